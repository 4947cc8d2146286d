//! Planted bugs are found, named, shrunk and reproduced.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

use singletrack_control::Time;
use singletrack_core::config::Config;
use singletrack_faults::{Tamper, Violation, attempt, schedule::Schedule, shrink};
use singletrack_pilot::{Event, Mode};
use singletrack_protocol::{Arm, Decoder, Drive, ToBoard};
use singletrack_record::TickRecord;
use singletrack_sim::PulseRecord;

const NEUTRAL_US: u16 = 1_500;

/// A drive along the circle, with additional entries.
fn schedule(entries: &str) -> Schedule {
    format!("seed 5; end_ms 9000; ask arm at 3200; {entries}")
        .parse()
        .unwrap()
}

fn violation(more: &str, mut tamper: impl Tamper) -> Violation {
    let outcome = attempt(&schedule(more), &mut tamper).unwrap();
    outcome
        .violation
        .unwrap_or_else(|| panic!("nothing was violated: {more}"))
}

/// Asserts that nothing is violated without the bug.
fn assert_no_violation(more: &str) {
    struct Sound;
    impl Tamper for Sound {}
    let outcome = attempt(&schedule(more), &mut Sound).unwrap();
    assert_eq!(outcome.violation, None, "{more}");
    assert!(outcome.driven_ms > 500, "{more}");
}

/// Changes pulses.
struct Pulses<F>(F);

impl<F: FnMut(&mut PulseRecord)> Tamper for Pulses<F> {
    fn pulse(&mut self, pulse: &mut PulseRecord) {
        (self.0)(pulse);
    }
}

/// Stands in for a faulty pilot.
struct Ticks<F>(F);

impl<F: FnMut(&mut TickRecord)> Tamper for Ticks<F> {
    fn tick(&mut self, tick: &mut TickRecord) {
        (self.0)(tick);
    }

    fn is_replayed(&self) -> bool {
        false
    }
}

/// Changes the record of ticks.
struct Records<F>(F);

impl<F: FnMut(&mut TickRecord)> Tamper for Records<F> {
    fn tick(&mut self, tick: &mut TickRecord) {
        (self.0)(tick);
    }
}

/// A board whose driving pulses continue `longer_us` too long.
fn prolonged(longer_us: u64) -> impl Tamper {
    let mut last = (0, NEUTRAL_US);
    Pulses(move |pulse: &mut PulseRecord| {
        let (driven_us, esc_us) = last;
        if pulse.esc_us > NEUTRAL_US {
            last = (pulse.time_us, pulse.esc_us);
        } else if pulse.time_us <= driven_us + longer_us {
            pulse.esc_us = esc_us;
        }
    })
}

/// Changes pulses from 6 s on.
fn from_6_s(mut change: impl FnMut(&mut PulseRecord)) -> impl Tamper {
    Pulses(move |pulse: &mut PulseRecord| {
        if pulse.time_us > 6_000_000 {
            change(pulse);
        }
    })
}

/// Changes driving ticks from 6 s on (one every 10 ms).
fn driving_from_6_s(mut change: impl FnMut(&mut TickRecord)) -> impl Tamper {
    Ticks(move |tick: &mut TickRecord| {
        if tick.index > 600 && tick.output.mode.commands() {
            change(tick);
        }
    })
}

#[test]
fn pulses_beyond_limits_and_slew_are_found() {
    let beyond = violation("", from_6_s(|pulse| pulse.esc_us += 200));
    assert_eq!(beyond.invariant, "pulse-limits");
    let reverse = violation("", from_6_s(|pulse| pulse.esc_us = 1_400));
    assert_eq!(reverse.invariant, "pulse-limits");
    let steered = violation("", from_6_s(|pulse| pulse.servo_us = 1_900));
    assert_eq!(steered.invariant, "servo-slew");
    let full = violation("", from_6_s(|pulse| pulse.esc_us = 1_700));
    assert_eq!(full.invariant, "esc-slew");
}

#[test]
fn a_board_that_drives_before_the_esc_is_armed_or_without_an_arm_request_is_found() {
    let creeping = |from_us: u64| {
        let mut esc_us = NEUTRAL_US;
        Pulses(move |pulse: &mut PulseRecord| {
            if pulse.time_us > from_us && esc_us < 1_650 {
                esc_us += 30;
                pulse.esc_us = esc_us;
            }
        })
    };
    assert_eq!(violation("", creeping(500_000)).invariant, "neutral-first");
    assert_eq!(
        violation("", creeping(2_500_000)).invariant,
        "unarmed-drive"
    );
}

#[test]
fn a_longer_time_to_live_is_found_and_shrunk() {
    // One of these faults silences the host.
    let more = "speed_mm_s 800; fault imu-biased at 3500 for 300 severity 40; \
                fault battery-low at 4000 for 900 severity 20; \
                fault daemon-paused at 6000 for 900 severity 500; \
                fault camera-duplicated at 6500 for 900 severity 100; ask arm at 8500";
    assert_no_violation(more);
    let schedule = schedule(more);
    let found = violation(more, prolonged(60_000));
    assert_eq!(found.invariant, "command-age");
    let (small, again) = shrink(&schedule, &found, || prolonged(60_000)).unwrap();
    assert_eq!(again.invariant, found.invariant);
    assert_eq!(small.faults.len(), 1, "{small}");
    assert!(small.faults[0].for_ms < 200, "{small}");
    assert_eq!(small.requests.len(), 1, "{small}");
    assert_eq!(small.situation.speed_mm_s, 500, "{small}");
    // Its text reproduces the violation.
    let read: Schedule = small.in_one_line().parse().unwrap();
    let replayed = attempt(&read, &mut prolonged(60_000)).unwrap();
    assert_eq!(replayed.violation, Some(again));
}

/// A line that repeats the last command with a younger age.
#[derive(Default)]
struct Repeats {
    decoder: Decoder,
    last: Option<(u64, Drive)>,
}

impl Tamper for Repeats {
    fn to_board(&mut self, now_us: u64, bytes: &mut Vec<u8>) {
        for &byte in &*bytes {
            if let Some(Ok(packet)) = self.decoder.push(byte)
                && let Ok(ToBoard::Drive(drive)) = ToBoard::decode(packet)
            {
                self.last = Some((now_us, drive));
            }
        }
        if let Some((then_us, drive)) = &mut self.last
            && now_us >= *then_us + 20_000
        {
            drive.telemetry_time_us = drive.telemetry_time_us.wrapping_add(20_000);
            drive.sequence = drive.sequence.next();
            *then_us = now_us;
            bytes.extend(ToBoard::from(*drive).encode().as_bytes());
        }
    }
}

#[test]
fn an_old_command_repeated_as_a_new_one_is_found() {
    let more = "fault daemon-killed at 6000 for 1500 severity 1";
    assert_no_violation(more);
    assert_eq!(
        violation(more, Repeats::default()).invariant,
        "host-silence"
    );
}

/// A line that sends arm requests and commands by itself.
struct Eager {
    since_us: u64,
    sequence: u8,
    /// Of the configuration that went over the line.
    hash: u32,
}

impl Tamper for Eager {
    fn to_board(&mut self, now_us: u64, bytes: &mut Vec<u8>) {
        let mut decoder = Decoder::new();
        for &byte in bytes.iter() {
            if let Some(Ok(packet)) = decoder.push(byte)
                && let Ok(ToBoard::Configure(configure)) = ToBoard::decode(packet)
            {
                self.hash = configure.configuration.hash();
            }
        }
        // A native board's clock is 0.3 % fast and starts at 65 ms.
        let since_start = now_us.saturating_sub(65_000);
        let telemetry_time_us =
            ((since_start + since_start * 3 / 1_000) as u32).wrapping_sub(5_000);
        if now_us < 2_800_000 || now_us < self.since_us + 20_000 {
            return;
        }
        self.since_us = now_us;
        self.sequence = self.sequence.wrapping_add(1);
        let sequence = singletrack_protocol::Sequence(self.sequence);
        let arm = Arm {
            request: singletrack_protocol::Sequence(7),
            configuration_hash: self.hash,
            telemetry_time_us,
        };
        let drive = Drive {
            sequence,
            speed_mm_s: 500,
            steering_100urad: 0,
            telemetry_time_us,
            pose_age_ms: 5,
            brake: false,
        };
        bytes.extend(ToBoard::from(arm).encode().as_bytes());
        bytes.extend(ToBoard::from(drive).encode().as_bytes());
    }
}

#[test]
fn a_line_that_arms_and_drives_by_itself_is_found() {
    let eager = Eager {
        since_us: 0,
        sequence: 0,
        hash: 0,
    };
    let found = violation("", eager);
    assert_eq!(found.invariant, "host-silence");
    // Before the first arm request.
    assert!(found.time_us < 3_200_000, "{found:?}");
}

/// A line that loses emergency stop requests.
#[derive(Default)]
struct LosesStops;

impl Tamper for LosesStops {
    fn to_board(&mut self, _: u64, bytes: &mut Vec<u8>) {
        let frames = bytes.split_inclusive(|&byte| byte == 0);
        let kept = frames.filter(|frame| {
            let mut decoder = Decoder::new();
            !frame.iter().any(|&byte| {
                matches!(
                    decoder.push(byte),
                    Some(Ok(packet)) if matches!(ToBoard::decode(packet), Ok(ToBoard::EmergencyStop(_)))
                )
            })
        });
        *bytes = kept.flatten().copied().collect();
    }
}

#[test]
fn a_lost_emergency_stop_is_found() {
    assert_no_violation("ask stop at 6000");
    assert_eq!(
        violation("ask stop at 6000", LosesStops).invariant,
        "emergency-stop"
    );
}

#[test]
fn a_board_that_keeps_driving_after_a_stop_or_a_hang_or_without_pulses_is_found() {
    for (more, longer_us, invariant) in [
        ("ask stop at 6000", 41_000, "latched-stop"),
        (
            "stop_input true; fault stop-input-open at 6000 for 900 severity 1",
            81_000,
            "unarmed-drive",
        ),
        (
            "fault board-hang at 6000 for 0 severity 1",
            60_000,
            "main-loop",
        ),
        (
            "fault pulses-gone at 6000 for 900 severity 1",
            200_000,
            "motor-pulses",
        ),
    ] {
        assert_no_violation(more);
        let found = violation(more, prolonged(longer_us));
        assert_eq!(found.invariant, invariant, "{more}: {}", found.details);
    }
}

#[test]
fn a_pilot_that_starts_or_continues_by_itself_is_found() {
    let starts = Ticks(|tick: &mut TickRecord| {
        if tick.index > 280 && tick.output.mode == Mode::Ready {
            tick.output.mode = Mode::Arming;
        }
    });
    assert_eq!(violation("", starts).invariant, "unasked-drive");
    let continues = || {
        driving_from_6_s(|tick| {
            tick.output.mode = Mode::Driving;
            tick.output.reason = None;
        })
    };
    for (more, invariant) in [
        ("ask disarm at 6500", "unasked-drive"),
        (
            "fault camera-silent at 6500 for 900 severity 1000",
            "host-hold",
        ),
        ("fault imu-silent at 6500 for 900 severity 1", "imu-silence"),
        ("fault imu-stuck at 6500 for 900 severity 1", "imu-stuck"),
    ] {
        assert_no_violation(more);
        let found = violation(more, continues());
        assert_eq!(found.invariant, invariant, "{more}: {}", found.details);
    }
}

#[test]
fn a_pilot_with_jumps_contradictions_or_nan_is_found() {
    let jumps = driving_from_6_s(|tick| {
        if tick.index == 650 {
            tick.output.actuation.steering += 0.1;
        }
    });
    assert_eq!(violation("", jumps).invariant, "command-rate");
    let contradicts = driving_from_6_s(|tick| tick.output.mode = Mode::Stopping);
    assert_eq!(violation("", contradicts).invariant, "mode-and-reason");
    let not_a_number = driving_from_6_s(|tick| tick.output.drive_time = Some(f64::NAN));
    assert_eq!(violation("", not_a_number).invariant, "finite");
}

/// A host that takes over another configuration than the one it was given.
struct Configurations<F>(F);

impl<F: FnMut(u32, &mut Config)> Tamper for Configurations<F> {
    fn configuration(&mut self, number: u32, config: &mut Config) {
        (self.0)(number, config);
    }

    fn is_replayed(&self) -> bool {
        false
    }
}

/// Reloaded while it stands, then driven and stopped.
const RELOADED: &str = "ask reload at 2000; ask disarm at 6000";

#[test]
fn a_configuration_that_is_taken_over_by_halves_is_found() {
    assert_no_violation(RELOADED);
    // The board got the new one, the pilot kept the old.
    let slower = |number, config: &mut Config| {
        if number == 2 {
            config.limits.max_acceleration_m_s2 *= 0.9;
            config.control.stop_deceleration_m_s2 *= 0.9;
        }
    };
    assert_eq!(
        violation(RELOADED, Configurations(slower)).invariant,
        "command-rate"
    );
    // The pilot got the new one, the board kept the old.
    let other_board = |number, config: &mut Config| {
        if number == 2 {
            config.board.speed.max_forward_mm_s += 1;
        }
    };
    assert_eq!(
        violation(RELOADED, Configurations(other_board)).invariant,
        "armed-configuration"
    );
}

#[test]
fn a_configuration_that_comes_into_force_during_a_drive_is_found() {
    // Refused by the host.
    assert_no_violation("ask reload at 5000");
    let underway = driving_from_6_s(|tick| {
        if tick.index == 650 {
            let _ = tick.events.push(Event::Reconfigured(2));
        }
    });
    assert_eq!(
        violation("ask reload at 5000", underway).invariant,
        "reconfigured-underway"
    );
}

#[test]
fn a_pilot_that_drives_on_by_old_setpoints_is_found() {
    for fault in ["setpoints-gone", "setpoints-nan"] {
        let more = format!("reference external; fault {fault} at 6500 for 900 severity 1");
        assert_no_violation(&more);
        let goes_on = driving_from_6_s(|tick| {
            tick.output.mode = Mode::Driving;
            tick.output.reason = None;
        });
        let found = violation(&more, goes_on);
        assert_eq!(found.invariant, "setpoint-silence", "{}", found.details);
    }
}

#[test]
fn a_grid_that_jumps_or_leaves_the_cameras_is_found() {
    let jumps = driving_from_6_s(|tick| {
        if tick.index >= 650 {
            tick.scheduled_ns -= 60_000;
        }
    });
    assert_eq!(violation("", jumps).invariant, "tick-grid");
    // As if the grid had never slid: frames arrive just before the tick.
    let unaligned = driving_from_6_s(|tick| {
        let start = tick.start_ns;
        for event in &mut tick.events {
            if let Event::Pose(pose) = event {
                pose.receive = Time(start - 100_000);
            }
        }
    });
    assert_eq!(violation("", unaligned).invariant, "camera-alignment");
}

#[test]
fn a_panic_is_a_violation_with_its_message() {
    let found = violation("", from_6_s(|_| panic!("out of cheese")));
    assert_eq!(found.invariant, "panic");
    assert_eq!(found.details, "out of cheese");
}

#[test]
fn a_flipped_bit_in_a_recorded_output_is_found() {
    let found = violation(
        "",
        Records(|tick: &mut TickRecord| {
            if tick.index == 700
                && let Some(estimate) = &mut tick.output.estimate
            {
                estimate.yaw = f64::from_bits(estimate.yaw.to_bits() ^ 1);
            }
        }),
    );
    assert_eq!(found.invariant, "replayed");
    assert!(
        found.details.starts_with("tick 700: estimate.yaw_rad"),
        "{}",
        found.details
    );
}

#[test]
fn a_flipped_bit_in_a_recorded_input_is_found() {
    let mut flipped = false;
    let found = violation(
        "",
        Records(|tick: &mut TickRecord| {
            for event in tick.events.iter_mut().filter(|_| tick.index >= 700) {
                if let Event::Pose(pose) = event
                    && !std::mem::replace(&mut flipped, true)
                {
                    pose.position.x = f64::from_bits(pose.position.x.to_bits() ^ 1);
                }
            }
        }),
    );
    assert_eq!(found.invariant, "replayed");
}
