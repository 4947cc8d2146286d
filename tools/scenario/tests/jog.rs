//! Jogging: bare pulses from a hand, through daemon, line, board and car, in virtual time.

use singletrack_control::statistics::Random;
use singletrack_core::config::{ReferenceSection, Start};
use singletrack_pilot::{Arming, Jog, Mode, PilotRequest, Reason};
use singletrack_protocol::{BoardMode, JOG_LIMIT_US, StopCause};
use singletrack_scenario::{
    simulated::{Drive, daemon_config},
    virtual_drive::VirtualDrive,
};
use singletrack_sim::{EscKind, MotorSensorFault, SimulationConfig};

const NEUTRAL_US: u16 = 1_500;
const STRAIGHT_US: u16 = 1_500;

/// From the last word of the hand, or from what goes wrong, to the first neutral pulse, µs.
const NEUTRAL_WITHIN_US: u64 = 120_000;

fn config() -> singletrack_core::config::Config {
    daemon_config(Drive::following(ReferenceSection::Circle {
        radius_m: 1.5,
        angular_velocity_rad_s: 0.3,
        centre_m: [0.0, 0.0],
        start: Start::Beginning,
    }))
}

fn simulation() -> SimulationConfig {
    SimulationConfig {
        seed: 1,
        ..SimulationConfig::default()
    }
}

/// Arms the car to jog, and goes on to the first tick in [`Mode::Jogging`], within 15 s.
fn start_jogging(drive: &mut VirtualDrive) {
    let until_us = drive.next_tick_us() + 15_000_000;
    while drive.mode() != Mode::Jogging {
        assert!(drive.next_tick_us() < until_us, "{:?}", drive.mode());
        match drive.mode() {
            Mode::Idle | Mode::Ready => drive.request(PilotRequest::Arm(Arming::Jog)).unwrap(),
            Mode::Arming => drive.request(PilotRequest::Hold).unwrap(),
            _ => {}
        }
        drive.step();
    }
}

fn jogging() -> VirtualDrive {
    let mut drive = VirtualDrive::new(config(), 1, simulation()).unwrap();
    start_jogging(&mut drive);
    drive
}

const fn pulses(servo_us: u16, esc_us: u16) -> Jog {
    Jog { servo_us, esc_us }
}

/// Gives these pulses at every tick, for so long.
fn hold(drive: &mut VirtualDrive, jog: Jog, ms: u64) {
    for _ in 0..ms / 10 {
        drive.host().parts.jogs.send(jog);
        drive.step();
    }
}

fn wait(drive: &mut VirtualDrive, ms: u64) {
    for _ in 0..ms / 10 {
        drive.step();
    }
}

fn board(drive: &VirtualDrive) -> (BoardMode, StopCause) {
    let telemetry = drive.world.board.telemetry().unwrap();
    (telemetry.mode, telemetry.stop_cause)
}

/// Time from `from_us` to the first pulse from which on the ESC is at neutral, µs; none if
/// it is not.
fn neutral_after(drive: &VirtualDrive, from_us: u64) -> Option<u64> {
    let pulses = &drive.world.board.pulses;
    let neutral = pulses.neutral_from(from_us, NEUTRAL_US, 0)?;
    Some(neutral.time_us - from_us)
}

fn turning() -> VirtualDrive {
    let mut drive = jogging();
    hold(&mut drive, pulses(STRAIGHT_US, 1_560), 1_000);
    assert!(drive.world.truth().wheel_speed > 0.1);
    drive
}

fn reason(drive: &VirtualDrive) -> Option<Reason> {
    drive.controller().pilot.reason()
}

#[test]
fn a_hand_steers_and_turns_the_wheels() {
    let mut drive = jogging();
    hold(&mut drive, pulses(1_400, NEUTRAL_US), 500);
    assert!(drive.world.truth().steering > 0.1, "to the left");
    hold(&mut drive, pulses(1_600, NEUTRAL_US), 500);
    assert!(drive.world.truth().steering < -0.1, "to the right");
    assert!(drive.world.truth().speed.abs() < 1e-3);
    hold(&mut drive, pulses(STRAIGHT_US, 1_560), 1_000);
    assert!(drive.world.truth().speed > 0.1);
    assert_eq!(drive.mode(), Mode::Jogging);
    assert_eq!(board(&drive).0, BoardMode::Jogging);
}

#[test]
fn a_hand_that_lets_go_ends_at_neutral_within_0_3_s() {
    let mut drive = turning();
    let last_us = drive.world.now_us;
    wait(&mut drive, 1_000);
    // 0.25 s by the daemon, a tick, the line and a servo frame.
    let neutral = neutral_after(&drive, last_us).unwrap();
    assert!(neutral < 300_000, "{neutral} us");
    assert_eq!(reason(&drive), Some(Reason::OperatorGone));
    assert_eq!(board(&drive), (BoardMode::Neutral, StopCause::Disarmed));
}

#[test]
fn renewals_without_pulses_do_not_hold_a_hand_that_let_go() {
    let mut drive = turning();
    let last_us = drive.world.now_us;
    for _ in 0..100 {
        drive.request(PilotRequest::Hold).unwrap();
        drive.step();
    }
    assert!(neutral_after(&drive, last_us).unwrap() < 300_000);
    assert_eq!(reason(&drive), Some(Reason::OperatorGone));
}

#[test]
fn a_disarm_a_stop_and_a_missing_operator_end_at_neutral_within_120_ms() {
    for (request, told) in [
        (PilotRequest::Disarm, Reason::Requested),
        (PilotRequest::OperatorGone, Reason::OperatorGone),
        (PilotRequest::TimeUp, Reason::TimeUp),
        (PilotRequest::EmergencyStop, Reason::EmergencyStop),
    ] {
        let mut drive = turning();
        let asked_us = drive.world.now_us;
        drive.request(request).unwrap();
        // The hand goes on.
        hold(&mut drive, pulses(STRAIGHT_US, 1_560), 1_000);
        let neutral = neutral_after(&drive, asked_us).unwrap();
        assert!(neutral <= NEUTRAL_WITHIN_US, "{request:?}: {neutral} us");
        assert_eq!(reason(&drive), Some(told), "{request:?}");
    }
}

/// With a cable that is pulled, the drive, and when it was.
fn pulled(own_supply: bool) -> (VirtualDrive, u64) {
    let mut simulation = simulation();
    simulation.board.own_supply = own_supply;
    let mut drive = VirtualDrive::new(config(), 1, simulation).unwrap();
    start_jogging(&mut drive);
    hold(&mut drive, pulses(STRAIGHT_US, 1_560), 500);
    assert!(drive.step().truth.wheel_speed > 0.1);
    let pulled_us = drive.world.now_us;
    drive.world.set_cable(false);
    hold(&mut drive, pulses(STRAIGHT_US, 1_560), 1_000);
    (drive, pulled_us)
}

/// Plugs the cable in again: the hand goes on, and the board does not.
fn plugged_again(mut drive: VirtualDrive) {
    let plugged_us = drive.world.now_us;
    drive.world.set_cable(true);
    hold(&mut drive, pulses(STRAIGHT_US, 1_560), 4_000);
    assert!(neutral_after(&drive, plugged_us).unwrap() <= NEUTRAL_WITHIN_US);
    assert_eq!(drive.mode(), Mode::Ready, "not armed again");
}

#[test]
fn a_pulled_cable_ends_at_neutral_within_120_ms_by_a_board_with_its_own_supply() {
    let (drive, pulled_us) = pulled(true);
    let neutral = neutral_after(&drive, pulled_us).unwrap();
    assert!(neutral <= NEUTRAL_WITHIN_US, "{neutral} us");
    let last = drive.world.board.pulses.last().copied().unwrap();
    assert_eq!(last.esc_us, NEUTRAL_US);
    plugged_again(drive);
}

#[test]
fn a_pulled_cable_takes_the_pulses_along_and_the_esc_stops_by_itself() {
    let (mut drive, pulled_us) = pulled(false);
    let pulses: Vec<_> = drive.world.board.pulses.iter().copied().collect();
    let mut later = pulses.iter().filter(|pulse| pulse.time_us >= pulled_us);
    assert!(later.all(|pulse| pulse.esc_us == 0), "no neutral pulse");
    assert_eq!(drive.step().truth.wheel_speed, 0.0);
    plugged_again(drive);
}

#[test]
fn a_stop_switch_ends_at_neutral_and_is_latched() {
    let mut config = config();
    config.board.stop_input = true;
    let mut drive = VirtualDrive::new(config, 1, simulation()).unwrap();
    start_jogging(&mut drive);
    hold(&mut drive, pulses(STRAIGHT_US, 1_560), 1_000);
    let opened_us = drive.world.now_us;
    drive.world.board.stop_input_open = true;
    hold(&mut drive, pulses(STRAIGHT_US, 1_560), 1_000);
    let neutral = neutral_after(&drive, opened_us).unwrap();
    assert!(neutral <= 40_000, "{neutral} us");
    assert_eq!(
        board(&drive),
        (BoardMode::EmergencyStopped, StopCause::StopInput)
    );
    assert_eq!(drive.mode(), Mode::Fault);
}

#[test]
fn a_reset_of_the_board_ends_it_and_does_not_jog_again() {
    let mut drive = turning();
    let pressed_us = drive.world.now_us;
    drive.world.press_reset();
    hold(&mut drive, pulses(STRAIGHT_US, 1_560), 5_000);
    // No pulses at all while the bootloader runs; the first one after it is neutral.
    let pulses = drive.world.board.pulses.iter();
    let later: Vec<_> = pulses
        .filter(|pulse| pulse.time_us >= pressed_us + 40_000)
        .collect();
    assert!(later.len() > 10);
    assert!(later.iter().all(|pulse| pulse.esc_us == NEUTRAL_US));
    assert_ne!(drive.mode(), Mode::Jogging);
}

#[test]
fn the_motor_gets_at_most_150_us_from_neutral_whatever_the_hand_gives() {
    let mut drive = jogging();
    for (servo_us, esc_us) in [(0, u16::MAX), (u16::MAX, 0), (1_500, 2_000), (2_000, 1_000)] {
        hold(&mut drive, pulses(servo_us, esc_us), 300);
        hold(&mut drive, pulses(STRAIGHT_US, NEUTRAL_US), 100);
    }
    let board = &drive.world.board;
    let servo = config().board.servo;
    let mut farthest = 0;
    for pulse in board.pulses.iter().filter(|pulse| pulse.servo_us != 0) {
        farthest = farthest.max(pulse.esc_us.abs_diff(NEUTRAL_US));
        assert!((servo.min_us..=servo.max_us).contains(&pulse.servo_us));
    }
    assert!((100..=JOG_LIMIT_US).contains(&farthest), "{farthest} us");
}

#[test]
fn wheels_above_1_m_s_end_it() {
    let mut simulation = simulation();
    simulation.car.motor.gain_m_s_per_us *= 2.0;
    let mut drive = VirtualDrive::new(config(), 1, simulation).unwrap();
    start_jogging(&mut drive);
    let mut fastest: f64 = 0.0;
    for _ in 0..300 {
        drive.host().parts.jogs.send(pulses(STRAIGHT_US, 1_650));
        fastest = fastest.max(drive.step().truth.wheel_speed);
    }
    assert_eq!(board(&drive), (BoardMode::Failsafe, StopCause::JogTooFast));
    assert_eq!(reason(&drive), Some(Reason::BoardFailsafe));
    // The motor's lag, and the dead time of the ESC.
    assert!((1.0..1.25).contains(&fastest), "{fastest} m/s");
}

#[test]
fn ten_seconds_of_turning_wheels_end_it() {
    let mut drive = jogging();
    let begun_us = drive.world.now_us;
    hold(&mut drive, pulses(STRAIGHT_US, 1_545), 12_000);
    assert_eq!(board(&drive), (BoardMode::Failsafe, StopCause::JogTooLong));
    let neutral = neutral_after(&drive, begun_us).unwrap();
    assert!((9_900_000..10_200_000).contains(&neutral), "{neutral} us");
}

#[test]
fn a_dead_pulse_sensor_ends_it_within_0_7_s() {
    let mut drive = jogging();
    drive.world.car.sensor_fault = MotorSensorFault::Gone;
    let begun_us = drive.world.now_us;
    hold(&mut drive, pulses(STRAIGHT_US, 1_600), 3_000);
    assert_eq!(board(&drive), (BoardMode::Failsafe, StopCause::MotorSensor));
    let neutral = neutral_after(&drive, begun_us).unwrap();
    assert!(neutral < 700_000, "{neutral} us");
}

#[test]
fn it_needs_neither_cameras_nor_imu_nor_a_place_in_the_fence() {
    let mut config = config();
    config.fence.corners_m = vec![[50.0, 50.0], [52.0, 50.0], [52.0, 52.0], [50.0, 52.0]];
    let mut simulation = simulation();
    simulation.natnet.is_off = true;
    let mut drive = VirtualDrive::new(config, 1, simulation).unwrap();
    start_jogging(&mut drive);
    hold(&mut drive, pulses(1_400, 1_560), 500);
    assert_eq!(drive.mode(), Mode::Jogging);
    assert!(drive.controller().pilot.mode().commands());
}

#[test]
fn after_jogging_the_car_drives_and_its_braking_is_not_judged() {
    let mut drive = turning();
    drive.request(PilotRequest::Disarm).unwrap();
    for _ in 0..400 {
        let tick = drive.step();
        assert_eq!(tick.tick.output.braking_measured, None);
    }
    let start = drive.start().unwrap();
    assert_eq!(start.tick.output.mode, Mode::Driving);
    wait(&mut drive, 2_000);
    assert_eq!(drive.mode(), Mode::Driving);
    // Neither pulses nor a request to jog disturb a drive.
    drive.request(PilotRequest::Arm(Arming::Jog)).unwrap();
    hold(&mut drive, pulses(1_100, 1_650), 500);
    assert_eq!(drive.mode(), Mode::Driving);
}

#[test]
fn the_configuration_is_not_replaced_while_jogging() {
    let mut drive = jogging();
    drive
        .host()
        .parts
        .jogs
        .send(pulses(STRAIGHT_US, NEUTRAL_US));
    drive.step();
    assert!(drive.reconfigure(config()).is_err());
}

/// A random hand on a random car, while things go wrong.
struct Hand {
    random: Random,
    drive: VirtualDrive,
    /// What the hand gives, until when; `None` while it lets go.
    gives: Option<Jog>,
    until_us: u64,
    /// When it last gave pulses.
    given_us: Option<u64>,
    /// When the cable was pulled.
    pulled_us: Option<u64>,
    sensor_is_dead: bool,
    /// Pulses of the board that have been checked.
    checked: u64,
    /// Since when the ESC has not been at neutral.
    driven_since_us: Option<u64>,
    /// Since when nothing jogs and the wheels should come to rest.
    ended_us: Option<u64>,
    jogged: u64,
}

impl Hand {
    fn new(seed: u64) -> Self {
        let mut random = Random::new(seed);
        for _ in 0..10 {
            random.below(2);
        }
        let mut config = config();
        let mut simulation = simulation();
        simulation.seed = seed;
        let motor = &mut simulation.car.motor;
        motor.kind = [EscKind::Car, EscKind::ForwardReverse, EscKind::Vesc][random.below(3)];
        motor.deadband_us = 5 + random.below(60) as u16;
        motor.gain_m_s_per_us *= 0.5 + 0.25 * random.below(10) as f64;
        config.board.stop_input = true;
        config.board.kill_output = random.below(2) == 0;
        motor.kill_relay = config.board.kill_output;
        simulation.board.own_supply = seed.is_multiple_of(2);
        Self {
            random,
            drive: VirtualDrive::new(config, seed, simulation).unwrap(),
            gives: None,
            until_us: 0,
            given_us: None,
            pulled_us: None,
            sensor_is_dead: false,
            checked: 0,
            driven_since_us: None,
            ended_us: None,
            jogged: 0,
        }
    }

    /// A tick: the hand, what goes wrong, and what must hold.
    fn tick(&mut self) {
        let now_us = self.drive.world.now_us;
        if matches!(self.drive.mode(), Mode::Idle | Mode::Ready) && self.random.below(20) == 0 {
            self.drive.request(PilotRequest::Arm(Arming::Jog)).unwrap();
        }
        if now_us >= self.until_us {
            let servo_us = self.random.below(3_000) as u16;
            let offset_us = self.random.below(500) as u16;
            let ms = 50 + self.random.below(3_000) as u64;
            self.until_us = now_us + 1_000 * ms;
            self.gives = Some(pulses(servo_us, 1_250 + offset_us));
            if self.random.below(6) == 0 {
                self.gives = None;
                self.until_us = now_us + 1_000 * (ms / 5);
            } else if self.random.below(20) == 0 {
                // Until the board ends it.
                self.until_us = now_us + 15_000_000;
            }
        }
        if let Some(jog) = self.gives {
            self.drive.host().parts.jogs.send(jog);
            self.given_us = Some(now_us);
        }
        if self.random.below(400) == 0 {
            self.go_wrong(now_us);
        }
        if let Some(pulled_us) = self.pulled_us
            && now_us > pulled_us + 1_000_000
        {
            self.pulled_us = None;
            self.drive.world.set_cable(true);
        }
        if self.drive.mode() == Mode::Fault && self.random.below(100) == 0 {
            let world = &mut self.drive.world;
            world.board.stop_input_open = false;
            world.press_reset();
        }
        let truth = self.drive.step().truth;
        self.jogged += u64::from(self.drive.mode() == Mode::Jogging);
        self.check_pulses();
        let speed = truth.wheel_speed.abs();
        let fastest = if self.sensor_is_dead { 3.0 } else { 1.5 };
        assert!(speed < fastest, "{speed} m/s");
        if self.drive.mode() == Mode::Jogging || speed < 0.01 {
            self.ended_us = None;
        } else {
            let ended_us = *self.ended_us.get_or_insert(now_us);
            assert!(now_us - ended_us < 3_000_000, "{speed} m/s after 3 s");
        }
    }

    fn go_wrong(&mut self, now_us: u64) {
        match self.random.below(7) {
            0 if self.pulled_us.is_none() => {
                self.pulled_us = Some(now_us);
                self.drive.world.set_cable(false);
            }
            1 => self.drive.world.press_reset(),
            2 => {
                let board = &mut self.drive.world.board;
                board.stop_input_open = true;
            }
            3 => {
                self.sensor_is_dead = true;
                let car = &mut self.drive.world.car;
                car.sensor_fault = MotorSensorFault::Gone;
            }
            4 => self.drive.request(PilotRequest::Disarm).unwrap(),
            5 => self.drive.request(PilotRequest::OperatorGone).unwrap(),
            _ => self.drive.request(PilotRequest::Hold).unwrap(),
        }
    }

    fn check_pulses(&mut self) {
        let log = &self.drive.world.board.pulses;
        let new = (log.total - self.checked) as usize;
        self.checked = log.total;
        let mut latest: Vec<_> = log.iter().rev().take(new).copied().collect();
        latest.reverse();
        for pulse in latest {
            let beyond_us = pulse.esc_us.abs_diff(NEUTRAL_US);
            if pulse.esc_us == 0 || pulse.cut || beyond_us == 0 {
                self.driven_since_us = None;
                continue;
            }
            assert!(beyond_us <= JOG_LIMIT_US, "{} us", pulse.esc_us);
            let age_us = |since_us: Option<u64>| {
                since_us.map_or(u64::MAX, |since_us| pulse.time_us.saturating_sub(since_us))
            };
            let hand_us = age_us(self.given_us);
            // The last command of a host whose cable is then pulled expires on the board.
            let most_us = match self.pulled_us {
                Some(_) => 300_000 + NEUTRAL_WITHIN_US,
                None => 300_000,
            };
            assert!(hand_us < most_us, "{hand_us} us after the hand let go");
            if self.pulled_us.is_some() {
                let pulled_us = age_us(self.pulled_us);
                assert!(
                    pulled_us <= NEUTRAL_WITHIN_US,
                    "{pulled_us} us without a cable"
                );
            }
            let since_us = *self.driven_since_us.get_or_insert(pulse.time_us);
            let driven_us = pulse.time_us - since_us;
            assert!(driven_us < 10_100_000, "{driven_us} us without a rest");
        }
    }
}

/// Left out of `cargo verify`, not of `--all`: they take seconds of processor time each.
mod thorough {
    use super::*;

    #[test]
    fn a_random_hand_never_leaves_the_bounds_whatever_goes_wrong() {
        let mut jogged = 0;
        for seed in 0..60 {
            let mut hand = Hand::new(seed);
            for _ in 0..4_000 {
                hand.tick();
            }
            jogged += hand.jogged;
        }
        // Otherwise hardly anything was checked.
        assert!(jogged > 30_000, "{jogged} ticks of jogging");
    }
}
