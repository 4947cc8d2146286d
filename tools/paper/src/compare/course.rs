//! The paths of the comparison: reference, start, and what is counted.

use clap::ValueEnum;
use singletrack_control::{Reference, ReferencePoint};
use singletrack_core::{
    ConfigError,
    config::{ReferenceSection, Start},
};
use singletrack_words::words;

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
        /// A circle of 0.45 m: the wheels can't be turned that far.
        InfeasibleCircle = "infeasible-circle",
    }
}

const RADIUS_M: f64 = 1.0;
const INFEASIBLE_RADIUS_M: f64 = 0.45;
const HALF_LENGTH_M: f64 = 3.0;
const HALF_WIDTH_M: f64 = 1.5;
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
            PathName::Circle => Self::circle(RADIUS_M, speed),
            PathName::InfeasibleCircle => Self::circle(INFEASIBLE_RADIUS_M, speed),
            PathName::Eight => {
                let rate = speed / libm::hypot(HALF_LENGTH_M, 2.0 * HALF_WIDTH_M);
                Self {
                    reference: ReferenceSection::FigureOfEight {
                        half_length_m: HALF_LENGTH_M,
                        half_width_m: HALF_WIDTH_M,
                        angular_velocity_rad_s: rate,
                        centre_m: [0.0; 2],
                        start: Start::Beginning,
                    },
                    start: [0.0; 2],
                    heading: libm::atan2(2.0 * HALF_WIDTH_M, HALF_LENGTH_M),
                    ends: false,
                    // One figure.
                    counted: [SETTLING_S, SETTLING_S + core::f64::consts::TAU / rate],
                }
            }
            PathName::LaneChange => Self::lane_change(speed),
        }
    }

    fn circle(radius: f64, speed: f64) -> Self {
        Self {
            reference: ReferenceSection::Circle {
                radius_m: radius,
                angular_velocity_rad_s: speed / radius,
                centre_m: [0.0; 2],
                start: Start::Beginning,
            },
            start: [radius, 0.0],
            heading: core::f64::consts::FRAC_PI_2,
            ends: false,
            counted: [SETTLING_S, SETTLING_S + CIRCLE_S],
        }
    }

    fn lane_change(speed: f64) -> Self {
        let run_up = 0.5 * speed * speed / LANE_ACCELERATION_M_S2;
        let before = run_up + LANE_STRAIGHT_S * speed;
        let length = before + LANE_LENGTH_M + before;
        let count = libm::ceil(length / LANE_STEP_M);
        let point = |index: u32| {
            let x = length * f64::from(index) / count;
            // A polynomial without a jump of curvature.
            let u = ((x - before) / LANE_LENGTH_M).clamp(0.0, 1.0);
            let y = LANE_M * u * u * u * (10.0 + u * (6.0 * u - 15.0));
            [x - 0.5 * length, y]
        };
        let begins = speed / LANE_ACCELERATION_M_S2 + LANE_STRAIGHT_S;
        Self {
            reference: ReferenceSection::PathList {
                points: (0..=count as u32).map(point).collect(),
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
                begins + LANE_LENGTH_M / speed + 0.8 * LANE_STRAIGHT_S,
            ],
        }
    }
}

/// A reference as a table over time: where its path is, and which point of it is nearest.
#[derive(Clone, Debug)]
pub(super) struct Table {
    reference: Reference,
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

    /// What it was made of.
    pub(super) const fn reference(&self) -> &Reference {
        &self.reference
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
