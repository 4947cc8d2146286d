//! The status of the daemon, whose keys are in the order of the alphabet, and the view of a tick: a
//! part of it, and a line of the state stream.

use core::fmt;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::{Tuning, TuningBounds, Word};

/// The status of daemon, board and figures.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// The board; `None` before its first telemetry.
    pub board: Option<Board>,
    /// What the drives with this configuration say of it; `None` if that is not asked for, or not
    /// known yet.
    pub calibration: Option<Calibration>,
    /// What is wrong with the cameras, or that nothing is.
    pub cameras: Cameras,
    /// The results of the procedures on this car, and the first that is missing.
    pub commissioned: Option<Value>,
    /// The file that a reload reads.
    pub config_path: Option<String>,
    /// The configuration in force.
    pub configuration: Configuration,
    /// Counters and quantiles since the daemon started.
    pub figures: Value,
    /// What live calibration corrects in this drive.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub learned: Option<Learned>,
    /// Whether the configuration in force is proved on this car.
    pub proved: Option<bool>,
    /// What the system granted the control thread.
    pub realtime: Value,
    /// The file of the record.
    pub record: Option<String>,
    /// Why the record ended before the daemon.
    pub record_error: Option<String>,
    /// Why the record will soon end.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub record_warning: Option<String>,
    /// Why the serial port can't be opened, and what to do.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub serial_error: Option<String>,
    /// The last tick; `None` before the first.
    pub state: Option<State>,
    /// What can be tuned; `None` if nothing can be.
    pub tuning: Option<Tunable>,
}

/// The board.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Board {
    /// Voltage of its battery, in mV.
    pub battery_mv: Option<u16>,
    /// Its own mode.
    pub mode: Word,
    /// Why it last went to neutral.
    pub stop_cause: Word,
    /// Whether its stop input is open.
    pub stop_input_open: Option<bool>,
}

/// What drives say of the calibration; empty if nothing is wrong.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// What is off, a sentence each.
    pub advice: Vec<String>,
    /// What to write into the configuration; not everything that is off has a key.
    pub corrections: Vec<Correction>,
}

impl Calibration {
    /// The advice in one line; `None` if nothing is wrong.
    pub fn line(&self) -> Option<String> {
        let accept = match self.corrections.as_slice() {
            [] => "",
            _ => ", or `singletrack accept`",
        };
        let off = self.advice.join("; ");
        (!off.is_empty()).then(|| format!("{off}: run `singletrack calibrate`{accept}"))
    }
}

/// A value of the configuration that drives contradict.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Correction {
    /// The value that was in force.
    pub configured: Value,
    /// Such as `board.servo.centre_us`.
    pub key: String,
    /// The value by the drives.
    pub value: Value,
}

/// Corrections of live calibration: the true value less the configured one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Learned {
    /// Yaw of the rigid body on the car, in rad.
    pub body_yaw_rad: f64,
    /// Pivot of the rigid body, forward and to the left, in m.
    pub pivot_m: [f64; 2],
    /// Lateness of the stamps of the cameras, in s.
    pub stamp_offset_s: f64,
    /// Angle of the front wheels for that commanded, as a fraction beyond one.
    pub steering_gain: f64,
    /// Angle of the front wheels when straight ones are commanded, in rad.
    pub steering_trim_rad: f64,
}

/// What is wrong with the cameras, or that nothing is.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Cameras {
    /// The cause as a word.
    pub diagnosis: Word,
    /// Which other rigid body is near the car: its markers may be taken for the car's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub neighbour: Option<String>,
    /// The cause as a sentence, with addresses, names and what to do.
    pub text: String,
}

impl Default for Cameras {
    fn default() -> Self {
        Self {
            diagnosis: "starting".into(),
            neighbour: None,
            text: "waiting for the server".to_owned(),
        }
    }
}

impl Cameras {
    /// Whether something is wrong.
    pub fn is_trouble(&self) -> bool {
        !matches!(&*self.diagnosis, "good" | "starting")
    }
}

impl fmt::Display for Cameras {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            formatter,
            "motion capture: {}: {}",
            self.diagnosis, self.text
        )?;
        match &self.neighbour {
            Some(neighbour) if self.is_trouble() => write!(formatter, "; {neighbour}"),
            _ => Ok(()),
        }
    }
}

/// The configuration in force.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Configuration {
    /// The last attempt to change it.
    pub last_change: Option<Change>,
    /// 1 for the one that the daemon started with, one more for each change.
    pub number: u32,
}

/// An attempt to change the configuration.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Change {
    /// The kind of request: `reload` or `set-reference`.
    pub by: Word,
    /// Why the configuration did not change; `None` if it did.
    pub error: Option<String>,
}

/// What can be tuned.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Tunable {
    /// The least and the most.
    pub bounds: TuningBounds,
    /// The values of the configuration.
    pub configured: Tuning,
    /// Whether the values in force differ from those of the configuration.
    pub differs: bool,
}

impl Status {
    /// Mode of the pilot; `disconnected` before the first tick.
    pub fn mode(&self) -> &str {
        self.state
            .as_ref()
            .map_or("disconnected", |state| &state.mode)
    }

    /// Why the car does not drive, or stopped.
    pub fn reason(&self) -> Option<&str> {
        self.state.as_ref()?.reason.as_deref()
    }

    /// Why an arm request would be refused now.
    pub fn preflight(&self) -> Option<&str> {
        self.state.as_ref()?.preflight.as_deref()
    }

    /// What an operator must know of the record before a drive; `None` if all is well with it.
    pub fn record_trouble(&self) -> Option<String> {
        record_trouble(self.record_error.as_deref(), self.record_warning.as_deref())
    }
}

/// What an operator must know of a record that has ended with this error, or soon will, in words.
pub fn record_trouble(error: Option<&str>, warning: Option<&str>) -> Option<String> {
    let ended = error.map(|error| format!("nothing is recorded: {error}"));
    ended.or_else(|| warning.map(str::to_owned))
}

/// The state after a tick. Positions are in the world frame; angles are positive to the left.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct State {
    /// `state`.
    pub topic: Word,
    /// Number of the tick.
    pub tick: u64,
    /// Time since the first tick, in s.
    pub t_s: f64,
    /// Time of the tick on `CLOCK_MONOTONIC`, in ns.
    pub time_ns: u64,
    /// Mode of the pilot.
    pub mode: Word,
    /// Why the car does not drive, or stops.
    pub reason: Option<Word>,
    /// Why an arm request would be refused now.
    pub preflight: Option<Word>,
    /// Phase of the session with the board.
    pub link: Word,
    /// Time since the first driving tick, in s; `None` outside a drive.
    pub drive_time_s: Option<f64>,
    /// Position of G along x, in m.
    pub x_m: Option<f64>,
    /// Position of G along y, in m.
    pub y_m: Option<f64>,
    /// Yaw, not wrapped, in rad.
    pub yaw_rad: Option<f64>,
    /// Speed of G, in m/s.
    pub speed_m_s: Option<f64>,
    /// Sideslip of G, in rad.
    pub sideslip_rad: Option<f64>,
    /// Yaw rate, in rad/s.
    pub yaw_rate_rad_s: Option<f64>,
    /// Age of the last accepted pose, in s.
    pub pose_age_s: Option<f64>,
    /// Whether no pose was accepted since the last tick.
    pub held: bool,
    /// Position of P, in m.
    pub point_m: Option<[f64; 2]>,
    /// Commanded velocity of P, in m/s.
    pub point_velocity_m_s: Option<[f64; 2]>,
    /// Wanted position of P, in m.
    pub reference_m: Option<[f64; 2]>,
    /// Path parameter of the reference, in s.
    pub path_s: Option<f64>,
    /// Why the reference is slowed down.
    pub slowed_by: Option<Word>,
    /// Steering after the limits, in rad.
    pub steering_rad: f64,
    /// Speed of G after the limits, in m/s.
    pub commanded_speed_m_s: f64,
    /// Time by which the state was predicted for the command, in s.
    pub looked_ahead_s: Option<f64>,
    /// Age of the last telemetry, in s.
    pub board_age_s: Option<f64>,
    /// The set-point in force.
    pub setpoint: Option<SetpointInForce>,
    /// Why the pilot refused a set-point in this tick.
    pub setpoint_refused: Option<Word>,
    /// What the safety filter did.
    pub filtering: Word,
    /// Number of ticks of this or the last drive in which the safety filter acted.
    pub filtered_ticks: u32,
    /// Tuned gains along x and y, per second.
    pub gain_per_s: Option<[f64; 2]>,
    /// Tuned distance p of P from the front axle, in m.
    pub point_distance_m: Option<f64>,
    /// The distance that p goes to, in m.
    pub wanted_point_distance_m: Option<f64>,
}

/// The set-point in force.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SetpointInForce {
    /// Its number, if it has one.
    pub sequence: Option<u32>,
    /// Time since it was decided, in s.
    pub age_s: f64,
}

impl State {
    /// The tuned values in force; `None` if nothing can be tuned.
    pub fn tuning(&self) -> Option<Tuning> {
        Some(Tuning {
            gain_per_s: self.gain_per_s,
            point_distance_m: self.point_distance_m?,
            wanted_point_distance_m: self.wanted_point_distance_m,
        })
    }
}
