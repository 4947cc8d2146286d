//! Another rigid body near the place of the one that is followed: its markers may have been taken
//! for those of the car.

use crate::{
    body::{BodyPose, BodyState},
    session::PoseFrame,
};

/// What a frame says of another rigid body than the one that is followed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OtherBody {
    /// Its streaming id.
    pub id: i32,
    /// Mid-exposure, in nanoseconds of the local monotonic clock.
    pub capture_time_ns: u64,
    /// Position of its pivot on the floor, x and y of the world with z up, in metres; none if it
    /// is not tracked, or its numbers are no pose.
    pub position_m: Option<[f64; 2]>,
}

impl OtherBody {
    /// All of a frame but the body `id`; none of a frame without a usable time.
    pub(super) fn of<'a>(
        id: i32,
        frame: &'a PoseFrame<'_>,
    ) -> impl Iterator<Item = Self> + use<'a> {
        let others = move |capture_time_ns| {
            let others = frame.bodies().filter(move |body| body.id != id);
            others.map(move |body| Self {
                id: body.id,
                capture_time_ns,
                position_m: tracked_m(body.state).map(|[x_m, y_m, _]| [x_m, y_m]),
            })
        };
        let capture = frame.capture.map(|capture| capture.time_ns);
        capture.into_iter().flat_map(others)
    }
}

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
        let streamed_m = frame.body(id).and_then(|body| tracked_m(body.state));
        let mut nearest: Option<Self> = None;
        for body in frame.bodies().filter(|body| body.id != id) {
            let Some(position_m) = tracked_m(body.state) else {
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

/// The position of a tracked body, m.
const fn tracked_m(state: BodyState) -> Option<[f64; 3]> {
    match state {
        BodyState::Tracked(BodyPose { position_m, .. }) => Some(position_m),
        _ => None,
    }
}

fn distance(from: [f64; 3], to: [f64; 3]) -> f64 {
    let squares = from.iter().zip(to).map(|(a, b)| (a - b) * (a - b));
    libm::sqrt(squares.sum())
}
