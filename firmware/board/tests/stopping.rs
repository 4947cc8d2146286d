//! Stop causes, and the behaviour of a stop.

use singletrack_protocol::{
    BoardMode, Configuration, EscCalibration, EscKind, FailsafeAction, RefusalReason, StopCause,
};

use crate::{MS, NEUTRAL, Rig, configuration};

const BRAKE: u16 = 1_300;

fn braking() -> Configuration {
    Configuration {
        failsafe: FailsafeAction::Brake,
        ..configuration()
    }
}

fn with_stop_input() -> Configuration {
    Configuration {
        stop_input: true,
        ..configuration()
    }
}

#[test]
fn a_stop_by_the_board_coasts_and_holds_the_last_steering_angle() {
    let mut rig = Rig::driving_with(configuration());
    rig.drive_for(300 * MS, 1_000, 2_500);
    assert_eq!(rig.outputs.servo_us, Some(1_680));
    rig.run(96 * MS);
    assert_eq!(
        (rig.board.mode(), rig.esc_us()),
        (BoardMode::Failsafe, NEUTRAL)
    );
    rig.pulse_period_us = None;
    rig.run(5_000 * MS);
    assert_eq!((rig.outputs.servo_us, rig.esc_us()), (Some(1_680), NEUTRAL));
}

#[test]
fn a_braking_stop_brakes_until_the_wheels_stand_still() {
    let mut rig = Rig::driving_with(braking());
    rig.run(96 * MS);
    assert_eq!(
        (rig.board.mode(), rig.esc_us()),
        (BoardMode::Failsafe, BRAKE)
    );
    rig.run(100 * MS);
    assert_eq!(rig.esc_us(), BRAKE);
    rig.pulse_period_us = None;
    let stood_still_us = rig.now.wrapping_sub(rig.inputs.motor.last_edge_us);
    rig.run(149_999 - stood_still_us);
    assert_eq!(rig.esc_us(), BRAKE);
    rig.run(1);
    assert_eq!(rig.esc_us(), NEUTRAL);
    // Pushed by hand, it does not brake again.
    rig.pulse_period_us = Some(5_000);
    rig.run(900 * MS);
    assert_eq!(rig.esc_us(), NEUTRAL);
}

#[test]
fn a_braking_stop_ends_after_half_a_second() {
    let mut rig = Rig::driving_with(braking());
    rig.run_until(|rig| rig.esc_us() == BRAKE);
    rig.run(498 * MS);
    assert_eq!(rig.esc_us(), BRAKE);
    rig.run(2 * MS);
    assert_eq!(rig.esc_us(), NEUTRAL);
}

#[test]
fn a_stop_at_standstill_does_not_brake() {
    let mut rig = Rig::armed_with(braking());
    rig.drive(0, 0);
    rig.run(96 * MS);
    assert_eq!(
        (rig.board.mode(), rig.esc_us()),
        (BoardMode::Failsafe, NEUTRAL)
    );
}

#[test]
fn a_stop_in_reverse_does_not_brake() {
    let mut configuration = braking();
    configuration.speed.max_reverse_mm_s = 500;
    let mut rig = Rig::armed_with(configuration);
    rig.drive_for(250 * MS, -500, 0);
    rig.pulse_period_us = Some(10_000);
    rig.drive_for(500 * MS, -500, 0);
    assert!(rig.esc_us() < NEUTRAL - 20);
    rig.emergency_stop();
    assert_eq!(rig.esc_us(), NEUTRAL);
}

#[test]
fn disarming_ends_in_neutral_mode() {
    let mut rig = Rig::driving_with(Configuration {
        esc: EscCalibration {
            kind: EscKind::ForwardReverse,
            ..configuration().esc
        },
        ..configuration()
    });
    rig.disarm();
    assert_eq!(
        (rig.board.mode(), rig.esc_us()),
        (BoardMode::Neutral, NEUTRAL)
    );
    assert_eq!(rig.board.stop_cause(), StopCause::Disarmed);
    rig.drive(1_000, 0);
    assert_eq!(rig.esc_us(), NEUTRAL);
}

#[test]
fn an_emergency_stop_is_latched_until_reset() {
    for from in [
        Rig::new(),
        Rig::ready_with(configuration()),
        Rig::armed_with(configuration()),
        Rig::driving_with(configuration()),
    ] {
        let mut rig = from;
        rig.pulse_period_us = None;
        rig.emergency_stop();
        assert_eq!(rig.esc_us(), NEUTRAL);
        for _ in 0..10 {
            rig.run(500 * MS);
            rig.disarm();
            assert_eq!(rig.arm(), Err(RefusalReason::EmergencyStopLatched));
            assert_eq!(
                rig.configure(configuration()),
                Err(RefusalReason::EmergencyStopLatched)
            );
            rig.greet(rig.now);
            rig.drive(1_000, 0);
            assert_eq!(rig.esc_us(), 0);
            assert_eq!(rig.board.mode(), BoardMode::EmergencyStopped);
        }
        assert_eq!(rig.board.stop_cause(), StopCause::EmergencyStop);
    }
}

#[test]
fn an_emergency_stop_gives_the_start_pulse_for_200_ms_and_then_none() {
    // Neither the configured neutral nor the brake is trusted.
    let off = Configuration {
        esc: EscCalibration {
            neutral_us: NEUTRAL + 15,
            ..configuration().esc
        },
        ..braking()
    };
    let mut rig = Rig::driving_with(off);
    rig.emergency_stop();
    for _ in 0..200 {
        assert_eq!(
            (rig.outputs.esc_us, rig.outputs.esc_neutral_us),
            (Some(NEUTRAL), NEUTRAL)
        );
        rig.run(MS);
    }
    for _ in 0..100 {
        assert_eq!(rig.outputs.esc_us, None);
        rig.run(100 * MS);
    }
    assert_eq!(rig.telemetry().esc_us, 0);
    // The wheels are still held straight.
    assert!(rig.outputs.servo_us.is_some());
}

#[test]
fn opening_the_stop_switch_is_an_emergency_stop() {
    let mut rig = Rig::driving_with(with_stop_input());
    rig.inputs.stop_input_open = true;
    rig.run(1);
    assert_eq!(
        (rig.board.mode(), rig.esc_us()),
        (BoardMode::EmergencyStopped, NEUTRAL)
    );
    assert_eq!(rig.board.stop_cause(), StopCause::StopInput);
    assert!(rig.status().stop_input_open);
    assert_eq!(rig.arm(), Err(RefusalReason::StopInputOpen));
    rig.inputs.stop_input_open = false;
    rig.run(MS);
    assert_eq!(rig.arm(), Err(RefusalReason::EmergencyStopLatched));
}

#[test]
fn a_switch_that_was_never_closed_prevents_arming_without_latching() {
    let mut rig = Rig::new();
    rig.inputs.stop_input_open = true;
    rig.poll(&[]);
    assert_eq!(rig.configure(with_stop_input()), Ok(()));
    rig.run(3_000 * MS);
    assert_eq!(rig.arm(), Err(RefusalReason::StopInputOpen));
    assert_eq!(rig.board.mode(), BoardMode::Neutral);
    rig.inputs.stop_input_open = false;
    rig.run(MS);
    assert_eq!(rig.arm(), Ok(()));
    rig.inputs.stop_input_open = true;
    rig.run(MS);
    assert_eq!(rig.board.mode(), BoardMode::EmergencyStopped);
}

#[test]
fn a_new_configuration_requires_a_closed_switch_again() {
    let mut rig = Rig::ready_with(with_stop_input());
    assert_eq!(rig.configure(configuration()), Ok(()));
    rig.inputs.stop_input_open = true;
    rig.run(MS);
    assert_eq!(rig.configure(with_stop_input()), Ok(()));
    rig.run(MS);
    assert_eq!(rig.board.mode(), BoardMode::Neutral);
    assert_eq!(rig.arm(), Err(RefusalReason::StopInputOpen));
}

#[test]
fn an_unconfigured_stop_input_is_ignored() {
    let mut rig = Rig::driving_with(configuration());
    rig.inputs.stop_input_open = true;
    rig.drive_for(300 * MS, 1_000, 0);
    assert_eq!(rig.board.mode(), BoardMode::Driving);
    assert!(!rig.status().stop_input_open);
}

#[test]
fn driving_for_150_ms_without_a_pulse_is_a_failed_sensor() {
    let mut rig = Rig::armed_with(configuration());
    rig.drive(1_000, 0);
    let mut beyond_deadband_since = None;
    for _ in 0..1_000 {
        rig.run(MS);
        rig.drive(1_000, 0);
        if rig.esc_us() > NEUTRAL + 20 {
            beyond_deadband_since.get_or_insert(rig.now);
        }
        let driven = rig.now - beyond_deadband_since.unwrap_or(rig.now);
        assert_eq!(
            driven >= 150 * MS,
            rig.board.mode() == BoardMode::Failsafe,
            "{driven}"
        );
        if rig.board.mode() == BoardMode::Failsafe {
            break;
        }
    }
    assert_eq!(rig.board.stop_cause(), StopCause::MotorSensor);
    assert_eq!(rig.esc_us(), NEUTRAL);
}

#[test]
fn driving_in_bursts_does_not_hide_a_dead_sensor() {
    let mut rig = Rig::armed_with(configuration());
    for burst in 0.. {
        rig.drive_for(140 * MS, 1_000, 0);
        rig.drive_for(10 * MS, 0, 0);
        if rig.board.mode() == BoardMode::Failsafe {
            break;
        }
        assert!(burst < 5, "still driving");
    }
    assert_eq!(rig.board.stop_cause(), StopCause::MotorSensor);
}

#[test]
fn a_pulse_at_the_edge_of_the_deadband_does_not_hide_a_dead_sensor() {
    let mut configuration = configuration();
    configuration.speed.feed_forward_us_per_m_s = 0;
    configuration.speed.proportional_us_per_m_s = 0;
    configuration.speed.integral_us_per_m = 0;
    let mut rig = Rig::armed_with(configuration);
    rig.drive_for(400 * MS, 1_000, 0);
    assert_eq!(rig.board.mode(), BoardMode::Failsafe);
    assert_eq!(rig.board.stop_cause(), StopCause::MotorSensor);
}

#[test]
fn pulses_that_stop_while_driving_are_a_failed_sensor_too() {
    for (silent_us, driving) in [(149_999, true), (150_000, false), (150_001, false)] {
        let mut rig = Rig::driving_with(configuration());
        rig.pulse_period_us = None;
        let mut left = silent_us - (rig.now - rig.inputs.motor.last_edge_us);
        while left > 0 {
            let step = left.min(10 * MS);
            rig.run(step);
            rig.drive(1_000, 0);
            left -= step;
        }
        assert_eq!(
            rig.board.mode() == BoardMode::Driving,
            driving,
            "{silent_us}"
        );
        if !driving {
            assert_eq!(rig.board.stop_cause(), StopCause::MotorSensor);
        }
    }
}

#[test]
fn a_commanded_standstill_is_not_a_failed_sensor() {
    let mut rig = Rig::armed_with(configuration());
    rig.drive_for(2_000 * MS, 0, 0);
    assert_eq!(rig.board.mode(), BoardMode::Driving);
}

#[test]
fn a_new_session_stops_the_car_and_a_repeated_greeting_does_not() {
    let mut rig = Rig::driving_with(configuration());
    rig.greet(77);
    assert_eq!(rig.board.mode(), BoardMode::Driving);
    rig.greet(78);
    assert_eq!(
        (rig.board.mode(), rig.esc_us()),
        (BoardMode::Failsafe, NEUTRAL)
    );
    assert_eq!(rig.board.stop_cause(), StopCause::HostRestarted);
    let mut rig = Rig::armed_with(configuration());
    rig.greet(78);
    assert_eq!(rig.board.mode(), BoardMode::Failsafe);
}

#[test]
fn a_stop_reports_its_cause_and_the_first_latched_cause_is_kept() {
    let mut rig = Rig::driving_with(with_stop_input());
    rig.emergency_stop();
    rig.inputs.stop_input_open = true;
    rig.run(20 * MS);
    let telemetry = rig.telemetry();
    assert_eq!(telemetry.mode, BoardMode::EmergencyStopped);
    assert_eq!(telemetry.stop_cause, StopCause::EmergencyStop);
    assert_eq!(telemetry.esc_us, NEUTRAL);
}
