//! What the motion capture said of the car, frame by frame.

use singletrack_mocap::{Binding, CaptureTimeSource, Observation, Pose, PoseState, RejectReason};

use super::{
    Senseless,
    code::{BindingKind, Code, OptionalCode, PoseKind},
    field::Maybe,
    message,
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
    PoseValueMessage as "PoseValue" {
        /// Position of the body's pivot, in m.
        x_m: f64,
        y_m: f64,
        z_m: f64,
        /// Yaw, left positive, from -pi to pi, in rad.
        yaw_rad: f64,
        /// Angle between the body's up axis and the world's, in rad.
        tilt_rad: f64,
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

impl From<&Observation> for PoseMessage {
    fn from(observation: &Observation) -> Self {
        let mut message = Self {
            frame_number: observation.frame_number,
            receive_time_ns: observation.receive_time_ns,
            state: Code(PoseKind::NoFrames),
            pose: Maybe(None),
            rejected: OptionalCode(None),
            binding: OptionalCode(None),
            binding_id: Maybe(None),
            binding_count: Maybe(None),
            silent_ns: Maybe(None),
        };
        message.state = Code(match observation.state {
            PoseState::NoFrames => PoseKind::NoFrames,
            PoseState::Unbound(binding) => {
                message.binding = OptionalCode(Some(match binding {
                    Binding::Unresolved => BindingKind::Unresolved,
                    Binding::Bound { id } => {
                        message.binding_id = Maybe(Some(id));
                        BindingKind::Bound
                    }
                    Binding::Missing => BindingKind::Missing,
                    Binding::Ambiguous { count } => {
                        message.binding_count = Maybe(Some(count as u64));
                        BindingKind::Ambiguous
                    }
                }));
                PoseKind::Unbound
            }
            PoseState::Valid(pose) => {
                message.pose = Maybe(Some(pose.into()));
                PoseKind::Valid
            }
            PoseState::Untracked => PoseKind::Untracked,
            PoseState::Absent => PoseKind::Absent,
            PoseState::Rejected(reason) => {
                message.rejected = OptionalCode(Some(reason));
                PoseKind::Rejected
            }
            PoseState::LockedOut(reason) => {
                message.rejected = OptionalCode(Some(reason));
                PoseKind::LockedOut
            }
            PoseState::Stale { silent_ns } => {
                message.silent_ns = Maybe(Some(silent_ns));
                PoseKind::Stale
            }
        });
        message
    }
}

impl TryFrom<PoseMessage> for Observation {
    type Error = Senseless;

    fn try_from(message: PoseMessage) -> Result<Self, Senseless> {
        let missing = |part| Senseless::PartMissing {
            kind: "a frame",
            part,
        };
        let rejected = || {
            message
                .rejected
                .0
                .ok_or_else(|| missing("why it is rejected"))
        };
        let binding = || {
            Ok(
                match message.binding.0.ok_or_else(|| missing("its binding"))? {
                    BindingKind::Unresolved => Binding::Unresolved,
                    BindingKind::Bound => Binding::Bound {
                        id: message.binding_id.0.ok_or_else(|| missing("its id"))?,
                    },
                    BindingKind::Missing => Binding::Missing,
                    BindingKind::Ambiguous => {
                        let count = message
                            .binding_count
                            .0
                            .ok_or_else(|| missing("its count"))?;
                        Binding::Ambiguous {
                            count: usize::try_from(count)
                                .map_err(|_| Senseless::CountTooLarge(count))?,
                        }
                    }
                },
            )
        };
        let state = match message.state.0 {
            PoseKind::NoFrames => PoseState::NoFrames,
            PoseKind::Unbound => PoseState::Unbound(binding()?),
            PoseKind::Valid => PoseState::Valid(
                message
                    .pose
                    .0
                    .clone()
                    .ok_or_else(|| missing("its pose"))?
                    .into(),
            ),
            PoseKind::Untracked => PoseState::Untracked,
            PoseKind::Absent => PoseState::Absent,
            PoseKind::Rejected => PoseState::Rejected(rejected()?),
            PoseKind::LockedOut => PoseState::LockedOut(rejected()?),
            PoseKind::Stale => PoseState::Stale {
                silent_ns: message
                    .silent_ns
                    .0
                    .ok_or_else(|| missing("how long it was silent"))?,
            },
        };
        Ok(Self {
            frame_number: message.frame_number,
            receive_time_ns: message.receive_time_ns,
            state,
        })
    }
}

impl From<Pose> for PoseValueMessage {
    fn from(pose: Pose) -> Self {
        Self {
            x_m: pose.x_m,
            y_m: pose.y_m,
            z_m: pose.z_m,
            yaw_rad: pose.yaw_rad,
            tilt_rad: pose.tilt_rad,
            capture_time_ns: pose.capture_time_ns,
            capture_uncertainty_ns: pose.capture_uncertainty_ns,
            capture_source: Code(pose.capture_source),
            receive_time_ns: pose.receive_time_ns,
            frame_number: pose.frame_number,
            mean_error_m: pose.mean_error_m,
            reacquired: pose.reacquired,
        }
    }
}

impl From<PoseValueMessage> for Pose {
    fn from(message: PoseValueMessage) -> Self {
        Self {
            x_m: message.x_m,
            y_m: message.y_m,
            z_m: message.z_m,
            yaw_rad: message.yaw_rad,
            tilt_rad: message.tilt_rad,
            capture_time_ns: message.capture_time_ns,
            capture_uncertainty_ns: message.capture_uncertainty_ns,
            capture_source: message.capture_source.0,
            receive_time_ns: message.receive_time_ns,
            frame_number: message.frame_number,
            mean_error_m: message.mean_error_m,
            reacquired: message.reacquired,
        }
    }
}
