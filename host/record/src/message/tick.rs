//! A control tick and all that the pilot decided in it.

use singletrack_control::{Actuation, Covariance, Estimate, ReferencePoint, SlowedBy};
use singletrack_pilot::{
    BoardRequest, DriveCommand, Filtering, Mode, Output, Reason, SetpointRefusal, Tuned,
};

use super::{
    array,
    event::{EventMessage, JogMessage, StampMessage},
    field::{Code, GainMessage, Group, Maybe, PointMessage, VelocityMessage},
    fields, message,
};
use crate::{DriveWrite, LinkPhase, TickRecord};

message! {
    /// A control tick: its inputs, its decisions and its times. Times are ns of the
    /// host's monotonic clock. World frame: z up; angles left positive.
    TickMessage as "Tick" of TickRecord {
        /// Number of the tick, from 0 at the start of the daemon.
        tick: u64 = index,
        /// Time when the tick was due: its point of the grid, or the arrival of a frame a little
        /// sooner.
        scheduled_ns: u64,
        /// Time when the thread woke up.
        start_ns: u64,
        /// Time when the command was decided and handed to the line.
        finish_ns: u64,
        /// `start_ns` - `scheduled_ns`.
        lateness_ns: i64 => TickRecord::lateness_ns,
        /// Points of the grid skipped just before: the tick before took too long.
        skipped: u32,
        /// Time of the tick as the pilot was given it.
        time_ns: u64 = pilot_time,
        output: Group<OutputFields>,
        /// Transmission of the command.
        drive: Maybe<DriveWriteMessage>,
        /// Time from the mid-exposure of the newest accepted pose to the command leaving,
        /// in ns. The pose is an old one in a held tick.
        capture_to_command_ns: Maybe<i64> => TickRecord::capture_to_command_ns,
        /// Phase of the session with the board.
        link: Code<LinkPhase>,
        /// Number of events that did not fit: the pilot never saw them.
        events_dropped: u32,
        /// Events that the pilot was given, in order.
        events: Vec<EventMessage>,
    }
}

fields! {
    /// Decisions of the pilot.
    OutputFields of Output {
        /// Mode of the pilot after the tick.
        mode: Code<Mode>,
        /// Reason why the car does not drive, or stopped.
        reason: Code<Option<Reason>>,
        /// Whether no pose was accepted since the last tick.
        held: bool,
        /// Whether the car is turning round.
        turning_round: bool,
        /// Time by which the state was predicted for the command, in s.
        looked_ahead_s: Maybe<f64> = looked_ahead,
        /// Time since the first driving tick, in s.
        drive_time_s: Maybe<f64> = drive_time,
        /// Estimated state that the pilot acted on.
        estimate: Maybe<EstimateMessage>,
        /// Wanted position and velocity of P.
        reference: Maybe<ReferenceMessage>,
        /// Position of P, by the estimate and the commanded steering.
        point: Maybe<PointMessage>,
        /// Commanded velocity of P, after the position loop.
        point_velocity: Maybe<VelocityMessage>,
        /// Speed of G and steering after the limits.
        actuation: ActuationMessage,
        /// Drive command for the board.
        command: Maybe<CommandMessage>,
        /// Request to the board.
        request: Code<Option<BoardRequest>>,
        /// Whether the first metre of an unproved configuration has just passed.
        proved: bool,
        /// Whether a proved configuration has just been contradicted.
        disproved: bool,
        /// Deceleration of the stop that has just ended, in m/s^2.
        braking_measured_m_s2: Maybe<f64> = braking_measured,
        /// Reason why an arm request would be refused; none if it would not, or while a drive
        /// is underway.
        preflight: Code<Option<Reason>>,
        /// Bare pulses for the board.
        jog: Maybe<JogMessage>,
        /// Newest set-point from outside that was not refused.
        setpoint: Maybe<StampMessage>,
        /// Reason why a set-point that came in this tick is not obeyed; of several the newest.
        setpoint_refused: Code<Option<SetpointRefusal>>,
        /// Action of the safety filter.
        filtering: Code<Filtering>,
        /// Number of ticks of this or the last drive in which the safety filter acted.
        filtered_ticks: u32,
        /// Path parameter of the reference, in s: the time of the drive, unless a governor
        /// has slowed the reference down.
        path_s: Maybe<f64> = path,
        /// Reason why the reference is slowed down.
        slowed_by: Code<Option<SlowedBy>>,
        /// Tuned values in force; absent if nothing can be tuned.
        tuned: Maybe<TunedMessage>,
        /// Covariances of the estimate.
        covariance: Maybe<CovarianceMessage>,
    }
}

message! {
    /// Tuned values in force.
    TunedMessage as "Tuned" of Tuned {
        /// Gains of the position loop; absent for a loop without.
        gain: Maybe<GainMessage>,
        /// Distance p of P from the front axle, in m.
        point_distance_m: f64 = point_distance,
        /// Distance that p goes to, in m.
        wanted_point_distance_m: f64 = wanted_point_distance,
    }
}

message! {
    /// Estimated state of the car.
    EstimateMessage as "Estimate" of Estimate {
        /// Time of the state, in ns of the host's monotonic clock.
        time_ns: u64 = time,
        /// Position of the centre of mass G, world frame, in m.
        position: Group<PointMessage>,
        /// Yaw, not wrapped, in rad.
        yaw_rad: f64 = yaw,
        /// Yaw rate, in rad/s.
        yaw_rate_rad_s: f64 = yaw_rate,
        /// Sideslip of G, in rad.
        sideslip_rad: f64 = sideslip,
        /// Speed of G, negative in reverse, in m/s.
        speed_m_s: f64 = speed,
        /// Mid-exposure of the last accepted pose, in ns of the host's monotonic clock.
        pose_time_ns: u64 = pose_time,
    }
}

message! {
    /// Covariances of the estimated state.
    CovarianceMessage as "Covariance" of Covariance {
        /// Covariance of position of G and yaw, world frame, in m and rad.
        pose: Group<PoseCovariance>,
        /// Covariance of the velocity of G forward and to the left and of the yaw rate, in m/s and
        /// rad/s.
        twist: Group<TwistCovariance>,
    }
}

array! {
    PoseCovariance of [f64; 6] { x_x, x_y, x_yaw, y_y, y_yaw, yaw_yaw, }
}

array! {
    TwistCovariance of [f64; 6] {
        forward_forward, forward_left, forward_yaw_rate, left_left, left_yaw_rate,
        yaw_rate_yaw_rate,
    }
}

message! {
    /// Wanted position and velocity of P.
    ReferenceMessage as "Reference" of ReferencePoint {
        /// Position of P; absent for a velocity alone.
        position: Maybe<PointMessage>,
        /// Velocity of P.
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
        /// Rate of the steering, in rad/s.
        steering_rate_rad_s: f64 = steering_rate,
    }
}

message! {
    /// Command to the board, in force until the next tick.
    CommandMessage as "Command" of DriveCommand {
        /// Speed of the rear axle, in m/s.
        rear_speed_m_s: f64 = rear_speed,
        /// Steering angle, in rad.
        steering_rad: f64 = steering,
        /// Mid-exposure of the last accepted pose that the command rests on, in ns of the
        /// host's monotonic clock.
        pose_time_ns: u64 = pose_time,
        /// Whether the ESC should brake down to the speed, where it can.
        brake: bool,
    }
}

message! {
    /// A drive command on its way to the board.
    DriveWriteMessage as "DriveWrite" of DriveWrite {
        /// Number of the command on the wire, wrapping.
        sequence: u8,
        /// Whether the whole frame was written; otherwise no byte of it was.
        written: bool,
        /// Time when the result was known, in ns of the host's monotonic clock.
        time_ns: u64,
    }
}
