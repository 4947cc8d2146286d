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

/// Sets a fault by its name.
pub(super) fn set(world: &mut World, name: &str, value: &FaultValue) -> Result<(), SetupError> {
    use FaultValue::{Number, Numbers, Switch, Word};

    let cameras = &mut world.cameras.faults;
    let line = &mut world.wire.faults;
    match (name, value) {
        ("imu", Word(word)) => {
            let known = [
                ("none", ImuFault::None),
                ("silent", ImuFault::Silent),
                ("stuck", ImuFault::Stuck),
                ("saturated", ImuFault::Saturated),
                ("erratic", ImuFault::Erratic),
            ];
            world.imu_fault = choice(name, word, &known)?;
        }
        ("motor_sensor", Word(word)) => {
            let known = MotorSensorFault::ALL.map(|fault| (fault.name(), fault));
            world.car.sensor_fault = choice(name, word, &known)?;
        }
        ("cameras", Word(word)) => {
            let known = [
                ("none", None),
                ("occluded", Some(LossKind::Occluded)),
                ("absent", Some(LossKind::Absent)),
                ("silent", Some(LossKind::Silent)),
            ];
            cameras.loss = choice(name, word, &known)?;
        }
        ("camera_jump_m", Numbers(jump)) if jump.iter().all(|it| in_hall(*it)) => {
            let jump = <[f64; 3]>::try_from(&jump[..]);
            cameras.jump_m = jump.map_err(|_| refusal(name, value))?;
        }
        ("line_drop", Number(share @ 0.0..=1.0)) => line.drop = *share,
        ("line_corrupt", Number(share @ 0.0..=1.0)) => line.corrupt = *share,
        ("line_delay_us", Number(us @ 0.0..)) if us.trunc() == *us => line.delay_us = *us as u64,
        ("line_stuck", Switch(on)) => line.stuck = *on,
        ("cable", Switch(on)) => world.set_cable(*on),
        ("board_power", Switch(on)) => world.set_board_power(*on),
        ("esc_power", Switch(on)) => world.car.set_esc_power(*on),
        ("battery", Switch(on)) => world.car.set_battery_plugged(*on),
        ("servo_reversed", Switch(on)) => world.car.set_servo_reversed(*on),
        ("stop_switch", Switch(on)) => world.board.stop_input_open = *on,
        _ => return Err(refusal(name, value)),
    }
    Ok(())
}

/// Why a fault can't be set to a value.
fn refusal(name: &str, value: &FaultValue) -> SetupError {
    let wanted = match name {
        "imu" | "motor_sensor" | "cameras" => "give a word",
        "camera_jump_m" => "give three lengths in m",
        "line_drop" | "line_corrupt" => "it must be between 0 and 1",
        "line_delay_us" => "give a whole number of µs",
        "line_stuck" | "cable" | "board_power" | "esc_power" | "battery" | "servo_reversed"
        | "stop_switch" => "give true or false",
        _ => {
            return SetupError::new(format!(
                "unknown fault {name:?}: use imu, motor_sensor, cameras, camera_jump_m, \
                 line_drop, line_corrupt, line_delay_us, line_stuck, cable, board_power, \
                 esc_power, battery, servo_reversed or stop_switch"
            ));
        }
    };
    let given = match value {
        FaultValue::Switch(on) => on.to_string(),
        FaultValue::Number(number) => number.to_string(),
        FaultValue::Numbers(numbers) => format!("{numbers:?}"),
        FaultValue::Word(word) => format!("{word:?}"),
    };
    SetupError::new(format!("{name} is {given}: {wanted}"))
}
