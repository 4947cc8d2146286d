//! The room that every stop of a box of states needs: what a certificate of the filter proves.

use core::f64::consts::TAU;

use super::{SafetyFilter, Start};
use crate::{Position, Stop, direction, stop::Range};

/// The number of directions towards which the room is known, the first one ahead, in equal steps
/// to the left.
pub const ROOM_DIRECTIONS: usize = 12;

/// States of a car that goes forward, by the worst of each.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StopBox {
    /// The largest of the estimated, measured and commanded speeds, with its error, m/s.
    pub speed: f64,
    /// The way since the last pose, m.
    pub blind: f64,
    /// The least deceleration of a stop, m/s².
    pub braking: f64,
    /// The control period, s.
    pub period: f64,
    /// The distance from the centre of mass to the rear axle, m.
    pub rear_axle_distance: f64,
    /// The angles between which the wheels may stand until they have settled, rad.
    pub before: [f64; 2],
    /// The angles between which they may be sent in this tick, rad.
    pub sent: [f64; 2],
}

impl SafetyFilter {
    /// How far from a side of its area the filter wants the estimated position for a stop, m, for a
    /// side in each direction from the heading. The measured curvature and the estimated sideslip
    /// are those of angles between which the wheels may stand.
    pub fn room(&self, states: &StopBox) -> [f64; ROOM_DIRECTIONS] {
        let curvatures = |[least, most]: [f64; 2]| self.curvatures(Range { least, most });
        let first = curvatures(states.before);
        let sideslip = |curvature| libm::atan(states.rear_axle_distance * curvature);
        let start = Start {
            position: Position::origin(),
            yaw: 0.0,
            sideslips: first.map(sideslip),
            pace: states.speed,
            blind: states.blind,
            stop: Stop {
                reaction: self.config.reaction + states.period,
                braking: states.braking,
            },
            period: states.period,
            of_rear: states.rear_axle_distance,
        };
        let ways = self.ways(&start, &first, &curvatures(states.sent));
        core::array::from_fn(|index| {
            let outward = direction(TAU * index as f64 / ROOM_DIRECTIONS as f64);
            ways.room(&outward, self.config.position_error)
        })
    }
}
