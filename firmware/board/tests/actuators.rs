//! What the servo and the ESC are given while driving.

mod rig;

use rig::{MS, NEUTRAL, Rig, configuration};
use singletrack_protocol::{BoardMode, Configuration, SpeedLoop};

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

#[test]
fn the_servo_slews_to_the_angle_at_the_configured_rate_whatever_the_poll_rate() {
    for poll_us in [100, 333, 1_000, 4_000, 10_000] {
        let mut rig = Rig::armed_with(configuration());
        rig.poll_us = poll_us;
        rig.drive(0, 5_000);
        for frame in 1..=4_u16 {
            rig.run(20 * MS);
            rig.drive(0, 5_000);
            let pulse = rig.outputs.servo_us.unwrap_or(0);
            let expected = 1_480 + 100 * frame;
            assert!(
                (expected - 3..=expected).contains(&pulse),
                "{poll_us}: {pulse}"
            );
        }
        rig.drive_for(1_000 * MS, 0, 5_000);
        assert_eq!(rig.outputs.servo_us, Some(1_880));
    }
}

#[test]
fn steering_beyond_the_limits_of_the_servo_ends_at_them() {
    let mut rig = Rig::armed_with(configuration());
    rig.drive_for(500 * MS, 0, i16::MAX);
    assert_eq!(rig.outputs.servo_us, Some(1_900));
    rig.drive_for(500 * MS, 0, i16::MIN);
    assert_eq!(rig.outputs.servo_us, Some(1_100));
}

#[test]
fn the_throttle_slews_up_and_falls_at_once() {
    let mut rig = Rig::armed_with(configuration());
    rig.pulse_period_us = Some(5_000);
    let mut pulse = NEUTRAL;
    for _ in 0..100 {
        rig.drive(2_000, 0);
        rig.run(MS);
        // 60 us in 20 ms are 3 us in 1 ms.
        assert!(
            rig.outputs.esc_us <= pulse + 3,
            "{} after {pulse}",
            rig.outputs.esc_us
        );
        pulse = rig.outputs.esc_us;
    }
    assert!(pulse > NEUTRAL + 200);
    // Slower: the next control step goes straight to the lower pulse.
    rig.drive(1_000, 0);
    rig.run(10 * MS);
    assert!(rig.outputs.esc_us < pulse - 50);
    // Standing: at once, and exactly neutral.
    rig.drive(0, 0);
    assert_eq!(rig.outputs.esc_us, NEUTRAL);
    assert_eq!(rig.board.mode(), BoardMode::Driving);
}

#[test]
fn a_speed_of_zero_forgets_the_integral() {
    let mut rig = Rig::driving_with(configuration());
    // Too slow for long: the integral fills.
    rig.pulse_period_us = Some(10_000);
    rig.drive_for(3_000 * MS, 1_000, 0);
    let filled = rig.outputs.esc_us;
    rig.drive(0, 0);
    rig.drive_for(100 * MS, 1_000, 0);
    let fresh = rig.outputs.esc_us;
    assert_eq!(filled, NEUTRAL + 20 + 100 + 25 + 60);
    assert!(fresh < filled - 40, "{fresh} and {filled}");
}

#[test]
fn the_integral_waits_for_a_throttle_that_still_slews() {
    let mut slow = configuration();
    slow.esc.slew_us_per_20ms = 5;
    let mut rig = Rig::armed_with(slow);
    rig.pulse_period_us = Some(10_000);
    rig.drive_for(500 * MS, 1_000, 0);
    // At the commanded speed, before the throttle has come up.
    rig.pulse_period_us = Some(5_000);
    rig.drive_for(200 * MS, 1_000, 0);
    let beyond_deadband = rig.outputs.esc_us - NEUTRAL - 20;
    assert!(beyond_deadband.abs_diff(100) <= 2, "{beyond_deadband}");
}

#[test]
fn faster_commands_are_clamped_to_the_configured_speed() {
    let settled = |speed_mm_s| {
        let mut rig = Rig::driving_with(configuration());
        rig.pulse_period_us = Some(2_500);
        rig.drive_for(1_000 * MS, speed_mm_s, 0);
        rig.outputs.esc_us
    };
    assert_eq!(settled(i16::MAX), settled(2_000));
    // The wheels turn at 2 m/s: nothing but the feed-forward is left.
    let beyond_deadband = settled(2_000) - NEUTRAL - 20;
    assert!(beyond_deadband.abs_diff(200) <= 1, "{beyond_deadband}");
}

#[test]
fn too_fast_is_neutral_and_never_the_brake() {
    let mut rig = Rig::driving_with(configuration());
    rig.pulse_period_us = Some(500);
    for _ in 0..100 {
        rig.drive_for(10 * MS, 500, 0);
        assert!(rig.outputs.esc_us >= NEUTRAL);
    }
    assert_eq!(rig.outputs.esc_us, NEUTRAL);
}

#[test]
fn the_loop_brings_a_car_to_the_commanded_speed() {
    // A motor that needs a third more than the feed-forward, with a lag of 0.2 s.
    let mut rig = Rig::armed_with(configuration());
    let mut speed_m_s = 0.0_f64;
    let mut travelled_m = 0.0_f64;
    for _ in 0..600 {
        rig.drive(1_000, 0);
        for _ in 0..10 {
            rig.now += MS;
            let drive = f64::from(rig.outputs.esc_us) - f64::from(NEUTRAL + 20);
            speed_m_s += (drive.max(0.0) / 133.0 - speed_m_s) * 0.001 / 0.2;
            travelled_m += speed_m_s * 0.001;
            let count = (travelled_m / 0.005) as u16;
            if rig.inputs.motor.count != count {
                rig.inputs.motor.count = count;
                rig.inputs.motor.last_edge_us = rig.now;
            }
            rig.poll(&[]);
        }
    }
    assert_eq!(rig.board.mode(), BoardMode::Driving);
    assert!((speed_m_s - 1.0).abs() < 0.02, "{speed_m_s}");
    let measured = rig.telemetry().motor_speed_mm_s;
    assert!((950..=1_050).contains(&measured), "{measured}");
}

/// The distinct pulses of the ESC with how long each kind was shown, in ms:
/// -1 for a pulse beyond the deadband below neutral, 0 within, 1 above.
fn phases(rig: &mut Rig, duration_ms: u32, speed_mm_s: i16) -> Vec<(i8, u32)> {
    let mut phases: Vec<(i8, u32)> = Vec::new();
    for ms in 0..duration_ms {
        if ms % 10 == 0 {
            rig.drive(speed_mm_s, 0);
        }
        rig.run(MS);
        let kind = match rig.outputs.esc_us {
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
fn into_reverse_goes_by_brake_standstill_and_neutral() {
    let mut rig = Rig::driving_with(with_reverse());
    // The wheels stop soon after the brake is on.
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
    // And back: neutral while it rolls backwards, then forward.
    let rolling = phases(&mut rig, 200, 300);
    assert!(matches!(rolling[..], [(0, _)]), "{rolling:?}");
    rig.pulse_period_us = None;
    let still = phases(&mut rig, 250, 300);
    rig.pulse_period_us = Some(16_667);
    assert!(matches!(still[..], [(0, 130..), (1, _)]), "{still:?}");
    assert_eq!(rig.board.mode(), BoardMode::Driving);
}

#[test]
fn braking_on_the_way_into_reverse_is_limited_too() {
    let mut rig = Rig::driving_with(with_reverse());
    // The wheels never stop, as they would if the brake pulse drove backwards.
    let all = phases(&mut rig, 3_000, -300);
    let braked: u32 = all
        .iter()
        .filter(|&&(kind, _)| kind == -1)
        .map(|&(_, time)| time)
        .sum();
    assert!(braked <= 500, "{all:?}");
    assert_eq!(rig.outputs.esc_us, NEUTRAL);
}

#[test]
fn an_esc_that_has_just_braked_is_not_given_the_brake_pulse_again() {
    let mut rig = Rig::driving_with(with_reverse());
    phases(&mut rig, 300, -300);
    rig.pulse_period_us = None;
    rig.disarm();
    rig.run(200 * MS);
    assert_eq!(rig.arm(), Ok(()));
    let again = phases(&mut rig, 150, -300);
    assert!(matches!(again[..], [(0, 150)]), "{again:?}");
}

#[test]
fn from_a_standing_start_the_brake_pulse_is_not_given() {
    let mut rig = Rig::armed_with(with_reverse());
    let start = phases(&mut rig, 190, -300);
    assert!(matches!(start[..], [(0, 190)]), "{start:?}");
}

#[test]
fn telemetry_shows_the_pulses_that_are_put_out() {
    let mut rig = Rig::driving_with(configuration());
    rig.drive_for(500 * MS, 1_200, -900);
    let telemetry = rig.telemetry();
    assert_eq!(Some(telemetry.servo_us), rig.outputs.servo_us);
    assert_eq!(telemetry.esc_us, rig.outputs.esc_us);
    assert_eq!(telemetry.last_sequence.next(), rig.board.last_sequence());
    assert_eq!(telemetry.motor_speed_mm_s, 1_000);
}
