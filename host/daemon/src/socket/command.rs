//! Parses a client's line into a command.

use core::{str::FromStr, time::Duration};

use serde::Deserialize;
use singletrack_core::{
    commissioned::{Procedure, ProcedureResult},
    config::ReferenceSection,
};
use singletrack_pilot::Jog;
use singletrack_record::Topic;

use super::setpoint::{PointKeys, Rejected, SetpointCommand, SetpointKeys, unreadable};

/// The version of the protocol. Client and daemon must have the same one.
pub const SOCKET_VERSION: u32 = 2;

/// A command of a client.
#[derive(Clone, Debug, PartialEq)]
pub enum Command {
    /// A question or request, answered by one line.
    Ask(Question),
    /// Arm, and follow the reference; answered when the car drives or can't be armed.
    Arm(Arm),
    /// Arm to jog, held by this connection; answered when the board takes pulses or can't be
    /// armed.
    ArmJog,
    /// Pulses for servo and ESC while this connection jogs, which they renew; not answered.
    Jog(Jog),
    /// Renews the drive that this connection holds; not answered.
    Hold,
    /// Read the configuration's file again, answered by one line when it is in force or
    /// refused.
    Reload,
    /// A new reference, answered by one line when it is in force or refused.
    SetReference(ReferenceSection),
    /// A set-point, answered only if it has no effect.
    Setpoint(SetpointCommand),
    /// What became of a procedure, answered by one line when it is kept.
    Commissioned {
        /// The procedure.
        procedure: Procedure,
        /// What became of it.
        result: ProcedureResult,
    },
    /// A subscription, answered by a stream of entries.
    Watch {
        /// The topics; empty for all.
        topics: Vec<Topic>,
    },
    /// A subscription to the state of every tick.
    WatchState,
}

/// Why a line is no command: the text of the answer, which says what to write instead.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ParseError {
    text: String,
    /// The line is a set-point, and rejected with this word.
    pub(super) rejected: Option<Rejected>,
}

impl core::fmt::Display for ParseError {
    fn fmt(&self, formatter: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        formatter.write_str(&self.text)
    }
}

impl core::error::Error for ParseError {}

impl From<String> for ParseError {
    fn from(text: String) -> Self {
        Self {
            text,
            rejected: None,
        }
    }
}

impl From<&str> for ParseError {
    fn from(text: &str) -> Self {
        text.to_owned().into()
    }
}

impl From<Rejected> for ParseError {
    fn from(rejected: Rejected) -> Self {
        Self {
            text: rejected.text.clone(),
            rejected: Some(rejected),
        }
    }
}

/// A request to arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Arm {
    /// Who attends the drive.
    pub attendance: Attendance,
    /// Whether the car may drive without having passed doctor, bring-up and calibrate.
    pub uncalibrated: bool,
}

/// Who attends a drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Attendance {
    /// The client: the drive ends when it stops to renew it, or when its connection ends.
    Hold,
    /// No client; the drive ends after this time.
    Timed(Duration),
    /// No client; the drive continues until a stop.
    Unattended,
}

/// A command without arguments.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Question {
    /// The status of daemon, board and figures.
    Status,
    /// Slow down, stop and disarm.
    Disarm,
    /// Disarm at once: neutral without a ramp.
    Halt,
    /// Emergency stop: neutral at once, until the board is reset.
    Stop,
}

/// The keys of a line, before validation.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Line {
    version: u32,
    command: String,
    attendance: Option<String>,
    for_s: Option<f64>,
    uncalibrated: Option<bool>,
    procedure: Option<String>,
    result: Option<String>,
    topics: Option<Vec<String>>,
    reference: Option<ReferenceSection>,
    velocity_m_s: Option<[f64; 2]>,
    position_m: Option<[f64; 2]>,
    steering_rad: Option<f64>,
    steering_rate_rad_s: Option<f64>,
    speed_m_s: Option<f64>,
    acceleration_m_s2: Option<f64>,
    trajectory: Option<Vec<PointKeys>>,
    time_ns: Option<u64>,
    sequence: Option<u32>,
    jog: Option<bool>,
    servo_us: Option<u16>,
    esc_us: Option<u16>,
    at_once: Option<bool>,
}

/// The shortest and the longest time of a timed drive, s.
const MIN_TIME: f64 = 0.5;
const MAX_TIME: f64 = 86_400.0;

impl Command {
    /// Parses a line that was read at `now_ns` of `CLOCK_MONOTONIC`.
    ///
    /// # Errors
    ///
    /// The text of the answer: what is wrong, and what to write instead.
    pub fn parse(line: &[u8], now_ns: u64) -> Result<Self, ParseError> {
        let mut line: Line = serde_json::from_slice(line).map_err(|error| {
            let text =
                format!("{error}; write {{\"version\":{SOCKET_VERSION},\"command\":\"status\"}}");
            match unreadable(line, &error) {
                Some(why) => Rejected { why, text }.into(),
                None => ParseError::from(text),
            }
        })?;
        if line.version != SOCKET_VERSION {
            return Err(format!(
                "version is {}: this daemon speaks version {SOCKET_VERSION}; use the singletrack of its release",
                line.version
            )
            .into());
        }
        let command = match line.command.as_str() {
            "status" => Self::Ask(Question::Status),
            "arm" => {
                let jogs = line.jog.take().unwrap_or(false);
                let uncalibrated = line.uncalibrated.take().unwrap_or(false);
                match line.take_attendance()? {
                    Attendance::Hold if jogs => Self::ArmJog,
                    _ if jogs => {
                        return Err("jogging must be held: \"attendance\":\"hold\"".into());
                    }
                    attendance => Self::Arm(Arm {
                        attendance,
                        uncalibrated,
                    }),
                }
            }
            "hold" => Self::Hold,
            "jog" => Self::Jog(line.take_jog()?),
            "reload" => Self::Reload,
            "disarm" => match line.at_once.take() {
                Some(true) => Self::Ask(Question::Halt),
                Some(false) | None => Self::Ask(Question::Disarm),
            },
            "stop" => Self::Ask(Question::Stop),
            "set-reference" => {
                let missing = "set-reference needs a reference, such as {\"kind\":\"circle\",\
                               \"radius_m\":1.0,\"angular_velocity_rad_s\":0.5}";
                Self::SetReference(line.reference.take().ok_or(missing)?)
            }
            "setpoint" => Self::Setpoint(line.take_setpoint().parse(now_ns)?),
            "commissioned" => line.take_commissioned()?,
            "watch" if line.topics.as_deref() == Some(&["state".to_owned()]) => {
                line.topics = None;
                Self::WatchState
            }
            "watch" => Self::Watch {
                topics: line
                    .topics
                    .take()
                    .unwrap_or_default()
                    .iter()
                    .map(|topic| Topic::from_str(topic).map_err(|error| error.to_string()))
                    .collect::<Result<_, _>>()?,
            },
            other => {
                return Err(format!(
                    "command is {other:?}: use status, arm, hold, jog, disarm, stop, set-reference, setpoint, commissioned, reload or watch"
                )
                .into());
            }
        };
        line.refuse_other_keys()?;
        Ok(command)
    }
}

impl Line {
    fn take_attendance(&mut self) -> Result<Attendance, String> {
        let time = self.for_s.take();
        let attendance = self.attendance.take();
        match (attendance.as_deref(), time) {
            (Some("hold"), None) => Ok(Attendance::Hold),
            (Some("unattended"), None) => Ok(Attendance::Unattended),
            (Some("timed"), Some(seconds)) if (MIN_TIME..=MAX_TIME).contains(&seconds) => {
                Ok(Attendance::Timed(Duration::from_secs_f64(seconds)))
            }
            (Some("timed"), Some(seconds)) => Err(format!(
                "for_s is {seconds}: it must lie between {MIN_TIME} and {MAX_TIME}"
            )),
            (Some("timed"), None) => {
                Err("attendance \"timed\" needs for_s, such as \"for_s\":60".to_owned())
            }
            (Some("hold" | "unattended"), Some(_)) => {
                Err("only attendance \"timed\" takes for_s".to_owned())
            }
            (Some(other), _) => Err(format!(
                "attendance is {other:?}: use \"hold\", \"timed\" or \"unattended\""
            )),
            (None, _) => Err(
                "arm needs an attendance: \"hold\" (send {\"command\":\"hold\"} every 100 ms on \
                 this connection; the drive ends when it does), \"timed\" with for_s, or \
                 \"unattended\" (nobody holds it: the drive goes on until a stop, a disarm or a \
                 safeguard ends it)"
                    .to_owned(),
            ),
        }
    }

    fn take_commissioned(&mut self) -> Result<Command, String> {
        let procedure = self.procedure.take().unwrap_or_default();
        let result = self.result.take().unwrap_or_default();
        Ok(Command::Commissioned {
            procedure: Procedure::named(&procedure).ok_or_else(|| {
                format!("procedure is {procedure:?}: use \"doctor\", \"bring-up\" or \"calibrate\"")
            })?,
            result: ProcedureResult::named(&result).ok_or_else(|| {
                format!(
                    "result is {result:?}: use \"begun\", \"resumed\", \"passed\" or \"failed\""
                )
            })?,
        })
    }

    fn take_jog(&mut self) -> Result<Jog, String> {
        match (self.servo_us.take(), self.esc_us.take()) {
            (Some(servo_us), Some(esc_us)) => Ok(Jog { servo_us, esc_us }),
            _ => Err("jog needs servo_us and esc_us, such as 1500 and 1500".to_owned()),
        }
    }

    fn take_setpoint(&mut self) -> SetpointKeys {
        SetpointKeys {
            velocity_m_s: self.velocity_m_s.take(),
            position_m: self.position_m.take(),
            steering_rad: self.steering_rad.take(),
            steering_rate_rad_s: self.steering_rate_rad_s.take(),
            speed_m_s: self.speed_m_s.take(),
            acceleration_m_s2: self.acceleration_m_s2.take(),
            trajectory: self.trajectory.take(),
            time_ns: self.time_ns.take(),
            sequence: self.sequence.take(),
        }
    }

    /// Refuses the keys that the command does not have.
    fn refuse_other_keys(&self) -> Result<(), String> {
        for (key, is_there, owner) in [
            ("attendance", self.attendance.is_some(), "arm"),
            ("for_s", self.for_s.is_some(), "arm"),
            ("uncalibrated", self.uncalibrated.is_some(), "arm"),
            ("procedure", self.procedure.is_some(), "commissioned"),
            ("result", self.result.is_some(), "commissioned"),
            ("topics", self.topics.is_some(), "watch"),
            ("reference", self.reference.is_some(), "set-reference"),
            ("velocity_m_s", self.velocity_m_s.is_some(), "setpoint"),
            ("position_m", self.position_m.is_some(), "setpoint"),
            ("steering_rad", self.steering_rad.is_some(), "setpoint"),
            (
                "steering_rate_rad_s",
                self.steering_rate_rad_s.is_some(),
                "setpoint",
            ),
            ("speed_m_s", self.speed_m_s.is_some(), "setpoint"),
            (
                "acceleration_m_s2",
                self.acceleration_m_s2.is_some(),
                "setpoint",
            ),
            ("trajectory", self.trajectory.is_some(), "setpoint"),
            ("time_ns", self.time_ns.is_some(), "setpoint"),
            ("sequence", self.sequence.is_some(), "setpoint"),
            ("jog", self.jog.is_some(), "arm"),
            ("servo_us", self.servo_us.is_some(), "jog"),
            ("esc_us", self.esc_us.is_some(), "jog"),
            ("at_once", self.at_once.is_some(), "disarm"),
        ] {
            if is_there {
                return Err(format!(
                    "{} takes no {key}; only {owner} does",
                    self.command
                ));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use singletrack_control::{
        Demand, Position, Setpoint, SetpointStamp, SpeedDemand, SteeringDemand, Time, Trajectory,
        TrajectoryPoint, Velocity,
    };

    use super::{super::setpoint::Rejection, *};

    const NOW: u64 = 1_000;

    #[test]
    fn invalid_lines_are_answered_with_what_to_write() {
        for (line, part) in [
            (r#""#, "write {"),
            (r#"status"#, "write {"),
            (r#"{"version":2}"#, "command"),
            (r#"{"command":"status"}"#, "version"),
            (r#"{"version":3,"command":"status"}"#, "version is 3"),
            (r#"{"version":2,"command":"fly"}"#, "use status, arm"),
            (r#"{"version":2,"command":"arm","now":true}"#, "now"),
            (
                r#"{"version":2,"command":"arm"}"#,
                "arm needs an attendance: \"hold\" (send",
            ),
            (
                r#"{"version":2,"command":"arm","attendance":"me"}"#,
                "attendance is \"me\": use \"hold\"",
            ),
            (
                r#"{"version":2,"command":"arm","attendance":"timed"}"#,
                "needs for_s",
            ),
            (
                r#"{"version":2,"command":"arm","attendance":"timed","for_s":0}"#,
                "for_s is 0: it must lie between 0.5 and 86400",
            ),
            (
                r#"{"version":2,"command":"arm","attendance":"hold","for_s":60}"#,
                "only attendance \"timed\"",
            ),
            (
                r#"{"version":2,"command":"disarm","attendance":"hold"}"#,
                "disarm takes no attendance; only arm does",
            ),
            (
                r#"{"version":2,"command":"arm","attendance":"hold","topics":["tick"]}"#,
                "arm takes no topics; only watch does",
            ),
            (
                r#"{"version":2,"command":"stop","at_once":true}"#,
                "stop takes no at_once; only disarm does",
            ),
            (
                r#"{"version":2,"command":"watch","topics":["ticks"]}"#,
                "ticks",
            ),
            (
                r#"{"version":2,"command":"watch","velocity_m_s":[0,0]}"#,
                "only setpoint does",
            ),
            (
                r#"{"version":2,"command":"status","uncalibrated":true}"#,
                "only arm does",
            ),
            (
                r#"{"version":2,"command":"commissioned","procedure":"drive","result":"passed"}"#,
                "procedure is \"drive\": use \"doctor\"",
            ),
            (
                r#"{"version":2,"command":"commissioned","procedure":"doctor"}"#,
                "result is \"\": use \"begun\"",
            ),
            (
                r#"{"version":2,"command":"set-reference"}"#,
                "needs a reference",
            ),
            (
                r#"{"version":2,"command":"set-reference","reference":{"kind":"circle"}}"#,
                "radius_m",
            ),
            (
                r#"{"version":2,"command":"set-reference","reference":{"kind":"square"}}"#,
                "square",
            ),
            (
                r#"{"version":2,"command":"setpoint"}"#,
                "needs velocity_m_s",
            ),
            (
                r#"{"version":2,"command":"setpoint","velocity_m_s":[1]}"#,
                "length",
            ),
            (
                r#"{"version":2,"command":"setpoint","velocity_m_s":[1,null]}"#,
                "null",
            ),
            (
                r#"{"version":2,"command":"setpoint","velocity_m_s":[1,1e999]}"#,
                "number out of range",
            ),
            (
                r#"{"version":2,"command":"setpoint","velocity_m_s":[0,-100.1]}"#,
                "velocity_m_s must lie between -100 and 100",
            ),
            (
                r#"{"version":2,"command":"setpoint","velocity_m_s":[0,0],"position_m":[1e5,0]}"#,
                "position_m",
            ),
            (
                r#"{"version":2,"command":"arm","attendance":"unattended","jog":true}"#,
                "jogging must be held",
            ),
            (
                r#"{"version":2,"command":"arm","jog":true}"#,
                "arm needs an attendance",
            ),
            (
                r#"{"version":2,"command":"hold","jog":true}"#,
                "hold takes no jog; only arm does",
            ),
            (
                r#"{"version":2,"command":"jog","servo_us":1500}"#,
                "jog needs servo_us and esc_us",
            ),
            (
                r#"{"version":2,"command":"jog","servo_us":-1,"esc_us":1500}"#,
                "invalid value",
            ),
            (
                r#"{"version":2,"command":"jog","servo_us":1500,"esc_us":65536}"#,
                "invalid value",
            ),
            (
                r#"{"version":2,"command":"reload","esc_us":1500}"#,
                "reload takes no esc_us; only jog does",
            ),
            (
                r#"{"version":2,"command":"setpoint","velocity_m_s":[0,0],"time_ns":1001}"#,
                "CLOCK_MONOTONIC of this computer says 1000",
            ),
        ] {
            let error = Command::parse(line.as_bytes(), NOW).unwrap_err();
            let error = error.to_string();
            assert!(error.contains(part), "{line}: {error}");
        }
    }

    #[test]
    fn valid_lines_are_parsed() {
        let arm = |attendance| Arm {
            attendance,
            uncalibrated: false,
        };
        let setpoint = |position, time| {
            let velocity = Velocity::new(0.5, -1.0);
            Command::Setpoint(SetpointCommand::Setpoint(Setpoint::point(
                Time(time),
                position,
                velocity,
            )))
        };
        let actuation = |steering, speed, sequence| {
            let stamp = SetpointStamp {
                time: Time(NOW),
                sequence,
            };
            let demand = Demand::Actuation { steering, speed };
            Command::Setpoint(SetpointCommand::Setpoint(Setpoint { stamp, demand }))
        };
        for (line, command) in [
            (
                r#"{"version":2,"command":"status"}"#,
                Command::Ask(Question::Status),
            ),
            (
                r#"{"version":2,"command":"disarm","at_once":true}"#,
                Command::Ask(Question::Halt),
            ),
            (
                r#"{"version":2,"command":"disarm","at_once":false}"#,
                Command::Ask(Question::Disarm),
            ),
            (
                r#"{"version":2,"command":"arm","attendance":"hold"}"#,
                Command::Arm(arm(Attendance::Hold)),
            ),
            (
                r#"{"version":2,"command":"arm","attendance":"timed","for_s":1.5}"#,
                Command::Arm(arm(Attendance::Timed(Duration::from_millis(1_500)))),
            ),
            (
                r#"{"version":2,"command":"arm","attendance":"unattended"}"#,
                Command::Arm(arm(Attendance::Unattended)),
            ),
            (
                r#"{"version":2,"command":"arm","attendance":"hold","uncalibrated":true}"#,
                Command::Arm(Arm {
                    attendance: Attendance::Hold,
                    uncalibrated: true,
                }),
            ),
            (
                r#"{"version":2,"command":"commissioned","procedure":"bring-up","result":"passed"}"#,
                Command::Commissioned {
                    procedure: Procedure::BringUp,
                    result: ProcedureResult::Passed,
                },
            ),
            (
                r#"{"version":2,"command":"arm","attendance":"hold","jog":true}"#,
                Command::ArmJog,
            ),
            (
                r#"{"version":2,"command":"arm","attendance":"hold","jog":false}"#,
                Command::Arm(arm(Attendance::Hold)),
            ),
            (
                r#"{"version":2,"command":"jog","servo_us":1400,"esc_us":65535}"#,
                Command::Jog(Jog {
                    servo_us: 1_400,
                    esc_us: u16::MAX,
                }),
            ),
            (r#"{"version":2,"command":"reload"}"#, Command::Reload),
            (r#"{"version":2,"command":"hold"}"#, Command::Hold),
            (
                "{\"command\":\"stop\",\"version\":2}\r\n",
                Command::Ask(Question::Stop),
            ),
            (
                r#"{"version":2,"command":"watch","topics":["tick","log"]}"#,
                Command::Watch {
                    topics: vec![Topic::Tick, Topic::Log],
                },
            ),
            (
                r#"{"version":2,"command":"set-reference","reference":
                    {"kind":"circle","radius_m":1,"angular_velocity_rad_s":0.5}}"#,
                Command::SetReference(ReferenceSection::Circle {
                    radius_m: 1.0,
                    angular_velocity_rad_s: 0.5,
                    centre_m: [0.0, 0.0],
                }),
            ),
            (
                r#"{"version":2,"command":"setpoint","velocity_m_s":[0.5,-1]}"#,
                setpoint(None, NOW),
            ),
            (
                r#"{"version":2,"command":"setpoint","velocity_m_s":[0.5,-1],
                    "position_m":[2,3],"time_ns":400}"#,
                setpoint(Some(Position::new(2.0, 3.0)), 400),
            ),
            (
                r#"{"version":2,"command":"setpoint","steering_rad":0.1,"speed_m_s":-0.5,
                    "sequence":7}"#,
                actuation(
                    SteeringDemand::Angle(0.1),
                    SpeedDemand::Speed(-0.5),
                    Some(7),
                ),
            ),
            (
                r#"{"version":2,"command":"setpoint","steering_rate_rad_s":-0.2,
                    "acceleration_m_s2":0.3}"#,
                actuation(
                    SteeringDemand::Rate(-0.2),
                    SpeedDemand::Acceleration(0.3),
                    None,
                ),
            ),
            (
                r#"{"version":2,"command":"setpoint","trajectory":[
                    {"time_ns":900,"position_m":[1,2],"velocity_m_s":[0,0]},
                    {"time_ns":1001,"position_m":[1,2.000001],"velocity_m_s":[3,4]}]}"#,
                Command::Setpoint(SetpointCommand::Trajectory(Box::new(Trajectory {
                    stamp: SetpointStamp {
                        time: Time(NOW),
                        sequence: None,
                    },
                    points: [(900, 2.0, [0.0, 0.0]), (1_001, 2.000_001, [3.0, 4.0])]
                        .into_iter()
                        .map(|(time, y, [v_x, v_y])| TrajectoryPoint {
                            time: Time(time),
                            position: Position::new(1.0, y),
                            velocity: Velocity::new(v_x, v_y),
                        })
                        .collect(),
                }))),
            ),
            (
                r#"{"version":2,"command":"watch","topics":["state"]}"#,
                Command::WatchState,
            ),
        ] {
            assert_eq!(Command::parse(line.as_bytes(), NOW), Ok(command), "{line}");
        }
    }

    #[test]
    fn a_set_point_with_a_mistake_is_rejected_with_a_word() {
        use Rejection::{Future, Invalid, NotFinite, Old, OutOfRange};
        let points = |times: &[u64]| {
            let point =
                |time| format!(r#"{{"time_ns":{time},"position_m":[0,0],"velocity_m_s":[0,0]}}"#);
            let points: Vec<_> = times.iter().map(point).collect();
            format!(r#""trajectory":[{}]"#, points.join(","))
        };
        let many: Vec<u64> = (1_000..1_101).collect();
        for (keys, why) in [
            ("", Invalid),
            (r#""position_m":[0,0]"#, Invalid),
            (r#""velocity_m_s":[0]"#, Invalid),
            (r#""velocity_m_s":[0,0],"speed_m_s":1"#, Invalid),
            (r#""velocity_m_s":[0,0],"to":1"#, Invalid),
            (r#""steering_rad":0.1"#, Invalid),
            (r#""speed_m_s":0.1"#, Invalid),
            (
                r#""steering_rad":0.1,"steering_rate_rad_s":0.1,"speed_m_s":1"#,
                Invalid,
            ),
            (
                r#""steering_rad":0.1,"acceleration_m_s2":0.1,"speed_m_s":1"#,
                Invalid,
            ),
            (r#""velocity_m_s":[0,0],"sequence":-1"#, Invalid),
            (r#""velocity_m_s":[0,0],"sequence":4294967296"#, Invalid),
            (r#""velocity_m_s":[NaN,0]"#, NotFinite),
            (r#""velocity_m_s":[0,-Infinity]"#, NotFinite),
            (r#""velocity_m_s":[0,null]"#, NotFinite),
            (r#""velocity_m_s":[0,1e999]"#, NotFinite),
            (r#""velocity_m_s":[0,100.1]"#, OutOfRange),
            (r#""velocity_m_s":[0,0],"position_m":[1e5,0]"#, OutOfRange),
            (r#""steering_rad":1.6,"speed_m_s":1"#, OutOfRange),
            (r#""steering_rad":0,"speed_m_s":-101"#, OutOfRange),
            (r#""steering_rate_rad_s":101,"speed_m_s":1"#, OutOfRange),
            (r#""steering_rad":0,"acceleration_m_s2":101"#, OutOfRange),
            (
                r#""steering_rad":0,"acceleration_m_s2":1,"time_ns":1001"#,
                Future,
            ),
            (&points(&[1_000]), OutOfRange),
            (&points(&[1_000, 1_000]), OutOfRange),
            (&points(&many), OutOfRange),
            (&points(&[2_000_000_000, 3_000_000_000]), Future),
            (&points(&[998, 999]), Old),
        ] {
            let comma = if keys.is_empty() { "" } else { "," };
            let line = format!(r#"{{"version":2,"command":"setpoint"{comma}{keys}}}"#);
            let error = Command::parse(line.as_bytes(), NOW).unwrap_err();
            let rejected = error.rejected.map(|rejected| rejected.why);
            assert_eq!(rejected, Some(why), "{line}: {}", error.text);
        }
        let error = Command::parse(b"{\"version\":2,\"command\":NaN}", NOW).unwrap_err();
        assert_eq!(error.rejected, None);
    }
}
