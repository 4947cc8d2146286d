//! A control tick and all that the pilot decided in it.

use singletrack_control::{Actuation, Estimate, ReferencePoint, SlowedBy};
use singletrack_pilot::{
    BoardRequest, DriveCommand, Filtering, Mode, Output, Reason, SetpointRefusal, Tuned,
};

use super::{
    InvalidMessage,
    code::{Code, OptionalCode},
    declare::{fields, message},
    event::{EventMessage, JogMessage, StampMessage},
    field::{GainMessage, Group, Maybe, PointMessage, Represents, VelocityMessage},
};
use crate::{DriveWrite, LinkPhase, TickRecord};

message! {
    /// A control tick: what it was given, what it decided, and when. Times are ns
    /// of the host's monotonic clock. World frame: z up; angles left positive.
    TickMessage as "Tick" of TickRecord {
        /// Counts the ticks of the daemon, from 0.
        index: u64,
        /// When it was due: at its point of the grid, or a little sooner, when a frame arrived.
        scheduled_ns: u64,
        /// When the thread woke up for it.
        start_ns: u64,
        /// When its command was decided and handed to the line.
        finish_ns: u64,
        /// `start_ns` - `scheduled_ns`.
        lateness_ns: i64 => TickRecord::lateness_ns,
        /// Points of the grid skipped just before it: the tick before took too long.
        skipped: u32,
        /// The moment that the pilot was told.
        pilot_time_ns: u64 = pilot_time,
        output: Group<OutputFields>,
        /// What became of the command.
        drive: Maybe<DriveWriteMessage>,
        /// From the mid-exposure of the newest accepted pose to the command leaving,
        /// in ns. The pose is an old one in a held tick.
        capture_to_command_ns: Maybe<i64> => TickRecord::capture_to_command_ns,
        /// The session with the board.
        link: Code<LinkPhase>,
        /// Events that did not fit: the pilot never saw them.
        events_dropped: u32,
        /// What the pilot was told, in order.
        events: Vec<EventMessage>,
    }
}

fields! {
    /// What the pilot decided.
    OutputFields of Output {
        /// The pilot's mode after the tick.
        mode: Code<Mode>,
        /// Why the car does not drive, or stopped.
        reason: OptionalCode<Reason>,
        /// Whether no new valid pose came since the tick before.
        held: bool,
        /// Whether the car is turning round.
        turning_round: bool,
        /// How far ahead the state was predicted to which the command belongs, in s.
        looked_ahead_s: Maybe<f64> = looked_ahead,
        /// Time since the first driving tick, in s.
        drive_time_s: Maybe<f64> = drive_time,
        /// The state that the pilot acted on.
        estimate: Maybe<EstimateMessage>,
        /// Where P should be and how fast it should move.
        reference: Maybe<ReferenceMessage>,
        /// Where P is, as far as the law knows.
        point: Maybe<PointMessage>,
        /// The velocity wanted of P.
        point_velocity: Maybe<VelocityMessage>,
        /// Speed of G and steering after limits.
        actuation: ActuationMessage,
        /// What to send to the board.
        command: Maybe<CommandMessage>,
        /// What to ask of the board.
        request: OptionalCode<BoardRequest>,
        /// Whether the first metre of an unproved configuration has just passed.
        proved: bool,
        /// Whether a proved configuration has just been contradicted.
        disproved: bool,
        /// Deceleration of the stop that has just ended, in m/s^2.
        braking_measured_m_s2: Maybe<f64> = braking_measured,
        /// Why the car could not be armed in this tick.
        preflight: PreflightMessage,
        /// Bare pulses to send to the board.
        jog: Maybe<JogMessage>,
        /// The newest set-point from outside that was not refused.
        setpoint: Maybe<StampMessage>,
        /// Why a set-point that came in this tick is not obeyed; of several the newest.
        setpoint_refused: OptionalCode<SetpointRefusal>,
        /// What the safety filter did.
        filtering: Code<Filtering>,
        /// The number of ticks of the drive, or of the last one, in which it did anything.
        filtered_ticks: u32,
        /// The path parameter of the reference, in s: the time of the drive, unless a governor
        /// has slowed the reference down.
        path_s: Maybe<f64> = path,
        /// Why the reference is slowed down.
        slowed_by: OptionalCode<SlowedBy>,
        /// The values in force of what can be tuned; absent if nothing can.
        tuned: Maybe<TunedMessage>,
    }
}

message! {
    /// The values in force of what can be tuned.
    TunedMessage as "Tuned" of Tuned {
        /// Of the position loop; absent if it has no such gains.
        gain: Maybe<GainMessage>,
        /// The distance p that the law uses, in m.
        point_distance_m: f64 = point_distance,
        /// Where p goes to, in m.
        wanted_point_distance_m: f64 = wanted_point_distance,
    }
}

message! {
    /// The arming check of a tick.
    PreflightMessage as "Preflight" {
        /// Why an arm request would be refused; none if it would not, or while a drive
        /// is underway.
        reason: OptionalCode<Reason>,
    }
}

impl Represents<Option<Reason>> for PreflightMessage {
    fn of(reason: &Option<Reason>) -> Self {
        Self {
            reason: OptionalCode(*reason),
        }
    }

    fn value(self) -> Result<Option<Reason>, InvalidMessage> {
        Ok(self.reason.0)
    }
}

message! {
    /// The state of the car as estimated.
    EstimateMessage as "Estimate" of Estimate {
        /// The moment that it is for, in ns of the host's monotonic clock.
        time_ns: u64 = time,
        /// Position of the centre of mass G, world frame, in m.
        position: Group<PointMessage>,
        /// Yaw, not wrapped, in rad.
        yaw_rad: f64 = yaw,
        yaw_rate_rad_s: f64 = yaw_rate,
        sideslip_rad: f64 = sideslip,
        /// Speed of G, negative in reverse, in m/s.
        speed_m_s: f64 = speed,
        /// Mid-exposure of the last accepted pose, in ns of the host's monotonic clock.
        pose_time_ns: u64 = pose_time,
    }
}

message! {
    /// One moment of the reference for P.
    ReferenceMessage as "Reference" of ReferencePoint {
        /// Absent for a reference that is a velocity alone.
        position: Maybe<PointMessage>,
        velocity: VelocityMessage,
    }
}

message! {
    /// Speed and steering for the car.
    ActuationMessage as "Actuation" of Actuation {
        /// Speed of G, in m/s.
        speed_m_s: f64 = speed,
        /// Steering angle, in rad.
        steering_rad: f64 = steering,
        /// Rate at which it got there, in rad/s.
        steering_rate_rad_s: f64 = steering_rate,
    }
}

message! {
    /// What the board is to do until the next tick.
    CommandMessage as "Command" of DriveCommand {
        /// Speed of the rear axle, in m/s.
        rear_speed_m_s: f64 = rear_speed,
        /// Steering angle, in rad.
        steering_rad: f64 = steering,
        /// Mid-exposure of the last accepted pose behind it, in ns of the host's
        /// monotonic clock.
        pose_time_ns: u64 = pose_time,
        /// Whether the ESC should brake down to the speed, where it can.
        brake: bool,
    }
}

message! {
    /// A drive command on its way to the board.
    DriveWriteMessage as "DriveWrite" of DriveWrite {
        /// Its number on the wire, wrapping.
        sequence: u8,
        /// Whether the whole frame was written; otherwise no byte of it was.
        written: bool,
        /// When that was known, in ns of the host's monotonic clock.
        time_ns: u64,
    }
}
