//! The outer loops on a car with lags, dead times and tyres, on circles and figures of eight.
//!
//! Prints the root mean square of the distance from P, with the true steering angle, to its
//! reference over the second half of 40 s. The loops are given the true state.
//!
//! ```text
//! cargo run --release -p singletrack-control --example outer_loops
//! ```

#![allow(
    clippy::disallowed_methods,
    reason = "an example prints figures of three digits"
)]

use std::collections::VecDeque;

use singletrack_control::{
    Circle, FigureOfEight, FrontPointLaw, LimitedLaw, Limits, LqiAxis, LqiConfig, LqiError,
    LqiLoop, Motion, MpcConfig, MpcError, MpcLoop, OuterLoop, Position, ProportionalLoop,
    Reference, RelaxedSingleTrack, SingleTrackState, TrackingInput, VehicleParameters, Velocity,
    direction, front_point_velocity,
};

const PERIOD: f64 = 0.01;

/// Servo: 20 ms of dead time and a lag of 40 ms. Motor: 30 ms, 80 ms, and 0.3 % too fast.
struct Car {
    model: RelaxedSingleTrack,
    state: SingleTrackState,
    speed: f64,
    steering: f64,
    steering_commands: VecDeque<f64>,
    speed_commands: VecDeque<f64>,
}

impl Car {
    fn at(law: &FrontPointLaw, reference: &Reference) -> Self {
        let start = reference.at(0.0);
        let yaw = start.velocity.y.atan2(start.velocity.x);
        let reach = law.front_axle_distance() + law.point_distance();
        let place = start.position.unwrap_or_default() - reach * direction(yaw);
        Self {
            model: RelaxedSingleTrack::new(VehicleParameters::paper()),
            state: SingleTrackState {
                x: place.x,
                y: place.y,
                yaw,
                ..SingleTrackState::default()
            },
            speed: 0.0,
            steering: 0.0,
            steering_commands: VecDeque::from([0.0; 2]),
            speed_commands: VecDeque::from([0.0; 3]),
        }
    }

    fn motion(&self) -> Motion {
        Motion {
            yaw: self.state.yaw,
            yaw_rate: self.state.yaw_rate,
            sideslip: self.state.sideslip,
        }
    }

    fn point(&self, law: &FrontPointLaw, steering: f64) -> Position {
        law.point(
            Position::new(self.state.x, self.state.y),
            self.state.yaw,
            steering,
        )
    }

    fn advance(&mut self, speed: f64, steering: f64) {
        self.steering_commands.push_back(steering);
        self.speed_commands.push_back(speed * 1.003);
        let steering = self.steering_commands.pop_front().unwrap_or_default();
        let speed = self.speed_commands.pop_front().unwrap_or_default();
        for _ in 0..10 {
            let step = PERIOD / 10.0;
            self.steering += (steering - self.steering) * step / 0.04;
            self.speed += (speed - self.speed) * step / 0.08;
            let rate = self
                .model
                .derivative(&self.state, self.speed, self.steering);
            self.state.yaw_rate += rate.yaw_rate * step;
            self.state.sideslip += rate.sideslip * step;
            self.state.yaw += self.state.yaw_rate * step;
            let way = self.speed * step * direction(self.state.yaw + self.state.sideslip);
            self.state.x += way.x;
            self.state.y += way.y;
        }
    }
}

/// The root mean square of the error in the second half, in mm.
fn drive(tracking: &mut dyn OuterLoop, law: FrontPointLaw, reference: &Reference) -> f64 {
    let limits = Limits {
        max_speed: 2.5,
        max_acceleration: 3.0,
        max_lateral_acceleration: 2.4,
        max_steering: 0.6,
        ..Limits::paper()
    };
    let mut car = Car::at(&law, reference);
    let mut limited = LimitedLaw::new(law, limits);
    let mut applied = Velocity::zeros();
    let ticks = 4000;
    let mut sum = 0.0;
    for tick in 0..ticks {
        let time = f64::from(tick) * PERIOD;
        let error = reference
            .at(time)
            .position
            .map(|wanted| (car.point(&law, car.steering) - wanted).norm_squared());
        if tick >= ticks / 2 {
            sum += error.unwrap_or_default();
        }
        let (motion, steering) = (car.motion(), limited.actuation().steering);
        let wanted = tracking.step(&TrackingInput {
            point: car.point(&law, steering),
            reference: &|ahead| reference.at(time + ahead),
            applied,
            period: PERIOD,
        });
        let Ok(actuation) = limited.step(&motion, car.speed, &wanted, PERIOD) else {
            return f64::NAN;
        };
        applied = front_point_velocity(
            &law,
            &motion,
            steering,
            actuation.speed,
            actuation.steering_rate,
        );
        car.advance(actuation.speed, actuation.steering);
    }
    1e3 * (sum / f64::from(ticks / 2)).sqrt()
}

fn lqi() -> Result<LqiLoop, LqiError> {
    let axis = |lag| LqiAxis {
        lag,
        integral_weight: 1.0,
        error_weight: 1.0,
        velocity_weight: 0.03,
    };
    LqiLoop::new(LqiConfig {
        along: axis(0.11),
        across: axis(0.06),
        integral_limit: 0.3,
        turn_rate: 3.0,
        period: PERIOD,
    })
}

fn mpc() -> Result<MpcLoop<4, 25>, MpcError> {
    MpcLoop::new(MpcConfig {
        lag: 0.06,
        period: PERIOD,
        ticks_per_stage: 3,
        position_weight: 1.0,
        velocity_weight: 0.02,
        acceleration_weight: 0.001,
        max_speed: 2.5,
        max_acceleration: 3.0,
        max_deceleration: 3.0,
        area: None,
        iterations: 20,
        disturbance_gain: 0.02,
    })
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let law = FrontPointLaw::new(0.1368, 0.35, 0.26)?;
    let circle = |radius, speed: f64| {
        Circle::new(Position::origin(), radius, speed / radius).map(Reference::Circle)
    };
    let eight = |length: f64, width: f64, rate| {
        FigureOfEight::new(Position::origin(), length / 2.0, width / 2.0, rate)
            .map(Reference::FigureOfEight)
    };
    let paths = [
        ("circle 1 m, 0.5 m/s", circle(1.0, 0.5)?),
        ("circle 1 m, 1.0 m/s", circle(1.0, 1.0)?),
        ("circle 1 m, 1.4 m/s", circle(1.0, 1.4)?),
        ("eight 4x2 m, 0.76 m/s", eight(4.0, 2.0, 0.27)?),
        ("eight 6x3 m, 0.98 m/s", eight(6.0, 3.0, 0.231)?),
    ];
    let proportional = |gain: f64, feed_forward| ProportionalLoop {
        gain: Velocity::new(gain, gain),
        feed_forward,
    };
    let mut loops: [(&str, Box<dyn OuterLoop>); 5] = [
        ("P, K = 1", Box::new(proportional(1.0, false))),
        ("P + velocity, K = 1", Box::new(proportional(1.0, true))),
        ("P + velocity, K = 3", Box::new(proportional(3.0, true))),
        ("LQI", Box::new(lqi()?)),
        ("MPC", Box::new(mpc()?)),
    ];
    print!("{:20}", "RMS of P, mm");
    for (name, _) in &paths {
        print!("{name:>24}");
    }
    println!();
    for (name, tracking) in &mut loops {
        print!("{name:20}");
        for (_, path) in &paths {
            tracking.reset();
            print!("{:24.1}", drive(tracking.as_mut(), law, path));
        }
        println!();
    }
    Ok(())
}
