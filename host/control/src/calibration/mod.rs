//! What a drive says about the calibration of the car.
//!
//! Four regressions over windows of a drive compare what poses, gyro, motor sensor and commands
//! say of the same motion. With the yaw rate ω of the car, its speed v, and stamps that are late
//! by τ:
//!
//! - gyro: it reads s ω + b, and the poses turn with ω − τ dω/dt;
//! - steering: ω = v (g δ + δ₀)/(L + K v²), with the angle δ of the configured servo's model;
//! - across: the rear axle moves along the car, but for the slip of its tyres. The pivot ahead of
//!   it moves across with ω, a turned body with v;
//! - along: the pivot moves with the speed of the motor sensor, less ω times its distance to the
//!   left.
//!
//! The gyro alone would need minutes for τ: its vibration is large. Steering and motor sensor have
//! delays too, which are believed to 8 ms, and only if the three agree.
//!
//! What a motion does not excite is not observable: on a steady circle all regressors are
//! constant. Tyres are those of the configured vehicle, in small angles as in equation 1: exact
//! slip angles change the gain by up to 1.7 %.

mod equations;

pub use equations::student_quantile;
use equations::{Fit, Means, Regression, Windows, begin, first_open, follows, is_gap};
use libm::{atanh, fabs, hypot, sincos, sqrt};
use nalgebra::SVector;

use crate::{
    ActuatorModel, GRAVITY, InertialSample, PoseSample, Position, Predictor, Time,
    VehicleParameters, words, wrap,
};

/// Length of a window, s.
const LENGTH: f64 = 0.6;

/// Length of a window that compares the gyro, s. The noise of the gyro turns the car, through the
/// controller, a moment later, which looks like early stamps: a long window has little of it.
const LONG: f64 = 3.0;

/// Windows in a block of 6 s.
const PER_BLOCK: u64 = 20;

/// Long windows in such a block.
const LONG_PER_BLOCK: u64 = 4;

/// Delay of the motor's speed against its stamp, besides half a pulse, s: the board counts
/// pulses between its polls.
const BOARD_DELAY: f64 = 0.006;

/// Largest difference of the delays of steering and motor sensor from their models, s: lags of
/// the servo, and tyres that slip while the car accelerates.
const DELAY_ERROR: f64 = 0.008;

/// The widest half width against the gyro alone with which the others count, s: its delay alone is
/// known.
const WIDEST_ALONE: f64 = 0.025;

/// Steering and motor sensor are believed up to this sum of squares of what the delays differ by,
/// in standard deviations: 95 % with two degrees of freedom.
const MOST_DISAGREEMENT: f64 = 6.0;

/// A block of a drive that contradicts the ones before by this is odd, as a change of the trim, rad:
/// the servo is stuck, the car slides, or the steering has changed.
const ODD: f64 = 0.015;

/// The steering counts as changed after this number of odd blocks in a row. Normal learning changes
/// it more slowly.
const ODD_BLOCKS: u32 = 2;

/// Slower windows are left out, m/s.
const SLOWEST: f64 = 0.25;

/// A faster body has jumped, m/s and rad/s.
const JUMP: [f64; 2] = [10.0, 15.0];

/// The most grip that the model of the tyres uses.
const MOST_GRIP: f64 = 0.9;

words! {
    /// What is estimated: the true value less the configured one.
    pub enum CalibrationParameter {
        /// Angle of the front wheels for that commanded, as a fraction beyond one.
        SteeringGain = 1 "steering-gain",
        /// Angle of the front wheels when straight ones are commanded, rad.
        SteeringTrim = 2 "steering-trim",
        /// Delay of the poses' stamps, s.
        StampOffset = 3 "stamp-offset",
        /// Measured over true yaw rate, as a fraction beyond one.
        GyroScale = 4 "gyro-scale",
        /// Yaw of the rigid body on the car, rad.
        BodyYaw = 5 "body-yaw",
        /// Position of the rigid body's pivot, forward, m.
        PivotForward = 6 "pivot-forward",
        /// Position of the rigid body's pivot, to the left, m.
        PivotLeft = 7 "pivot-left",
        /// Distance for a motor pulse, as a fraction beyond one.
        PulseDistance = 8 "pulse-distance",
    }
}

impl CalibrationParameter {
    /// What a deviation must exceed to matter: each costs some 3 mm, or nothing but trust.
    pub const fn threshold(self) -> f64 {
        self.bounds().threshold
    }

    const fn bounds(self) -> Bounds {
        let [threshold, widest, systematic, least_excitation] = match self {
            Self::SteeringGain => [0.02, 0.03, 0.004, 0.1],
            Self::SteeringTrim => [0.005, 0.01, 0.000_5, 0.8],
            Self::StampOffset => [0.004, 0.012, 0.000_7, 0.06],
            Self::GyroScale => [0.015, 0.015, 0.001, 0.1],
            Self::BodyYaw => [0.004, 0.006, 0.000_5, 0.2],
            Self::PivotForward => [0.003, 0.004, 0.000_6, 0.1],
            Self::PivotLeft => [0.003, 0.004, 0.000_6, 0.1],
            Self::PulseDistance => [0.01, 0.015, 0.002, 0.2],
        };
        Bounds {
            threshold,
            widest,
            systematic,
            least_excitation,
        }
    }
}

/// What is demanded of an estimate.
struct Bounds {
    threshold: f64,
    /// The largest half width of an interval that counts.
    widest: f64,
    /// What the model is wrong by, which no residual shows.
    systematic: f64,
    /// The least root mean square of the regressor, without its part along the others.
    least_excitation: f64,
}

/// An estimate of a parameter, with its interval of 95 %.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CalibrationEstimate {
    /// What is estimated.
    pub parameter: CalibrationParameter,
    /// The true value less the configured one.
    pub value: f64,
    /// Half the width of the interval; infinite if nothing is known.
    pub half_width: f64,
    /// Whether the motion made it observable.
    pub observable: bool,
}

impl CalibrationEstimate {
    /// Whether the configured value is wrong by what matters.
    pub fn is_off(&self) -> bool {
        let off = fabs(self.value);
        self.observable && off > self.half_width && off > self.parameter.threshold()
    }
}

/// What is configured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CalibrationConfig {
    /// The car.
    pub vehicle: VehicleParameters,
    /// How the front wheels follow their commands.
    pub actuators: ActuatorModel,
    /// Position of the rigid body's pivot from the centre of mass: forward, left, m.
    pub marker_offset: [f64; 2],
    /// Yaw of the rigid body on the car, rad.
    pub marker_yaw: f64,
    /// Distance for a motor pulse, m.
    pub pulse_distance: f64,
}

/// Estimates the errors of a calibration while the car drives.
///
/// It does not change the car. Its memory is the last six minutes that count.
#[derive(Clone, Debug)]
pub struct Calibration {
    config: CalibrationConfig,
    predictor: Predictor,
    /// The first tick.
    origin: Option<Time>,
    pose: Option<(f64, Position, f64)>,
    speed: f64,
    /// The first open window, and the first open long one.
    first: u64,
    first_long: u64,
    /// Yaw rate, and velocity along and across the axes of the configured car.
    poses: Windows<3>,
    /// Speed of the motor sensor.
    motor: Windows<1>,
    /// That speed times the angle of the wheels.
    wheels: Windows<1>,
    turns: Windows<1>,
    gyro: Windows<1>,
    gyro_fit: Regression<4>,
    steering_fit: Regression<3>,
    across_fit: Regression<2>,
    along_fit: Regression<4>,
    /// Blocks in a row that contradict those before.
    odd: u32,
    /// The sudden change of the steering while the car drove, as a change of the trim,
    /// rad: a horn has slipped, a servo is stuck. `None` if it has not. What was known of the
    /// steering before is forgotten.
    pub steering_change: Option<f64>,
}

impl Calibration {
    /// Before the first tick.
    pub fn new(config: CalibrationConfig) -> Self {
        Self {
            config,
            predictor: Predictor::new(config.actuators, &config.vehicle),
            origin: None,
            pose: None,
            speed: 0.0,
            first: 0,
            first_long: 0,
            poses: Windows::new(LENGTH),
            motor: Windows::new(LENGTH),
            wheels: Windows::new(LENGTH),
            turns: Windows::new(LONG),
            gyro: Windows::new(LONG),
            gyro_fit: Regression::new(),
            steering_fit: Regression::new(),
            across_fit: Regression::new(),
            along_fit: Regression::new(),
            odd: 0,
            steering_change: None,
        }
    }

    /// Whether the last seconds contradict what the drives before say of the steering, or it has
    /// changed.
    pub const fn doubts_steering(&self) -> bool {
        self.odd > 0 || self.steering_change.is_some()
    }

    /// A block of the drive ends: compares it with those before.
    fn end_steering_block(&mut self) {
        let fit = self.steering_fit.fit(None);
        // What was never observable is contradicted by the first bend.
        let is_known = estimate(CalibrationParameter::SteeringGain, fit, 0).observable
            && estimate(CalibrationParameter::SteeringTrim, fit, 1).observable;
        let change = fit
            .filter(|_| is_known)
            .and_then(|fit| self.steering_fit.contradiction(1, &fit.values));
        match change {
            Some(change) if fabs(change) > ODD => {
                self.odd += 1;
                if self.odd >= ODD_BLOCKS {
                    self.steering_change = Some(change);
                    self.steering_fit.forget();
                }
                // What contradicts is not mixed with what was known.
                self.steering_fit.drop_block();
            }
            Some(_) => {
                self.odd = 0;
                self.steering_fit.end_block();
            }
            None => self.steering_fit.end_block(),
        }
    }

    /// A tick begins at `now`, before its poses and its telemetry.
    pub fn begin_tick(&mut self, now: Time) {
        self.origin.get_or_insert(now);
        self.close_until(self.seconds(now));
    }

    fn seconds(&self, time: Time) -> f64 {
        self.origin.map_or(0.0, |origin| time.seconds_since(origin))
    }

    /// Takes telemetry of the board: the speed of the rear axle from the motor pulses (m/s), and
    /// the sample of the IMU if there is a new one.
    pub fn board(&mut self, time: Time, inertial: Option<InertialSample>, motor_speed: f64) {
        self.speed = motor_speed;
        let time = self.seconds(time);
        self.motor.take(self.first, time, [motor_speed]);
        if let Some(inertial) = inertial {
            let time = self.seconds(inertial.time);
            self.gyro.take(self.first_long, time, [inertial.yaw_rate]);
        }
    }

    /// A tick ends with this steering angle commanded, rad; none if the car does not follow a
    /// command.
    pub fn end_tick(&mut self, now: Time, steering: Option<f64>) {
        if let Some(steering) = steering {
            self.predictor.advance(now, self.speed);
            let moved = self.speed * self.predictor.wheels();
            self.predictor.commanded(now, steering);
            self.wheels.take(self.first, self.seconds(now), [moved]);
        } else {
            self.predictor.reset(0.0);
            self.wheels.interrupt();
        }
    }

    /// The estimates, in the order of their numbers.
    pub fn estimates(&self) -> [CalibrationEstimate; CalibrationParameter::ALL.len()] {
        use CalibrationParameter as Parameter;
        let (gyro, steering) = (self.gyro_fit.fit(None), self.steering_fit.fit(None));
        let across = self.across_fit.fit(None);
        let body_yaw = across.map_or(0.0, |fit| fit.values[1]);
        let along = self.along_fit.fit(Some((3, body_yaw)));
        Parameter::ALL.map(|parameter| match parameter {
            Parameter::SteeringGain => estimate(parameter, steering, 0),
            Parameter::SteeringTrim => estimate(parameter, steering, 1),
            Parameter::GyroScale => estimate(parameter, gyro, 0),
            Parameter::StampOffset => stamps(gyro, steering, along),
            Parameter::PivotForward => estimate(parameter, across, 0),
            Parameter::BodyYaw => estimate(parameter, across, 1),
            Parameter::PulseDistance => estimate(parameter, along, 0),
            Parameter::PivotLeft => estimate(parameter, along, 1),
        })
    }

    /// Takes a pose that came since the last tick.
    pub fn pose(&mut self, pose: &PoseSample) {
        let time = self.seconds(pose.capture);
        let yaw = pose.yaw - self.config.marker_yaw;
        let last = self.pose.replace((time, pose.position, yaw));
        let Some((then, position, yaw_then)) = last else {
            return;
        };
        if !follows(then, time) {
            return;
        }
        let turned = wrap(yaw - yaw_then);
        let moved = pose.position - position;
        let span = time - then;
        let [fastest, fastest_turn] = JUMP;
        if !(moved.norm() < fastest * span && fabs(turned) < fastest_turn * span) {
            self.pose = None;
            self.poses.clear();
            self.turns.clear();
            return;
        }
        let (sine, cosine) = sincos(yaw_then + 0.5 * turned);
        let along = cosine * moved.x + sine * moved.y;
        let across = cosine * moved.y - sine * moved.x;
        self.poses
            .add(self.first, then, time, [turned, along, across]);
        self.turns.add(self.first_long, then, time, [turned]);
    }

    /// Closes the windows that are complete at `now`, s.
    fn close_until(&mut self, now: f64) {
        let [next, next_long] = [LENGTH, LONG].map(|length| first_open(length, now));
        if is_gap(self.first, next) {
            // Ticks were missing.
            self.poses.clear();
            self.motor.clear();
            self.wheels.clear();
            self.first = next;
        }
        if is_gap(self.first_long, next_long) {
            self.turns.clear();
            self.gyro.clear();
            self.first_long = next_long;
        }
        while self.first < next {
            let number = self.first;
            let poses = self.poses.close(number);
            let motor = self.motor.close(number);
            let wheels = self.wheels.close(number);
            if let (Some(poses), Some(motor), Some(([wheels], _))) = (poses, motor, wheels) {
                self.add(&poses, &motor, wheels);
            }
            self.first += 1;
            if self.first.is_multiple_of(PER_BLOCK) {
                self.end_steering_block();
                self.across_fit.end_block();
                self.along_fit.end_block();
            }
        }
        while self.first_long < next_long {
            let number = self.first_long;
            let [turn, gyro] = [&mut self.turns, &mut self.gyro].map(|it| it.close(number));
            if let (Some(([turn], [slope])), Some(([gyro], _))) = (turn, gyro)
                && self.speed > SLOWEST
            {
                let minutes = begin(LONG, number) / 60.0;
                let regressors = SVector::from([turn, slope, 1.0, minutes]);
                self.gyro_fit.add(regressors, gyro - turn);
            }
            self.first_long += 1;
            if self.first_long.is_multiple_of(LONG_PER_BLOCK) {
                self.gyro_fit.end_block();
            }
        }
    }

    /// Adds the equations of a window in which the car drove.
    fn add(&mut self, poses: &Means<3>, motor: &Means<1>, wheels: f64) {
        let ([turn, along, across], [turn_slope, _, _]) = *poses;
        let ([motor], [motor_slope]) = *motor;
        let [forward, left] = self.config.marker_offset;
        // Of the centre of mass, by the poses.
        let speed = hypot(along + left * turn, across - forward * turn);
        if along < SLOWEST || motor < SLOWEST {
            return;
        }
        let tyres = Tyres::of(&self.config.vehicle, speed, turn, turn_slope);
        let wheelbase = self.config.vehicle.wheelbase_m();
        let length = (wheelbase + tyres.understeer * speed * speed).max(0.5 * wheelbase);
        // The motor sensor has the course of the speed, the poses have its scale.
        let modelled = wheels * speed / (motor * length);
        self.steering_fit.add(
            SVector::from([modelled, speed / length, -turn_slope]),
            turn - modelled + tyres.delay * turn_slope,
        );
        let rear = self.config.vehicle.rear_axle_distance_m;
        self.across_fit.add(
            SVector::from([turn, -along]),
            across - (rear + forward) * turn + speed * tyres.rear_slip,
        );
        let delay = BOARD_DELAY + 0.5 * self.config.pulse_distance / speed;
        self.along_fit.add(
            SVector::from([motor, -turn, -motor_slope, across]),
            along + left * turn - motor - delay * motor_slope,
        );
    }
}

/// Steering and rear slip that the tyres take in a bend.
struct Tyres {
    /// Steering for each m/s² of lateral acceleration, rad s²/m.
    understeer: f64,
    /// Slip angle of the rear axle, rad.
    rear_slip: f64,
    /// Delay from the front wheels to the yaw rate, of linear tyres, s.
    delay: f64,
}

impl Tyres {
    /// At this speed (m/s), yaw rate (rad/s) and yaw acceleration (rad/s²).
    fn of(vehicle: &VehicleParameters, speed: f64, turn: f64, turn_slope: f64) -> Self {
        let [m, inertia, l_f, l_r, c_f, c_r] = vehicle.symbols();
        let wheelbase = vehicle.wheelbase_m();
        let lateral = speed * turn + l_r * turn_slope;
        let used = (fabs(speed * turn) / (vehicle.friction * GRAVITY)).min(MOST_GRIP);
        // By how much the slip of saturating tyres is larger than that of linear ones.
        let stiffness =
            c_f * c_r * wheelbase * wheelbase / speed + m * speed * (c_r * l_r - c_f * l_f);
        let damping = m * (c_f * l_f * l_f + c_r * l_r * l_r) + inertia * (c_f + c_r);
        let more = if used > 1e-3 { atanh(used) / used } else { 1.0 };
        Self {
            understeer: more * m / wheelbase * (l_r / c_f - l_f / c_r),
            rear_slip: more * (m * l_f * lateral - inertia * turn_slope) / (wheelbase * c_r),
            // An oversteering car has a speed beyond which this says nothing.
            delay: (damping / stiffness - m * speed * l_f / (c_r * wheelbase)).clamp(0.0, 0.1),
        }
    }
}

/// The delay of the poses: that against the gyro; and with the steering and the motor sensor, if
/// they agree with it.
fn stamps(
    gyro: Option<Fit<4>>,
    steering: Option<Fit<3>>,
    along: Option<Fit<4>>,
) -> CalibrationEstimate {
    let parameter = CalibrationParameter::StampOffset;
    let bounds = parameter.bounds();
    let alone = estimate(parameter, gyro, 1);
    let (Some(gyro), Some(steering), Some(along)) = (gyro, steering, along) else {
        return alone;
    };
    let excitations = [
        gyro.excitation[1],
        steering.excitation[2],
        along.excitation[2],
    ];
    let are_excited = excitations.iter().all(|it| *it >= bounds.least_excitation);
    if alone.half_width > WIDEST_ALONE || !are_excited {
        return alone;
    }
    let with_error = |half_width: f64| hypot(half_width, DELAY_ERROR);
    let delays = [
        [alone.value, alone.half_width],
        [steering.values[2], with_error(steering.half_widths[2])],
        [along.values[2], with_error(along.half_widths[2])],
    ];
    let (mut weights, mut sum) = (0.0, 0.0);
    for [value, half_width] in delays {
        let weight = 1.0 / (half_width * half_width);
        weights += weight;
        sum += weight * value;
    }
    let mean = sum / weights;
    // Half widths are two standard deviations.
    let disagreement: f64 = delays
        .iter()
        .map(|[value, half_width]| {
            4.0 * (value - mean) * (value - mean) / (half_width * half_width)
        })
        .sum();
    if disagreement > MOST_DISAGREEMENT {
        // It may be the gyro that is far off.
        let half_width = 1.5 * alone.half_width;
        return CalibrationEstimate {
            half_width,
            observable: alone.observable && half_width <= bounds.widest,
            ..alone
        };
    }
    let half_width = 1.0 / sqrt(weights);
    CalibrationEstimate {
        parameter,
        value: mean,
        half_width,
        observable: half_width <= bounds.widest,
    }
}

/// What a fit says of a parameter.
fn estimate<const N: usize>(
    parameter: CalibrationParameter,
    fit: Option<Fit<N>>,
    index: usize,
) -> CalibrationEstimate {
    let bounds = parameter.bounds();
    let Some(fit) = fit else {
        return CalibrationEstimate {
            parameter,
            value: 0.0,
            half_width: f64::INFINITY,
            observable: false,
        };
    };
    let half_width = hypot(fit.half_widths[index], bounds.systematic);
    CalibrationEstimate {
        parameter,
        value: fit.values[index],
        half_width,
        observable: half_width <= bounds.widest && fit.excitation[index] >= bounds.least_excitation,
    }
}
