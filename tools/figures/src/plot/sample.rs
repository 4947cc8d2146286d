//! What is plotted of a record: samples, the truth of a simulation, and why there is none.

use std::path::PathBuf;

use singletrack_pilot::Mode;
use singletrack_record::RecordError;

use crate::output::WriteError;

/// Ground truth at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TruthSample {
    /// Since the first driving tick, in s.
    pub time: f64,
    /// The true P, world frame, in m.
    pub point: [f64; 2],
    /// Steering angle of the front wheels, in rad.
    pub steering: f64,
    /// Speed of G, in m/s.
    pub speed: f64,
    /// Sideslip of G, in rad.
    pub sideslip: f64,
    /// Yaw rate, in rad/s.
    pub yaw_rate: f64,
}

/// Why plotting failed.
#[derive(Debug, thiserror::Error)]
pub enum PlotError {
    /// The record can't be read.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// The car never drove.
    #[error("{}: there is no drive in this record: {why}; singletrack dump --topic tick shows what there is", path.display())]
    NoDrive {
        /// The record.
        path: PathBuf,
        /// What there is instead.
        why: String,
    },
    /// The record has fewer drives.
    #[error("{}: there is no drive {wanted}: choose --drive from 1 to {count}", path.display())]
    UnknownDrive {
        /// The record.
        path: PathBuf,
        /// The number asked for.
        wanted: usize,
        /// How many there are.
        count: usize,
    },
    /// The drive can't be shown from above.
    #[error("{}: no animation: {why}", path.display())]
    NoAnimation {
        /// The record.
        path: PathBuf,
        /// What it lacks.
        why: &'static str,
    },
    /// A picture can't be written.
    #[error(transparent)]
    Write(#[from] WriteError),
}

/// Inputs and outputs of a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TickSample {
    /// Since the first driving tick, in s.
    pub time: f64,
    /// The mode after the tick.
    pub mode: Mode,
    /// Whether no new pose came since the tick before.
    pub held: bool,
    /// G as estimated, world frame, in m.
    pub place: [f64; 2],
    /// Yaw as estimated, in rad.
    pub yaw: f64,
    /// P as estimated, world frame, in m.
    pub point: [f64; 2],
    /// Where P should be, in m; not a number for a reference that is a velocity alone.
    pub reference: [f64; 2],
    /// The velocity commanded of P, in m/s.
    pub point_velocity: [f64; 2],
    /// Speed of G that was asked for, after limits, in m/s.
    pub commanded_speed: f64,
    /// Steering angle that was asked for, after limits, in rad.
    pub steering: f64,
    /// Speed of G as estimated, in m/s.
    pub speed: f64,
    /// Sideslip as estimated, in rad.
    pub sideslip: f64,
    /// Yaw rate as estimated, in rad/s.
    pub yaw_rate: f64,
    /// How late the tick began, in s.
    pub lateness: f64,
    /// From the mid-exposure of a new pose to the command that rests on it, in s.
    pub latency: f64,
    /// Points of the control grid skipped just before it.
    pub skipped: u32,
    /// Frames since the tick before that had no valid pose.
    pub poses_missing: u32,
}

/// Measurements of the board.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoardPoint {
    /// Since the first driving tick, in s.
    pub time: f64,
    /// Speed of the rear axle by the motor's pulses, in m/s.
    pub motor_speed: f64,
    /// Yaw rate by the gyro, in rad/s; not a number without a new sample.
    pub yaw_rate: f64,
}
