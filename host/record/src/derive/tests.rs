//! The messages for general tools.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test may fail"
)]

use singletrack_mocap::{CaptureTimeSource, Observation, Pose, PoseState};
use singletrack_pilot::{Mode, Reason};
use singletrack_protocol::{BoardMode, ImuState, RefusalReason, ResetCause, Status};

use crate::{
    BASE_FRAME, Channel, ClockMapping, Drops, Encoder, Entry, Level, Log as LogEntry, MAP_FRAME,
    ODOM_FRAME, StandardTopic, StatusRecord, TelemetryRecord, TickRecord, tick,
    topic::tests::{BySchema, telemetry},
};

/// 40 s of the monotonic clock are 100.25 s of the wall clock.
const START: ClockMapping = ClockMapping {
    monotonic_ns: 39_000_000_000,
    wall_ns: 99_250_000_000,
};

fn encoder() -> Encoder {
    Encoder::new(START)
}

/// The topics, publish times and messages that follow from an entry.
fn derived(encoder: &mut Encoder, entry: &Entry) -> Vec<(StandardTopic, u64, Vec<u8>)> {
    encoder
        .encode(entry)
        .unwrap()
        .filter_map(|publication| {
            let Channel::Standard(topic) = publication.channel else {
                return None;
            };
            let log_time_ns = START.wall_ns_at(entry.time_ns());
            assert_eq!(publication.log_time_ns, log_time_ns);
            Some((
                topic,
                publication.publish_time_ns,
                publication.bytes.to_vec(),
            ))
        })
        .collect()
}

/// The numbers of one message that follows from an entry, and its bytes.
struct Message {
    publish_time_ns: u64,
    numbers: Vec<(String, f64)>,
    bytes: Vec<u8>,
}

impl Message {
    fn of(encoder: &mut Encoder, entry: &Entry, wanted: StandardTopic) -> Self {
        let (topic, publish_time_ns, bytes) = derived(encoder, entry)
            .into_iter()
            .find(|(topic, ..)| *topic == wanted)
            .expect("the topic");
        Self {
            publish_time_ns,
            numbers: BySchema::read(&topic.schema_text(), &bytes),
            bytes,
        }
    }

    fn at(&self, path: &str) -> f64 {
        self.numbers
            .iter()
            .find_map(|(known, value)| (known == path).then_some(*value))
            .expect(path)
    }

    fn says(&self, text: &str) -> bool {
        let text = [text.as_bytes(), &[0]].concat();
        self.bytes.windows(text.len()).any(|part| part == text)
    }
}

fn topics(encoder: &mut Encoder, entry: &Entry) -> Vec<StandardTopic> {
    let derived = derived(encoder, entry);
    derived.into_iter().map(|(topic, ..)| topic).collect()
}

fn full() -> Entry {
    Entry::Tick(tick::tests::full())
}

fn close(one: f64, other: f64) -> bool {
    (one - other).abs() < 1e-12
}

#[test]
fn an_entry_comes_first_and_bit_for_bit() {
    let mut encoder = encoder();
    let entry = full();
    let mut bytes = Vec::new();
    entry.encode(&mut bytes).unwrap();
    let first = encoder.encode(&entry).unwrap().next().unwrap();
    assert_eq!(first.channel, Channel::Entry(crate::Topic::Tick));
    assert_eq!(first.bytes, bytes);
    assert_eq!(
        first.publish_time_ns,
        START.wall_ns_at(entry.sample_time_ns())
    );
}

#[test]
fn a_driving_tick_gives_position_and_reference() {
    let mut encoder = encoder();
    assert_eq!(
        topics(&mut encoder, &full()),
        [
            StandardTopic::Odometry,
            StandardTopic::Transforms,
            StandardTopic::Command,
            StandardTopic::Reference,
            StandardTopic::PointP,
            StandardTopic::Diagnostics,
        ]
    );
    let odometry = Message::of(&mut encoder, &full(), StandardTopic::Odometry);
    // 40.01006 s on the monotonic clock.
    assert_eq!(odometry.publish_time_ns, 100_260_060_000);
    assert_eq!(odometry.at("header.stamp.sec"), 100.0);
    assert_eq!(odometry.at("header.stamp.nanosec"), 260_060_000.0);
    assert!(odometry.says(ODOM_FRAME) && odometry.says(BASE_FRAME));
    assert_eq!(odometry.at("pose.pose.position.x"), 1.0);
    assert_eq!(odometry.at("pose.pose.position.y"), 2.0);
    let half = (0.1 + 0.2) / 2.0_f64;
    assert!(close(
        odometry.at("pose.pose.orientation.z"),
        libm::sin(half)
    ));
    assert!(close(
        odometry.at("pose.pose.orientation.w"),
        libm::cos(half)
    ));
    let (forward, left) = (0.4 * libm::cos(0.15_f64), 0.4 * libm::sin(0.15_f64));
    assert!(close(odometry.at("twist.twist.linear.x"), forward));
    assert!(close(odometry.at("twist.twist.linear.y"), left));
    assert_eq!(odometry.at("twist.twist.angular.z"), 0.5);
    let covariance = |of: &str, row: usize, column: usize| {
        odometry.at(&format!("{of}.covariance[{}]", 6 * row + column))
    };
    // The covariances of x with y, and of the yaw rate with the velocity to the left.
    assert_eq!(covariance("pose", 0, 1), 1e-9);
    assert_eq!(covariance("twist", 5, 1), 3e-5);
    for axis in 0..6 {
        let is_known = [0, 1, 5].contains(&axis);
        for of in ["pose", "twist"] {
            let variance = covariance(of, axis, axis);
            assert!(
                variance > 0.0 && is_known == (variance < 1.0),
                "{of} {axis}"
            );
        }
    }

    let transforms = Message::of(&mut encoder, &full(), StandardTopic::Transforms);
    assert!(transforms.says(MAP_FRAME));
    assert_eq!(transforms.at("transforms"), 2.0);
    assert_eq!(transforms.at("transforms[0].transform.translation.y"), 0.0);
    assert_eq!(transforms.at("transforms[1].transform.translation.y"), 2.0);
    assert_eq!(
        transforms.at("transforms[1].transform.rotation.z"),
        odometry.at("pose.pose.orientation.z")
    );

    let command = Message::of(&mut encoder, &full(), StandardTopic::Command);
    assert_eq!(command.at("drive.steering_angle"), f64::from(0.32_f32));
    assert_eq!(
        command.at("drive.steering_angle_velocity"),
        f64::from(-0.01_f32)
    );
    assert_eq!(command.at("drive.speed"), f64::from(0.39_f32));

    let reference = Message::of(&mut encoder, &full(), StandardTopic::Reference);
    assert_eq!(
        (reference.at("point.x"), reference.at("point.y")),
        (0.9, 0.1)
    );
    let point = Message::of(&mut encoder, &full(), StandardTopic::PointP);
    assert_eq!((point.at("point.x"), point.at("point.y")), (0.8, 0.2));
}

#[test]
fn a_point_is_encoded_as_in_the_standard() {
    let point = Message::of(&mut encoder(), &full(), StandardTopic::PointP);
    let expected = [
        &[0, 1, 0, 0][..], // plain CDR, little-endian
        &100_i32.to_le_bytes(),
        &260_060_000_u32.to_le_bytes(),
        &[4, 0, 0, 0],
        b"map\0", // to a multiple of eight from the header's end
        &0.8_f64.to_le_bytes(),
        &0.2_f64.to_le_bytes(),
        &[0; 8],
    ]
    .concat();
    assert_eq!(point.bytes, expected);
}

#[test]
fn a_tick_without_estimate_and_command_gives_no_message() {
    let entry = Entry::Tick(tick::tests::empty());
    let mut encoder = encoder();
    assert_eq!(topics(&mut encoder, &entry), [StandardTopic::Diagnostics]);
    assert_eq!(topics(&mut encoder, &entry), []);
}

#[test]
fn a_new_sample_of_the_imu_is_shown_in_si_units() {
    let Entry::Telemetry(mut record) = telemetry() else {
        panic!("not telemetry");
    };
    record.imu_time_host_ns = Some(40_500_000_000);
    let imu = Message::of(
        &mut encoder(),
        &Entry::Telemetry(record),
        StandardTopic::Imu,
    );
    assert_eq!(imu.publish_time_ns, 100_750_000_000);
    assert_eq!(imu.at("orientation.w"), 1.0);
    assert_eq!(imu.at("orientation.z"), -1.0 / 16_384.0);
    assert_eq!(imu.at("angular_velocity.z"), -0.006);
    assert_eq!(imu.at("linear_acceleration.y"), -0.002);
    assert_eq!(imu.at("orientation_covariance[0]"), 0.0);

    for (imu, time) in [
        (ImuState::Repeated, Some(1)),
        (ImuState::Silent, Some(1)),
        (ImuState::Fresh, None),
    ] {
        let mut telemetry = record.telemetry;
        telemetry.imu = imu;
        let entry = Entry::Telemetry(TelemetryRecord {
            imu_time_host_ns: time,
            telemetry,
            ..record
        });
        assert_eq!(topics(&mut encoder(), &entry), []);
    }
}

fn observation(state: PoseState) -> Entry {
    Entry::Pose(Observation {
        frame_number: 9,
        receive_time_ns: 40_300_000_000,
        state,
    })
}

#[test]
fn a_valid_pose_is_shown_at_its_mid_exposure() {
    let valid = observation(PoseState::Valid(Pose {
        x_m: 1.5,
        y_m: -0.5,
        z_m: 0.1,
        yaw_rad: 1.0,
        tilt_rad: 0.2,
        roll_rad: 0.0,
        pitch_rad: 0.0,
        capture_time_ns: 40_250_000_000,
        capture_uncertainty_ns: 1,
        capture_source: CaptureTimeSource::MidExposureEcho,
        receive_time_ns: 40_300_000_000,
        frame_number: 9,
        mean_error_m: 0.001,
        reacquired: false,
    }));
    let pose = Message::of(&mut encoder(), &valid, StandardTopic::MocapPose);
    assert_eq!(pose.publish_time_ns, 100_500_000_000);
    assert_eq!(pose.at("header.stamp.nanosec"), 500_000_000.0);
    assert_eq!(pose.at("pose.position.x"), 1.5);
    assert_eq!(pose.at("pose.position.z"), 0.1);
    assert!(close(pose.at("pose.orientation.z"), libm::sin(0.5_f64)));

    let untracked = observation(PoseState::Untracked);
    assert_eq!(topics(&mut encoder(), &untracked), []);
}

#[test]
fn a_line_of_the_log_keeps_its_level() {
    let entry = Entry::Log(LogEntry {
        time_ns: 40_000_000_000,
        level: Level::Warning,
        text: "the disk does not keep up".to_owned(),
    });
    let line = Message::of(&mut encoder(), &entry, StandardTopic::Rosout);
    assert_eq!(line.at("level"), 30.0);
    assert_eq!(line.at("stamp.sec"), 100.0);
    assert!(line.says("the disk does not keep up"));
}

#[test]
fn a_time_beyond_the_range_of_ros_is_its_last_time() {
    let entry = Entry::Log(LogEntry {
        time_ns: u64::MAX,
        level: Level::Info,
        text: String::new(),
    });
    let line = Message::of(&mut encoder(), &entry, StandardTopic::Rosout);
    assert_eq!(line.at("stamp.sec"), f64::from(i32::MAX));
}

fn status(frames_damaged: u16) -> Entry {
    Entry::Status(StatusRecord {
        receive_time_ns: 40_000_000_000,
        status: Status {
            board_time_us: 6,
            configuration_hash: 0xdead_beef,
            reset_cause: ResetCause::Watchdog,
            stop_input_open: false,
            battery_mv: 7_400,
            frames_received: 8,
            frames_damaged,
            drives_refused: 10,
            last_refusal: RefusalReason::Stale,
            frames_dropped: 11,
            bytes_overrun: 12,
            imu_errors: 13,
            supply_mv: 5_000,
            battery_open: false,
            power_on: false,
            edges_refused: 0,
            imu_calibration: 0xFF,
            imu_status: 5,
            imu_error: 0,
            imu_self_test: 0x0F,
        },
    })
}

fn mode(mode: Mode, reason: Option<Reason>) -> TickRecord {
    let mut tick = tick::tests::full();
    tick.output.mode = mode;
    tick.output.reason = reason;
    tick
}

fn levels(encoder: &mut Encoder, entry: &Entry) -> Vec<f64> {
    let message = Message::of(encoder, entry, StandardTopic::Diagnostics);
    (0..message.at("status") as usize)
        .map(|index| message.at(&format!("status[{index}].level")))
        .collect()
}

#[test]
fn each_status_of_the_board_and_each_change_of_mode_is_a_diagnosis() {
    let mut encoder = encoder();
    // Before the first tick.
    assert_eq!(levels(&mut encoder, &status(9)), [0.0, 0.0]);
    let driving = Entry::Tick(mode(Mode::Driving, None));
    let diagnosis = Message::of(&mut encoder, &driving, StandardTopic::Diagnostics);
    assert!(diagnosis.says("driving") && diagnosis.says("7.4") && diagnosis.says("deadbeef"));
    assert_eq!(diagnosis.at("status"), 3.0);
    assert!(!topics(&mut encoder, &driving).contains(&StandardTopic::Diagnostics));
    let stopping = Entry::Tick(mode(Mode::Stopping, Some(Reason::PoseTooOld)));
    let diagnosis = Message::of(&mut encoder, &stopping, StandardTopic::Diagnostics);
    assert!(diagnosis.says("stopping: pose-too-old"));
}

#[test]
fn the_level_of_a_diagnosis_follows_the_state() {
    let mut encoder = encoder();
    let level = |encoder: &mut Encoder, entry| levels(encoder, &entry);
    let tick = |of, reason| Entry::Tick(mode(of, reason));
    assert_eq!(level(&mut encoder, tick(Mode::Driving, None)), [0.0, 0.0]);
    let requested = tick(Mode::Stopping, Some(Reason::Requested));
    assert_eq!(level(&mut encoder, requested), [0.0, 0.0]);
    let blind = tick(Mode::Slowing, Some(Reason::PoseTooOld));
    assert_eq!(level(&mut encoder, blind), [1.0, 0.0]);
    let fault = tick(Mode::Fault, Some(Reason::EmergencyStop));
    assert_eq!(level(&mut encoder, fault), [2.0, 0.0]);

    let Entry::Telemetry(mut record) = telemetry() else {
        panic!("not telemetry");
    };
    record.telemetry.mode = BoardMode::EmergencyStopped;
    assert!(!topics(&mut encoder, &Entry::Telemetry(record)).contains(&StandardTopic::Diagnostics));
    assert_eq!(level(&mut encoder, status(9)), [2.0, 2.0, 0.0]);
    record.telemetry.mode = BoardMode::Driving;
    topics(&mut encoder, &Entry::Telemetry(record));
    assert_eq!(level(&mut encoder, status(9)), [2.0, 0.0, 0.0]);
    // An error counter rose.
    assert_eq!(level(&mut encoder, status(10)), [2.0, 1.0, 0.0]);
    assert_eq!(level(&mut encoder, status(10)), [2.0, 0.0, 0.0]);
    let mut lost = mode(Mode::Disconnected, Some(Reason::LinkDown));
    lost.link = crate::LinkPhase::Greeting;
    assert_eq!(level(&mut encoder, Entry::Tick(lost)), [1.0, 3.0, 0.0]);
    let drops = Entry::Drops(Drops {
        time_ns: 40_000_000_000,
        entries: 4,
    });
    assert_eq!(level(&mut encoder, drops), [1.0, 3.0, 1.0]);
}
