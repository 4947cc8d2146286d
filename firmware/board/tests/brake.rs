//! Brake pulses: only where the ESC brakes, once per drive forward, and never for long.

use singletrack_protocol::{
    BoardMode, Configuration, Drive, EscCalibration, EscKind, FailsafeAction, SpeedLoop,
};

use crate::{MS, NEUTRAL, Rig, configuration};

const BRAKE: u16 = 1_300;

fn of_kind(kind: EscKind) -> Configuration {
    Configuration {
        esc: EscCalibration {
            kind,
            ..configuration().esc
        },
        ..configuration()
    }
}

/// Commands a speed with the brake every 10 ms; returns the ESC's pulses, one per ms.
fn brake_for(rig: &mut Rig, ms: u32, speed_mm_s: i16) -> Vec<u16> {
    (0..ms)
        .map(|ms| {
            if ms % 10 == 0 {
                let command = Drive {
                    brake: true,
                    ..rig.command(speed_mm_s, 0)
                };
                rig.send(command);
            }
            rig.run(MS);
            rig.esc_us()
        })
        .collect()
}

fn count(pulses: &[u16], pulse: u16) -> usize {
    pulses.iter().filter(|&&other| other == pulse).count()
}

#[test]
fn a_stop_led_by_the_host_brakes_until_the_wheels_stand() {
    for kind in [EscKind::Car, EscKind::Vesc] {
        let mut rig = Rig::driving_with(of_kind(kind));
        let pulses = brake_for(&mut rig, 100, 0);
        assert!(count(&pulses, BRAKE) >= 85, "{kind:?}: {pulses:?}");
        rig.pulse_period_us = None;
        let pulses = brake_for(&mut rig, 300, 0);
        assert!((100..=152).contains(&count(&pulses, BRAKE)), "{pulses:?}");
        assert_eq!(rig.esc_us(), NEUTRAL);
    }
}

#[test]
fn without_the_flag_a_car_that_is_too_fast_gets_neutral() {
    let mut rig = Rig::driving_with(configuration());
    rig.drive_for(20 * MS, 200, 0);
    for _ in 0..30 {
        rig.drive_for(10 * MS, 200, 0);
        assert!((NEUTRAL..=NEUTRAL + 20).contains(&rig.esc_us()));
    }
}

#[test]
fn a_car_that_is_hardly_too_fast_is_not_braked() {
    let mut rig = Rig::driving_with(configuration());
    let pulses = brake_for(&mut rig, 300, 850);
    assert_eq!(count(&pulses, BRAKE), 0, "{pulses:?}");
    let pulses = brake_for(&mut rig, 30, 849);
    assert!(count(&pulses, BRAKE) > 0, "{pulses:?}");
}

#[test]
fn the_brake_ends_at_the_commanded_speed() {
    let mut rig = Rig::driving_with(configuration());
    let pulses = brake_for(&mut rig, 100, 500);
    assert!(count(&pulses, BRAKE) >= 85, "{pulses:?}");
    // 0.48 m/s.
    rig.pulse_period_us = Some(10_400);
    let ends = brake_for(&mut rig, 40, 500);
    // From neutral, by 60 us in 20 ms.
    let first = ends.iter().find(|&&pulse| pulse != BRAKE);
    assert!(first.is_some_and(|&pulse| (NEUTRAL..=NEUTRAL + 3).contains(&pulse)));
    let pulses = brake_for(&mut rig, 100, 500);
    assert_eq!(count(&pulses, BRAKE), 0, "{pulses:?}");
    // The speed loop goes on.
    assert!(rig.esc_us() >= NEUTRAL);
}

#[test]
fn a_brake_pulse_ends_after_half_a_second_and_is_not_repeated() {
    let mut rig = Rig::driving_with(configuration());
    let pulses = brake_for(&mut rig, 2_000, 300);
    let braked = count(&pulses, BRAKE);
    assert!((495..=500).contains(&braked), "{braked}");
    let free = pulses
        .iter()
        .filter(|pulse| (NEUTRAL..=NEUTRAL + 20).contains(*pulse));
    assert!(free.count() + braked + 10 >= pulses.len());
    rig.disarm();
    assert_eq!(rig.esc_us(), NEUTRAL);
}

#[test]
fn after_driving_forward_again_it_brakes_again() {
    let mut rig = Rig::driving_with(configuration());
    brake_for(&mut rig, 600, 300);
    rig.drive_for(500 * MS, 1_500, 0);
    assert!(rig.esc_us() > NEUTRAL + 20);
    let pulses = brake_for(&mut rig, 100, 0);
    assert!(count(&pulses, BRAKE) >= 85, "{pulses:?}");
}

#[test]
fn a_second_brake_is_earned_by_three_servo_frames_of_driving() {
    // Shorter, and the ESC may have seen no driving pulse: a second pulse below neutral
    // is reverse.
    let mut outcomes = Vec::new();
    for ms in (10..=120).step_by(10) {
        let mut rig = Rig::driving_with(configuration());
        brake_for(&mut rig, 600, 300);
        let mut driven_ms = 0;
        for _ in 0..ms / 10 {
            rig.drive(1_500, 0);
            for _ in 0..10 {
                rig.run(MS);
                driven_ms += u32::from(rig.esc_us() > NEUTRAL + 20);
            }
        }
        let pulses = brake_for(&mut rig, 200, 0);
        let brakes = count(&pulses, BRAKE) > 0;
        assert_eq!(brakes, driven_ms >= 60, "{driven_ms}: {pulses:?}");
        outcomes.push(brakes);
    }
    assert!(outcomes.contains(&false) && outcomes.contains(&true));
}

#[test]
fn short_drives_with_a_pause_between_do_not_earn_a_brake() {
    let mut rig = Rig::driving_with(configuration());
    brake_for(&mut rig, 600, 300);
    for _ in 0..20 {
        rig.drive_for(40 * MS, 1_500, 0);
        // Below the measured speed: neutral.
        rig.drive_for(20 * MS, 200, 0);
    }
    let pulses = brake_for(&mut rig, 200, 0);
    assert_eq!(count(&pulses, BRAKE), 0, "{pulses:?}");
}

#[test]
fn a_brake_pulse_that_drives_ends_when_the_speed_rises() {
    // A forward/reverse ESC that is configured as a car's: it stops, then speeds up
    // backwards.
    for by_failsafe in [false, true] {
        let mut rig = Rig::driving_with(Configuration {
            failsafe: FailsafeAction::Brake,
            ..configuration()
        });
        let brake = |rig: &mut Rig, ms: u32| {
            if !by_failsafe {
                return brake_for(rig, ms, 0);
            }
            (0..ms)
                .map(|_| {
                    rig.run(MS);
                    rig.esc_us()
                })
                .collect()
        };
        if by_failsafe {
            rig.run_until(|rig| rig.board.mode() == BoardMode::Failsafe);
        }
        for period_us in [6_000, 10_000, 20_000, 50_000] {
            rig.pulse_period_us = Some(period_us);
            brake(&mut rig, 60);
        }
        assert_eq!(rig.esc_us(), BRAKE);
        rig.pulse_period_us = Some(20_000);
        let pulses = brake(&mut rig, 150);
        assert_eq!(pulses.last(), Some(&NEUTRAL), "{pulses:?}");
    }
}

#[test]
fn a_disarm_brakes_a_rolling_car_once() {
    for kind in [EscKind::Car, EscKind::Vesc] {
        let mut rig = Rig::driving_with(of_kind(kind));
        rig.disarm();
        assert_eq!(
            (rig.board.mode(), rig.esc_us()),
            (BoardMode::Neutral, BRAKE)
        );
        rig.run(498 * MS);
        assert_eq!(rig.esc_us(), BRAKE);
        rig.run(3 * MS);
        assert_eq!(rig.esc_us(), NEUTRAL);
        rig.pulse_period_us = None;
        rig.run(1_000 * MS);
        assert_eq!(rig.arm(), Ok(()));
        rig.pulse_period_us = Some(5_000);
        let pulses = brake_for(&mut rig, 50, 0);
        assert_eq!(count(&pulses, BRAKE), 0, "{pulses:?}");
    }
}

#[test]
fn a_disarm_at_a_crawl_does_not_brake() {
    let mut rig = Rig::driving_with(configuration());
    rig.pulse_period_us = Some(40_000);
    rig.drive_for(200 * MS, 120, 0);
    rig.disarm();
    assert_eq!(rig.esc_us(), NEUTRAL);
}

#[test]
fn a_disarm_brakes_above_150_mm_s() {
    for (period_us, pulse) in [(33_333, NEUTRAL), (33_000, BRAKE)] {
        let mut rig = Rig::driving_with(configuration());
        rig.pulse_period_us = Some(period_us);
        rig.drive_for(500 * MS, 160, 0);
        rig.disarm();
        assert_eq!(rig.esc_us(), pulse, "{period_us}");
    }
}

#[test]
fn a_brake_pulse_continues_through_a_configuration_that_brakes() {
    let braking = Configuration {
        failsafe: FailsafeAction::Brake,
        ..configuration()
    };
    for (next, pulse) in [
        (braking, BRAKE),
        (configuration(), NEUTRAL),
        (of_kind(EscKind::ForwardReverse), NEUTRAL),
    ] {
        let mut rig = Rig::driving_with(braking);
        rig.run_until(|rig| rig.esc_us() == BRAKE);
        assert_eq!(rig.configure(next), Ok(()));
        rig.run(100 * MS);
        assert_eq!(rig.esc_us(), pulse, "{next:?}");
    }
}

#[test]
fn an_esc_without_brake_gets_no_pulse_below_neutral() {
    let mut rig = Rig::driving_with(of_kind(EscKind::ForwardReverse));
    let pulses = brake_for(&mut rig, 300, 0);
    assert!(count(&pulses, NEUTRAL) >= 290, "{pulses:?}");
    assert!(pulses.iter().all(|&pulse| pulse >= NEUTRAL), "{pulses:?}");
    rig.drive_for(200 * MS, 1_500, 0);
    rig.disarm();
    rig.run(MS);
    assert_eq!(rig.esc_us(), NEUTRAL);
}

#[test]
fn an_esc_without_brake_reverses_from_standstill_without_one() {
    let mut configuration = of_kind(EscKind::ForwardReverse);
    configuration.speed.max_reverse_mm_s = 500;
    let mut rig = Rig::driving_with(configuration);
    // Rolling: neutral, not the brake.
    rig.drive_for(300 * MS, -300, 0);
    assert_eq!(rig.esc_us(), NEUTRAL);
    rig.pulse_period_us = None;
    rig.drive_for(300 * MS, -300, 0);
    assert!(rig.esc_us() < NEUTRAL - 20);
}

#[test]
fn a_brake_in_reverse_is_not_given() {
    let mut configuration = configuration();
    configuration.speed.max_reverse_mm_s = 500;
    let mut rig = Rig::armed_with(configuration);
    rig.drive_for(250 * MS, -500, 0);
    rig.pulse_period_us = Some(10_000);
    rig.drive_for(500 * MS, -500, 0);
    let pulses = brake_for(&mut rig, 200, 0);
    assert_eq!(count(&pulses[20..], NEUTRAL), 180, "{pulses:?}");
}

#[test]
fn a_drive_forward_does_not_earn_a_brake_in_reverse() {
    let mut without_brake = of_kind(EscKind::ForwardReverse);
    without_brake.speed.max_reverse_mm_s = 500;
    let mut rig = Rig::driving_with(without_brake);
    rig.drive_for(100 * MS, -300, 0);
    rig.pulse_period_us = None;
    rig.drive_for(300 * MS, -300, 0);
    assert!(rig.esc_us() < NEUTRAL - 20);
    rig.disarm();
    rig.run(200 * MS);
    // The same ESC, as one that brakes.
    let braking = Configuration {
        failsafe: FailsafeAction::Brake,
        esc: EscCalibration {
            kind: EscKind::Car,
            ..without_brake.esc
        },
        ..without_brake
    };
    assert_eq!(rig.configure(braking), Ok(()));
    assert_eq!(rig.arm(), Ok(()));
    rig.pulse_period_us = Some(16_667);
    rig.drive_for(300 * MS, -300, 0);
    assert!(rig.esc_us() < NEUTRAL - 20);
    for _ in 0..300 {
        rig.run(MS);
        if rig.board.mode() == BoardMode::Failsafe {
            assert_eq!(rig.esc_us(), NEUTRAL);
        }
    }
    assert_eq!(rig.board.mode(), BoardMode::Failsafe);
}

#[test]
fn wheels_that_may_have_stood_at_neutral_are_not_braked() {
    // A pulse every 30 mm: 150 ms after the last one the measured speed is still 0.2 m/s.
    let far_apart = Configuration {
        speed: SpeedLoop {
            pulse_distance_um: 30_000,
            ..configuration().speed
        },
        ..configuration()
    };
    let mut rig = Rig::armed_with(far_apart);
    rig.pulse_period_us = Some(60 * MS);
    rig.drive_for(500 * MS, 500, 0);
    assert!(count(&brake_for(&mut rig, 50, 0), BRAKE) > 30, "it rolls");
    rig.drive_for(500 * MS, 500, 0);
    rig.pulse_period_us = None;
    rig.drive_for(150 * MS, 0, 0);
    assert!(rig.telemetry().motor_speed_mm_s > 150);
    assert_eq!(count(&brake_for(&mut rig, 300, 0), BRAKE), 0);
}

#[test]
fn a_car_that_has_stood_at_neutral_and_is_pushed_is_not_braked() {
    let mut rig = Rig::driving_with(configuration());
    rig.pulse_period_us = None;
    rig.drive_for(200 * MS, 0, 0);
    rig.pulse_period_us = Some(10 * MS);
    assert_eq!(count(&brake_for(&mut rig, 300, 0), BRAKE), 0);
}

#[test]
fn no_stop_brakes_a_car_that_has_stood_at_neutral_and_is_pushed() {
    // By the host, by the board, and by another host.
    let by_disarm = |rig: &mut Rig| rig.disarm();
    let by_timeout = |rig: &mut Rig| {
        rig.run_until(|rig| rig.board.mode() == BoardMode::Failsafe);
    };
    let by_hello = |rig: &mut Rig| rig.greet(78);
    let stops: [fn(&mut Rig); 3] = [by_disarm, by_timeout, by_hello];
    for stop in stops {
        for stands in [true, false] {
            let mut rig = Rig::driving_with(Configuration {
                failsafe: FailsafeAction::Brake,
                ..configuration()
            });
            if stands {
                rig.pulse_period_us = None;
                rig.drive_for(200 * MS, 0, 0);
            }
            rig.pulse_period_us = Some(10 * MS);
            rig.drive_for(100 * MS, 0, 0);
            assert!(rig.telemetry().motor_speed_mm_s > 400);
            stop(&mut rig);
            let pulse = if stands { NEUTRAL } else { BRAKE };
            for _ in 0..100 {
                assert_eq!(rig.esc_us(), pulse, "stands: {stands}");
                rig.run(MS);
            }
        }
    }
}

#[test]
fn a_stop_does_not_brake_wheels_that_stand_although_they_are_driven() {
    // Against a wall: the ESC drives, and takes a pulse below neutral for reverse.
    let mut rig = Rig::driving_with(Configuration {
        failsafe: FailsafeAction::Brake,
        ..configuration()
    });
    rig.pulse_period_us = None;
    rig.drive_for(100 * MS, 1_000, 0);
    assert_eq!(rig.board.mode(), BoardMode::Driving);
    rig.greet(78);
    assert_eq!(rig.board.mode(), BoardMode::Failsafe);
    for _ in 0..100 {
        assert_eq!(rig.esc_us(), NEUTRAL);
        rig.run(MS);
    }
}

#[test]
fn a_car_that_has_stood_since_its_last_drive_and_is_pushed_is_not_braked() {
    let mut rig = Rig::driving_with(configuration());
    // So slow that the disarm does not use the brake up.
    rig.pulse_period_us = Some(40 * MS);
    rig.drive_for(200 * MS, 120, 0);
    rig.disarm();
    rig.pulse_period_us = None;
    rig.run(2_500 * MS);
    assert_eq!(rig.arm(), Ok(()));
    rig.pulse_period_us = Some(10 * MS);
    rig.run(100 * MS);
    assert_eq!(count(&brake_for(&mut rig, 300, 0), BRAKE), 0);
}
