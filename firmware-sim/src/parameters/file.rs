//! The file of a simulation.

use core::fmt::Display;
use std::path::Path;

use singletrack_settings::{explain, section};

use super::SimulationConfig;
use crate::{
    board::BoardParameters, cameras::CameraParameters, car::CarParameters,
    natnet_server::NatNetParameters, truth::CarTruth, wire::WireParameters,
};

/// Why the file of a simulation is refused: in words, with the file.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct SimulationFileError(String);

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
        let text = std::fs::read_to_string(path).map_err(|error| {
            SimulationFileError(format!("can't read {}: {error}", path.display()))
        })?;
        let refused = |why: &dyn Display| SimulationFileError(format!("{}: {why}", path.display()));
        let SimulationFile {
            seed,
            car,
            board,
            wire,
            cameras,
            natnet,
            truth,
        } = toml::from_str(&text).map_err(|error| refused(&explain(&text, &error)))?;
        let mut simulation = Self {
            seed,
            car,
            board,
            wire,
            cameras,
            natnet,
        };
        let applied = truth.apply(&mut simulation);
        applied.map_err(|error| refused(&error))?;
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
