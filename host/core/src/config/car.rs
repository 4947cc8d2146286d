//! `[vehicle]`, `[limits]` and `[actuators]`: what the car is believed to be, what it may do, and
//! how fast its steering and motor follow. `[estimator]` and `[online_calibration]`: how pose, IMU
//! and motor speed become a state, and what a drive says about the calibration.
//!
//! The types of the mathematics are read as they are; the sections declared here describe them.

use singletrack_control::{
    ActuatorModel, EstimatorConfig, Limits, MarkerLoss, SteeringMap, SteeringTable,
    VehicleParameters, words,
};
use singletrack_settings::{Declared as _, Maps as _, ValueError, section};

use super::{Config, ConfigError, ServoSection, refuse_if};

const PAPER: VehicleParameters = VehicleParameters::paper();

section! {
    /// The car: the 1:10 car of the paper unless given. The law needs both axles; tyres and mass bound
    /// the steering in fast bends and say how the car slips.
    "vehicle" => pub(super) VehicleKeys;
    [];

    /// Mass. The default, as those of inertia and tyres, is the paper's car's scaled to the wheelbase.
    mass_kg: Option<f64> = None, text "above 0", otherwise PAPER.mass_kg;
    /// Yaw moment of inertia about the centre of mass.
    yaw_inertia_kg_m2: Option<f64> = None, text "above 0", otherwise PAPER.yaw_inertia_kg_m2;
    /// Distance of the front axle from the centre of mass.
    front_axle_distance_m: f64, in up_to(2.0), example PAPER.front_axle_distance_m;
    /// Distance of the rear axle from the centre of mass.
    rear_axle_distance_m: f64, in up_to(2.0), example PAPER.rear_axle_distance_m;
    /// Friction coefficient between tyre and ground.
    friction: Option<f64> = None, text "above 0", otherwise PAPER.friction;
    /// Cornering stiffness of the front axle.
    front_cornering_stiffness_n_rad: Option<f64> = None, text "above 0",
        otherwise PAPER.front_cornering_stiffness_n_rad;
    /// Cornering stiffness of the rear axle.
    rear_cornering_stiffness_n_rad: Option<f64> = None, text "above 0",
        otherwise PAPER.rear_cornering_stiffness_n_rad;
}

/// A car with these axles, and the mass, inertia and tyres of the paper's car at this scale.
pub(crate) fn scaled_paper(
    front_axle_distance_m: f64,
    rear_axle_distance_m: f64,
) -> VehicleParameters {
    let scale = (front_axle_distance_m + rear_axle_distance_m) / PAPER.wheelbase_m();
    // A tyre's stiffness grows with its load.
    let [load, inertia] = [scale.powi(3), scale.powi(5)];
    VehicleParameters {
        mass_kg: PAPER.mass_kg * load,
        yaw_inertia_kg_m2: PAPER.yaw_inertia_kg_m2 * inertia,
        front_axle_distance_m,
        rear_axle_distance_m,
        friction: PAPER.friction,
        front_cornering_stiffness_n_rad: PAPER.front_cornering_stiffness_n_rad * load,
        rear_cornering_stiffness_n_rad: PAPER.rear_cornering_stiffness_n_rad * load,
    }
}

impl TryFrom<VehicleKeys> for VehicleParameters {
    type Error = ValueError;

    fn try_from(keys: VehicleKeys) -> Result<Self, ValueError> {
        keys.check().map_err(|error| ValueError {
            fix: format!("{}; the axles are in m", error.fix),
            ..error
        })?;
        let paper = scaled_paper(keys.front_axle_distance_m, keys.rear_axle_distance_m);
        Ok(Self {
            mass_kg: keys.mass_kg.unwrap_or(paper.mass_kg),
            yaw_inertia_kg_m2: keys.yaw_inertia_kg_m2.unwrap_or(paper.yaw_inertia_kg_m2),
            friction: keys.friction.unwrap_or(paper.friction),
            front_cornering_stiffness_n_rad: keys
                .front_cornering_stiffness_n_rad
                .unwrap_or(paper.front_cornering_stiffness_n_rad),
            rear_cornering_stiffness_n_rad: keys
                .rear_cornering_stiffness_n_rad
                .unwrap_or(paper.rear_cornering_stiffness_n_rad),
            ..paper
        })
    }
}

section! {
    /// What the car may do.
    "limits" => pub LimitsSection: Copy;
    [maps Limits = Limits::paper()];

    /// Top speed forward.
    max_speed_m_s: f64 => max_speed, in up_to(20.0);
    /// Top speed in reverse, in which the law is unstable; 0 disables reverse.
    max_reverse_speed_m_s: f64 => max_reverse_speed, in 0.0..=20.0;
    /// Largest rate of change of the speed.
    max_acceleration_m_s2: f64 => max_acceleration, in up_to(50.0);
    /// Largest lateral acceleration, that of a steady bend with the tyres of `[vehicle]`. At
    /// most friction times gravity; beyond that the tyres slide.
    max_lateral_acceleration_m_s2: f64 => max_lateral_acceleration, in up_to(50.0);
    // The law is singular before 90 degrees.
    /// Largest steering angle to either side.
    max_steering_rad: f64 => max_steering, in up_to(1.2);
    /// Largest steering rate.
    max_steering_rate_rad_s: f64 => max_steering_rate, in up_to(50.0);
    /// Speed at which the car turns round when P should move backward. It brakes instead
    /// where P is ahead of a reference that moves forward and comes within a second.
    creep_speed_m_s: f64 => creep_speed, in up_to(max_speed_m_s);
    /// A wanted velocity below this is standstill.
    standstill_speed_m_s: f64 => standstill_speed, in up_to(max_speed_m_s);
}

impl LimitsSection {
    /// For the controller of a car with this wheelbase, in m.
    pub fn limits(&self, wheelbase: f64) -> Limits {
        self.apply_to(Limits {
            wheelbase,
            ..Limits::paper()
        })
    }
}

section! {
    /// How steering and motor are believed to follow their commands: dead time, then a lag of
    /// first order. `singletrack calibrate` measures them, and `compensation.actuation` uses
    /// them. The defaults are those of the simulated car.
    "actuators" => pub ActuatorsSection;
    [default];

    /// Time constant of the front wheels' angle.
    steering_lag_ms: f64 = 40.0, in 0.0..=1_000.0;
    /// Time from a command to the first movement of the front wheels: line, board, half a
    /// servo frame, and the servo.
    steering_dead_time_ms: f64 = 18.0, in 0.0..=500.0;
    /// Time constant of the speed.
    speed_lag_ms: f64 = 80.0, in 0.0..=2_000.0;
    /// Time from a command to the first change of the speed.
    speed_dead_time_ms: f64 = 36.0, in 0.0..=500.0;
    /// Pairs of servo pulse, in us, and angle of the front wheels, in rad, in the order of the
    /// pulses, for steering that is no straight line: not symmetric, with a dead band (equal
    /// angles) or a stop. Its pulses lie within those of `board.servo`, whose `centre_us` must steer
    /// straight by it, to 0.02 rad. Left out, `board.servo` is the line.
    steering_table: Option<Vec<[f64; 2]>> = None, text "2 to 32 pairs",
        example vec![[1_080.0, 0.525], [1_500.0, 0.0], [1_920.0, -0.525]];
}

/// The largest angle that a command for the board can carry, rounded down.
const MOST_COMMANDED_RAD: f64 = 3.2;

/// The most that the wheels may point aside at the pulse that the board holds them straight with.
const MOST_AT_CENTRE_RAD: f64 = 0.02;

impl ActuatorsSection {
    /// In s.
    pub fn model(&self) -> ActuatorModel {
        ActuatorModel {
            steering_dead_time: 1e-3 * self.steering_dead_time_ms,
            steering_lag: 1e-3 * self.steering_lag_ms,
            speed_dead_time: 1e-3 * self.speed_dead_time_ms,
            speed_lag: 1e-3 * self.speed_lag_ms,
        }
    }

    /// The angle of the front wheels over the pulse of this servo.
    ///
    /// # Errors
    ///
    /// The pairs are no table, or not one of this servo.
    pub fn steering_map(&self, servo: &ServoSection) -> Result<SteeringMap, ConfigError> {
        const KEY: &str = "actuators.steering_table";
        let centre_us = f64::from(servo.centre_us);
        let gain_us_per_rad = f64::from(servo.gain_us_per_rad);
        let map = |table| SteeringMap {
            centre_us,
            gain_us_per_rad,
            table,
        };
        let Some(pairs) = &self.steering_table else {
            return Ok(map(None));
        };
        let refuse = |fix: String| ConfigError::value(KEY, format!("{pairs:?}"), fix);
        let table = SteeringTable::new(pairs).map_err(|error| refuse(error.to_string()))?;
        for &[pulse, _] in pairs {
            if !(f64::from(servo.min_us)..=f64::from(servo.max_us)).contains(&pulse) {
                return Err(refuse(format!(
                    "{pulse} us lies outside board.servo.min_us to max_us, {} to {}",
                    servo.min_us, servo.max_us
                )));
            }
            if ((pulse - centre_us) / gain_us_per_rad).abs() > MOST_COMMANDED_RAD {
                return Err(refuse(format!(
                    "a command can't carry {pulse} us with board.servo.gain_us_per_rad = {}; \
                     raise its magnitude",
                    servo.gain_us_per_rad
                )));
            }
        }
        if (table.pairs()[0][1] > 0.0) != (gain_us_per_rad < 0.0) {
            return Err(refuse(format!(
                "the wheels turn to the other side with board.servo.gain_us_per_rad = {}; give \
                 it the other sign, or the angles",
                servo.gain_us_per_rad
            )));
        }
        let at_centre = table.angle(centre_us);
        if at_centre.abs() > MOST_AT_CENTRE_RAD {
            return Err(refuse(format!(
                "at board.servo.centre_us, {centre_us}, the wheels point {at_centre:.3} rad \
                 aside, but must within {MOST_AT_CENTRE_RAD}; set it to {:.0}",
                table.pulse(0.0)
            )));
        }
        Ok(map(Some(table)))
    }
}

section! {
    /// How the state is estimated from pose, IMU and motor speed.
    "estimator" => pub EstimatorSection: Copy;
    // The lengths of the vehicle are not in this section.
    [maps EstimatorConfig = EstimatorConfig::for_vehicle(&VehicleParameters::paper())];

    /// Position and yaw while the markers are lost: "hold" keeps the last pose (as in the
    /// paper), "dead-reckon" predicts it from IMU and motor speed.
    marker_loss: MarkerLoss => marker_loss, words MarkerLoss;
    /// Standard deviation of a pose's coordinate.
    position_noise_m: f64 => position_noise, in up_to(0.1);
    /// Standard deviation of a pose's yaw.
    yaw_noise_rad: f64 => yaw_noise, in up_to(0.5);
    /// A pose farther from the prediction than this, beyond five deviations, is refused.
    position_gate_m: f64 => position_gate, in up_to(1.0);
    /// A pose whose yaw differs more than this from the prediction, beyond five deviations, is
    /// refused.
    yaw_gate_rad: f64 => yaw_gate, in up_to(3.0);
    /// Noise density of the gyro, before it is learned.
    gyro_noise_density_rad_s_per_sqrt_hz: f64 => gyro_noise_density, in up_to(1.0);
    /// Standard deviation of the gyro's scale from one, at the start; 0 takes it for exact.
    gyro_scale_noise: f64 => gyro_scale_noise, in 0.0..=0.1;
    /// Random walk of the gyro's bias.
    gyro_bias_walk_rad_s2_per_sqrt_hz: f64 => gyro_bias_walk, in up_to(1.0);
    /// Noise density of the accelerometer at rest.
    acceleration_noise_density_m_s2_per_sqrt_hz: f64 => acceleration_noise_density,
        in up_to(10.0);
    /// What the car's vibration adds to it, per m/s of its speed.
    vibration_noise_density_m_s2_per_sqrt_hz_per_m_s: f64 => vibration_noise_density, in 0.0..=10.0;
    /// Random walk of the accelerometer's bias.
    acceleration_bias_walk_m_s3_per_sqrt_hz: f64 => acceleration_bias_walk, in up_to(10.0);
    /// Standard deviation of the motor's speed at standstill.
    motor_speed_noise_m_s: f64 => motor_speed_noise, in up_to(1.0);
    /// Standard deviation of the motor's speed, as a fraction of it.
    motor_speed_scale_noise: f64 => motor_speed_scale_noise, in up_to(1.0);
    /// How far beyond a pose "hold" predicts, to cover the pose's latency.
    prediction_horizon_ms: f64 = 30.0, in 0.0..=100.0;
}

impl EstimatorSection {
    /// For the controller of this vehicle; where the markers are is in `[motion_capture]`.
    pub(super) fn config(
        &self,
        vehicle: &VehicleParameters,
        actuators: &ActuatorModel,
        marker_offset_m: [f64; 2],
        marker_yaw_rad: f64,
    ) -> EstimatorConfig {
        self.apply_to(EstimatorConfig {
            prediction_horizon: self.prediction_horizon_ms / 1_000.0,
            marker_offset: marker_offset_m,
            marker_yaw: marker_yaw_rad,
            steering_dead_time: actuators.steering_dead_time,
            steering_lag: actuators.steering_lag,
            ..EstimatorConfig::for_vehicle(vehicle)
        })
    }
}

words! {
    /// What becomes of the estimates.
    pub enum OnlineCalibrationMode: serde {
        /// Nothing is estimated.
        Off = "off",
        /// The estimates are shown.
        Advice = "advice",
        /// The controller corrects what it acts on by them, too.
        Live = "live",
    }
}

section! {
    /// Estimates how steering, cameras, IMU and motor sensor differ from their configuration, while
    /// the car drives. `docs/online-calibration.md` says what the estimates are worth.
    "online_calibration" => pub OnlineCalibrationSection: Copy;
    [default];

    /// "off"; "advice": status and log say what is off; or "live": the controller corrects what it
    /// acts on, within bounds, and begins every drive without a correction. "live" excludes the
    /// safety filter.
    mode: OnlineCalibrationMode = OnlineCalibrationMode::Off, text "\"off\", \"advice\" or \"live\"";
}

impl OnlineCalibrationSection {
    /// Refuses live calibration with the safety filter, which rests on the configured steering.
    pub(super) fn validate(self, config: &Config) -> Result<(), ConfigError> {
        let is_refused = self.mode == OnlineCalibrationMode::Live && config.safety_filter.enabled;
        let fix = "the safety filter rests on the configured steering; use \"advice\", or set \
                   safety_filter.enabled = false";
        refuse_if(is_refused, "online_calibration.mode", "\"live\"", fix)?;
        Ok(self.check()?)
    }

    /// Whether anything is estimated.
    pub fn is_enabled(self) -> bool {
        self.mode != OnlineCalibrationMode::Off
    }
}
