//! Whether a pose can follow the last accepted one.

use core::f64::consts::{PI, TAU};

use super::{
    config::PoseLimits,
    observation::{PlanarPose, PoseState, RejectReason},
};

/// The plausibility check of a [`PlanarTracker`](super::PlanarTracker), which is also for poses
/// that were recorded without one.
#[derive(Clone, Debug)]
pub struct PoseGate {
    limits: PoseLimits,
    last_valid: Option<PlanarPose>,
    last_implausible: Option<PlanarPose>,
    rejects: u32,
    /// Implausible poses in a row that follow each other, since the lock-out.
    consistent: u32,
}

impl PoseGate {
    /// A gate that has seen no pose.
    #[must_use]
    pub const fn new(limits: PoseLimits) -> Self {
        Self {
            limits,
            last_valid: None,
            last_implausible: None,
            rejects: 0,
            consistent: 0,
        }
    }

    /// Whether the pose can follow the ones before it.
    pub fn judge(&mut self, pose: PlanarPose) -> PoseState {
        self.judge_candidate(Ok(pose))
    }

    /// Position of the last accepted pose, m.
    pub(super) fn place_m(&self) -> Option<[f64; 3]> {
        self.last_valid.map(|pose| [pose.x_m, pose.y_m, pose.z_m])
    }

    pub(super) fn judge_candidate(
        &mut self,
        candidate: Result<PlanarPose, RejectReason>,
    ) -> PoseState {
        let pose = match candidate {
            Ok(pose) => pose,
            Err(reason) => {
                self.last_implausible = None;
                self.consistent = 0;
                return self.reject(reason);
            }
        };
        let Some(last_valid) = self.last_valid else {
            return self.accept(pose, true);
        };
        match self.follows(&last_valid, &pose) {
            Ok(()) => self.accept(pose, self.is_locked_out()),
            Err(reason) => {
                let consistent = self
                    .last_implausible
                    .is_some_and(|last| self.follows(&last, &pose).is_ok());
                if !(consistent && self.is_locked_out()) {
                    self.consistent = 0;
                } else {
                    self.consistent += 1;
                    if self.consistent >= self.limits.max_consecutive_rejects {
                        return self.accept(pose, true);
                    }
                }
                self.last_implausible = Some(pose);
                self.reject(reason)
            }
        }
    }

    const fn is_locked_out(&self) -> bool {
        self.rejects >= self.limits.max_consecutive_rejects
    }

    fn accept(&mut self, mut pose: PlanarPose, reacquired: bool) -> PoseState {
        pose.reacquired = reacquired;
        self.last_valid = Some(pose);
        self.last_implausible = None;
        self.rejects = 0;
        self.consistent = 0;
        PoseState::Valid(pose)
    }

    const fn reject(&mut self, reason: RejectReason) -> PoseState {
        self.rejects = self.rejects.saturating_add(1);
        if self.is_locked_out() {
            PoseState::LockedOut(reason)
        } else {
            PoseState::Rejected(reason)
        }
    }

    /// Whether a body that was at `from` can be at `to`.
    fn follows(&self, from: &PlanarPose, to: &PlanarPose) -> Result<(), RejectReason> {
        // Accepting an old capture time would make the next pose plausible wherever it
        // is: the body would have had a long time to get there.
        let backward_ns = from.capture_time_ns.saturating_sub(to.capture_time_ns);
        let uncertainty_ns = from
            .capture_uncertainty_ns
            .saturating_add(to.capture_uncertainty_ns);
        if backward_ns > uncertainty_ns {
            return Err(RejectReason::CaptureTime);
        }
        let elapsed_ns = to.capture_time_ns.saturating_sub(from.capture_time_ns);
        let elapsed_s = elapsed_ns as f64 * 1e-9;
        let [dx, dy, dz] = [to.x_m - from.x_m, to.y_m - from.y_m, to.z_m - from.z_m];
        let distance_m = libm::sqrt(dx * dx + dy * dy + dz * dz);
        let limits = &self.limits;
        if distance_m > limits.jump_margin_m + limits.max_speed_m_s * elapsed_s {
            return Err(RejectReason::Jump);
        }
        let turned_rad = libm::fabs(wrap_to_pi(to.yaw_rad - from.yaw_rad));
        if turned_rad > limits.yaw_margin_rad + limits.max_yaw_rate_rad_s * elapsed_s {
            return Err(RejectReason::Flip);
        }
        Ok(())
    }
}

/// The same angle in -pi to pi.
fn wrap_to_pi(angle_rad: f64) -> f64 {
    angle_rad - TAU * libm::floor((angle_rad + PI) / TAU)
}
