//! The front-point law on the ideal car: P follows the paper's circle.
//!
//! The car is equations 1 and 2 as printed. The law and the outer loop are evaluated
//! continuously, at every stage of the integration, so P is exactly the two integrators of
//! equation 6. The outer loop is proportional and has no feed-forward: P settles on a
//! smaller circle and lags behind the reference, as the theory states.
//!
//! ```text
//! cargo run --example ideal_car
//! ```

#![allow(
    clippy::disallowed_methods,
    reason = "an example prints figures of three digits"
)]

use std::error::Error;
use std::io::{self, Write};

use singletrack_control::{
    Circle, FrontPointLaw, Motion, Position, ProportionalLoop, Reference, SingleTrack,
    SingleTrackDerivative, SingleTrackState, VehicleParameters, Velocity, angle_between,
};

/// Angular velocity ω of the reference, in rad/s.
const ANGULAR_VELOCITY: f64 = 0.5;
/// Gain K of the outer loop on both axes, per second.
const GAIN: f64 = 1.0;
/// Distance p of the point P from the front axle, in m.
const POINT_DISTANCE: f64 = 0.35;
/// The initial distance of P behind the first point of the reference, in m. The ideal car
/// has no equation at standstill, so it must begin with a speed.
const START_BEHIND: f64 = 0.5;
/// Step of the integration, in s.
const STEP: f64 = 1e-3;
/// Duration of the drive in steps: 40 s, after which the transient has decayed to e^-40.
const STEPS: u32 = 40_000;
/// Steps from one line of the table to the next: 4 s.
const STEPS_PER_LINE: u32 = 4_000;

/// The circle on which P moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SettledCircle {
    /// Distance of P from the centre, in m.
    pub(crate) amplitude: f64,
    /// Angle by which P is behind the reference, in rad.
    pub(crate) lag: f64,
}

/// The car, with the integrator of its steering.
#[derive(Clone, Copy)]
struct Car {
    body: SingleTrackState,
    /// Steering angle δ, in rad.
    steering: f64,
}

/// The time derivative of a [`Car`].
#[derive(Clone, Copy)]
struct CarRate {
    body: SingleTrackDerivative,
    steering: f64,
}

impl Car {
    const fn centre_of_mass(&self) -> Position {
        Position::new(self.body.x, self.body.y)
    }

    /// The car after `step` seconds at a constant rate.
    fn after(&self, step: f64, rate: &CarRate) -> Self {
        Self {
            body: SingleTrackState {
                x: self.body.x + step * rate.body.x,
                y: self.body.y + step * rate.body.y,
                yaw: self.body.yaw + step * rate.body.yaw,
                yaw_rate: self.body.yaw_rate + step * rate.body.yaw_rate,
                sideslip: self.body.sideslip + step * rate.body.sideslip,
            },
            steering: self.steering + step * rate.steering,
        }
    }
}

/// Model, law, outer loop and reference.
struct ClosedLoop {
    model: SingleTrack,
    law: FrontPointLaw,
    tracking: ProportionalLoop,
    reference: Reference,
}

impl ClosedLoop {
    fn point(&self, car: &Car) -> Position {
        self.law
            .point(car.centre_of_mass(), car.body.yaw, car.steering)
    }

    /// The derivative of the closed loop at `time` (s).
    fn rate(&self, time: f64, car: &Car) -> Result<CarRate, Box<dyn Error>> {
        let motion = Motion {
            yaw: car.body.yaw,
            yaw_rate: car.body.yaw_rate,
            sideslip: car.body.sideslip,
        };
        let wanted = self
            .tracking
            .velocity(&self.reference.at(time), &self.point(car));
        let command = self.law.command(&motion, car.steering, &wanted)?;
        Ok(CarRate {
            body: self
                .model
                .derivative(&car.body, command.speed, car.steering),
            steering: command.steering_rate,
        })
    }

    /// One step of the classical Runge-Kutta method.
    fn step(&self, time: f64, car: &Car) -> Result<Car, Box<dyn Error>> {
        let half = 0.5 * STEP;
        let first = self.rate(time, car)?;
        let second = self.rate(time + half, &car.after(half, &first))?;
        let third = self.rate(time + half, &car.after(half, &second))?;
        let fourth = self.rate(time + STEP, &car.after(STEP, &third))?;
        Ok(car
            .after(STEP / 6.0, &first)
            .after(STEP / 3.0, &second)
            .after(STEP / 3.0, &third)
            .after(STEP / 6.0, &fourth))
    }
}

/// Drives the car, prints the table to `out`, and returns where P settled.
pub(crate) fn run(out: &mut impl Write) -> Result<SettledCircle, Box<dyn Error>> {
    let vehicle = VehicleParameters::paper();
    let l_f = vehicle.front_axle_distance_m;
    let circle = Circle::new(Position::origin(), 1.0, ANGULAR_VELOCITY)?;
    let closed_loop = ClosedLoop {
        model: SingleTrack::new(vehicle),
        law: FrontPointLaw::new(l_f, POINT_DISTANCE, vehicle.wheelbase_m())?,
        tracking: ProportionalLoop {
            gain: Velocity::new(GAIN, GAIN),
            feed_forward: false,
        },
        reference: Reference::Circle(circle),
    };
    // The reference begins at (radius, 0) towards +y. The car stands behind it, in line.
    let mut car = Car {
        body: SingleTrackState {
            x: circle.radius(),
            y: -START_BEHIND - POINT_DISTANCE - l_f,
            yaw: std::f64::consts::FRAC_PI_2,
            ..SingleTrackState::default()
        },
        steering: 0.0,
    };
    writeln!(
        out,
        "    t      P x      P y    ref x    ref y    error\n    s        m        m        m        m        m"
    )?;
    let mut settled = SettledCircle {
        amplitude: 0.0,
        lag: 0.0,
    };
    for step in 0..=STEPS {
        let time = f64::from(step) * STEP;
        if step % STEPS_PER_LINE == 0 {
            let point = closed_loop.point(&car);
            let reference = closed_loop
                .reference
                .at(time)
                .position
                .ok_or("a circle has positions")?;
            writeln!(
                out,
                "{time:5.1} {:8.4} {:8.4} {:8.4} {:8.4} {:8.4}",
                point.x,
                point.y,
                reference.x,
                reference.y,
                (reference - point).norm(),
            )?;
            settled = SettledCircle {
                amplitude: (point - circle.centre()).norm(),
                lag: angle_between(&(point - circle.centre()), &(reference - circle.centre())),
            };
        }
        car = closed_loop.step(time, &car)?;
    }
    let theory = theory(circle.radius());
    writeln!(out, "\n          amplitude m   lag rad")?;
    for (name, SettledCircle { amplitude, lag }) in [("settled", settled), ("theory", theory)] {
        writeln!(out, "{name:8}  {amplitude:11.6}  {lag:8.6}")?;
    }
    Ok(settled)
}

/// Two integrators under proportional feedback: amplitude R/√(1 + (ω/K)²) and lag
/// atan(ω/K).
pub(crate) fn theory(radius: f64) -> SettledCircle {
    let ratio = ANGULAR_VELOCITY / GAIN;
    SettledCircle {
        amplitude: radius / (1.0 + ratio * ratio).sqrt(),
        lag: ratio.atan(),
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    run(&mut io::stdout().lock())?;
    Ok(())
}
