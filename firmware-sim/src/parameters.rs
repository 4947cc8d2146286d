//! The configuration of a simulation, and of the board on its default car.

use singletrack_control::VehicleParameterError;
use singletrack_protocol::{
    Configuration, EscCalibration, FailsafeAction, ImuAxes, LONGEST_ROLL_OUT_MS, ServoCalibration,
    SpeedLoop,
};
use singletrack_settings::{Declared as _, ValueError, section};

use crate::{
    board::{BoardParameters, UnoError},
    cameras::CameraParameters,
    car::{CarParameters, EscKind, mounting_deg},
    natnet_server::NatNetParameters,
    wire::WireParameters,
};

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

    /// Checks all settings against their ranges.
    ///
    /// # Errors
    ///
    /// The first setting that is out of range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let car = &self.car;
        car.vehicle.validate()?;
        car.servo.check()?;
        car.motor.check()?;
        if let Some(push) = &car.motor.push {
            push.check()?;
        }
        car.motor_sensor.check()?;
        car.battery.check()?;
        car.imu.check()?;
        self.cameras.check()?;
        self.board.check()?;
        self.wire.check()?;
        Ok(self.wire.faults.check()?)
    }
}

/// The board's configuration for the default [`crate::CarParameters`], as from a
/// calibration of that car.
pub const fn default_board_configuration() -> Configuration {
    Configuration {
        servo: ServoCalibration {
            centre_us: 1_500,
            gain_us_per_rad: -800,
            min_us: 1_080,
            max_us: 1_920,
            // 6 rad/s, close to the servo's limit.
            slew_us_per_20ms: 96,
        },
        esc: EscCalibration {
            kind: singletrack_protocol::EscKind::Car,
            neutral_us: 1_500,
            deadband_us: 30,
            min_us: 1_200,
            max_us: 1_700,
            slew_us_per_20ms: 40,
            brake_us: 1_350,
        },
        speed: SpeedLoop {
            pulse_distance_um: 3_000,
            // Less than the car needs (98): the proportional term saturates before
            // the car moves, and the sum would overshoot.
            feed_forward_us_per_m_s: 80,
            proportional_us_per_m_s: 80,
            integral_us_per_m: 250,
            integral_limit_us: 60,
            max_forward_mm_s: 1_500,
            max_reverse_mm_s: 0,
        },
        failsafe: FailsafeAction::Coast,
        max_pose_age_ms: 950,
        stop_input: false,
        kill_output: false,
        max_roll_out_ms: LONGEST_ROLL_OUT_MS,
        car_id: 0,
        imu_axes: ImuAxes::AS_PRINTED,
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
}
