//! The watches over the motor's pulses: a dead sensor, and wheels that turn at neutral.

use singletrack_protocol::{BoardMode, Configuration, EscKind, SpeedLoop, StopCause};

use crate::{MS, NEUTRAL, Rig, configuration};

fn with_pulse_distance(pulse_distance_um: u16) -> Configuration {
    Configuration {
        speed: SpeedLoop {
            pulse_distance_um,
            max_forward_mm_s: 2_000.min(12 * pulse_distance_um.min(1_000)),
            ..configuration().speed
        },
        ..configuration()
    }
}

/// A commanded speed that rises by 2 m/s², as the host's does, to its end.
fn ramp(ms: u32, end_mm_s: i16) -> i16 {
    i16::try_from(2 * ms).unwrap_or(i16::MAX).min(end_mm_s)
}

/// Time at a start for which no pulse is expected, where the pulses are far apart, in ms.
const START_MS: u32 = 100;

/// Time from the first pulse beyond the deadband to the failsafe with a dead sensor, in
/// ms, and the commanded distance until then, in mm: where the pulses are far apart,
/// without that of the first [`START_MS`]. None if it never comes.
fn until_failure(pulse_distance_um: u16, end_mm_s: i16) -> Option<(u32, u32)> {
    let mut rig = Rig::armed_with(with_pulse_distance(pulse_distance_um));
    let (mut driven_ms, mut commanded_um) = (0, 0);
    for ms in 0..2_000 {
        let speed = ramp(ms, end_mm_s);
        if ms % 10 == 0 {
            rig.drive(speed, 0);
        }
        rig.run(MS);
        if rig.board.mode() == BoardMode::Failsafe {
            assert_eq!(rig.board.stop_cause(), StopCause::MotorSensor);
            return Some((driven_ms, commanded_um / 1_000));
        }
        if rig.esc_us() > NEUTRAL + 20 {
            driven_ms += 1;
            if pulse_distance_um <= 5_000 || driven_ms > START_MS {
                commanded_um += u32::from(speed.unsigned_abs());
            }
        }
    }
    None
}

#[test]
fn a_dead_sensor_is_found_after_two_and_a_half_pulse_distances_15_mm_and_150_ms() {
    for distance_um in [3_000, 6_000, 12_000, 25_000, 30_000] {
        for end_mm_s in [400, 1_500] {
            let (driven_ms, commanded_mm) = until_failure(distance_um, end_mm_s).unwrap();
            // And 15 mm for a car that is late.
            let patience_mm = u32::from(distance_um) * 5 / 2_000 + 15;
            assert!(
                driven_ms >= 149 && commanded_mm + 1 >= patience_mm,
                "{distance_um} um, {end_mm_s} mm/s: {driven_ms} ms, {commanded_mm} mm"
            );
            // Not later than either needs, but for a period of the ramp.
            let of_time = driven_ms <= 152;
            let of_distance = commanded_mm <= patience_mm + 5;
            assert!(
                of_time || of_distance,
                "{distance_um} um, {end_mm_s} mm/s: {driven_ms} ms, {commanded_mm} mm"
            );
        }
    }
}

#[test]
fn a_car_that_is_commanded_to_crawl_has_600_ms_for_a_pulse() {
    for distance_um in [6_000, 30_000] {
        let (driven_ms, _) = until_failure(distance_um, 20).unwrap();
        assert!((599..=602).contains(&driven_ms), "{driven_ms}");
    }
}

#[test]
fn pulses_of_a_slow_car_with_a_long_pulse_distance_are_enough() {
    // 25 mm a pulse at 60 mm/s.
    let mut rig = Rig::armed_with(with_pulse_distance(25_000));
    rig.pulse_period_us = Some(416_667);
    rig.drive_for(5_000 * MS, 60, 0);
    assert_eq!(rig.board.mode(), BoardMode::Driving);
}

#[test]
fn bursts_of_driving_do_not_hide_a_dead_sensor_of_a_long_pulse_distance() {
    let mut rig = Rig::armed_with(with_pulse_distance(25_000));
    for burst in 0.. {
        rig.drive_for(140 * MS, 400, 0);
        rig.drive_for(300 * MS, 0, 0);
        if rig.board.mode() == BoardMode::Failsafe {
            break;
        }
        assert!(burst < 5, "still driving");
    }
    assert_eq!(rig.board.stop_cause(), StopCause::MotorSensor);
}

#[test]
fn the_standstill_time_follows_the_pulse_distance() {
    for (distance_um, still_ms) in [(100, 150), (5_000, 150), (12_000, 240), (30_000, 600)] {
        let mut rig = Rig::ready_with(with_pulse_distance(distance_um));
        rig.inputs.motor.count = rig.inputs.motor.count.wrapping_add(1);
        rig.inputs.motor.last_edge_us = rig.now;
        rig.poll(&[]);
        rig.run((still_ms - 1) * MS);
        assert!(rig.arm().is_err(), "{distance_um}");
        rig.run(MS);
        assert_eq!(rig.arm(), Ok(()), "{distance_um}");
    }
}

/// Runs until the board latches; returns the time, in ms. None if it does not.
fn until_latched(rig: &mut Rig, for_ms: u32) -> Option<u32> {
    for ms in 0..for_ms {
        if rig.board.mode() == BoardMode::EmergencyStopped {
            assert_eq!(rig.board.stop_cause(), StopCause::RunsAtNeutral);
            // Neutral is what drives: no pulse at all.
            assert_eq!(rig.outputs.esc_us, None);
            return Some(ms);
        }
        rig.run(MS);
    }
    None
}

#[test]
fn an_unarmed_car_that_drives_at_neutral_latches_after_3_s_or_a_metre() {
    for (speed_mm_s, max_roll_out_ms, expected_ms) in [
        (600, 1_000, 1_000),
        (300, 2_700, 2_700),
        (300, 3_500, 3_000),
        (300, 30_000, 3_000),
        (600, 30_000, 1_667),
        (2_000, 2_700, 500),
    ] {
        let mut rig = Rig::ready_with(Configuration {
            max_roll_out_ms,
            ..configuration()
        });
        rig.pulse_period_us = Some(5_000_000 / speed_mm_s);
        let latched_ms = until_latched(&mut rig, 10_000).unwrap();
        assert!(
            (expected_ms - 20..=expected_ms + 20).contains(&latched_ms),
            "{speed_mm_s} mm/s, {max_roll_out_ms} ms: {latched_ms}"
        );
    }
}

#[test]
fn a_car_that_drives_at_neutral_before_any_configuration_latches_too() {
    // Ten or 100 pulses, of unknown distance, in a tenth of a second.
    for period_us in [10_000, 1_000] {
        let mut rig = Rig::new();
        rig.pulse_period_us = Some(period_us);
        let latched_ms = until_latched(&mut rig, 10_000).unwrap();
        assert!((3_000..=3_030).contains(&latched_ms), "{latched_ms}");
    }
}

#[test]
fn an_unarmed_car_that_creeps_latches_after_half_a_metre() {
    for distance_um in [3_000, 6_000, 12_000, 30_000] {
        for speed_mm_s in [28, 32, 40, 49, 60, 90] {
            let mut rig = Rig::ready_with(with_pulse_distance(distance_um));
            rig.inputs.motor.last_edge_us = rig.now;
            rig.pulse_period_us = Some(u32::from(distance_um) * 1_000 / speed_mm_s);
            let latched_ms = until_latched(&mut rig, 30_000);
            let latched_mm = latched_ms.map(|ms| ms * speed_mm_s / 1_000);
            // One pulse more at each end.
            let most_mm = 500 + 2 * u32::from(distance_um) / 1_000;
            assert!(
                latched_mm.is_some_and(|mm| (490..=most_mm).contains(&mm)),
                "{distance_um} um, {speed_mm_s} mm/s: {latched_mm:?} mm"
            );
        }
    }
}

#[test]
fn a_car_that_is_moved_slowly_by_hand_with_pauses_does_not_latch() {
    let mut rig = Rig::ready_with(with_pulse_distance(12_000));
    for _ in 0..10 {
        // 0.06 m/s over 0.3 m, then it stands for longer than between two pulses.
        rig.pulse_period_us = Some(200_000);
        rig.run(5_000 * MS);
        rig.pulse_period_us = None;
        rig.run(600 * MS);
    }
    assert_eq!(rig.board.mode(), BoardMode::Neutral);
    // After a drive the limits of the roll-out hold.
    let mut rig = Rig::driving_with(Configuration {
        max_roll_out_ms: 20_000,
        ..with_pulse_distance(3_000)
    });
    rig.disarm();
    rig.pulse_period_us = Some(50_000);
    rig.run(12_000 * MS);
    assert_eq!(rig.board.mode(), BoardMode::Neutral);
}

#[test]
fn a_car_that_is_moved_by_hand_for_a_while_does_not_latch() {
    let mut rig = Rig::ready_with(configuration());
    for _ in 0..5 {
        // 0.33 m/s over 0.95 m, or 1 m/s over 0.95 m, then it stands.
        for (period_us, ms) in [(15_000, 2_850), (5_000, 950)] {
            rig.pulse_period_us = Some(period_us);
            rig.run(ms * MS);
            rig.pulse_period_us = None;
            rig.run(200 * MS);
        }
    }
    assert_eq!(rig.board.mode(), BoardMode::Neutral);
}

#[test]
fn edges_of_interference_at_standstill_do_not_latch() {
    let mut rig = Rig::ready_with(Configuration {
        max_roll_out_ms: 1_000,
        ..configuration()
    });
    // Ten edges a second never look like standstill, and are 50 mm/s.
    rig.pulse_period_us = Some(100_000);
    rig.run(5_000 * MS);
    assert_eq!(rig.board.mode(), BoardMode::Neutral);
}

/// Turns the wheels as a car does that slows down from 1 m/s.
fn roll_out(rig: &mut Rig, deceleration_mm_s2: u32) {
    let configuration = rig.board.configuration().copied();
    let distance_um = configuration.map_or(0, |configuration| {
        u32::from(configuration.speed.pulse_distance_um)
    });
    rig.pulse_period_us = None;
    let mut way_um = 0;
    for ms in 0..20_000_u32 {
        let speed = 1_000_u32.saturating_sub(deceleration_mm_s2 * ms / 1_000);
        if speed < 30 || rig.board.mode() == BoardMode::EmergencyStopped {
            return;
        }
        way_um += speed;
        if way_um >= distance_um {
            way_um -= distance_um;
            rig.inputs.motor.count = rig.inputs.motor.count.wrapping_add(1);
            rig.inputs.motor.last_edge_us = rig.now;
        }
        rig.run(MS);
    }
}

#[test]
fn after_a_drive_wheels_that_keep_their_speed_latch_long_before_the_roll_out() {
    let mut rig = Rig::driving_with(Configuration {
        max_roll_out_ms: 4_000,
        ..configuration()
    });
    rig.run(100 * MS);
    assert_eq!(rig.board.mode(), BoardMode::Failsafe);
    let latched_ms = until_latched(&mut rig, 10_000).unwrap();
    assert!((300..=1_300).contains(&latched_ms), "{latched_ms}");
}

#[test]
fn a_car_that_rolls_out_as_slowly_as_configured_does_not_latch() {
    for (deceleration, max_roll_out_ms) in [(1_400, 1_700), (300, 4_300)] {
        let rolls = || {
            let mut rig = Rig::driving_with(Configuration {
                max_roll_out_ms,
                ..configuration()
            });
            rig.run(100 * MS);
            rig
        };
        let mut rig = rolls();
        roll_out(&mut rig, deceleration);
        assert_eq!(rig.board.mode(), BoardMode::Failsafe, "{deceleration}");
        // Much more slowly than the longest roll-out.
        let mut rig = rolls();
        roll_out(&mut rig, deceleration / 4);
        assert_eq!(rig.board.stop_cause(), StopCause::RunsAtNeutral);
    }
}

#[test]
fn a_car_that_still_speeds_up_as_the_drive_ends_does_not_latch() {
    let mut rig = Rig::driving_with(configuration());
    rig.pulse_period_us = Some(10_000);
    rig.drive_for(200 * MS, 1_000, 0);
    rig.disarm();
    rig.run(50 * MS);
    rig.pulse_period_us = Some(5_000);
    rig.run(200 * MS);
    roll_out(&mut rig, 1_400);
    assert_eq!(rig.board.mode(), BoardMode::Neutral);
}

#[test]
fn a_drive_that_ends_before_the_first_pulse_is_one() {
    let ended = || {
        let mut rig = Rig::armed_with(Configuration {
            max_roll_out_ms: 4_300,
            ..with_pulse_distance(25_000)
        });
        rig.drive_for(100 * MS, 1_000, 0);
        assert!(rig.esc_us() > NEUTRAL + 20);
        rig.disarm();
        rig.run(MS);
        rig
    };
    // 1.7 m in 3.3 s.
    let mut rig = ended();
    roll_out(&mut rig, 300);
    assert_eq!(rig.board.mode(), BoardMode::Neutral);
    // 0.1 m/s: the first speed is measured after the time in which the car may speed up.
    let mut rig = ended();
    for period_us in [350_000, 400_000, 450_000] {
        rig.pulse_period_us = Some(period_us);
        rig.run(900 * MS);
    }
    assert_eq!(rig.board.mode(), BoardMode::Neutral);
    // It goes on with 0.5 m/s: a metre would take 2 s.
    let mut rig = ended();
    rig.pulse_period_us = Some(50_000);
    let latched_ms = until_latched(&mut rig, 10_000).unwrap();
    assert!((300..=1_500).contains(&latched_ms), "{latched_ms}");
}

#[test]
fn wheels_that_have_come_to_rest_after_a_drive_are_pushed() {
    let mut rig = Rig::driving_with(Configuration {
        max_roll_out_ms: 10_000,
        ..configuration()
    });
    rig.pulse_period_us = None;
    rig.disarm();
    rig.run(300 * MS);
    rig.pulse_period_us = Some(20_000);
    let latched_ms = until_latched(&mut rig, 10_000).unwrap();
    assert!((3_000..=3_020).contains(&latched_ms), "{latched_ms}");
}

#[test]
fn a_commanded_standstill_that_the_car_ignores_latches() {
    let mut rig = Rig::driving_with(Configuration {
        max_roll_out_ms: 4_000,
        ..configuration()
    });
    rig.drive_for(2_000 * MS, 0, 0);
    assert_eq!(rig.board.stop_cause(), StopCause::RunsAtNeutral);
}

#[test]
fn a_car_that_is_faster_than_its_command_does_not_latch() {
    let mut rig = Rig::driving_with(Configuration {
        max_roll_out_ms: 1_000,
        ..configuration()
    });
    // Downhill: neutral, and still faster than 0.4 m/s.
    rig.drive_for(3_000 * MS, 400, 0);
    assert!((NEUTRAL..=NEUTRAL + 20).contains(&rig.esc_us()));
    assert_eq!(rig.board.mode(), BoardMode::Driving);
}

#[test]
fn every_kind_of_esc_is_watched() {
    for kind in EscKind::ALL {
        let mut configuration = configuration();
        configuration.esc.kind = kind;
        let mut rig = Rig::ready_with(configuration);
        rig.pulse_period_us = Some(8_000);
        assert!(until_latched(&mut rig, 6_000).is_some(), "{kind:?}");
    }
}

/// The ESC's pulse after a start at 0.3 m/s and some pulses of the wheels.
fn pulse_at_start(pulse_distance_um: u16, pulses: u16) -> u16 {
    let mut rig = Rig::armed_with(with_pulse_distance(pulse_distance_um));
    rig.drive_for(70 * MS, 300, 0);
    for _ in 0..pulses {
        rig.inputs.motor.count = rig.inputs.motor.count.wrapping_add(1);
        rig.inputs.motor.last_edge_us = rig.now;
        // 0.25 m/s.
        rig.drive_for(u32::from(pulse_distance_um) * 4 / 10_000 * 10 * MS, 300, 0);
    }
    rig.drive_for(10 * MS, 300, 0);
    rig.esc_us()
}

#[test]
fn a_standstill_that_no_pulse_has_measured_does_not_drive_the_speed_loop() {
    // 100 us per m/s of the command, and nothing of the error before it is measured.
    let forward = NEUTRAL + 20 + 30;
    for distance_um in [25_000, 30_000] {
        assert_eq!(pulse_at_start(distance_um, 0), forward, "{distance_um}");
    }
    // One pulse is no measurement: the car is at most late.
    for (pulses, error) in [(1, 0..=8), (2, 2..=8)] {
        let pulse = pulse_at_start(25_000, pulses);
        assert!(error.contains(&(pulse - forward)), "{pulses}: {pulse}");
    }
    // Short distances: as always, 50 us per m/s of 0.3 m/s, and an integral.
    assert!(pulse_at_start(5_000, 0) >= forward + 15);
}

#[test]
fn a_car_that_does_not_start_is_driven_harder_while_it_waits_for_its_first_pulse() {
    let mut rig = Rig::armed_with(with_pulse_distance(25_000));
    rig.drive_for(80 * MS, 300, 0);
    let at_first = rig.esc_us();
    rig.drive_for(200 * MS, 300, 0);
    assert_eq!(rig.board.mode(), BoardMode::Driving);
    assert!(rig.esc_us() >= at_first + 8, "{}", rig.esc_us());
}

#[test]
fn a_start_is_one_after_every_stop() {
    let mut rig = Rig::armed_with(with_pulse_distance(25_000));
    rig.pulse_period_us = Some(83_333);
    rig.drive_for(1_000 * MS, 300, 0);
    rig.pulse_period_us = None;
    // It stands for less than the time after which the wheels count as standing.
    rig.drive_for(300 * MS, 0, 0);
    assert_eq!(rig.board.mode(), BoardMode::Driving);
    rig.drive_for(70 * MS, 300, 0);
    assert_eq!(rig.esc_us(), NEUTRAL + 20 + 30);
}
