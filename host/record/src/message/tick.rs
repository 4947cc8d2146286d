//! A control tick and all that the pilot decided in it.

use nalgebra::{Point2, Vector2};
use singletrack_control::{Actuation, Estimate, Position, ReferencePoint, Time, Velocity};
use singletrack_pilot::{BoardRequest, DriveCommand, Event, Mode, Output, Reason};

use super::{
    Senseless,
    code::{Code, OptionalCode},
    event::EventMessage,
    field::Maybe,
    message,
};
use crate::{DriveWrite, LinkPhase, TickRecord};

message! {
    /// A control tick: what it was given, what it decided, and when. Times are ns
    /// of the host's monotonic clock. World frame: z up; angles left positive.
    TickMessage as "Tick" {
        /// Counts the ticks of the daemon, from 0.
        index: u64,
        /// The point of the tick's grid that it belongs to.
        scheduled_ns: u64,
        /// When the thread woke up for it.
        start_ns: u64,
        /// When its command was decided and handed to the line.
        finish_ns: u64,
        /// `start_ns` - `scheduled_ns`.
        lateness_ns: i64,
        /// Points of the grid skipped just before it: the tick before took too long.
        skipped: u32,
        /// The moment that the pilot was told.
        pilot_time_ns: u64,
        /// The pilot's mode after the tick.
        mode: Code<Mode>,
        /// Why the car does not drive, or stopped.
        reason: OptionalCode<Reason>,
        /// Whether no new valid pose came since the tick before.
        held: bool,
        /// Whether the car is turning round.
        turning_round: bool,
        /// Time since the first driving tick, in s.
        drive_time_s: Maybe<f64>,
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
        /// What became of the command.
        drive: Maybe<DriveWriteMessage>,
        /// From the mid-exposure of the newest accepted pose to the command leaving,
        /// in ns. The pose is an old one in a held tick.
        capture_to_command_ns: Maybe<i64>,
        /// The session with the board.
        link: Code<LinkPhase>,
        /// Events that did not fit: the pilot never saw them.
        events_dropped: u32,
        /// What the pilot was told, in order.
        events: Vec<EventMessage>,
    }
}

message! {
    /// The state of the car as estimated.
    EstimateMessage as "Estimate" {
        /// The moment that it is for, in ns of the host's monotonic clock.
        time_ns: u64,
        /// Position of the centre of mass G, world frame, in m.
        x_m: f64,
        y_m: f64,
        /// Yaw, not wrapped, in rad.
        yaw_rad: f64,
        yaw_rate_rad_s: f64,
        sideslip_rad: f64,
        /// Speed of G, negative in reverse, in m/s.
        speed_m_s: f64,
        /// Mid-exposure of the last accepted pose, in ns of the host's monotonic clock.
        pose_time_ns: u64,
    }
}

message! {
    /// One moment of the reference for P.
    ReferenceMessage as "Reference" {
        /// Absent for a reference that is a velocity alone.
        position: Maybe<PointMessage>,
        velocity: VelocityMessage,
    }
}

message! {
    /// A position on the floor, world frame.
    PointMessage as "Point" {
        x_m: f64,
        y_m: f64,
    }
}

message! {
    /// A velocity on the floor, world frame.
    VelocityMessage as "Velocity" {
        x_m_s: f64,
        y_m_s: f64,
    }
}

message! {
    /// Speed and steering for the car.
    ActuationMessage as "Actuation" {
        /// Speed of G, in m/s.
        speed_m_s: f64,
        /// Steering angle, in rad.
        steering_rad: f64,
        /// Rate at which it got there, in rad/s.
        steering_rate_rad_s: f64,
    }
}

message! {
    /// What the board is to do until the next tick.
    CommandMessage as "Command" {
        /// Speed of the rear axle, in m/s.
        rear_speed_m_s: f64,
        /// Steering angle, in rad.
        steering_rad: f64,
        /// Mid-exposure of the last accepted pose behind it, in ns of the host's
        /// monotonic clock.
        pose_time_ns: u64,
    }
}

message! {
    /// A drive command on its way to the board.
    DriveWriteMessage as "DriveWrite" {
        /// Its number on the wire, wrapping.
        sequence: u8,
        /// Whether the whole frame was written; otherwise no byte of it was.
        written: bool,
        /// When that was known, in ns of the host's monotonic clock.
        time_ns: u64,
    }
}

impl From<&TickRecord> for TickMessage {
    fn from(tick: &TickRecord) -> Self {
        let output = &tick.output;
        Self {
            index: tick.index,
            scheduled_ns: tick.scheduled_ns,
            start_ns: tick.start_ns,
            finish_ns: tick.finish_ns,
            lateness_ns: tick.lateness_ns(),
            skipped: tick.skipped,
            pilot_time_ns: tick.pilot_time.0,
            mode: Code(output.mode),
            reason: OptionalCode(output.reason),
            held: output.held,
            turning_round: output.turning_round,
            drive_time_s: Maybe(output.drive_time),
            estimate: Maybe::from(output.estimate),
            reference: Maybe::from(output.reference),
            point: Maybe::from(output.point),
            point_velocity: Maybe::from(output.point_velocity),
            actuation: output.actuation.into(),
            command: Maybe::from(output.command),
            request: OptionalCode(output.request),
            drive: Maybe::from(tick.drive),
            capture_to_command_ns: Maybe(tick.capture_to_command_ns()),
            link: Code(tick.link),
            events_dropped: tick.events_dropped,
            events: tick.events.iter().map(Into::into).collect(),
        }
    }
}

impl TryFrom<TickMessage> for TickRecord {
    type Error = Senseless;

    fn try_from(message: TickMessage) -> Result<Self, Senseless> {
        let mut events = heapless::Vec::new();
        for event in &message.events {
            events
                .push(Event::try_from(event)?)
                .map_err(|_| Senseless::TooManyEvents(message.events.len()))?;
        }
        Ok(Self {
            index: message.index,
            scheduled_ns: message.scheduled_ns,
            start_ns: message.start_ns,
            finish_ns: message.finish_ns,
            skipped: message.skipped,
            pilot_time: Time(message.pilot_time_ns),
            events,
            events_dropped: message.events_dropped,
            output: Output {
                mode: message.mode.0,
                reason: message.reason.0,
                estimate: message.estimate.0.map(Into::into),
                held: message.held,
                drive_time: message.drive_time_s.0,
                reference: message.reference.0.map(Into::into),
                point: message.point.0.map(Into::into),
                point_velocity: message.point_velocity.0.map(Into::into),
                actuation: message.actuation.into(),
                turning_round: message.turning_round,
                command: message.command.0.map(Into::into),
                request: message.request.0,
            },
            drive: message.drive.0.map(Into::into),
            link: message.link.0,
        })
    }
}

impl From<Estimate> for EstimateMessage {
    fn from(estimate: Estimate) -> Self {
        Self {
            time_ns: estimate.time.0,
            x_m: estimate.position.x,
            y_m: estimate.position.y,
            yaw_rad: estimate.yaw,
            yaw_rate_rad_s: estimate.yaw_rate,
            sideslip_rad: estimate.sideslip,
            speed_m_s: estimate.speed,
            pose_time_ns: estimate.pose_time.0,
        }
    }
}

impl From<EstimateMessage> for Estimate {
    fn from(message: EstimateMessage) -> Self {
        Self {
            time: Time(message.time_ns),
            position: Point2::new(message.x_m, message.y_m),
            yaw: message.yaw_rad,
            yaw_rate: message.yaw_rate_rad_s,
            sideslip: message.sideslip_rad,
            speed: message.speed_m_s,
            pose_time: Time(message.pose_time_ns),
        }
    }
}

impl From<ReferencePoint> for ReferenceMessage {
    fn from(reference: ReferencePoint) -> Self {
        Self {
            position: Maybe::from(reference.position),
            velocity: reference.velocity.into(),
        }
    }
}

impl From<ReferenceMessage> for ReferencePoint {
    fn from(message: ReferenceMessage) -> Self {
        Self {
            position: message.position.0.map(Into::into),
            velocity: message.velocity.into(),
        }
    }
}

impl From<Position> for PointMessage {
    fn from(position: Position) -> Self {
        Self {
            x_m: position.x,
            y_m: position.y,
        }
    }
}

impl From<PointMessage> for Position {
    fn from(message: PointMessage) -> Self {
        Point2::new(message.x_m, message.y_m)
    }
}

impl From<Velocity> for VelocityMessage {
    fn from(velocity: Velocity) -> Self {
        Self {
            x_m_s: velocity.x,
            y_m_s: velocity.y,
        }
    }
}

impl From<VelocityMessage> for Velocity {
    fn from(message: VelocityMessage) -> Self {
        Vector2::new(message.x_m_s, message.y_m_s)
    }
}

impl From<Actuation> for ActuationMessage {
    fn from(actuation: Actuation) -> Self {
        Self {
            speed_m_s: actuation.speed,
            steering_rad: actuation.steering,
            steering_rate_rad_s: actuation.steering_rate,
        }
    }
}

impl From<ActuationMessage> for Actuation {
    fn from(message: ActuationMessage) -> Self {
        Self {
            speed: message.speed_m_s,
            steering: message.steering_rad,
            steering_rate: message.steering_rate_rad_s,
        }
    }
}

impl From<DriveCommand> for CommandMessage {
    fn from(command: DriveCommand) -> Self {
        Self {
            rear_speed_m_s: command.rear_speed,
            steering_rad: command.steering,
            pose_time_ns: command.pose_time.0,
        }
    }
}

impl From<CommandMessage> for DriveCommand {
    fn from(message: CommandMessage) -> Self {
        Self {
            rear_speed: message.rear_speed_m_s,
            steering: message.steering_rad,
            pose_time: Time(message.pose_time_ns),
        }
    }
}

impl From<DriveWrite> for DriveWriteMessage {
    fn from(drive: DriveWrite) -> Self {
        Self {
            sequence: drive.sequence,
            written: drive.written,
            time_ns: drive.time_ns,
        }
    }
}

impl From<DriveWriteMessage> for DriveWrite {
    fn from(message: DriveWriteMessage) -> Self {
        Self {
            sequence: message.sequence,
            written: message.written,
            time_ns: message.time_ns,
        }
    }
}
