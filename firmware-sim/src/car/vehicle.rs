//! The car's dynamics.

use std::collections::VecDeque;

use libm::{cos, sincos, tan};
use singletrack_control::{RelaxedSingleTrack, SingleTrackDerivative, SingleTrackState};

use super::{
    CarParameters, CarState, MotorPulses, MotorSensorFault, StartPose, Truth,
    hands::{HandMotion, Hands},
    motor::{Battery, MotorAction, Push, SpeedController},
    motor_sensor::MotorSensor,
};
use crate::clock::Epoch;

/// Longest integration step, in µs.
///
/// The fastest mode of the relaxed model is near -1,900/s at 0.08 m/s, where RK4 is
/// stable up to 1.4 ms. Just more than the board's period of 1 ms by any of its clocks.
const MAX_STEP_US: u64 = 1_050;

/// The car: maps pulses to motion and sensor signals.
#[derive(Clone, Debug)]
pub struct Car {
    /// The parameters.
    pub parameters: CarParameters,
    model: RelaxedSingleTrack,
    now_us: u64,
    state: CarState,
    servo_target: f64,
    /// The pulse that the wheels stand for, in µs: differs from the last one by the play.
    servo_held_us: f64,
    servo_is_reversed: bool,
    /// Pulses within the dead time: when each is due, and its length, in µs.
    servo_pending: VecDeque<(u64, u16)>,
    esc: SpeedController,
    /// The ESC's switch, and the relay in its supply.
    esc_is_switched_on: bool,
    kill_output: bool,
    /// The zero of the times in the parameters.
    pub(crate) epoch: Epoch,
    /// Whether the parameters have timed events.
    has_events: bool,
    /// What has happened by the present time.
    happened: Happened,
    way: f64,
    esc_pending: VecDeque<(u64, u16)>,
    esc_last_pulse_us: u64,
    battery: Battery,
    sensor: MotorSensor,
    /// The fault of the motor's pulse sensor.
    pub sensor_fault: MotorSensorFault,
    hands: Hands,
}

/// The timed events of the parameters, at the present time.
#[derive(Clone, Copy, Debug, Default)]
struct Happened {
    servo_is_stuck: bool,
    /// Angle by which the horn has slipped, in rad.
    slip: f64,
    supply_dips: bool,
    esc_reboots: bool,
    /// The action at which the throttle is stuck.
    throttle: Option<MotorAction>,
    blown: bool,
    /// The speed at which the car is being moved, in m/s.
    moved_at: Option<f64>,
    /// Its acceleration, in m/s².
    moved_rate: f64,
}

impl Car {
    /// A car at rest at its start pose at simulation time zero, with straight
    /// wheels and an ESC that has just been powered.
    pub fn new(parameters: CarParameters) -> Self {
        let mut car = Self {
            model: parameters.model(),
            now_us: 0,
            state: CarState::default(),
            servo_target: 0.0,
            servo_held_us: parameters.servo.centre_us,
            servo_is_reversed: false,
            servo_pending: VecDeque::new(),
            esc: SpeedController::default(),
            esc_is_switched_on: true,
            kill_output: false,
            epoch: Epoch::default(),
            has_events: parameters.servo.stuck_from_s.is_some()
                || parameters.servo.slips_at_s.is_some()
                || parameters.battery.dip_at_s.is_some()
                || parameters.motor.reboot_at_s.is_some()
                || parameters.motor.stuck_from_s.is_some()
                || parameters.motor.push.is_some(),
            happened: Happened::default(),
            way: 0.0,
            esc_pending: VecDeque::new(),
            esc_last_pulse_us: 0,
            battery: Battery::default(),
            sensor: MotorSensor::default(),
            sensor_fault: MotorSensorFault::None,
            hands: Hands::default(),
            parameters,
        };
        car.battery
            .draw(&car.parameters.battery, false, 0.0, 0.0, 0.0);
        car.place(car.parameters.start);
        car
    }

    /// Places the car at rest with straight wheels. Pulses within the dead times
    /// still act.
    pub fn place(&mut self, pose: StartPose) {
        self.state = CarState {
            track: standing([pose.x_m, pose.y_m], pose.yaw_rad),
            ..CarState::default()
        };
        self.servo_target = 0.0;
        self.servo_held_us = self.parameters.servo.centre_us;
    }

    /// Stands at once: what it drives into does not give way.
    pub fn collide(&mut self) {
        let SingleTrackState { x, y, yaw, .. } = self.state.track;
        self.state.wheel_speed = 0.0;
        self.state.track = standing([x, y], yaw);
    }

    /// Begins what a person does with the car; a motion that is under way ends where it is.
    /// A car that moves is stopped.
    pub fn begin_by_hand(&mut self, motion: HandMotion) {
        let SingleTrackState { x, y, yaw, .. } = self.state.track;
        if !self.wheels_are_up() {
            self.state.wheel_speed = 0.0;
        }
        self.state.track = standing([x, y], yaw);
        self.hands.begin(motion, self.now_us, [x, y], yaw);
    }

    /// Whether a motion by hand is under way.
    pub const fn is_in_motion_by_hand(&self) -> bool {
        self.hands.is_busy()
    }

    /// Whether the wheels are off the floor.
    pub fn wheels_are_up(&self) -> bool {
        self.hands.wheels_are_up(self.now_us)
    }

    /// Whether the servo pushes against a mechanical stop: it buzzes.
    pub fn servo_strains(&self) -> bool {
        let servo = &self.parameters.servo;
        servo.free_angle(self.servo_held_us).abs() > servo.stop_rad + 0.01
    }

    /// Sets the seed of the sensors' random numbers.
    pub(crate) fn seed(&mut self, seed: u64) {
        self.sensor.seed(seed);
    }

    /// Connects the servo so that it turns the other way, or as configured; of no effect on
    /// one with a table.
    pub fn set_servo_reversed(&mut self, reversed: bool) {
        if reversed != self.servo_is_reversed {
            self.servo_is_reversed = reversed;
            self.parameters.servo.gain_us_per_rad *= -1.0;
        }
    }

    /// Switches the ESC's supply. Without it the motor is free; afterwards the ESC
    /// needs neutral for its arming time.
    pub fn set_esc_power(&mut self, on: bool) {
        self.esc_is_switched_on = on;
        self.cut_esc_without_power();
    }

    /// Unplugs the battery, or plugs it in. The board stays on its USB; the servo is limp.
    pub fn set_battery_plugged(&mut self, plugged: bool) {
        self.battery.is_unplugged = !plugged;
        self.cut_esc_without_power();
    }

    /// Sets the board's kill output: whether it holds the relay in the ESC's supply. Of no
    /// effect without a relay.
    pub fn set_kill_output(&mut self, held: bool) {
        self.kill_output = held;
        self.cut_esc_without_power();
    }

    /// Whether the ESC has power: switched on, not restarting, and its relay held, if it
    /// has one.
    pub const fn esc_has_power(&self) -> bool {
        self.esc_is_switched_on
            && !self.battery.is_unplugged
            && !self.happened.esc_reboots
            && (self.kill_output || !self.parameters.motor.kill_relay)
    }

    /// Whether the supply of servo and IMU has failed.
    pub const fn supply_dips(&self) -> bool {
        self.happened.supply_dips
    }

    fn cut_esc_without_power(&mut self) {
        if !self.esc_has_power() {
            self.esc = SpeedController::default();
            self.esc_pending.clear();
        }
    }

    /// What the ESC does to the motor.
    fn drive(&self) -> MotorAction {
        if self.esc_has_power() {
            self.happened.throttle.unwrap_or(self.esc.drive)
        } else {
            MotorAction::Free
        }
    }

    /// Whether the ESC drives the motor, in either direction.
    pub fn is_driven(&self) -> bool {
        matches!(self.drive(), MotorAction::Towards(settled) if settled != 0.0)
    }

    /// Applies the events of the parameters that have come.
    fn take_events(&mut self) {
        if !self.has_events && !self.hands.is_busy() && self.happened.moved_at.is_none() {
            return;
        }
        let p = &self.parameters;
        let (epoch, now_us) = (self.epoch, self.now_us);
        let was = self.happened;
        let slips = epoch.has_come(p.servo.slips_at_s, now_us);
        let throttle_is_stuck = epoch.has_come(p.motor.stuck_from_s, now_us);
        let moves = |push: &Push| epoch.is_within(Some(push.at_s), push.for_s * 1e3, now_us);
        let happened = Happened {
            servo_is_stuck: epoch.has_come(p.servo.stuck_from_s, now_us),
            slip: if slips { p.servo.slip_rad } else { 0.0 },
            supply_dips: epoch.is_within(p.battery.dip_at_s, p.battery.dip_ms, now_us),
            esc_reboots: epoch.is_within(p.motor.reboot_at_s, p.motor.reboot_ms, now_us),
            throttle: throttle_is_stuck.then(|| was.throttle.unwrap_or(self.esc.drive)),
            blown: was.blown,
            moved_at: p.motor.push.filter(moves).map(|push| push.speed_m_s),
            moved_rate: 0.0,
        };
        let rolled = self.hands.roll(now_us);
        let place = self.hands.end(now_us);
        self.happened = happened;
        if happened.supply_dips != was.supply_dips {
            self.battery.dips = happened.supply_dips;
            self.servo_pending.clear();
        }
        if happened.esc_reboots && !was.esc_reboots {
            self.cut_esc_without_power();
        }
        if let Some(push) = self.parameters.motor.push
            && push.for_s <= 0.0
            && !was.blown
            && epoch.has_come(Some(push.at_s), now_us)
        {
            self.happened.blown = true;
            self.state.wheel_speed += push.speed_m_s;
        }
        if let Some([speed, rate]) = rolled {
            self.happened.moved_at = Some(speed);
            self.happened.moved_rate = rate;
        }
        if let Some(speed) = self.happened.moved_at {
            self.state.wheel_speed = speed;
        }
        if let Some(place) = place {
            self.state.track = standing(place.position, place.yaw);
        }
    }

    /// Draws charge from the battery, in Ah; a negative charge restores it.
    pub fn drain_battery(&mut self, charge_ah: f64) {
        self.battery.drawn_ah += charge_ah;
    }

    /// Applies one servo frame: both pulses start at the car's present time. Zero
    /// means no pulse.
    pub fn apply_pulses(&mut self, mut servo_us: u16, mut esc_us: u16) {
        if self.parameters.swapped_wires {
            core::mem::swap(&mut servo_us, &mut esc_us);
        }
        if servo_us != 0 && !self.happened.supply_dips && !self.battery.is_unplugged {
            let due_us = self.now_us + self.parameters.servo.dead_time_us;
            self.servo_pending.push_back((due_us, servo_us));
        }
        if esc_us != 0 && self.esc_has_power() {
            let due_us = self.now_us + self.parameters.motor.dead_time_us;
            self.esc_pending.push_back((due_us, esc_us));
        }
    }

    /// Lets the pulses from the next servo frame on act later by `delay_us` than before.
    pub const fn delay_pulses(&mut self, delay_us: u64) {
        let CarParameters { servo, motor, .. } = &mut self.parameters;
        servo.dead_time_us = servo.dead_time_us.saturating_add(delay_us);
        motor.dead_time_us = motor.dead_time_us.saturating_add(delay_us);
    }

    /// The motor pulses so far.
    pub fn motor_pulses(&self) -> MotorPulses {
        self.sensor.pulses
    }

    /// Whether the ESC has been at neutral long enough to drive.
    pub const fn esc_is_armed(&self) -> bool {
        self.esc.armed
    }

    /// Advances to `until_us`; an earlier time has no effect.
    pub fn advance_to(&mut self, until_us: u64) {
        while self.now_us < until_us {
            self.take_events();
            self.take_pulses();
            let mut end = until_us.min(self.now_us + MAX_STEP_US);
            for pending in [&self.servo_pending, &self.esc_pending] {
                // A step ends when an actuator's input changes.
                end = pending.front().map_or(end, |(due_us, _)| end.min(*due_us));
            }
            self.step(end);
        }
        self.take_events();
        self.take_pulses();
    }

    /// Voltage at the battery's terminals, in V.
    pub(crate) fn battery_v(&self) -> f64 {
        self.battery.voltage(&self.parameters.battery)
    }

    /// The present ground truth.
    pub fn truth(&self) -> Truth {
        let (track, wheel_speed) = (self.state.track, self.state.wheel_speed);
        let d = self.derivative(&self.state, self.inputs());
        let (sin_sideslip, cos_sideslip) = sincos(track.sideslip);
        let speed = course_speed(wheel_speed, track.sideslip);
        let speed_rate =
            d.wheel_speed / cos_sideslip + speed * tan(track.sideslip) * d.track.sideslip;
        let turning = speed * (d.track.sideslip + track.yaw_rate);
        let (roll, pitch) = self.tilt(track.yaw);
        let free = Truth {
            time_us: self.now_us,
            x: track.x,
            y: track.y,
            yaw: track.yaw,
            yaw_rate: track.yaw_rate,
            sideslip: track.sideslip,
            steering: self.state.steering,
            speed,
            wheel_speed,
            longitudinal_acceleration: speed_rate * cos_sideslip - turning * sin_sideslip,
            lateral_acceleration: speed_rate * sin_sideslip + turning * cos_sideslip,
            battery_v: self.battery_v(),
            way: self.way,
            roll,
            pitch,
            held: self.hands.holds(),
            height: self.hands.stand,
            ..Truth::default()
        };
        self.truth_in_hands(free)
    }

    /// What differs of a car that is held.
    fn truth_in_hands(&self, free: Truth) -> Truth {
        if !free.held || self.hands.roll(self.now_us).is_some() {
            return free;
        }
        let Some(motion) = self.hands.motion(self.now_us) else {
            return Truth {
                speed: 0.0,
                longitudinal_acceleration: 0.0,
                lateral_acceleration: 0.0,
                ..free
            };
        };
        let [forward, left] = motion.velocity;
        let [x, y] = motion.place.position;
        let [yaw_rate, roll_rate, pitch_rate] = motion.rates;
        Truth {
            x,
            y,
            yaw: motion.place.yaw,
            yaw_rate,
            sideslip: 0.0,
            speed: libm::hypot(forward, left),
            longitudinal_acceleration: motion.acceleration[0],
            lateral_acceleration: motion.acceleration[1],
            roll: motion.place.roll,
            pitch: motion.place.pitch,
            height: motion.place.height,
            roll_rate,
            pitch_rate,
            ..free
        }
    }

    /// Roll and pitch on the slope, in rad.
    fn tilt(&self, yaw: f64) -> (f64, f64) {
        let slope = self.parameters.motor.slope_deg.to_radians();
        let across = yaw - self.parameters.motor.slope_heading_deg.to_radians();
        let (sine, cosine) = sincos(across);
        (-slope * sine, -slope * cosine)
    }

    fn take_pulses(&mut self) {
        let (now_us, speed) = (self.now_us, self.state.wheel_speed);
        let CarParameters { servo, motor, .. } = &self.parameters;
        let is_due = |(due_us, _): &mut (u64, u16)| *due_us <= now_us;
        while let Some((_, pulse_us)) = self.servo_pending.pop_front_if(is_due) {
            self.servo_target = servo.target_with_backlash(&mut self.servo_held_us, pulse_us);
        }
        while let Some((_, pulse_us)) = self.esc_pending.pop_front_if(is_due) {
            self.esc_last_pulse_us = now_us;
            self.esc.pulse(motor, pulse_us, now_us, speed);
        }
        if now_us - self.esc_last_pulse_us > motor.signal_loss_us {
            self.esc.release();
        }
    }

    fn step(&mut self, end_us: u64) {
        let start_us = self.now_us;
        let h = (end_us - start_us) as f64 * 1e-6;
        let s = self.state;
        let inputs = self.inputs();
        let k1 = self.derivative(&s, inputs);
        let k2 = self.derivative(&s.plus(&k1, h / 2.0), inputs);
        let k3 = self.derivative(&s.plus(&k2, h / 2.0), inputs);
        let k4 = self.derivative(&s.plus(&k3, h), inputs);
        let mut next = s
            .plus(&k1, h / 6.0)
            .plus(&k2, h / 3.0)
            .plus(&k3, h / 3.0)
            .plus(&k4, h / 6.0);
        let stop = self.parameters.servo.stop_rad;
        next.steering = next.steering.clamp(-stop, stop);
        // Rolling friction stops the car; it can't accelerate it.
        let driven = self.is_driven();
        let motor = &self.parameters.motor;
        let downhill = motor.downhill(next.track.yaw);
        let stops = next.wheel_speed.abs() < 1e-4 || next.wheel_speed * s.wheel_speed < 0.0;
        // On a slope friction would only creep to a halt: it acts fully from 5 mm/s on.
        let is_held = downhill != 0.0 && next.wheel_speed.abs() < 0.005;
        if !driven
            && self.happened.moved_at.is_none()
            && (stops || is_held)
            && motor.holds(self.drive(), downhill)
        {
            next.wheel_speed = 0.0;
        }
        let battery = &self.parameters.battery;
        self.battery
            .draw(battery, driven, s.wheel_speed, k1.wheel_speed, h);
        if let Some(moved) = self.hands.motion(end_us) {
            next.track = standing(moved.place.position, moved.place.yaw);
            if !self.hands.wheels_are_up(end_us) {
                // The rear wheels roll as far as their axle moves along the car.
                next.wheel_speed = moved.velocity[0];
            }
        }
        let rolled = (s.wheel_speed + next.wheel_speed) / 2.0 * h;
        if !self.hands.holds() {
            self.way += (rolled / cos(next.track.sideslip).max(0.5)).abs();
        }
        let grip = motor.grip(driven, self.epoch, start_us);
        let sensor = &self.parameters.motor_sensor;
        self.sensor
            .roll(sensor, self.sensor_fault, rolled / grip, start_us, end_us);
        self.sensor.interfere(sensor, driven, start_us, end_us);
        self.state = next;
        self.now_us = end_us;
    }

    /// What acts on the motor throughout a step: the ESC, and the battery's voltage over the
    /// nominal one.
    fn inputs(&self) -> (MotorAction, f64) {
        let voltage_share = self.battery_v() / self.parameters.battery.nominal_v;
        (self.drive(), voltage_share)
    }

    fn derivative(&self, s: &CarState, inputs: (MotorAction, f64)) -> CarState {
        let d = if self.hands.holds() && self.happened.moved_at.is_none() {
            SingleTrackDerivative::default()
        } else {
            let speed = course_speed(s.wheel_speed, s.track.sideslip);
            self.model.derivative(&s.track, speed, s.steering)
        };
        let stands = self.happened.servo_is_stuck || self.happened.supply_dips;
        let target = self.servo_target + self.happened.slip;
        let rate = self.parameters.servo.rate(s.steering, target);
        CarState {
            track: SingleTrackState {
                x: d.x,
                y: d.y,
                yaw: d.yaw,
                yaw_rate: d.yaw_rate,
                sideslip: d.sideslip,
            },
            steering: if stands { 0.0 } else { rate },
            wheel_speed: self.wheel_acceleration(s, inputs),
        }
    }

    /// Acceleration of the wheels, in m/s².
    fn wheel_acceleration(&self, s: &CarState, (drive, voltage_share): (MotorAction, f64)) -> f64 {
        if self.happened.moved_at.is_some() {
            return self.happened.moved_rate;
        }
        let motor = &self.parameters.motor;
        if self.hands.holds() && !self.wheels_are_up() {
            return 0.0;
        }
        if self.hands.holds() {
            let motor = motor.wheels_up();
            return motor.acceleration(drive, s.wheel_speed, voltage_share);
        }
        let acceleration = motor.acceleration(drive, s.wheel_speed, voltage_share);
        let downhill = motor.downhill(s.track.yaw);
        if downhill == 0.0 {
            acceleration
        } else if s.wheel_speed == 0.0 && motor.holds(drive, downhill) {
            0.0
        } else {
            acceleration + downhill
        }
    }
}

/// The car stands here, or is held.
fn standing([x, y]: [f64; 2], yaw: f64) -> SingleTrackState {
    SingleTrackState {
        x,
        y,
        yaw,
        ..SingleTrackState::default()
    }
}

/// Speed of G along its course when the wheels roll along the car.
fn course_speed(wheel_speed: f64, sideslip: f64) -> f64 {
    // A large sideslip does not increase the speed.
    wheel_speed / cos(sideslip).max(0.5)
}
