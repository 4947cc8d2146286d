//! The configuration of a simulation.

#[cfg(feature = "real-time")]
mod file;
pub(crate) mod ranges;

use singletrack_control::VehicleParameterError;
use singletrack_protocol::Configuration;
use singletrack_settings::{ValueError, section};

use crate::{
    attitude::mounting_deg,
    board::{BoardParameters, UnoError},
    cameras::CameraParameters,
    car::{CarParameters, EscKind},
    natnet_server::NatNetParameters,
    wire::WireParameters,
};

#[cfg(feature = "real-time")]
pub use file::SimulationFileError;

section! {
    /// The configuration of a simulation.
    ///
    /// The default is the paper's car with hobby-grade actuators, a consumer IMU and a
    /// good motion capture system, without faults.
    "simulation" => pub SimulationConfig;
    [default];

    /// Seed of all random numbers.
    seed: u64 = 1;
    /// The car.
    car: CarParameters = CarParameters::default();
    /// The board's clock, start-up and buffers.
    board: BoardParameters = BoardParameters::default();
    /// The serial line.
    wire: WireParameters = WireParameters::default();
    /// The cameras.
    cameras: CameraParameters = CameraParameters::default();
    /// The NatNet server.
    natnet: NatNetParameters = NatNetParameters::default();
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
    #[error(transparent)]
    Value(#[from] ValueError),
}

impl SimulationConfig {
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
}
