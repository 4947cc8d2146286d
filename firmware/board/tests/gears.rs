//! Changes between forward and reverse.

use singletrack_protocol::{
    BoardMode, Configuration, Drive, EscCalibration, FailsafeAction, SpeedLoop,
};

use crate::{MS, NEUTRAL, Rig, configuration};

fn with_reverse() -> Configuration {
    let speed = SpeedLoop {
        max_reverse_mm_s: 500,
        ..configuration().speed
    };
    Configuration {
        speed,
        ..configuration()
    }
}

/// Driving in reverse at 0.3 m/s, as commanded.
fn reversing_with(configuration: Configuration) -> Rig {
    let mut rig = Rig::armed_with(configuration);
    // From standstill: neutral for 200 ms, then reverse.
    rig.drive_for(230 * MS, -300, 0);
    rig.pulse_period_us = Some(16_667);
    rig.drive_for(300 * MS, -300, 0);
    assert!(rig.esc_us() < NEUTRAL - 20);
    assert!(rig.telemetry().motor_speed_mm_s < -250);
    rig
}

/// The phases of the ESC pulse with their durations, in ms: -1 for a pulse beyond
/// the deadband below neutral, 0 within, 1 above.
fn phases(rig: &mut Rig, duration_ms: u32, speed_mm_s: i16) -> Vec<(i8, u32)> {
    let mut phases: Vec<(i8, u32)> = Vec::new();
    for ms in 0..duration_ms {
        if ms % 10 == 0 {
            rig.drive(speed_mm_s, 0);
        }
        rig.run(MS);
        let kind = match rig.esc_us() {
            ..1_480 => -1,
            1_480..=1_520 => 0,
            _ => 1,
        };
        match phases.last_mut() {
            Some((last, time)) if *last == kind => *time += 1,
            _ => phases.push((kind, 1)),
        }
    }
    phases
}

#[test]
fn reverse_requires_brake_standstill_and_neutral() {
    let mut rig = Rig::driving_with(with_reverse());
    // The wheels stop soon after braking starts.
    let rolling = phases(&mut rig, 100, -300);
    rig.pulse_period_us = None;
    let standing = phases(&mut rig, 420, -300);
    rig.pulse_period_us = Some(16_667);
    let reversing = phases(&mut rig, 300, -300);
    assert!(rolling.iter().all(|&(kind, _)| kind != 1), "{rolling:?}");
    let [(-1, braked), (0, paused), ..] = standing[..] else {
        panic!("{standing:?}")
    };
    assert!(braked >= 100, "{standing:?}");
    assert!(paused >= 200, "{standing:?}");
    assert_eq!(reversing.last().map(|phase| phase.0), Some(-1));
    assert!(rig.telemetry().motor_speed_mm_s < -250);
    // Back to forward: neutral while it rolls backwards, then forward.
    let rolling = phases(&mut rig, 200, 300);
    assert!(matches!(rolling[..], [(0, _)]), "{rolling:?}");
    rig.pulse_period_us = None;
    let still = phases(&mut rig, 250, 300);
    rig.pulse_period_us = Some(16_667);
    assert!(matches!(still[..], [(0, 130..), (1, _)]), "{still:?}");
    assert_eq!(rig.board.mode(), BoardMode::Driving);
}

#[test]
fn braking_before_reverse_is_limited() {
    let mut rig = Rig::driving_with(with_reverse());
    // The wheels never stop, as if the brake pulse drove in reverse.
    let all = phases(&mut rig, 3_000, -300);
    let braked: u32 = all
        .iter()
        .filter(|&&(kind, _)| kind == -1)
        .map(|&(_, time)| time)
        .sum();
    assert!(braked <= 500, "{all:?}");
    assert_eq!(rig.esc_us(), NEUTRAL);
}

#[test]
fn braking_before_reverse_ends_when_the_speed_rises() {
    let mut rig = Rig::driving_with(with_reverse());
    rig.pulse_period_us = Some(10_000);
    phases(&mut rig, 100, -300);
    rig.pulse_period_us = Some(20_000);
    phases(&mut rig, 60, -300);
    assert_eq!(rig.esc_us(), configuration().esc.brake_us);
    rig.pulse_period_us = Some(10_000);
    phases(&mut rig, 60, -300);
    assert_eq!(rig.esc_us(), NEUTRAL);
}

#[test]
fn braking_before_reverse_lasts_for_200_ms_at_standstill() {
    let mut rig = Rig::driving_with(with_reverse());
    rig.pulse_period_us = None;
    // Standing after 150 ms. The pulse reaches the brake gradually.
    let all = phases(&mut rig, 350, -300);
    assert!(
        matches!(all[..], [(0, ..=10), (-1, 190..=200), (0, _)]),
        "{all:?}"
    );
}

#[test]
fn the_brake_pulse_is_not_repeated_after_braking() {
    for braked_ms in [50, 300] {
        let mut rig = Rig::driving_with(with_reverse());
        phases(&mut rig, braked_ms, -300);
        rig.pulse_period_us = None;
        rig.disarm();
        rig.run(200 * MS);
        assert_eq!(rig.arm(), Ok(()));
        let again = phases(&mut rig, 150, -300);
        assert!(matches!(again[..], [(0, 150)]), "{braked_ms}: {again:?}");
    }
}

#[test]
fn no_brake_pulse_from_standstill() {
    let mut rig = Rig::armed_with(with_reverse());
    let start = phases(&mut rig, 190, -300);
    assert!(matches!(start[..], [(0, 190)]), "{start:?}");
}

#[test]
fn a_speed_of_zero_neither_brakes_nor_changes_gear() {
    let mut rig = Rig::driving_with(with_reverse());
    for _ in 0..100 {
        rig.drive_for(10 * MS, 0, 0);
        assert_eq!(rig.esc_us(), NEUTRAL);
    }
    let onwards = phases(&mut rig, 60, 1_000);
    assert!(matches!(onwards[..], [(0, ..=25), (1, _)]), "{onwards:?}");
}

#[test]
fn a_forward_command_before_reverse_drives_without_delay() {
    // While braking, and in the neutral after it.
    for (reverse_ms, now) in [(100, -1), (300, 0)] {
        let mut rig = Rig::driving_with(with_reverse());
        rig.pulse_period_us = None;
        let way = phases(&mut rig, reverse_ms, -300);
        assert_eq!(way.last().map(|phase| phase.0), Some(now), "{way:?}");
        let back = phases(&mut rig, 100, 500);
        assert!(matches!(back[..], [(0, ..=25), (1, _)]), "{back:?}");
    }
}

#[test]
fn a_stop_before_reverse_continues_braking() {
    let mut rig = Rig::driving_with(Configuration {
        failsafe: FailsafeAction::Brake,
        ..with_reverse()
    });
    phases(&mut rig, 100, -300);
    rig.greet(rig.now);
    assert_eq!(rig.board.mode(), BoardMode::Failsafe);
    assert_eq!(rig.esc_us(), configuration().esc.brake_us);
    // Half a second in all.
    rig.run(410 * MS);
    assert_eq!(rig.esc_us(), NEUTRAL);
}

#[test]
fn the_gear_stays_in_reverse_at_standstill() {
    let mut rig = reversing_with(with_reverse());
    rig.pulse_period_us = None;
    for _ in 0..50 {
        rig.drive_for(10 * MS, 0, 0);
        assert_eq!(rig.esc_us(), NEUTRAL);
    }
    let onwards = phases(&mut rig, 60, -300);
    assert!(matches!(onwards[..], [(0, ..=25), (-1, _)]), "{onwards:?}");
}

#[test]
fn the_gear_and_the_sign_of_the_speed_stay_in_reverse_after_disarming() {
    let mut rig = reversing_with(with_reverse());
    rig.disarm();
    rig.run(100 * MS);
    assert!(rig.telemetry().motor_speed_mm_s < -250);
    rig.pulse_period_us = None;
    rig.run(200 * MS);
    assert_eq!(rig.arm(), Ok(()));
    let onwards = phases(&mut rig, 60, -300);
    assert!(matches!(onwards[..], [(0, ..=25), (-1, _)]), "{onwards:?}");
}

#[test]
fn the_throttle_in_reverse_is_clamped_to_its_limit() {
    for (min_us, max_us) in [(1_460, 1_800), (1_400, 1_540)] {
        let mut configuration = with_reverse();
        configuration.esc = EscCalibration {
            min_us,
            max_us,
            brake_us: 1_470,
            ..configuration.esc
        };
        let mut rig = Rig::armed_with(configuration);
        rig.drive_for(230 * MS, -500, 0);
        // Hardly moving: the loop saturates.
        rig.pulse_period_us = Some(100_000);
        rig.drive_for(3_000 * MS, -500, 0);
        assert_eq!(rig.esc_us(), min_us);
    }
}

#[test]
fn a_car_that_has_stood_at_neutral_goes_to_reverse_without_a_brake_pulse() {
    let mut rig = Rig::armed_with(with_reverse());
    rig.pulse_period_us = Some(16_667);
    rig.drive_for(500 * MS, 300, 0);
    rig.pulse_period_us = None;
    rig.drive_for(1_000 * MS, 0, 0);
    // Neutral for 200 ms, then reverse: its first pulse below neutral drives.
    let phases = phases(&mut rig, 300, -300);
    assert!(
        matches!(phases[..], [(0, 195..=235), (-1, _)]),
        "{phases:?}"
    );
}

#[test]
fn a_brake_before_a_reverse_that_is_taken_back_uses_the_brake_up() {
    let mut rig = Rig::driving_with(with_reverse());
    let braking = phases(&mut rig, 60, -300);
    assert!(
        matches!(braking[..], [(0, ..), (-1, _)] | [(-1, _)]),
        "{braking:?}"
    );
    // The host stops instead, with the brake.
    for _ in 0..30 {
        let command = Drive {
            brake: true,
            ..rig.command(0, 0)
        };
        rig.send(command);
        for _ in 0..10 {
            rig.run(MS);
            assert_eq!(rig.esc_us(), NEUTRAL);
        }
    }
}

#[test]
fn every_change_to_reverse_brakes_as_long_as_the_first() {
    let mut rig = Rig::driving_with(with_reverse());
    let mut braked_ms = || {
        rig.pulse_period_us = Some(5_000);
        rig.drive_for(500 * MS, 1_000, 0);
        let braking = phases(&mut rig, 600, -300);
        let back = phases(&mut rig, 20, 300);
        assert!(back.iter().all(|&(kind, _)| kind != -1), "{back:?}");
        braking
            .iter()
            .filter(|phase| phase.0 == -1)
            .map(|phase| phase.1)
            .sum::<u32>()
    };
    let [first, second] = [braked_ms(), braked_ms()];
    assert!(
        first >= 490 && second.abs_diff(first) <= 2,
        "{first} {second}"
    );
}

#[test]
fn a_reverse_after_the_brake_of_a_stop_pauses_at_once() {
    let mut rig = Rig::driving_with(with_reverse());
    for (speed_mm_s, pulses_us) in [(0, 1_300), (-300, NEUTRAL)] {
        for _ in 0..5 {
            let command = Drive {
                brake: true,
                ..rig.command(speed_mm_s, 0)
            };
            rig.send(command);
            rig.run(10 * MS);
            assert_eq!(rig.esc_us(), pulses_us, "{speed_mm_s}");
        }
    }
}
