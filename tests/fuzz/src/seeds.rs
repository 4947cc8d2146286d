//! Seeds of the corpus: golden frames, their mutations, and sequences of events
//! that reach all states of a target.
//!
//! `cargo run -p singletrack-fuzz --example seeds` writes them to `corpus/`.

use singletrack_mocap::{codec::BitstreamVersion, encode};
use singletrack_protocol::{
    Acknowledgement, Arm, BoardMode, Configure, Disarm, Drive, EmergencyStop, Frame, Hello,
    ImuState, Jog, Refusal, RefusalReason, Request, ResetCause, Sequence, Status, StopCause,
    Telemetry, ToBoard, ToHost, VERSION,
};

use crate::choices::CONFIGURATION;

/// One file of the corpus.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Seed {
    /// File name.
    pub name: String,
    /// Contents.
    pub bytes: Vec<u8>,
}

/// The seeds of a target; none for an unknown name.
pub fn seeds(target: &str) -> Vec<Seed> {
    match target {
        "board_bytes" => serial(&to_board(), 0..4, BOARD_COURSES),
        "host_bytes" => serial(&to_host(), 1..6, HOST_COURSES),
        "natnet_packets" => natnet(),
        "configuration" => configuration(),
        "control_line" => control_line(),
        "page_head" => page_head(),
        "stream_messages" => stream_messages(),
        _ => vec![],
    }
}

/// A sequence of events, with its name.
type Course = (&'static str, &'static [u8]);

// The numbers are the operations in `board_bytes`.
const BOARD_COURSES: &[Course] = &[
    (
        "configure-arm-drive",
        &[
            0, 6, 1, 1, 7, 0, 0, 0, 5, 0, 0, 0, 1, 8, 12, 0xF4, 1, 0xE8, 3, 19, 0, 4, 0, 0, 15,
        ],
    ),
    (
        "drive-and-fall-silent",
        &[3, 19, 0xF4, 1, 0, 0, 8, 3, 31, 3, 31, 3, 31, 3, 31],
    ),
    (
        "brake-and-fall-silent",
        &[11, 19, 0xF4, 1, 0, 0, 8, 3, 31, 3, 31, 3, 31, 3, 31],
    ),
    (
        "stop-switch",
        &[19, 19, 0xF4, 1, 0, 0, 4, 16, 1, 3, 4, 16, 0, 8],
    ),
    (
        "motor-sensor-dies",
        &[3, 14, 0, 0, 19, 0xE8, 3, 0, 0, 15, 19, 0xE8, 3, 0, 0, 15],
    ),
    (
        "motor-jumps",
        &[
            3, 15, 0xFF, 0xFF, 1, 2, 3, 4, 19, 0xE8, 3, 0, 0, 4, 15, 0, 0, 0, 0, 0, 0, 3, 9,
        ],
    ),
    (
        "reverse",
        &[
            35, 12, 0, 0xFE, 0, 0, 12, 0, 0xFE, 0, 0, 19, 0, 0xFE, 0, 0, 15,
        ],
    ),
    (
        "disarm-and-arm-again",
        &[3, 10, 4, 0xFF, 0xFF, 7, 5, 0, 0, 0x5A, 0, 8, 12, 0, 1, 0, 0],
    ),
    ("emergency-stop", &[3, 11, 8, 12, 0, 1, 0, 0]),
    ("another-host", &[3, 6, 1, 9, 8, 12, 0, 1, 0, 0]),
    ("another-version", &[3, 6, 0, 0x63, 0, 2, 8]),
    ("line-full", &[3, 18, 0, 3, 31, 8, 10, 18, 1, 3, 31]),
    (
        "clock-wraps",
        &[
            7, 19, 0xF4, 1, 0, 0, 15, 3, 31, 5, 0, 0, 0, 2, 8, 12, 0, 1, 0, 0,
        ],
    ),
    (
        "every-limit",
        &[
            1, 7, 0xFF, 0xFF, 0, 7, 0, 0, 1, 7, 0x14, 5, 2, 7, 0xD0, 7, 3, 7, 1, 0, 4, 7, 0xDC, 5,
            5,
        ],
    ),
];

// The numbers are the operations in `host_bytes`.
const HOST_COURSES: &[Course] = &[
    (
        "greet-configure-arm-drive",
        &[
            1, 3, 6, 9, 3, 17, 10, 2, 21, 0, 0, 0, 0, 0, 0, 0xE0, 0x3F, 22, 15,
        ],
    ),
    ("drive-until-silent", &[5, 22, 8, 15, 30]),
    ("disarm", &[5, 22, 2, 18, 10, 1, 15, 8, 9, 4]),
    ("emergency-stop", &[5, 22, 2, 19, 10, 5, 9, 4]),
    ("board-restarts", &[5, 22, 2, 5, 1, 3, 6, 9, 4]),
    ("board-clock-restarts", &[5, 22, 2, 11, 0, 0, 0, 0, 1, 3, 6]),
    (
        "refusals",
        &[4, 8, 0, 2, 1, 1, 17, 8, 0, 2, 1, 7, 18, 8, 3, 3, 2, 3],
    ),
    ("another-version", &[1, 4, 0x63, 0, 15, 200, 3]),
    ("configuration-gone", &[5, 13, 1, 1, 2, 3, 4, 0, 0, 0]),
    ("hang-up", &[5, 17, 23, 1, 3, 6, 9, 2]),
    (
        "unanswered-arm",
        &[3, 17, 14, 0xFF, 0xFF, 14, 0xFF, 0xFF, 14, 0xFF, 0xFF],
    ),
    (
        "not-finite",
        &[5, 21, 0, 0, 0, 0, 0, 0, 0xF8, 0x7F, 0, 0, 0, 0, 0, 0, 0, 0],
    ),
    (
        "another-configuration",
        &[3, 20, 0x20, 3, 6, 9, 2, 20, 0, 0],
    ),
];

// The numbers are the operations in `natnet_packets`.
const NATNET_COURSES: &[Course] = &[
    (
        "greet-define-drive",
        &[0, 6, 3, 1, 6, 0, 0, 14, 0, 0, 6, 3, 7, 15],
    ),
    (
        "negotiate",
        &[8, 8, 3, 1, 8, 3, 0, 4, 0, 6, 1, 7, 0, 0, 0, 7, 15],
    ),
    ("negotiation-refused", &[8, 8, 3, 1, 8, 3, 0, 5]),
    ("not-supported", &[0, 6, 3, 0, 5, 1, 3, 0, 17, 0, 4]),
    (
        "jump",
        &[3, 6, 7, 5, 10, 0, 0, 0x80, 0x3F, 0, 0, 0, 0, 7, 5],
    ),
    (
        "lock-out",
        &[
            3, 6, 18, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 10, 0, 0, 0xA0, 0x40, 0, 0, 0, 0, 7, 15,
            7, 15,
        ],
    ),
    (
        "not-finite",
        &[3, 6, 10, 0, 0, 0xC0, 0x7F, 0, 0, 0x80, 0x7F],
    ),
    (
        "duplicate-id",
        &[
            3, 6, 11, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1,
        ],
    ),
    (
        "models-change",
        &[
            3, 6, 11, 2, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 1, 3, 6, 3, 7, 9,
        ],
    ),
    ("ambiguous-name", &[2, 6, 6, 2, 9, 0, 0, 0, 7, 5]),
    ("stranger", &[3, 6, 0xC2, 0xC3, 0xC0, 3, 1, 2, 3, 7, 5]),
    (
        "server-leaves",
        &[3, 6, 19, 17, 0, 4, 3, 1, 6, 3, 0, 6, 3, 7, 9],
    ),
    (
        "clock-backward",
        &[3, 6, 15, 0, 0, 0, 0, 0, 0, 0, 0, 1, 7, 9],
    ),
    (
        "clock-steps",
        &[3, 6, 14, 0xFF, 0x7F, 17, 0, 4, 14, 0, 0x80, 7, 15],
    ),
    (
        "numbers-restart",
        &[
            3, 6, 18, 0, 0, 0, 0, 0, 0, 0, 0x80, 1, 0, 0, 0, 7, 15, 7, 15,
        ],
    ),
    ("silence", &[3, 6, 17, 0x80, 0, 17, 0, 9]),
    ("no-clock", &[0, 0, 3, 1, 0, 2, 0, 6, 3, 7, 15]),
    (
        "y-up-multicast",
        &[23, 6, 7, 15, 12, 3, 60, 0, 0xFF, 61, 0, 0x7F, 90, 0, 1],
    ),
    ("ticks-wrap", &[35, 6, 7, 15, 14, 0, 0]),
];

fn seed(name: impl Into<String>, bytes: impl Into<Vec<u8>>) -> Seed {
    Seed {
        name: name.into(),
        bytes: bytes.into(),
    }
}

fn courses(courses: &[Course]) -> impl Iterator<Item = Seed> {
    courses
        .iter()
        .map(|&(name, bytes)| seed(format!("course-{name}"), bytes))
}

/// The golden frames in some initial states, and corrupted ones in the last state.
fn serial(
    golden: &[(&'static str, Frame)],
    stages: core::ops::Range<u8>,
    course: &[Course],
) -> Vec<Seed> {
    let bytes = |stage: u8, frame: &[u8]| {
        let length = u8::try_from(frame.len()).unwrap_or(u8::MAX);
        [&[stage, 0, length], frame].concat()
    };
    let last = stages.end - 1;
    let mut seeds: Vec<_> = courses(course).collect();
    for (name, frame) in golden {
        let frame = frame.as_bytes();
        for stage in [stages.start, last] {
            seeds.push(seed(
                format!("golden-{name}-at-{stage}"),
                bytes(stage, frame),
            ));
        }
        let middle = frame.len() / 2;
        let mut flipped = frame.to_vec();
        if let Some(byte) = flipped.get_mut(middle) {
            *byte ^= 1;
        }
        seeds.push(seed(format!("flipped-{name}"), bytes(last, &flipped)));
        // Half a frame, then a complete one.
        let cut = [frame.get(..middle).unwrap_or_default(), frame].concat();
        seeds.push(seed(format!("cut-{name}"), bytes(last, &cut)));
    }
    seeds
}

fn hello() -> Hello {
    Hello {
        protocol_version: VERSION,
        software_version: [0, 1, 0],
        nonce: 0x1234_5678,
    }
}

fn to_board() -> Vec<(&'static str, Frame)> {
    let request = Sequence(3);
    let messages: [(_, ToBoard); 7] = [
        ("hello", hello().into()),
        (
            "configure",
            Configure {
                request,
                configuration: CONFIGURATION,
            }
            .into(),
        ),
        (
            "arm",
            Arm {
                request,
                configuration_hash: CONFIGURATION.hash(),
                telemetry_time_us: 2_200_000,
            }
            .into(),
        ),
        ("disarm", Disarm { request }.into()),
        (
            "drive",
            Drive {
                sequence: Sequence(1),
                speed_mm_s: 400,
                steering_100urad: -3_000,
                telemetry_time_us: 2_200_000,
                pose_age_ms: 12,
                brake: false,
            }
            .into(),
        ),
        ("emergency-stop", EmergencyStop { request }.into()),
        (
            "jog",
            Jog {
                sequence: Sequence(2),
                telemetry_time_us: 2_200_000,
                servo_us: 1_400,
                esc_us: 1_560,
            }
            .into(),
        ),
    ];
    messages
        .map(|(name, message)| (name, message.encode()))
        .to_vec()
}

fn to_host() -> Vec<(&'static str, Frame)> {
    let sequence = Sequence(3);
    let request = Request::Arm;
    let messages: [(_, ToHost); 5] = [
        ("hello", hello().into()),
        (
            "telemetry",
            Telemetry {
                board_time_us: 7_100_000,
                mode: BoardMode::Driving,
                stop_cause: StopCause::CommandTimeout,
                last_sequence: Sequence(200),
                imu: ImuState::Fresh,
                imu_age_100us: 37,
                linear_acceleration_mm_s2: [-120, 981, 14],
                angular_velocity_mrad_s: [5, -6, 499],
                attitude_q14: [16_383, -3, 44, -2_048],
                motor_speed_mm_s: 401,
                servo_us: 1_222,
                esc_us: 1_561,
            }
            .into(),
        ),
        (
            "status",
            Status {
                board_time_us: 7_100_010,
                configuration_hash: CONFIGURATION.hash(),
                reset_cause: ResetCause::Watchdog,
                stop_input_open: true,
                battery_mv: 7_412,
                frames_received: 1_001,
                frames_damaged: 12,
                drives_refused: 3,
                last_refusal: RefusalReason::OutOfSequence,
                frames_dropped: 4,
                bytes_overrun: 5,
                imu_errors: 6,
                supply_mv: 5_000,
                battery_open: false,
                power_on: false,
                edges_refused: 0,
                imu_calibration: 0xFF,
                imu_status: 5,
                imu_error: 0,
                imu_self_test: 0x0F,
            }
            .into(),
        ),
        (
            "acknowledgement",
            Acknowledgement {
                request,
                sequence,
                configuration_hash: CONFIGURATION.hash(),
            }
            .into(),
        ),
        (
            "refusal",
            Refusal {
                request,
                sequence,
                reason: RefusalReason::Moving,
            }
            .into(),
        ),
    ];
    messages
        .map(|(name, message)| (name, message.encode()))
        .to_vec()
}

/// An empty frame in every layout, complete and truncated, and sequences of events.
fn natnet() -> Vec<Seed> {
    let mut seeds: Vec<_> = courses(NATNET_COURSES).collect();
    // The index in the table of versions of `natnet_packets`.
    for (index, (major, minor)) in [(0, (2, 7)), (3, (3, 0)), (6, (4, 1))] {
        let mut buffer = [0; 512];
        let frame = BitstreamVersion::new(major, minor).map(|version| {
            encode::frame(version, &encode::FrameContent::default(), &mut buffer)
                .unwrap_or_default()
        });
        let frame = buffer.get(..frame.unwrap_or_default()).unwrap_or_default();
        for (what, length) in [("whole", frame.len()), ("cut", frame.len() / 2)] {
            let length = u8::try_from(length).unwrap_or(u8::MAX);
            let bytes = [&[3, index, 0, length], frame].concat();
            seeds.push(seed(format!("frame-{major}.{minor}-{what}"), bytes));
        }
    }
    for id in [0_u8, 1, 2, 3, 5, 7, 8, 9, 13, 100] {
        seeds.push(seed(
            format!("message-{id}"),
            [3, 6, 1, id, 8, 1, 2, 3, 4, 5, 6, 7, 8],
        ));
    }
    seeds
}

/// Texts, and single changes of the example.
fn configuration() -> Vec<Seed> {
    let texts = [
        ("empty", ""),
        ("section", "[serial]\nport = \"/dev/ttyACM0\"\n"),
        ("dotted", "serial.port = \"a\"\nserial.baud = 1.5\n"),
        ("unknown", "colour = 1\n"),
        ("nested", "a = [[[[[[[[[[{ b = [[[[1]]]] }]]]]]]]]]]\n"),
        ("unclosed", "[serial\nport = \"\"\"x\n"),
        ("escape", "[serial]\nport = \"\\u0000\\uD7FF\"\n"),
        ("date", "[serial]\nport = 1979-05-27T07:32:00Z\n"),
        (
            "kinds",
            "[reference]\nkind = \"waypoints\"\nradius_m = 1.0\n",
        ),
    ];
    let mut seeds: Vec<_> = texts
        .map(|(name, text)| seed(format!("text-{name}"), [b"\0", text.as_bytes()].concat()))
        .to_vec();
    // Operation, line, value.
    for line in (0..128).step_by(6) {
        let value = line / 6;
        seeds.push(seed(format!("line-{line}"), [1, 1, line, value, 0, line]));
    }
    seeds
}

/// From the greeting to poses, with each protocol and transport, and single messages.
fn stream_messages() -> Vec<Seed> {
    let mut seeds = Vec::new();
    // The index in the table of protocols of `stream_messages`, and that of the transports.
    for (protocol, transport) in (0..3).flat_map(|protocol| [(protocol, 0), (protocol, 1)]) {
        // On the stream: the operation, a position, and the choices of the message.
        let message = |operation: u8, choice: u8, stamp: u8| -> Vec<u8> {
            let choices: &[u8] = match (protocol, operation) {
                (0, 4) => &[choice],
                (0, _) => &[choice, stamp, 0],
                (_, 10) => &[stamp, 0, choice],
                _ => &[],
            };
            [&[72 + operation, 0, 0, 0, 0], choices].concat()
        };
        let opened = [protocol, transport, 1, 0, 1];
        let mut bytes = opened.to_vec();
        // Names, types (2 is the pose's, 3 the answer's), and poses.
        for (operation, choice) in [(4, 0), (5, 2), (6, 3), (7, 0), (6, 0), (10, 1), (10, 2)] {
            bytes.extend(message(operation, choice, choice));
        }
        // A second, the stream's end, and another one.
        bytes.extend([0, 0, 4, 2, 0, 0, 1, 1, 0, 1]);
        seeds.push(seed(format!("course-{protocol}-{transport}"), bytes));
        let alone = (4..12).map(|operation| {
            let bytes = [&opened[..], &message(operation, 1, 2)].concat();
            seed(format!("message-{protocol}-{transport}-{operation}"), bytes)
        });
        seeds.extend(alone);
    }
    seeds
}

/// The lines of the protocol's description, and objects that resemble them.
fn page_head() -> Vec<Seed> {
    let heads = [
        ("root", "GET / HTTP/1.1\r\nHost: localhost:8767\r\n\r\n"),
        (
            "events",
            "GET /events?token=abc HTTP/1.1\r\nHost: 127.0.0.1:8767\r\nAccept: text/event-stream\r\n\r\n",
        ),
        ("head", "HEAD /page.js HTTP/1.0\r\n\r\n"),
        ("unfinished", "GET /setup.json HTTP/1.1\r\nHost: [::1"),
        ("stranger", "GET / HTTP/1.1\r\nHost: evil.example\r\n\r\n"),
        ("post", "POST / HTTP/1.1\r\nContent-Length: 3\r\n\r\nabc"),
        ("bare-line-feeds", "GET / HTTP/1.1\nHost: localhost\n\n"),
        ("no-head", "\u{0}\u{1}\u{2}\r\n\r\n"),
    ];
    let raw = heads.map(|(name, head)| Seed {
        name: format!("head-{name}"),
        bytes: [&[0], head.as_bytes()].concat(),
    });
    // The numbers choose from the parts of `page_head`.
    let parts = |name: String, target, header| Seed {
        name,
        bytes: vec![1, 1, 0, target, 0, header],
    };
    let targets = (0..7).map(|target| parts(format!("target-{target}"), target, 0));
    let headers = (0..10).map(|header| parts(format!("header-{header}"), 1, header));
    raw.into_iter().chain(targets).chain(headers).collect()
}

fn control_line() -> Vec<Seed> {
    let lines = [
        ("status", r#"{"version":3,"command":"status"}"#),
        (
            "arm",
            r#"{"version":3,"command":"arm","attendance":"hold"}"#,
        ),
        (
            "arm-timed",
            r#"{"version":3,"command":"arm","attendance":"timed","for_s":60}"#,
        ),
        ("hold", r#"{"version":3,"command":"hold"}"#),
        ("disarm", r#"{"version":3,"command":"disarm"}"#),
        ("stop", r#"{"command":"stop","version":3}"#),
        (
            "watch",
            r#"{"version":3,"command":"watch","topics":["tick","log"]}"#,
        ),
        (
            "set-reference",
            r#"{"version":3,"command":"set-reference","reference":{"kind":"circle","radius_m":1,"angular_velocity_rad_s":0.5}}"#,
        ),
        (
            "tune",
            r#"{"version":3,"command":"tune","gain_per_s":[2.0,1.5],"point_distance_m":0.4}"#,
        ),
        (
            "setpoint",
            r#"{"version":3,"command":"setpoint","velocity_m_s":[0.5,-1],"position_m":[2,3],"time_ns":400}"#,
        ),
        (
            "setpoint-actuation",
            r#"{"version":3,"command":"setpoint","steering_rad":0.1,"acceleration_m_s2":-1,"sequence":7}"#,
        ),
        (
            "setpoint-trajectory",
            r#"{"version":3,"command":"setpoint","trajectory":[{"time_ns":1000000000000,"position_m":[0,0],"velocity_m_s":[0,0]},{"time_ns":1000100000000,"position_m":[0.1,0],"velocity_m_s":[1,0]}]}"#,
        ),
        (
            "setpoint-too-large",
            r#"{"version":3,"command":"setpoint","velocity_m_s":[1e999,0]}"#,
        ),
        ("version", r#"{"version":3,"command":"status"}"#),
        ("escape", r#"{"version":3,"command":"\u0073tatus"}"#),
        ("twice", r#"{"version":3,"version":3,"command":"arm"}"#),
        ("nested", "[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[["),
        ("empty", ""),
        ("no-object", "arm"),
    ];
    let mut seeds: Vec<_> = lines
        .map(|(name, line)| seed(format!("line-{name}"), [b"\0", line.as_bytes()].concat()))
        .to_vec();
    // Key and value, then the next key and its value.
    for command in 6..13 {
        for key in [2, 4] {
            let bytes = [1, 1, 1, command, key, 13, key + 1, 18];
            seeds.push(seed(format!("object-{command}-{key}"), bytes));
        }
    }
    seeds
}

#[cfg(test)]
mod tests {
    use crate::TARGETS;

    #[test]
    fn every_target_has_seeds_with_distinct_names() {
        for target in TARGETS {
            let seeds = super::seeds(target.name);
            let mut names: Vec<_> = seeds.iter().map(|seed| &seed.name).collect();
            names.sort_unstable();
            names.dedup();
            assert_eq!(names.len(), seeds.len(), "{}", target.name);
            assert!(seeds.len() >= 24, "{}: {}", target.name, seeds.len());
        }
        assert!(super::seeds("unknown").is_empty());
    }
}
