//! The car's state at the moment at which a command acts, from a model of the actuators.
//!
//! A command reaches wheels and motor late, and they follow it with a lag. The model is the
//! identified one: for each actuator a dead time, then a lag of first order. Everything that
//! is measured stays measured: the model only says how the state changes until then.

use heapless::Deque;
use libm::{atan, exp, fabs, sincos, tan};

use crate::{Estimate, Motion, Position, Time, VehicleParameters};

/// Commands kept: those of the longest dead time at the shortest period.
const COMMANDS: usize = 128;

/// The longest step of the prediction, s.
const LONGEST_STEP: f64 = 0.005;

/// The most that is predicted, s: beyond it a model says little.
const FARTHEST: f64 = 0.5;

/// How steering and motor follow their commands, in s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ActuatorModel {
    /// From a command to the first movement of the front wheels.
    pub steering_dead_time: f64,
    /// Time constant of the wheels' angle.
    pub steering_lag: f64,
    /// From a command to the first change of the speed.
    pub speed_dead_time: f64,
    /// Time constant of the speed.
    pub speed_lag: f64,
}

/// Follows the wheels by a model of the servo, and predicts the state of the car.
#[derive(Clone, Debug, PartialEq)]
pub struct Predictor {
    model: ActuatorModel,
    lateral: Lateral,
    /// The steering angles commanded, with the times from which they count.
    commands: Deque<(Time, f64), COMMANDS>,
    /// The angle that counted before the first of them.
    before: f64,
    /// The state of the model at `time`.
    time: Option<Time>,
    wheels: f64,
    response: Response,
}

/// Yaw rate and sideslip of the model, in rad/s and rad.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Response {
    yaw_rate: f64,
    sideslip: f64,
}

/// The state at the moment that was predicted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Predicted {
    /// Position of G, m.
    pub position: Position,
    /// Yaw, yaw rate and sideslip.
    pub motion: Motion,
    /// Speed of G, m/s.
    pub speed: f64,
    /// Angle of the front wheels, rad.
    pub wheels: f64,
    /// How far after the estimate the state is, s.
    pub ahead: f64,
    response: Response,
    lateral: Lateral,
}

/// The car's answer to its steering, to first order: the steady state of linear tyres, and the
/// time constants of yaw rate and sideslip.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Lateral {
    wheelbase: f64,
    rear_axle_distance: f64,
    /// Steering for each m/s² of lateral acceleration, rad s²/m.
    understeer: f64,
    /// Sideslip that each m/s² takes away, rad s²/m.
    rear_slip: f64,
    /// Time constants for each m/s of speed, s²/m.
    yaw_time: f64,
    slip_time: f64,
}

impl Lateral {
    fn of(vehicle: &VehicleParameters) -> Self {
        let [m, inertia, l_f, l_r, c_f, c_r] = vehicle.symbols();
        let wheelbase = vehicle.wheelbase_m();
        Self {
            wheelbase,
            rear_axle_distance: l_r,
            understeer: m / wheelbase * (l_r / c_f - l_f / c_r),
            rear_slip: m * l_f / (wheelbase * c_r),
            yaw_time: inertia / (c_f * l_f * l_f + c_r * l_r * l_r),
            slip_time: m / (c_f + c_r),
        }
    }

    /// The response after `dt` seconds with this speed and these wheels.
    fn after(&self, response: Response, speed: f64, wheels: f64, dt: f64) -> Response {
        let pace = fabs(speed);
        // An oversteering car has a critical speed; the model must not diverge there.
        let length = (self.wheelbase + self.understeer * speed * speed).max(0.5 * self.wheelbase);
        let curvature = tan(wheels) / length;
        let steady = Response {
            yaw_rate: speed * curvature,
            sideslip: atan(self.rear_axle_distance * curvature)
                - self.rear_slip * speed * speed * curvature,
        };
        Response {
            yaw_rate: lagged(response.yaw_rate, steady.yaw_rate, self.yaw_time * pace, dt),
            sideslip: lagged(
                response.sideslip,
                steady.sideslip,
                self.slip_time * pace,
                dt,
            ),
        }
    }
}

/// What `value` is `dt` (s) after it began to go to `target` with a lag of `lag` (s); without a lag, `target`.
pub(crate) fn lagged(value: f64, target: f64, lag: f64, dt: f64) -> f64 {
    if lag <= 0.0 {
        return target;
    }
    target + (value - target) * exp(-dt / lag)
}

impl Predictor {
    /// Straight wheels that stand.
    pub fn new(model: ActuatorModel, vehicle: &VehicleParameters) -> Self {
        Self {
            model,
            lateral: Lateral::of(vehicle),
            commands: Deque::new(),
            before: 0.0,
            time: None,
            wheels: 0.0,
            response: Response::default(),
        }
    }

    /// The model.
    pub const fn model(&self) -> &ActuatorModel {
        &self.model
    }

    /// The angle of the front wheels by the model, at the last tick, in rad.
    pub const fn wheels(&self) -> f64 {
        self.wheels
    }

    /// The wheels have stood at `steering` (rad) for long.
    pub fn reset(&mut self, steering: f64) {
        self.commands.clear();
        self.before = steering;
        self.wheels = steering;
        self.response = Response::default();
        self.time = None;
    }

    /// The steering angle `steering` (rad) was commanded at `now`.
    pub fn commanded(&mut self, now: Time, steering: f64) {
        if self.commands.is_full()
            && let Some((_, oldest)) = self.commands.pop_front()
        {
            self.before = oldest;
        }
        // There is room: see above.
        let _ = self.commands.push_back((now, steering));
    }

    /// Advances the model of the wheels to `now`, with the car at this speed (m/s).
    pub fn advance(&mut self, now: Time, speed: f64) {
        let from = self.time.replace(now).unwrap_or(now);
        let elapsed = now.seconds_since(from).clamp(0.0, FARTHEST);
        (self.wheels, self.response) = self.run(from, speed, elapsed, |_, _| {});
        // What no longer counts is forgotten.
        let counts_from = now.before(self.model.steering_dead_time);
        while let Some(&(time, steering)) = self.commands.front()
            && time <= counts_from
        {
            self.before = steering;
            self.commands.pop_front();
        }
    }

    /// The state when a command of this tick begins to turn the wheels. The model must have
    /// been advanced to the estimate's time.
    pub fn predict(&self, estimate: &Estimate) -> Predicted {
        let ahead = self.model.steering_dead_time.min(FARTHEST);
        let mut state = Predicted {
            position: estimate.position,
            motion: estimate.motion(),
            speed: estimate.speed,
            wheels: self.wheels,
            ahead: 0.0,
            response: self.response,
            lateral: self.lateral,
        };
        let moves = |response, dt| state.moves(response, dt);
        let (wheels, _) = self.run(estimate.time, estimate.speed, ahead, moves);
        Predicted { wheels, ..state }
    }

    /// Runs servo and response for `duration` seconds after `from`; `each` sees the response
    /// at the end of each step, and its length.
    fn run(
        &self,
        from: Time,
        speed: f64,
        duration: f64,
        mut each: impl FnMut(Response, f64),
    ) -> (f64, Response) {
        let (mut wheels, mut response, mut done) = (self.wheels, self.response, 0.0);
        let dead = self.model.steering_dead_time;
        let mut target = self.before;
        let mut commands = self.commands.iter().peekable();
        while done < duration {
            // A command counts from the end of its dead time on.
            let mut end = duration.min(done + LONGEST_STEP);
            while let Some(&&(time, steering)) = commands.peek() {
                let counts = time.after(dead);
                let counts = if counts >= from {
                    counts.seconds_since(from)
                } else {
                    0.0
                };
                if counts > done {
                    end = end.min(counts);
                    break;
                }
                target = steering;
                commands.next();
            }
            let dt = end - done;
            wheels = lagged(wheels, target, self.model.steering_lag, dt);
            response = self.lateral.after(response, speed, wheels, dt);
            each(response, dt);
            done = end;
        }
        (wheels, response)
    }

    /// The command (rad) with which the wheels turn from `wheels` (rad) with `rate` (rad/s)
    /// over a period of `period` seconds, in spite of their lag.
    pub fn command_for(&self, wheels: f64, rate: f64, period: f64) -> f64 {
        let lag = self.model.steering_lag;
        let reached = if lag > 0.0 {
            1.0 - exp(-period / lag)
        } else {
            1.0
        };
        wheels + rate * period / reached
    }
}

impl Predicted {
    /// Moves on for `dt` seconds, at the end of which the model's response is `response`.
    fn moves(&mut self, response: Response, dt: f64) {
        let before = self.motion;
        let yaw_rate = before.yaw_rate + response.yaw_rate - self.response.yaw_rate;
        let sideslip = before.sideslip + response.sideslip - self.response.sideslip;
        self.response = response;
        let turn = 0.5 * (before.yaw_rate + yaw_rate) * dt;
        let course = before.yaw + 0.5 * (turn + before.sideslip + sideslip);
        let (sine, cosine) = sincos(course);
        self.position.x += self.speed * dt * cosine;
        self.position.y += self.speed * dt * sine;
        self.motion = Motion {
            yaw: before.yaw + turn,
            yaw_rate,
            sideslip,
        };
        self.ahead += dt;
    }

    /// The state `dt` seconds later, if the wheels turn with `rate` (rad/s) and the speed
    /// reaches `speed` (m/s).
    #[must_use]
    pub fn after(&self, dt: f64, rate: f64, speed: f64) -> Self {
        let mut later = *self;
        later.wheels += rate * dt;
        later.speed = 0.5 * (self.speed + speed);
        let response = self
            .lateral
            .after(self.response, later.speed, later.wheels, dt);
        later.moves(response, dt);
        later.speed = speed;
        later
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::direction;

    const MODEL: ActuatorModel = ActuatorModel {
        steering_dead_time: 0.02,
        steering_lag: 0.04,
        speed_dead_time: 0.03,
        speed_lag: 0.08,
    };

    const START: Time = Time(1_000_000_000);

    fn predictor(model: ActuatorModel) -> Predictor {
        Predictor::new(model, &VehicleParameters::paper())
    }

    /// A car at the origin, looking along x.
    fn estimate(now: Time, speed: f64, yaw_rate: f64) -> Estimate {
        Estimate {
            time: now,
            position: Position::origin(),
            yaw: 0.0,
            yaw_rate,
            sideslip: 0.0,
            speed,
            pose_time: now,
        }
    }

    #[test]
    fn the_wheels_follow_a_command_after_its_dead_time_with_their_lag() {
        let mut predictor = predictor(MODEL);
        predictor.advance(START, 0.5);
        predictor.commanded(START, 0.2);
        for (seconds, part) in [(0.0, 0.0), (0.02, 0.0), (0.06, 0.632_120_559), (0.5, 1.0)] {
            predictor.advance(START.after(seconds), 0.5);
            assert!((predictor.wheels() - 0.2 * part).abs() < 1e-5, "{seconds}");
        }
        predictor.reset(-0.1);
        predictor.advance(START, 0.5);
        assert_eq!(predictor.wheels(), -0.1);
    }

    #[test]
    fn the_prediction_is_the_state_that_comes() {
        let mut predictor = predictor(MODEL);
        let mut command = 0.0;
        for tick in 0..50 {
            let now = START.after(0.01 * f64::from(tick));
            predictor.advance(now, 0.5);
            let seen = predictor.predict(&estimate(now, 0.5, 0.0));
            assert!((seen.ahead - 0.02).abs() < 1e-12);
            command += 0.003;
            predictor.commanded(now, command);
            // What is commanded from now on does not act before the dead time ends.
            let mut later = predictor.clone();
            later.commanded(now.after(0.01), 9.0);
            later.advance(now.after(0.02), 0.5);
            assert!((later.wheels() - seen.wheels).abs() < 1e-6, "{tick}");
        }
    }

    #[test]
    fn a_car_in_a_steady_bend_stays_on_its_circle() {
        let mut predictor = predictor(MODEL);
        predictor.reset(0.2);
        for tick in 0..100 {
            predictor.advance(START.after(0.01 * f64::from(tick)), 0.8);
        }
        let now = START.after(0.99);
        let seen = predictor.predict(&estimate(now, 0.8, 0.7));
        let turned = 0.7 * 0.02;
        assert!((seen.motion.yaw - turned).abs() < 1e-9);
        let chord = 0.8 * 0.02 * direction(0.5 * turned);
        assert!((seen.position - Position::origin() - chord).norm() < 1e-6);
        assert!((seen.motion.yaw_rate - 0.7).abs() < 1e-6);
    }

    #[test]
    fn a_command_with_its_lead_turns_the_wheels_as_wanted() {
        for lag in [0.0, 0.04, 0.2] {
            let model = ActuatorModel {
                steering_dead_time: 0.0,
                steering_lag: lag,
                ..MODEL
            };
            let mut predictor = predictor(model);
            let mut wheels = 0.0;
            for tick in 0..100 {
                let now = START.after(0.01 * f64::from(tick));
                predictor.advance(now, 0.5);
                assert!((predictor.wheels() - wheels).abs() < 1e-9, "{lag}");
                let command = predictor.command_for(predictor.wheels(), 0.3, 0.01);
                predictor.commanded(now, command);
                wheels += 0.003;
            }
        }
    }

    #[test]
    fn extreme_models_and_states_stay_finite() {
        let vehicle = VehicleParameters {
            front_cornering_stiffness_n_rad: 500.0,
            rear_cornering_stiffness_n_rad: 20.0,
            ..VehicleParameters::paper()
        };
        for model in [
            MODEL,
            ActuatorModel {
                steering_dead_time: 0.5,
                steering_lag: 1.0,
                speed_dead_time: 0.5,
                speed_lag: 2.0,
            },
            ActuatorModel {
                steering_dead_time: 0.0,
                steering_lag: 0.0,
                speed_dead_time: 0.0,
                speed_lag: 0.0,
            },
        ] {
            let mut predictor = Predictor::new(model, &vehicle);
            for (tick, speed) in [0.0, -3.0, 20.0, 1e-9, 5.0]
                .iter()
                .cycle()
                .take(500)
                .enumerate()
            {
                let now = START.after(0.005 * tick as f64);
                predictor.advance(now, *speed);
                let seen = predictor.predict(&estimate(now, *speed, 1.0));
                assert!(seen.motion.yaw.is_finite() && seen.position.x.is_finite());
                assert!(seen.motion.yaw_rate.is_finite() && seen.motion.sideslip.is_finite());
                predictor.commanded(now, if tick % 2 == 0 { 1.2 } else { -1.2 });
            }
        }
    }
}
