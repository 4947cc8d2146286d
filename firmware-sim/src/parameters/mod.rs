//! The configuration of a simulation.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use singletrack_control::VehicleParameterError;
use singletrack_protocol::{Configuration, ImuAxes, ImuAxis};

use crate::{
    attitude::Rotation,
    board::{BoardParameters, UnoError},
    cameras::CameraParameters,
    car::{CarParameters, EscKind},
    natnet_server::NatNetParameters,
    truth::CarTruth,
    wire::WireParameters,
};

/// The configuration of a simulation.
///
/// The default is the paper's car with hobby-grade actuators, a consumer IMU and a
/// good motion capture system, without faults.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SimulationConfig {
    /// Seed of all random numbers.
    pub seed: u64,
    /// The car.
    pub car: CarParameters,
    /// The board's clock, start-up and buffers.
    pub board: BoardParameters,
    /// The serial line.
    pub wire: WireParameters,
    /// The cameras.
    pub cameras: CameraParameters,
    /// The NatNet server.
    pub natnet: NatNetParameters,
}

impl Default for SimulationConfig {
    fn default() -> Self {
        Self {
            seed: 1,
            car: CarParameters::default(),
            board: BoardParameters::default(),
            wire: WireParameters::default(),
            cameras: CameraParameters::default(),
            natnet: NatNetParameters::default(),
        }
    }
}

/// Errors in the configuration of a simulation.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ConfigError {
    /// Invalid vehicle parameters.
    #[error("car.vehicle: {0}")]
    Vehicle(#[from] VehicleParameterError),
    /// The simulated UNO is not available.
    #[error(transparent)]
    Uno(#[from] UnoError),
    /// A value is out of range.
    #[error("{name} is {value}: it must be {rule}")]
    OutOfRange {
        /// Name of the setting.
        name: &'static str,
        /// Value of the setting.
        value: f64,
        /// Allowed values.
        rule: &'static str,
    },
}

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
    #[error("{}: {source}", path.display())]
    Parse {
        /// The file.
        path: PathBuf,
        /// Where and why.
        source: toml::de::Error,
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

/// The file of a simulation: its configuration, and what is true of the car beside it.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct SimulationFile {
    seed: u64,
    car: CarParameters,
    board: BoardParameters,
    wire: WireParameters,
    cameras: CameraParameters,
    natnet: NatNetParameters,
    truth: CarTruth,
}

impl Default for SimulationFile {
    fn default() -> Self {
        let SimulationConfig {
            seed,
            car,
            board,
            wire,
            cameras,
            natnet,
        } = SimulationConfig::default();
        Self {
            seed,
            car,
            board,
            wire,
            cameras,
            natnet,
            truth: CarTruth::default(),
        }
    }
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
        } = toml::from_str(&text).map_err(|source| SimulationFileError::Parse {
            path: path.to_owned(),
            source,
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

    /// Makes the car as its board's configuration says: a calibration without an error.
    /// Bands and limits, which a configuration chooses with room to spare, stay as they are.
    pub fn follow(&mut self, board: &Configuration) {
        let car = &mut self.car;
        car.servo.centre_us = board.servo.centre_us.into();
        car.servo.gain_us_per_rad = board.servo.gain_us_per_rad.into();
        car.motor.neutral_us = board.esc.neutral_us;
        let kind = match board.esc.kind {
            singletrack_protocol::EscKind::ForwardReverse => EscKind::ForwardReverse,
            singletrack_protocol::EscKind::Vesc => EscKind::Vesc,
            _ => EscKind::Car,
        };
        if kind != car.motor.kind {
            car.motor.kind = kind;
            car.motor.signal_loss_us = kind.signal_loss_us();
        }
        car.motor.kill_relay = board.kill_output;
        car.motor_sensor.pulse_distance_um = board.speed.pulse_distance_um.into();
        car.imu.mounting_deg = mounting_deg(board.imu_axes);
        self.board.car_id = board.car_id;
    }

    /// Checks all settings against their ranges.
    ///
    /// # Errors
    ///
    /// The first setting that is out of range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let Self {
            car,
            board,
            wire,
            cameras,
            ..
        } = self;
        car.vehicle.validate()?;
        let positive = "finite and above zero";
        let probability = "a probability from 0 to 1";
        let not_negative = "finite and not negative";
        let edge_rate = "between 0 and 100000";
        let at_least_one = |value: u64| value as f64;
        for (name, value, valid, rule) in [
            check(
                "car.servo.gain_us_per_rad",
                car.servo.gain_us_per_rad,
                |x| x != 0.0,
                "finite and not zero",
            ),
            check(
                "car.servo.lag_s",
                car.servo.lag_s,
                |x| x >= 0.002,
                "0.002 or more",
            ),
            check(
                "car.servo.max_rate_rad_s",
                car.servo.max_rate_rad_s,
                above_zero,
                positive,
            ),
            check(
                "car.servo.stop_rad",
                car.servo.stop_rad,
                |x| x > 0.0 && x < 1.5,
                "between 0 and 1.5",
            ),
            check(
                "car.motor.lag_s",
                car.motor.lag_s,
                |x| x >= 0.002,
                "0.002 or more",
            ),
            check(
                "car.motor.saturation_us",
                car.motor.saturation_us,
                above_zero,
                positive,
            ),
            check(
                "car.motor.gain_m_s_per_us",
                car.motor.gain_m_s_per_us,
                above_zero,
                positive,
            ),
            check(
                "car.motor.coasting_m_s2",
                car.motor.coasting_m_s2,
                zero_or_more,
                not_negative,
            ),
            check(
                "car.motor.viscous_per_s",
                car.motor.viscous_per_s,
                zero_or_more,
                not_negative,
            ),
            check(
                "car.motor_sensor.pulse_distance_um",
                car.motor_sensor.pulse_distance_um,
                |x| x >= 10.0,
                "10 or more",
            ),
            check(
                "car.battery.nominal_v",
                car.battery.nominal_v,
                above_zero,
                positive,
            ),
            check(
                "car.imu.period_us",
                at_least_one(car.imu.period_us),
                |x| x >= 1_000.0,
                "1000 or more",
            ),
            check(
                "cameras.period_us",
                at_least_one(cameras.period_us),
                |x| x >= 1_000.0,
                "1000 or more",
            ),
            check(
                "board.poll_period_us",
                at_least_one(board.poll_period_us),
                |x| x >= 100.0,
                "100 or more",
            ),
            check(
                "car.servo.backlash_us",
                car.servo.backlash_us,
                zero_or_more,
                not_negative,
            ),
            check(
                "car.motor.reboot_ms",
                car.motor.reboot_ms,
                above_zero,
                positive,
            ),
            check(
                "car.motor.slope_deg",
                car.motor.slope_deg,
                |x| (-45.0..=45.0).contains(&x),
                "from -45 to 45",
            ),
            check(
                "car.motor.slope_heading_deg",
                car.motor.slope_heading_deg,
                |_| true,
                "finite",
            ),
            check(
                "car.motor.slip",
                car.motor.slip,
                |x| (0.0..1.0).contains(&x),
                "from 0 to below 1",
            ),
            check(
                "car.motor.push.speed_m_s",
                car.motor.push.map_or(0.0, |push| push.speed_m_s),
                |_| true,
                "finite",
            ),
            check(
                "car.motor.push.for_s",
                car.motor.push.map_or(0.0, |push| push.for_s),
                zero_or_more,
                not_negative,
            ),
            check(
                "car.motor_sensor.emi_driven_hz",
                car.motor_sensor.emi_driven_hz,
                is_edge_rate,
                edge_rate,
            ),
            check(
                "car.motor_sensor.emi_standstill_hz",
                car.motor_sensor.emi_standstill_hz,
                is_edge_rate,
                edge_rate,
            ),
            check(
                "car.motor_sensor.ringing_edges",
                f64::from(car.motor_sensor.ringing_edges),
                |x| x <= 1_000.0,
                "1000 or less",
            ),
            check(
                "car.battery.supply_v",
                car.battery.supply_v,
                above_zero,
                positive,
            ),
            check(
                "car.battery.dip_ms",
                car.battery.dip_ms,
                above_zero,
                positive,
            ),
            check(
                "car.imu.mounting_deg",
                car.imu.mounting_deg.iter().sum(),
                |_| true,
                "finite",
            ),
            check("car.imu.gyro_scale", car.imu.gyro_scale, |_| true, "finite"),
            check(
                "car.imu.acceleration_scale",
                car.imu.acceleration_scale,
                |_| true,
                "finite",
            ),
            check(
                "car.imu.vibration_m_s2",
                car.imu.vibration_m_s2,
                zero_or_more,
                not_negative,
            ),
            check(
                "car.imu.vibration_rad_s",
                car.imu.vibration_rad_s,
                zero_or_more,
                not_negative,
            ),
            check(
                "car.imu.leak_s",
                car.imu.leak_s.unwrap_or(1.0),
                above_zero,
                positive,
            ),
            check("car.imu.torn", car.imu.torn, is_probability, probability),
            check(
                "car.imu.calibration",
                car.imu
                    .calibration
                    .iter()
                    .copied()
                    .max()
                    .unwrap_or(0)
                    .into(),
                |x| x <= 3.0,
                "0 to 3",
            ),
            check(
                "car.imu.restart_ms",
                car.imu.restart_ms,
                zero_or_more,
                not_negative,
            ),
            check(
                "cameras.stamp_bias_ms",
                cameras.stamp_bias_ms,
                |x| x.abs() <= 10_000.0,
                "from -10000 to 10000",
            ),
            check(
                "cameras.stamp_drift_ppm",
                cameras.stamp_drift_ppm,
                |x| x.abs() <= 100_000.0,
                "from -100000 to 100000",
            ),
            check("cameras.frozen_ms", cameras.frozen_ms, above_zero, positive),
            check("cameras.flip_deg", cameras.flip_deg, |_| true, "finite"),
            check(
                "cameras.forged_offset_m",
                cameras.forged_offset_m.iter().sum(),
                |_| true,
                "finite",
            ),
            check(
                "cameras.forged_drift_m_s",
                cameras.forged_drift_m_s.iter().sum(),
                |_| true,
                "finite",
            ),
            check(
                "wire.baud",
                f64::from(wire.baud),
                |x| x >= 300.0,
                "300 or more",
            ),
            check(
                "wire.faults.drop",
                wire.faults.drop,
                is_probability,
                probability,
            ),
            check(
                "wire.faults.corrupt",
                wire.faults.corrupt,
                is_probability,
                probability,
            ),
            check(
                "cameras.position_noise_m",
                cameras.position_noise_m,
                zero_or_more,
                not_negative,
            ),
            check(
                "cameras.orientation_noise_rad",
                cameras.orientation_noise_rad,
                zero_or_more,
                not_negative,
            ),
        ] {
            if !valid {
                return Err(ConfigError::OutOfRange { name, value, rule });
            }
        }
        for (name, time_s) in [
            ("car.servo.stuck_from_s", car.servo.stuck_from_s),
            ("car.motor.stuck_from_s", car.motor.stuck_from_s),
            ("car.motor.reboot_at_s", car.motor.reboot_at_s),
            ("car.motor.slip_from_s", car.motor.slip_from_s),
            ("car.motor.push.at_s", car.motor.push.map(|push| push.at_s)),
            ("car.battery.dip_at_s", car.battery.dip_at_s),
            ("cameras.other_body_from_s", cameras.other_body_from_s),
            ("cameras.frozen_from_s", cameras.frozen_from_s),
            ("cameras.flip_from_s", cameras.flip_from_s),
            ("cameras.forged_from_s", cameras.forged_from_s),
        ] {
            let (name, value, valid, rule) =
                check(name, time_s.unwrap_or(0.0), zero_or_more, not_negative);
            if !valid {
                return Err(ConfigError::OutOfRange { name, value, rule });
            }
        }
        Ok(())
    }
}

/// The angles of a sensor whose axes are mounted so.
fn mounting_deg(axes: ImuAxes) -> [f64; 3] {
    let direction = |axis: ImuAxis| -> [f64; 3] {
        core::array::from_fn(
            |i| match (usize::from(axis.index()) == i, axis.is_negative()) {
                (false, _) => 0.0,
                (true, true) => -1.0,
                (true, false) => 1.0,
            },
        )
    };
    let right_angles = || [0.0, 90.0, 180.0, 270.0].into_iter();
    let mut mountings = right_angles().flat_map(|roll| {
        right_angles().flat_map(move |pitch| right_angles().map(move |yaw| [roll, pitch, yaw]))
    });
    mountings
        .find(|&angles| {
            // Without a rotation the axes are those of the car.
            let turned = |axis: [f64; 3]| {
                Rotation::from_degrees(angles).map_or(axis, |mounting| mounting.into_turned(axis))
            };
            [
                ([1.0, 0.0, 0.0], axes.forward),
                ([0.0, 1.0, 0.0], axes.left),
                ([0.0, 0.0, 1.0], axes.up),
            ]
            .into_iter()
            .all(|(axis, chip)| {
                let error = turned(axis).into_iter().zip(direction(chip));
                error.into_iter().all(|(a, b)| (a - b).abs() < 1e-6)
            })
        })
        // A left-handed set of axes, which the board refuses.
        .unwrap_or_default()
}

fn check(
    name: &'static str,
    value: f64,
    rule: fn(f64) -> bool,
    words: &'static str,
) -> (&'static str, f64, bool, &'static str) {
    (name, value, value.is_finite() && rule(value), words)
}

fn above_zero(x: f64) -> bool {
    x > 0.0
}

fn zero_or_more(x: f64) -> bool {
    x >= 0.0
}

fn is_edge_rate(x: f64) -> bool {
    (0.0..=100_000.0).contains(&x)
}

fn is_probability(x: f64) -> bool {
    (0.0..=1.0).contains(&x)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_is_valid_and_round_trips() {
        let config = SimulationConfig::default();
        config.validate().unwrap();
        let text = toml::to_string(&config).unwrap();
        assert_eq!(toml::from_str::<SimulationConfig>(&text).unwrap(), config);
    }

    #[test]
    fn a_car_that_follows_its_default_configuration_is_the_default_car() {
        let mut followed = SimulationConfig::default();
        followed.follow(&crate::default_board_configuration());
        assert_eq!(followed, SimulationConfig::default());
    }

    #[test]
    fn a_car_that_follows_its_configuration_is_calibrated() {
        let mut board = crate::default_board_configuration();
        board.servo.gain_us_per_rad = 700;
        board.esc.neutral_us = 1_520;
        board.esc.kind = singletrack_protocol::EscKind::Vesc;
        board.speed.pulse_distance_um = 12_000;
        board.kill_output = true;
        board.car_id = 7;
        let mut simulation = SimulationConfig::default();
        simulation.follow(&board);
        let car = &simulation.car;
        assert_eq!(car.servo.gain_us_per_rad, 700.0);
        assert_eq!(car.motor.neutral_us, 1_520);
        assert_eq!(car.motor.signal_loss_us, 1_000_000);
        assert_eq!(car.motor_sensor.pulse_distance_um, 12_000.0);
        assert!(car.motor.kill_relay);
        assert_eq!(simulation.board.car_id, 7);
    }

    #[test]
    fn all_mountings_at_right_angles_have_angles() {
        use singletrack_protocol::ImuAxis::{MinusX, MinusY, MinusZ, PlusX, PlusY, PlusZ};
        let axes = [PlusX, MinusX, PlusY, MinusY, PlusZ, MinusZ];
        let mut found = 0;
        for forward in axes {
            for left in axes {
                for up in axes {
                    let mounting = ImuAxes { forward, left, up };
                    found += u32::from(mounting_deg(mounting) != [0.0; 3]);
                }
            }
        }
        // And the one without a turn.
        assert_eq!(found, 23);
        let turned = ImuAxes {
            forward: MinusY,
            left: PlusX,
            up: PlusZ,
        };
        assert_eq!(mounting_deg(turned), [0.0, 0.0, 90.0]);
    }

    #[test]
    fn unknown_keys_and_invalid_values_are_reported_by_name() {
        let error = toml::from_str::<SimulationConfig>("[car.servo]\nlagg_s = 1").unwrap_err();
        assert!(error.to_string().contains("lagg_s"), "{error}");
        let config: SimulationConfig = toml::from_str("[wire.faults]\ncorrupt = 1.5").unwrap();
        assert_eq!(
            config.validate().unwrap_err().to_string(),
            "wire.faults.corrupt is 1.5: it must be a probability from 0 to 1"
        );
        let error = toml::from_str::<SimulationConfig>("[cameras]\nloss = \"1s\"").unwrap_err();
        assert!(error.to_string().contains("DURATION@INTERVAL"), "{error}");
        let error =
            toml::from_str::<SimulationConfig>("[natnet]\nbitstream = \"2.5\"").unwrap_err();
        assert!(error.to_string().contains("2.5"), "{error}");
    }

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
