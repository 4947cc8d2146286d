//! A drive on the paper's model: equations 1 and 2, without lag, noise, limits or estimator.

use libm::{atan, cos, sin, tan};
use singletrack_control::{
    ActuatorModel, Estimate, FrontPointLaw, Limits, OuterLoop as _, Position, SingleTrack,
    SingleTrackDerivative, SingleTrackState, Singularity, Time, TrackingInput, TrackingLoop,
    VehicleParameters, Velocity,
};
use singletrack_core::config::LoopModel;
use singletrack_sim::Truth;

use super::{
    controller::Drives,
    counted::{Counted, DriveError, DriveResult, POINT_DISTANCE_M},
    course::{Course, Table},
    foreign::{Foreign, Known},
    predictive::Predictive,
};

/// Step of the integration and of the controller, which is almost continuous, in s.
const STEP_S: f64 = 1e-3;
/// Steps from one counted state to the next.
const STEPS_PER_COUNT: u32 = 10;
/// Steps of the controller between two of a loop with a state, which is one of ticks.
const STEPS_PER_TICK: u32 = 10;
/// Slower than this, in m/s, the wheels roll where they point: equation 1 is singular at
/// standstill.
const ROLLS_BELOW: f64 = 0.1;

/// The ideal plant's: wider than any course needs.
const FREE: Limits = Limits {
    max_speed: 10.0,
    ..Limits::paper()
};

/// The ideal plant's actuators.
const PROMPT: ActuatorModel = ActuatorModel {
    steering_dead_time: 0.0,
    steering_lag: 0.0,
    speed_dead_time: 0.0,
    speed_lag: 0.0,
};

/// Drives `course` with a controller that knows the true state.
pub(super) fn drive(
    drives: &Drives,
    course: &Course,
    table: &Table,
) -> Result<DriveResult, DriveError> {
    let vehicle = VehicleParameters::paper();
    let own = drives.own_point();
    let mut errors = Counted::new(own, &vehicle, course.counted, table);
    let mut law = Controller::new(drives, &vehicle, table)?;
    let mut car = Car::at(own.reach(&vehicle), course, vehicle);
    let steps = (course.counted[1] / STEP_S) as u32;
    let mut stopped = None;
    for step in 0..=steps {
        let time = f64::from(step) * STEP_S;
        let rate = match law.command(&mut car, time) {
            Ok(rate) => rate,
            Err(error) => {
                stopped = Some(format!("singular: {error}"));
                break;
            }
        };
        if step % STEPS_PER_COUNT == 0 {
            errors.add(time, &car.truth());
        }
        car.advance(rate);
        if !car.state.x.is_finite() {
            stopped = Some("diverged".to_owned());
            break;
        }
    }
    Ok(errors.result(stopped))
}

#[expect(
    clippy::large_enum_variant,
    reason = "there is one at a time, on the stack"
)]
enum Controller<'a> {
    Front {
        law: FrontPointLaw,
        tracking: TrackingLoop,
        /// From one step of the loop to the next, and until the next.
        steps: u32,
        left: u32,
        applied: Velocity,
        table: &'a Table,
    },
    Foreign(Foreign<'a>),
    Predictive {
        law: Predictive<'a>,
        /// Steering (rad) and speed (m/s) of the next tick, and the steps until then.
        next: [f64; 2],
        left: u32,
    },
}

impl<'a> Controller<'a> {
    fn new(
        drives: &Drives,
        vehicle: &VehicleParameters,
        table: &'a Table,
    ) -> Result<Self, DriveError> {
        Ok(match drives {
            Drives::Point { outer_loop, .. } => {
                let steps = if drives.has_model() {
                    STEPS_PER_TICK
                } else {
                    1
                };
                let tracking = outer_loop.tracking_loop(&LoopModel {
                    actuators: None,
                    limits: &FREE,
                    fence: None,
                    reference: &table.reference,
                    period: f64::from(steps) * STEP_S,
                })?;
                Self::Front {
                    law: FrontPointLaw::new(
                        vehicle.front_axle_distance_m,
                        POINT_DISTANCE_M,
                        vehicle.wheelbase_m(),
                    )?,
                    tracking,
                    steps,
                    left: 0,
                    applied: Velocity::zeros(),
                    table,
                }
            }
            &Drives::Actuators { law, catch_up, .. } => Self::Foreign(Foreign {
                law,
                catch_up,
                vehicle: *vehicle,
                table,
                index: 0,
                // There is nothing to compensate.
                compensation: None,
            }),
            Drives::Predictive(weights) => Self::Predictive {
                law: Predictive::new(
                    *weights,
                    // Its tyres are linear.
                    VehicleParameters {
                        friction: 1e3,
                        ..*vehicle
                    },
                    PROMPT,
                    FREE,
                    f64::from(STEPS_PER_TICK) * STEP_S,
                    table,
                ),
                next: [0.0; 2],
                left: 0,
            },
            Drives::Yours(_) => return Err(DriveError::Yours),
        })
    }

    /// Gives the car its speed, and its steering angle or, returned, the rate of that in rad/s.
    fn command(&mut self, car: &mut Car, time: f64) -> Result<f64, Singularity> {
        let estimate = car.estimate();
        match self {
            Self::Front {
                law,
                tracking,
                steps,
                left,
                applied,
                table,
            } => {
                if *left == 0 {
                    *left = *steps;
                    *applied = tracking.step(&TrackingInput {
                        point: law.point(estimate.position, estimate.yaw, car.steering),
                        reference: &|ahead| table.reference.at(time + ahead),
                        applied: *applied,
                        period: f64::from(*steps) * STEP_S,
                    });
                }
                *left -= 1;
                let command = law.command(&estimate.motion(), car.steering, applied)?;
                car.speed = command.speed;
                return Ok(command.steering_rate);
            }
            Self::Foreign(foreign) => {
                [car.steering, car.speed] = foreign.command(&estimate, time, 0.0);
            }
            Self::Predictive { law, next, left } => {
                if *left == 0 {
                    *left = STEPS_PER_TICK;
                    [car.steering, car.speed] = *next;
                    *next = law.answer(&Known {
                        estimate: &car.estimate(),
                        steering: car.steering,
                        speed: car.speed,
                        time,
                    });
                }
                *left -= 1;
            }
        }
        Ok(0.0)
    }
}

struct Car {
    model: SingleTrack,
    state: SingleTrackState,
    steering: f64,
    speed: f64,
}

impl Car {
    fn at(reach: f64, course: &Course, vehicle: VehicleParameters) -> Self {
        let [x, y] = course.start;
        Self {
            model: SingleTrack::new(vehicle),
            state: SingleTrackState {
                x: x - reach * cos(course.heading),
                y: y - reach * sin(course.heading),
                yaw: course.heading,
                ..SingleTrackState::default()
            },
            steering: 0.0,
            speed: 0.0,
        }
    }

    fn slope(&self, state: &SingleTrackState, steering: f64) -> SingleTrackDerivative {
        self.model.derivative(state, self.speed, steering)
    }

    /// One step with this speed and a constant steering rate (rad/s).
    fn advance(&mut self, rate: f64) {
        let (start, half) = (self.steering, 0.5 * STEP_S);
        self.steering = start + STEP_S * rate;
        if self.speed < ROLLS_BELOW {
            self.roll();
            return;
        }
        // The classical Runge-Kutta method.
        let middle = start + half * rate;
        let first = self.slope(&self.state, start);
        let second = self.slope(&after(&self.state, half, &first), middle);
        let third = self.slope(&after(&self.state, half, &second), middle);
        let fourth = self.slope(&after(&self.state, STEP_S, &third), self.steering);
        let parts = [(1.0, first), (2.0, second), (2.0, third), (1.0, fourth)];
        for (part, slope) in parts {
            self.state = after(&self.state, part * STEP_S / 6.0, &slope);
        }
    }

    /// One step without slip.
    fn roll(&mut self) {
        let vehicle = self.model.vehicle();
        let curvature = tan(self.steering) / vehicle.wheelbase_m();
        let state = &mut self.state;
        state.sideslip = atan(vehicle.rear_axle_distance_m * curvature);
        state.yaw_rate = self.speed * cos(state.sideslip) * curvature;
        state.x += STEP_S * self.speed * cos(state.yaw + state.sideslip);
        state.y += STEP_S * self.speed * sin(state.yaw + state.sideslip);
        state.yaw += STEP_S * state.yaw_rate;
    }

    fn estimate(&self) -> Estimate {
        Estimate {
            time: Time(0),
            position: Position::new(self.state.x, self.state.y),
            yaw: self.state.yaw,
            yaw_rate: self.state.yaw_rate,
            sideslip: self.state.sideslip,
            speed: self.speed,
            pose_time: Time(0),
        }
    }

    fn truth(&self) -> Truth {
        let turn = if self.speed < ROLLS_BELOW {
            self.state.yaw_rate
        } else {
            self.state.yaw_rate + self.slope(&self.state, self.steering).sideslip
        };
        Truth {
            x: self.state.x,
            y: self.state.y,
            yaw: self.state.yaw,
            yaw_rate: self.state.yaw_rate,
            sideslip: self.state.sideslip,
            steering: self.steering,
            speed: self.speed,
            lateral_acceleration: self.speed * turn,
            ..Truth::default()
        }
    }
}

/// The state after `time` seconds at a constant slope.
fn after(state: &SingleTrackState, time: f64, slope: &SingleTrackDerivative) -> SingleTrackState {
    SingleTrackState {
        x: state.x + time * slope.x,
        y: state.y + time * slope.y,
        yaw: state.yaw + time * slope.yaw,
        yaw_rate: state.yaw_rate + time * slope.yaw_rate,
        sideslip: state.sideslip + time * slope.sideslip,
    }
}
