//! The events of a tick, exactly: a replay starts from them.

use singletrack_control::{
    Demand, InertialSample, NeighbourSample, PoseSample, ReferencePoint, Setpoint, SetpointStamp,
    SpeedDemand, SteeringDemand, TrajectoryPiece, TrajectoryPoint,
};
use singletrack_pilot::{
    AttitudeSample, BoardHealth, BoardSample, BoardState, Event, Jog, Learned, LineHealth,
    LinkState, PilotRequest, PoseMissing, RealTimeState, Tilt, Tuning,
};

use super::{
    Fields, choice,
    field::{Code, GainMessage, Group, Maybe, Part, PointMessage, Represents, VelocityMessage},
    fields, message,
};

choice! {
    /// Something that happened between two ticks. Which of the fields are present
    /// follows from the kind.
    EventMessage as "Event" of Event, "an event" {
        EventKind as "KIND",
        1 "pose" Pose(pose: Maybe<PoseSampleMessage>, "its pose"),
        2 "pose-missing" PoseMissing(
            /// Reason why a frame brought no pose.
            pose_missing: Code<Option<PoseMissing>>, "why the pose is missing"
        ),
        3 "board" Board(board: Maybe<BoardSampleMessage>, "the board's sample"),
        4 "link" Link(link: Code<Option<LinkState>>, "the link"),
        5 "request" Request(request: Code<Option<PilotRequest>>, "the request"),
        6 "arm-refused" ArmRefused,
        7 "health" Health(health: Maybe<BoardHealthMessage>, "the board's health"),
        8 "line" Line(line: Maybe<LineHealthMessage>, "the line's health"),
        9 "real-time" RealTime(real_time: Maybe<RealTimeMessage>, "what was granted"),
        10 "setpoint" Setpoint(setpoint: Maybe<SetpointMessage>, "the set-point"),
        11 "reconfigured" Reconfigured(
            /// Number of the configuration that is in force from here on.
            reconfigured: Maybe<u32>, "the configuration's number"
        ),
        12 "attitude" Attitude(attitude: Maybe<AttitudeMessage>, "the attitude"),
        13 "proved" Proved(
            /// Whether the configuration has been proved on this car.
            proved: Maybe<bool>, "whether it is proved"
        ),
        14 "jog" Jog(jog: Maybe<JogMessage>, "the pulses"),
        15 "trajectory-piece" TrajectoryPiece(
            trajectory_piece: Maybe<TrajectoryPieceMessage>, "the trajectory's point"
        ),
        16 "tuning" Tuning(tuning: Maybe<TuningMessage>, "the values"),
        17 "neighbour" Neighbour(neighbour: Maybe<NeighbourMessage>, "the body"),
        18 "learned" Learned(learned: Maybe<LearnedMessage>, "what is learned"),
        19 "begin" Begin(
            /// Time when the reference of a car that waited began, in ns of the host's monotonic
            /// clock.
            begin_ns: Maybe<u64>, "the time"
        ),
    }
}

message! {
    /// A valid pose of the car, from the motion capture.
    PoseSampleMessage as "PoseSample" of PoseSample {
        /// Mid-exposure, in ns of the host's monotonic clock.
        capture_ns: u64 = capture,
        /// Time when the packet arrived, in ns of the host's monotonic clock.
        receive_ns: u64 = receive,
        /// Number that the motion capture gave to the frame.
        frame: i32,
        /// Position of the rigid body's origin, world frame, in m.
        position: Group<PointMessage>,
        /// Yaw of the rigid body, left positive, in rad, from -pi to pi.
        yaw_rad: f64 = yaw,
    }
}

message! {
    /// Another rigid body as the motion capture sees it.
    NeighbourMessage as "Neighbour" of NeighbourSample {
        /// Streaming id of the body; negative while an expected body has none.
        id: i32,
        /// Mid-exposure, in ns of the host's monotonic clock.
        capture_ns: u64 = capture,
        /// Position of the body's origin on the floor, world frame, in m; absent if it is not
        /// seen.
        position: Maybe<PointMessage>,
        /// Whether it is a car that yields to this one.
        yields: bool,
    }
}

message! {
    /// Measurements of the board, in the car's axes (forward, left, up).
    BoardSampleMessage as "BoardSample" of BoardSample {
        /// Time of the board's record, in ns of the host's monotonic clock.
        time_ns: u64 = time,
        /// Sample of the IMU; absent if the IMU is silent or the sample was reported before.
        inertial: Maybe<InertialSampleMessage>,
        /// Speed of the rear axle by the motor pulses, in m/s.
        motor_speed_m_s: f64 = motor_speed,
        /// State of the board's safety machine.
        state: Code<BoardState>,
    }
}

message! {
    /// A sample of the inertial measurement unit.
    InertialSampleMessage as "InertialSample" of InertialSample {
        /// Time of the measurement, in ns of the host's monotonic clock.
        time_ns: u64 = time,
        /// Angular velocity about the vertical, left positive, in rad/s.
        yaw_rate_rad_s: f64 = yaw_rate,
        /// Acceleration forward, without gravity, in m/s^2.
        forward_acceleration_m_s2: f64 = forward_acceleration,
        /// Acceleration to the left, without gravity, in m/s^2.
        left_acceleration_m_s2: f64 = left_acceleration,
    }
}

message! {
    /// Health of the board.
    BoardHealthMessage as "BoardHealth" of BoardHealth {
        /// Voltage of the battery, in mV.
        battery_mv: u16,
        /// Whether the stop input is open; false if no stop switch is configured.
        stop_input_open: bool,
        /// Whether nothing is connected to the input that measures the battery.
        battery_open: bool,
        /// Whether the IMU reports an error, or failed its self-test.
        imu_fault: bool,
    }
}

message! {
    /// Attitude, height and clock of the sensors.
    AttitudeMessage as "Attitude" of AttitudeSample {
        /// Attitude by the IMU, in the car's axes.
        imu: Maybe<TiltMessage>,
        /// Attitude of the rigid body, in its own axes.
        body: Maybe<TiltMessage>,
        /// Height of the rigid body's origin, in m.
        height_m: Maybe<f64> = height,
        /// Bound on the error of the poses' mid-exposure, in s.
        capture_uncertainty_s: Maybe<f64> = capture_uncertainty,
    }
}

message! {
    /// Roll and pitch.
    TiltMessage as "Tilt" of Tilt {
        /// Rotation about the forward axis, left side up, in rad.
        roll_rad: f64 = roll,
        /// Rotation about the left axis, nose down, in rad.
        pitch_rad: f64 = pitch,
    }
}

message! {
    /// Share of damaged frames over about a second, 0 to 1; absent while too few frames
    /// came.
    LineHealthMessage as "LineHealth" of LineHealth {
        /// Share of the frames to the host.
        to_host: Maybe<f64>,
        /// Share of the frames to the board.
        to_board: Maybe<f64>,
    }
}

message! {
    /// Scheduling that the system granted the controller.
    RealTimeMessage as "RealTime" of RealTimeState {
        /// Whether the controller is scheduled in real time.
        fifo: bool,
        /// Whether the controller's memory is locked.
        memory_locked: bool,
    }
}

message! {
    /// A set-point from outside: a velocity of P, with a position or without; or a steering
    /// angle, with or without a largest rate, or a rate alone, with a speed or an acceleration.
    SetpointMessage as "Setpoint" {
        stamp: Group<StampMessage>,
        /// Position of P; absent for a velocity alone.
        position: Maybe<PointMessage>,
        /// Velocity of P.
        velocity: Maybe<VelocityMessage>,
        /// Steering angle, in rad.
        steering_rad: Maybe<f64>,
        /// Rate of the steering, in rad/s; beside an angle the largest one.
        steering_rate_rad_s: Maybe<f64>,
        /// Speed of G, in m/s.
        speed_m_s: Maybe<f64>,
        /// Acceleration of G, in m/s^2.
        acceleration_m_s2: Maybe<f64>,
        /// Speed of the rear axle, in m/s.
        rear_speed_m_s: Maybe<f64>,
    }
}

message! {
    /// Identity of a set-point.
    StampMessage as "SetpointStamp" of SetpointStamp {
        /// Time when it was decided, in ns of the host's monotonic clock.
        time_ns: u64 = time,
        /// Number that the sender gave to it.
        sequence: Maybe<u32>,
    }
}

message! {
    /// A point of a trajectory from outside; the last one puts it in force.
    TrajectoryPieceMessage as "TrajectoryPiece" of TrajectoryPiece {
        stamp: Group<StampMessage>,
        /// Place of the point, from 0.
        index: u8,
        /// Number of points.
        count: u8,
        point: Group<TrajectoryPointFields>,
    }
}

fields! {
    /// A point of a trajectory.
    TrajectoryPointFields of TrajectoryPoint {
        /// Time when P should be there, in ns of the host's monotonic clock.
        at_ns: u64 = time,
        /// Position of P.
        position: PointMessage,
        /// Velocity of P.
        velocity: VelocityMessage,
    }
}

impl Represents<Setpoint> for SetpointMessage {
    fn of(setpoint: &Setpoint) -> Self {
        let stamp = Represents::of(&setpoint.stamp);
        let absent = Self {
            stamp,
            ..Fields::absent()
        };
        match setpoint.demand {
            Demand::Point(ReferencePoint { position, velocity }) => Self {
                position: Represents::of(&position),
                velocity: Represents::of(&Some(velocity)),
                ..absent
            },
            Demand::Actuation { steering, speed } => {
                let (angle, rate) = match steering {
                    SteeringDemand::Angle(angle) => (Some(angle), None),
                    SteeringDemand::AngleWithin { angle, rate } => (Some(angle), Some(rate)),
                    SteeringDemand::Rate(rate) => (None, Some(rate)),
                };
                let mut message = Self {
                    steering_rad: Maybe(angle),
                    steering_rate_rad_s: Maybe(rate),
                    ..absent
                };
                match speed {
                    SpeedDemand::Speed(speed) => message.speed_m_s.0 = Some(speed),
                    SpeedDemand::RearSpeed(speed) => message.rear_speed_m_s.0 = Some(speed),
                    SpeedDemand::Acceleration(it) => message.acceleration_m_s2.0 = Some(it),
                }
                message
            }
        }
    }

    fn value(self) -> Result<Setpoint, String> {
        let part = Part("a set-point");
        let demand = if self.velocity.0.is_some() {
            Demand::Point(ReferencePoint {
                position: self.position.value()?,
                velocity: part.take(self.velocity, "its velocity")?,
            })
        } else {
            Demand::Actuation {
                steering: match (self.steering_rad.0, self.steering_rate_rad_s.0) {
                    (Some(angle), None) => SteeringDemand::Angle(angle),
                    (Some(angle), Some(rate)) => SteeringDemand::AngleWithin { angle, rate },
                    (None, rate) => {
                        SteeringDemand::Rate(part.take(Maybe(rate), "velocity and steering")?)
                    }
                },
                speed: match (self.speed_m_s.0, self.rear_speed_m_s.0) {
                    (Some(speed), _) => SpeedDemand::Speed(speed),
                    (None, Some(speed)) => SpeedDemand::RearSpeed(speed),
                    (None, None) => {
                        SpeedDemand::Acceleration(part.take(self.acceleration_m_s2, "its speed")?)
                    }
                },
            }
        };
        Ok(Setpoint {
            stamp: self.stamp.value()?,
            demand,
        })
    }
}

message! {
    /// Bare pulses from the operator who jogs.
    JogMessage as "Jog" of Jog {
        /// Servo pulse, in us.
        servo_us: u16,
        /// ESC pulse, in us.
        esc_us: u16,
    }
}

message! {
    /// New tuned values; an absent one stays.
    TuningMessage as "Tuning" of Tuning {
        /// Gains of the position loop.
        gain: Maybe<GainMessage>,
        /// Distance p of P from the front axle, in m.
        point_distance_m: Maybe<f64> = point_distance,
    }
}

message! {
    /// Learned corrections of the car: true values less configured ones.
    LearnedMessage as "Learned" of Learned {
        /// Angle of the front wheels for that commanded, as a fraction beyond one.
        steering_gain: f64,
        /// Angle of the front wheels when straight ones are commanded, in rad.
        steering_trim_rad: f64 = steering_trim,
        /// Delay of the stamps of the poses, in s.
        stamp_offset_s: f64 = stamp_offset,
        /// Yaw of the rigid body on the car, in rad.
        body_yaw_rad: f64 = body_yaw,
        /// Position of the rigid body's pivot, forward, in m.
        pivot_forward_m: f64 = pivot_forward,
        /// Position of the rigid body's pivot, to the left, in m.
        pivot_left_m: f64 = pivot_left,
    }
}

#[cfg(test)]
mod tests {
    use byteorder::LittleEndian;
    use proptest::prelude::*;
    use singletrack_control::{Position, Time, Velocity};

    use singletrack_pilot::Arming;

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
                position: Position::new(x, y),
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
            BoardState::PoweringUp,
            BoardState::Jogging,
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

    fn any_stamp() -> impl Strategy<Value = SetpointStamp> {
        (any_time(), any::<Option<u32>>())
            .prop_map(|(time, sequence)| SetpointStamp { time, sequence })
    }

    fn any_demand() -> impl Strategy<Value = Demand> {
        let pair = || (any_float(), any_float());
        prop_oneof![
            (prop::option::of(pair()), pair()).prop_map(|(position, (v_x, v_y))| {
                Demand::Point(ReferencePoint {
                    position: position.map(|(x, y)| Position::new(x, y)),
                    velocity: Velocity::new(v_x, v_y),
                })
            }),
            ([0..3, 0..3], pair(), any_float()).prop_map(
                |([steering, speed], (angle, rate), drives)| Demand::Actuation {
                    steering: match steering {
                        0 => SteeringDemand::Angle(angle),
                        1 => SteeringDemand::AngleWithin { angle, rate },
                        _ => SteeringDemand::Rate(rate),
                    },
                    speed: match speed {
                        0 => SpeedDemand::Speed(drives),
                        1 => SpeedDemand::RearSpeed(drives),
                        _ => SpeedDemand::Acceleration(drives),
                    },
                },
            ),
        ]
    }

    fn any_piece() -> impl Strategy<Value = TrajectoryPiece> {
        (any_stamp(), any::<[u8; 2]>(), any_time(), any::<[u64; 4]>()).prop_map(
            |(stamp, [index, count], time, floats)| {
                let [x, y, v_x, v_y] = floats.map(f64::from_bits);
                TrajectoryPiece {
                    stamp,
                    index,
                    count,
                    point: TrajectoryPoint {
                        time,
                        position: Position::new(x, y),
                        velocity: Velocity::new(v_x, v_y),
                    },
                }
            },
        )
    }

    fn any_tuning() -> impl Strategy<Value = Tuning> {
        let gain = prop::option::of((any_float(), any_float()));
        (gain, prop::option::of(any_float())).prop_map(|(gain, point_distance)| Tuning {
            gain: gain.map(|(x, y)| Velocity::new(x, y)),
            point_distance,
        })
    }

    fn any_learned() -> impl Strategy<Value = Learned> {
        any::<[u64; 6]>().prop_map(|bits| {
            let [gain, trim, stamp, yaw, forward, left] = bits.map(f64::from_bits);
            Learned {
                steering_gain: gain,
                steering_trim: trim,
                stamp_offset: stamp,
                body_yaw: yaw,
                pivot_forward: forward,
                pivot_left: left,
            }
        })
    }

    fn any_event() -> impl Strategy<Value = Event> {
        prop_oneof![
            (any_stamp(), any_demand())
                .prop_map(|(stamp, demand)| Event::Setpoint(Setpoint { stamp, demand })),
            any_piece().prop_map(Event::TrajectoryPiece),
            any_tuning().prop_map(Event::Tuning),
            any_learned().prop_map(Event::Learned),
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
                Event::Request(PilotRequest::Arm(Arming::Unattended)),
                Event::Request(PilotRequest::Disarm),
                Event::Request(PilotRequest::EmergencyStop),
                Event::Request(PilotRequest::Arm(Arming::Held)),
                Event::Request(PilotRequest::Hold),
                Event::Request(PilotRequest::OperatorGone),
                Event::Request(PilotRequest::TimeUp),
                Event::Request(PilotRequest::Arm(Arming::Jog)),
                Event::Jog(Jog {
                    servo_us: 1_380,
                    esc_us: 1_545
                }),
                Event::Request(PilotRequest::Halt),
                Event::Request(PilotRequest::Carried),
                Event::Request(PilotRequest::Arm(Arming::Waiting)),
                Event::Begin(Time(3)),
                Event::Proved(true),
                Event::Proved(false),
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
            Event::Setpoint(setpoint) => match setpoint.demand {
                Demand::Point(ReferencePoint { position, velocity }) => {
                    let position = position.unwrap_or_default();
                    vec![position.x, position.y, velocity.x, velocity.y]
                }
                Demand::Actuation { steering, speed } => {
                    let (SpeedDemand::Speed(drives)
                    | SpeedDemand::RearSpeed(drives)
                    | SpeedDemand::Acceleration(drives)) = speed;
                    match steering {
                        SteeringDemand::AngleWithin { angle, rate } => vec![angle, rate, drives],
                        SteeringDemand::Angle(it) | SteeringDemand::Rate(it) => vec![it, drives],
                    }
                }
            },
            Event::TrajectoryPiece(TrajectoryPiece { point, .. }) => vec![
                point.position.x,
                point.position.y,
                point.velocity.x,
                point.velocity.y,
            ],
            Event::Tuning(tuning) => {
                let gain = tuning.gain.unwrap_or_default();
                vec![gain.x, gain.y, tuning.point_distance.unwrap_or_default()]
            }
            Event::Learned(learned) => learned.values().to_vec(),
            _ => Vec::new(),
        };
        floats.into_iter().map(f64::to_bits).collect()
    }

    proptest! {
        #[test]
        fn an_event_comes_back_from_its_bytes_bit_for_bit(
            events in prop::collection::vec(any_event(), 0..crate::MAX_EVENTS),
        ) {
            let messages: Vec<EventMessage> = events.iter().map(EventMessage::of).collect();
            let bytes = cdr_encoding::to_vec::<_, LittleEndian>(&messages).unwrap();
            let (read, length) =
                cdr_encoding::from_bytes::<Vec<EventMessage>, LittleEndian>(&bytes).unwrap();
            prop_assert_eq!(length, bytes.len());
            prop_assert_eq!(read.len(), events.len());
            for (read, event) in read.into_iter().zip(&events) {
                let read = read.value().unwrap();
                // The text differs in everything but the payload of NaNs.
                prop_assert_eq!(format!("{read:?}"), format!("{event:?}"));
                prop_assert_eq!(bits(&read), bits(event));
            }
        }

        #[test]
        fn arbitrary_bytes_are_an_event_or_refused(bytes: Vec<u8>) {
            let read = cdr_encoding::from_bytes::<EventMessage, LittleEndian>(&bytes);
            if let Ok((message, _)) = read {
                let kind = message.kind;
                if let Ok(event) = message.value() {
                    prop_assert_eq!(EventMessage::of(&event).kind, kind);
                }
            }
        }
    }

    #[test]
    fn an_event_without_its_part_is_refused() {
        let message = EventMessage {
            kind: Code(EventKind::Pose),
            ..Fields::absent()
        };
        assert_eq!(
            message.value().unwrap_err().to_string(),
            "an event without its pose"
        );
    }
}
