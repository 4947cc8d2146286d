//! Jogging: bare pulses, their limits, and all their ends.

use singletrack_protocol::{
    BoardMode, Configuration, EscCalibration, EscKind, FailsafeAction, JOG_DRIVE_US, JOG_LIMIT_US,
    JOG_SPEED_MM_S, RefusalReason, StopCause, ToBoard,
};

use crate::{MS, NEUTRAL, Rig, TTL, configuration};

const STRAIGHT: u16 = 1_480;

/// The ESC receives the pulse that begins at each multiple of 20 ms.
const SERVO_FRAME_US: u32 = 20_000;

/// Jogs at a pulse that turns the wheels, which turn.
fn jogging_with(configuration: Configuration) -> Rig {
    let mut rig = Rig::armed_with(configuration);
    rig.jog(STRAIGHT, 1_560);
    rig.pulse_period_us = Some(20 * MS);
    rig.jog_for(300 * MS, STRAIGHT, 1_560);
    assert_eq!(rig.board.mode(), BoardMode::Jogging);
    assert_eq!(rig.esc_us(), 1_560);
    rig
}

fn jogging() -> Rig {
    jogging_with(configuration())
}

#[test]
fn pulses_are_given_as_they_are_slowly_within_the_limits() {
    let mut rig = Rig::armed_with(configuration());
    rig.jog(1_600, 1_600);
    rig.jog_for(20 * MS, 1_600, 1_600);
    let (servo, esc) = (rig.outputs.servo_us.unwrap_or(0), rig.esc_us());
    assert!((STRAIGHT + 90..=STRAIGHT + 101).contains(&servo), "{servo}");
    assert!((NEUTRAL + 55..=NEUTRAL + 61).contains(&esc), "{esc}");
    rig.jog_for(100 * MS, 1_600, 1_600);
    assert_eq!(rig.outputs.servo_us, Some(1_600));
    assert_eq!(rig.esc_us(), 1_600);
    // Towards neutral it changes at once, as in a drive.
    rig.jog(1_600, 1_540);
    assert_eq!(rig.esc_us(), 1_540);
    rig.jog_for(100 * MS, 1_600, 1_600);
    assert_eq!(rig.esc_us(), 1_600);
    // Towards neutral at once, and from one side to the other through it.
    rig.jog(1_600, 1_400);
    assert!((NEUTRAL - 5..=NEUTRAL).contains(&rig.esc_us()));
    rig.jog_for(100 * MS, 0, 1_400);
    assert_eq!(rig.esc_us(), 1_400);
    rig.jog_for(200 * MS, 0, NEUTRAL);
    assert_eq!(rig.esc_us(), NEUTRAL);
    assert_eq!(rig.outputs.servo_us, Some(1_100), "its limit");
}

#[test]
fn the_motor_gets_at_most_150_us_from_neutral_and_the_limits_of_the_esc() {
    for (jog_us, pulse_us) in [
        (u16::MAX, NEUTRAL + JOG_LIMIT_US),
        (1_651, 1_650),
        (0, NEUTRAL - JOG_LIMIT_US),
        (1_349, 1_350),
    ] {
        let mut rig = Rig::armed_with(configuration());
        rig.jog(STRAIGHT, jog_us);
        rig.jog_for(200 * MS, STRAIGHT, jog_us);
        assert_eq!(rig.esc_us(), pulse_us);
    }
    for (jog_us, pulse_us) in [(u16::MAX, 1_590), (0, 1_410)] {
        let configuration = Configuration {
            esc: EscCalibration {
                min_us: 1_410,
                brake_us: 1_420,
                max_us: 1_590,
                ..configuration().esc
            },
            ..configuration()
        };
        let mut rig = Rig::armed_with(configuration);
        rig.jog(STRAIGHT, jog_us);
        rig.jog_for(200 * MS, STRAIGHT, jog_us);
        assert_eq!(rig.esc_us(), pulse_us);
    }
}

#[test]
fn the_neutral_pulse_comes_within_120_ms_of_the_last_pulses() {
    for phase in 0..SERVO_FRAME_US / MS {
        let mut rig = jogging();
        rig.run(phase * MS);
        rig.jog(STRAIGHT, 1_560);
        let (last, mut latched) = (rig.now, rig.esc_us());
        while latched != NEUTRAL {
            rig.run(MS);
            if rig.now.is_multiple_of(SERVO_FRAME_US) {
                latched = rig.esc_us();
            }
            assert!(rig.now - last <= 120 * MS, "phase {phase} ms");
        }
        assert!(rig.now - last > 90 * MS, "stopped too early");
        assert_eq!(rig.board.stop_cause(), StopCause::JogTimeout);
        assert_eq!(rig.board.mode(), BoardMode::Failsafe);
    }
}

#[test]
fn the_delay_of_the_line_counts_towards_the_time_to_live() {
    for (age, left) in [(0, TTL), (60 * MS, TTL - 60 * MS), (TTL, 0)] {
        let mut rig = jogging();
        let mut jog = rig.jog_command(STRAIGHT, 1_560);
        jog.telemetry_time_us = rig.now - age;
        rig.send(jog);
        assert_eq!(
            rig.outputs.drive_deadline_us,
            Some(rig.now.wrapping_add(left))
        );
        rig.run(left);
        assert_eq!(rig.board.mode(), BoardMode::Jogging, "{age}");
        rig.run(1);
        assert_eq!(rig.board.mode(), BoardMode::Failsafe, "{age}");
    }
}

#[test]
fn old_pulses_pulses_from_the_future_and_repeated_ones_are_refused() {
    for age in [TTL + 1, 1_000 * MS, u32::MAX] {
        let mut rig = Rig::armed_with(configuration());
        let mut jog = rig.jog_command(STRAIGHT, 1_560);
        jog.telemetry_time_us = rig.now.wrapping_sub(age);
        assert_eq!(rig.refused(jog), RefusalReason::Stale);
        assert_eq!(rig.esc_us(), NEUTRAL);
    }
    let mut rig = jogging();
    let mut jog = rig.jog_command(STRAIGHT, 1_560);
    jog.sequence = rig.board.last_sequence();
    assert_eq!(rig.refused(jog), RefusalReason::OutOfSequence);
}

#[test]
fn a_board_that_is_not_armed_refuses_pulses() {
    let mut rig = Rig::ready_with(configuration());
    let jog = rig.jog_command(STRAIGHT, 1_560);
    assert_eq!(rig.refused(jog), RefusalReason::NotArmed);
    let kill_output = Configuration {
        kill_output: true,
        ..configuration()
    };
    let mut rig = Rig::ready_with(kill_output);
    assert_eq!(rig.arm(), Ok(()));
    let jog = rig.jog_command(STRAIGHT, 1_560);
    assert_eq!(rig.refused(jog), RefusalReason::NotYetNeutral);
    rig.run(1_900 * MS);
    assert_eq!(rig.board.mode(), BoardMode::Armed);
    rig.jog(STRAIGHT, 1_560);
    assert_eq!(rig.board.mode(), BoardMode::Jogging);
    assert!(rig.outputs.power_on);
    rig.run(TTL + 1);
    assert!(!rig.outputs.power_on);
    rig.emergency_stop();
    let jog = rig.jog_command(STRAIGHT, 1_560);
    assert_eq!(rig.refused(jog), RefusalReason::EmergencyStopLatched);
}

#[test]
fn a_drive_and_jogging_exclude_each_other_until_the_board_is_armed_again() {
    let mut rig = jogging();
    let drive = rig.command(1_000, 0);
    rig.send(drive);
    assert_eq!(rig.board.mode(), BoardMode::Jogging);
    assert_eq!(rig.refused(drive), RefusalReason::Busy);

    let mut rig = Rig::driving_with(configuration());
    rig.drive(1_000, 0);
    let jog = rig.jog_command(1_900, 1_650);
    rig.send(jog);
    assert_eq!(rig.board.mode(), BoardMode::Driving);
    assert_eq!(rig.refused(jog), RefusalReason::Busy);
    assert_eq!(rig.outputs.servo_us, Some(STRAIGHT));

    rig.disarm();
    rig.pulse_period_us = None;
    rig.run(3_000 * MS);
    assert_eq!(rig.arm(), Ok(()));
    rig.jog(STRAIGHT, 1_560);
    assert_eq!(rig.board.mode(), BoardMode::Jogging);
}

#[test]
fn pulses_need_no_pose() {
    let never_seen = Configuration {
        max_pose_age_ms: 1,
        ..configuration()
    };
    let mut rig = jogging_with(never_seen);
    rig.jog_for(2_000 * MS, STRAIGHT, 1_560);
    assert_eq!(rig.board.mode(), BoardMode::Jogging);
}

#[test]
fn no_configuration_and_no_second_arm_is_taken_while_jogging() {
    let mut rig = jogging();
    rig.jog(STRAIGHT, 1_560);
    assert_eq!(rig.configure(configuration()), Err(RefusalReason::Busy));
    rig.jog(STRAIGHT, 1_560);
    assert_eq!(rig.arm(), Err(RefusalReason::Busy));
    assert_eq!(rig.board.mode(), BoardMode::Jogging);
}

#[test]
fn wheels_faster_than_1_m_s_end_it_at_once() {
    for (period, ends) in [(5_100, false), (4_900, true)] {
        let mut rig = jogging();
        rig.pulse_period_us = Some(period);
        rig.jog_for(500 * MS, STRAIGHT, 1_560);
        assert_eq!(rig.board.mode() == BoardMode::Failsafe, ends, "{period}");
        if ends {
            assert_eq!(rig.board.stop_cause(), StopCause::JogTooFast);
            assert_eq!(rig.esc_us(), NEUTRAL);
        }
    }
    assert_eq!(JOG_SPEED_MM_S, 1_000);
}

#[test]
fn ten_seconds_of_pulses_end_it_also_below_the_deadband() {
    for esc_us in [1_560, NEUTRAL + 1, NEUTRAL - 1] {
        let mut rig = Rig::armed_with(configuration());
        let begin = rig.now;
        if esc_us == 1_560 {
            rig.pulse_period_us = Some(20 * MS);
        }
        rig.jog(STRAIGHT, esc_us);
        while rig.board.mode() == BoardMode::Jogging {
            rig.jog_for(10 * MS, STRAIGHT, esc_us);
        }
        let after = rig.now - begin;
        assert!(
            (JOG_DRIVE_US..=JOG_DRIVE_US + 30 * MS).contains(&after),
            "{after}"
        );
        assert_eq!(rig.board.stop_cause(), StopCause::JogTooLong);
        assert_eq!(rig.esc_us(), NEUTRAL);
    }
}

#[test]
fn steering_alone_has_no_end_and_a_rest_at_neutral_begins_the_time_again() {
    let mut rig = Rig::armed_with(configuration());
    rig.jog(1_400, NEUTRAL);
    rig.jog_for(30_000 * MS, 1_400, NEUTRAL);
    assert_eq!(rig.board.mode(), BoardMode::Jogging);
    for _ in 0..3 {
        rig.pulse_period_us = Some(20 * MS);
        rig.jog_for(9_500 * MS, STRAIGHT, 1_560);
        rig.pulse_period_us = None;
        rig.jog_for(500 * MS, STRAIGHT, NEUTRAL);
        assert_eq!(rig.board.mode(), BoardMode::Jogging);
    }
    // Neutral while the wheels roll on is no rest.
    rig.pulse_period_us = Some(20 * MS);
    rig.jog_for(6_000 * MS, STRAIGHT, 1_560);
    rig.jog_for(500 * MS, STRAIGHT, NEUTRAL);
    rig.jog_for(4_000 * MS, STRAIGHT, 1_560);
    assert_eq!(rig.board.stop_cause(), StopCause::JogTooLong);
}

#[test]
fn a_dead_sensor_ends_it_after_0_6_s_in_either_direction() {
    for esc_us in [1_560, 1_440] {
        let mut rig = Rig::armed_with(configuration());
        let begin = rig.now;
        rig.jog(STRAIGHT, esc_us);
        while rig.board.mode() == BoardMode::Jogging {
            rig.jog_for(10 * MS, STRAIGHT, esc_us);
        }
        let after = rig.now - begin;
        assert!((590 * MS..=640 * MS).contains(&after), "{after}");
        assert_eq!(rig.board.stop_cause(), StopCause::MotorSensor);
        assert_eq!(rig.esc_us(), NEUTRAL);
    }
}

#[test]
fn wheels_that_turn_within_the_configured_deadband_are_no_fault_while_they_are_jogged() {
    let mut rig = Rig::armed_with(configuration());
    rig.pulse_period_us = Some(20 * MS);
    rig.jog(STRAIGHT, NEUTRAL + 15);
    rig.jog_for(8_000 * MS, STRAIGHT, NEUTRAL + 15);
    assert_eq!(rig.board.mode(), BoardMode::Jogging);
}

#[test]
fn wheels_that_go_on_at_neutral_latch() {
    let mut rig = jogging();
    for _ in 0..1_000 {
        rig.jog_for(10 * MS, STRAIGHT, NEUTRAL);
    }
    assert_eq!(rig.board.mode(), BoardMode::EmergencyStopped);
    assert_eq!(rig.board.stop_cause(), StopCause::RunsAtNeutral);
    assert_eq!(rig.outputs.esc_us, None);
}

#[test]
fn every_end_is_neutral_without_a_brake() {
    type End = fn(&mut Rig);
    let ends: [(End, BoardMode, StopCause); 5] = [
        (Rig::disarm, BoardMode::Neutral, StopCause::Disarmed),
        (
            Rig::emergency_stop,
            BoardMode::EmergencyStopped,
            StopCause::EmergencyStop,
        ),
        (
            |rig| rig.run(TTL + 1),
            BoardMode::Failsafe,
            StopCause::JogTimeout,
        ),
        (
            |rig| rig.greet(99),
            BoardMode::Failsafe,
            StopCause::HostRestarted,
        ),
        (
            |rig| {
                rig.inputs.stop_input_open = true;
                rig.run(MS);
            },
            BoardMode::EmergencyStopped,
            StopCause::StopInput,
        ),
    ];
    for kind in [EscKind::Car, EscKind::Vesc, EscKind::ForwardReverse] {
        for (end, mode, cause) in ends {
            let mut configuration = configuration();
            configuration.esc.kind = kind;
            configuration.failsafe = if kind.has_brake() {
                FailsafeAction::Brake
            } else {
                FailsafeAction::Coast
            };
            configuration.stop_input = true;
            let mut rig = jogging_with(configuration);
            // Fast enough to be braked, if it were a drive.
            rig.pulse_period_us = Some(10 * MS);
            rig.jog_for(500 * MS, STRAIGHT, 1_600);
            end(&mut rig);
            assert_eq!((rig.board.mode(), rig.board.stop_cause()), (mode, cause));
            for _ in 0..100 {
                assert_eq!(rig.esc_us(), NEUTRAL, "{kind:?} {cause:?}");
                rig.run(MS);
            }
        }
    }
}

#[test]
fn jogging_from_the_poll_in_which_a_brake_ends_does_not_brake() {
    let mut rig = Rig::driving_with(Configuration {
        failsafe: FailsafeAction::Brake,
        ..configuration()
    });
    rig.run(TTL + 1);
    assert_eq!(rig.board.mode(), BoardMode::Failsafe);
    assert_eq!(rig.esc_us(), 1_300, "brakes");
    rig.pulse_period_us = None;
    // The wheels have stood for long enough when the requests arrive together.
    rig.now = rig.now.wrapping_add(400 * MS);
    let requests = [
        ToBoard::from(rig.arm_request()).encode(),
        ToBoard::from(rig.jog_command(STRAIGHT, 1_560)).encode(),
    ];
    let bytes: Vec<u8> = requests
        .iter()
        .flat_map(|request| request.as_bytes().iter().copied())
        .collect();
    rig.poll(&bytes);
    assert_eq!(rig.board.mode(), BoardMode::Jogging);
    for _ in 0..50 {
        assert!(rig.esc_us() >= NEUTRAL, "{}", rig.esc_us());
        rig.jog_for(10 * MS, STRAIGHT, 1_560);
    }
    assert_eq!(rig.esc_us(), 1_560);
}

#[test]
fn the_speed_has_the_sign_of_the_last_pulse_and_a_drive_starts_forward_after_it() {
    let mut rig = Rig::armed_with(configuration());
    rig.jog(STRAIGHT, 1_440);
    rig.pulse_period_us = Some(20 * MS);
    rig.jog_for(300 * MS, STRAIGHT, 1_440);
    assert!(rig.board.motor_speed_mm_s() < 0);
    rig.jog_for(50 * MS, STRAIGHT, NEUTRAL);
    assert!(rig.board.motor_speed_mm_s() < 0);
    rig.jog_for(50 * MS, STRAIGHT, 1_560);
    assert!(rig.board.motor_speed_mm_s() > 0);
    rig.jog_for(50 * MS, STRAIGHT, 1_440);
    rig.disarm();
    rig.pulse_period_us = None;
    rig.run(3_000 * MS);
    assert_eq!(rig.arm(), Ok(()));
    rig.drive_for(100 * MS, 1_000, 0);
    assert!(rig.esc_us() > NEUTRAL);
}
