//! Conditions for arming.

use singletrack_protocol::{
    Arm, BoardMode, Configuration, EscCalibration, Hello, RefusalReason, Sequence, StopCause,
    VERSION,
};

use crate::{MS, NEUTRAL, Rig, TTL, configuration};

#[test]
fn before_configuration_the_esc_is_neutral_and_the_servo_silent() {
    let mut rig = Rig::new();
    assert_eq!((rig.outputs.servo_us, rig.esc_us()), (None, NEUTRAL));
    for _ in 0..3_000 {
        rig.run(MS);
        rig.drive(1_000, 500);
        let outputs = rig.outputs;
        assert_eq!((outputs.servo_us, outputs.esc_us), (None, Some(NEUTRAL)));
        assert_eq!(outputs.drive_deadline_us, None);
    }
    assert_eq!(rig.arm(), Err(RefusalReason::NotConfigured));
}

#[test]
fn before_arming_the_esc_is_neutral_and_the_servo_centred() {
    let mut rig = Rig::ready_with(configuration());
    for _ in 0..3_000 {
        rig.run(MS);
        rig.drive(1_000, 500);
        assert_eq!((rig.outputs.servo_us, rig.esc_us()), (Some(1_480), NEUTRAL));
    }
    let command = rig.command(1_000, 0);
    assert_eq!(rig.refused(command), RefusalReason::NotArmed);
}

#[test]
fn neutral_is_held_for_two_seconds_before_the_board_arms() {
    for (held_us, outcome) in [
        (1_999_999, Err(RefusalReason::NotYetNeutral)),
        (2_000_000, Ok(())),
        (2_000_001, Ok(())),
    ] {
        let mut rig = Rig::new();
        rig.poll(&[]);
        assert_eq!(rig.configure(configuration()), Ok(()));
        rig.run(held_us);
        let ready = outcome.is_ok();
        let mode = if ready {
            BoardMode::Neutral
        } else {
            BoardMode::Boot
        };
        assert_eq!(rig.board.mode(), mode);
        assert_eq!(rig.arm(), outcome, "{held_us}");
    }
}

#[test]
fn a_new_neutral_pulse_is_held_for_two_seconds() {
    let mut rig = Rig::new();
    rig.run(3_000 * MS);
    assert_eq!(rig.board.mode(), BoardMode::Neutral);
    let esc = EscCalibration {
        neutral_us: 1_520,
        ..configuration().esc
    };
    assert_eq!(
        rig.configure(Configuration {
            esc,
            ..configuration()
        }),
        Ok(())
    );
    assert_eq!(rig.esc_us(), 1_520);
    assert_eq!(rig.board.mode(), BoardMode::Boot);
    assert_eq!(rig.arm(), Err(RefusalReason::NotYetNeutral));
    rig.run(2_000 * MS);
    assert_eq!(rig.arm(), Ok(()));
}

#[test]
fn a_new_neutral_pulse_after_a_failsafe_is_held_for_two_seconds() {
    let mut rig = Rig::armed_with(configuration());
    rig.drive(0, 0);
    rig.run(TTL + 1);
    assert_eq!(rig.board.mode(), BoardMode::Failsafe);
    let mut other = configuration();
    other.esc.neutral_us = 1_520;
    assert_eq!(rig.configure(other), Ok(()));
    rig.run(1_999 * MS);
    assert_eq!(rig.arm(), Err(RefusalReason::NotYetNeutral));
    rig.run(MS);
    assert_eq!(rig.arm(), Ok(()));
}

#[test]
fn an_arm_request_must_name_the_configuration_in_force() {
    let mut rig = Rig::ready_with(configuration());
    let right = rig.arm_request();
    let wrong = Arm {
        configuration_hash: right.configuration_hash ^ 1,
        ..right
    };
    assert_eq!(rig.arm_as(wrong), Err(RefusalReason::ConfigurationDiffers));
    assert_eq!(rig.arm_as(right), Ok(()));
    assert_eq!(rig.board.mode(), BoardMode::Armed);
    assert_eq!(rig.esc_us(), NEUTRAL);
}

#[test]
fn a_delayed_request_does_not_arm() {
    for (age, outcome) in [
        (TTL - 1, Ok(())),
        (TTL, Ok(())),
        (TTL + 1, Err(RefusalReason::Stale)),
        (10_000 * MS, Err(RefusalReason::Stale)),
        // In the future.
        (u32::MAX, Err(RefusalReason::Stale)),
    ] {
        let mut rig = Rig::ready_with(configuration());
        let arm = rig.arm_request();
        let arm = Arm {
            telemetry_time_us: rig.now.wrapping_sub(age),
            ..arm
        };
        assert_eq!(rig.arm_as(arm), outcome, "{age}");
    }
}

#[test]
fn the_board_does_not_arm_while_the_wheels_turn() {
    for (still_us, outcome) in [
        (149_999, Err(RefusalReason::Moving)),
        (150_000, Ok(())),
        (150_001, Ok(())),
    ] {
        let mut rig = Rig::ready_with(configuration());
        rig.inputs.motor.count += 1;
        rig.inputs.motor.last_edge_us = rig.now;
        rig.poll(&[]);
        assert_eq!(rig.arm(), Err(RefusalReason::Moving));
        rig.run(still_us);
        assert_eq!(rig.arm(), outcome, "{still_us}");
    }
}

#[test]
fn a_repeated_request_is_acknowledged_but_does_not_rearm() {
    let mut rig = Rig::ready_with(configuration());
    let arm = rig.arm_request();
    assert_eq!(rig.arm_as(arm), Ok(()));
    rig.pulse_period_us = Some(5_000);
    rig.drive(1_000, 0);
    assert_eq!(rig.arm_as(arm), Ok(()));
    assert_eq!(rig.board.mode(), BoardMode::Driving);
    assert_eq!(rig.arm(), Err(RefusalReason::Busy));
    rig.pulse_period_us = None;
    rig.run(300 * MS);
    assert_eq!(rig.board.mode(), BoardMode::Failsafe);
    let late = Arm {
        telemetry_time_us: rig.now,
        ..arm
    };
    assert_eq!(rig.arm_as(late), Err(RefusalReason::OutOfSequence));
    assert_eq!(rig.arm(), Ok(()));
}

#[test]
fn a_new_session_may_reuse_a_request_number() {
    let mut rig = Rig::ready_with(configuration());
    let arm = rig.arm_request();
    assert_eq!(rig.arm_as(arm), Ok(()));
    rig.greet(1_234);
    rig.run(20 * MS);
    let arm = Arm {
        telemetry_time_us: rig.now,
        ..arm
    };
    assert_eq!(rig.arm_as(arm), Ok(()));
}

#[test]
fn a_request_sent_before_a_stop_does_not_arm() {
    for (before, outcome) in [(1, Err(RefusalReason::Stale)), (0, Ok(()))] {
        let mut rig = Rig::armed_with(configuration());
        rig.drive(0, 0);
        rig.run(TTL + 1);
        assert_eq!(rig.board.mode(), BoardMode::Failsafe);
        let stopped = rig.now;
        rig.run(20 * MS);
        let arm = rig.arm_request();
        let arm = Arm {
            telemetry_time_us: stopped - before,
            ..arm
        };
        assert_eq!(rig.arm_as(arm), outcome, "{before}");
    }
}

#[test]
fn after_a_failsafe_driving_requires_arming() {
    let mut rig = Rig::driving_with(configuration());
    rig.pulse_period_us = None;
    rig.run(300 * MS);
    assert_eq!(rig.board.mode(), BoardMode::Failsafe);
    for _ in 0..100 {
        rig.run(10 * MS);
        rig.drive(1_000, 0);
        assert_eq!(
            (rig.board.mode(), rig.esc_us()),
            (BoardMode::Failsafe, NEUTRAL)
        );
    }
    rig.disarm();
    assert_eq!(rig.board.mode(), BoardMode::Failsafe);
    assert_eq!(rig.arm(), Ok(()));
    rig.drive(1_000, 0);
    assert_eq!(rig.board.mode(), BoardMode::Driving);
}

#[test]
fn the_board_is_not_configured_while_armed_or_driving() {
    let mut rig = Rig::armed_with(configuration());
    let other = Configuration {
        max_pose_age_ms: 100,
        ..configuration()
    };
    assert_eq!(rig.configure(other), Err(RefusalReason::Busy));
    rig.pulse_period_us = Some(5_000);
    rig.drive(1_000, 0);
    assert_eq!(rig.configure(other), Err(RefusalReason::Busy));
    assert_eq!(rig.board.configuration(), Some(&configuration()));
    rig.run(200 * MS);
    assert_eq!(rig.board.mode(), BoardMode::Failsafe);
    assert_eq!(rig.configure(other), Ok(()));
    assert_eq!(rig.board.configuration(), Some(&other));
}

#[test]
fn an_invalid_configuration_is_refused_and_the_old_one_kept() {
    let mut rig = Rig::ready_with(configuration());
    let wrong = Configuration {
        max_pose_age_ms: 1_001,
        ..configuration()
    };
    assert_eq!(
        rig.configure(wrong),
        Err(RefusalReason::InvalidConfiguration)
    );
    assert_eq!(rig.board.configuration(), Some(&configuration()));
    let mut new = Rig::new();
    new.poll(&[]);
    assert_eq!(
        new.configure(wrong),
        Err(RefusalReason::InvalidConfiguration)
    );
    assert_eq!(new.outputs.servo_us, None);
    assert_eq!(new.status().configuration_hash, 0);
}

#[test]
fn a_host_of_another_version_can_stop_but_not_configure_or_arm() {
    let mut rig = Rig::driving_with(configuration());
    rig.send(Hello {
        protocol_version: VERSION + 1,
        software_version: [0; 3],
        nonce: 5,
    });
    assert_eq!(rig.board.stop_cause(), StopCause::HostRestarted);
    rig.pulse_period_us = None;
    rig.run(500 * MS);
    assert_eq!(rig.arm(), Err(RefusalReason::VersionDiffers));
    assert_eq!(
        rig.configure(configuration()),
        Err(RefusalReason::VersionDiffers)
    );
    rig.greet(6);
    assert_eq!(rig.arm(), Ok(()));
}

#[test]
fn arming_restarts_the_sequence() {
    let mut rig = Rig::driving_with(configuration());
    let last = rig.board.last_sequence();
    rig.pulse_period_us = None;
    rig.disarm();
    rig.run(200 * MS);
    assert_eq!(rig.arm(), Ok(()));
    let mut command = rig.command(500, 0);
    command.sequence = Sequence(last.0.wrapping_sub(5));
    rig.send(command);
    assert_eq!(rig.board.last_sequence(), command.sequence);
}

#[test]
fn an_armed_board_waits_for_its_first_command_for_a_second() {
    let mut rig = Rig::armed_with(configuration());
    rig.run(999 * MS);
    assert_eq!(rig.board.mode(), BoardMode::Armed);
    rig.drive(0, 0);
    assert_eq!(rig.board.mode(), BoardMode::Driving);

    let mut rig = Rig::armed_with(configuration());
    rig.run(1_000 * MS);
    assert_eq!(rig.board.mode(), BoardMode::Failsafe);
    assert_eq!(rig.board.stop_cause(), StopCause::CommandTimeout);
    rig.drive(1_000, 0);
    assert_eq!(rig.board.mode(), BoardMode::Failsafe);
    // The next arm begins a second of its own.
    rig.run(5_000 * MS);
    assert_eq!(rig.arm(), Ok(()));
    rig.run(900 * MS);
    assert_eq!(rig.board.mode(), BoardMode::Armed);
}
