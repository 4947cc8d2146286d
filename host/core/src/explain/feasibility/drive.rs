//! The car of the judgement: it follows the commands without slip, lag and noise. A circle is
//! judged from its geometry.

use singletrack_control::{
    Actuation, Ahead, Governor, LimitedLaw, Limits, Motion, OuterLoop as _, Position,
    ProportionalLoop, Reference, ReferencePoint, SlowedBy, Stop, TrackingInput, TrackingLoop,
    VehicleParameters, Velocity, along_bend, direction,
};
use singletrack_pilot::{FIRST_METRE, Fence, FirstMetre, PilotConfig};

use super::{Finding, RESERVE_M, Stand, begun, duration};
use crate::config::{Config, OuterLoopSection};

/// The reaction of the geofence's watch, and the age of a pose, in s.
const REACTION_S: f64 = 0.13;

/// A governed reference that takes this many times its time does not come to its end.
const LONGER: f64 = 10.0;

/// A governed reference with a lower rate stands.
const STANDS: f64 = 1e-3;

/// Why the governor may change a reference: not because the car starts beside it.
const REASONS: [SlowedBy; 5] = [
    SlowedBy::Tyres,
    SlowedBy::Steering,
    SlowedBy::SteeringRate,
    SlowedBy::Speed,
    SlowedBy::Geofence,
];

/// The gain of the loop that is judged in the place of a predictive one, per second.
const INSTEAD_PER_S: f64 = 2.0;

/// A standing car, and what drives it.
pub(super) struct Car {
    law: LimitedLaw,
    tracking: TrackingLoop,
    applied: Velocity,
    reference: Reference,
    /// None if the reference is followed as it is.
    governor: Option<Governor>,
    /// The path parameter of the reference, s.
    path: f64,
    vehicle: VehicleParameters,
    limits: Limits,
    stop: Stop,
    period: f64,
    time: f64,
    /// What the reference has counted of the time, s: it waits for a car that may not be as fast.
    clock: f64,
    position: Position,
    yaw: f64,
    /// What is left of the way on which the configuration is proved, m.
    unproved: f64,
}

/// How a drive ended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Ended {
    /// The car followed its reference for the whole time, inside the geofence.
    Inside,
    /// It could not stop inside the geofence any more.
    Left {
        /// When, s.
        time: f64,
        /// Where.
        position: Position,
    },
    /// The law had no answer.
    Singular {
        /// When, s.
        time: f64,
    },
}

impl Ended {
    /// For how long the car drove, s.
    pub(super) const fn time(&self) -> f64 {
        match self {
            Self::Inside => f64::INFINITY,
            Self::Left { time, .. } | Self::Singular { time } => *time,
        }
    }

    /// What went wrong, in words.
    pub(super) fn how(&self) -> String {
        match self {
            Self::Left { time, position } => format!(
                "the car would leave the fence near ({:.2}, {:.2}) m after {time:.1} s",
                position.x, position.y
            ),
            Self::Singular { time } => format!("the law has no answer after {time:.1} s"),
            Self::Inside => String::new(),
        }
    }
}

/// What the governor makes of a reference.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Governed {
    /// Why it changes the reference most often; none if it does not.
    pub(super) by: Option<SlowedBy>,
    /// How long the reference takes, as a multiple of the time asked for.
    pub(super) longer: f64,
    /// The largest distance of the governed reference from its path, m.
    pub(super) beside: f64,
    /// Whether it comes to its end, if it has one.
    pub(super) ends: bool,
    /// Whether it waits at the geofence, out of which the reference leads.
    pub(super) waits: bool,
}

/// What a period wanted and got.
struct Step {
    reference: ReferencePoint,
    speed: f64,
    steering: f64,
}

impl Car {
    pub(super) fn new(pilot: &PilotConfig, vehicle: &VehicleParameters, stand: Stand) -> Self {
        Self {
            law: LimitedLaw::new(pilot.law, pilot.limits),
            tracking: match &pilot.tracking {
                // A plan in every tick of every start that is tried would take minutes.
                TrackingLoop::Mpc(_) => TrackingLoop::Proportional(ProportionalLoop {
                    gain: Velocity::new(INSTEAD_PER_S, INSTEAD_PER_S),
                    feed_forward: true,
                }),
                other => other.clone(),
            },
            applied: Velocity::zeros(),
            reference: begun(pilot, stand),
            governor: pilot.governor(),
            path: 0.0,
            vehicle: *vehicle,
            limits: pilot.limits,
            stop: Stop {
                reaction: REACTION_S,
                braking: pilot.braking,
            },
            period: pilot.period,
            time: 0.0,
            clock: 0.0,
            position: Position::new(stand.x_m, stand.y_m),
            yaw: stand.yaw_rad,
            unproved: 0.0,
        }
    }

    /// Follows the reference over the first metre of a configuration that is not proved, for
    /// `longest` (s) at most, or until the car could not stop inside `fence`.
    pub(super) fn drive_first_metre(mut self, fence: &Fence, longest: f64) -> Ended {
        self.unproved = FIRST_METRE.way;
        self.drive_while(fence, |car| car.unproved > 0.0 && car.time < longest)
    }

    /// Follows the reference until this place of it (s), for `longest` (s) at most, or until the
    /// car could not stop inside `fence`.
    pub(super) fn drive(self, fence: &Fence, until: f64, longest: f64) -> Ended {
        self.drive_while(fence, |car| car.place() < until && car.time < longest)
    }

    fn drive_while(mut self, fence: &Fence, goes_on: impl Fn(&Self) -> bool) -> Ended {
        while goes_on(&self) {
            if !self.stops_inside(fence) {
                return Ended::Left {
                    time: self.time,
                    position: self.position,
                };
            }
            if self.step().is_none() {
                return Ended::Singular { time: self.time };
            }
        }
        Ended::Inside
    }

    /// Follows the reference without a geofence, and measures what the governor makes of it.
    pub(super) fn governed(mut self) -> Governed {
        let until = duration(&self.reference);
        let mut counts = [0_u32; REASONS.len()];
        let mut beside = 0.0_f64;
        while self.place() < until && self.time < LONGER * until {
            let Some(step) = self.step() else {
                break;
            };
            let place = self.reference.at(self.path).position;
            if let (Some(governed), Some(place)) = (step.reference.position, place) {
                beside = beside.max((governed - place).norm());
            }
            let slowed_by = self.governor.as_ref().and_then(Governor::slowed_by);
            for (count, reason) in counts.iter_mut().zip(REASONS) {
                *count += u32::from(slowed_by == Some(reason));
            }
        }
        let most = counts.iter().zip(REASONS).max_by_key(|(count, _)| **count);
        let waits = self.governor.as_ref().is_some_and(|governor| {
            governor.slowed_by() == Some(SlowedBy::Geofence) && governor.rate() < STANDS
        });
        Governed {
            by: most
                .filter(|(count, _)| **count > 0)
                .map(|(_, reason)| reason),
            longer: self.time / self.place(),
            beside,
            ends: self.place() >= until || self.reference.duration().is_none(),
            waits,
        }
    }

    /// Follows the reference without a geofence; gives the shares of the drive, 0 to 1, in which
    /// steering, speed and lateral acceleration are at their limits.
    pub(super) fn saturated(mut self) -> [f64; 3] {
        let limits = self.limits;
        let until = duration(&self.reference);
        let (mut steps, mut counts) = (0_u32, [0_u32; 3]);
        while self.time < until
            && let Some(step) = self.step()
        {
            steps += 1;
            let in_bend = limits.speed_in_bend(step.steering);
            let at_limit = [
                step.steering.abs() >= 0.999 * limits.max_steering,
                step.reference.velocity.norm() > 1.001 * limits.max_speed,
                step.speed.abs() >= 0.999 * in_bend,
            ];
            for (count, is_reached) in counts.iter_mut().zip(at_limit) {
                *count += u32::from(is_reached);
            }
        }
        counts.map(|count| f64::from(count) / f64::from(steps.max(1)))
    }

    /// How far the reference has come, s.
    const fn place(&self) -> f64 {
        match self.governor {
            Some(_) => self.path,
            None => self.clock,
        }
    }

    /// One period of the controller; `None` where the law is singular.
    fn step(&mut self) -> Option<Step> {
        let before = self.law.actuation();
        let (sideslip, curvature) = self.rolls(before.steering);
        let motion = Motion {
            yaw: self.yaw,
            yaw_rate: before.speed * curvature,
            sideslip,
        };
        let law = self.law.law();
        let point = law.point(self.position, self.yaw, before.steering);
        self.path = match &mut self.governor {
            Some(governor) => governor.advance(self.clock, &self.reference, &point),
            None => self.clock,
        };
        let at = |ahead: f64| match &self.governor {
            Some(governor) => governor.at(&self.reference, ahead),
            None => self.reference.at(self.clock + ahead),
        };
        let reference = at(0.0);
        let wanted = self.tracking.step(&TrackingInput {
            point,
            reference: &at,
            applied: self.applied,
            period: self.period,
        });
        let ahead = Ahead {
            // A governed reference waits, and the car for it.
            overtaken: match self.governor {
                Some(_) => reference.overtaken_by(&point),
                None => None,
            },
            lead: None,
        };
        self.law
            .step_ahead(&motion, before.speed, &wanted, &ahead, self.period)
            .ok()?;
        let first_metre = self.first_metre();
        if let Some(first) = first_metre {
            self.law.cap_speed(first.speed);
        }
        let actuation = self.law.actuation();
        self.applied = self.law.point_velocity();
        let (sideslip, curvature) = self.rolls(self.steered(&actuation));
        let way = actuation.speed * self.period;
        let turned = way * curvature;
        self.position += way * direction(self.yaw + sideslip + 0.5 * turned);
        self.yaw += turned;
        self.time += self.period;
        self.unproved -= actuation.speed.abs() * self.period;
        let waits = first_metre.filter(|_| reference.position.is_some());
        self.clock += self.period
            * waits.map_or(1.0, |first| {
                (first.speed / reference.velocity.norm()).min(1.0)
            });
        Some(Step {
            reference,
            speed: actuation.speed,
            steering: actuation.steering,
        })
    }

    /// What holds while the configuration is proved.
    fn first_metre(&self) -> Option<FirstMetre> {
        (self.unproved > 0.0).then_some(FIRST_METRE)
    }

    /// The steering angle (rad) with the wave that proves the steering.
    fn steered(&self, actuation: &Actuation) -> f64 {
        let most = self.limits.max_steering;
        self.first_metre().map_or(actuation.steering, |first| {
            let wave = FirstMetre::wave(first.way - self.unproved);
            (actuation.steering + wave).clamp(-most, most)
        })
    }

    /// Sideslip (rad) and curvature of the path of G (1/m) of a car that rolls without slip.
    fn rolls(&self, steering: f64) -> (f64, f64) {
        let wheelbase = self.vehicle.wheelbase_m();
        let tangent = libm::tan(steering);
        let sideslip = libm::atan(self.vehicle.rear_axle_distance_m / wheelbase * tangent);
        (sideslip, libm::cos(sideslip) * tangent / wheelbase)
    }

    /// Whether the car is inside and stays inside if it stops now, with its wheels held.
    fn stops_inside(&self, fence: &Fence) -> bool {
        let actuation = self.law.actuation();
        let (sideslip, curvature) = self.rolls(self.steered(&actuation));
        let stop = self.first_metre().map_or(self.stop, |first| Stop {
            braking: self.stop.braking.min(first.braking),
            ..self.stop
        });
        // What is not proved is not compensated either: the wheels are late.
        let late = self.first_metre().map_or(0.0, |_| RESERVE_M);
        let ahead = (stop.way(actuation.speed) + late).copysign(actuation.speed);
        let course = direction(self.yaw + sideslip);
        fence.contains_path(&self.position, &along_bend(&course, curvature, ahead))
    }
}

/// Below this share of its limit a steady steering angle leaves room for corrections.
const STEERING_RESERVE: f64 = 0.97;

/// The circle that P and car settle on, without slip.
#[derive(Clone, Copy)]
pub(super) struct SteadyCircle<'a> {
    config: &'a Config,
    /// Radius of P: smaller than that of the reference without feed-forward, m.
    point: f64,
    /// Radius of P over that of the reference.
    factor: f64,
    /// Angular velocity, rad/s.
    rate: f64,
    /// The smallest circle of P at the largest steering angle, m.
    least: f64,
}

impl<'a> SteadyCircle<'a> {
    /// For a reference of this radius (m) and angular velocity (rad/s).
    pub(super) fn of(config: &'a Config, limits: &Limits, radius: f64, rate: f64) -> Self {
        // P is an integrator per axis in a proportional loop: a first-order low pass.
        let factor = match config.outer_loop {
            OuterLoopSection::Proportional {
                gain_per_s: [x, y],
                feed_forward: false,
            } => x.min(y) / libm::hypot(x.min(y), rate),
            _ => 1.0,
        };
        let wheelbase = config.vehicle.wheelbase_m();
        let rear = wheelbase / libm::tan(limits.max_steering);
        let distance = config.law.point_distance_m;
        Self {
            config,
            point: factor * radius,
            factor,
            rate,
            least: (rear * rear + wheelbase * wheelbase + distance * distance).sqrt(),
        }
    }

    /// Radius of the rear axle's circle, m; `None` if P's circle is too small for any angle.
    fn rear_axle(&self) -> Option<f64> {
        let wheelbase = self.config.vehicle.wheelbase_m();
        let distance = self.config.law.point_distance_m;
        let squared = self.point * self.point - distance * distance - wheelbase * wheelbase;
        (squared > 0.0).then(|| squared.sqrt())
    }

    /// Radius of the circle of the centre of mass, m; `None` if P's circle is too small for any angle.
    pub(super) fn centre_of_mass(&self) -> Option<f64> {
        let rear = self.rear_axle()?;
        Some(libm::hypot(rear, self.config.vehicle.rear_axle_distance_m))
    }

    /// The largest radius of the reference, m, rounded down, with which the centre of mass keeps
    /// within `room` (m); `None` if the car can't drive it.
    pub(super) fn largest(&self, room: f64) -> Option<f64> {
        let config = self.config;
        let rear = config.vehicle.rear_axle_distance_m;
        let ahead = libm::hypot(config.law.point_distance_m, config.vehicle.wheelbase_m());
        let point = (room * room - rear * rear + ahead * ahead).max(0.0).sqrt();
        (room > 0.0 && point > self.least).then(|| round_down(point / self.factor))
    }

    /// Judges the steering that it takes, for a reference that was asked for with the radius
    /// `asked` (m). Returns the radius of the rear axle's circle, m, if P can drive it.
    pub(super) fn judge_radius(&self, asked: f64, findings: &mut Vec<Finding>) -> Option<f64> {
        let limits = &self.config.limits;
        let lags = if self.factor < 1.0 {
            format!(
                ", and without outer_loop.feed_forward P settles on {:.2} m at \
                 reference.angular_velocity_rad_s = {}",
                self.point, self.rate
            )
        } else {
            String::new()
        };
        let smallest = round_up(self.least / self.factor);
        let rear = self.rear_axle().filter(|_| self.point >= self.least);
        let Some(rear) = rear else {
            let fix = format!(
                "with limits.max_steering_rad = {} P can't drive a circle below {:.2} m{lags}; \
                 give at least {smallest:.2}, or lower law.point_distance_m",
                limits.max_steering_rad, self.least
            );
            findings.push(Finding::impossible("reference.radius_m", asked, fix));
            return None;
        };
        let steering = libm::atan(self.config.vehicle.wheelbase_m() / rear);
        if steering > STEERING_RESERVE * limits.max_steering_rad {
            let fix = format!(
                "the circle takes a steering angle of {steering:.3} rad of \
                 limits.max_steering_rad = {}, which leaves nothing for corrections{lags}; \
                 give {:.2} or more",
                limits.max_steering_rad,
                round_up(1.05 * self.least / self.factor),
            );
            findings.push(Finding::warning("reference.radius_m", asked, fix));
        }
        Some(rear)
    }

    /// Judges the speed and the lateral acceleration that it takes.
    pub(super) fn judge_pace(&self, rear: f64, findings: &mut Vec<Finding>) {
        const RATE: &str = "reference.angular_velocity_rad_s";
        let (limits, vehicle) = (&self.config.limits, &self.config.vehicle);
        let speed = self.point * self.rate;
        if speed > limits.max_speed_m_s {
            let fix = format!(
                "P would drive {speed:.2} m/s; limits.max_speed_m_s is {}: lower the angular \
                 velocity to {:.2} or less, or the radius",
                limits.max_speed_m_s,
                round_down(limits.max_speed_m_s / self.point),
            );
            findings.push(Finding::impossible(RATE, self.rate, fix));
        }
        // The speed of the centre of mass, and the lateral acceleration as the limit is
        // defined: v² tan δ/L.
        let centre = libm::hypot(rear, vehicle.rear_axle_distance_m);
        let lateral = (self.rate * centre).powi(2) / rear;
        if lateral > limits.max_lateral_acceleration_m_s2 {
            let most = (limits.max_lateral_acceleration_m_s2 * rear).sqrt() / centre;
            let fix = format!(
                "the circle takes {lateral:.2} m/s2 of lateral acceleration; \
                 limits.max_lateral_acceleration_m_s2 is {}: lower the angular velocity to \
                 {:.2} or less",
                limits.max_lateral_acceleration_m_s2,
                round_down(most),
            );
            findings.push(Finding::impossible(RATE, self.rate, fix));
        }
    }
}

/// To two decimals, so that the advice is not below or above what is possible.
fn round_up(value: f64) -> f64 {
    (100.0 * value).ceil() / 100.0
}

fn round_down(value: f64) -> f64 {
    (100.0 * value).floor() / 100.0
}
