//! Faults of a simulated car, board, line or cameras, by their names.

use serde::Deserialize;
use singletrack_sim::{ImuFault, LossKind, MotorSensorFault, World};

use super::{
    SetupError,
    setup::{choice, in_hall},
};

/// The value of a fault: a word, a number, numbers, or whether it is so.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(
    untagged,
    expecting = "use a word, a number, a list of numbers, true or false"
)]
pub enum FaultValue {
    /// State of a switch.
    Switch(bool),
    /// An amount, in the unit that the fault's name ends with.
    Number(f64),
    /// A displacement.
    Numbers(Vec<f64>),
    /// The word for a kind.
    Word(String),
}

impl FaultValue {
    fn error(&self, name: &str, wanted: &str) -> SetupError {
        let given = match self {
            Self::Switch(on) => on.to_string(),
            Self::Number(number) => number.to_string(),
            Self::Numbers(numbers) => format!("{numbers:?}"),
            Self::Word(word) => format!("{word:?}"),
        };
        SetupError::new(format!("{name} is {given}: {wanted}"))
    }

    fn kind<T: Copy>(&self, name: &str, known: &[(&str, T)]) -> Result<T, SetupError> {
        match self {
            Self::Word(word) => choice(name, word, known),
            other => Err(other.error(name, "give a word")),
        }
    }

    fn is_on(&self, name: &str) -> Result<bool, SetupError> {
        match self {
            Self::Switch(on) => Ok(*on),
            other => Err(other.error(name, "give true or false")),
        }
    }

    fn probability(&self, name: &str) -> Result<f64, SetupError> {
        match self {
            Self::Number(number) if (0.0..=1.0).contains(number) => Ok(*number),
            other => Err(other.error(name, "it must be between 0 and 1")),
        }
    }

    fn microseconds(&self, name: &str) -> Result<u64, SetupError> {
        match self {
            Self::Number(number) if *number >= 0.0 && number.trunc() == *number => {
                Ok(*number as u64)
            }
            other => Err(other.error(name, "give a whole number of µs")),
        }
    }

    fn lengths(&self, name: &str) -> Result<[f64; 3], SetupError> {
        match self {
            Self::Numbers(numbers) if numbers.iter().all(|it| in_hall(*it)) => {
                <[f64; 3]>::try_from(&numbers[..]).ok()
            }
            _ => None,
        }
        .ok_or_else(|| self.error(name, "give three lengths in m"))
    }
}

/// Sets a fault by its name.
pub(super) fn set(world: &mut World, name: &str, value: &FaultValue) -> Result<(), SetupError> {
    match name {
        "imu" => {
            world.imu_fault = value.kind(
                name,
                &[
                    ("none", ImuFault::None),
                    ("silent", ImuFault::Silent),
                    ("stuck", ImuFault::Stuck),
                    ("saturated", ImuFault::Saturated),
                    ("erratic", ImuFault::Erratic),
                ],
            )?;
        }
        "motor_sensor" => {
            let known = MotorSensorFault::ALL.map(|fault| (fault.name(), fault));
            world.car.sensor_fault = value.kind(name, &known)?;
        }
        "cameras" => {
            world.cameras.faults.loss = value.kind(
                name,
                &[
                    ("none", None),
                    ("occluded", Some(LossKind::Occluded)),
                    ("absent", Some(LossKind::Absent)),
                    ("silent", Some(LossKind::Silent)),
                ],
            )?;
        }
        "camera_jump_m" => world.cameras.faults.jump_m = value.lengths(name)?,
        "line_drop" => world.wire.faults.drop = value.probability(name)?,
        "line_corrupt" => world.wire.faults.corrupt = value.probability(name)?,
        "line_delay_us" => world.wire.faults.delay_us = value.microseconds(name)?,
        "line_stuck" => world.wire.faults.stuck = value.is_on(name)?,
        "cable" => world.set_cable(value.is_on(name)?),
        "board_power" => world.set_board_power(value.is_on(name)?),
        "esc_power" => world.car.set_esc_power(value.is_on(name)?),
        "battery" => world.car.set_battery_plugged(value.is_on(name)?),
        "servo_reversed" => world.car.set_servo_reversed(value.is_on(name)?),
        "stop_switch" => world.board.stop_input_open = value.is_on(name)?,
        _ => {
            return Err(SetupError::new(format!(
                "unknown fault {name:?}: use imu, motor_sensor, cameras, camera_jump_m, \
                 line_drop, line_corrupt, line_delay_us, line_stuck, cable, board_power, \
                 esc_power, battery, servo_reversed or stop_switch"
            )));
        }
    }
    Ok(())
}
