//! A small car on a stand, its board and its operator, in virtual time.

use singletrack_commissioning::{
    Answer, Answers, Attendance, Bench, BoardReading, Interrupted, Jog, Observation, PoseReading,
    Question, Refused, TickReading, edit::Edit,
};
use singletrack_control::statistics::Random;
use singletrack_control::{Position, Time, Velocity};
use singletrack_core::Config;
use singletrack_pilot::Mode;
use singletrack_protocol::{BoardMode, RefusalReason, ResetCause, Status, StopCause};
use singletrack_record::StatusRecord;

use crate::{Kind, Truth, numbers};

/// What a hand is about to do to a turning motor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Hand {
    CutSupply,
    OpenSwitch,
    Unplug,
    PressReset,
}

pub(crate) struct MockCar {
    pub(crate) truth: Truth,
    pub(crate) random: Random,
    config: Config,
    pub(crate) text: String,
    /// Every question, in order.
    pub(crate) asked: Vec<&'static str>,
    /// Gives up at this question.
    pub(crate) interrupt_at: Option<&'static str>,
    pub(crate) emergency_stops: u32,
    /// How often the daemon still loses the board while it jogs.
    pub(crate) losses: u32,
    /// The way of the car, and the fastest wheels, ever.
    pub(crate) way_m: f64,
    pub(crate) fastest_m_s: f64,
    now_us: u64,
    mode: BoardMode,
    cause: StopCause,
    boot_us: u64,
    armed_us: u64,
    jogged: Option<(u64, Jog)>,
    servo_us: f64,
    servo_target_us: f64,
    esc_offset_us: f64,
    wheels_us: f64,
    farthest_us: f64,
    speed: f64,
    travelled_m: f64,
    edges: Vec<(u64, u64)>,
    reference: Option<(u64, u64)>,
    measured: f64,
    last_edge_us: u64,
    driven_us: u64,
    jogging_us: u64,
    reverse_ready: bool,
    esc_input_us: f64,
    esc_changed_us: u64,
    powered: bool,
    powered_us: u64,
    was_powered: bool,
    supply_cut: bool,
    switch_open: bool,
    plugged: bool,
    reset_cause: ResetCause,
    /// How the motor stopped when the cable was pulled.
    stopped_how: Option<usize>,
    hand: Option<(Hand, Option<u64>)>,
    turned: f64,
    /// When a hand acted, how fast the wheels were, and for how long they kept that.
    acted: Option<(u64, f64)>,
    drove_us: u64,
}

const EXAMPLE: &str = include_str!("../../../daemon/singletrackd.example.toml");

impl MockCar {
    pub(crate) fn new(truth: Truth, seed: u64) -> Self {
        let mut edit = Edit::new(EXAMPLE).unwrap();
        for (key, value) in [
            ("board.kill_output", truth.kill_output.into()),
            ("board.stop_input", true.into()),
            (
                "board.speed.pulse_distance_um",
                ((truth.pulse_distance_m * 1e6).round() as i64).into(),
            ),
            ("board.speed.max_forward_mm_s", 1_000.into()),
            ("fence.braking_m_s2", 0.3.into()),
            ("limits.max_speed_m_s", 1.0.into()),
        ] {
            edit.set(key, &value).unwrap();
        }
        let text = edit.text().to_owned();
        Self {
            random: numbers(seed),
            config: Config::from_toml(&text).unwrap(),
            text,
            asked: Vec::new(),
            interrupt_at: None,
            emergency_stops: 0,
            losses: 0,
            way_m: 0.0,
            fastest_m_s: 0.0,
            now_us: 1_000_000,
            mode: BoardMode::Boot,
            cause: StopCause::None,
            boot_us: 1_000_000,
            armed_us: 0,
            jogged: None,
            servo_us: 1_500.0,
            servo_target_us: 1_500.0,
            esc_offset_us: 0.0,
            wheels_us: truth.centre_us,
            farthest_us: truth.centre_us,
            speed: 0.0,
            travelled_m: 0.0,
            edges: Vec::new(),
            reference: None,
            measured: 0.0,
            last_edge_us: 0,
            driven_us: 0,
            jogging_us: 0,
            reverse_ready: true,
            esc_input_us: 1_500.0,
            esc_changed_us: 0,
            powered: !truth.kill_output,
            powered_us: 0,
            was_powered: false,
            supply_cut: false,
            switch_open: false,
            plugged: true,
            reset_cause: ResetCause::PowerOn,
            stopped_how: None,
            hand: None,
            turned: 0.0,
            acted: None,
            drove_us: 0,
            truth,
        }
    }

    fn time(&self) -> Time {
        Time(self.now_us * 1_000)
    }

    fn neutral_us(&self) -> f64 {
        f64::from(self.config.board.esc.neutral_us)
    }

    fn is_armed(&self) -> bool {
        matches!(
            self.mode,
            BoardMode::Armed | BoardMode::PoweringUp | BoardMode::Jogging
        )
    }

    fn fail(&mut self, cause: StopCause) {
        if self.is_armed() {
            self.mode = BoardMode::Failsafe;
            self.cause = cause;
            self.jogged = None;
        }
    }

    fn latch(&mut self, cause: StopCause) {
        if self.mode != BoardMode::EmergencyStopped {
            self.mode = BoardMode::EmergencyStopped;
            self.cause = cause;
            self.jogged = None;
        }
    }

    fn reset_board(&mut self) {
        self.mode = BoardMode::Boot;
        self.boot_us = self.now_us + 1_000_000;
        self.jogged = None;
        self.servo_target_us = f64::from(self.config.board.servo.centre_us);
        self.cause = StopCause::None;
    }

    /// The board, once in 10 ms.
    fn board(&mut self) {
        let now_us = self.now_us;
        let elapsed = move |since: u64| now_us.saturating_sub(since);
        let (booted, powering) = (elapsed(self.boot_us), elapsed(self.armed_us));
        if self.mode == BoardMode::Boot && booted >= 2_000_000 {
            self.mode = BoardMode::Neutral;
        }
        if self.mode == BoardMode::PoweringUp && powering >= 2_000_000 {
            self.mode = BoardMode::Armed;
            self.armed_us = self.now_us;
        }
        if self.mode == BoardMode::Armed && elapsed(self.armed_us) >= 1_000_000 {
            self.fail(StopCause::CommandTimeout);
        }
        if let Some((at, jog)) = self.jogged {
            // The daemon's hold.
            if elapsed(at) > 250_000 {
                self.mode = BoardMode::Neutral;
                self.cause = StopCause::Disarmed;
                self.jogged = None;
            } else {
                self.mode = BoardMode::Jogging;
                let servo = self.config.board.servo;
                self.servo_target_us = f64::from(jog.servo_us.clamp(servo.min_us, servo.max_us));
            }
        }
        if self.switch_open && self.truth.switch_works {
            self.latch(StopCause::StopInput);
        }
        let esc = self.config.board.esc;
        let target = match self.jogged {
            Some((_, jog)) => {
                let pulse = f64::from(jog.esc_us.clamp(esc.min_us, esc.max_us));
                (pulse - self.neutral_us()).clamp(-150.0, 150.0)
            }
            None => 0.0,
        };
        if target * self.esc_offset_us < 0.0 {
            self.esc_offset_us = 0.0;
        }
        self.esc_offset_us = if target.abs() < self.esc_offset_us.abs() {
            target
        } else {
            let slew = f64::from(esc.slew_us_per_20ms) / 2.0;
            self.esc_offset_us + (target - self.esc_offset_us).clamp(-slew, slew)
        };
        let slew = f64::from(self.config.board.servo.slew_us_per_20ms) / 2.0;
        self.servo_us += (self.servo_target_us - self.servo_us).clamp(-slew, slew);
        self.measure();
        if self.mode == BoardMode::Jogging {
            if self.measured > 1.0 {
                self.fail(StopCause::JogTooFast);
            }
            if self.esc_offset_us == 0.0 && self.measured == 0.0 {
                self.jogging_us = 0;
            } else {
                self.jogging_us += 10_000;
            }
            if self.jogging_us >= 10_000_000 {
                self.fail(StopCause::JogTooLong);
            }
            if self.esc_offset_us.abs() > f64::from(esc.deadband_us) {
                self.driven_us += 10_000;
            }
            if self.driven_us >= 600_000 && elapsed(self.last_edge_us) >= 150_000 {
                self.fail(StopCause::MotorSensor);
            }
        } else {
            self.driven_us = 0;
            self.jogging_us = 0;
        }
    }

    fn measure(&mut self) {
        let now = self.now_us;
        if let Some(&(count, at)) = self.edges.last() {
            self.last_edge_us = at;
            self.driven_us = 0;
            self.measured = match self.reference {
                Some((before, since)) if at > since => {
                    (count - before) as f64 * self.truth.pulse_distance_m * 1e6
                        / (at - since) as f64
                }
                _ => self.measured,
            };
            self.reference = Some((count, at));
            self.edges.clear();
        }
        let waited = now.saturating_sub(self.last_edge_us);
        if waited >= 500_000 {
            self.measured = 0.0;
            self.reference = None;
            if self.esc_offset_us == 0.0 {
                self.driven_us = 0;
            }
        } else {
            let at_most = self.truth.pulse_distance_m * 1e6 / waited.max(1) as f64;
            self.measured = self.measured.min(at_most);
        }
        // The board counts in mm/s.
        self.measured = (self.measured * 1e3).floor() / 1e3;
    }

    /// Supply, ESC, motor and wheels, for a millisecond.
    fn plant(&mut self) {
        let t = &self.truth;
        let held = !t.kill_output || !t.relay_works || self.is_armed();
        let powered = held && !self.supply_cut;
        if powered && !self.powered {
            self.powered_us = self.now_us;
        }
        self.powered = powered;
        self.was_powered |= powered && self.is_armed();
        let silent = !(self.plugged || self.truth.own_supply) || self.boot_us > self.now_us;
        let servo = self.servo_us;
        let esc = self.neutral_us() + self.esc_offset_us;
        let (servo, esc) = if t.swapped {
            (esc, servo)
        } else {
            (servo, esc)
        };
        // The wheels.
        let half = t.play_us / 2.0;
        self.wheels_us = self.wheels_us.clamp(servo - half, servo + half);
        if (servo - t.centre_us).abs() > (self.farthest_us - t.centre_us).abs() {
            self.farthest_us = servo;
        }
        // The pulse that the ESC acts on.
        if !silent || !t.runs_without_pulses {
            let pulse = if silent { t.neutral_us } else { esc };
            if (pulse - t.neutral_us).abs() <= t.ignored_us && self.esc_input_us != pulse {
                if self.now_us.saturating_sub(self.esc_changed_us) as f64 * 1e-6 >= t.holds_s {
                    self.esc_input_us = pulse;
                }
            } else {
                self.esc_input_us = pulse;
                self.esc_changed_us = self.now_us;
            }
        }
        let way = self.esc_input_us - t.neutral_us;
        let beyond = way.abs() - t.ignored_us;
        let driving = (beyond - t.breakaway_us).max(0.0);
        let settled = t.gain_m_s_per_us * driving / (1.0 + driving / t.saturation_us);
        let ready = self.powered && self.now_us - self.powered_us >= 1_000_000;
        let rolling = t.rolling_m_s2 * (self.speed / 0.005).clamp(-1.0, 1.0) + self.speed;
        if beyond <= 0.0 {
            self.reverse_ready = self.speed.abs() < 0.02;
        } else {
            self.reverse_ready &= way < 0.0;
        }
        let reverse = match t.kind {
            Kind::ForwardReverse => true,
            Kind::Vesc => false,
            Kind::Car => self.reverse_ready,
        };
        let acceleration = if !ready || beyond <= 0.0 {
            -rolling
        } else if way > 0.0 || reverse {
            let driven = (settled * way.signum() - self.speed) / t.lag_s;
            let faster = settled * self.speed * way.signum() >= 0.0
                && driven * self.speed < 0.0
                && driven.abs() > rolling.abs();
            if faster {
                -rolling
            } else {
                driven.clamp(-3.0, 3.0)
            }
        } else {
            -rolling - (0.02 * beyond).min(3.0) * (self.speed / 0.005).clamp(-1.0, 1.0)
        };
        self.speed += acceleration * 1e-3;
        self.fastest_m_s = self.fastest_m_s.max(self.speed.abs());
        if let Some((at, speed)) = self.acted
            && self.speed.abs() > 0.9 * speed
        {
            self.drove_us = self.now_us - at;
        }
        if self.speed.abs() > 0.05 {
            self.turned = self.speed;
        }
        let before = self.travelled_m;
        self.travelled_m += self.speed.abs() * 1e-3;
        if !t.on_stand {
            self.way_m += self.speed * 1e-3;
        }
        let edge = |way: f64| (way / t.pulse_distance_m) as u64;
        if edge(self.travelled_m) != edge(before) && !t.sensor_dead {
            self.edges.push((edge(self.travelled_m), self.now_us));
        }
    }

    fn act(&mut self) {
        let Some((hand, at)) = self.hand else { return };
        let at = match at {
            None if self.speed.abs() > 0.2 => {
                let delay = self.random.between(0.7, 2.0);
                self.hand = Some((hand, Some(self.now_us + (delay * 1e6) as u64)));
                return;
            }
            None => return,
            Some(at) => at,
        };
        if self.now_us < at {
            return;
        }
        self.hand = None;
        self.acted = Some((self.now_us, self.speed.abs()));
        self.drove_us = 0;
        match hand {
            Hand::CutSupply => self.supply_cut = true,
            Hand::OpenSwitch => self.switch_open = true,
            Hand::Unplug => {
                self.plugged = false;
                if !self.truth.own_supply {
                    self.mode = BoardMode::Boot;
                    self.jogged = None;
                }
            }
            Hand::PressReset => self.reset_board(),
        }
    }

    fn pass(&mut self, us: u64) {
        for _ in 0..us / 1_000 {
            self.now_us += 1_000;
            self.plant();
            if self.now_us.is_multiple_of(10_000) {
                self.board();
                self.act();
            }
        }
    }

    /// The steering angle, left positive.
    fn angle(&self) -> f64 {
        let t = &self.truth;
        ((self.wheels_us - t.centre_us) / t.gain_us_per_rad).clamp(-t.stop_rad, t.stop_rad)
    }

    fn board_us(&self) -> u32 {
        (self.now_us - self.boot_us) as u32
    }

    /// How the motor stopped, by eye.
    fn stopped_how(&self) -> usize {
        match self.drove_us {
            _ if self.speed.abs() > 0.1 => 2,
            drove_us if drove_us > 400_000 => 1,
            _ => 0,
        }
    }

    fn status(&self) -> Status {
        Status {
            board_time_us: self.board_us(),
            configuration_hash: 1,
            reset_cause: self.reset_cause,
            stop_input_open: self.switch_open,
            battery_mv: 7_600,
            frames_received: 0,
            frames_damaged: 0,
            drives_refused: 0,
            last_refusal: RefusalReason::None,
            frames_dropped: 0,
            bytes_overrun: 0,
            imu_errors: 0,
            supply_mv: 5_000,
            battery_open: false,
            power_on: self.truth.kill_output && self.is_armed(),
            edges_refused: 0,
            imu_calibration: 0xFF,
            imu_status: 5,
            imu_error: 0,
            imu_self_test: 15,
        }
    }
}

impl Bench for MockCar {
    fn wait(&mut self, observed: &mut Vec<Observation>) -> Result<(), Interrupted> {
        self.pass(10_000);
        let time = self.time();
        if self.plugged && self.boot_us <= self.now_us {
            let sign = self.esc_offset_us.signum();
            observed.push(Observation::Board(BoardReading {
                time,
                board_us: self.board_us(),
                receive: time,
                inertial: None,
                motor_speed: self.measured * sign,
                servo_us: self.servo_us.round() as u16,
                esc_us: if self.mode == BoardMode::EmergencyStopped {
                    0
                } else {
                    (self.neutral_us() + self.esc_offset_us).round() as u16
                },
                mode: self.mode,
                stop_cause: self.cause,
            }));
            if self.now_us.is_multiple_of(200_000) {
                observed.push(Observation::Health(StatusRecord {
                    receive_time_ns: time.0,
                    status: self.status(),
                }));
            }
        }
        let noise = self.random.between(-2e-4, 2e-4);
        observed.push(Observation::Pose(PoseReading {
            capture: time,
            receive: time,
            uncertainty: 1e-4,
            position: [0.3 + self.way_m + noise, -0.2, 0.2],
            yaw: 0.4,
            roll: 0.0,
            pitch: 0.0,
            mean_error: 1e-4,
        }));
        observed.push(Observation::Tick(TickReading {
            time,
            mode: Mode::Idle,
            reason: None,
            preflight: None,
            pose: None,
            point: None,
        }));
        Ok(())
    }

    fn ask(&mut self, question: &Question) -> Result<Answer, Interrupted> {
        if self.interrupt_at == Some(question.id) {
            return Err(Interrupted::ByOperator);
        }
        self.asked.push(question.id);
        self.pass(2_000_000);
        let answer = match question.id {
            "on-stand" | "kill-switch" => Answer::YesNo(true),
            "esc-dark" => Answer::YesNo(!self.powered),
            "esc-woke" => Answer::YesNo(std::mem::take(&mut self.was_powered)),
            "wheels-still" => Answer::YesNo(self.turned == 0.0),
            "front-wheels" => {
                // Less than a degree looks straight, and the eye is off by as much.
                let seen = self.angle().to_degrees() + self.random.between(-1.0, 1.0);
                Answer::Choice(match seen {
                    seen if seen > 0.8 => 0,
                    seen if seen < -0.8 => 2,
                    _ => 1,
                })
            }
            "wheel-angle" => {
                Answer::Number((self.angle().to_degrees() + self.random.between(-2.0, 2.0)).round())
            }
            "at-stop" => {
                let farthest = std::mem::replace(&mut self.farthest_us, self.truth.centre_us);
                let angle = (farthest - self.truth.centre_us) / self.truth.gain_us_per_rad;
                Answer::YesNo(angle.abs() > self.truth.stop_rad)
            }
            "driven-wheels" => Answer::Choice(if self.turned == 0.0 {
                2
            } else {
                usize::from((self.turned > 0.0) == self.truth.backward)
            }),
            "stopped-how" => {
                let remembered = self.stopped_how.take();
                Answer::Choice(remembered.unwrap_or_else(|| self.stopped_how()))
            }
            "cut-supply" => self.prepare(Hand::CutSupply),
            "open-switch" => self.prepare(Hand::OpenSwitch),
            "unplug" => self.prepare(Hand::Unplug),
            "reset-at-speed" => self.prepare(Hand::PressReset),
            "restore-supply" => {
                self.supply_cut = false;
                Answer::Begin
            }
            "close-switch" => {
                self.switch_open = false;
                self.reset_board();
                Answer::Begin
            }
            "plug-in" => {
                self.stopped_how = Some(self.stopped_how());
                self.plugged = true;
                self.reset_board();
                self.reset_cause = if self.truth.own_supply {
                    ResetCause::External
                } else {
                    ResetCause::PowerOn
                };
                Answer::Begin
            }
            "esc-after-board" | "board-after-esc" | "clear-latch" => {
                self.turned = 0.0;
                self.reset_board();
                self.pass(3_000_000);
                Answer::Begin
            }
            other => panic!("{other}"),
        };
        self.farthest_us = self.truth.centre_us;
        let fits = match (&question.answers, answer) {
            (Answers::Begin, Answer::Begin) | (Answers::YesNo, Answer::YesNo(_)) => true,
            (Answers::Choice(words), Answer::Choice(index)) => index < words.len(),
            (Answers::Number { range, .. }, Answer::Number(number)) => {
                (range[0]..=range[1]).contains(&number)
            }
            _ => false,
        };
        assert!(fits, "{question:?}: {answer:?}");
        Ok(answer)
    }

    fn show(&mut self, text: &str, _: f64) {
        assert!(!text.is_empty());
    }

    fn arm(&mut self, attendance: Attendance) -> Result<(), Refused> {
        assert_eq!(attendance, Attendance::Jog);
        if !matches!(self.mode, BoardMode::Neutral | BoardMode::Failsafe) || self.measured != 0.0 {
            return Err(Refused(self.mode.name().into()));
        }
        self.armed_us = self.now_us;
        self.driven_us = 0;
        self.was_powered = false;
        self.turned = 0.0;
        self.mode = if self.truth.kill_output {
            BoardMode::PoweringUp
        } else {
            BoardMode::Armed
        };
        Ok(())
    }

    fn jog(&mut self, jog: Jog) -> Result<(), Refused> {
        if self.mode == BoardMode::Jogging && self.losses > 0 {
            self.losses -= 1;
            self.fail(StopCause::HostRestarted);
        }
        if !matches!(self.mode, BoardMode::Armed | BoardMode::Jogging) {
            return Err(Refused("not-armed".into()));
        }
        self.jogged = Some((self.now_us, jog));
        Ok(())
    }

    fn drive(&mut self, _: Velocity, _: Option<Position>) -> Result<(), Refused> {
        panic!("a bring-up does not drive")
    }

    fn disarm(&mut self) -> Result<(), Refused> {
        if self.is_armed() {
            if self.truth.falls_off && self.measured != 0.0 {
                self.way_m += 0.05;
            }
            self.mode = BoardMode::Neutral;
            self.cause = StopCause::Disarmed;
            self.jogged = None;
        }
        Ok(())
    }

    fn emergency_stop(&mut self) -> Result<(), Refused> {
        self.emergency_stops += 1;
        self.latch(StopCause::EmergencyStop);
        Ok(())
    }

    fn configuration(&self) -> &Config {
        &self.config
    }

    fn change(&mut self, values: &[(&str, toml_edit::Value)]) -> Result<(), Refused> {
        let refused = |error: &dyn ToString| Refused(error.to_string());
        let mut edit = Edit::new(&self.text).map_err(|error| refused(&error))?;
        for (key, value) in values {
            edit.set(key, value).map_err(|error| refused(&error))?;
        }
        let config = Config::from_toml(edit.text()).map_err(|error| refused(&error))?;
        assert!(!self.is_armed(), "a configuration is refused while armed");
        if config.board.esc.neutral_us != self.config.board.esc.neutral_us {
            self.mode = BoardMode::Boot;
            self.boot_us = self.now_us;
        }
        self.config = config;
        self.text = edit.text().to_owned();
        Ok(())
    }
}

impl MockCar {
    fn prepare(&mut self, hand: Hand) -> Answer {
        self.hand = Some((hand, None));
        Answer::Begin
    }
}
