//! What a tick commands, as a value.

use singletrack_control::{Actuation, Position, ReferencePoint, SlowedBy, Velocity};

use super::{DriveCommand, Filtering};

/// What a tick commands, and what led there; see [`Output`](super::Output).
pub(super) struct Action {
    pub(super) drive_time: Option<f64>,
    pub(super) reference: Option<ReferencePoint>,
    pub(super) point: Option<Position>,
    pub(super) point_velocity: Option<Velocity>,
    pub(super) actuation: Actuation,
    pub(super) turning_round: bool,
    pub(super) looked_ahead: Option<f64>,
    pub(super) path: Option<f64>,
    /// The share of the period by which the reference waits.
    pub(super) delay: f64,
    pub(super) slowed_by: Option<SlowedBy>,
    pub(super) command: Option<DriveCommand>,
    pub(super) proved: bool,
    /// The deceleration of the proving run's roll, m/s².
    pub(super) coasted: Option<f64>,
    pub(super) filtering: Filtering,
    pub(super) filtered_ticks: u32,
}
