//! The car in a file: the table `[vehicle]` of any TOML file.
//!
//! The daemon's configuration and a scenario may have that table, and are vehicle files
//! then; `tools/vehicles` has some cars.

use std::{fs, path::Path};

use serde::{Deserialize, Serialize};
use singletrack_control::VehicleParameters;
use singletrack_settings::explain;

use crate::Result;

/// What is read of a file; other tables may be there.
#[derive(Deserialize, Serialize)]
struct File {
    vehicle: VehicleParameters,
}

/// Reads the car of a file, or the paper's if there is none.
///
/// # Errors
///
/// A file that can't be read, or has no car in it.
pub fn read_or_paper(path: Option<&Path>) -> Result<VehicleParameters> {
    path.map_or_else(|| Ok(VehicleParameters::paper()), read)
}

/// Reads the car of a file.
///
/// # Errors
///
/// A file that can't be read, or has no car in it.
pub fn read(path: &Path) -> Result<VehicleParameters> {
    let name = path.display();
    let text = fs::read_to_string(path)
        .map_err(|error| format!("can't read the vehicle file {name}: {error}"))?;
    let File { vehicle } = toml::from_str(&text).map_err(|error| {
        format!(
            "{name}: {} (a vehicle file needs a table [vehicle] as in tools/vehicles/paper.toml)",
            explain(&text, &error)
        )
    })?;
    vehicle
        .validate()
        .map_err(|error| format!("{name}: [vehicle]: {error}"))?;
    Ok(vehicle)
}

/// The text of a file with this car.
///
/// # Errors
///
/// A number that has no TOML.
pub fn text(vehicle: VehicleParameters) -> Result<String> {
    toml::to_string(&File { vehicle })
        .map_err(|error| format!("can't write a vehicle file: {error}").into())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shipped(name: &str) -> VehicleParameters {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tools/vehicles");
        read(&folder.join(name)).unwrap()
    }

    #[test]
    fn the_papers_car_is_the_default() {
        assert_eq!(shipped("paper.toml"), VehicleParameters::paper());
        assert_eq!(read_or_paper(None).unwrap(), VehicleParameters::paper());
    }

    #[test]
    fn the_other_cars_stiffnesses_follow_from_their_coefficients_and_loads() {
        for (name, front, rear) in [
            ("f1tenth.toml", 4.718, 5.4562),
            ("bmw-320i.toml", 20.89, 20.89),
        ] {
            let car = shipped(name);
            let load =
                car.friction * car.mass_kg * singletrack_control::GRAVITY / car.wheelbase_m();
            for (stiffness, expected) in [
                (
                    car.front_cornering_stiffness_n_rad,
                    front * load * car.rear_axle_distance_m,
                ),
                (
                    car.rear_cornering_stiffness_n_rad,
                    rear * load * car.front_axle_distance_m,
                ),
            ] {
                assert!(
                    (stiffness / expected - 1.0).abs() < 1e-4,
                    "{name}: {stiffness} {expected}"
                );
            }
        }
    }

    #[test]
    fn a_daemons_configuration_that_names_its_car_is_a_vehicle_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("daemon.toml");
        let example = include_str!("../../host/daemon/singletrackd.example.toml");
        // Its car is commented out, being the paper's.
        let named = example
            .replace("#[vehicle]", "[vehicle]")
            .replace("#mass_kg = 1.9", "mass_kg = 2.1");
        let named: Vec<&str> = named
            .lines()
            .skip_while(|line| *line != "[vehicle]")
            .map(|line| line.strip_prefix('#').unwrap_or(line))
            .take_while(|line| !line.is_empty())
            .collect();
        fs::write(
            &path,
            format!("[control]\nperiod_ms = 10\n{}", named.join("\n")),
        )
        .unwrap();
        assert_eq!(
            read(&path).unwrap(),
            VehicleParameters {
                mass_kg: 2.1,
                ..VehicleParameters::paper()
            }
        );
    }

    #[test]
    fn what_is_no_car_is_refused_with_file_key_and_fix() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("car.toml");
        let refused = |text: &str| {
            fs::write(&path, text).unwrap();
            let error = read(&path).unwrap_err().to_string();
            assert!(error.contains("car.toml"), "{error}");
            error
        };
        assert!(refused("[law]\n").contains("[vehicle]"));
        let whole = include_str!("../../tools/vehicles/paper.toml");
        assert!(refused(&whole.replace("mass_kg", "mas_kg")).contains("mas_kg"));
        assert!(refused(&whole.replace("friction = 0.25\n", "")).contains("friction"));
        assert!(refused(&whole.replace("1.9", "-1.9")).contains("mass_kg is -1.9"));
        let error = read(&folder.path().join("none.toml"))
            .unwrap_err()
            .to_string();
        assert!(error.contains("none.toml"), "{error}");
    }
}
