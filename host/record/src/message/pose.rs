//! The car in the frames of the motion capture.

use singletrack_mocap::{Binding, CaptureTimeSource, Observation, Pose, PoseState, RejectReason};

use super::{
    code::{BindingKind, Code, OptionalCode, PoseKind},
    declare::{Fields, fields, message},
    field::{InvalidMessage, Maybe, Part, Represents},
};

message! {
    /// What one frame of the motion capture says of the car.
    PoseMessage as "Pose" {
        /// Number that the motion capture gave to the frame.
        frame_number: i32,
        /// When it arrived, in ns of the host's monotonic clock.
        receive_time_ns: u64,
        /// What it says.
        state: Code<PoseKind>,
        /// The pose, if it is valid.
        pose: Maybe<PoseValueMessage>,
        /// Why a pose is not believed.
        rejected: OptionalCode<RejectReason>,
        /// What the model definitions say of the car's name, if it has no id.
        binding: OptionalCode<BindingKind>,
        /// The car's streaming id, if it is bound.
        binding_id: Maybe<i32>,
        /// How many bodies have the car's name, if it is ambiguous.
        binding_count: Maybe<u64>,
        /// For how long the stream has been silent, if it is, in ns.
        silent_ns: Maybe<u64>,
    }
}

message! {
    /// A believable pose of the rigid body. World frame: z up.
    PoseValueMessage as "PoseValue" of Pose {
        /// Position of the body's pivot, in m.
        x_m: f64,
        y_m: f64,
        z_m: f64,
        /// Yaw, left positive, from -pi to pi, in rad.
        yaw_rad: f64,
        /// Angle between the body's up axis and the world's, in rad.
        tilt_rad: f64,
        /// Rotation about the body's x axis, its left side up, in rad.
        roll_rad: f64,
        /// Rotation about the body's y axis, its front down, in rad.
        pitch_rad: f64,
        /// Mid-exposure, in ns of the host's monotonic clock.
        capture_time_ns: u64,
        /// Bound on its error, in ns.
        capture_uncertainty_ns: u64,
        /// How it was found.
        capture_source: Code<CaptureTimeSource>,
        /// When the frame arrived, in ns of the host's monotonic clock.
        receive_time_ns: u64,
        /// Number that the motion capture gave to the frame.
        frame_number: i32,
        /// Mean distance of the markers from the model, in m.
        mean_error_m: f64,
        /// Whether it does not continue the pose before.
        reacquired: bool,
    }
}

impl Represents<Observation> for PoseMessage {
    fn of(observation: &Observation) -> Self {
        let of = |kind| Self {
            frame_number: observation.frame_number,
            receive_time_ns: observation.receive_time_ns,
            state: Code(kind),
            ..Fields::absent()
        };
        match observation.state {
            PoseState::NoFrames => of(PoseKind::NoFrames),
            PoseState::Unbound(binding) => {
                let (kind, id, count) = match binding {
                    Binding::Unresolved => (BindingKind::Unresolved, None, None),
                    Binding::Bound { id } => (BindingKind::Bound, Some(id), None),
                    Binding::Missing => (BindingKind::Missing, None, None),
                    Binding::Ambiguous { count } => {
                        (BindingKind::Ambiguous, None, Some(count as u64))
                    }
                };
                Self {
                    binding: OptionalCode(Some(kind)),
                    binding_id: Maybe(id),
                    binding_count: Maybe(count),
                    ..of(PoseKind::Unbound)
                }
            }
            PoseState::Valid(pose) => Self {
                pose: Maybe(Some(Represents::of(&pose))),
                ..of(PoseKind::Valid)
            },
            PoseState::Untracked => of(PoseKind::Untracked),
            PoseState::Absent => of(PoseKind::Absent),
            PoseState::Rejected(reason) => Self {
                rejected: OptionalCode(Some(reason)),
                ..of(PoseKind::Rejected)
            },
            PoseState::LockedOut(reason) => Self {
                rejected: OptionalCode(Some(reason)),
                ..of(PoseKind::LockedOut)
            },
            PoseState::Stale { silent_ns } => Self {
                silent_ns: Maybe(Some(silent_ns)),
                ..of(PoseKind::Stale)
            },
        }
    }

    fn value(self) -> Result<Observation, InvalidMessage> {
        let part = Part("a frame");
        let rejected = || part.take(self.rejected, "why it is rejected");
        let state = match self.state.0 {
            PoseKind::NoFrames => PoseState::NoFrames,
            PoseKind::Unbound => {
                PoseState::Unbound(match part.take(self.binding, "its binding")? {
                    BindingKind::Unresolved => Binding::Unresolved,
                    BindingKind::Bound => Binding::Bound {
                        id: part.take(self.binding_id, "its id")?,
                    },
                    BindingKind::Missing => Binding::Missing,
                    BindingKind::Ambiguous => {
                        let count: u64 = part.take(self.binding_count, "its count")?;
                        Binding::Ambiguous {
                            count: usize::try_from(count)
                                .map_err(|_| InvalidMessage::CountTooLarge(count))?,
                        }
                    }
                })
            }
            PoseKind::Valid => PoseState::Valid(part.take(self.pose, "its pose")?),
            PoseKind::Untracked => PoseState::Untracked,
            PoseKind::Absent => PoseState::Absent,
            PoseKind::Rejected => PoseState::Rejected(rejected()?),
            PoseKind::LockedOut => PoseState::LockedOut(rejected()?),
            PoseKind::Stale => PoseState::Stale {
                silent_ns: part.take(self.silent_ns, "how long it was silent")?,
            },
        };
        Ok(Observation {
            frame_number: self.frame_number,
            receive_time_ns: self.receive_time_ns,
            state,
        })
    }
}
