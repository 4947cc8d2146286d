//! What the daemon sends: a line of JSON each. Keys are in the order of the alphabet.

use core::fmt;
use std::borrow::Cow;

use crate::words;
use serde::{Deserialize, Serialize};

use crate::{ClientError, SOCKET_VERSION, State, Status};

/// A moment on the daemon's two clocks, in ns.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Clocks {
    /// On `CLOCK_MONOTONIC`.
    pub monotonic_ns: u64,
    /// On the wall clock, since 1970.
    pub wall_ns: u64,
}

/// A word of a closed list, which a newer daemon may have lengthened.
pub type Word = Cow<'static, str>;

/// A line of the daemon to a client that is no watcher of entries.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Reply {
    /// The answer to a request.
    Answer(Box<Answer>),
    /// The state of a tick, to a watcher of the states.
    State(Box<State>),
    /// How a held drive goes on.
    Drive {
        /// The drive.
        drive: Drive,
        /// Version of the protocol.
        version: u32,
    },
    /// How a held drive ended.
    Ended {
        /// The end.
        ended: Ended,
        /// Version of the protocol.
        version: u32,
    },
    /// To a watcher that is too slow.
    Missed {
        /// Entries or states that it missed.
        missed: u64,
        /// Version of the protocol.
        version: u32,
    },
}

words! {
    /// Why a request is refused, for programs: control flow rests on it, never on the text beside it.
    pub enum Code: serde {
        /// The line, a key or a value is wrong.
        Invalid = "invalid",
        /// A number of a set-point is not finite.
        NotFinite = "not-finite",
        /// A value is out of its range.
        OutOfRange = "out-of-range",
        /// A set-point was decided later than now.
        Future = "future",
        /// A set-point is older than the time-out.
        Old = "old",
        /// A set-point has a number that is not above the last one.
        Sequence = "sequence",
        /// Another connection gives the set-points.
        OtherSource = "other-source",
        /// The reference takes no set-points.
        NotExternal = "not-external",
        /// The mode does not allow it: the car is not ready, is driven already, or stopped meanwhile.
        NotReady = "not-ready",
        /// Another client has armed, or is being judged.
        OtherClient = "other-client",
        /// Doctor, bring-up or calibrate has not passed.
        NotCommissioned = "not-commissioned",
        /// The car can't drive its reference from where it stands.
        NotFeasible = "not-feasible",
        /// Another request or configuration came meanwhile.
        Superseded = "superseded",
        /// The connection holds no drive.
        NoDrive = "no-drive",
        /// The connection holds a drive, or jogs, and takes other requests.
        Occupied = "occupied",
        /// The change needs a restart of the daemon.
        NeedsRestart = "needs-restart",
        /// The daemon has no such file, or can't write it.
        File = "file",
        /// The control loop does not answer.
        Stalled = "stalled",
        /// Too many clients.
        Busy = "busy",
        /// The token is wrong or missing.
        Token = "token",
        /// A word of a newer daemon.
        #[serde(other)]
        Other = "other",
    }
}

/// A refused request.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{text}")]
pub struct Refused {
    /// For programs.
    pub code: Code,
    /// For people: why, and what to do.
    pub text: String,
}

impl Refused {
    /// A refusal with this text.
    pub fn new(code: Code, text: impl fmt::Display) -> Self {
        let text = text.to_string();
        Self { code, text }
    }
}

/// The answer to a request.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Answer {
    /// To `messages`: how to map their stamps. To `clock`: now.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clocks: Option<Clocks>,
    /// Why the request is refused, for programs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub code: Option<Code>,
    /// The number of the configuration that is in force now.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub configuration: Option<u32>,
    /// Why the request is refused.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<String>,
    /// What a disarm does not change.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub note: Option<Word>,
    /// Whether the request is obeyed.
    pub ok: bool,
    /// Whether this is about a set-point that has no effect, and not the answer to another request.
    #[serde(default, skip_serializing_if = "core::ops::Not::not")]
    pub rejected: bool,
    /// The status.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub status: Option<Status>,
    /// The configuration in force.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub toml: Option<String>,
    /// The tuned values in force.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tuning: Option<Tuning>,
    /// Version of the protocol.
    pub version: u32,
    /// What a new reference asks of the car that it can hardly do; of a drive that has begun, why it is
    /// not recorded, or soon will not be.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<String>,
}

/// How a held drive goes on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Drive {
    /// Time since the first driving tick, in s.
    pub drive_time_s: Option<f64>,
    /// The pilot's mode.
    pub mode: Word,
    /// Why the car stops.
    pub reason: Option<Word>,
    /// The estimated speed, in m/s.
    pub speed_m_s: Option<f64>,
}

/// How a drive ended.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Ended {
    /// The pilot's mode.
    pub mode: Word,
    /// Why.
    pub reason: Option<Word>,
}

/// Values that can be tuned.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Tuning {
    /// The gains of the position loop along x and y, per second; none for a loop without.
    pub gain_per_s: Option<[f64; 2]>,
    /// p, in m.
    pub point_distance_m: f64,
    /// Where p goes to, in m.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wanted_point_distance_m: Option<f64>,
}

/// The least and the most of each tuned value.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TuningBounds {
    /// Least and largest gain, per second.
    pub gain_per_s: Option<[f64; 2]>,
    /// Least and largest distance p, in m.
    pub point_distance_m: Option<[f64; 2]>,
}

impl Answer {
    /// The request is obeyed.
    pub fn done() -> Self {
        Self {
            ok: true,
            version: SOCKET_VERSION,
            ..Self::default()
        }
    }

    /// The request is refused.
    pub fn refusal(refused: Refused) -> Self {
        Self {
            ok: false,
            code: Some(refused.code),
            error: Some(refused.text),
            ..Self::done()
        }
    }

    /// The request is refused, with this text.
    pub fn failure(code: Code, text: impl fmt::Display) -> Self {
        Self::refusal(Refused::new(code, text))
    }

    /// This answer, unless it is a refusal.
    ///
    /// # Errors
    ///
    /// The daemon's reason.
    pub fn agreed(self) -> Result<Self, ClientError> {
        if self.ok {
            return Ok(self);
        }
        Err(ClientError::Refused(Refused {
            code: self.code.unwrap_or(Code::Other),
            text: self.error.unwrap_or_else(|| "without a reason".to_owned()),
        }))
    }
}

impl Reply {
    /// The answer that this line must be.
    ///
    /// # Errors
    ///
    /// The daemon refuses, or the line is no answer.
    pub fn agreed(self) -> Result<Answer, ClientError> {
        match self {
            Self::Answer(answer) => answer.agreed(),
            other => Err(ClientError::NoAnswer(format!("{other:?}"))),
        }
    }
}

impl fmt::Display for Ended {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "mode {}", self.mode)?;
        match &self.reason {
            Some(reason) => write!(formatter, ": {reason}"),
            None => Ok(()),
        }
    }
}
