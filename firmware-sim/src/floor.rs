//! The floor that several cars share: where each is for the cameras of the others, and how near they
//! come to each other.

use libm::sincos;

use crate::{
    cameras::{DecoyMotion, Sight},
    car::Truth,
};

/// Cars on one floor. Each has a world of its own, in which the others are decoys.
#[derive(Clone, Debug)]
pub struct Floor {
    cars: Vec<FloorCar>,
    /// The least distance between two bodies so far, in m; negative if they have overlapped.
    pub nearest_m: f64,
}

#[derive(Clone, Debug)]
struct FloorCar {
    half_m: [f64; 2],
    seen: Sight,
    /// Its time on the floor's clock, in µs, and where it was.
    placed: Option<(i64, Truth)>,
}

impl Floor {
    /// A floor for cars with these halves of length and width, in m.
    pub fn new(halves_m: impl IntoIterator<Item = [f64; 2]>) -> Self {
        let car = |half_m| FloorCar {
            half_m,
            seen: Sight::Now,
            placed: None,
        };
        Self {
            cars: halves_m.into_iter().map(car).collect(),
            nearest_m: f64::INFINITY,
        }
    }

    /// Car `index` is here now; `started_us` is when its world began, on the floor's clock. Whether it
    /// drives into another one, which stops it: [`Car::collide`](crate::Car::collide).
    #[must_use]
    pub fn place(&mut self, index: usize, started_us: i64, truth: Truth) -> bool {
        let Some(car) = self.cars.get_mut(index) else {
            return false;
        };
        car.placed = Some((started_us + truth.time_us as i64, truth));
        let half_m = car.half_m;
        let (mut nearest_m, mut collides) = (self.nearest_m, false);
        for other in self.others(index) {
            let Some((_, placed)) = other.placed else {
                continue;
            };
            let gap_m = apart(&truth, &placed, [half_m, other.half_m]);
            let [x, y] = velocity(&truth);
            let approaches = x * (placed.x - truth.x) + y * (placed.y - truth.y) > 0.0;
            collides |= gap_m < 0.0 && approaches;
            nearest_m = nearest_m.min(gap_m);
        }
        self.nearest_m = nearest_m;
        collides
    }

    /// The others, in their order, as decoys of the world of car `index`, which began at
    /// `started_us`.
    pub fn decoys(&self, index: usize, started_us: i64) -> impl Iterator<Item = DecoyMotion> {
        self.others(index).map(move |other| {
            let (at_us, truth) = other.placed.unwrap_or_default();
            DecoyMotion {
                at_us: at_us - started_us,
                position_m: [truth.x, truth.y],
                velocity_m_s: velocity(&truth),
                seen: match other.placed {
                    Some(_) => other.seen,
                    None => Sight::Not,
                },
            }
        })
    }

    fn others(&self, index: usize) -> impl Iterator<Item = &FloorCar> {
        let cars = self.cars.iter().enumerate();
        cars.filter_map(move |(other, car)| (other != index).then_some(car))
    }

    /// What the cameras of the others see of a car.
    pub fn show(&mut self, index: usize, seen: Sight) {
        if let Some(car) = self.cars.get_mut(index) {
            car.seen = seen;
        }
    }
}

/// In the floor's frame, in m/s.
fn velocity(truth: &Truth) -> [f64; 2] {
    let (sin, cos) = sincos(truth.yaw + truth.sideslip);
    [truth.speed * cos, truth.speed * sin]
}

/// The distance between two rectangles along the axis of either that separates them best, in m: not
/// more than the true one; negative if they overlap.
fn apart(one: &Truth, other: &Truth, [one_half, other_half]: [[f64; 2]; 2]) -> f64 {
    let axes = |truth: &Truth| {
        let (sin, cos) = sincos(truth.yaw);
        [[cos, sin], [-sin, cos]]
    };
    let (one_axes, other_axes) = (axes(one), axes(other));
    let way = [other.x - one.x, other.y - one.y];
    let dot = |a: [f64; 2], b: [f64; 2]| a[0] * b[0] + a[1] * b[1];
    let reach = |axes: [[f64; 2]; 2], half: [f64; 2], along| {
        dot(axes[0], along).abs() * half[0] + dot(axes[1], along).abs() * half[1]
    };
    let gap = |along| {
        dot(way, along).abs()
            - reach(one_axes, one_half, along)
            - reach(other_axes, other_half, along)
    };
    let all = one_axes.into_iter().chain(other_axes);
    all.map(gap).fold(f64::NEG_INFINITY, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f64, y: f64, yaw: f64) -> Truth {
        Truth {
            x,
            y,
            yaw,
            ..Truth::default()
        }
    }

    #[test]
    fn the_gap_between_two_bodies_is_that_of_their_rectangles() {
        let mut floor = Floor::new([[0.2, 0.1]; 2]);
        assert!(!floor.place(0, 0, at(0.0, 0.0, 0.0)));
        assert_eq!(floor.nearest_m, f64::INFINITY);
        for (truth, gap) in [
            (at(1.0, 0.0, 0.0), 0.6),
            (at(1.0, 0.0, core::f64::consts::FRAC_PI_2), 0.7),
            (at(0.0, -0.5, 0.0), 0.3),
            (at(0.3, 0.1, 0.0), -0.1),
        ] {
            let mut floor = floor.clone();
            assert!(!floor.place(1, 0, truth), "it stands");
            assert!((floor.nearest_m - gap).abs() < 1e-12, "{truth:?}");
        }
    }

    #[test]
    fn a_car_collides_with_a_body_that_it_overlaps_and_drives_at() {
        for (x, speed, collides) in [
            (0.3, 1.0, true),
            (0.3, -1.0, false),
            (-0.3, -1.0, true),
            (0.5, 1.0, false),
        ] {
            let mut floor = Floor::new([[0.2, 0.1]; 2]);
            let _ = floor.place(1, 0, at(x, 0.0, 1.0));
            let mut truth = at(0.0, 0.0, 0.0);
            truth.speed = speed;
            assert_eq!(floor.place(0, 0, truth), collides, "{x} {speed}");
        }
    }

    #[test]
    fn a_car_is_a_decoy_for_the_others_at_the_time_of_their_worlds() {
        let mut floor = Floor::new([[0.2, 0.1]; 2]);
        let mut truth = at(1.0, 2.0, 0.0);
        (truth.time_us, truth.speed) = (500, 3.0);
        assert!(!floor.place(1, 10_000, truth));
        let decoys: Vec<_> = floor.decoys(0, 2_000).collect();
        let decoy = DecoyMotion {
            at_us: 8_500,
            position_m: [1.0, 2.0],
            velocity_m_s: [3.0, 0.0],
            seen: Sight::Now,
        };
        assert_eq!(decoys, [decoy]);
        assert!(floor.decoys(1, 0).all(|decoy| decoy.seen == Sight::Not));
        floor.show(1, Sight::Not);
        assert!(floor.decoys(0, 0).all(|decoy| decoy.seen == Sight::Not));
    }
}
