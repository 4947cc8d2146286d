//! Faults that need the image: hangs, the watchdog, the bus, the receiver.

use proptest::prelude::*;
use singletrack_protocol::{
    BoardMode, EmergencyStop, ImuState, ResetCause, StopCause, ToBoard, UNSOLICITED,
};
use singletrack_sim::{BusFault, Hang, PulseRecord, ScriptedDrive, WireFaults};

use super::{armed, config, driving, is_within, is_within_limits, limits, pulses_since};

const NEUTRAL_US: u16 = 1_500;

/// Time from `since_us` to the pulse from which on the motor is not driven, in ms.
fn neutral_after_ms(drive: &ScriptedDrive, since_us: u64) -> f64 {
    let neutral = drive
        .world
        .board
        .pulses
        .neutral_from(since_us, NEUTRAL_US, 0)
        .unwrap();
    (neutral.time_us - since_us) as f64 * 1e-3
}

#[test]
fn a_hung_main_loop_gives_neutral_within_45_ms_and_a_reset_within_110() {
    // At every phase of the servo frame, and of the control period.
    for phase_ms in 0..20 {
        let mut drive = driving(1);
        drive.run_ms(phase_ms);
        drive.world.board.hang(Hang::MainLoop);
        let hung_us = drive.world.now_us;
        let (mut reset_us, mut ticks) = (None, 0);
        while reset_us.is_none() {
            drive.drive(1, 400, 500, |_| {});
            ticks += 1;
            assert!(ticks < 20, "no reset");
            if drive.world.board.resets == 1 {
                reset_us = drive
                    .world
                    .board
                    .pulses
                    .iter()
                    .find(|pulse| pulse.time_us >= hung_us && pulse.esc_us == 0)
                    .map(|pulse| pulse.time_us);
            }
        }
        let neutral = neutral_after_ms(&drive, hung_us);
        let reset = (reset_us.unwrap() - hung_us) as f64 * 1e-3;
        assert!(neutral <= 45.0, "phase {phase_ms} ms: {neutral} ms");
        // Neutral from the supervisor, not from the reset that ends the pulses.
        assert!(neutral < reset, "phase {phase_ms} ms: {neutral} {reset}");
        assert!(reset <= 110.0, "phase {phase_ms} ms: reset {reset} ms");
    }
}

#[test]
fn a_watchdog_reset_is_reported_and_requires_arming() {
    let mut drive = driving(1);
    drive.host.hellos.clear();
    drive.world.board.hang(Hang::MainLoop);
    let hung_us = drive.world.now_us;
    // A host that has not noticed keeps sending commands for ten seconds.
    drive.drive(1_000, 400, 500, |_| {});
    assert_eq!(drive.host.hellos.first().unwrap().nonce, UNSOLICITED);
    let status = drive.host.status.unwrap();
    assert_eq!(status.reset_cause, ResetCause::Watchdog);
    assert_eq!(status.configuration_hash, 0);
    assert_eq!(drive.host.mode(), Some(BoardMode::Neutral));
    assert_eq!(drive.world.truth().wheel_speed, 0.0);
    let later = pulses_since(&drive, hung_us + 110_000);
    assert!(later.len() > 400);
    // The servo is silent until it is configured again.
    let silent = |pulse: &PulseRecord| pulse.servo_us == 0 && pulse.esc_us == NEUTRAL_US;
    assert!(later.iter().all(silent));
    drive.prepare();
    assert_eq!(drive.host.mode(), Some(BoardMode::Armed));
    drive.drive(100, 400, 0, |_| {});
    assert_eq!(drive.host.mode(), Some(BoardMode::Driving));
    assert!(drive.world.truth().wheel_speed > 0.3);
    assert_eq!(drive.world.board.resets, 1);
}

#[test]
fn with_interrupts_disabled_the_watchdog_ends_the_drive() {
    let mut drive = driving(1);
    drive.world.board.hang(Hang::Everything);
    let hung_us = drive.world.now_us;
    drive.drive(30, 400, 500, |_| {});
    assert_eq!(drive.world.board.resets, 1);
    let neutral = neutral_after_ms(&drive, hung_us);
    assert!(neutral <= 110.0, "{neutral} ms");
}

#[test]
fn a_pulse_guard_without_ticks_or_pulses_is_reset_however_often_the_host_asks_to_stop() {
    // Every frame wakes the main loop, which polls the board and publishes its neutral pulse.
    // Nobody writes that to the timer.
    for hang in [Hang::Ticks, Hang::Pulses] {
        let mut drive = driving(1);
        drive.world.board.hang(hang);
        let hung_us = drive.world.now_us;
        let mut reset_ms = None;
        for ms in (0..1_000).step_by(10) {
            let request = drive.host.next_sequence();
            drive.send(&ToBoard::EmergencyStop(EmergencyStop { request }));
            drive.run_ms(10);
            if drive.world.board.resets > 0 {
                reset_ms.get_or_insert(ms + 10);
            }
        }
        assert!(
            reset_ms.is_some_and(|ms| ms <= 110),
            "{hang:?}: {reset_ms:?} ms"
        );
        assert_eq!(drive.world.board.resets, 1, "{hang:?}");
        let neutral = neutral_after_ms(&drive, hung_us);
        assert!(neutral <= 110.0, "{hang:?}: {neutral} ms");
    }
}

/// Resolution of the times of resets: the image runs in steps of a millisecond.
const RESET_RESOLUTION_US: u64 = 1_000;

/// Checks every pulse independently of its mark as cut. Returns the number of
/// pulses outside the limits.
fn cut_by_resets(drive: &ScriptedDrive) -> usize {
    let pulses: Vec<PulseRecord> = drive.world.board.pulses.iter().copied().collect();
    let mut outside = 0;
    for (place, pulse) in pulses.iter().enumerate() {
        assert!(is_within_limits(pulse), "{pulse:?}");
        let [servo, esc] = limits();
        for (width_us, limits) in [(pulse.servo_us, servo), (pulse.esc_us, esc)] {
            if is_within(width_us, limits) {
                continue;
            }
            outside += 1;
            assert!(width_us < limits[0], "{pulse:?}");
            // The next record is the end of the pulses by the reset.
            let reset = pulses[place + 1];
            assert_eq!((reset.servo_us, reset.esc_us), (0, 0), "{pulse:?}");
            let end_us = pulse.time_us + u64::from(width_us);
            // Both times are rounded up to a microsecond, and the width is by the
            // board's clock, which is up to 0.5 % off.
            let tolerance_us = 2 + u64::from(width_us) / 200;
            assert!(
                end_us <= reset.time_us + tolerance_us,
                "{pulse:?} {reset:?}"
            );
            assert!(
                end_us + tolerance_us + RESET_RESOLUTION_US >= reset.time_us,
                "{pulse:?} {reset:?}"
            );
        }
    }
    outside
}

#[test]
fn only_resets_cut_pulses_below_the_limits() {
    let (mut cut_by_line, mut cut_by_watchdog) = (0, 0);
    for phase_ms in 0..20 {
        let mut drive = driving(1);
        drive.run_ms(phase_ms);
        drive.world.reset_board(ResetCause::BrownOut);
        drive.drive(30, 400, 500, |_| {});
        assert_eq!(drive.world.board.resets, 1);
        cut_by_line += cut_by_resets(&drive);
        assert_eq!(drive.world.board.pulse_jitter_us(), Some(0.0));

        let mut drive = driving(1);
        drive.run_ms(phase_ms);
        drive.world.board.hang(Hang::Everything);
        drive.drive(30, 400, 500, |_| {});
        assert_eq!(drive.world.board.resets, 1);
        cut_by_watchdog += cut_by_resets(&drive);
        assert_eq!(drive.world.board.pulse_jitter_us(), Some(0.0));
    }
    // A pulse takes a thirteenth of the frame, and each frame has two.
    assert!((1..=4).contains(&cut_by_line), "{cut_by_line}");
    assert!(cut_by_watchdog <= 40, "{cut_by_watchdog}");
}

#[test]
fn the_neutral_pulse_ends_within_120_ms_of_the_last_command_at_every_phase() {
    // Phases of the servo frame; the drive before is always the same.
    for phase_ms in 0..20 {
        let mut drive = driving(1);
        drive.run_ms(phase_ms);
        let command = drive.host.drive(400, 500);
        drive.send(&command);
        let sent_us = drive.world.now_us;
        drive.run_ms(300);
        let neutral = neutral_after_ms(&drive, sent_us);
        // A pulse is known at its end.
        let end_ms = neutral + f64::from(NEUTRAL_US) * 1e-3;
        assert!((60.0..=120.0).contains(&end_ms), "{phase_ms}: {end_ms}");
        assert_eq!(drive.host.mode(), Some(BoardMode::Failsafe));
        drive.run_ms(3_000);
        drive.arm();
        drive.drive(30, 400, 500, |_| {});
        assert_eq!(drive.host.mode(), Some(BoardMode::Driving));
    }
}

#[test]
fn the_imu_recovers_from_every_bus_fault_while_driving() {
    for fault in [BusFault::Absent, BusFault::Jammed, BusFault::Restarted] {
        let mut drive = driving(1);
        assert_eq!(drive.host.telemetry.unwrap().imu, ImuState::Fresh);
        let errors = drive.host.status.unwrap().imu_errors;
        drive.world.board.set_imu_bus(fault);
        let mut silent = false;
        drive.drive(30, 400, 500, |drive| {
            silent |= drive.host.telemetry.unwrap().imu == ImuState::Silent;
        });
        assert!(silent || fault == BusFault::Jammed, "{fault:?}");
        // The board must free a jammed bus by itself.
        if fault != BusFault::Jammed {
            drive.world.board.set_imu_bus(BusFault::None);
        }
        drive.drive(200, 400, 500, |_| {});
        assert_eq!(drive.host.mode(), Some(BoardMode::Driving), "{fault:?}");
        let fresh = (0..10).all(|_| {
            drive.drive(1, 400, 500, |_| {});
            drive.host.telemetry.unwrap().imu != ImuState::Silent
        });
        assert!(fresh, "{fault:?}");
        let status = drive.host.status.unwrap();
        assert!(
            status.imu_errors > errors || fault == BusFault::Restarted,
            "{fault:?}"
        );
        assert_eq!(drive.world.board.resets, 0);
    }
}

#[test]
fn a_short_circuited_bus_loses_only_the_imu() {
    let mut drive = armed(config(1));
    drive.world.board.set_imu_bus(BusFault::ShortCircuit);
    drive.drive(500, 400, 500, |_| {});
    assert_eq!(drive.host.telemetry.unwrap().imu, ImuState::Silent);
    assert_eq!(drive.host.mode(), Some(BoardMode::Driving));
    assert!((drive.world.truth().wheel_speed - 0.4).abs() < 0.04);
    assert_eq!(drive.world.board.resets, 0);
}

#[test]
fn values_of_the_imu_arrive_with_unit_sign_and_axis() {
    let mut drive = driving(1);
    drive.drive(300, 400, 2_000, |_| {});
    let (truth, telemetry) = (drive.world.truth(), drive.host.telemetry.unwrap());
    let yaw_rate = f64::from(telemetry.angular_velocity_mrad_s[2]) * 1e-3;
    let lateral = f64::from(telemetry.linear_acceleration_mm_s2[1]) * 1e-3;
    assert!(truth.yaw_rate > 0.2, "{truth:?}");
    assert!((yaw_rate - truth.yaw_rate).abs() < 0.03, "{yaw_rate}");
    assert!(
        (lateral - truth.lateral_acceleration).abs() < 0.3,
        "{lateral}"
    );
    let norm: i64 = telemetry
        .attitude_q14
        .iter()
        .map(|&q| i64::from(q) * i64::from(q))
        .sum();
    assert!(((norm as f64).sqrt() / 16_384.0 - 1.0).abs() < 0.001);
}

/// Pulses that do not belong to a drive at 0.4 m/s with a constant angle.
fn wrong_pulses(pulses: &[PulseRecord]) -> Vec<PulseRecord> {
    // The drive starts with 1,599 us and needs less afterwards, and never reverses.
    let is_right = |pulse: &PulseRecord| {
        (NEUTRAL_US..=1_610).contains(&pulse.esc_us)
            && (pulse.servo_us == 0 || pulse.servo_us.abs_diff(1_460) <= 40)
    };
    let wrong = pulses.iter().filter(|pulse| !is_right(pulse));
    wrong.copied().collect()
}

#[test]
fn one_percent_of_bit_errors_gives_no_wrong_pulse_and_no_reset() {
    let mut drive = driving(1);
    // 1 % of all data bits in both directions: 8 % of the bytes have a flipped bit.
    // A third of the commands arrive; most of them are too old because little of
    // the telemetry arrives, and the car stands most of the time.
    let begin_us = drive.world.now_us;
    drive.world.wire.faults = WireFaults {
        corrupt: 0.08,
        ..WireFaults::default()
    };
    for _ in 0..20 {
        drive.drive(300, 400, 500, |_| {});
        // The host arms repeatedly, as an operator would.
        for _ in 0..10 {
            drive.arm();
        }
    }
    assert!(drive.host.damaged > 1_000, "{}", drive.host.damaged);
    drive.world.wire.faults = WireFaults::default();
    let end_us = drive.world.now_us;
    assert!(end_us - begin_us >= 60_000_000);
    // The link recovers within 100 ms in both directions.
    let (records, answers) = (drive.host.records, drive.host.answers);
    drive.drive(5, 400, 500, |_| {});
    drive.arm();
    assert!(drive.world.now_us - end_us <= 100_000);
    assert!(drive.host.records >= records + 8);
    assert!(drive.host.answers > answers);
    let pulses = pulses_since(&drive, begin_us);
    assert!(pulses.len() > 2_900);
    assert_eq!(wrong_pulses(&pulses), []);
    assert_eq!(drive.world.board.resets, 0);
}

#[test]
fn one_percent_of_bit_errors_in_the_commands_gives_no_wrong_pulse() {
    let mut drive = driving(1);
    let begin_us = drive.world.now_us;
    let mut random = 1_u64;
    let mut driven = 0;
    for _ in 0..6_000 {
        let command = drive.host.drive(400, 500).encode();
        let mut bytes = command.as_bytes().to_vec();
        for byte in &mut bytes {
            for bit in 0..8 {
                // Knuth's generator; its upper half is random enough.
                random = random
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1_442_695_040_888_963_407);
                if (random >> 32).is_multiple_of(100) {
                    *byte ^= 1 << bit;
                }
            }
        }
        drive.world.host_write(&bytes);
        drive.run_ms(10);
        driven += u32::from(drive.host.mode() == Some(BoardMode::Driving));
        if drive.host.mode() == Some(BoardMode::Failsafe) {
            drive.arm();
        }
    }
    let status = drive.host.status.unwrap();
    assert!(status.frames_damaged > 3_000, "{status:?}");
    // Occasionally enough commands are lost in a row to stop the car.
    assert!(driven > 3_000, "{driven}");
    assert_eq!(wrong_pulses(&pulses_since(&drive, begin_us)), []);
    assert_eq!(drive.world.board.resets, 0);
}

#[test]
fn random_bytes_at_the_full_baud_rate_cause_no_overrun_and_stop_the_car() {
    let mut drive = driving(1);
    let flood_us = drive.world.now_us;
    let mut byte = 1_u8;
    for _ in 0..100 {
        // The line carries 115 bytes in 10 ms.
        let garbage: Vec<u8> = (0..115)
            .map(|_| {
                byte = byte.wrapping_mul(181).wrapping_add(59);
                byte
            })
            .collect();
        drive.world.host_write(&garbage);
        drive.run_ms(10);
    }
    assert_eq!(drive.world.board.bytes_overrun(), 0);
    assert_eq!(drive.host.mode(), Some(BoardMode::Failsafe));
    assert_eq!(
        drive.host.telemetry.unwrap().stop_cause,
        StopCause::CommandTimeout
    );
    assert!(pulses_since(&drive, flood_us).iter().all(is_within_limits));
    let status = drive.host.status.unwrap();
    assert_eq!(status.bytes_overrun, 0, "{status:?}");
    assert_eq!(drive.world.board.resets, 0);
}

#[test]
fn a_hung_board_counts_lost_bytes() {
    let mut drive = driving(1);
    drive.world.board.hang(Hang::Everything);
    drive.world.host_write(&[0; 50]);
    drive.run_ms(20);
    // Two bytes in the receiver's buffer, one in its shift register.
    let lost = drive.world.board.bytes_overrun();
    assert!((40..=48).contains(&lost), "{lost}");
}

#[test]
fn a_configured_stop_switch_gives_neutral_at_once() {
    let mut drive = ScriptedDrive::new(config(1)).unwrap();
    drive.configuration.stop_input = true;
    drive.run_ms(200);
    drive.prepare();
    drive.drive(100, 400, 0, |_| {});
    assert_eq!(drive.host.mode(), Some(BoardMode::Driving));
    drive.world.board.stop_input_open = true;
    let opened_us = drive.world.now_us;
    drive.drive(20, 400, 0, |_| {});
    assert_eq!(drive.host.mode(), Some(BoardMode::EmergencyStopped));
    let neutral = neutral_after_ms(&drive, opened_us);
    assert!(neutral <= 25.0, "{neutral} ms");
}

#[test]
fn every_reset_cause_is_reported() {
    for cause in [
        ResetCause::External,
        ResetCause::BrownOut,
        ResetCause::PowerOn,
        ResetCause::Watchdog,
    ] {
        let mut drive = ScriptedDrive::new(config(1)).unwrap();
        drive.run_ms(300);
        assert_eq!(drive.host.status.unwrap().reset_cause, ResetCause::PowerOn);
        drive.configure();
        drive.world.reset_board(cause);
        drive.run_ms(3_500);
        assert_eq!(drive.host.status.unwrap().reset_cause, cause);
    }
}

#[test]
fn a_power_on_is_not_hidden_by_the_reset_of_the_port_that_the_host_opens_then() {
    let mut drive = ScriptedDrive::new(config(1)).unwrap();
    let reset_cause = |drive: &mut ScriptedDrive| {
        drive.run_ms(3_500);
        drive.host.status.unwrap().reset_cause
    };
    // The cable takes the power along and brings it back; the port is opened.
    for _ in 0..2 {
        for _ in 0..2 {
            drive.world.press_reset();
            assert_eq!(reset_cause(&mut drive), ResetCause::PowerOn);
        }
        drive.configure();
        drive.world.press_reset();
        assert_eq!(reset_cause(&mut drive), ResetCause::External);
        drive.world.set_cable(false);
        drive.run_ms(500);
        drive.world.set_cable(true);
        drive.run_ms(500);
    }
}

/// The first pulse after a start is complete and neutral, and every pulse has the
/// commanded width to the cycle.
#[test]
fn both_pulses_have_exactly_the_width_in_telemetry_every_20_ms() {
    let mut drive = driving(1);
    drive.drive(200, 400, -700, |_| {});
    let telemetry = drive.host.telemetry.unwrap();
    let pulses = pulses_since(&drive, drive.world.now_us - 1_000_000);
    let last = pulses.last().unwrap();
    assert_eq!(last.servo_us, telemetry.servo_us);
    assert!(last.esc_us.abs_diff(telemetry.esc_us) <= 2);
    for pair in pulses.windows(2) {
        let [before, after] = pair else { continue };
        assert_eq!(after.board_time_us - before.board_time_us, 20_000);
    }
    let first = drive.world.board.pulses.iter().next().unwrap();
    assert_eq!((first.servo_us, first.esc_us), (0, NEUTRAL_US));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    #[test]
    fn random_bytes_do_not_drive_the_motor(
        writes in prop::collection::vec((0_u64..30, prop::collection::vec(any::<u8>(), 0..200)), 0..40),
    ) {
        let mut drive = ScriptedDrive::new(config(1)).unwrap();
        drive.run_ms(100);
        for (later_ms, bytes) in writes {
            drive.world.host_write(&bytes);
            drive.run_ms(later_ms);
        }
        drive.run_ms(100);
        let felt = |pulse: &PulseRecord| pulse.esc_us != 0 && pulse.esc_us != NEUTRAL_US;
        prop_assert!(!drive.world.board.pulses.iter().any(felt));
        prop_assert_eq!(drive.world.board.resets, 0);
        // Telemetry continues.
        let records = drive.host.records;
        drive.run_ms(100);
        prop_assert!(drive.host.records >= records + 9);
    }
}
