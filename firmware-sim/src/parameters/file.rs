//! The file of a simulation.

use std::path::{Path, PathBuf};

use singletrack_settings::{explain, section};

use super::{ConfigError, SimulationConfig};
use crate::{
    board::BoardParameters, cameras::CameraParameters, car::CarParameters,
    natnet_server::NatNetParameters, truth::CarTruth, wire::WireParameters,
};

/// Errors in the file of a simulation.
#[derive(Debug, thiserror::Error)]
pub enum SimulationFileError {
    /// The file can't be read.
    #[error("can't read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// The file is not a configuration.
    #[error("{}: {message}", path.display())]
    Parse {
        /// The file.
        path: PathBuf,
        /// Where and why.
        message: String,
    },
    /// A value is invalid.
    #[error("{}: {source}", path.display())]
    Value {
        /// The file.
        path: PathBuf,
        /// The value.
        source: ConfigError,
    },
}

section! {
    /// The file of a simulation: its configuration, and what is true of the car beside it.
    "simulation" => SimulationFile;
    [];

    /// See [`SimulationConfig`].
    seed: u64 = SimulationConfig::default().seed;
    /// See [`SimulationConfig`].
    car: CarParameters = CarParameters::default();
    /// See [`SimulationConfig`].
    board: BoardParameters = BoardParameters::default();
    /// See [`SimulationConfig`].
    wire: WireParameters = WireParameters::default();
    /// See [`SimulationConfig`].
    cameras: CameraParameters = CameraParameters::default();
    /// See [`SimulationConfig`].
    natnet: NatNetParameters = NatNetParameters::default();
    /// The car.
    truth: CarTruth = CarTruth::default();
}

impl SimulationConfig {
    /// Reads and checks a file: the sections of a simulation, and a table `[truth]`, which
    /// replaces what they say.
    ///
    /// # Errors
    ///
    /// The file can't be read, has an unknown key, or a value out of range.
    pub fn read(path: &Path) -> Result<Self, SimulationFileError> {
        let text = std::fs::read_to_string(path).map_err(|source| SimulationFileError::Read {
            path: path.to_owned(),
            source,
        })?;
        let SimulationFile {
            seed,
            car,
            board,
            wire,
            cameras,
            natnet,
            truth,
        } = toml::from_str(&text).map_err(|error| SimulationFileError::Parse {
            path: path.to_owned(),
            message: explain(&text, &error),
        })?;
        let mut simulation = Self {
            seed,
            car,
            board,
            wire,
            cameras,
            natnet,
        };
        truth
            .apply(&mut simulation)
            .map_err(|source| SimulationFileError::Value {
                path: path.to_owned(),
                source,
            })?;
        Ok(simulation)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_takes_the_sections_of_the_simulation_and_the_truth() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("car.toml");
        let read = |text: &str| {
            std::fs::write(&path, text).unwrap();
            SimulationConfig::read(&path).map_err(|error| error.to_string())
        };
        let text = "seed = 7\n[car.servo]\nlag_s = 0.1\n[truth.servo]\ncentre_us = 1540\n";
        let simulation = read(text).unwrap();
        assert_eq!(simulation.seed, 7);
        assert_eq!(simulation.car.servo.lag_s, 0.1);
        assert_eq!(simulation.car.servo.centre_us, 1540.0);
        for (text, name) in [
            ("[truth.servo]\ncentre = 1", "centre"),
            ("[truht]", "truht"),
            ("[truth.servo]\ncentre_us = 1", "truth.servo.centre_us"),
            ("[car.motor]\nslip = 2.0", "car.motor.slip"),
        ] {
            let error = read(text).unwrap_err();
            assert!(
                error.contains(name) && error.contains("car.toml"),
                "{error}"
            );
        }
    }
}
