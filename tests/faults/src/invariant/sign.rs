//! Signs: the car turns the way it steers, and the gyroscope the way the car turns.

use singletrack_pilot::{Event, Mode};

use super::{Invariant, Verdict};
use crate::observation::Observation;

/// The way that a contradiction may last, in m.
const CONTRADICTED_M: f64 = 0.5;

/// The same once the configuration has been proved: the servo has broken since.
const BROKEN_M: f64 = 1.2;

/// The way driven while something is contradicted.
#[derive(Default)]
struct Way {
    metres: f64,
}

impl Way {
    /// Adds the way of a tick; an agreement ends the contradiction, and what shows neither
    /// leaves it.
    fn tick(&mut self, contradicted: Option<bool>, metres: f64) -> f64 {
        match contradicted {
            Some(true) => self.metres += metres,
            Some(false) => self.metres = 0.0,
            None => {}
        }
        self.metres
    }
}

fn is_driving(mode: Mode) -> bool {
    matches!(mode, Mode::Driving | Mode::Slowing)
}

/// `steering-sign`: a car that turns against its steering command does not drive on for
/// half a metre; if its configuration has been proved, for 1.2 m: the watch compares twice over 0.4 m,
/// and may have begun a comparison before.
///
/// Bends of less than 0.2/m and commands of less than 0.1 rad show no sign; the command is
/// that of 0.3 s ago, which servo and car need.
#[derive(Default)]
pub(super) struct SteeringSign {
    way: Way,
    commands: std::collections::VecDeque<f64>,
}

const SERVO_TICKS: usize = 30;

impl Invariant for SteeringSign {
    fn name(&self) -> &'static str {
        "steering-sign"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        let Some(tick) = observation.tick else {
            return Ok(());
        };
        if !is_driving(tick.output.mode) {
            *self = Self::default();
            return Ok(());
        }
        self.commands.push_back(tick.output.actuation.steering);
        if self.commands.len() <= SERVO_TICKS {
            return Ok(());
        }
        self.commands.pop_front();
        // All commands of the last 0.3 s steer to one side.
        let least = self.commands.iter().copied().fold(f64::MAX, f64::min);
        let most = self.commands.iter().copied().fold(f64::MIN, f64::max);
        let side = if least > 0.1 {
            1.0
        } else if most < -0.1 {
            -1.0
        } else {
            0.0
        };
        let truth = &observation.truth;
        let bends = truth.speed > 0.1 && (truth.yaw_rate / truth.speed).abs() > 0.2;
        let contradicted = (side != 0.0 && bends).then_some(truth.yaw_rate * side < 0.0);
        let way = self
            .way
            .tick(contradicted, truth.speed * observation.spec.period_s);
        let limit = if observation.is_proved {
            BROKEN_M
        } else {
            CONTRADICTED_M
        };
        if way > limit {
            return Err(format!("{way:.2} m driven against the steering"));
        }
        Ok(())
    }
}

/// `gyro-sign`: a car whose gyroscope measures a turn to the other side does not drive on
/// for half a metre.
#[derive(Default)]
pub(super) struct GyroSign {
    way: Way,
}

impl Invariant for GyroSign {
    fn name(&self) -> &'static str {
        "gyro-sign"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        let Some(tick) = observation.tick else {
            return Ok(());
        };
        if !is_driving(tick.output.mode) {
            *self = Self::default();
            return Ok(());
        }
        let truth = &observation.truth;
        let mut measured = tick.events.iter().filter_map(|event| match event {
            Event::Board(sample) => Some(sample.inertial?.yaw_rate),
            _ => None,
        });
        let turns = truth.yaw_rate.abs() > 0.2;
        let contradicted = measured
            .next_back()
            .filter(|_| turns)
            .map(|rate| rate * truth.yaw_rate.signum() < -0.1);
        let way = self
            .way
            .tick(contradicted, truth.speed * observation.spec.period_s);
        if way > CONTRADICTED_M {
            return Err(format!("{way:.2} m driven against the gyroscope"));
        }
        Ok(())
    }
}
