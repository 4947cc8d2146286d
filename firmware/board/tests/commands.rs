//! Acceptance and lifetime of commands.

use singletrack_protocol::{
    BoardMode, Configuration, Drive, RefusalReason, Sequence, StopCause, ToBoard,
};

use crate::{MS, NEUTRAL, Rig, TTL, configuration};

/// The ESC receives the pulse that begins at each multiple of 20 ms.
const SERVO_FRAME_US: u32 = 20_000;

#[test]
fn the_neutral_pulse_comes_within_120_ms_of_the_last_valid_command() {
    for phase in 0..SERVO_FRAME_US / MS {
        let mut rig = Rig::driving_with(configuration());
        rig.run(phase * MS);
        rig.drive(1_000, 0);
        let (last_command, mut latched) = (rig.now, rig.esc_us());
        while latched != NEUTRAL {
            rig.run(MS);
            if rig.now.is_multiple_of(SERVO_FRAME_US) {
                latched = rig.esc_us();
            }
            assert!(rig.now - last_command <= 120 * MS, "phase {phase} ms");
        }
        assert!(rig.now - last_command > 90 * MS, "stopped too early");
        assert_eq!(rig.board.stop_cause(), StopCause::CommandTimeout);
    }
}

#[test]
fn a_command_is_in_force_exactly_for_its_time_to_live() {
    for (after, driving) in [(TTL - 1, true), (TTL, true), (TTL + 1, false)] {
        let mut rig = Rig::driving_with(configuration());
        rig.drive(1_000, 0);
        assert_eq!(
            rig.outputs.drive_deadline_us,
            Some(rig.now.wrapping_add(TTL))
        );
        rig.run(after);
        assert_eq!(rig.board.mode() == BoardMode::Driving, driving, "{after}");
        assert_eq!(rig.esc_us() > NEUTRAL, driving);
        assert_eq!(rig.outputs.drive_deadline_us.is_some(), driving);
    }
}

#[test]
fn the_transmission_delay_counts_towards_the_time_to_live() {
    for (age, left) in [(0, TTL), (60 * MS, TTL - 60 * MS), (TTL, 0)] {
        let mut rig = Rig::driving_with(configuration());
        let mut command = rig.command(1_000, 0);
        command.telemetry_time_us = rig.now - age;
        rig.send(command);
        rig.run(left);
        assert_eq!(rig.board.mode(), BoardMode::Driving, "{age}");
        rig.run(1);
        assert_eq!(rig.board.mode(), BoardMode::Failsafe, "{age}");
    }
}

#[test]
fn an_expired_command_or_one_in_the_future_is_refused() {
    for (age, accepted) in [
        (0, true),
        (TTL - 1, true),
        (TTL, true),
        (TTL + 1, false),
        (1_000 * MS, false),
        (u32::MAX, false),
        (u32::MAX / 2 + 1, false),
    ] {
        let mut rig = Rig::armed_with(configuration());
        let mut command = rig.command(1_000, 0);
        command.telemetry_time_us = rig.now.wrapping_sub(age);
        if accepted {
            rig.send(command);
            assert_eq!(rig.board.mode(), BoardMode::Driving, "{age}");
        } else {
            assert_eq!(rig.refused(command), RefusalReason::Stale, "{age}");
            assert_eq!(rig.board.mode(), BoardMode::Armed);
        }
    }
}

#[test]
fn commands_released_by_a_stuck_line_do_not_drive() {
    let mut rig = Rig::armed_with(configuration());
    let mut queue = Vec::new();
    // For less than an armed board waits for its first command.
    for _ in 0..850 {
        rig.run(MS);
        queue.push(rig.command(1_000, 800));
    }
    // The newest of them are as old as the time to live.
    rig.run(TTL + 1);
    for command in &queue {
        rig.send(*command);
        assert_eq!(rig.esc_us(), NEUTRAL);
    }
    let mut bytes = Vec::new();
    for command in queue {
        bytes.extend_from_slice(ToBoard::Drive(command).encode().as_bytes());
    }
    rig.poll(&bytes);
    assert_eq!(rig.esc_us(), NEUTRAL);
    assert_eq!(rig.outputs.servo_us, Some(1_480));
    assert_eq!(rig.board.mode(), BoardMode::Armed);
    assert_eq!(rig.status().drives_refused, 2 * 850);
}

#[test]
fn a_stuck_line_stops_the_car_and_its_queue_does_not_restart_it() {
    let mut rig = Rig::driving_with(configuration());
    let mut bytes = Vec::new();
    for sent in 0..976 {
        // It rolls out.
        if sent == 50 {
            rig.pulse_period_us = None;
        }
        rig.run(10 * MS);
        let command = rig.command(1_000, 800);
        bytes.extend_from_slice(ToBoard::Drive(command).encode().as_bytes());
    }
    assert_eq!(rig.board.mode(), BoardMode::Failsafe);
    for chunk in bytes.chunks(12) {
        rig.poll(chunk);
        rig.run(MS);
        assert_eq!(
            (rig.board.mode(), rig.esc_us()),
            (BoardMode::Failsafe, NEUTRAL)
        );
    }
}

#[test]
fn a_command_with_an_old_pose_is_refused() {
    for (pose_age_ms, waited_us, accepted) in [
        (900, 0, true),
        (901, 0, false),
        (899, 1_000, true),
        (899, 1_001, false),
        (850, 50_000, true),
        (850, 50_001, false),
        (u16::MAX, 0, false),
    ] {
        let mut rig = Rig::armed_with(configuration());
        let mut command = rig.command(1_000, 0);
        command.pose_age_ms = pose_age_ms;
        command.telemetry_time_us = rig.now - waited_us;
        if accepted {
            rig.send(command);
            assert_eq!(
                rig.board.mode(),
                BoardMode::Driving,
                "{pose_age_ms} + {waited_us}"
            );
        } else {
            assert_eq!(rig.refused(command), RefusalReason::PoseTooOld);
        }
    }
}

#[test]
fn the_pose_ages_behind_an_accepted_command() {
    for (after, driving) in [(49_999, true), (50_000, true), (50_001, false)] {
        let mut rig = Rig::driving_with(configuration());
        let mut command = rig.command(1_000, 0);
        command.pose_age_ms = 850;
        rig.send(command);
        assert_eq!(rig.outputs.drive_deadline_us, Some(rig.now + 50_000));
        rig.run(after);
        assert_eq!(rig.board.mode() == BoardMode::Driving, driving, "{after}");
        if !driving {
            assert_eq!(rig.board.stop_cause(), StopCause::PoseTooOld);
            assert_eq!(rig.esc_us(), NEUTRAL);
        }
    }
}

#[test]
fn the_first_expiry_is_the_cause_and_a_tie_is_a_command_timeout() {
    let ttl_ms = (TTL / MS) as u16;
    for (pose_left_ms, cause) in [
        (ttl_ms - 1, StopCause::PoseTooOld),
        (ttl_ms, StopCause::CommandTimeout),
        (ttl_ms + 1, StopCause::CommandTimeout),
    ] {
        let mut rig = Rig::driving_with(configuration());
        let mut command = rig.command(1_000, 0);
        command.pose_age_ms = 900 - pose_left_ms;
        rig.send(command);
        rig.run(TTL + 1);
        assert_eq!(rig.board.stop_cause(), cause, "{pose_left_ms}");
    }
}

#[test]
fn repeated_commands_with_one_old_pose_stop_at_the_limit() {
    for limit_ms in [1, 50, 200, 900, 1_000] {
        let configuration = Configuration {
            max_pose_age_ms: limit_ms,
            ..configuration()
        };
        let mut rig = Rig::armed_with(configuration);
        rig.pulse_period_us = Some(5_000);
        let exposure = rig.now;
        while rig.board.mode() != BoardMode::Failsafe {
            let mut command = rig.command(1_000, 0);
            command.pose_age_ms = ((rig.now - exposure).div_ceil(MS)) as u16;
            rig.send(command);
            rig.run(MS);
            assert!(
                rig.now - exposure <= (u32::from(limit_ms) + 2) * MS,
                "{limit_ms}"
            );
        }
        assert!(
            rig.now - exposure > u32::from(limit_ms) * MS,
            "{limit_ms}: too early"
        );
        assert_eq!(rig.board.stop_cause(), StopCause::PoseTooOld, "{limit_ms}");
        assert_eq!(rig.esc_us(), NEUTRAL);
    }
}

#[test]
fn only_a_newer_sequence_number_is_accepted() {
    for (step, accepted) in [
        (0, false),
        (1, true),
        (127, true),
        (128, false),
        (255, false),
    ] {
        let mut rig = Rig::driving_with(configuration());
        let command = rig.command(1_000, 0);
        let sequence = Sequence(rig.board.last_sequence().0.wrapping_add(step));
        let command = Drive {
            sequence,
            ..command
        };
        if accepted {
            rig.send(command);
            assert_eq!(rig.board.last_sequence(), sequence, "{step}");
        } else {
            let before = rig.status().drives_refused;
            rig = Rig::driving_with(configuration());
            let sequence = Sequence(rig.board.last_sequence().0.wrapping_add(step));
            let command = Drive {
                sequence,
                telemetry_time_us: rig.now,
                ..command
            };
            rig.send(command);
            let status = rig.status();
            assert_eq!(status.drives_refused, before + 1, "{step}");
            assert_eq!(status.last_refusal, RefusalReason::OutOfSequence);
        }
    }
}

#[test]
fn a_duplicate_does_not_prolong_a_command() {
    let mut rig = Rig::driving_with(configuration());
    let command = rig.command(1_000, 0);
    let accepted = rig.now;
    for _ in 0..30 {
        rig.send(Drive {
            telemetry_time_us: rig.now,
            ..command
        });
        rig.run(5 * MS);
    }
    assert_eq!(rig.board.mode(), BoardMode::Failsafe);
    assert!(rig.now - accepted > TTL);
}

#[test]
fn a_late_poll_does_not_revive_an_expired_command() {
    let mut rig = Rig::driving_with(configuration());
    rig.now += TTL + 1;
    rig.drive(1_000, 0);
    assert_eq!(
        (rig.board.mode(), rig.esc_us()),
        (BoardMode::Failsafe, NEUTRAL)
    );
}

#[test]
fn the_wrap_of_the_clock_has_no_effect() {
    // The wrap falls before, in and after every phase of the drive.
    for offset in (0..4_000).step_by(151) {
        let mut rig = Rig::starting_at(u32::MAX - offset * MS);
        rig.poll(&[]);
        assert_eq!(rig.configure(configuration()), Ok(()));
        rig.run(2_000 * MS);
        assert_eq!(rig.arm(), Ok(()), "{offset}");
        rig.pulse_period_us = Some(5_000);
        rig.drive_for(600 * MS, 1_000, 300);
        assert_eq!(rig.board.mode(), BoardMode::Driving, "{offset}");
        assert_eq!(rig.telemetry().motor_speed_mm_s, 1_000, "{offset}");
        rig.run(TTL);
        assert_eq!(rig.board.mode(), BoardMode::Driving, "{offset}");
        rig.run(1);
        assert_eq!(rig.board.mode(), BoardMode::Failsafe, "{offset}");
        assert_eq!(rig.status().drives_refused, 0);
    }
}

#[test]
fn two_hours_of_standing_still_have_no_effect() {
    let mut rig = Rig::ready_with(configuration());
    rig.poll_us = 100 * MS;
    rig.run(u32::MAX / 4 * 3);
    rig.run(u32::MAX / 4 * 3);
    rig.poll_us = MS;
    rig.run(10 * MS);
    assert_eq!(rig.telemetry().motor_speed_mm_s, 0);
    assert_eq!(rig.arm(), Ok(()));
    rig.pulse_period_us = Some(5_000);
    rig.drive_for(100 * MS, 1_000, 0);
    assert_eq!(rig.board.mode(), BoardMode::Driving);
}

#[test]
fn reverse_is_refused_unless_enabled() {
    let mut rig = Rig::armed_with(configuration());
    let command = rig.command(-1, 0);
    assert_eq!(rig.refused(command), RefusalReason::ReverseDisabled);
    let mut enabled = configuration();
    enabled.speed.max_reverse_mm_s = 500;
    let mut rig = Rig::armed_with(enabled);
    rig.drive(-1, 0);
    assert_eq!(rig.board.mode(), BoardMode::Driving);
}
