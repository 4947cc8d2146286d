//! Servo and ESC pulses while driving.

use singletrack_protocol::BoardMode;

use crate::{MS, NEUTRAL, Rig, configuration};

#[test]
fn the_servo_slews_at_the_configured_rate_for_any_poll_rate() {
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
fn steering_is_clamped_to_the_limits_of_the_servo() {
    let mut rig = Rig::armed_with(configuration());
    rig.drive_for(500 * MS, 0, i16::MAX);
    assert_eq!(rig.outputs.servo_us, Some(1_900));
    rig.drive_for(500 * MS, 0, i16::MIN);
    assert_eq!(rig.outputs.servo_us, Some(1_100));
}

#[test]
fn the_throttle_slews_up_and_falls_immediately() {
    let mut rig = Rig::armed_with(configuration());
    rig.pulse_period_us = Some(5_000);
    let mut pulse = NEUTRAL;
    for _ in 0..100 {
        rig.drive(2_000, 0);
        rig.run(MS);
        // 60 us in 20 ms are 3 us in 1 ms.
        assert!(rig.esc_us() <= pulse + 3, "{} after {pulse}", rig.esc_us());
        pulse = rig.esc_us();
    }
    assert!(pulse > NEUTRAL + 200);
    // A lower speed: the next control step goes to the lower pulse at once.
    rig.drive(1_000, 0);
    rig.run(10 * MS);
    assert!(rig.esc_us() < pulse - 50);
    // Zero speed: exactly neutral at once.
    rig.drive(0, 0);
    assert_eq!(rig.esc_us(), NEUTRAL);
    assert_eq!(rig.board.mode(), BoardMode::Driving);
}

#[test]
fn a_speed_of_zero_resets_the_integral() {
    let mut rig = Rig::driving_with(configuration());
    // Too slow for a long time: the integral fills.
    rig.pulse_period_us = Some(10_000);
    rig.drive_for(3_000 * MS, 1_000, 0);
    let filled = rig.esc_us();
    rig.drive(0, 0);
    rig.drive_for(100 * MS, 1_000, 0);
    let fresh = rig.esc_us();
    assert_eq!(filled, NEUTRAL + 20 + 100 + 25 + 60);
    assert!(fresh < filled - 40, "{fresh} and {filled}");
}

#[test]
fn the_integral_stops_while_the_throttle_slews() {
    let mut slow = configuration();
    slow.esc.slew_us_per_20ms = 5;
    let mut rig = Rig::armed_with(slow);
    rig.pulse_period_us = Some(10_000);
    rig.drive_for(500 * MS, 1_000, 0);
    // At the commanded speed before the throttle has slewed up.
    rig.pulse_period_us = Some(5_000);
    rig.drive_for(200 * MS, 1_000, 0);
    let beyond_deadband = rig.esc_us() - NEUTRAL - 20;
    assert!(beyond_deadband.abs_diff(100) <= 2, "{beyond_deadband}");
}

#[test]
fn the_integral_stops_at_the_limit_of_the_throttle() {
    let mut narrow = configuration();
    narrow.esc.max_us = NEUTRAL + 20 + 120;
    let mut rig = Rig::armed_with(narrow);
    // Too slow for a long time: 100 us of feed-forward and 25 us for the error end at the limit.
    rig.pulse_period_us = Some(10_000);
    rig.drive_for(3_000 * MS, 1_000, 0);
    assert_eq!(rig.esc_us(), narrow.esc.max_us);
    // At the commanded speed no accumulated integral keeps the throttle open.
    rig.pulse_period_us = Some(5_000);
    rig.drive_for(100 * MS, 1_000, 0);
    let beyond_deadband = rig.esc_us() - NEUTRAL - 20;
    assert!(beyond_deadband.abs_diff(100) <= 2, "{beyond_deadband}");
}

#[test]
fn faster_commands_are_clamped_to_the_configured_speed() {
    let settled = |speed_mm_s| {
        let mut rig = Rig::driving_with(configuration());
        rig.pulse_period_us = Some(2_500);
        rig.drive_for(1_000 * MS, speed_mm_s, 0);
        rig.esc_us()
    };
    assert_eq!(settled(i16::MAX), settled(2_000));
    // The wheels turn at 2 m/s: only the feed-forward is left.
    let beyond_deadband = settled(2_000) - NEUTRAL - 20;
    assert!(beyond_deadband.abs_diff(200) <= 1, "{beyond_deadband}");
}

#[test]
fn a_car_that_is_too_fast_gets_neutral_not_the_brake() {
    let mut rig = Rig::driving_with(configuration());
    rig.pulse_period_us = Some(500);
    for _ in 0..100 {
        rig.drive_for(10 * MS, 500, 0);
        assert!(rig.esc_us() >= NEUTRAL);
    }
    assert_eq!(rig.esc_us(), NEUTRAL);
}

#[test]
fn the_loop_reaches_the_commanded_speed() {
    // A motor that needs a third more than the feed-forward, with a lag of 0.2 s.
    let mut rig = Rig::armed_with(configuration());
    let mut speed_m_s = 0.0_f64;
    let mut travelled_m = 0.0_f64;
    for _ in 0..600 {
        rig.drive(1_000, 0);
        for _ in 0..10 {
            rig.now += MS;
            let drive = f64::from(rig.esc_us()) - f64::from(NEUTRAL + 20);
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

#[test]
fn telemetry_contains_the_output_pulses() {
    let mut rig = Rig::driving_with(configuration());
    rig.drive_for(500 * MS, 1_200, -900);
    let telemetry = rig.telemetry();
    assert_eq!(Some(telemetry.servo_us), rig.outputs.servo_us);
    assert_eq!(telemetry.esc_us, rig.esc_us());
    assert_eq!(telemetry.last_sequence.next(), rig.board.last_sequence());
    assert_eq!(telemetry.motor_speed_mm_s, 1_000);
}
