//! Turns a path along which the car was pushed into points of a reference.
//!
//! A reference is the path of P, the point in front of the front axle. Where P is depends on
//! the steering angle, and the wheels of a car that is pushed point anywhere. But wheels that
//! roll point along the path of the front axle. So the path of P is taken from that of the
//! front axle: P lies ahead of it in the direction of its motion. A car whose P follows this
//! path rolls as it was pushed.

use nalgebra::{Matrix3, Matrix3x2, Vector3};
use singletrack_control::{Position, Velocity, direction, wrap};
use singletrack_statistics::RootMeanSquare;

/// Where the car was at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Position of the centre of mass, in m.
    pub position: Position,
    /// Heading, in rad.
    pub yaw: f64,
}

/// Geometry of the car and of the path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TeachOptions {
    /// Distance of the front axle from the centre of mass, in m.
    pub front_axle_distance_m: f64,
    /// Distance of P from the front axle, in m.
    pub point_distance_m: f64,
    /// Whether the path leads back to its start.
    pub is_closed: bool,
    /// Distance between the points, along the path of the front axle, in m.
    pub spacing_m: f64,
}

/// A path that was taught.
#[derive(Clone, Debug, PartialEq)]
pub struct Taught {
    /// Points on the path of P.
    pub points: Vec<Position>,
    /// Length of the path of the front axle, in m.
    pub length_m: f64,
    /// How far apart the ends of a closed path were, in m; zero for an open one.
    pub gap_m: f64,
    /// How far the places were off the smooth path, as a root mean square, in m.
    pub roughness_m: f64,
}

/// Why places make no path.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum TeachError {
    /// The car has hardly moved.
    #[error("the car has moved {length_m:.2} m; a path needs {LEAST_LENGTH_M} m")]
    Short {
        /// Length of the path, in m.
        length_m: f64,
    },
    /// The car moved backward or sideways: no wheels roll like this.
    #[error(
        "at ({x_m:.2}, {y_m:.2}) m the front axle moved {degrees:.0} degrees off the car's \
         heading; push the car forward, with its front wheels turned as far as it should bend"
    )]
    Across {
        /// Where the front axle was, in m.
        x_m: f64,
        /// Where the front axle was, in m.
        y_m: f64,
        /// Between the motion and the heading, in degrees.
        degrees: f64,
    },
    /// The cameras did not see the car on a part of its way.
    #[error(
        "the cameras lost the car before ({x_m:.2}, {y_m:.2}) m: {step_m:.2} m are missing; push \
         it again, with your hands beside the markers"
    )]
    Jump {
        /// Where the front axle was seen again, in m.
        x_m: f64,
        /// Where the front axle was seen again, in m.
        y_m: f64,
        /// The length that is missing, in m.
        step_m: f64,
    },
    /// The ends of a closed path are too far apart.
    #[error(
        "the path comes back to {gap_m:.2} m beside its start; a closed path needs {CLOSE_M} m: \
         push the car on until it is where it began"
    )]
    Open {
        /// The distance, in m.
        gap_m: f64,
    },
    /// There are more points than a reference takes.
    #[error("{count} points, {most} fit; give a larger spacing")]
    TooMany {
        /// The number of points.
        count: usize,
        /// The largest number.
        most: usize,
    },
}

/// The shortest path, in m.
const LEAST_LENGTH_M: f64 = 0.5;
/// Places that are closer to the last one count as standing, in m.
const LEAST_STEP_M: f64 = 0.005;
/// The longest way between two places, in m.
const LONGEST_STEP_M: f64 = 0.15;
/// Half of the length over which places are averaged, in m.
const WINDOW_M: f64 = 0.15;
/// The largest angle between the motion of the front axle and the heading, in rad: more than
/// wheels can be turned.
const ACROSS_RAD: f64 = 1.0;
/// The largest distance between the ends of a closed path, in m.
const CLOSE_M: f64 = 0.15;
/// The share of a closed path in which its end is looked for.
const END_SHARE: f64 = 0.3;

/// A place of the front axle, with the way to it.
#[derive(Clone, Copy, Debug)]
struct Step {
    way: f64,
    position: Position,
    yaw: f64,
}

/// The smooth path of P for the `places` of a car that was moved, in their order.
///
/// # Errors
///
/// The places make no path that a car can drive.
pub fn taught_path(places: &[Place], options: &TeachOptions) -> Result<Taught, TeachError> {
    let mut steps = front_axle(places, options.front_axle_distance_m)?;
    let mut gap_m = 0.0;
    if options.is_closed {
        gap_m = close(&mut steps)?;
    }
    let length_m = steps.last().map_or(0.0, |step| step.way);
    if length_m < LEAST_LENGTH_M {
        return Err(TeachError::Short { length_m });
    }
    if options.is_closed {
        go_round(&mut steps, length_m);
    }
    let stretches = (length_m / options.spacing_m).round().max(2.0);
    let most = singletrack_control::MAX_PATH_POINTS;
    if stretches >= most as f64 {
        return Err(TeachError::TooMany {
            count: stretches as usize + 1,
            most,
        });
    }
    let count = stretches as usize + usize::from(!options.is_closed);
    let mut points = Vec::with_capacity(count);
    for index in 0..count {
        let way = length_m * index as f64 / stretches;
        let (at, slope) = smooth(&steps, way);
        let heading = slope.y.atan2(slope.x);
        let yaw = nearest(&steps, way).yaw;
        let off = wrap(heading - yaw);
        if off.abs() > ACROSS_RAD {
            return Err(TeachError::Across {
                x_m: at.x,
                y_m: at.y,
                degrees: off.to_degrees(),
            });
        }
        points.push(at + options.point_distance_m * direction(heading));
    }
    Ok(Taught {
        points,
        length_m,
        gap_m,
        roughness_m: roughness(&steps, length_m),
    })
}

/// The places of the front axle, without those where the car stood.
fn front_axle(places: &[Place], distance: f64) -> Result<Vec<Step>, TeachError> {
    let mut steps: Vec<Step> = Vec::new();
    for place in places {
        let position = place.position + distance * direction(place.yaw);
        let way = match steps.last() {
            None => 0.0,
            Some(last) => {
                let step = (position - last.position).norm();
                if step < LEAST_STEP_M {
                    continue;
                }
                if step > LONGEST_STEP_M {
                    return Err(TeachError::Jump {
                        x_m: position.x,
                        y_m: position.y,
                        step_m: step,
                    });
                }
                last.way + step
            }
        };
        steps.push(Step {
            way,
            position,
            yaw: place.yaw,
        });
    }
    Ok(steps)
}

/// Cuts a closed path where it comes back to its start, and spreads the gap between its ends
/// over its length. Returns the gap.
fn close(steps: &mut Vec<Step>) -> Result<f64, TeachError> {
    let length = steps.last().map_or(0.0, |step| step.way);
    let Some(first) = steps.first().copied() else {
        return Ok(0.0);
    };
    let nearest = steps
        .iter()
        .enumerate()
        .filter(|(_, step)| step.way > (1.0 - END_SHARE) * length)
        .map(|(index, step)| (index, (step.position - first.position).norm()))
        .min_by(|a, b| a.1.total_cmp(&b.1));
    let Some((end, distance)) = nearest else {
        return Ok(0.0);
    };
    // Of the way between the ends, only what lies across it is an error.
    let last = steps.get(end).copied().unwrap_or(first);
    let along = smooth(steps, 0.0).1.normalize() + smooth(steps, last.way).1.normalize();
    let along = along.try_normalize(0.1).unwrap_or_default();
    let ahead = along.dot(&(first.position - last.position));
    let gap = (first.position - last.position) - ahead * along;
    if gap.norm() > CLOSE_M || distance > 2.0 * CLOSE_M {
        return Err(TeachError::Open { gap_m: distance });
    }
    steps.truncate(end + 1);
    // The last step ends where the first begins.
    let length = last.way + ahead;
    steps.retain(|step| step.way < length - LEAST_STEP_M);
    for step in steps.iter_mut() {
        step.position += step.way / length * gap;
    }
    steps.push(Step {
        way: length,
        ..first
    });
    Ok(gap.norm())
}

/// Repeats the ends of a closed path beyond it, so that they are smoothed like the rest.
fn go_round(steps: &mut Vec<Step>, length: f64) {
    // Its last step is its first.
    steps.pop();
    let beyond = 2.0 * WINDOW_M;
    let shifted = |step: &Step, by: f64| Step {
        way: step.way + by,
        ..*step
    };
    let before = steps.iter().filter(|step| step.way > length - beyond);
    let mut around: Vec<Step> = before.map(|step| shifted(step, -length)).collect();
    around.extend(steps.iter().copied());
    let after = steps.iter().filter(|step| step.way < beyond);
    around.extend(after.map(|step| shifted(step, length)));
    *steps = around;
}

fn nearest(steps: &[Step], way: f64) -> Step {
    let after = steps.partition_point(|step| step.way < way);
    let index = after.min(steps.len().saturating_sub(1));
    steps.get(index).copied().unwrap_or(Step {
        way: 0.0,
        position: Position::origin(),
        yaw: 0.0,
    })
}

/// Position and direction at `way`: a parabola through the places around it, which count the
/// less the further away they are.
fn smooth(steps: &[Step], way: f64) -> (Position, Velocity) {
    let ends = steps.first().zip(steps.last());
    let room = ends.map_or(0.0, |(first, last)| (way - first.way).min(last.way - way));
    // At an end the places are on one side only: twice as far.
    let window = 2.0 * WINDOW_M - room.clamp(0.0, WINDOW_M);
    let from = steps.partition_point(|step| step.way < way - window);
    let to = steps.partition_point(|step| step.way <= way + window);
    let around = steps.get(from..to).unwrap_or_default();
    // The normal equations, in units of the window.
    let mut normal = Matrix3::zeros();
    let mut right = Matrix3x2::zeros();
    let origin = nearest(steps, way).position;
    for step in around {
        let x = (step.way - way) / window;
        let weight = (1.0 - x.abs().powi(3)).max(0.0).powi(3);
        let row = Vector3::new(1.0, x, x * x);
        normal += weight * row * row.transpose();
        right += weight * row * (step.position - origin).transpose();
    }
    let inverse = normal.try_inverse();
    match inverse.filter(|_| normal.determinant().abs() >= 1e-9) {
        Some(inverse) => {
            let parabola = inverse * right;
            let [offset, slope] = [0, 1].map(|power| parabola.row(power).transpose());
            (origin + offset, slope)
        }
        None => {
            let near = nearest(steps, way);
            (near.position, direction(near.yaw))
        }
    }
}

fn roughness(steps: &[Step], length: f64) -> f64 {
    let inside = steps
        .iter()
        .filter(|step| (0.0..=length).contains(&step.way));
    let mut off = RootMeanSquare::default();
    for step in inside {
        off.add_square((smooth(steps, step.way).0 - step.position).norm_squared());
    }
    off.value().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    const OPTIONS: TeachOptions = TeachOptions {
        front_axle_distance_m: 0.14,
        point_distance_m: 0.35,
        is_closed: false,
        spacing_m: 0.1,
    };

    /// Noise of a camera's position, in m; the same every time.
    fn noise(index: usize) -> Velocity {
        let hash = |salt: u64| {
            let mut bits = (index as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ salt;
            bits = (bits ^ (bits >> 31)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            (bits >> 40) as f64 / f64::from(1_u32 << 24) - 0.5
        };
        // A standard deviation of 0.5 mm.
        1.7e-3 * Velocity::new(hash(1), hash(0xabcd_ef01))
    }

    /// A car whose front axle goes round a circle of this radius, by this angle.
    fn round(radius: f64, angle: f64, noisy: bool) -> Vec<Place> {
        let wheelbase = 0.26;
        let count = (radius * angle / 0.003) as usize;
        // The wheels' angle to the car, on a circle of the front axle.
        let steering = (wheelbase / radius).asin();
        (0..count)
            .map(|index| {
                let at = angle * index as f64 / count as f64;
                let front = Position::origin() + radius * direction(at);
                let yaw = at + std::f64::consts::FRAC_PI_2 - steering;
                let error = if noisy {
                    noise(index)
                } else {
                    Velocity::zeros()
                };
                Place {
                    position: front - OPTIONS.front_axle_distance_m * direction(yaw) + error,
                    yaw,
                }
            })
            .collect()
    }

    #[test]
    fn p_is_ahead_of_the_front_axle_along_its_path() {
        for noisy in [false, true] {
            let taught = taught_path(&round(1.0, 4.0, noisy), &OPTIONS).unwrap();
            // On a circle the front axle, its direction and P make a right angle.
            let radius = 1.0_f64.hypot(OPTIONS.point_distance_m);
            let tolerance = if noisy { 3e-3 } else { 5e-4 };
            for point in &taught.points {
                let off = point.coords.norm() - radius;
                assert!(off.abs() < tolerance, "{off}");
            }
            assert!((taught.length_m - 4.0).abs() < if noisy { 0.12 } else { 0.01 });
            assert!(taught.roughness_m < 1e-3);
            assert_eq!(taught.gap_m, 0.0);
        }
    }

    #[test]
    fn a_closed_path_goes_on_where_it_began() {
        let closed = TeachOptions {
            is_closed: true,
            ..OPTIONS
        };
        // A little more than once round, and a little less.
        for turn in [6.5, 6.2] {
            let taught = taught_path(&round(0.8, turn, true), &closed).unwrap();
            assert!(taught.gap_m < 0.01, "{}", taught.gap_m);
            let radius = 0.8_f64.hypot(OPTIONS.point_distance_m);
            let count = taught.points.len();
            for (index, point) in taught.points.iter().enumerate() {
                assert!((point.coords.norm() - radius).abs() < 4e-3, "{point}");
                let next = taught.points[(index + 1) % count];
                let step = (next - point).norm();
                assert!((0.08..0.13).contains(&step), "{step}");
            }
        }
        assert!(matches!(
            taught_path(&round(0.8, 5.0, false), &closed),
            Err(TeachError::Open { gap_m }) if gap_m > 0.5
        ));
    }

    #[test]
    fn what_no_wheels_can_roll_is_refused() {
        assert!(matches!(
            taught_path(&[], &OPTIONS),
            Err(TeachError::Short { .. })
        ));
        assert!(matches!(
            taught_path(&round(1.0, 0.3, false), &OPTIONS),
            Err(TeachError::Short { .. })
        ));
        let mut backward = round(1.0, 3.0, false);
        backward.reverse();
        assert!(matches!(
            taught_path(&backward, &OPTIONS),
            Err(TeachError::Across { degrees, .. }) if degrees.abs() > 150.0
        ));
        let mut unseen = round(1.0, 3.0, false);
        unseen.drain(300..400);
        assert!(matches!(
            taught_path(&unseen, &OPTIONS),
            Err(TeachError::Jump { step_m, .. }) if (0.28..0.32).contains(&step_m)
        ));
        let many = TeachOptions {
            spacing_m: 0.005,
            ..OPTIONS
        };
        assert!(matches!(
            taught_path(&round(1.0, 3.0, false), &many),
            Err(TeachError::TooMany { most: 400, .. })
        ));
    }

    #[test]
    fn a_car_that_stands_on_its_way_adds_no_points() {
        let mut places = round(1.0, 3.0, false);
        let middle = places[400];
        for index in 0..1_000 {
            let error = noise(index);
            places.insert(
                400,
                Place {
                    position: middle.position + error,
                    ..middle
                },
            );
        }
        let taught = taught_path(&places, &OPTIONS).unwrap();
        assert!((taught.length_m - 3.0).abs() < 0.03, "{}", taught.length_m);
    }
}
