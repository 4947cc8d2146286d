//! Schedules: generation, text form, and repeatability.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use proptest::prelude::*;
use singletrack_campaign::CampaignArgs;
use singletrack_faults::{
    Campaign, CampaignOutcome, Untampered, Until, Violation, drive,
    schedule::{Deviation, FaultKind, OperatorRequest, Schedule},
};
use singletrack_sim::BoardKind;

proptest! {
    #[test]
    fn a_schedule_round_trips_through_its_text(seed: u64) {
        let schedule = Schedule::generate(seed, BoardKind::Native);
        prop_assert_eq!(&schedule.to_string().parse::<Schedule>().unwrap(), &schedule);
        prop_assert_eq!(&schedule.in_one_line().parse::<Schedule>().unwrap(), &schedule);
    }

    #[test]
    fn a_generated_schedule_is_within_bounds(seed: u64) {
        let schedule = Schedule::generate(seed, BoardKind::Native);
        // At most fifteen, and three of the operator: two that hang, and wild pulses.
        prop_assert!((1..=18).contains(&schedule.faults.len()));
        prop_assert!(schedule.requests.iter().any(|ask| ask.request == OperatorRequest::Arm));
        prop_assert!(schedule.requests.is_sorted_by_key(|ask| ask.at_ms));
        for fault in &schedule.faults {
            prop_assert!((1..=1_000).contains(&fault.severity), "{fault}");
            prop_assert!(fault.at_ms <= schedule.end_ms, "{fault}");
        }
    }
}

#[test]
fn the_page_says_of_every_fault_whether_it_is_kinder_than_the_world() {
    let page = include_str!("../../../docs/faults.md");
    let (_, table) = page.split_once("## Which faults are kinder").unwrap();
    for kind in FaultKind::ALL {
        let name = format!("`{}`", kind.name());
        assert!(table.contains(&name), "docs/faults.md does not name {name}");
    }
}

#[test]
fn a_pulled_plug_takes_the_boards_power_along_unless_it_has_its_own() {
    let outcome = |own_supply: bool, faults: &[&str]| {
        let mut text = format!(
            "seed 7; proved true; speed_mm_s 1000; fence_mm 8000; esc_kind vesc; own_supply {own_supply}; \
             end_ms 11000; ask arm at 3200"
        );
        for fault in faults {
            text += &format!("; fault {fault} at 7000 for 2000 severity 1");
        }
        let outcome = drive(&text.parse().unwrap(), &mut Untampered, Until::End).unwrap();
        assert_eq!(outcome.violation, None, "{text}");
        outcome.digest
    };
    let plug = outcome(false, &["line-unplugged"]);
    assert_eq!(plug, outcome(false, &["line-unplugged", "board-off"]));
    let own = outcome(true, &["line-unplugged"]);
    assert_ne!(own, plug);
    assert_ne!(own, outcome(true, &["line-unplugged", "board-off"]));
}

#[test]
fn every_kind_of_fault_occurs_within_a_thousand_seeds() {
    let seeds = 0..1_000;
    let schedules: Vec<_> = seeds
        .map(|seed| Schedule::generate(seed, BoardKind::Native))
        .collect();
    for kind in FaultKind::ALL {
        let faults = schedules.iter().flat_map(|schedule| &schedule.faults);
        let count = faults.filter(|fault| fault.kind == *kind).count();
        assert!(count >= 20, "{}: {count}", kind.name());
    }
}

#[test]
fn most_schedules_hold_their_drives_and_many_jog() {
    let schedules: Vec<_> = (0..1_000)
        .map(|seed| Schedule::generate(seed, BoardKind::Native))
        .collect();
    let count = |is: &dyn Fn(&Schedule) -> bool| schedules.iter().filter(|it| is(it)).count();
    let attended = count(&|schedule| schedule.situation.attended);
    assert!((550..650).contains(&attended), "{attended}");
    for request in [
        OperatorRequest::Gone,
        OperatorRequest::TimeUp,
        OperatorRequest::Halt,
        OperatorRequest::Jog,
        OperatorRequest::JogOn,
        OperatorRequest::Lift,
        OperatorRequest::PutDown,
    ] {
        let asked = count(&|schedule| schedule.requests.iter().any(|ask| ask.request == request));
        assert!(asked >= 50, "{request:?}: {asked}");
    }
}

#[test]
fn no_car_is_quite_as_configured_and_some_are_not_at_all() {
    let seeds = 0..1_000;
    let schedules: Vec<_> = seeds
        .map(|seed| Schedule::generate(seed, BoardKind::Native))
        .collect();
    for &deviation in Deviation::ALL {
        let values = schedules.iter().map(|schedule| {
            let value = schedule.truth.get(deviation).unwrap();
            assert!(
                deviation.possible().contains(&value),
                "{}",
                deviation.name()
            );
            value
        });
        let least = *deviation.tolerable().start();
        let varies = deviation.tolerable().count() > 1;
        assert!(values.filter(|&value| value != least).count() > 0 || !varies);
    }
    let tolerable = schedules.iter().filter(|schedule| schedule.is_tolerable());
    let tolerable = tolerable.count();
    assert!((300..700).contains(&tolerable), "{tolerable}");
}

#[test]
fn every_property_of_the_car_is_far_outside_its_tolerance_in_some_schedules() {
    let schedules: Vec<_> = (0..8_000)
        .map(|seed| Schedule::generate(seed, BoardKind::Native))
        .collect();
    for &deviation in Deviation::ALL {
        // Every heading is tolerable.
        if deviation == Deviation::SlopeHeading {
            continue;
        }
        let outside = |proved: bool| {
            let outside = schedules.iter().filter(|schedule| {
                let value = schedule.truth.get(deviation).unwrap();
                !deviation.tolerable().contains(&value) && schedule.situation.proved == proved
            });
            outside.count()
        };
        for proved in [false, true] {
            assert!(outside(proved) >= 3, "{} {proved}", deviation.name());
        }
    }
}

#[test]
fn an_invalid_entry_is_reported_with_the_accepted_forms() {
    let error = |text: &str| text.parse::<Schedule>().unwrap_err().to_string();
    for bad in [
        "fault camera-lost at 5 for 5 severity 5",
        "fault line-drop at 5 for 5 severity 0",
        "ask arm 5",
        "speed_mm_s fast",
        "speed 5",
        "truth servo-trim-us 2000",
        "truth servo-trim 20",
        "esc_kind learns-neutral",
    ] {
        let message = error(bad);
        assert!(message.contains(bad), "{message}");
        assert!(message.contains("fault KIND at MS"), "{message}");
    }
    assert!(error("seed 5").contains("no end_ms"));
    assert!(error("end_ms 5 # and so on").contains("no seed"));
}

#[test]
fn the_same_schedule_gives_the_same_bits_and_another_seed_differs() {
    let digest = |seed| {
        let mut schedule = Schedule::generate(seed, BoardKind::Native);
        schedule.end_ms = schedule.end_ms.min(6_000);
        drive(&schedule, &mut Untampered, Until::Violation).unwrap()
    };
    for seed in [3, 4] {
        assert_eq!(digest(seed), digest(seed));
    }
    assert_ne!(digest(3).digest, digest(4).digest);
}

#[test]
fn the_wall_clock_has_no_effect() {
    let text = "seed 7; end_ms 8000; ask arm at 3200";
    let plain: Schedule = text.parse().unwrap();
    let stepped = format!("{text}; fault wall-clock-step at 4000 for 2000 severity 1000");
    let stepped: Schedule = stepped.parse().unwrap();
    let outcome = drive(&plain, &mut Untampered, Until::Violation).unwrap();
    assert!(outcome.driven_ms > 4_000, "{outcome:?}");
    assert_eq!(
        outcome,
        drive(&stepped, &mut Untampered, Until::Violation).unwrap()
    );
}

/// The first violation of a schedule without a planted bug.
fn violation(text: &str) -> Option<Violation> {
    let schedule: Schedule = text.parse().unwrap();
    let outcome = drive(&schedule, &mut Untampered, Until::Violation).unwrap();
    outcome.violation
}

#[test]
fn a_reload_before_the_first_tick_of_a_daemon_belongs_to_that_daemon() {
    let text = "seed 15920; end_ms 7000; ask reload at 5893; ask arm at 6500; \
                fault daemon-killed at 5000 for 893 severity 1";
    assert_eq!(violation(text), None);
}

#[test]
fn an_arm_while_the_last_command_of_a_failed_drive_is_in_force_counts() {
    // The board stops each of these drives, because no motor pulse comes.
    let text = "seed 17319; camera_latency_ms 3; serial_delay_us 6557; board_skew_ppm -2857; \
                board_clock_ms 1193085; end_ms 26960; ask arm at 25458; ask arm at 25778; \
                ask arm at 25887; fault esc-stuck at 2011 for 1 severity 1";
    assert_eq!(violation(text), None);
}

#[test]
fn a_brake_on_the_ramp_does_not_hide_that_a_car_rolls_freely() {
    // Doubled motor pulses make the board brake on the ramp; at neutral the car has half the
    // configured deceleration.
    let text = "seed 103722; reference circle; speed_mm_s 1334; proved true; \
                braking_mm_s2 1209; pulse_distance_um 8405; serial_delay_us 3850; \
                board_skew_ppm 1063; board_clock_ms 3305938; truth motor-gain-permille 54; \
                truth rolling-mm-s2 463; truth viscous-permille 399; truth esc-neutral-us -9; \
                truth esc-deadband-us -6; truth esc-dead-time-ms 28; truth motor-lag-ms 60; \
                truth body-yaw-mrad -14; truth slope-cdeg 27; truth slope-heading-deg 80; \
                truth stamp-drift-ppm -6; truth ringing-edges 1; truth drained-mah 253; \
                end_ms 6300; ask arm at 3200; ask arm at 6247";
    assert_eq!(violation(text), None);
}

#[test]
fn one_speed_that_is_estimated_too_high_does_not_hide_that_a_car_brakes_weakly() {
    // At 49 % of the configured deceleration: the last high speed of the long stop is 4 % too high.
    let text = "seed 1600390; reference circle; speed_mm_s 1151; coast true; brake true; proved \
                true; queue_shows true; steering_table true; esc_kind forward-reverse; fence_mm \
                2085; braking_mm_s2 2400; pulse_distance_um 3000; camera_latency_ms 19; \
                serial_delay_us 5855; board_skew_ppm 469; board_clock_ms 1616419; truth \
                servo-trim-us -8; truth servo-gain-permille 73; truth servo-rate-mrad-s 7577; \
                truth pulse-distance-permille 11; truth motor-gain-permille 22; truth \
                rolling-mm-s2 976; truth viscous-permille 835; truth esc-neutral-us -9; truth \
                esc-dead-time-ms 56; truth motor-lag-ms 81; truth esc-signal-loss-ms 881; truth \
                body-yaw-mrad -1; truth pivot-forward-mm 2; truth pivot-left-mm 7; truth \
                servo-backlash-us 3; truth slope-cdeg 27; truth slope-heading-deg 47; truth \
                imu-yaw-ddeg -14; truth imu-pitch-ddeg 1; truth imu-roll-ddeg -3; truth \
                gyro-scale-permille -13; truth acceleration-scale-permille -11; truth \
                imu-leak-ms 35129; truth vibration-mm-s2 941; truth stamp-bias-us -1180; truth \
                stamp-drift-ppm 7; truth body-height-mm 177; truth supply-mv 5083; truth \
                drained-mah 568; truth servo-asymmetry-permille 22; end_ms 9600; ask arm at \
                3200; ask arm at 4334; ask arm at 4523; ask arm at 4962; ask disarm at 5300; ask \
                arm at 5955; ask disarm at 6712; ask arm at 8860";
    assert_eq!(violation(text), None);
}

#[test]
fn cameras_that_show_too_fast_a_car_do_not_hide_that_it_brakes_weakly() {
    // The body's pivot is beside the car: on a circle the cameras see it half as fast again.
    let text = "seed 105312; reference circle; speed_mm_s 1001; proved true; \
                esc_kind forward-reverse; braking_mm_s2 2400; board_skew_ppm 3000; \
                truth rolling-mm-s2 1003; truth viscous-permille 148; truth pivot-left-mm -321; \
                truth slope-cdeg 31; truth slope-heading-deg 144; end_ms 7800; \
                ask arm at 4176; ask arm at 7766";
    assert_eq!(violation(text), None);
}

#[test]
fn an_esc_with_a_narrow_deadband_holds_a_slow_pulse_of_a_board_that_is_reset() {
    let text = "seed 109645; reference external; safety_filter true; proved false; \
                reset_on_open true; fence_mm 122; camera_latency_ms 5; serial_delay_us 6855; board_skew_ppm -3928; \
                board_clock_ms 1230692; truth servo-trim-us 14; truth motor-gain-permille 51; \
                truth esc-deadband-us -4; truth esc-dead-time-ms 11; \
                truth esc-signal-loss-ms 991; end_ms 12000; ask arm at 7000; \
                fault loop-bang-bang at 6242 for 5587 severity 51; \
                fault board-reset at 10653 for 1 severity 1";
    assert_eq!(violation(text), None);
}

#[test]
fn a_trim_in_a_bend_is_not_taken_for_a_wrong_gain() {
    // The turn is 0.73 of what the steering should make: gain, trim and play are wrong to one side.
    let text = "seed 361; proved false; braking_mm_s2 614; board_skew_ppm 4014; \
                truth servo-trim-us -17; truth servo-gain-permille 64; truth esc-deadband-us 5; \
                truth servo-backlash-us 10; truth servo-asymmetry-permille -19; \
                truth servo-dead-band-us 4; end_ms 6500; ask arm at 3200";
    assert_eq!(violation(text), None);
}

#[test]
fn wrong_bits_of_the_imu_neither_alarm_nor_end_a_drive() {
    for severity in [1, 900, 1_000] {
        let schedule: Schedule = format!(
            "seed 7; proved true; end_ms 12000; ask arm at 3200; \
             fault imu-wrong-bit at 6000 for 6000 severity {severity}"
        )
        .parse()
        .unwrap();
        let outcome = drive(&schedule, &mut Untampered, Until::Violation).unwrap();
        assert_eq!(outcome.violation, None, "{severity}");
        assert!(
            outcome.driven_ms > 8_000,
            "{severity}: {}",
            outcome.driven_ms
        );
    }
}

/// Left out of `cargo verify`, not of `--all`: they take seconds of processor time each.
mod thorough {
    use super::*;

    #[test]
    fn threads_and_shards_have_no_effect_and_nothing_is_violated() {
        let campaign = Campaign {
            first_seed: 500,
            count: 6,
            board: BoardKind::Native,
            until: Until::Violation,
        };
        let run = |shard: &str, threads| {
            let arguments = CampaignArgs {
                shard: Some(shard.parse().unwrap()),
                threads: Some(threads),
                ..CampaignArgs::default()
            };
            let campaign = singletrack_campaign::Campaign::obtain(campaign, &arguments).unwrap();
            campaign.results
        };
        let one = run("1/1", 1);
        let mut parts: Vec<_> = (1..=3).flat_map(|k| run(&format!("{k}/3"), 2)).collect();
        parts.sort_by_key(|(unit, _)| *unit);
        assert_eq!(one, parts);
        let outcome = CampaignOutcome::of(one.iter().map(|(_, outcome)| outcome)).unwrap();
        assert_eq!(outcome.failures, []);
        assert_eq!(outcome.count, 6);
        assert!(outcome.driven_s > 15.0, "{}", outcome.driven_s);
    }

    #[test]
    fn some_cars_run_at_neutral() {
        let runs = (0..500)
            .map(|seed| Schedule::generate(seed, BoardKind::Native))
            .filter(|schedule| schedule.situation.neutral_us != 1_500)
            .filter(|schedule| {
                let outcome = drive(schedule, &mut Untampered, Until::Violation).unwrap();
                outcome.reasons.contains("runs-at-neutral")
            });
        let count = runs.count();
        assert!(count >= 5, "{count}");
    }

    /// For as long as the cameras see the car aside of where it is, it drives on or slows down: the law is
    /// never asked for a sideslip at which it is singular, and nothing is dropped to neutral.
    #[test]
    fn cameras_that_err_by_centimetres_leave_the_law_out_of_its_singularity() {
        for (mm, ms) in [5, 10, 20, 22, 25, 28, 34, 40, 50, 60, 80]
            .into_iter()
            .flat_map(|mm| [10, 20, 60, 100, 200, 400].map(|ms| (mm, ms)))
        {
            let text = format!(
                "seed 7; end_ms 7500; speed_mm_s 400; ask arm at 3200; \
                 fault camera-jump at 6000 for {ms} severity {mm}"
            );
            let schedule: Schedule = text.parse().unwrap();
            let outcome = drive(&schedule, &mut Untampered, Until::Violation).unwrap();
            assert!(outcome.violation.is_none(), "{text}");
            assert!(!outcome.reasons.contains("law-singular"), "{text}");
        }
    }
}
