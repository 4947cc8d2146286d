//! What a frame says of the body.

use super::{Observation, Outcome, RestartReason, Session};
use crate::binding::Binding;
use crate::clock::{Capture, CaptureClock};
use crate::codec::{Frame, FrameFlags};
use crate::gate::Verdict;
use crate::order::Order;
use crate::pose::{Pose, PoseState, RejectReason};

/// While "models changed" stays set, the definitions are read this often.
const MODELS_CHANGED_NS: u64 = 1_000_000_000;

impl Session {
    pub(super) fn handle_frame(&mut self, now_ns: u64, frame: &Frame<'_>) -> Outcome {
        match self
            .sequence
            .place(frame.number, CaptureClock::order_key(frame))
        {
            Order::Newest { lost } => self.counters.lost += lost,
            Order::Renumbered => self.counters.renumbered += 1,
            Order::Duplicate => {
                self.counters.duplicates += 1;
                return Outcome::Duplicate;
            }
            Order::Late => {
                self.counters.late += 1;
                return Outcome::Late;
            }
            Order::Restarted => {
                self.counters.late += 1;
                self.restart(now_ns, RestartReason::FramesBackward);
                return Outcome::Late;
            }
        }
        self.counters.frames += 1;
        self.last_frame_ns = Some(now_ns);
        self.stale = false;
        self.watch_models(now_ns, frame);
        let capture = self.capture(frame, now_ns);
        self.state = self.observe(frame, now_ns, capture);
        Outcome::Frame(Observation {
            frame_number: frame.number,
            receive_time_ns: now_ns,
            state: self.state,
        })
    }

    /// When the models change, an id may name another body from this frame on:
    /// no pose is taken until the definitions have been read again.
    fn watch_models(&mut self, now_ns: u64, frame: &Frame<'_>) {
        let changed = frame.flags.contains(FrameFlags::MODELS_CHANGED);
        if changed && !self.models_changed {
            self.set_binding(Binding::Unresolved);
            self.schedule.models_by(now_ns);
        } else if changed {
            self.schedule
                .models_by(now_ns.saturating_add(MODELS_CHANGED_NS));
        }
        self.models_changed = changed;
    }

    /// When the frame was captured: never after it arrived.
    fn capture(&mut self, frame: &Frame<'_>, now_ns: u64) -> Option<Capture> {
        let mut capture = self.clock.capture(frame, now_ns)?;
        if capture.time_ns > now_ns {
            if capture.time_ns - now_ns > capture.uncertainty_ns {
                return None;
            }
            self.counters.capture_clamped += 1;
            capture.time_ns = now_ns;
        }
        Some(capture)
    }

    fn observe(&mut self, frame: &Frame<'_>, now_ns: u64, capture: Option<Capture>) -> PoseState {
        let Binding::Bound { id } = self.binding else {
            self.counters.unbound += 1;
            return PoseState::Unbound(self.binding);
        };
        let mut bodies = frame.rigid_bodies().filter(|body| body.id == id);
        let Some(body) = bodies.next() else {
            self.counters.absent += 1;
            return PoseState::Absent;
        };
        let candidate = if bodies.next().is_some() {
            Err(RejectReason::DuplicateId)
        } else if !body.tracking_valid() {
            self.counters.untracked += 1;
            return PoseState::Untracked;
        } else {
            capture
                .ok_or(RejectReason::CaptureTime)
                .and_then(|capture| {
                    Pose::from_body(
                        &body,
                        self.config.up_axis,
                        &self.config.limits,
                        frame.number,
                        now_ns,
                        capture,
                    )
                })
        };
        match self.gate.judge(candidate) {
            Verdict::Valid(pose) => {
                self.counters.valid += 1;
                PoseState::Valid(pose)
            }
            Verdict::Rejected(reason) => {
                self.counters.rejected.count(reason);
                PoseState::Rejected(reason)
            }
            Verdict::LockedOut(reason) => {
                self.counters.rejected.count(reason);
                self.counters.locked_out += 1;
                PoseState::LockedOut(reason)
            }
        }
    }
}
