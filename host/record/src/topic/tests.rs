//! The encoded bytes, checked by hand and against the schema.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test may fail"
)]

use std::collections::BTreeMap;

use singletrack_protocol::{
    BoardMode, ImuState, RefusalReason, ResetCause, Sequence, Status, StopCause, Telemetry,
};

use super::*;
use crate::{Drops, Level, Log, StatusRecord, TelemetryRecord};

fn encoded(entry: &Entry) -> Vec<u8> {
    let mut bytes = Vec::new();
    entry.encode(&mut bytes).unwrap();
    bytes
}

pub(crate) fn telemetry() -> Entry {
    Entry::Telemetry(TelemetryRecord {
        receive_time_ns: 0x0102_0304_0506_0708,
        board_time_host_ns: 7,
        imu_time_host_ns: Some(9),
        telemetry: Telemetry {
            board_time_us: 0xa1a2_a3a4,
            mode: BoardMode::Driving,
            stop_cause: StopCause::None,
            last_sequence: Sequence(200),
            imu: ImuState::Fresh,
            imu_age_100us: 12,
            linear_acceleration_mm_s2: [1, -2, 3],
            angular_velocity_mrad_s: [4, 5, -6],
            attitude_q14: [16384, 0, 0, -1],
            motor_speed_mm_s: 400,
            servo_us: 1500,
            esc_us: 1560,
        },
    })
}

#[test]
fn a_log_line_is_encoded_as_in_the_standard() {
    let entry = Entry::Log(Log {
        time_ns: 1,
        level: Level::Warning,
        text: "ab".to_owned(),
    });
    let expected = [
        &[0, 1, 0, 0][..],            // plain CDR, little-endian
        &[1, 0, 0, 0, 0, 0, 0, 0],    // time_ns
        &[30],                        // level
        &[0, 0, 0],                   // to a multiple of four from the header's end
        &[3, 0, 0, 0, b'a', b'b', 0], // length with the NUL
    ]
    .concat();
    assert_eq!(encoded(&entry), expected);
}

#[test]
fn telemetry_is_aligned_from_the_end_of_the_header() {
    let bytes = encoded(&telemetry());
    let expected = [
        &[0, 1, 0, 0][..],
        &[8, 7, 6, 5, 4, 3, 2, 1],
        &[7, 0, 0, 0, 0, 0, 0, 0],
        &[1],    // has_imu_time_host_ns
        &[0; 7], // eight bytes are aligned to eight
        &[9, 0, 0, 0, 0, 0, 0, 0],
        &[0xa4, 0xa3, 0xa2, 0xa1],
        &[4, 1, 200, 2, 12], // mode, stop cause, sequence, IMU, its age
        &[0],                // two bytes are aligned to two
        &[1, 0, 0xfe, 0xff, 3, 0],
        &[4, 0, 5, 0, 0xfa, 0xff],
        &[0x00, 0x40, 0, 0, 0, 0, 0xff, 0xff],
        &[0x90, 0x01, 0xdc, 0x05, 0x18, 0x06],
    ]
    .concat();
    assert_eq!(bytes, expected);
}

/// A reader of CDR that knows only the text of the schema.
pub(crate) struct BySchema<'a> {
    definitions: BTreeMap<String, Vec<(String, String)>>,
    bytes: &'a [u8],
    at: usize,
    seen: Vec<(String, f64)>,
}

impl<'a> BySchema<'a> {
    /// All numbers in a message, by their paths; for a list and a text, the length.
    pub(crate) fn read(text: &str, bytes: &'a [u8]) -> Vec<(String, f64)> {
        let mut definitions = BTreeMap::new();
        for (index, part) in text.split(&"=".repeat(80)).enumerate() {
            let mut lines = part.lines().filter(|line| !line.is_empty());
            let name = if index == 0 {
                "root".to_owned()
            } else {
                lines
                    .next()
                    .unwrap()
                    .strip_prefix("MSG: ")
                    .unwrap()
                    .to_owned()
            };
            let fields = lines
                .filter(|line| !line.starts_with('#') && !line.contains('='))
                .map(|line| {
                    let (kind, field) = line.split_once(' ').unwrap();
                    (kind.to_owned(), field.to_owned())
                })
                .collect();
            assert!(definitions.insert(name, fields).is_none());
        }
        let mut reader = Self {
            definitions,
            bytes: bytes.strip_prefix(&message::ENCAPSULATION).unwrap(),
            at: 0,
            seen: Vec::new(),
        };
        reader.message("root", "");
        assert_eq!(reader.at, reader.bytes.len(), "bytes are left of {text}");
        reader.seen
    }

    fn take<const N: usize>(&mut self) -> [u8; N] {
        self.at = self.at.next_multiple_of(N);
        let bytes = self.bytes[self.at..self.at + N].try_into().unwrap();
        self.at += N;
        bytes
    }

    fn message(&mut self, kind: &str, prefix: &str) {
        let fields = self.definitions.get(kind).expect(kind).clone();
        for (kind, name) in fields {
            let path = format!("{prefix}{name}");
            if let Some(element) = kind.strip_suffix("[]") {
                let length = u32::from_le_bytes(self.take());
                self.seen.push((path.clone(), f64::from(length)));
                for index in 0..length {
                    self.message(element, &format!("{path}[{index}]."));
                }
                continue;
            }
            if let Some((element, length)) = kind.split_once('[') {
                assert_eq!(element, "float64");
                for index in 0..length.strip_suffix(']').unwrap().parse::<usize>().unwrap() {
                    let value = f64::from_le_bytes(self.take());
                    self.seen.push((format!("{path}[{index}]"), value));
                }
                continue;
            }
            let value = match kind.as_str() {
                "bool" | "byte" | "uint8" => f64::from(self.take::<1>()[0]),
                "uint16" => f64::from(u16::from_le_bytes(self.take())),
                "uint32" => f64::from(u32::from_le_bytes(self.take())),
                "uint64" => u64::from_le_bytes(self.take()) as f64,
                "int16" => f64::from(i16::from_le_bytes(self.take())),
                "int32" => f64::from(i32::from_le_bytes(self.take())),
                "int64" => i64::from_le_bytes(self.take()) as f64,
                "float32" => f32::from_le_bytes(self.take()).into(),
                "float64" => f64::from_le_bytes(self.take()),
                "string" => {
                    let length = u32::from_le_bytes(self.take()) as usize;
                    self.at += length;
                    assert_eq!(self.bytes[self.at - 1], 0);
                    length as f64
                }
                message => {
                    self.message(message, &format!("{path}."));
                    continue;
                }
            };
            self.seen.push((path, value));
        }
    }
}

#[test]
fn the_schema_alone_suffices_to_read_the_bytes() {
    let status = Entry::Status(StatusRecord {
        receive_time_ns: 5,
        status: Status {
            board_time_us: 6,
            configuration_hash: 0xdead_beef,
            reset_cause: ResetCause::Watchdog,
            stop_input_open: true,
            battery_mv: 7400,
            frames_received: 8,
            frames_damaged: 9,
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
    });
    let drops = Entry::Drops(Drops {
        time_ns: 1,
        entries: 2,
    });
    for entry in [telemetry(), status, drops] {
        // Fields are printed with the names and in the order of the schema.
        let fields = entry.topic().fields();
        let read: Vec<_> = BySchema::read(&entry.topic().schema_text(), &encoded(&entry))
            .into_iter()
            .filter(|(path, _)| !path.starts_with("has_"))
            .collect();
        let names: Vec<_> = read.iter().map(|(path, _)| path.clone()).collect();
        assert_eq!(names, fields);
        for ((path, raw), shown) in read.iter().zip(entry.values()) {
            match shown {
                Value::Unsigned(value) => assert_eq!(value as f64, *raw, "{path}"),
                Value::Signed(value) => assert_eq!(value as f64, *raw, "{path}"),
                Value::Bool(value) => assert_eq!(f64::from(u8::from(value)), *raw, "{path}"),
                Value::Text(word) => {
                    let constant = format!("_{}={raw}\n", word.to_uppercase().replace('-', "_"));
                    assert!(
                        entry.topic().schema_text().contains(&constant),
                        "{constant}"
                    );
                }
                Value::Float(_) | Value::Absent => panic!("{path} is {shown:?}"),
            }
        }
    }
}

#[test]
fn the_schema_of_a_tick_describes_its_bytes_with_and_without_optional_fields() {
    for tick in [crate::tick::tests::full(), crate::tick::tests::empty()] {
        let entry = Entry::Tick(tick);
        let read = BySchema::read(&Topic::Tick.schema_text(), &encoded(&entry));
        let names: Vec<_> = read
            .iter()
            .map(|(path, _)| path.clone())
            .filter(|path| {
                !path.contains('[') && !path.split('.').any(|part| part.starts_with("has_"))
            })
            .collect();
        assert_eq!(names, Topic::Tick.fields());
        let at = |name: &str| {
            read.iter()
                .find_map(|(path, value)| (path == name).then_some(*value))
                .unwrap()
        };
        let Entry::Tick(tick) = &entry else {
            panic!("not a tick");
        };
        assert_eq!(at("lateness_ns"), tick.lateness_ns() as f64);
        assert_eq!(at("events"), tick.events.len() as f64);
        match tick.output.estimate {
            Some(estimate) => assert_eq!(at("estimate.yaw_rad"), estimate.yaw),
            None => {
                assert_eq!(at("has_estimate"), 0.0);
                assert!(at("estimate.yaw_rad").is_nan(), "a gap in every plot");
            }
        }
    }
}

#[test]
fn schemas_have_only_names_and_types_that_ros_allows() {
    for channel in crate::Channel::all() {
        for line in channel.schema_text().lines() {
            if line.is_empty() || line.starts_with(['#', '=']) || line.starts_with("MSG: ") {
                continue;
            }
            let (_, name) = line.split_once(' ').expect(line);
            let (name, constant) = match name.split_once('=') {
                Some((name, value)) => {
                    value.parse::<u8>().expect(line);
                    (name, true)
                }
                None => (name, false),
            };
            assert!(!name.contains("__") && !name.ends_with('_'), "{line}");
            assert!(
                name.chars().all(|character| character == '_'
                    || character.is_ascii_digit()
                    || if constant {
                        character.is_ascii_uppercase()
                    } else {
                        character.is_ascii_lowercase()
                    }),
                "{line}"
            );
        }
    }
}

#[test]
fn a_message_with_an_unknown_code_is_refused_by_name() {
    let mut bytes = encoded(&telemetry());
    let mode = 4 + 8 + 8 + 8 + 8 + 4;
    assert_eq!(bytes[mode], 4);
    bytes[mode] = 77;
    assert_eq!(
        Entry::decode(Topic::Telemetry, &bytes),
        Err("77 is none of the MODE_ constants".to_owned())
    );
}

#[test]
fn a_message_that_is_too_long_or_too_short_is_refused() {
    let bytes = encoded(&telemetry());
    for length in 0..bytes.len() {
        assert!(Entry::decode(Topic::Telemetry, &bytes[..length]).is_err());
    }
    let longer = [&bytes[..], &[0]].concat();
    assert!(Entry::decode(Topic::Telemetry, &longer).is_err());
    let mut big_endian = bytes;
    big_endian[1] = 0;
    assert!(Entry::decode(Topic::Telemetry, &big_endian).is_err());
}

#[test]
fn json_escapes_texts_and_shows_absent_values_as_null() {
    let mut json = String::new();
    Entry::Log(Log {
        time_ns: u64::MAX,
        level: Level::Error,
        text: "a \"quoted\"\\ line\n\u{1}ü".to_owned(),
    })
    .write_json(&mut json);
    let value: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(value["topic"], "log");
    assert_eq!(value["time_ns"], u64::MAX);
    assert_eq!(value["text"], "a \"quoted\"\\ line\n\u{1}ü");

    json.clear();
    Entry::Tick(crate::tick::tests::empty()).write_json(&mut json);
    let value: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert!(value["estimate"].is_null());
    assert_eq!(value["mode"], "disconnected");

    json.clear();
    Entry::Tick(crate::tick::tests::full()).write_json(&mut json);
    let value: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(value["estimate"]["yaw_rad"], 0.1 + 0.2);
    assert_eq!(value["events"][0]["pose"]["frame"], 17);
}

#[test]
fn each_channel_is_at_its_index() {
    for (place, channel) in Channel::all().enumerate() {
        assert_eq!(channel.index(), place, "{}", channel.topic());
    }
    assert_eq!(Channel::all().count(), Channel::COUNT);
}
