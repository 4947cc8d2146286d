//! What the pilot was told, exactly: a replay starts from these.

use nalgebra::Point2;
use singletrack_control::{InertialSample, PoseSample, Setpoint, Time};
use singletrack_pilot::{
    BoardHealth, BoardSample, BoardState, Event, LineHealth, LinkState, PoseMissing, RealTimeState,
    Request,
};

use super::{
    Senseless,
    code::{Code, EventKind, OptionalCode},
    field::Maybe,
    message,
    tick::{PointMessage, VelocityMessage},
};

message! {
    /// Something that happened between two ticks. Which of the fields are present
    /// follows from the kind.
    EventMessage as "Event" {
        kind: Code<EventKind>,
        pose: Maybe<PoseSampleMessage>,
        /// Why a frame brought no pose.
        pose_missing: OptionalCode<PoseMissing>,
        board: Maybe<BoardSampleMessage>,
        link: OptionalCode<LinkState>,
        request: OptionalCode<Request>,
        health: Maybe<BoardHealthMessage>,
        line: Maybe<LineHealthMessage>,
        real_time: Maybe<RealTimeMessage>,
        setpoint: Maybe<SetpointMessage>,
        /// Number of the configuration that is in force from here on.
        reconfigured: Maybe<u32>,
    }
}

message! {
    /// A valid pose of the car, from the motion capture.
    PoseSampleMessage as "PoseSample" {
        /// Mid-exposure, in ns of the host's monotonic clock.
        capture_ns: u64,
        /// When the packet arrived, in ns of the host's monotonic clock.
        receive_ns: u64,
        /// Number that the motion capture gave to the frame.
        frame: i32,
        /// Position of the rigid body's origin, world frame, in m.
        x_m: f64,
        y_m: f64,
        /// Yaw of the rigid body, left positive, in rad, from -pi to pi.
        yaw_rad: f64,
    }
}

message! {
    /// What the board measured, in the car's axes (forward, left, up).
    BoardSampleMessage as "BoardSample" {
        /// When the board made the record, in ns of the host's monotonic clock.
        time_ns: u64,
        /// Absent if the IMU is silent or its sample was reported before.
        inertial: Maybe<InertialSampleMessage>,
        /// Speed of the rear axle by the motor pulses, in m/s.
        motor_speed_m_s: f64,
        /// The board's safety machine.
        state: Code<BoardState>,
    }
}

message! {
    /// A sample of the inertial measurement unit.
    InertialSampleMessage as "InertialSample" {
        /// When it was measured, in ns of the host's monotonic clock.
        time_ns: u64,
        /// Angular velocity about the vertical, left positive, in rad/s.
        yaw_rate_rad_s: f64,
        /// Acceleration forward, without gravity, in m/s^2.
        forward_acceleration_m_s2: f64,
        /// Acceleration to the left, without gravity, in m/s^2.
        left_acceleration_m_s2: f64,
    }
}

message! {
    /// What the board says of itself.
    BoardHealthMessage as "BoardHealth" {
        battery_mv: u16,
        /// False if no stop switch is configured.
        stop_input_open: bool,
    }
}

message! {
    /// Damaged frames as a part of all over about a second, 0 to 1; absent while
    /// too few came to tell.
    LineHealthMessage as "LineHealth" {
        to_host: Maybe<f64>,
        to_board: Maybe<f64>,
    }
}

message! {
    /// What the system granted the controller.
    RealTimeMessage as "RealTime" {
        /// Whether it is scheduled in real time.
        fifo: bool,
        /// Whether its memory stays in place.
        memory_locked: bool,
    }
}

message! {
    /// A set-point for P from outside.
    SetpointMessage as "Setpoint" {
        /// When it arrived, in ns of the host's monotonic clock.
        time_ns: u64,
        /// Absent for a velocity alone.
        position: Maybe<PointMessage>,
        velocity: VelocityMessage,
    }
}

impl EventMessage {
    const fn of(kind: EventKind) -> Self {
        Self {
            kind: Code(kind),
            pose: Maybe(None),
            pose_missing: OptionalCode(None),
            board: Maybe(None),
            link: OptionalCode(None),
            request: OptionalCode(None),
            health: Maybe(None),
            line: Maybe(None),
            real_time: Maybe(None),
            setpoint: Maybe(None),
            reconfigured: Maybe(None),
        }
    }
}

impl From<&Event> for EventMessage {
    fn from(event: &Event) -> Self {
        match *event {
            Event::Pose(pose) => Self {
                pose: Maybe(Some(pose.into())),
                ..Self::of(EventKind::Pose)
            },
            Event::PoseMissing(missing) => Self {
                pose_missing: OptionalCode(Some(missing)),
                ..Self::of(EventKind::PoseMissing)
            },
            Event::Board(sample) => Self {
                board: Maybe(Some(sample.into())),
                ..Self::of(EventKind::Board)
            },
            Event::Link(link) => Self {
                link: OptionalCode(Some(link)),
                ..Self::of(EventKind::Link)
            },
            Event::Request(request) => Self {
                request: OptionalCode(Some(request)),
                ..Self::of(EventKind::Request)
            },
            Event::ArmRefused => Self::of(EventKind::ArmRefused),
            Event::Health(health) => Self {
                health: Maybe(Some(health.into())),
                ..Self::of(EventKind::Health)
            },
            Event::Line(line) => Self {
                line: Maybe(Some(line.into())),
                ..Self::of(EventKind::Line)
            },
            Event::RealTime(state) => Self {
                real_time: Maybe(Some(state.into())),
                ..Self::of(EventKind::RealTime)
            },
            Event::Setpoint(setpoint) => Self {
                setpoint: Maybe(Some(setpoint.into())),
                ..Self::of(EventKind::Setpoint)
            },
            Event::Reconfigured(number) => Self {
                reconfigured: Maybe(Some(number)),
                ..Self::of(EventKind::Reconfigured)
            },
        }
    }
}

impl TryFrom<&EventMessage> for Event {
    type Error = Senseless;

    fn try_from(message: &EventMessage) -> Result<Self, Senseless> {
        let missing = |part| Senseless::PartMissing {
            kind: "an event",
            part,
        };
        Ok(match message.kind.0 {
            EventKind::Pose => Self::Pose(
                message
                    .pose
                    .0
                    .clone()
                    .ok_or_else(|| missing("its pose"))?
                    .into(),
            ),
            EventKind::PoseMissing => Self::PoseMissing(
                message
                    .pose_missing
                    .0
                    .ok_or_else(|| missing("why the pose is missing"))?,
            ),
            EventKind::Board => Self::Board(
                message
                    .board
                    .0
                    .clone()
                    .ok_or_else(|| missing("the board's sample"))?
                    .into(),
            ),
            EventKind::Link => Self::Link(message.link.0.ok_or_else(|| missing("the link"))?),
            EventKind::Request => {
                Self::Request(message.request.0.ok_or_else(|| missing("the request"))?)
            }
            EventKind::ArmRefused => Self::ArmRefused,
            EventKind::Health => {
                let health = message.health.0.clone();
                Self::Health(health.ok_or_else(|| missing("the board's health"))?.into())
            }
            EventKind::Line => {
                let line = message.line.0.clone();
                Self::Line(line.ok_or_else(|| missing("the line's health"))?.into())
            }
            EventKind::RealTime => {
                let state = message.real_time.0.clone();
                Self::RealTime(state.ok_or_else(|| missing("what was granted"))?.into())
            }
            EventKind::Setpoint => {
                let setpoint = message.setpoint.0.clone();
                Self::Setpoint(setpoint.ok_or_else(|| missing("the set-point"))?.into())
            }
            EventKind::Reconfigured => {
                let number = message.reconfigured.0;
                Self::Reconfigured(number.ok_or_else(|| missing("the configuration's number"))?)
            }
        })
    }
}

impl From<BoardHealth> for BoardHealthMessage {
    fn from(health: BoardHealth) -> Self {
        Self {
            battery_mv: health.battery_mv,
            stop_input_open: health.stop_input_open,
        }
    }
}

impl From<BoardHealthMessage> for BoardHealth {
    fn from(message: BoardHealthMessage) -> Self {
        Self {
            battery_mv: message.battery_mv,
            stop_input_open: message.stop_input_open,
        }
    }
}

impl From<LineHealth> for LineHealthMessage {
    fn from(line: LineHealth) -> Self {
        Self {
            to_host: Maybe(line.to_host),
            to_board: Maybe(line.to_board),
        }
    }
}

impl From<LineHealthMessage> for LineHealth {
    fn from(message: LineHealthMessage) -> Self {
        Self {
            to_host: message.to_host.0,
            to_board: message.to_board.0,
        }
    }
}

impl From<RealTimeState> for RealTimeMessage {
    fn from(state: RealTimeState) -> Self {
        Self {
            fifo: state.fifo,
            memory_locked: state.memory_locked,
        }
    }
}

impl From<RealTimeMessage> for RealTimeState {
    fn from(message: RealTimeMessage) -> Self {
        Self {
            fifo: message.fifo,
            memory_locked: message.memory_locked,
        }
    }
}

impl From<Setpoint> for SetpointMessage {
    fn from(setpoint: Setpoint) -> Self {
        Self {
            time_ns: setpoint.time.0,
            position: Maybe::from(setpoint.position),
            velocity: setpoint.velocity.into(),
        }
    }
}

impl From<SetpointMessage> for Setpoint {
    fn from(message: SetpointMessage) -> Self {
        Self {
            time: Time(message.time_ns),
            position: message.position.0.map(Into::into),
            velocity: message.velocity.into(),
        }
    }
}

impl From<PoseSample> for PoseSampleMessage {
    fn from(pose: PoseSample) -> Self {
        Self {
            capture_ns: pose.capture.0,
            receive_ns: pose.receive.0,
            frame: pose.frame,
            x_m: pose.position.x,
            y_m: pose.position.y,
            yaw_rad: pose.yaw,
        }
    }
}

impl From<PoseSampleMessage> for PoseSample {
    fn from(message: PoseSampleMessage) -> Self {
        Self {
            capture: Time(message.capture_ns),
            receive: Time(message.receive_ns),
            frame: message.frame,
            position: Point2::new(message.x_m, message.y_m),
            yaw: message.yaw_rad,
        }
    }
}

impl From<BoardSample> for BoardSampleMessage {
    fn from(sample: BoardSample) -> Self {
        Self {
            time_ns: sample.time.0,
            inertial: Maybe::from(sample.inertial),
            motor_speed_m_s: sample.motor_speed,
            state: Code(sample.state),
        }
    }
}

impl From<BoardSampleMessage> for BoardSample {
    fn from(message: BoardSampleMessage) -> Self {
        Self {
            time: Time(message.time_ns),
            inertial: message.inertial.0.map(Into::into),
            motor_speed: message.motor_speed_m_s,
            state: message.state.0,
        }
    }
}

impl From<InertialSample> for InertialSampleMessage {
    fn from(sample: InertialSample) -> Self {
        Self {
            time_ns: sample.time.0,
            yaw_rate_rad_s: sample.yaw_rate,
            forward_acceleration_m_s2: sample.forward_acceleration,
            left_acceleration_m_s2: sample.left_acceleration,
        }
    }
}

impl From<InertialSampleMessage> for InertialSample {
    fn from(message: InertialSampleMessage) -> Self {
        Self {
            time: Time(message.time_ns),
            yaw_rate: message.yaw_rate_rad_s,
            forward_acceleration: message.forward_acceleration_m_s2,
            left_acceleration: message.left_acceleration_m_s2,
        }
    }
}

#[cfg(test)]
mod tests {
    use byteorder::LittleEndian;
    use proptest::prelude::*;

    use super::*;

    /// Every bit pattern, also of what is not a number.
    fn any_float() -> impl Strategy<Value = f64> {
        any::<u64>().prop_map(f64::from_bits)
    }

    fn any_time() -> impl Strategy<Value = Time> {
        any::<u64>().prop_map(Time)
    }

    fn any_pose() -> impl Strategy<Value = PoseSample> {
        (
            any_time(),
            any_time(),
            any::<i32>(),
            any_float(),
            any_float(),
            any_float(),
        )
            .prop_map(|(capture, receive, frame, x, y, yaw)| PoseSample {
                capture,
                receive,
                frame,
                position: Point2::new(x, y),
                yaw,
            })
    }

    fn any_inertial() -> impl Strategy<Value = InertialSample> {
        (any_time(), any_float(), any_float(), any_float()).prop_map(
            |(time, yaw_rate, forward_acceleration, left_acceleration)| InertialSample {
                time,
                yaw_rate,
                forward_acceleration,
                left_acceleration,
            },
        )
    }

    fn any_board() -> impl Strategy<Value = BoardSample> {
        let state = prop::sample::select(vec![
            BoardState::Booting,
            BoardState::Neutral,
            BoardState::Armed,
            BoardState::Driving,
            BoardState::Failsafe,
            BoardState::EmergencyStopped,
        ]);
        (
            any_time(),
            prop::option::of(any_inertial()),
            any_float(),
            state,
        )
            .prop_map(|(time, inertial, motor_speed, state)| BoardSample {
                time,
                inertial,
                motor_speed,
                state,
            })
    }

    fn any_event() -> impl Strategy<Value = Event> {
        prop_oneof![
            any_pose().prop_map(Event::Pose),
            any_board().prop_map(Event::Board),
            prop::sample::select(vec![
                Event::PoseMissing(PoseMissing::Untracked),
                Event::PoseMissing(PoseMissing::Absent),
                Event::PoseMissing(PoseMissing::Stale),
                Event::PoseMissing(PoseMissing::Rejected),
                Event::PoseMissing(PoseMissing::Untrustworthy),
                Event::Link(LinkState::Down),
                Event::Link(LinkState::Ready),
                Event::Request(Request::Arm),
                Event::Request(Request::Disarm),
                Event::Request(Request::EmergencyStop),
                Event::ArmRefused,
            ]),
        ]
    }

    /// All floats of an event by their bits, for which equality is not enough.
    fn bits(event: &Event) -> Vec<u64> {
        let floats = match event {
            Event::Pose(pose) => vec![pose.position.x, pose.position.y, pose.yaw],
            Event::Board(board) => {
                let mut floats = vec![board.motor_speed];
                if let Some(inertial) = board.inertial {
                    floats.extend([
                        inertial.yaw_rate,
                        inertial.forward_acceleration,
                        inertial.left_acceleration,
                    ]);
                }
                floats
            }
            _ => Vec::new(),
        };
        floats.into_iter().map(f64::to_bits).collect()
    }

    proptest! {
        #[test]
        fn an_event_comes_back_from_its_bytes_bit_for_bit(
            events in prop::collection::vec(any_event(), 0..crate::MAX_EVENTS),
        ) {
            let messages: Vec<EventMessage> = events.iter().map(Into::into).collect();
            let bytes = cdr_encoding::to_vec::<_, LittleEndian>(&messages).unwrap();
            let (read, length) =
                cdr_encoding::from_bytes::<Vec<EventMessage>, LittleEndian>(&bytes).unwrap();
            prop_assert_eq!(length, bytes.len());
            prop_assert_eq!(read.len(), events.len());
            for (read, event) in read.iter().zip(&events) {
                let read = Event::try_from(read).unwrap();
                // The text differs in everything but the payload of NaNs.
                prop_assert_eq!(format!("{read:?}"), format!("{event:?}"));
                prop_assert_eq!(bits(&read), bits(event));
            }
        }

        #[test]
        fn arbitrary_bytes_are_an_event_or_refused(bytes: Vec<u8>) {
            let read = cdr_encoding::from_bytes::<EventMessage, LittleEndian>(&bytes);
            if let Ok((message, _)) = read
                && let Ok(event) = Event::try_from(&message)
            {
                prop_assert_eq!(EventMessage::from(&event).kind, message.kind);
            }
        }
    }

    #[test]
    fn an_event_without_its_part_is_refused() {
        let message = EventMessage::of(EventKind::Pose);
        assert_eq!(
            Event::try_from(&message).unwrap_err().to_string(),
            "an event without its pose"
        );
    }
}
