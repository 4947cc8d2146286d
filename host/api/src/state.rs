//! The view of a tick: a line of the state stream, and a part of the status.

use serde::{Deserialize, Serialize};

use crate::{Tuning, Word};

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
