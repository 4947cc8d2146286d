//! The state stream: what a controller outside needs to know of a tick.

use serde::{Deserialize, Serialize};

use crate::Word;

/// The state of a tick. Times are in s, positions in m, angles in rad, in the world frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct State {
    /// `state`.
    pub topic: Word,
    /// The number of the tick.
    pub tick: u64,
    /// Since the first tick.
    pub t: f64,
    /// Of the tick, on `CLOCK_MONOTONIC`.
    pub time_ns: u64,
    /// The pilot's mode.
    pub mode: Word,
    /// Why the car does not drive, or stops.
    pub reason: Option<Word>,
    /// Since the first driving tick.
    pub drive_time: Option<f64>,
    /// Of G.
    pub x: Option<f64>,
    /// Of G.
    pub y: Option<f64>,
    /// Not wrapped.
    pub yaw: Option<f64>,
    /// Of G, in m/s.
    pub speed: Option<f64>,
    /// Of G.
    pub sideslip: Option<f64>,
    /// In rad/s.
    pub yaw_rate: Option<f64>,
    /// Of the last accepted pose.
    pub pose_age: Option<f64>,
    /// Whether there was no new pose.
    pub held: bool,
    /// P.
    pub point: Option<[f64; 2]>,
    /// The commanded velocity of P, in m/s.
    pub point_velocity: Option<[f64; 2]>,
    /// Where P should be.
    pub reference: Option<[f64; 2]>,
    /// After the limits.
    pub steering: f64,
    /// After the limits, in m/s.
    pub commanded_speed: f64,
    /// Of the last telemetry.
    pub board_age: Option<f64>,
    /// The set-point in force.
    pub setpoint: Option<SetpointInForce>,
    /// Why the pilot refused a set-point in this tick.
    pub setpoint_refused: Option<Word>,
    /// What the safety filter did.
    pub filtering: Word,
    /// The tuned gains along x and y, per second.
    pub gain: Option<[f64; 2]>,
    /// The tuned p.
    pub point_distance: Option<f64>,
}

/// The set-point in force.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SetpointInForce {
    /// Its number, if it has one.
    pub sequence: Option<u32>,
    /// Since it was decided.
    pub age: f64,
}
