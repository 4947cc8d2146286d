//! What a client sends: a line of JSON each.

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::{
    SOCKET_VERSION,
    explain::{duplicate, explain, no_object},
};

/// A command of a client.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "command", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Request {
    /// The status of daemon, board and figures.
    Status {},
    /// The daemon's clocks.
    Clock {},
    /// Arm, and follow the reference or jog.
    Arm(Arm),
    /// Renews the drive that this connection holds; only a failure is answered.
    Hold {},
    /// Pulses for servo and ESC while this connection jogs, which they renew; only a failure is
    /// answered.
    Jog {
        /// Pulse of the servo, in µs.
        servo_us: u16,
        /// Pulse of the ESC, in µs.
        esc_us: u16,
    },
    /// Slow down, stop and disarm.
    Disarm {
        /// Neutral at once, without a ramp.
        #[serde(default, skip_serializing_if = "is_false")]
        at_once: bool,
        /// The body that the cameras show is the car, which was carried.
        #[serde(default, skip_serializing_if = "is_false")]
        carried: bool,
    },
    /// Emergency stop: neutral at once, until the board is reset.
    Stop {},
    /// Another reference, with the keys of `[reference]` in the configuration.
    SetReference {
        /// The table.
        reference: Value,
    },
    /// Read the configuration's file again.
    Reload {},
    /// The configuration in force.
    Configuration {},
    /// Other values of what can be tuned.
    Tune(Tune),
    /// A set-point, answered only if it is rejected.
    Setpoint(Setpoint),
    /// The state of a procedure.
    Commissioned {
        /// `doctor`, `bring-up` or `calibrate`.
        procedure: String,
        /// `begun`, `resumed`, `changed`, `passed` or `failed`.
        result: String,
        /// Begin it also if an earlier procedure has not passed.
        #[serde(default, skip_serializing_if = "is_false")]
        uncalibrated: bool,
    },
    /// A subscription: the entries of the record with these topics, or the state of every tick.
    Watch {
        /// The topics; empty for all, `state` alone for the states.
        #[serde(default)]
        topics: Vec<String>,
    },
    /// A subscription to messages as ROS 2 encodes them.
    Messages {
        /// Their topics; empty for all.
        #[serde(default)]
        topics: Vec<String>,
    },
}

/// A request to arm.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Arm {
    /// Who attends the drive: the daemon refuses a request without.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub attendance: Option<Attendance>,
    /// The length of a timed drive, in s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub for_s: Option<f64>,
    /// The longest time between two renewals of a held drive, in ms.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hold_ms: Option<u64>,
    /// When the reference of a held drive begins, on the daemon's `CLOCK_MONOTONIC`. Until then the
    /// armed car stands.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub start_ns: Option<u64>,
    /// Whether the client gives pulses in place of a drive.
    #[serde(default, skip_serializing_if = "is_false")]
    pub jog: bool,
    /// Whether the car may drive without having passed doctor, bring-up and calibrate.
    #[serde(default, skip_serializing_if = "is_false")]
    pub uncalibrated: bool,
}

/// Who attends a drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Attendance {
    /// The client, which renews the drive every 100 ms on the same connection.
    Hold,
    /// No client; the drive ends after a time.
    Timed,
    /// No client; the drive continues until a stop.
    Unattended,
}

/// What may be tuned.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tune {
    /// The gain of the position loop, per second.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gain_per_s: Option<Gain>,
    /// p, in m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub point_distance_m: Option<f64>,
}

/// A gain for both axes, or one for each.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged, try_from = "Value")]
pub enum Gain {
    /// For both.
    Both(f64),
    /// Along x and y.
    Each([f64; 2]),
}

impl Gain {
    /// Along x and y.
    pub const fn each(self) -> [f64; 2] {
        match self {
            Self::Both(gain) => [gain, gain],
            Self::Each(gains) => gains,
        }
    }
}

impl TryFrom<Value> for Gain {
    type Error = String;

    fn try_from(given: Value) -> Result<Self, String> {
        let both = given.as_f64().map(Self::Both);
        let each = || <[f64; 2]>::deserialize(&given).ok().map(Self::Each);
        both.or_else(each).ok_or_else(|| {
            format!("gain_per_s is {given}: give a number, or two for x and y, such as [2.0, 2.0]")
        })
    }
}

/// A set-point: a velocity of P, or steering and speed, or a trajectory.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Setpoint {
    /// Velocity of P in the cameras' frame, in m/s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub velocity_m_s: Option<[f64; 2]>,
    /// Position of P, in m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position_m: Option<[f64; 2]>,
    /// Steering angle, in rad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub steering_rad: Option<f64>,
    /// Steering rate, in rad/s; beside an angle the largest one to either side.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub steering_rate_rad_s: Option<f64>,
    /// Speed of the centre of mass, in m/s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub speed_m_s: Option<f64>,
    /// Speed of the rear axle, in m/s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rear_speed_m_s: Option<f64>,
    /// Change of the speed, in m/s².
    #[serde(skip_serializing_if = "Option::is_none")]
    pub acceleration_m_s2: Option<f64>,
    /// Points in time.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub trajectory: Option<Vec<TrajectoryPoint>>,
    /// When it was decided, on `CLOCK_MONOTONIC`; otherwise when the daemon read it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub time_ns: Option<u64>,
    /// Its number, which grows within a connection.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sequence: Option<u32>,
}

/// A point of a trajectory of P.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrajectoryPoint {
    /// When P is there, on `CLOCK_MONOTONIC`.
    pub time_ns: u64,
    /// Position, in m.
    pub position_m: [f64; 2],
    /// Velocity, in m/s.
    pub velocity_m_s: [f64; 2],
}

/// Why a line is no request, or a request no line: a text which says what to write instead.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct RequestError(pub String);

/// A line as it is sent.
#[derive(Serialize, Deserialize)]
struct Line<R> {
    version: u32,
    #[serde(flatten)]
    request: R,
}

/// A line whose command is a word.
#[derive(Deserialize)]
struct Named {
    #[serde(rename = "command")]
    _command: String,
}

impl Request {
    /// A disarm with a ramp, of a car that was not carried.
    pub const DISARM: Self = Self::Disarm {
        at_once: false,
        carried: false,
    };

    /// Reads a line.
    ///
    /// # Errors
    ///
    /// The line is no request, or of another version.
    pub fn parse(line: &[u8]) -> Result<Self, RequestError> {
        let parsed = serde_json::from_slice::<Line<Self>>(line);
        let error = match parsed.or_else(|error| without_nulls(line).ok_or(error)) {
            Ok(given) if given.version == SOCKET_VERSION => {
                // serde takes the number of a command for its word.
                let named = serde_json::from_slice::<Named>(line);
                let text = "command takes a word in quotes";
                return named
                    .map(|_| given.request)
                    .map_err(|_| with_example(None, text));
            }
            Ok(line) => return Err(other_version(line.version)),
            Err(error) => error,
        };
        let keys = match serde_json::from_slice::<Map<String, Value>>(line) {
            Ok(keys) => keys,
            Err(error) => {
                let text = String::from_utf8_lossy(line);
                let after = text.split_once("\"command\":\"").map(|(_, after)| after);
                let command = after.and_then(|after| after.split('"').next());
                return Err(with_example(command, &no_object(line, &error)));
            }
        };
        let version = keys.get("version");
        match version.map(|version| (version, version.as_u64())) {
            Some((_, Some(version))) if version == u64::from(SOCKET_VERSION) => {}
            Some((_, Some(version))) => return Err(other_version(version)),
            Some((version, None)) => {
                let text = format!("version is {version}: it takes the number {SOCKET_VERSION}");
                return Err(with_example(None, &text));
            }
            None => return Err(with_example(None, "version is missing")),
        }
        let command = keys.get("command").and_then(Value::as_str);
        let what = duplicate(&error.to_string())
            .or_else(|| explain::<Line<Self>>(&keys, &["command", "version"], ""))
            .unwrap_or_else(|| error.to_string());
        Err(with_example(command, &what))
    }

    /// The line, with its end.
    ///
    /// # Errors
    ///
    /// A number is not finite: JSON would have null in its place, which counts as left out.
    pub fn to_line(&self) -> Result<String, RequestError> {
        let line = Line {
            version: SOCKET_VERSION,
            request: self,
        };
        let (written, values) = serde_json::to_string(&line)
            .and_then(|written| Ok((written, serde_json::to_value(&line)?)))
            .map_err(|error| RequestError(error.to_string()))?;
        if has_null(&values) {
            let text =
                "a number of the request is not finite, or a value is null: nothing was sent";
            return Err(RequestError(text.to_owned()));
        }
        Ok(written + "\n")
    }
}

/// Whether a JSON value is null, or holds a null.
pub fn has_null(value: &Value) -> bool {
    match value {
        Value::Null => true,
        Value::Array(values) => values.iter().any(has_null),
        Value::Object(keys) => keys.values().any(has_null),
        _ => false,
    }
}

/// The line without the keys that are null: programs write those of every command, and leave null
/// what they don't mean. None if it is no request even so.
fn without_nulls(line: &[u8]) -> Option<Line<Request>> {
    let keys: Map<String, Value> = serde_json::from_slice(line).ok()?;
    let count = keys.len();
    let given = keys.into_iter().filter(|(_, value)| !value.is_null());
    let given: Map<_, _> = given.collect();
    if given.len() == count {
        return None;
    }
    serde_json::from_value(given.into()).ok()
}

/// What is wrong with a line, and what to write for this command.
fn with_example(command: Option<&str>, what: &str) -> RequestError {
    let example = command.and_then(|command| {
        let name = format!("\"command\":\"{command}\"");
        let example = EXAMPLES.into_iter().find(|line| line.contains(&name));
        Some((command, example?))
    });
    RequestError(match example {
        Some((command, example)) => format!("{command}: {what}; write {example}"),
        None => format!("{what}; write {}", EXAMPLES[0]),
    })
}

fn other_version(version: impl Into<u64>) -> RequestError {
    let version = version.into();
    RequestError(format!(
        "version is {version}: this daemon speaks version {SOCKET_VERSION}; use the singletrack \
         of its release"
    ))
}

/// A line of every command, as in the table of the documentation, which has the answers, too.
pub const EXAMPLES: [&str; 19] = [
    r#"{"version":3,"command":"status"}"#,
    r#"{"version":3,"command":"clock"}"#,
    r#"{"version":3,"command":"arm","attendance":"hold"}"#,
    r#"{"version":3,"command":"hold"}"#,
    r#"{"version":3,"command":"arm","attendance":"hold","jog":true}"#,
    r#"{"version":3,"command":"jog","servo_us":1500,"esc_us":1500}"#,
    r#"{"version":3,"command":"reload"}"#,
    r#"{"version":3,"command":"configuration"}"#,
    r#"{"version":3,"command":"disarm"}"#,
    r#"{"version":3,"command":"disarm","at_once":true}"#,
    r#"{"version":3,"command":"disarm","carried":true}"#,
    r#"{"version":3,"command":"stop"}"#,
    r#"{"version":3,"command":"set-reference","reference":{"kind":"circle","radius_m":1.0,"angular_velocity_rad_s":0.5}}"#,
    r#"{"version":3,"command":"setpoint","velocity_m_s":[0.4,0.0]}"#,
    r#"{"version":3,"command":"tune","gain_per_s":2.0,"point_distance_m":0.4}"#,
    r#"{"version":3,"command":"commissioned","procedure":"doctor","result":"passed"}"#,
    r#"{"version":3,"command":"watch","topics":["tick"]}"#,
    r#"{"version":3,"command":"messages","topics":["/odom"]}"#,
    r#"{"version":3,"command":"watch","topics":["state"]}"#,
];

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde asks for it")]
const fn is_false(flag: &bool) -> bool {
    !*flag
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may fail")]
mod tests {
    use super::*;

    #[test]
    fn every_example_is_a_request_and_is_written_as_one() {
        for line in EXAMPLES {
            let request = Request::parse(line.as_bytes()).unwrap();
            let written = request.to_line().unwrap();
            let values = [line, &written].map(|line| serde_json::from_str::<Value>(line).unwrap());
            assert_eq!(values[0], values[1]);
        }
    }

    #[test]
    fn the_number_of_a_command_is_not_its_word() {
        for number in 0..20 {
            for keys in ["", ",\"servo_us\":1500,\"esc_us\":1500"] {
                let line = format!("{{\"version\":3,\"command\":{number}{keys}}}\n");
                let error = Request::parse(line.as_bytes()).unwrap_err();
                assert!(!error.to_string().is_empty(), "{line}");
            }
        }
        let error = Request::parse(b"{\"version\":3,\"command\":2}").unwrap_err();
        assert!(error.to_string().contains("a word in quotes"), "{error}");
    }

    #[test]
    fn a_number_that_is_not_finite_is_no_value_that_was_left_out() {
        let requests = |number| {
            [
                Request::Tune(Tune {
                    point_distance_m: Some(number),
                    ..Tune::default()
                }),
                Request::Setpoint(Setpoint {
                    velocity_m_s: Some([0.1, number]),
                    ..Setpoint::default()
                }),
                Request::Arm(Arm {
                    for_s: Some(number),
                    ..Arm::default()
                }),
                Request::SetReference {
                    reference: serde_json::json!({ "kind": "circle", "radius_m": number }),
                },
            ]
        };
        assert!(requests(0.4).iter().all(|one| one.to_line().is_ok()));
        for number in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            for request in requests(number) {
                let error = request.to_line().unwrap_err().to_string();
                assert!(error.contains("not finite"), "{error}");
            }
        }
    }

    #[test]
    fn a_key_that_is_null_is_as_one_that_is_left_out() {
        for (line, request) in [
            (
                r#"{"version":3,"command":"disarm","at_once":null,"attendance":null}"#,
                Request::DISARM,
            ),
            (
                r#"{"version":3,"command":"stop","velocity_m_s":null}"#,
                Request::Stop {},
            ),
            (
                r#"{"version":3,"command":"watch","topics":null}"#,
                Request::Watch { topics: vec![] },
            ),
        ] {
            assert_eq!(Request::parse(line.as_bytes()), Ok(request), "{line}");
        }
        for line in [
            r#"{"version":3,"command":"stop","velocity_m_s":null,"now":1}"#,
            r#"{"version":3,"command":null}"#,
        ] {
            assert!(Request::parse(line.as_bytes()).is_err(), "{line}");
        }
    }

    /// With `SINGLETRACK_RENEW` set, the table is written.
    #[test]
    fn the_documentation_has_the_table_of_the_examples() {
        let page = include_str!("../../../docs/control-socket.md");
        let head = "| to the daemon | from the daemon |\n|---|---|\n";
        let (_, rest) = page.split_once(head).unwrap();
        let (table, _) = rest.split_once("\n\n").unwrap();
        let line = |row: &'static str| row.strip_prefix("| `")?.split_once("` | ");
        let lines: Vec<_> = table.lines().map(|row| line(row).unwrap().0).collect();
        assert_eq!(lines, EXAMPLES);
    }

    #[test]
    fn the_documentation_names_every_code_of_a_refusal() {
        let page = include_str!("../../../docs/control-socket.md");
        let (_, table) = page.split_once("| code | the request |\n").unwrap();
        let (table, _) = table.split_once("\n\n").unwrap();
        for code in crate::Code::ALL {
            assert!(table.contains(&format!("`{code}`")), "{code}");
        }
        let newer: crate::Code = serde_json::from_str("\"melted\"").unwrap();
        assert_eq!(newer, crate::Code::Other);
    }

    #[test]
    fn a_line_of_another_version_is_told_so_whatever_it_holds() {
        for line in [
            r#"{"version":4,"command":"fly","fast":true}"#,
            r#"{"version":1,"command":"status"}"#,
        ] {
            let error = Request::parse(line.as_bytes()).unwrap_err().to_string();
            assert!(error.contains("this daemon speaks version 3"), "{error}");
        }
    }
}
