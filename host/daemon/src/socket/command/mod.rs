//! Parses a client's line into a command.

mod line;
#[cfg(test)]
mod tests;

use core::{str::FromStr, time::Duration};

use singletrack_core::{
    commissioned::{Procedure, ProcedureResult},
    config::ReferenceSection,
};
use singletrack_pilot::{Jog, Tuning};
use singletrack_record::{Channel, Topic};

use self::line::{Line, channel};
use super::setpoint::{Rejected, SetpointCommand, unreadable};

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
    /// Other values of what can be tuned, answered by one line when they are in force or refused.
    Tune(Tuning),
    /// A set-point, answered only if it has no effect.
    Setpoint(SetpointCommand),
    /// The state of a procedure, answered by one line when it is kept.
    Commissioned {
        /// The procedure.
        procedure: Procedure,
        /// Its state.
        result: ProcedureResult,
    },
    /// A subscription, answered by a stream of entries.
    Watch {
        /// The topics; empty for all.
        topics: Vec<Topic>,
    },
    /// A subscription to encoded messages, answered by a stream of them.
    Messages {
        /// Their channels; empty for all.
        channels: Vec<Channel>,
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
    /// The same; and the body that the cameras show is the car, which was carried.
    Carried,
    /// Disarm at once: neutral without a ramp.
    Halt,
    /// Emergency stop: neutral at once, until the board is reset.
    Stop,
}

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
            "disarm" => match (
                line.at_once.take().unwrap_or(false),
                line.carried.take().unwrap_or(false),
            ) {
                (true, true) => {
                    return Err("disarm takes at_once or carried, not both".into());
                }
                (true, false) => Self::Ask(Question::Halt),
                (false, true) => Self::Ask(Question::Carried),
                (false, false) => Self::Ask(Question::Disarm),
            },
            "stop" => Self::Ask(Question::Stop),
            "set-reference" => {
                let missing = "set-reference needs a reference, such as {\"kind\":\"circle\",\
                               \"radius_m\":1.0,\"angular_velocity_rad_s\":0.5}";
                Self::SetReference(line.reference.take().ok_or(missing)?)
            }
            "tune" => Self::Tune(line.take_tuning()?),
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
            "messages" => Self::Messages {
                channels: line
                    .topics
                    .take()
                    .unwrap_or_default()
                    .iter()
                    .map(|topic| channel(topic))
                    .collect::<Result<_, _>>()?,
            },
            other => {
                return Err(format!(
                    "command is {other:?}: use status, arm, hold, jog, disarm, stop, set-reference, setpoint, tune, commissioned, reload, messages or watch"
                )
                .into());
            }
        };
        line.refuse_other_keys()?;
        Ok(command)
    }
}
