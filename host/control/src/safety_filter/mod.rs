//! A filter behind any outer loop: whatever velocity of P is wanted, the car stays able to stop
//! inside its area.
//!
//! Two stages. The first is a quadratic program: of the velocities that keep P able to stop
//! before each side, the one nearest to what is wanted; and if that one does not pass, of those
//! that keep the lateral acceleration in bounds too. It makes the filter gentle, and the claim
//! does not rest on it. The second tries the
//! law with that velocity, and with slower ones, and takes the first after which every stop
//! that the car may make stays inside. If there is none, the car stops, which the tick before
//! has proved to stay inside. `docs/safety-filter.md` states the claim with its assumptions.

mod projection;

use core::f64::consts::TAU;

use heapless::Vec;
use libm::{atan, cos, fabs, sin, sqrt, tan};

use self::projection::{HalfPlane, MOST, nearest};
use crate::{
    Actuation, ConvexArea, Estimate, GRAVITY, LimitedLaw, Position, Side, Singularity, Stop,
    Velocity, direction,
    stop::{ROUNDED, Range, StopWay, Wheels},
};

/// The number of ticks whose steering commands may still be on their way to the wheels.
pub const MAX_STEERING_TICKS: usize = 64;
/// Below this speed (m/s) the measured curvature is noise.
const BENDS_FROM: f64 = 0.2;
/// What a steering angle may exceed its bound by through rounding, rad.
const ROUNDING: f64 = 1e-9;
/// The lateral acceleration (m/s²) beyond which the curvature's error grows: a quarter of gravity.
pub const GENTLE_BEND: f64 = 0.25 * GRAVITY;
/// How much slower the velocities are that are tried one after the other.
const SLOWER: [f64; 5] = [1.0, 0.75, 0.5, 0.25, 0.0];
/// How much earlier steering and speed from outside are scaled than a stop must begin, s: they
/// have no stage that makes the filter gentle.
const EARLY: f64 = 0.1;

/// The number of directions towards which the room is known, the first one ahead, in equal steps
/// to the left.
pub const ROOM_DIRECTIONS: usize = 12;

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
    /// The largest deviation of the path's curvature from tan(δ)/L, 1/m, up to [`GENTLE_BEND`]: slip,
    /// play and trim.
    pub curvature_error: f64,
    /// What each m/s² of lateral acceleration beyond [`GENTLE_BEND`] adds, s²/m²: tyres slip more than
    /// in proportion.
    pub curvature_error_growth: f64,
    /// The most by which a moving car may become faster than it was measured and commanded, m/s.
    pub speed_error: f64,
    /// The largest speed of P, m/s.
    pub max_speed: f64,
    /// The largest lateral acceleration, m/s².
    pub max_lateral_acceleration: f64,
    /// The part of the steering angle that the tyres' slip takes at that limit, rad.
    pub slip: f64,
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
    /// The angle of the front wheels, as far as the law knows, rad.
    pub wheels: f64,
    /// The most by which the angle that is sent may differ from that of the law, rad. A stop
    /// sends that of the law.
    pub wave: f64,
    /// The way since the last pose, m.
    pub blind: f64,
    /// The deceleration that every stop reaches, m/s².
    pub braking: f64,
    /// The control period, s.
    pub period: f64,
    /// What keeps the car apart from other bodies in this tick: sides of its area too.
    pub neighbours: &'a [Side],
}

/// States of a car that goes forward, by the worst of each, whose stops a certificate of the filter bounds.
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

/// What the filter made of a velocity, in m/s, or of steering and speed from outside, of which it leaves
/// a part from 0 to 1: of the speed, and of the change of the steering.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Filtered<T = Velocity> {
    /// Nothing: give it to the law as it is.
    Unchanged,
    /// The velocity of P nearest to the wanted one within the bounds is to be given to the law.
    Limited(T),
    /// A part of that one, or of the demand, because it would not leave the car able to stop inside.
    Scaled(T),
    /// None keeps the car able to stop inside: slow down now, with the steering held.
    Stop,
}

/// The filter.
#[derive(Clone, Debug, PartialEq)]
pub struct SafetyFilter {
    config: SafetyConfig,
    /// The speed that commands on their way may still lead to, m/s.
    pace: f64,
    /// The steering sent in the last ticks, rad; the last one first.
    steering: [f64; MAX_STEERING_TICKS],
    /// Between these angles the wheels stand, rad.
    on_their_way: Range,
}

/// A car that may have to stop.
struct Start {
    position: Position,
    yaw: f64,
    /// The estimated sideslip, rad.
    sideslips: Range,
    /// The speed that it has at most, with its error, m/s.
    pace: f64,
    /// The way since the last pose, m.
    blind: f64,
    stop: Stop,
    /// The control period, s.
    period: f64,
    /// The distance from the centre of mass to the rear axle, m.
    of_rear: f64,
}

impl SafetyConfig {
    /// The largest deviation of the path's curvature, 1/m, at a speed (m/s) or slower, with the wheels
    /// between the angles of these curvatures. Tyres that hold bend no path more than they can.
    fn curvature_error_at(&self, speed: f64, curvatures: &Range) -> f64 {
        let sharpest = fabs(curvatures.least).max(fabs(curvatures.most));
        let lateral = (speed * speed * sharpest).min(self.max_lateral_acceleration);
        let growth = self.curvature_error_growth * (1.0 + ROUNDED);
        self.curvature_error + growth * (lateral - GENTLE_BEND).max(0.0)
    }
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
            ("curvature_error_growth", config.curvature_error_growth),
            ("speed_error", config.speed_error),
            ("max_speed", config.max_speed),
            ("max_lateral_acceleration", config.max_lateral_acceleration),
            ("slip", config.slip),
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
            on_their_way: Range::only(0.0),
        })
    }

    /// Forgets the speeds of the last drive; the wheels stand between straight ahead and
    /// `steering` (rad), to where they were sent last.
    pub const fn reset(&mut self, steering: f64) {
        self.pace = 0.0;
        self.steering = [steering; MAX_STEERING_TICKS];
        // A board that has restarted has set them straight.
        self.steering[0] = 0.0;
        self.on_their_way = Range::only(steering).with(0.0);
    }

    /// Notes what is known at a tick, before the step: the largest of the estimated, the
    /// measured and the commanded speed (`pace`, m/s), the steering that was sent last (rad), and
    /// the deceleration that every stop reaches (m/s²), over a period (s). To be called at every
    /// tick of a drive, whatever drives it.
    pub fn observe(&mut self, pace: f64, sent: f64, braking: f64, period: f64) {
        // A pace that is not finite must not count as standstill. What was commanded may still
        // be on its way, however slow the car is now.
        let pace = if pace.is_finite() { pace } else { f64::MAX };
        self.pace = pace.max(self.pace - braking * period);
        self.steering.copy_within(..MAX_STEERING_TICKS - 1, 1);
        self.steering[0] = sent;
        self.on_their_way = self.steering[..=self.config.steering_ticks]
            .iter()
            .fold(Range::only(sent), |range, steering| range.with(*steering));
    }

    /// One tick: what to do in place of `wanted`, the velocity of P that an outer loop asks for
    /// (m/s; any bits). `advance` is the step of the law that would follow.
    pub fn step(
        &self,
        input: &SafetyInput<'_>,
        wanted: &Velocity,
        advance: impl Fn(&mut LimitedLaw, &Velocity) -> Result<Actuation, Singularity>,
    ) -> Filtered {
        if !(wanted.x.is_finite() && wanted.y.is_finite()) {
            return Filtered::Stop;
        }
        let passes = |candidate: &Velocity| {
            let mut law = input.law.clone();
            // Where the law is singular the pilot stops the car: the stop is judged all the same.
            let next = advance(&mut law, candidate).unwrap_or(input.law.actuation());
            self.keeps_a_stop(input, &next, 0.0)
        };
        // The law limits the speed of P too.
        let speed = wanted.norm();
        let limited = if speed > self.config.max_speed {
            wanted * (self.config.max_speed / speed)
        } else {
            *wanted
        };
        let mut planes = self.towards_sides(input);
        let near = nearest(&limited, &planes, self.config.max_speed);
        if near == limited {
            if passes(wanted) {
                return Filtered::Unchanged;
            }
        } else if passes(&near) {
            return Filtered::Limited(near);
        }
        for plane in self.in_bends(input) {
            if plane.most.is_finite() {
                // There is room for the sides and for these.
                let _ = planes.push(plane);
            }
        }
        let near = nearest(&limited, &planes, self.config.max_speed);
        for share in SLOWER {
            if passes(&(near * share)) {
                return if share == 1.0 {
                    Filtered::Limited(near)
                } else {
                    Filtered::Scaled(near * share)
                };
            }
        }
        Filtered::Stop
    }

    /// One tick of a controller outside that demands steering and speed. `advance` is the step
    /// that would follow, with this part of the speed and of the change of the steering.
    pub fn demand(
        &self,
        input: &SafetyInput<'_>,
        advance: impl Fn(&mut LimitedLaw, f64) -> Result<Actuation, Singularity>,
    ) -> Filtered<f64> {
        for share in SLOWER {
            let mut law = input.law.clone();
            let early = if share > 0.0 { EARLY } else { 0.0 };
            let Ok(next) = advance(&mut law, share) else {
                return Filtered::Stop;
            };
            if self.keeps_a_stop(input, &next, early) {
                return if share == 1.0 {
                    Filtered::Unchanged
                } else {
                    Filtered::Scaled(share)
                };
            }
        }
        Filtered::Stop
    }

    /// The bounds that leave P able to stop before each side.
    fn towards_sides(&self, input: &SafetyInput<'_>) -> Vec<HalfPlane, MOST> {
        let estimate = input.estimate;
        let point = input
            .law
            .law()
            .point(estimate.position, estimate.yaw, input.wheels);
        let stop = self.stop(input, 0.0);
        let bound = |side: &Side| {
            let room = side.distance(&point) - self.config.position_error - input.blind;
            HalfPlane {
                along: side.outward,
                most: stop.fastest(room),
            }
        };
        let mut planes: Vec<_, MOST> = self.config.area.sides().iter().map(bound).collect();
        // A bound that no velocity reaches costs time alone.
        let near = |plane: &HalfPlane| plane.most < self.config.max_speed;
        planes.extend(input.neighbours.iter().map(bound).filter(near));
        planes
    }

    /// A stop that is decided `early` (s) after the next tick.
    fn stop(&self, input: &SafetyInput<'_>, early: f64) -> Stop {
        Stop {
            reaction: self.config.reaction + input.period + early,
            braking: input.braking,
        }
    }

    /// The bounds by the lateral acceleration: on the speed in the bend that the car is on, and
    /// on the steering to either side at the speed that it has. Equation 7 makes both linear in
    /// the velocity of P. Standing is always allowed.
    fn in_bends(&self, input: &SafetyInput<'_>) -> [HalfPlane; 3] {
        let estimate = input.estimate;
        let (law, steering) = (input.law.law(), input.wheels);
        let cosine = cos(estimate.sideslip - steering);
        let axle = estimate.yaw_rate * law.front_axle_distance();
        // v cos(β - δ) = v_P·(direction of the wheels) - r l_f sin δ.
        let sharpest = measured_curvature(estimate)
            .map_or(0.0, fabs)
            .max(self.curvature(self.sharpest_rolling(input)));
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
        atan(curvature * self.config.wheelbase) + self.config.slip
    }

    /// The sharpest angle at which the wheels may stand, without the tyres' slip, rad.
    fn sharpest_rolling(&self, input: &SafetyInput<'_>) -> f64 {
        let Range { least, most } = self.on_their_way.widened(input.wave);
        (fabs(least).max(fabs(most)) - self.config.slip).max(0.0)
    }

    /// The curvatures between which the path bends now, 1/m: those of the angles between which
    /// the wheels stand, and the measured one.
    fn present_curvatures(&self, input: &SafetyInput<'_>) -> Range {
        let range = self.curvatures(self.on_their_way.widened(input.wave));
        measured_curvature(input.estimate).map_or(range, |measured| range.with(measured))
    }

    /// Whether the path bends as the claim assumes: by the angles between which the wheels stand,
    /// but for [`SafetyConfig::curvature_error`]. `wave` as in [`SafetyInput`]. A car that is too
    /// slow to tell does.
    pub fn bends_as_assumed(&self, estimate: &Estimate, wave: f64) -> bool {
        let range = self.curvatures(self.on_their_way.widened(wave));
        let error = self.config.curvature_error_at(estimate.speed, &range);
        let Range { least, most } = range.widened(error);
        // A NaN does not.
        measured_curvature(estimate).is_none_or(|measured| measured >= least && measured <= most)
    }

    fn curvature(&self, steering: f64) -> f64 {
        tan(steering) / self.config.wheelbase
    }

    fn curvatures(&self, steering: Range) -> Range {
        steering.map(|angle| self.curvature(angle))
    }

    /// Whether every stop after a tick with this command stays inside, and would if it began
    /// `early` (s) later.
    fn keeps_a_stop(&self, input: &SafetyInput<'_>, next: &Actuation, early: f64) -> bool {
        let estimate = input.estimate;
        let pace = match self.pace.max(fabs(next.speed)) {
            0.0 => 0.0,
            moving => moving + self.config.speed_error,
        };
        let now = input.law.actuation().steering;
        if fabs(next.steering) > fabs(now).max(self.widest_steering() + ROUNDING) {
            return false;
        }
        let first = self
            .present_curvatures(input)
            .with(self.curvature(next.steering - input.wave))
            .with(self.curvature(next.steering + input.wave));
        let start = Start {
            position: estimate.position,
            yaw: estimate.yaw,
            sideslips: Range::only(estimate.sideslip),
            pace,
            blind: input.blind,
            stop: self.stop(input, early),
            period: input.period,
            of_rear: self.config.wheelbase - input.law.law().front_axle_distance(),
        };
        let forward = self.ways(&start, &first, &Range::only(self.curvature(next.steering)));
        let sides = self.config.area.sides().iter().chain(input.neighbours);
        let inside = |way: &StopWay| way.stays_inside(sides.clone(), self.config.position_error);

        let reverses = estimate.speed < -BENDS_FROM || next.speed < 0.0;
        inside(&forward) && (!reverses || inside(&backward(&forward)))
    }

    /// Every way of a stop, with the wheels between the angles of the `first` curvatures (1/m) until
    /// they have settled between those of `then`.
    fn ways(&self, start: &Start, first: &Range, then: &Range) -> StopWay {
        let of_course = self.config.course_error;
        // More than the rounding of a tangent or its inverse.
        let rounded = |range: &Range| ROUNDED * fabs(range.least).max(fabs(range.most));
        let wheels = |curvatures: &Range| Wheels {
            curvatures: curvatures.widened(
                self.config.curvature_error_at(start.pace, curvatures) + rounded(curvatures),
            ),
            sideslips: start
                .sideslips
                .with(atan(start.of_rear * curvatures.least))
                .with(atan(start.of_rear * curvatures.most))
                .widened(of_course + ROUNDED),
        };
        // The way since the last pose may have been on any of these bends: the whole length is
        // laid ahead of the estimate.
        StopWay {
            from: start.position,
            heading: start.yaw,
            length: (start.blind + start.stop.way(start.pace)) * (1.0 + ROUNDED),
            first: wheels(first),
            settles_after: (start.blind
                + start.pace * start.period * (self.config.steering_ticks + 1) as f64)
                * (1.0 + ROUNDED),
            then: wheels(then),
        }
    }

    /// How far from a side of its area the filter wants the estimated position for a stop, m, for a
    /// side in each direction from the heading. The measured curvature and the estimated sideslip
    /// are those of angles between which the wheels may stand.
    pub fn room(&self, states: &StopBox) -> [f64; ROOM_DIRECTIONS] {
        let curvatures = |[least, most]: [f64; 2]| self.curvatures(Range { least, most });
        let first = curvatures(states.before);
        let sideslip = |curvature| atan(states.rear_axle_distance * curvature);
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

    /// The centre of mass's distance from the nearest side, m; negative outside.
    pub fn clearance(&self, centre_of_mass: &Position) -> f64 {
        self.config.area.clearance(centre_of_mass)
    }
}

fn measured_curvature(estimate: &Estimate) -> Option<f64> {
    (fabs(estimate.speed) > BENDS_FROM).then(|| estimate.yaw_rate / estimate.speed)
}

/// The way to standstill of a car that goes backward, mirrored to one that goes forward.
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
