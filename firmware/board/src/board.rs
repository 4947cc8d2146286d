//! The board: its parts, and the order of their work in a poll.

use singletrack_protocol::{
    Acknowledgement, BoardMode, Configuration, Configure, FailsafeAction, JOG_DRIVE_US,
    JOG_SPEED_MM_S, LONGEST_ROLL_OUT_MS, Refusal, RefusalReason, Request, ResetCause,
    STATUS_PERIOD_US, Sequence, Status, StopCause, TELEMETRY_PERIOD_US, Telemetry, ToBoard,
};

use crate::{
    Inputs, Outputs,
    clock::{Stopwatch, Ticker, age_us},
    esc::{BRAKE_ABOVE_MM_S, Esc, Motion, NEUTRAL_AT_BOOT_US},
    link::{Imu, Link},
    odometer::{Driven, Odometer},
    roll_out::RollOut,
    safety::{Action, ArmingConditions, Safety},
    steering::Steering,
};

/// The speed loop runs in step with telemetry, just before it, so that a record
/// contains the loop's latest output.
const CONTROL_PERIOD_US: u32 = TELEMETRY_PERIOD_US;

/// The board: maps time, inputs and received bytes to outputs.
#[derive(Clone, Debug)]
pub struct Board {
    last_poll_us: Option<u32>,
    active: Option<Active>,
    link: Link,
    safety: Safety,
    odometer: Odometer,
    roll_out: RollOut,
    imu: Imu,
    steering: Steering,
    esc: Esc,
    /// Time for which the motor has been jogged without a rest.
    jogged: Stopwatch,
    control: Ticker<CONTROL_PERIOD_US>,
    status: Ticker<STATUS_PERIOD_US>,
    reset_cause: ResetCause,
    drives_refused: u16,
    last_refusal: RefusalReason,
}

/// The configuration in force.
#[derive(Clone, Debug)]
struct Active {
    configuration: Configuration,
    hash: u32,
}

impl Board {
    /// A board that has just started, built into the car `car_id`.
    pub const fn new(reset_cause: ResetCause, software_version: [u8; 3], car_id: u16) -> Self {
        Self {
            last_poll_us: None,
            active: None,
            link: Link::new(software_version, car_id),
            safety: Safety::new(),
            odometer: Odometer::new(),
            roll_out: RollOut::new(LONGEST_ROLL_OUT_MS),
            imu: Imu::new(),
            steering: Steering::new(),
            esc: Esc::new(),
            jogged: Stopwatch::started(),
            control: Ticker::new(),
            status: Ticker::new(),
            reset_cause,
            drives_refused: 0,
            last_refusal: RefusalReason::None,
        }
    }

    /// Sets the cause of the reset, for a board constructed before it was known.
    pub const fn set_reset_cause(&mut self, reset_cause: ResetCause) {
        self.reset_cause = reset_cause;
    }

    /// Runs the firmware once.
    ///
    /// Call it at least every 10 ms, and when a frame has ended or the stop switch
    /// has changed; later calls delay the same actions. `now_us` is the board's
    /// clock, which never runs backwards but wraps. `received` holds the bytes
    /// since the last poll. `transmit` accepts one whole frame (or, after a start,
    /// a zero before the first) or none of it, and returns which; it may be called
    /// several times in a poll. The outputs are valid until the next poll.
    ///
    /// Before the first poll the pins must follow [`Board::outputs`].
    pub fn poll(
        &mut self,
        now_us: u32,
        inputs: &Inputs,
        received: &[u8],
        transmit: &mut impl FnMut(&[u8]) -> bool,
    ) -> Outputs {
        // A clock that runs backwards counts as standing still.
        let elapsed_us = self
            .last_poll_us
            .and_then(|last_us| age_us(now_us, last_us))
            .unwrap_or(0);
        self.last_poll_us = Some(now_us);

        self.link.greet(transmit);
        self.observe(now_us, elapsed_us, inputs);
        for &byte in received {
            if let Some(message) = self.link.receive(byte) {
                self.handle(now_us, inputs, &message, transmit);
            }
        }
        let control_due = self.control.advance(elapsed_us);
        self.actuate(elapsed_us, control_due);
        self.link.greet(transmit);
        self.report(now_us, elapsed_us, inputs, control_due, transmit);
        self.outputs()
    }

    /// The present outputs for the pins.
    pub fn outputs(&self) -> Outputs {
        Outputs {
            servo_us: self.steering.pulse_us(),
            esc_us: self.esc_us(),
            esc_neutral_us: self.neutral_us(),
            drive_deadline_us: self.safety.drive_deadline_us(),
            power_on: self.power_on(),
        }
    }

    /// State of the safety state machine.
    pub const fn mode(&self) -> BoardMode {
        self.safety.mode()
    }

    /// Cause of the last stop.
    pub const fn stop_cause(&self) -> StopCause {
        self.safety.cause()
    }

    /// Sequence number of the last accepted [`singletrack_protocol::Drive`]; zero
    /// before the first.
    pub const fn last_sequence(&self) -> Sequence {
        self.safety.last_sequence()
    }

    /// The configuration in force.
    pub fn configuration(&self) -> Option<&Configuration> {
        self.active.as_ref().map(|active| &active.configuration)
    }

    /// Speed measured from the motor pulses, in mm/s, signed by the direction
    /// driven; zero without a configuration.
    pub fn motor_speed_mm_s(&self) -> i16 {
        let magnitude = self.odometer.speed_mm_s();
        if self.esc.is_reverse() {
            -magnitude
        } else {
            magnitude
        }
    }

    fn hash(&self) -> u32 {
        self.active.as_ref().map_or(0, |active| active.hash)
    }

    fn esc_us(&self) -> Option<u16> {
        if self.safety.is_silent() {
            return None;
        }
        Some(match self.configuration() {
            Some(configuration) if !self.safety.is_latched() => {
                self.esc.pulse_us(&configuration.esc)
            }
            _ => NEUTRAL_AT_BOOT_US,
        })
    }

    fn neutral_us(&self) -> u16 {
        match self.configuration() {
            Some(configuration) if !self.safety.is_latched() => configuration.esc.neutral_us,
            _ => NEUTRAL_AT_BOOT_US,
        }
    }

    /// Whether the kill output holds the ESC's supply.
    fn power_on(&self) -> bool {
        self.safety.is_armed() && self.has_kill_output()
    }

    fn motion(&self) -> Motion {
        Motion {
            moving: self.odometer.is_moving(),
            speed_mm_s: self.odometer.speed_mm_s(),
            rolls: self.odometer.rolls(),
        }
    }

    /// Processes time and inputs, before any received byte.
    fn observe(&mut self, now_us: u32, elapsed_us: u32, inputs: &Inputs) {
        let driven = self
            .configuration()
            .is_some_and(|configuration| self.esc.is_driving(&configuration.esc));
        // Jogging has no speed: a pulse must come within a time alone.
        let (target_mm_s, commanded) = match self.safety.command().map(|command| command.action) {
            Some(Action::Drive { speed_mm_s, .. }) => (speed_mm_s.unsigned_abs(), speed_mm_s != 0),
            // The deadband may be narrower than configured: jogging is to find it.
            Some(Action::Jog { .. }) => (0, !self.esc.is_neutral()),
            None => (0, false),
        };
        let esc = Driven {
            driven,
            target_mm_s,
        };
        self.odometer.observe(now_us, elapsed_us, inputs.motor, esc);
        self.roll_out
            .observe(elapsed_us, driven || commanded, &self.odometer);
        self.imu.observe(now_us, elapsed_us, inputs.imu.as_ref());

        let was_driving = self.is_driving();
        self.safety.advance(now_us, elapsed_us);
        if self.odometer.has_failed() {
            self.safety.fail(StopCause::MotorSensor);
        }
        self.watch_jogging(elapsed_us);
        if self.roll_out.lasts_too_long(self.odometer.count()) || self.roll_out.keeps_its_speed() {
            self.safety.latch(StopCause::RunsAtNeutral);
        }
        if self.has_stop_input() {
            self.safety.observe_stop_input(inputs.stop_input_open);
        }
        self.stop_if(was_driving);
    }

    /// Ends jogging that is too fast or lasts too long.
    fn watch_jogging(&mut self, elapsed_us: u32) {
        self.jogged.advance(elapsed_us);
        let rests = self.esc.is_neutral() && self.odometer.is_at_rest();
        if rests || self.safety.mode() != BoardMode::Jogging {
            self.jogged = Stopwatch::started();
        } else if self.odometer.speed_mm_s() > JOG_SPEED_MM_S {
            self.safety.fail(StopCause::JogTooFast);
        } else if self.jogged.elapsed_us() >= JOG_DRIVE_US {
            self.safety.fail(StopCause::JogTooLong);
        }
    }

    #[inline(never)]
    fn handle(
        &mut self,
        now_us: u32,
        inputs: &Inputs,
        message: &ToBoard,
        transmit: &mut impl FnMut(&[u8]) -> bool,
    ) {
        let was_driving = self.is_driving();
        match message {
            ToBoard::Hello(hello) => {
                if self.link.greeted(hello) {
                    self.safety.host_restarted();
                    self.stop_if(was_driving);
                }
            }
            ToBoard::Configure(configure) => {
                let outcome = self.configure(configure, inputs);
                self.answer(Request::Configure, configure.request, outcome, transmit);
            }
            ToBoard::Arm(arm) => {
                let conditions = ArmingConditions {
                    configuration_hash: self.active.as_ref().map(|active| active.hash),
                    version_differs: self.link.version_differs(),
                    moving: self.odometer.is_moving(),
                    stop_input_open: self.has_stop_input() && inputs.stop_input_open,
                    kill_output: self.has_kill_output(),
                };
                let outcome = self.safety.arm(now_us, arm, conditions);
                self.answer(Request::Arm, arm.request, outcome, transmit);
            }
            ToBoard::Disarm(disarm) => {
                self.safety.disarm();
                if was_driving {
                    self.stop(self.odometer.speed_mm_s() > BRAKE_ABOVE_MM_S);
                }
                self.answer(Request::Disarm, disarm.request, Ok(()), transmit);
            }
            ToBoard::EmergencyStop(stop) => {
                self.safety.latch(StopCause::EmergencyStop);
                self.stop_if(was_driving);
                self.answer(Request::EmergencyStop, stop.request, Ok(()), transmit);
            }
            ToBoard::Drive(drive) => {
                let active = self.active.as_ref().map(|active| &active.configuration);
                let outcome = self.safety.drive(now_us, drive, active);
                if let (Ok(()), Some(configuration)) = (outcome, active) {
                    self.steering
                        .steer(&configuration.servo, drive.steering_100urad);
                }
                self.count_refusal(outcome);
            }
            ToBoard::Jog(jog) => {
                let outcome = self.safety.jog(now_us, jog);
                if let (Ok(()), Some(Active { configuration, .. })) = (outcome, &self.active) {
                    self.steering.jog(&configuration.servo, jog.servo_us);
                }
                self.count_refusal(outcome);
            }
        }
    }

    fn count_refusal(&mut self, outcome: Result<(), RefusalReason>) {
        if let Err(reason) = outcome {
            self.drives_refused = self.drives_refused.wrapping_add(1);
            self.last_refusal = reason;
        }
    }

    #[inline(never)]
    fn configure(&mut self, configure: &Configure, inputs: &Inputs) -> Result<(), RefusalReason> {
        self.safety.may_configure()?;
        if self.link.version_differs() {
            return Err(RefusalReason::VersionDiffers);
        }
        let configuration = &configure.configuration;
        if configuration.validate().is_err() {
            return Err(RefusalReason::InvalidConfiguration);
        }
        if configuration.car_id != self.link.car_id() {
            return Err(RefusalReason::OtherCar);
        }
        let hash = configuration.hash();
        let neutral_changed = configuration.esc.neutral_us != self.neutral_us();
        self.steering.configure(&configuration.servo);
        self.esc.configure(configuration);
        if neutral_changed {
            // Held from now on.
            self.esc.release();
        }
        self.odometer
            .configure(configuration.speed.pulse_distance_um);
        self.roll_out.configure(
            configuration.max_roll_out_ms,
            configuration.speed.pulse_distance_um,
        );
        self.active = Some(Active {
            configuration: *configuration,
            hash,
        });
        self.safety.configured(neutral_changed);
        if self.has_stop_input() {
            self.safety.observe_stop_input(inputs.stop_input_open);
        }
        Ok(())
    }

    /// Stops the ESC if the safety state machine has just ended driving.
    fn stop_if(&mut self, was_driving: bool) {
        if was_driving && !self.is_driving() {
            let brakes = self
                .configuration()
                .is_some_and(|configuration| configuration.failsafe == FailsafeAction::Brake);
            self.stop(brakes);
        }
    }

    /// Goes to neutral, after braking if `brakes` and if the ESC can.
    #[inline(never)]
    fn stop(&mut self, brakes: bool) {
        let can_brake = self
            .configuration()
            .is_some_and(|configuration| configuration.esc.kind.has_brake());
        // An emergency stop trusts no configuration.
        let brakes = brakes && can_brake && !self.safety.is_latched();
        self.esc.stop(brakes, self.motion());
    }

    /// Whether it obeys commands.
    const fn is_driving(&self) -> bool {
        self.safety.command().is_some()
    }

    fn has_stop_input(&self) -> bool {
        self.configuration()
            .is_some_and(|configuration| configuration.stop_input)
    }

    fn has_kill_output(&self) -> bool {
        self.configuration()
            .is_some_and(|configuration| configuration.kill_output)
    }

    fn answer(
        &mut self,
        request: Request,
        sequence: Sequence,
        outcome: Result<(), RefusalReason>,
        transmit: &mut impl FnMut(&[u8]) -> bool,
    ) {
        match outcome {
            Ok(()) => {
                let configuration_hash = self.hash();
                let acknowledgement = Acknowledgement {
                    request,
                    sequence,
                    configuration_hash,
                };
                self.link.send(&acknowledgement, transmit);
            }
            Err(reason) => {
                let refusal = Refusal {
                    request,
                    sequence,
                    reason,
                };
                self.link.send(&refusal, transmit);
            }
        }
    }

    fn actuate(&mut self, elapsed_us: u32, control_due: bool) {
        let Some(Active { configuration, .. }) = &self.active else {
            return;
        };
        if control_due {
            self.odometer.measure(configuration.speed.pulse_distance_um);
            self.roll_out
                .measured(self.odometer.speed_mm_s().unsigned_abs());
        }
        self.steering.advance(elapsed_us);
        let motion = self.motion();
        match self.safety.command().map(|command| command.action) {
            Some(Action::Drive { speed_mm_s, brake }) => {
                if control_due {
                    let measured_mm_s = self
                        .odometer
                        .controlled_mm_s(configuration.speed.pulse_distance_um, speed_mm_s);
                    self.esc
                        .control(configuration, speed_mm_s, measured_mm_s, brake);
                }
                self.esc
                    .advance_driving(&configuration.esc, elapsed_us, speed_mm_s, brake, motion);
            }
            Some(Action::Jog { esc_us }) => {
                self.esc
                    .advance_jogging(&configuration.esc, elapsed_us, esc_us);
            }
            None => self.esc.advance_stopped(elapsed_us, motion),
        }
    }

    fn report(
        &mut self,
        now_us: u32,
        elapsed_us: u32,
        inputs: &Inputs,
        telemetry_due: bool,
        transmit: &mut impl FnMut(&[u8]) -> bool,
    ) {
        if telemetry_due {
            self.send_telemetry(now_us, transmit);
        }
        if self.status.advance(elapsed_us) {
            self.send_status(now_us, inputs, transmit);
        }
    }

    #[inline(never)]
    fn send_telemetry(&mut self, now_us: u32, transmit: &mut impl FnMut(&[u8]) -> bool) {
        if self.link.send(&self.telemetry(now_us), transmit) {
            self.imu.sent();
        }
    }

    #[inline(never)]
    fn send_status(
        &mut self,
        now_us: u32,
        inputs: &Inputs,
        transmit: &mut impl FnMut(&[u8]) -> bool,
    ) {
        self.link.send(&self.status(now_us, inputs), transmit);
    }

    fn telemetry(&self, now_us: u32) -> Telemetry {
        let sample = self.imu.sample();
        Telemetry {
            board_time_us: now_us,
            mode: self.safety.mode(),
            stop_cause: self.safety.cause(),
            last_sequence: self.safety.last_sequence(),
            imu: self.imu.state(),
            imu_age_100us: self.imu.age_100us(),
            linear_acceleration_mm_s2: sample.linear_acceleration_mm_s2,
            angular_velocity_mrad_s: sample.angular_velocity_mrad_s,
            attitude_q14: sample.attitude_q14,
            motor_speed_mm_s: self.motor_speed_mm_s(),
            servo_us: self.steering.pulse_us().unwrap_or(0),
            esc_us: self.esc_us().unwrap_or(0),
        }
    }

    fn status(&self, now_us: u32, inputs: &Inputs) -> Status {
        Status {
            board_time_us: now_us,
            configuration_hash: self.hash(),
            reset_cause: self.reset_cause,
            stop_input_open: self.has_stop_input() && inputs.stop_input_open,
            battery_mv: inputs.battery_mv,
            frames_received: self.link.frames_received,
            frames_damaged: self.link.frames_damaged,
            drives_refused: self.drives_refused,
            last_refusal: self.last_refusal,
            frames_dropped: self.link.frames_dropped,
            bytes_overrun: inputs.bytes_overrun,
            imu_errors: inputs.imu_errors,
            supply_mv: inputs.supply_mv,
            battery_open: inputs.battery_open,
            power_on: self.power_on(),
            edges_refused: inputs.edges_refused,
            imu_calibration: inputs.imu_health.calibration,
            imu_status: inputs.imu_health.status,
            imu_error: inputs.imu_health.error,
            imu_self_test: inputs.imu_health.self_test,
        }
    }
}
