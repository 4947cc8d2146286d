//! The true position of the car.

use singletrack_control::Position;
use singletrack_pilot::Mode;

use super::{Invariant, Verdict};
use crate::observation::Observation;

/// `fence`: the true centre of mass goes no farther beyond the geofence than a car
/// that stops in time rolls out.
///
/// The pilot starts a stop when the stopping path along the current bend (reaction
/// time, `fence.braking_m_s2`, time without a pose) leaves the geofence. The car
/// may need more:
///
/// - the excess roll-out: a motor in neutral does not brake, and the car
///   decelerates by friction alone, 0.8 m/s² plus 1/s times its speed; zero with
///   the default of 1.4 m/s²;
/// - the 120 ms for which the last command is obeyed, if the daemon is silenced at
///   that moment;
/// - 0.1 m for the error of the estimate under all faults that do not falsify
///   poses, and for a bend that changes meanwhile.
///
/// While the cameras report false poses, and for the rest of a drive that used one,
/// there is no limit.
#[derive(Default)]
pub(super) struct Fence {
    /// Recent maximum of the speed, in m/s; frozen at the crossing.
    speed: f64,
    deceived: bool,
    last_false_us: u64,
}

/// Roll-out deceleration of the simulated car: see `MotorParameters`.
const FRICTION: f64 = 0.8;
const VISCOUS: f64 = 1.0;

const SILENCE_S: f64 = 0.12;
const ESTIMATE_M: f64 = 0.1;

/// Time in which the estimate of a standing car recovers from a false pose, in µs.
const RECOVERY_US: u64 = 3_000_000;

/// Roll-out distance from `speed`: the integral of v dv / (f + k v).
fn roll_out_m(speed: f64) -> f64 {
    speed / VISCOUS - FRICTION / (VISCOUS * VISCOUS) * (1.0 + VISCOUS * speed / FRICTION).ln()
}

fn allowed_m(speed: f64, braking: f64) -> f64 {
    let expected = 0.5 * speed * speed / braking;
    (roll_out_m(speed) - expected).max(0.0) + SILENCE_S * speed + ESTIMATE_M
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
            self.last_false_us = observation.now_us;
        }
        let Some(tick) = observation.tick else {
            return Ok(());
        };
        if tick.output.mode == Mode::Arming && observation.now_us > self.last_false_us + RECOVERY_US
        {
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
    fn the_roll_out_distance_matches_the_integrated_friction() {
        // Integrated in small steps.
        let (mut v, mut way, dt) = (1.5, 0.0, 1e-5);
        while v > 0.0 {
            way += v * dt;
            v -= (FRICTION + VISCOUS * v) * dt;
        }
        assert!((roll_out_m(1.5) - way).abs() < 1e-3, "{way}");
    }

    #[test]
    fn the_allowance_grows_with_speed_from_the_error_of_the_estimate() {
        assert_eq!(allowed_m(0.0, 1.4), ESTIMATE_M);
        let allowed = [0.3, 0.5, 1.0, 1.5].map(|speed| allowed_m(speed, 1.4));
        assert!(allowed.is_sorted(), "{allowed:?}");
        assert!(allowed[0] < 0.15 && allowed[3] < 0.3, "{allowed:?}");
        // A configured braking that exceeds the real one allows more.
        assert!(allowed_m(0.5, 2.4) > allowed[1] + 0.02);
    }
}
