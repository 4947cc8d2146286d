//! The true position of the car, and what the safety filter promises.

use std::collections::VecDeque;

use singletrack_control::Position;
use singletrack_pilot::Mode;

use super::{Invariant, Verdict};
use crate::{observation::Observation, schedule::FaultKind};

/// `fence`: the true centre of mass goes no farther beyond the geofence than the pilot's
/// estimate is wrong.
///
/// The pilot starts a stop when the stopping path along the current bend (reaction time,
/// `fence.braking_m_s2`, time without a pose) leaves the geofence. The car may need more:
///
/// - 120 ms for which the last command is obeyed, if the daemon is silenced at that moment;
///   with a dead board, also the time for which the ESC has held its last pulse; and what
///   the ESC takes longer than the 0.1 s of reaction to release its motor;
/// - the largest error of the pilot's estimate of the position in the last second in which
///   it commanded the drive; what the pilot believes after the decision to stop drives
///   nothing. Lies of the cameras appear here and nowhere else: the car is judged while they
///   last and after them, and `estimate` bounds how long they may be believed;
/// - 0.1 m for a bend that changes meanwhile.
///
/// A car whose motor is free and that brakes less than configured may roll farther, see
/// `stands`. A car that was armed outside, or that somebody pushed there, is not judged
/// until it is inside again; nor is one that runs at neutral without a drive (`unarmed-motion`), or
/// is jogged.
pub(super) struct Fence {
    /// Recent maximum of the speed, in m/s; frozen at the crossing.
    speed: f64,
    /// The errors of the estimate in the last ticks that followed the reference, in m.
    errors: VecDeque<f64>,
    excused: bool,
}

impl Default for Fence {
    /// The car may have been put down outside.
    fn default() -> Self {
        Self {
            speed: 0.0,
            errors: VecDeque::new(),
            excused: true,
        }
    }
}

const SILENCE_S: f64 = 0.12;
const BEND_M: f64 = 0.1;
const REACTION_S: f64 = 0.1;
/// Time in which a pilot whose estimate becomes right again finds that the car is outside,
/// in s.
const RECENT_S: f64 = 1.0;

impl Invariant for Fence {
    fn name(&self) -> &'static str {
        "fence"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        let truth = &observation.truth;
        let position = Position::new(truth.x, truth.y);
        let clearance = observation.spec.fence.clearance(&position);
        if let Some(tick) = observation.tick {
            if tick.output.mode == Mode::Arming {
                self.errors.clear();
                self.speed = 0.0;
                self.excused = clearance < 0.0;
            }
            if matches!(tick.output.mode, Mode::Driving | Mode::Slowing)
                && let Some(estimate) = &tick.output.estimate
            {
                let recent = (RECENT_S / observation.spec.period_s) as usize;
                while self.errors.len() >= recent.max(1) {
                    self.errors.pop_front();
                }
                self.errors.push_back((estimate.position - position).norm());
            }
            if clearance >= 0.0 {
                let slower = self.speed - 2.0 * observation.spec.period_s;
                self.speed = truth.speed.abs().max(slower);
            }
        }
        if clearance >= 0.0 {
            self.excused = false;
            return Ok(());
        }
        self.speed = self.speed.max(truth.speed.abs());
        let stop = observation.stop;
        // Somebody pushes it, or it runs at neutral without a drive: see `unarmed-motion`.
        let stopping = stop.is_some_and(|stop| !stop.stood);
        let unarmed = !observation.board_is_armed && !stopping;
        self.excused |= observation.is_moved_by_hand() || observation.jogs || unarmed;
        let held_s = stop.map_or(0.0, |stop| stop.held_us as f64 * 1e-6);
        let error = self.errors.iter().copied().fold(0.0, f64::max);
        let release_s = observation.spec.true_release_us as f64 * 1e-6;
        let late_s = (release_s - REACTION_S).max(0.0);
        let allowed = (SILENCE_S + held_s + late_s) * self.speed + error + BEND_M;
        if -clearance <= allowed || self.excused {
            return Ok(());
        }
        if stop.is_some_and(|stop| stop.is_weak(observation.spec)) {
            return Ok(());
        }
        let stuck = observation.is_active(FaultKind::EscStuck);
        if stuck && !observation.spec.situation.kill_output {
            // Nothing stops it.
            self.excused = true;
            return Ok(());
        }
        Err(format!(
            "{:.3} m beyond the fence, {allowed:.3} allowed from {:.2} m/s with an estimate {:.3} m off",
            -clearance, self.speed, error
        ))
    }
}

/// `estimate`: while the car drives, the error of the estimated position does not grow by
/// more than the configured blind distance and 0.15 m for longer than the configured blind
/// time and 0.4 s: a lie of the cameras is found or makes no difference.
///
/// A lie from before the drive can't be found until it ends, so that only the growth since
/// the car was armed counts; a pause in [`Mode::Slowing`] is not a new drive. A pivot that is
/// wrong on the body turns with the car, and does not grow: the error is seen from the world and
/// from the car, and the lesser growth counts.
#[derive(Default)]
pub(super) struct EstimateError {
    /// The error at the arming, as seen from the world and from the car.
    offset: Option<[[f64; 2]; 2]>,
    since_us: Option<u64>,
}

impl EstimateError {
    /// How far the error has grown since the arming, with the car at this yaw.
    fn grown(&mut self, error: [f64; 2], yaw: f64) -> f64 {
        let [x, y] = error;
        let (sin, cos) = libm::sincos(yaw);
        let errors = [error, [cos * x + sin * y, cos * y - sin * x]];
        let [world, car] = *self.offset.get_or_insert(errors);
        let growth = |[x, y]: [f64; 2], [was_x, was_y]: [f64; 2]| libm::hypot(x - was_x, y - was_y);
        growth(errors[0], world).min(growth(errors[1], car))
    }
}

const WRONG_M: f64 = 0.15;
const FOUND_US: u64 = 400_000;

impl Invariant for EstimateError {
    fn name(&self) -> &'static str {
        "estimate"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        let Some(tick) = observation.tick else {
            return Ok(());
        };
        if tick.output.mode == Mode::Arming {
            self.offset = None;
        }
        let (Some(estimate), Mode::Driving | Mode::Slowing) =
            (&tick.output.estimate, tick.output.mode)
        else {
            self.since_us = None;
            return Ok(());
        };
        let truth = &observation.truth;
        let error = [estimate.position.x - truth.x, estimate.position.y - truth.y];
        let grown = self.grown(error, truth.yaw);
        let spec = observation.spec;
        if grown <= spec.blind_m + WRONG_M {
            self.since_us = None;
            return Ok(());
        }
        let since_us = *self.since_us.get_or_insert(observation.now_us);
        let limit_us = spec.blind_us + FOUND_US;
        let after_us = observation.now_us - since_us;
        if after_us <= limit_us {
            return Ok(());
        }
        Err(format!(
            "driving for {} ms on an estimate {grown:.2} m off, {} allowed",
            after_us / 1_000,
            limit_us / 1_000
        ))
    }
}

/// `filter`: with the safety filter on, the true centre of mass never leaves the geofence,
/// whatever the outer loop wants. Nothing is allowed beyond it: no silence of the host, no bend,
/// no error of the estimate.
///
/// The claim rests on assumptions: a car that is calibrated, brakes as configured and is not
/// pushed; cameras, line, board and host without a fault, which `fence` judges with its
/// allowance. Hostile, silent and mistaken programs break none of them. A car that was armed
/// outside is not judged until it is inside.
pub(super) struct Filter {
    excused: bool,
    /// Whether a fault has broken an assumption.
    broken: bool,
}

impl Default for Filter {
    /// The car may have been put down outside.
    fn default() -> Self {
        Self {
            excused: true,
            broken: false,
        }
    }
}

impl Invariant for Filter {
    fn name(&self) -> &'static str {
        "filter"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        let Observation {
            spec,
            truth,
            faults,
            new_faults,
            ..
        } = observation;
        let mut faults = faults.iter().chain(*new_faults);
        self.broken |= faults.any(|fault| !fault.kind.changes_setpoints());
        if !spec.situation.safety_filter || !spec.is_tolerable || self.broken {
            return Ok(());
        }
        let clearance = spec.fence.clearance(&Position::new(truth.x, truth.y));
        let mode = observation.tick.map(|tick| tick.output.mode);
        if mode == Some(Mode::Arming) {
            self.excused = clearance < 0.0;
        }
        // No geofence holds an operator who jogs.
        self.excused |= observation.jogs;
        self.excused &= clearance < 0.0;
        if clearance >= 0.0 || self.excused {
            return Ok(());
        }
        Err(format!(
            "{:.3} m beyond the geofence at {:.2} m/s with the safety filter on",
            -clearance, truth.speed
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observation::scene::Scene;

    #[test]
    fn the_allowance_is_the_silence_of_the_host_and_a_changing_bend() {
        let mut scene = Scene::new();
        let side = 2.0 + 0.8;
        let judge = |scene: &Scene| {
            let mut fence = Fence {
                excused: false,
                ..Fence::default()
            };
            fence.check(&scene.observation(0))
        };
        scene.truth.speed = 1.0;
        scene.truth.x = side + 0.21;
        assert_eq!(judge(&scene), Ok(()));
        scene.truth.x = side + 0.23;
        let found = judge(&scene);
        assert!(found.is_err_and(|details| details.starts_with("0.230 m beyond the fence, 0.220")));
    }

    /// The growth for a car that turns half round, and of which the estimate is off by an offset of
    /// the pivot to the left and by a lie that begins, in m.
    fn grown(pivot: f64, lie: f64) -> f64 {
        let mut invariant = EstimateError::default();
        invariant.grown([0.0, pivot], 0.0);
        invariant.grown([lie, -pivot], core::f64::consts::PI)
    }

    #[test]
    fn a_pivot_turns_with_the_car_and_a_lie_grows() {
        assert!(grown(0.5, 0.0) < 1e-12);
        assert!((grown(0.0, 0.7) - 0.7).abs() < 1e-12);
        assert!((grown(0.5, 0.7) - 0.7).abs() < 1e-12);
    }
}
