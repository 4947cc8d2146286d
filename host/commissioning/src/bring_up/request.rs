//! Requests to the operator: the stand, the place, and what is asked of the hands.

use singletrack_control::Time;

use super::{car::Car, questions};
use crate::{
    Answer, Bench, BoardReading, Finding, PoseReading, Question, Refused, Step, Trouble,
    finding::{failed, require},
};

/// Time for which the car must be at rest, s.
const WATCHED_S: f64 = 2.0;

pub(super) const STEP: Step = Step::new("stand", "The car on its stand", find)
    .expecting("All wheels are clear of the floor, the cameras see the car, and it stands still.");

pub(super) fn find(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    let is_on_stand = ask_yes(bench, &questions::ON_STAND)?;
    let fix = "Put a box under the chassis so that all wheels turn freely.";
    require(is_on_stand, "the car is not on a stand", fix)?;
    let mut car = Car::look(bench)?;
    let readings = car.watch(WATCHED_S, "standing")?;
    let turns = readings.iter().any(BoardReading::turns);
    let found = "the motor turns although the car is not armed";
    let fix = "Cut the supply of the ESC. Its neutral is not at 1500 us, or the pulse sensor picks \
               up interference: see docs/uno.md.";
    require(!turns, found, fix)?;
    Ok(Finding::good("the car stands still in view of the cameras"))
}

/// Puts values in force.
pub(super) fn change(
    bench: &mut dyn Bench,
    values: &[(&str, toml_edit::Value)],
) -> Result<(), Trouble> {
    bench.change(values).map_err(|Refused(why)| {
        let keys: Vec<_> = values.iter().map(|(key, _)| *key).collect();
        let fix = "Correct the configuration file as the message says, and run the bring-up again.";
        failed(format!("{} can't be changed: {why}", keys.join(", ")), fix)
    })
}

/// Asks a question that must not be skipped.
pub(super) fn ask(bench: &mut dyn Bench, question: &Question) -> Result<Answer, Trouble> {
    match bench.ask(question)? {
        Answer::Skip => Err(Trouble::Skipped),
        answer => Ok(answer),
    }
}

/// Asks for yes or no.
pub(super) fn ask_yes(bench: &mut dyn Bench, question: &Question) -> Result<bool, Trouble> {
    Ok(ask(bench, question)? == Answer::YesNo(true))
}

/// Asks for one of several words.
pub(super) fn ask_word<'a>(
    bench: &mut dyn Bench,
    question: &Question,
    words: &[&'a str],
) -> Result<&'a str, Trouble> {
    match ask(bench, question)? {
        Answer::Choice(index) => words.get(index).copied().ok_or(Trouble::Skipped),
        _ => Err(Trouble::Skipped),
    }
}

/// Asks for a number.
pub(super) fn ask_number(bench: &mut dyn Bench, question: &Question) -> Result<f64, Trouble> {
    match ask(bench, question)? {
        Answer::Number(number) => Ok(number),
        _ => Err(Trouble::Skipped),
    }
}

/// Way by which a car on its stand may shake, m, in several poses and in one.
const SHAKES_M: f64 = 0.02;
const JUMPS_M: f64 = 0.06;

/// Turn by which it may shake, rad.
const SHAKES_RAD: f64 = 0.1;

/// Poses in a row beyond these limits after which the car counts as moving.
const MOVING_POSES: u32 = 3;

/// Poses whose mean is the place of the car.
const PLACE_POSES: u32 = 10;

/// The place of a car, which it must not leave.
#[derive(Debug, Default)]
pub(super) struct Place {
    poses: u32,
    sum: [f64; 3],
    yaw: f64,
    off: u32,
    /// How far the car has moved when it has left its place, m.
    pub(super) left: Option<f64>,
    /// When the last pose arrived.
    pub(super) seen: Option<Time>,
}

impl Place {
    pub(super) fn see(&mut self, pose: &PoseReading) {
        self.seen = Some(pose.receive);
        if self.poses < PLACE_POSES {
            if self.poses == 0 {
                self.yaw = pose.yaw;
            }
            self.poses += 1;
            for (sum, value) in self.sum.iter_mut().zip(pose.position) {
                *sum += value;
            }
            return;
        }
        let poses = f64::from(self.poses);
        let squares: f64 = self
            .sum
            .iter()
            .zip(pose.position)
            .map(|(sum, value)| (value - sum / poses).powi(2))
            .sum();
        let way = squares.sqrt();
        let turn = (pose.yaw - self.yaw).sin().abs();
        self.off = if way > SHAKES_M || turn > SHAKES_RAD {
            self.off + 1
        } else {
            0
        };
        if self.off >= MOVING_POSES || way > JUMPS_M {
            self.left = Some(way);
        }
    }

    pub(super) fn is_known(&self) -> bool {
        self.poses >= PLACE_POSES
    }
}
