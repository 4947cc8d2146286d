//! A filter behind any outer loop: whatever velocity of P is wanted, the car stays able to stop
//! inside its area.
//!
//! Two stages. The first is a quadratic program: of the velocities that keep P able to stop
//! before each side, with speed and lateral acceleration in bounds, the one nearest to what is
//! wanted. It makes the filter gentle, and the claim does not rest on it. The second tries the
//! law with that velocity, and with slower ones, and takes the first after which every stop
//! that the car may make stays inside. If there is none, the car stops, which the tick before
//! has proved to stay inside. `docs/safety-filter.md` states the claim with its assumptions.

mod projection;
mod stop_way;

use heapless::Vec;
use libm::{atan, cos, fabs, sin, sqrt, tan};

use self::{
    projection::{HalfPlane, MOST, nearest},
    stop_way::{Range, StopWay, Wheels},
};
use crate::{ConvexArea, Estimate, LimitedLaw, Position, Velocity, direction};

/// The number of ticks whose steering commands may still be on their way to the wheels.
pub const MAX_STEERING_TICKS: usize = 32;
/// Below this speed (m/s) the measured curvature is noise.
const BENDS_FROM: f64 = 0.2;
/// What a steering angle may exceed its bound by through rounding, rad.
const ROUNDING: f64 = 1e-9;
/// How much slower the velocities are that are tried one after the other.
const SLOWER: [f64; 5] = [1.0, 0.75, 0.5, 0.25, 0.0];

/// What the [`SafetyFilter`] rests on.
#[derive(Clone, Debug, PartialEq)]
pub struct SafetyConfig {
    /// Where the centre of mass may be: the geofence within its margin.
    pub area: ConvexArea,
    /// The time from a tick to when the car begins to slow down at the latest, s: the period,
    /// dead times, the lag of the motor.
    pub reaction: f64,
    /// The number of ticks after which the wheels are where they are commanded to be; less than
    /// [`MAX_STEERING_TICKS`].
    pub steering_ticks: usize,
    /// The largest error of the estimated position, m.
    pub position_error: f64,
    /// The largest error of the estimated course, rad.
    pub course_error: f64,
    /// The largest deviation of the path's curvature from tan(δ)/L, 1/m: slip, play and trim.
    pub curvature_error: f64,
    /// The largest speed of P, m/s.
    pub max_speed: f64,
    /// The largest lateral acceleration, m/s².
    pub max_lateral_acceleration: f64,
    /// Distance between the axles, m.
    pub wheelbase: f64,
}

/// A setting of the filter is not finite, or negative.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("{name} is {value}: it must be finite and not negative")]
pub struct SafetyConfigError {
    /// The value's name.
    pub name: &'static str,
    /// The value.
    pub value: f64,
}

/// The car at a tick.
#[derive(Clone, Copy, Debug)]
pub struct SafetyInput<'a> {
    /// The estimated state.
    pub estimate: &'a Estimate,
    /// The law as it is before this tick.
    pub law: &'a LimitedLaw,
    /// The largest of the estimated, the measured and the commanded speed, m/s.
    pub pace: f64,
    /// The way since the last pose, m.
    pub blind: f64,
    /// The deceleration that every stop reaches, m/s².
    pub braking: f64,
    /// The control period, s.
    pub period: f64,
}

/// What the filter made of a velocity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Filtered {
    /// Nothing: give it to the law as it is.
    Unchanged,
    /// Another velocity of P is to be given to the law, in m/s.
    Changed(Velocity),
    /// None keeps the car able to stop inside: slow down now, with the steering held.
    Stop,
}

/// The filter.
#[derive(Clone, Debug, PartialEq)]
pub struct SafetyFilter {
    config: SafetyConfig,
    /// The speed that commands on their way may still lead to, m/s.
    pace: f64,
    /// The steering of the last ticks, rad; the last one first.
    steering: [f64; MAX_STEERING_TICKS],
}

impl SafetyFilter {
    /// A filter for a standing car with straight wheels.
    ///
    /// # Errors
    ///
    /// [`SafetyConfigError`] for a value that is not finite or negative.
    pub fn new(config: SafetyConfig) -> Result<Self, SafetyConfigError> {
        for (name, value) in [
            ("reaction", config.reaction),
            ("position_error", config.position_error),
            ("course_error", config.course_error),
            ("curvature_error", config.curvature_error),
            ("max_speed", config.max_speed),
            ("max_lateral_acceleration", config.max_lateral_acceleration),
            ("wheelbase", config.wheelbase),
            (
                "steering_ticks",
                if config.steering_ticks < MAX_STEERING_TICKS {
                    0.0
                } else {
                    f64::NAN
                },
            ),
        ] {
            if !(value.is_finite() && value >= 0.0) {
                return Err(SafetyConfigError { name, value });
            }
        }
        Ok(Self {
            config,
            pace: 0.0,
            steering: [0.0; MAX_STEERING_TICKS],
        })
    }

    /// Forgets the commands of the last drive; the wheels are at `steering` (rad).
    pub const fn reset(&mut self, steering: f64) {
        self.pace = 0.0;
        self.steering = [steering; MAX_STEERING_TICKS];
    }

    /// One tick: what to do in place of `wanted`, the velocity of P that an outer loop asks for
    /// (m/s; any bits).
    pub fn step(&mut self, input: &SafetyInput<'_>, wanted: &Velocity) -> Filtered {
        self.observe(input);
        if !(wanted.x.is_finite() && wanted.y.is_finite()) {
            return Filtered::Stop;
        }
        let gentle = self.gentle(input, wanted);
        for share in SLOWER {
            let candidate = gentle * share;
            if self.keeps_a_stop(input, &candidate) {
                return if candidate == *wanted {
                    Filtered::Unchanged
                } else {
                    Filtered::Changed(candidate)
                };
            }
        }
        Filtered::Stop
    }

    fn observe(&mut self, input: &SafetyInput<'_>) {
        // What was commanded may still be on its way, however slow the car is now.
        self.pace = input.pace.max(self.pace - input.braking * input.period);
        self.steering.copy_within(..MAX_STEERING_TICKS - 1, 1);
        self.steering[0] = input.law.actuation().steering;
    }

    /// The velocity nearest to `wanted` with which P can stop before each side, and the car is
    /// not too fast for its bend.
    fn gentle(&self, input: &SafetyInput<'_>, wanted: &Velocity) -> Velocity {
        let estimate = input.estimate;
        let steering = input.law.actuation().steering;
        let law = input.law.law();
        let point = law.point(estimate.position, estimate.yaw, steering);
        let mut planes = Vec::<HalfPlane, MOST>::new();
        for side in self.config.area.sides() {
            let room = side.distance(&point) - self.config.position_error - input.blind;
            let plane = HalfPlane {
                along: side.outward,
                most: self.approach(input, room),
            };
            // There is room for every side and for the bends.
            let _ = planes.push(plane);
        }
        for plane in self.in_bends(input) {
            if plane.most.is_finite() {
                let _ = planes.push(plane);
            }
        }
        nearest(wanted, &planes, self.config.max_speed)
    }

    /// The speed towards a side from which P can stop within `room` (m): it goes on for the
    /// reaction time and slows down then.
    fn approach(&self, input: &SafetyInput<'_>, room: f64) -> f64 {
        if room.is_nan() || room <= 0.0 {
            return 0.0;
        }
        let reaction = self.config.reaction + input.period;
        input.braking * (sqrt(reaction * reaction + 2.0 * room / input.braking) - reaction)
    }

    /// The bounds by the lateral acceleration: on the speed in the bend that the car is on, and
    /// on the steering to either side at the speed that it has. Equation 7 makes both linear in
    /// the velocity of P. Standing is always allowed.
    fn in_bends(&self, input: &SafetyInput<'_>) -> [HalfPlane; 3] {
        let estimate = input.estimate;
        let (law, steering) = (input.law.law(), input.law.actuation().steering);
        let cosine = cos(estimate.sideslip - steering);
        let axle = estimate.yaw_rate * law.front_axle_distance();
        // v cos(β - δ) = v_P·(direction of the wheels) - r l_f sin δ.
        let sharpest = self
            .on_their_way()
            .chain(self.measured_curvature(input))
            .fold(0.0, |most: f64, curvature| most.max(fabs(curvature)));
        let fastest = sqrt(self.config.max_lateral_acceleration / sharpest);
        // u_δ p cos(β - δ) = v_P·(left of the course) - r l_f cos β - r p cos(β - δ).
        let course = direction(estimate.yaw + estimate.sideslip);
        let left = Velocity::new(-course.y, course.x);
        let turned = axle * cos(estimate.sideslip);
        let reach = law.point_distance() * cosine;
        let widest = self.widest_steering();
        let to_left = (widest - steering).max(0.0) / input.period;
        let to_right = (widest + steering).max(0.0) / input.period;
        [
            HalfPlane {
                along: direction(estimate.yaw + steering),
                most: (fastest * cosine + axle * sin(steering)).max(0.0),
            },
            HalfPlane {
                along: left,
                most: (reach * (to_left + estimate.yaw_rate) + turned).max(0.0),
            },
            HalfPlane {
                along: -left,
                most: (reach * (to_right - estimate.yaw_rate) - turned).max(0.0),
            },
        ]
    }

    /// The steering at which the lateral acceleration reaches its bound at the speed that the
    /// car may have, rad.
    fn widest_steering(&self) -> f64 {
        let curvature = self.config.max_lateral_acceleration / (self.pace * self.pace);
        atan(curvature * self.config.wheelbase)
    }

    /// The curvatures that were commanded and that the wheels may not have reached yet, 1/m.
    fn on_their_way(&self) -> impl Iterator<Item = f64> + '_ {
        self.steering[..=self.config.steering_ticks]
            .iter()
            .map(|steering| self.curvature(*steering))
    }

    fn curvature(&self, steering: f64) -> f64 {
        tan(steering) / self.config.wheelbase
    }

    fn measured_curvature(&self, input: &SafetyInput<'_>) -> Option<f64> {
        let estimate = input.estimate;
        (fabs(estimate.speed) > BENDS_FROM).then(|| estimate.yaw_rate / estimate.speed)
    }

    /// Whether every stop after a tick with this velocity stays inside.
    fn keeps_a_stop(&self, input: &SafetyInput<'_>, candidate: &Velocity) -> bool {
        let estimate = input.estimate;
        let mut law = input.law.clone();
        // Where the law is singular the pilot stops the car: the stop is judged all the same.
        let next = law
            .step(&estimate.motion(), estimate.speed, candidate, input.period)
            .unwrap_or(input.law.actuation());
        let pace = self.pace.max(fabs(next.speed));
        let commanded = self.curvature(next.steering);
        let now = input.law.actuation().steering;
        if fabs(next.steering) > fabs(now).max(self.widest_steering() + ROUNDING) {
            return false;
        }
        let reaction = self.config.reaction + input.period;
        let (of_curvature, of_course) = (self.config.curvature_error, self.config.course_error);
        let wheels = |curvatures: Range| Wheels {
            curvatures: curvatures.widened(of_curvature),
            sideslips: Range::only(self.sideslip(input, curvatures.least))
                .with(self.sideslip(input, curvatures.most))
                .with(estimate.sideslip)
                .widened(of_course),
        };
        let first = self
            .on_their_way()
            .chain(self.measured_curvature(input))
            .fold(Range::only(commanded), Range::with);
        // The way since the last pose may have been on any of these bends: the whole length is
        // laid ahead of the estimate.
        let forward = StopWay {
            from: estimate.position,
            heading: estimate.yaw,
            length: input.blind + pace * reaction + 0.5 * pace * pace / input.braking,
            first: wheels(first),
            settles_after: input.blind
                + pace * input.period * (self.config.steering_ticks + 1) as f64,
            then: wheels(Range::only(commanded)),
        };
        let inside =
            |way: &StopWay| way.stays_inside(&self.config.area, self.config.position_error);
        let reverses = estimate.speed < -BENDS_FROM || next.speed < 0.0;
        inside(&forward) && (!reverses || inside(&backward(&forward)))
    }

    /// The sideslip of a car that rolls without slip on this curvature of the rear axle's path.
    fn sideslip(&self, input: &SafetyInput<'_>, curvature: f64) -> f64 {
        let of_rear = self.config.wheelbase - input.law.law().front_axle_distance();
        atan(of_rear * curvature)
    }

    /// The centre of mass's distance from the nearest side, m; negative outside.
    #[must_use]
    pub fn clearance(&self, centre_of_mass: &Position) -> f64 {
        self.config.area.clearance(centre_of_mass)
    }
}

/// The same way of a car that goes backward.
fn backward(way: &StopWay) -> StopWay {
    let turned = |wheels: &Wheels| Wheels {
        curvatures: wheels.curvatures.mirrored(),
        ..*wheels
    };
    StopWay {
        heading: way.heading + core::f64::consts::PI,
        first: turned(&way.first),
        then: turned(&way.then),
        ..*way
    }
}
