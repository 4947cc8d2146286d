//! The geofence ahead of the leader.

use libm::{fabs, sincos, sqrt};

use crate::{ConvexArea, Position, Velocity};

/// The distance that the leader keeps from the edge, m: the car is beside it by noise and lag.
const RESERVE: f64 = 0.05;
/// Judged over planned speed. The geofence's watch judges by the estimated speed, whose noise on a
/// car that vibrates is 4 cm/s at 1.4 m/s: without this it stops the car beside a wall.
const JUDGED: f64 = 1.08;
/// The way of a stop is found to this part of it: 2 to the power of this.
const HALVES: u32 = 12;

/// The area in which the centre of mass G must be able to stop, and how the car stops.
#[derive(Clone, Debug, PartialEq)]
pub struct Room {
    /// The area of G, m.
    area: ConvexArea,
    /// The deceleration of a stop, m/s².
    braking: f64,
    /// The time before it begins, s.
    reaction: f64,
}

impl Room {
    /// The room inside `area` for a car that stops with the deceleration `braking` (m/s²) after
    /// the time `reaction` (s). The leader keeps 5 cm from the edge. None if so little is left.
    #[must_use]
    pub fn new(area: &ConvexArea, braking: f64, reaction: f64) -> Option<Self> {
        let is_valid = braking > 0.0 && braking.is_finite() && reaction >= 0.0;
        let area = area.shrunk(RESERVE).ok()?;
        (is_valid && reaction.is_finite()).then_some(Self {
            area,
            braking,
            reaction,
        })
    }

    /// The highest speed of G at which it stops inside, up to that of `velocity`, while it turns
    /// by `turn_rate` (rad/s) at that speed. The wheels are held during the stop.
    pub(super) fn speed(&self, from: &Position, velocity: &Velocity, turn_rate: f64) -> f64 {
        let speed = sqrt(velocity.norm_squared());
        if speed <= 0.0 || speed.is_nan() {
            return speed;
        }
        let along = velocity / speed;
        let curvature = turn_rate / speed;
        // Half of the way and all of it, each as the chord of its bend.
        let stays = |way: f64| {
            [0.5 * way, way].into_iter().all(|way| {
                let turned = 0.5 * way * curvature;
                self.area.clearance(&(from + way * chord(&along, turned))) >= 0.0
            })
        };
        let judged = JUDGED * speed;
        let whole = judged * self.reaction + 0.5 * judged * judged / self.braking;
        if stays(whole) {
            return speed;
        }
        let (mut inside, mut outside) = (0.0, whole);
        for _ in 0..HALVES {
            let middle = 0.5 * (inside + outside);
            if stays(middle) {
                inside = middle;
            } else {
                outside = middle;
            }
        }
        let reaction = self.braking * self.reaction;
        (sqrt(reaction * reaction + 2.0 * self.braking * inside) - reaction) / JUDGED
    }
}

/// The direction turned to the left by an angle (rad), as long as the chord of a bend that turns
/// by twice the angle is, as a part of its way.
fn chord(along: &Velocity, angle: f64) -> Velocity {
    let (sine, cosine) = sincos(angle);
    let turned = Velocity::new(
        cosine * along.x - sine * along.y,
        sine * along.x + cosine * along.y,
    );
    let part = if fabs(angle) < 1e-6 {
        1.0
    } else {
        sine / angle
    };
    part * turned
}

#[cfg(test)]
mod tests {
    use super::*;

    fn room() -> Room {
        let corners = [(-1.05, -1.05), (1.05, -1.05), (1.05, 1.05), (-1.05, 1.05)];
        let area = ConvexArea::new(&corners.map(|(x, y)| Position::new(x, y))).unwrap();
        Room::new(&area, 1.0, 0.1).unwrap()
    }

    #[test]
    fn a_speed_that_can_be_stopped_inside_is_kept() {
        // 0.108 + 0.583 m before the edge, for the speed that is judged.
        let from = Position::new(0.308, 0.0);
        assert_eq!(room().speed(&from, &Velocity::new(1.0, 0.0), 0.0), 1.0);
        assert_eq!(room().speed(&from, &Velocity::zeros(), 0.0), 0.0);
    }

    #[test]
    fn nearer_to_the_edge_the_way_of_the_stop_ends_there() {
        for before in [0.01, 0.1, 0.3, 0.59] {
            let from = Position::new(1.0 - before, 0.0);
            let speed = room().speed(&from, &Velocity::new(1.0, 0.0), 0.0);
            let judged = JUDGED * speed;
            let way = 0.1 * judged + 0.5 * judged * judged;
            assert!((way - before).abs() < 1e-3, "{before}: {speed} {way}");
        }
        let outside = Position::new(1.001, 0.0);
        assert_eq!(room().speed(&outside, &Velocity::new(1.0, 0.0), 0.0), 0.0);
    }

    #[test]
    fn a_bend_that_turns_from_the_edge_may_be_faster() {
        let from = Position::new(0.8, 0.0);
        let velocity = Velocity::new(0.6, 0.8);
        let straight = room().speed(&from, &velocity, 0.0);
        let away = room().speed(&from, &velocity, 1.5);
        let towards = room().speed(&from, &velocity, -1.5);
        assert!(
            towards < straight && straight < away,
            "{towards} {straight} {away}"
        );
    }

    #[test]
    fn nothing_is_left_of_an_area_that_is_too_small() {
        let corners = [(0.0, 0.0), (0.05, 0.0), (0.05, 0.05)];
        let area = ConvexArea::new(&corners.map(|(x, y)| Position::new(x, y))).unwrap();
        assert_eq!(Room::new(&area, 1.0, 0.1), None);
    }
}
