//! The car's dynamics.

use std::collections::VecDeque;

use libm::{cos, sin, tan};
use serde::{Deserialize, Serialize};
use singletrack_control::{RelaxedSingleTrack, SingleTrackState, VehicleParameters};

use super::{
    BatteryParameters, ImuParameters, MotorParameters, MotorPulses, MotorSensorFault,
    MotorSensorParameters, ServoParameters,
    battery::Battery,
    motor::{Drive, SpeedController},
    motor_sensor::MotorSensor,
};

/// Parameters of the car.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CarParameters {
    /// Masses, lengths, tyres.
    pub vehicle: VehicleParameters,
    /// The steering servo.
    pub servo: ServoParameters,
    /// ESC, motor and gears.
    pub motor: MotorParameters,
    /// The motor's pulse sensor.
    pub motor_sensor: MotorSensorParameters,
    /// The inertial measurement unit.
    pub imu: ImuParameters,
    /// The battery.
    pub battery: BatteryParameters,
    /// Initial pose of the car.
    pub start: StartPose,
}

/// Initial pose of the car.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct StartPose {
    /// Position of the centre of mass along x, in m.
    pub x_m: f64,
    /// Position of the centre of mass along y, in m.
    pub y_m: f64,
    /// Yaw, in rad.
    pub yaw_rad: f64,
}

/// Ground truth at one time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Truth {
    /// Simulation time, in µs.
    pub time_us: u64,
    /// Position of the centre of mass G along x, in m.
    pub x: f64,
    /// Position of the centre of mass G along y, in m.
    pub y: f64,
    /// Yaw, in rad, not wrapped.
    pub yaw: f64,
    /// Yaw rate, in rad/s.
    pub yaw_rate: f64,
    /// Sideslip: the angle from the car's axis to the velocity of G, in rad.
    pub sideslip: f64,
    /// Steering angle of the front wheels, left positive, in rad.
    pub steering: f64,
    /// Speed of G along its course, reverse negative, in m/s.
    pub speed: f64,
    /// Speed of the rear wheels along the car, in m/s.
    pub wheel_speed: f64,
    /// Acceleration of G along the car, in m/s².
    pub longitudinal_acceleration: f64,
    /// Acceleration of G to the car's left, in m/s².
    pub lateral_acceleration: f64,
    /// Voltage at the battery's terminals, in V.
    pub battery_v: f64,
}

impl Truth {
    /// The point P, `point_distance_m` beyond the front axle in the direction
    /// of the front wheels, when the front axle is `front_axle_distance_m`
    /// ahead of G: x and y in m.
    #[must_use]
    pub fn point_p(&self, front_axle_distance_m: f64, point_distance_m: f64) -> [f64; 2] {
        let course = self.yaw + self.steering;
        [
            self.x + front_axle_distance_m * cos(self.yaw) + point_distance_m * cos(course),
            self.y + front_axle_distance_m * sin(self.yaw) + point_distance_m * sin(course),
        ]
    }
}

/// The integrated state.
#[derive(Clone, Copy, Debug, Default)]
struct State {
    track: SingleTrackState,
    steering: f64,
    wheel_speed: f64,
}

impl State {
    fn plus(&self, d: &Self, h: f64) -> Self {
        let (a, b) = (&self.track, &d.track);
        Self {
            track: SingleTrackState {
                x: a.x + h * b.x,
                y: a.y + h * b.y,
                yaw: a.yaw + h * b.yaw,
                yaw_rate: a.yaw_rate + h * b.yaw_rate,
                sideslip: a.sideslip + h * b.sideslip,
            },
            steering: self.steering + h * d.steering,
            wheel_speed: self.wheel_speed + h * d.wheel_speed,
        }
    }
}

/// A pulse within an actuator's dead time.
#[derive(Clone, Copy, Debug)]
struct Pending {
    due_us: u64,
    pulse_us: u16,
}

/// Longest integration step, in µs.
///
/// The fastest mode of the relaxed model is near -1,900/s at 0.08 m/s, where RK4 is
/// stable up to 1.4 ms.
const MAX_STEP_US: u64 = 1_000;

/// The car: maps pulses to motion and sensor signals.
#[derive(Clone, Debug)]
pub struct Car {
    parameters: CarParameters,
    model: RelaxedSingleTrack,
    now_us: u64,
    state: State,
    servo_target: f64,
    servo_pending: VecDeque<Pending>,
    esc: SpeedController,
    esc_is_powered: bool,
    esc_pending: VecDeque<Pending>,
    esc_last_pulse_us: u64,
    battery: Battery,
    sensor: MotorSensor,
    sensor_fault: MotorSensorFault,
}

impl Car {
    /// A car at rest at its start pose at simulation time zero, with straight
    /// wheels and an ESC that has just been powered.
    #[must_use]
    pub fn new(parameters: CarParameters) -> Self {
        let mut car = Self {
            model: RelaxedSingleTrack::new(parameters.vehicle),
            now_us: 0,
            state: State::default(),
            servo_target: 0.0,
            servo_pending: VecDeque::new(),
            esc: SpeedController::new(),
            esc_is_powered: true,
            esc_pending: VecDeque::new(),
            esc_last_pulse_us: 0,
            battery: Battery::default(),
            sensor: MotorSensor::default(),
            sensor_fault: MotorSensorFault::None,
            parameters,
        };
        car.battery.draw(&parameters.battery, false, 0.0, 0.0, 0.0);
        car.place(parameters.start);
        car
    }

    /// The parameters.
    #[must_use]
    pub const fn parameters(&self) -> &CarParameters {
        &self.parameters
    }

    /// Places the car at rest with straight wheels. Pulses within the dead times
    /// still act.
    pub fn place(&mut self, pose: StartPose) {
        self.state = State {
            track: SingleTrackState {
                x: pose.x_m,
                y: pose.y_m,
                yaw: pose.yaw_rad,
                ..SingleTrackState::default()
            },
            ..State::default()
        };
        self.servo_target = 0.0;
    }

    /// Sets the fault of the motor's pulse sensor.
    pub fn set_motor_sensor_fault(&mut self, fault: MotorSensorFault) {
        self.sensor_fault = fault;
    }

    /// Switches the ESC's supply. Without it the motor is free; afterwards the ESC
    /// needs neutral for its arming time.
    pub fn set_esc_power(&mut self, on: bool) {
        self.esc_is_powered = on;
        if !on {
            self.esc = SpeedController::new();
            self.esc_pending.clear();
        }
    }

    /// Draws charge from the battery, in Ah; a negative charge restores it.
    pub fn drain_battery(&mut self, charge_ah: f64) {
        self.battery.drain(charge_ah);
    }

    /// Applies one servo frame: both pulses start at the car's present time. Zero
    /// means no pulse.
    pub fn apply_pulses(&mut self, servo_us: u16, esc_us: u16) {
        if servo_us != 0 {
            self.servo_pending.push_back(Pending {
                due_us: self.now_us + self.parameters.servo.dead_time_us,
                pulse_us: servo_us,
            });
        }
        if esc_us != 0 && self.esc_is_powered {
            self.esc_pending.push_back(Pending {
                due_us: self.now_us + self.parameters.motor.dead_time_us,
                pulse_us: esc_us,
            });
        }
    }

    /// The motor pulses so far.
    #[must_use]
    pub fn motor_pulses(&self) -> MotorPulses {
        self.sensor.pulses()
    }

    /// Whether the ESC has been at neutral long enough to drive.
    #[must_use]
    pub const fn esc_is_armed(&self) -> bool {
        self.esc.is_armed()
    }

    /// Advances to `until_us`; an earlier time has no effect.
    pub fn advance_to(&mut self, until_us: u64) {
        while self.now_us < until_us {
            self.take_pulses();
            let mut end = until_us.min(self.now_us + MAX_STEP_US);
            for pending in [self.servo_pending.front(), self.esc_pending.front()]
                .into_iter()
                .flatten()
            {
                // A step ends when an actuator's input changes.
                end = end.min(pending.due_us);
            }
            self.step(end);
        }
        self.take_pulses();
    }

    /// The present ground truth.
    #[must_use]
    pub fn truth(&self) -> Truth {
        let State {
            track,
            steering,
            wheel_speed,
        } = self.state;
        let d = self.derivative(&self.state);
        let cos_sideslip = cos(track.sideslip);
        let speed = course_speed(wheel_speed, track.sideslip);
        let speed_rate =
            d.wheel_speed / cos_sideslip + speed * tan(track.sideslip) * d.track.sideslip;
        let turning = speed * (d.track.sideslip + track.yaw_rate);
        let sin_sideslip = sin(track.sideslip);
        Truth {
            time_us: self.now_us,
            x: track.x,
            y: track.y,
            yaw: track.yaw,
            yaw_rate: track.yaw_rate,
            sideslip: track.sideslip,
            steering,
            speed,
            wheel_speed,
            longitudinal_acceleration: speed_rate * cos_sideslip - turning * sin_sideslip,
            lateral_acceleration: speed_rate * sin_sideslip + turning * cos_sideslip,
            battery_v: self.battery.voltage(&self.parameters.battery),
        }
    }

    fn take_pulses(&mut self) {
        while let Some(pending) = due(&mut self.servo_pending, self.now_us) {
            self.servo_target = self.parameters.servo.target(pending.pulse_us);
        }
        while let Some(pending) = due(&mut self.esc_pending, self.now_us) {
            self.esc_last_pulse_us = self.now_us;
            self.esc.pulse(
                &self.parameters.motor,
                pending.pulse_us,
                self.now_us,
                self.state.wheel_speed,
            );
        }
        if self.now_us - self.esc_last_pulse_us > self.parameters.motor.signal_loss_us {
            self.esc.release();
        }
    }

    fn step(&mut self, end_us: u64) {
        let start_us = self.now_us;
        let h = (end_us - start_us) as f64 * 1e-6;
        let s = self.state;
        let k1 = self.derivative(&s);
        let k2 = self.derivative(&s.plus(&k1, h / 2.0));
        let k3 = self.derivative(&s.plus(&k2, h / 2.0));
        let k4 = self.derivative(&s.plus(&k3, h));
        let mut next = s
            .plus(&k1, h / 6.0)
            .plus(&k2, h / 3.0)
            .plus(&k3, h / 3.0)
            .plus(&k4, h / 6.0);
        let stop = self.parameters.servo.stop_rad;
        next.steering = next.steering.clamp(-stop, stop);
        // Rolling friction stops the car; it cannot accelerate it.
        let driven = matches!(self.esc.drive(), Drive::Towards(settled) if settled != 0.0);
        if !driven && (next.wheel_speed.abs() < 1e-4 || next.wheel_speed * s.wheel_speed < 0.0) {
            next.wheel_speed = 0.0;
        }
        self.battery.draw(
            &self.parameters.battery,
            driven,
            s.wheel_speed,
            k1.wheel_speed,
            h,
        );
        self.sensor.roll(
            &self.parameters.motor_sensor,
            self.sensor_fault,
            (s.wheel_speed + next.wheel_speed) / 2.0 * h,
            start_us,
            end_us,
        );
        self.state = next;
        self.now_us = end_us;
    }

    fn derivative(&self, s: &State) -> State {
        let p = &self.parameters;
        let speed = course_speed(s.wheel_speed, s.track.sideslip);
        let d = self.model.derivative(&s.track, speed, s.steering);
        let voltage_share = self.battery.voltage(&p.battery) / p.battery.nominal_v;
        State {
            track: SingleTrackState {
                x: d.x,
                y: d.y,
                yaw: d.yaw,
                yaw_rate: d.yaw_rate,
                sideslip: d.sideslip,
            },
            steering: p.servo.rate(s.steering, self.servo_target),
            wheel_speed: p
                .motor
                .acceleration(self.esc.drive(), s.wheel_speed, voltage_share),
        }
    }
}

/// Speed of G along its course when the wheels roll along the car.
fn course_speed(wheel_speed: f64, sideslip: f64) -> f64 {
    // A large sideslip does not increase the speed.
    wheel_speed / cos(sideslip).max(0.5)
}

fn due(queue: &mut VecDeque<Pending>, now_us: u64) -> Option<Pending> {
    (queue.front()?.due_us <= now_us).then(|| queue.pop_front())?
}
