//! Where the car really is.

use singletrack_control::Position;
use singletrack_pilot::Mode;

use super::{Invariant, Verdict};
use crate::observation::Observation;

/// `fence`: the true centre of mass gets no farther beyond the fence than a car
/// that is told to stop in time rolls on.
///
/// The pilot begins to stop when the way that it needs, along its bend (reaction,
/// `fence.braking_m_s2`, what it may have gone unseen), leaves the fence. The car
/// may need more, by
///
/// - what it rolls farther than that: a motor in neutral does not brake, so that
///   the car slows down by friction alone, 0.8 m/s² and 1/s times its speed; with
///   the default of 1.4 m/s² that is nothing;
/// - the time until the last command is no longer obeyed, 120 ms, if the daemon
///   is silenced just then;
/// - 0.1 m, by which the estimate may be off under all faults that are no lies, and
///   by which a bend that closes or opens meanwhile leads elsewhere.
///
/// While the cameras tell of a car where there is none, and for the rest of a
/// drive that has heard them do so, nobody can know.
#[derive(Default)]
pub(super) struct Fence {
    /// The largest speed of late, m/s; the one of the crossing once outside.
    speed: f64,
    deceived: bool,
    lied_us: u64,
}

/// What the simulated car rolls out with: see `MotorParameters`.
const FRICTION: f64 = 0.8;
const VISCOUS: f64 = 1.0;

const SILENCE_S: f64 = 0.12;
const ESTIMATE_M: f64 = 0.1;

/// The estimate of a car that stands forgets a lie in so long, in µs.
const MEMORY_US: u64 = 3_000_000;

/// How far the car rolls from `speed`: the integral of v dv / (f + k v).
fn rolls_m(speed: f64) -> f64 {
    speed / VISCOUS - FRICTION / (VISCOUS * VISCOUS) * (1.0 + VISCOUS * speed / FRICTION).ln()
}

fn allowed_m(speed: f64, braking: f64) -> f64 {
    let expected = 0.5 * speed * speed / braking;
    (rolls_m(speed) - expected).max(0.0) + SILENCE_S * speed + ESTIMATE_M
}

impl Invariant for Fence {
    fn name(&self) -> &'static str {
        "fence"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        if observation
            .newest_pose
            .is_some_and(|pose| pose.exposure.falsified)
        {
            self.deceived = true;
            self.lied_us = observation.now_us;
        }
        let Some(tick) = observation.tick else {
            return Ok(());
        };
        if tick.output.mode == Mode::Arming && observation.now_us > self.lied_us + MEMORY_US {
            self.deceived = false;
        }
        let truth = &observation.truth;
        let clearance = observation
            .spec
            .fence
            .clearance(&Position::new(truth.x, truth.y));
        if clearance >= 0.0 {
            let slower = self.speed - 2.0 * observation.spec.period_s;
            self.speed = truth.speed.abs().max(slower);
            return Ok(());
        }
        self.speed = self.speed.max(truth.speed.abs());
        let allowed = allowed_m(self.speed, observation.spec.braking);
        if -clearance > allowed && !self.deceived {
            return Err(format!(
                "{:.3} m beyond the fence, {allowed:.3} allowed from {:.2} m/s",
                -clearance, self.speed
            ));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_car_rolls_out_over_the_distance_that_friction_gives() {
        // By small steps.
        let (mut v, mut way, dt) = (1.5, 0.0, 1e-5);
        while v > 0.0 {
            way += v * dt;
            v -= (FRICTION + VISCOUS * v) * dt;
        }
        assert!((rolls_m(1.5) - way).abs() < 1e-3, "{way}");
    }

    #[test]
    fn what_is_allowed_beyond_the_fence_grows_with_speed_from_the_estimates_error() {
        assert_eq!(allowed_m(0.0, 1.4), ESTIMATE_M);
        let allowed = [0.3, 0.5, 1.0, 1.5].map(|speed| allowed_m(speed, 1.4));
        assert!(allowed.is_sorted(), "{allowed:?}");
        assert!(allowed[0] < 0.15 && allowed[3] < 0.3, "{allowed:?}");
        // A car that brakes less than it is said to gets farther.
        assert!(allowed_m(0.5, 2.4) > allowed[1] + 0.02);
    }
}
