//! Parses a client's line into a command.

#[cfg(test)]
mod tests;

use core::{ops::RangeInclusive, str::FromStr, time::Duration};

use serde_json::Value;
use singletrack_api::{Refused, Request, RequestError, explain};
use singletrack_control::{Time, Velocity};
use singletrack_core::{
    commissioned::{Procedure, ProcedureResult},
    config::ReferenceSection,
    setpoint::SetpointCommand,
};
use singletrack_pilot::{Jog, PilotRequest, Tuning};
use singletrack_record::{Channel, Topic};

use super::setpoint::unreadable;

/// A command of a client.
#[derive(Clone, Debug, PartialEq)]
pub enum Command {
    /// The status of daemon, board and figures, answered by one line.
    Status,
    /// A request that ends a drive, answered by one line.
    End(PilotRequest),
    /// The clocks, answered by one line.
    Clock,
    /// The configuration in force, answered by one line.
    Configuration,
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
        /// Whether it may begin although an earlier one has not passed.
        uncalibrated: bool,
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
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ParseError {
    /// It is not understood.
    #[error("{0}")]
    Text(String),
    /// It is a set-point, and rejected.
    #[error(transparent)]
    Rejected(#[from] Refused),
}

impl From<String> for ParseError {
    fn from(text: String) -> Self {
        Self::Text(text)
    }
}

/// A request to arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Arm {
    /// Who attends the drive.
    pub attendance: Attendance,
    /// The longest time between two renewals of a held drive, if it is shorter than the pilot's.
    pub hold: Option<Duration>,
    /// When the reference of a held drive begins, on `CLOCK_MONOTONIC`.
    pub start_ns: Option<u64>,
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

impl Command {
    /// Parses a line that was read at `now_ns` of `CLOCK_MONOTONIC`.
    ///
    /// # Errors
    ///
    /// The text of the answer: what is wrong, and what to write instead.
    pub fn parse(line: &[u8], now_ns: u64) -> Result<Self, ParseError> {
        match Request::parse(line) {
            Ok(request) => Self::of(request, now_ns),
            Err(RequestError(text)) => Err(match unreadable(line) {
                Some(code) => Refused { code, text }.into(),
                None => ParseError::Text(text),
            }),
        }
    }

    fn of(request: Request, now_ns: u64) -> Result<Self, ParseError> {
        Ok(match request {
            Request::Status {} => Self::Status,
            Request::Clock {} => Self::Clock,
            Request::Arm(arm) => {
                let attendance = attendance(&arm)?;
                let hold = hold(&arm, now_ns)?;
                match (arm.jog, attendance) {
                    (true, Attendance::Hold) => Self::ArmJog,
                    (true, _) => {
                        let text = "jogging must be held: \"attendance\":\"hold\"";
                        return Err(text.to_owned().into());
                    }
                    (false, attendance) => Self::Arm(Arm {
                        attendance,
                        hold,
                        start_ns: arm.start_ns,
                        uncalibrated: arm.uncalibrated,
                    }),
                }
            }
            Request::Hold {} => Self::Hold,
            Request::Jog { servo_us, esc_us } => Self::Jog(Jog { servo_us, esc_us }),
            Request::Reload {} => Self::Reload,
            Request::Configuration {} => Self::Configuration,
            Request::Disarm { at_once, carried } => Self::End(match (at_once, carried) {
                (true, true) => {
                    return Err("disarm takes at_once or carried, not both"
                        .to_owned()
                        .into());
                }
                (true, false) => PilotRequest::Halt,
                (false, true) => PilotRequest::Carried,
                (false, false) => PilotRequest::Disarm,
            }),
            Request::Stop {} => Self::End(PilotRequest::EmergencyStop),
            Request::SetReference { reference } => Self::SetReference(section(reference)?),
            Request::Tune(tune) => Self::Tune(Tuning {
                gain: tune.gain_per_s.map(|gain| Velocity::from(gain.each())),
                point_distance: tune.point_distance_m,
            }),
            Request::Setpoint(setpoint) => {
                Self::Setpoint(SetpointCommand::of(setpoint, Time(now_ns))?)
            }
            Request::Commissioned {
                procedure,
                result,
                uncalibrated,
            } => Self::Commissioned {
                uncalibrated,
                procedure: Procedure::named(&procedure).ok_or_else(|| {
                    format!(
                        "procedure is {procedure:?}: use \"doctor\", \"bring-up\" or \"calibrate\""
                    )
                })?,
                result: ProcedureResult::named(&result).ok_or_else(|| {
                    format!(
                        "result is {result:?}: use \"begun\", \"resumed\", \"changed\", \
                         \"passed\" or \"failed\""
                    )
                })?,
            },
            Request::Watch { topics } if topics == ["state"] => Self::WatchState,
            Request::Watch { topics } => {
                let known = |name: &String| Topic::from_str(name).map_err(|it| it.to_string());
                let topics: Result<_, _> = topics.iter().map(known).collect();
                Self::Watch { topics: topics? }
            }
            Request::Messages { topics } => {
                let channels: Result<_, _> = topics.iter().map(|name| channel(name)).collect();
                Self::Messages {
                    channels: channels?,
                }
            }
        })
    }
}

/// The reference that a client gives.
fn section(reference: Value) -> Result<ReferenceSection, String> {
    let explained = match &reference {
        Value::Object(keys) => explain::<ReferenceSection>(keys, &["kind"], "reference."),
        other => Some(format!(
            "reference is {other}: it takes an object in braces"
        )),
    };
    serde_json::from_value(reference)
        .map_err(|error| explained.unwrap_or_else(|| error.to_string()))
}

/// The shortest and the longest time of a timed drive, s.
const MIN_TIME: f64 = 0.5;
const MAX_TIME: f64 = 86_400.0;

/// Who attends a drive.
fn attendance(arm: &singletrack_api::Arm) -> Result<Attendance, String> {
    use singletrack_api::Attendance::{Hold, Timed, Unattended};
    match (arm.attendance, arm.for_s) {
        (Some(Hold), None) => Ok(Attendance::Hold),
        (Some(Unattended), None) => Ok(Attendance::Unattended),
        (Some(Timed), Some(seconds)) if (MIN_TIME..=MAX_TIME).contains(&seconds) => {
            Ok(Attendance::Timed(Duration::from_secs_f64(seconds)))
        }
        (Some(Timed), Some(seconds)) => Err(format!(
            "for_s is {seconds}: it must lie between {MIN_TIME} and {MAX_TIME}"
        )),
        (Some(Timed), None) => {
            Err("attendance \"timed\" needs for_s, such as \"for_s\":60".to_owned())
        }
        (Some(Hold | Unattended), Some(_)) => {
            Err("only attendance \"timed\" takes for_s".to_owned())
        }
        (None, _) => Err(
            "arm needs an attendance: \"hold\" (send {\"command\":\"hold\"} every 100 ms on \
             this connection; the drive ends when it does), \"timed\" with for_s, or \
             \"unattended\" (no client holds it: the drive continues until a stop, a disarm or \
             a safeguard ends it)"
                .to_owned(),
        ),
    }
}

/// The longest time between two renewals of a held drive, ms: the pilot's is the longest.
const HOLD_MS: RangeInclusive<u64> = 100..=500;

/// The longest time from a request to arm to the start of its reference, ns.
const LONGEST_WAIT_NS: u64 = 60_000_000_000;

/// The time between two renewals that a client asks for a held drive, if all that it asks is valid.
fn hold(arm: &singletrack_api::Arm, now_ns: u64) -> Result<Option<Duration>, String> {
    let is_held = arm.attendance == Some(singletrack_api::Attendance::Hold) && !arm.jog;
    if !is_held && (arm.hold_ms.is_some() || arm.start_ns.is_some()) {
        return Err("only attendance \"hold\" without jog takes hold_ms and start_ns".to_owned());
    }
    if let Some(start_ns) = arm.start_ns
        && !(now_ns..=now_ns + LONGEST_WAIT_NS).contains(&start_ns)
    {
        return Err(format!(
            "start_ns is {start_ns}: it must lie within {} s from now, {now_ns} on this daemon's \
             CLOCK_MONOTONIC; ask for its clock",
            LONGEST_WAIT_NS / 1_000_000_000
        ));
    }
    match arm.hold_ms {
        Some(ms) if !HOLD_MS.contains(&ms) => Err(format!(
            "hold_ms is {ms}: it must lie between {} and {}",
            HOLD_MS.start(),
            HOLD_MS.end()
        )),
        hold => Ok(hold.map(Duration::from_millis)),
    }
}

fn channel(topic: &str) -> Result<Channel, String> {
    Channel::all()
        .find(|channel| channel.topic() == topic)
        .ok_or_else(|| {
            let known: Vec<_> = Channel::all().map(Channel::topic).collect();
            format!("no topic {topic:?}: use {}", known.join(", "))
        })
}
