//! Another rigid body near the place of the one that is followed: its markers may have been taken
//! for those of the car.

use crate::{
    body::{BodyPose, BodyState},
    session::PoseFrame,
};

/// Distance from the followed body within which another one counts as near, m.
pub const NEAR_M: f64 = 0.5;

/// The nearest tracked body with another id, within [`NEAR_M`] of the followed body: of where the
/// stream has it, plausible or not, or of its last accepted pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Neighbour {
    /// Its streaming id.
    pub id: i32,
    /// Distance between the pivots, m.
    pub distance_m: f64,
}

impl Neighbour {
    /// The neighbour of the body `id`, which was last accepted at `accepted_m`.
    pub(super) fn of(id: i32, frame: &PoseFrame<'_>, accepted_m: Option<[f64; 3]>) -> Option<Self> {
        let tracked = |state| match state {
            BodyState::Tracked(BodyPose { position_m, .. }) => Some(position_m),
            _ => None,
        };
        let streamed_m = frame.body(id).and_then(|body| tracked(body.state));
        let mut nearest: Option<Self> = None;
        for body in frame.bodies().filter(|body| body.id != id) {
            let Some(position_m) = tracked(body.state) else {
                continue;
            };
            for place_m in [streamed_m, accepted_m].into_iter().flatten() {
                let distance_m = distance(place_m, position_m);
                if distance_m <= nearest.map_or(NEAR_M, |nearest| nearest.distance_m) {
                    nearest = Some(Self {
                        id: body.id,
                        distance_m,
                    });
                }
            }
        }
        nearest
    }
}

fn distance(from: [f64; 3], to: [f64; 3]) -> f64 {
    let squares = from.iter().zip(to).map(|(a, b)| (a - b) * (a - b));
    libm::sqrt(squares.sum())
}
