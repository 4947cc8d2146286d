//! The paths of the comparison: reference, start, and what is counted.

use core::f64::consts::{FRAC_PI_2, TAU};

use clap::ValueEnum;
use singletrack_control::{Reference, ReferencePoint, words};
use singletrack_core::{
    ConfigError,
    config::{PathPoints, ReferenceSection, Start, WaypointSection},
};

words! {
    /// A path.
    #[derive(ValueEnum)]
    pub enum PathName: serde {
        /// A circle of 1 m: beyond 1.595 m/s the tyres slide.
        Circle = "circle",
        /// An eight of 6 x 3 m; the speed is that in its middle, where it is highest.
        Eight = "eight",
        /// Half a metre to the left over 3 m of a straight line.
        LaneChange = "lane-change",
        /// An ellipse of 6 x 4 m.
        Ellipse = "ellipse",
        /// Half a metre to the left over 3 m, and back after another metre.
        DoubleLaneChange = "double-lane-change",
        /// Waypoints at the corners of a polygon with twelve sides of a metre.
        Corners = "corners",
        /// An eight of 7 x 3 m.
        WideEight = "wide-eight",
        /// A lane change with whose end the car stops, and stands.
        Stop = "stop",
        /// An ellipse of 4 x 2 m: at its ends the wheels can't be turned far enough.
        TightEllipse = "tight-ellipse",
        /// A circle of 0.45 m: the wheels can't be turned that far.
        InfeasibleCircle = "infeasible-circle",
    }
}

/// The paths that the parameters were not chosen on, and that a car can drive.
pub(super) const TEST_PATHS: [PathName; 5] = [
    PathName::Ellipse,
    PathName::DoubleLaneChange,
    PathName::Corners,
    PathName::WideEight,
    PathName::Stop,
];

/// Just below where the tyres slide, at 2.45 m/s²: what is compared are loops, not limits.
pub(super) const LATERAL_M_S2: f64 = 2.4;

const ELLIPSE_POINTS: u32 = 120;
const SIDES: u32 = 12;
const SIDE_M: f64 = 1.0;
/// The way between the two changes of a double one, in m.
const LANE_BETWEEN_M: f64 = 1.0;
/// The time after a stop that is counted, in s.
const STANDS_S: f64 = 1.0;
/// The lane change: width, length, acceleration at its ends, and time on the straight lines.
const LANE_M: f64 = 0.5;
const LANE_LENGTH_M: f64 = 3.0;
const LANE_ACCELERATION_M_S2: f64 = 1.0;
const LANE_STRAIGHT_S: f64 = 1.5;
const LANE_LATERAL_M_S2: f64 = 2.0;
/// Distance of the points that a lane change is given by, in m.
const LANE_STEP_M: f64 = 0.1;

/// Time until the error of the start, when the reference moves at once, has decayed, in s.
const SETTLING_S: f64 = 12.0;
/// Time that is counted on a circle, in s.
const CIRCLE_S: f64 = 20.0;

/// A path with a speed.
#[derive(Clone, Debug)]
pub(super) struct Course {
    /// The reference of the car's control point.
    pub(super) reference: ReferenceSection,
    /// Start of the control point, in m, and direction of the path there, in rad.
    pub(super) start: [f64; 2],
    pub(super) heading: f64,
    /// Whether the reference comes to an end, in place of driving on round after round.
    pub(super) ends: bool,
    /// The time that is counted, in s since the car drives.
    pub(super) counted: [f64; 2],
}

impl Course {
    pub(super) fn new(path: PathName, speed: f64) -> Self {
        match path {
            PathName::Circle => Self::circle(1.0, speed),
            PathName::InfeasibleCircle => Self::circle(0.45, speed),
            PathName::Eight => Self::eight(3.0, 1.5, speed),
            PathName::WideEight => Self::eight(3.5, 1.5, speed),
            PathName::Ellipse => Self::ellipse([3.0, 2.0], speed),
            PathName::TightEllipse => Self::ellipse([2.0, 1.0], speed),
            PathName::Corners => Self::corners(speed),
            PathName::LaneChange => Self::lane_change(speed, &[LANE_M]),
            PathName::DoubleLaneChange => Self::lane_change(speed, &[LANE_M, -LANE_M]),
            PathName::Stop => Self::stop(speed),
        }
    }

    /// A path that is driven round after round from here, of which this time, in s, is counted.
    const fn rounds(
        reference: ReferenceSection,
        start: [f64; 2],
        heading: f64,
        counted_s: f64,
    ) -> Self {
        Self {
            reference,
            start,
            heading,
            ends: false,
            counted: [SETTLING_S, SETTLING_S + counted_s],
        }
    }

    /// With this radius, in m.
    fn circle(radius: f64, speed: f64) -> Self {
        let reference = ReferenceSection::Circle {
            radius_m: radius,
            angular_velocity_rad_s: speed / radius,
            centre_m: [0.0; 2],
            start: Start::Beginning,
        };
        Self::rounds(reference, [radius, 0.0], FRAC_PI_2, CIRCLE_S)
    }

    /// With these halves of its length and width, in m.
    fn eight(half_length: f64, half_width: f64, speed: f64) -> Self {
        let rate = speed / libm::hypot(half_length, 2.0 * half_width);
        let reference = ReferenceSection::FigureOfEight {
            half_length_m: half_length,
            half_width_m: half_width,
            angular_velocity_rad_s: rate,
            centre_m: [0.0; 2],
            start: Start::Beginning,
        };
        let heading = libm::atan2(2.0 * half_width, half_length);
        // One figure.
        Self::rounds(reference, [0.0; 2], heading, TAU / rate)
    }

    /// With these half axes, in m, from its right end on, to the left.
    fn ellipse([a, b]: [f64; 2], speed: f64) -> Self {
        let points = (0..ELLIPSE_POINTS).map(|index| {
            let angle = TAU * f64::from(index) / f64::from(ELLIPSE_POINTS);
            [a * libm::cos(angle), b * libm::sin(angle)]
        });
        let points: Vec<[f64; 2]> = points.collect();
        let ends = points.iter().zip(points.iter().cycle().skip(1));
        let length: f64 = ends.map(|(from, to)| distance(*from, *to)).sum();
        let reference = ReferenceSection::Path {
            points: PathPoints::Points(points),
            closed: true,
            speed_m_s: speed,
            lateral_acceleration_m_s2: LATERAL_M_S2,
            acceleration_m_s2: LANE_ACCELERATION_M_S2,
            start: Start::Beginning,
        };
        // One round.
        Self::rounds(reference, [a, 0.0], FRAC_PI_2, length / speed)
    }

    fn corners(speed: f64) -> Self {
        let sides = f64::from(SIDES);
        let turn = TAU / sides;
        let radius = 0.5 * SIDE_M / libm::sin(0.5 * turn);
        let round_s = sides * SIDE_M / speed;
        let count = (speed * (SETTLING_S + round_s + 6.0) / SIDE_M) as u32;
        // It speeds up over the first sides.
        let run_up = 0.5 * speed * speed / LANE_ACCELERATION_M_S2;
        let time = |way: f64| {
            if way < run_up {
                (2.0 * way / LANE_ACCELERATION_M_S2).sqrt()
            } else {
                (way + run_up) / speed
            }
        };
        // The first side leads along y.
        let corner = |index: u32| {
            let angle = turn * (f64::from(index) - 0.5);
            [radius * libm::cos(angle), radius * libm::sin(angle)]
        };
        let waypoint = |index: u32| {
            let [x_m, y_m] = corner(index);
            WaypointSection {
                t_s: time(f64::from(index) * SIDE_M),
                x_m,
                y_m,
            }
        };
        let waypoints = (0..=count).map(waypoint).collect();
        let reference = ReferenceSection::WaypointList { waypoints };
        Self::rounds(reference, corner(0), FRAC_PI_2, round_s)
    }

    /// A straight line, changes to the left by `steps` over [`LANE_LENGTH_M`] each with
    /// [`LANE_BETWEEN_M`] between them, and a straight line.
    fn lane_change(speed: f64, steps: &[f64]) -> Self {
        let run_up = 0.5 * speed * speed / LANE_ACCELERATION_M_S2;
        let before = run_up + LANE_STRAIGHT_S * speed;
        Self::lanes(speed, steps, [before, before])
    }

    /// Changes of lane by these steps, with straight lines of these lengths.
    fn lanes(speed: f64, steps: &[f64], [before, after]: [f64; 2]) -> Self {
        let changes = steps.len() as f64 * (LANE_LENGTH_M + LANE_BETWEEN_M) - LANE_BETWEEN_M;
        let length = before + changes + after;
        let count = libm::ceil(length / LANE_STEP_M);
        let point = |index: u32| {
            let x = length * f64::from(index) / count;
            let each = steps.iter().enumerate().map(|(place, step)| {
                let from = before + place as f64 * (LANE_LENGTH_M + LANE_BETWEEN_M);
                // A polynomial without a jump of curvature.
                let u = ((x - from) / LANE_LENGTH_M).clamp(0.0, 1.0);
                step * u * u * u * (10.0 + u * (6.0 * u - 15.0))
            });
            [x - 0.5 * length, each.sum()]
        };
        let begins = speed / LANE_ACCELERATION_M_S2 + LANE_STRAIGHT_S;
        Self {
            reference: ReferenceSection::Path {
                points: PathPoints::Points((0..=count as u32).map(point).collect()),
                closed: false,
                speed_m_s: speed,
                // More than the change needs: it is driven at full speed.
                lateral_acceleration_m_s2: LANE_LATERAL_M_S2,
                acceleration_m_s2: LANE_ACCELERATION_M_S2,
                start: Start::Beginning,
            },
            start: point(0),
            heading: 0.0,
            ends: true,
            counted: [
                begins - 0.5,
                begins + changes / speed + 0.8 * LANE_STRAIGHT_S,
            ],
        }
    }

    /// The car slows down on the straight line behind the change; its stop is counted.
    fn stop(speed: f64) -> Self {
        let ramp = 0.5 * speed * speed / LANE_ACCELERATION_M_S2;
        let course = Self::lanes(speed, &[LANE_M], [ramp + LANE_STRAIGHT_S * speed, ramp]);
        let [from, _] = course.counted;
        let changed = from + 0.5 + LANE_LENGTH_M / speed;
        let stands = changed + speed / LANE_ACCELERATION_M_S2;
        Self {
            counted: [changed, stands + STANDS_S],
            ..course
        }
    }
}

/// A reference as a table over time: where its path is, and which point of it is nearest.
#[derive(Clone, Debug)]
pub(super) struct Table {
    /// What it was made of.
    pub(super) reference: Reference,
    samples: Vec<Sample>,
}

/// A point of a path.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    /// Distance along the path, in m.
    pub(super) way: f64,
    pub(super) position: [f64; 2],
    /// Direction of the path, in rad.
    pub(super) heading: f64,
    /// Speed of the reference, in m/s.
    pub(super) speed: f64,
}

const SAMPLES_PER_SECOND: f64 = 200.0;

impl Table {
    /// Up to `duration` seconds.
    pub(super) fn new(course: &Course, duration: f64) -> Result<Self, ConfigError> {
        let reference = course.reference.reference()?;
        let mut samples: Vec<Sample> = Vec::new();
        for index in 0..=(duration * SAMPLES_PER_SECOND) as u32 {
            let mut sample = at(
                &reference,
                f64::from(index) / SAMPLES_PER_SECOND,
                samples.last().map_or(course.heading, |last| last.heading),
            );
            if let Some(last) = samples.last() {
                sample.way = last.way + distance(last.position, sample.position);
            }
            samples.push(sample);
        }
        Ok(Self { reference, samples })
    }

    /// Where the reference is at a time, exactly.
    pub(super) fn at(&self, time: f64) -> Sample {
        let place = (time * SAMPLES_PER_SECOND).max(0.0);
        let before = self.get(place as usize);
        let mut sample = at(&self.reference, time, before.heading);
        sample.way = before.way + distance(before.position, sample.position);
        sample
    }

    pub(super) fn get(&self, index: usize) -> &Sample {
        // It has the sample of time 0 at least.
        &self.samples[index.min(self.samples.len() - 1)]
    }

    /// The nearest point of the path, not far from that at `index`: the path may cross
    /// itself.
    pub(super) fn nearest(&self, position: [f64; 2], index: usize) -> usize {
        let about = self.get(index).way;
        let first = self.find(about - SEARCH_M[0]);
        let last = self.find(about + SEARCH_M[1]);
        let mut best = (f64::INFINITY, index);
        for index in first..=last {
            let distance = distance(self.get(index).position, position);
            if distance < best.0 {
                best = (distance, index);
            }
        }
        best.1
    }

    /// The first place that is `way` metres along the path.
    pub(super) fn find(&self, way: f64) -> usize {
        let index = self.samples.partition_point(|sample| sample.way < way);
        index.min(self.samples.len() - 1)
    }
}

/// How far behind and ahead the nearest point is searched, in m.
const SEARCH_M: [f64; 2] = [0.3, 0.3];

/// The reference at a time, without its way; `heading` is its direction if it stands.
fn at(reference: &Reference, time: f64, heading: f64) -> Sample {
    let ReferencePoint { position, velocity } = reference.at(time);
    let position = position.unwrap_or_default();
    let speed = libm::hypot(velocity.x, velocity.y);
    Sample {
        way: 0.0,
        position: [position.x, position.y],
        heading: if speed > 1e-3 {
            libm::atan2(velocity.y, velocity.x)
        } else {
            heading
        },
        speed,
    }
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    libm::hypot(a[0] - b[0], a[1] - b[1])
}
