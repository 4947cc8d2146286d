//! What board, cameras and daemon report: telemetry and status as the board sends them (scaled integers
//! with the unit in the name), the car in the frames of the motion capture, and the daemon's log and
//! configuration, with what it could not record.

use singletrack_mocap::{Binding, CaptureTimeSource, Observation, Pose, PoseState, RejectReason};
use singletrack_protocol::{
    BoardMode, ImuState, RefusalReason, ResetCause, Status, StopCause, Telemetry,
};

use super::{
    Fields, array,
    field::{BindingKind, Code, Group, Maybe, Part, PoseKind, Represents},
    fields, message,
};
use crate::{ConfigurationRecord, Drops, Level, Log, StatusRecord, TelemetryRecord};

message! {
    /// A telemetry record of the board, 100 Hz. Car axes: forward, left, up.
    TelemetryMessage as "Telemetry" of TelemetryRecord {
        /// When its last byte was received, in ns of the host's monotonic clock.
        receive_time_ns: u64,
        /// When the board made it, in ns of the host's monotonic clock.
        board_time_host_ns: u64,
        /// When the IMU took its sample, in ns of the host's monotonic clock.
        imu_time_host_ns: Maybe<u64>,
        telemetry: Group<TelemetryFields>,
    }
}

fields! {
    /// What the board sends in it.
    TelemetryFields of Telemetry {
        /// When the board made it, in us of the board's own clock, wrapping.
        board_time_us: u32,
        /// The safety machine.
        mode: Code<BoardMode>,
        /// Why it last went to neutral.
        stop_cause: Code<StopCause>,
        /// Number of the last drive command that was accepted.
        last_sequence: u8,
        /// Whether the IMU's values are new.
        imu: Code<ImuState>,
        /// Age of the IMU's sample at `board_time_us`, in units of 100 us, saturating.
        imu_age_100us: u8,
        /// Acceleration without gravity along the car's axes, in mm/s^2.
        linear_acceleration_mm_s2: Group<AccelerationFields>,
        /// Angular velocity about the car's axes, in mrad/s. Yaw rate: about up.
        angular_velocity_mrad_s: Group<AngularVelocityFields>,
        /// Attitude: a unit quaternion, scaled by 2^14.
        attitude_q14: Group<AttitudeFields>,
        /// Speed by the motor pulses, signed by the direction driven, in mm/s.
        motor_speed_mm_s: i16,
        /// Servo pulse, in us; zero while the servo is silent.
        servo_us: u16,
        /// ESC pulse, in us.
        esc_us: u16,
    }
}

array! {
    AccelerationFields of [i16; 3] {
        forward_acceleration_mm_s2,
        left_acceleration_mm_s2,
        up_acceleration_mm_s2,
    }
}

array! {
    AngularVelocityFields of [i16; 3] {
        roll_rate_mrad_s,
        pitch_rate_mrad_s,
        yaw_rate_mrad_s,
    }
}

array! {
    AttitudeFields of [i16; 4] {
        attitude_w_q14,
        attitude_x_q14,
        attitude_y_q14,
        attitude_z_q14,
    }
}

message! {
    /// A status record of the board, 5 Hz. Counters wrap.
    StatusMessage as "Status" of StatusRecord {
        /// When its last byte was received, in ns of the host's monotonic clock.
        receive_time_ns: u64,
        status: Group<StatusFields>,
    }
}

fields! {
    /// What the board sends in it.
    StatusFields of Status {
        /// When the board made it, in us of the board's own clock, wrapping.
        board_time_us: u32,
        /// Hash of the configuration in force; zero for none.
        configuration_hash: u32,
        /// Why the board last started.
        reset_cause: Code<ResetCause>,
        /// Whether the stop switch is open, if one is configured.
        stop_input_open: bool,
        /// Battery voltage, in mV.
        battery_mv: u16,
        /// Good frames received.
        frames_received: u16,
        /// Frames refused for CRC, COBS or length.
        frames_damaged: u16,
        /// Drive commands refused.
        drives_refused: u16,
        /// Why the last of them was.
        last_refusal: Code<RefusalReason>,
        /// Frames not sent because the line was full.
        frames_dropped: u16,
        /// Bytes lost by the receiver.
        bytes_overrun: u16,
        /// Errors on the bus to the IMU.
        imu_errors: u16,
        /// The processor's supply, in mV.
        supply_mv: u16,
        /// Whether the battery's input floats.
        battery_open: bool,
        /// Whether the kill output is held.
        power_on: bool,
        /// Milliseconds with more edges of the motor's sensor than the board takes.
        edges_refused: u16,
        /// The BNO055's register `CALIB_STAT`.
        imu_calibration: u8,
        /// The BNO055's register `SYS_STATUS`.
        imu_status: u8,
        /// The BNO055's register `SYS_ERR`.
        imu_error: u8,
        /// The BNO055's register `ST_RESULT`.
        imu_self_test: u8,
    }
}

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
        rejected: Code<Option<RejectReason>>,
        /// What the model definitions say of the car's name, if it has no id.
        binding: Code<Option<BindingKind>>,
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
                    binding: Code(Some(kind)),
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
                rejected: Code(Some(reason)),
                ..of(PoseKind::Rejected)
            },
            PoseState::LockedOut(reason) => Self {
                rejected: Code(Some(reason)),
                ..of(PoseKind::LockedOut)
            },
            PoseState::Stale { silent_ns } => Self {
                silent_ns: Maybe(Some(silent_ns)),
                ..of(PoseKind::Stale)
            },
        }
    }

    fn value(self) -> Result<Observation, String> {
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
                            count: usize::try_from(count).map_err(|error| error.to_string())?,
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

message! {
    /// A line of the log.
    LogMessage as "Log" of Log {
        /// When it was logged, in ns of the host's monotonic clock.
        time_ns: u64,
        /// How much it matters.
        level: Code<Level>,
        /// What it says.
        text: String,
    }
}

message! {
    /// Another configuration is in force.
    ConfigurationMessage as "Configuration" of ConfigurationRecord {
        /// When that was known, in ns of the host's monotonic clock.
        time_ns: u64,
        /// The number that a tick's event names it by; that of the start has 1.
        number: u32,
        /// The whole of it, as TOML.
        toml: String,
    }
}

message! {
    /// Messages that did not reach the record, because the writer was behind.
    DropsMessage as "Drops" of Drops {
        /// When they were counted, in ns of the host's monotonic clock.
        time_ns: u64,
        /// How many since the record began.
        entries: u64,
    }
}
