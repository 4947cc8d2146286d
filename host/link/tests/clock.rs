//! The board's clock in host time, against a simulated resonator.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // Helpers of tests are tests.

use proptest::{prelude::*, test_runner::FileFailurePersistence};
use singletrack_control::statistics::Random;
use singletrack_link::{BoardClock, Stamp, StampOutcome};

/// A board whose clock runs `skew` fast, first stamped `first_us`, heard with
/// up to `jitter_ns` of delay.
struct Bench {
    clock: BoardClock,
    noise: Random,
    host_ns: u64,
    board_us: f64,
    skew: f64,
    drift_per_s: f64,
    jitter_ns: u64,
    received_ns: u64,
}

const START_NS: u64 = 1_000_000_000_000;

impl Bench {
    fn new(skew: f64, first_us: u32, jitter_ns: u64, seed: u64) -> Self {
        Self {
            clock: BoardClock::default(),
            noise: Random::new(seed),
            host_ns: START_NS,
            board_us: f64::from(first_us),
            skew,
            drift_per_s: 0.0,
            jitter_ns,
            received_ns: 0,
        }
    }

    fn stamp(&self) -> u32 {
        (self.board_us as u64 & u64::from(u32::MAX)) as u32
    }

    /// One record, 10 ms after the one before; its stamp and its error in ns.
    fn record(&mut self) -> (Stamp, i64) {
        self.host_ns += 10_000_000;
        self.board_us += 10_000.0 * (1.0 + self.skew);
        self.skew += self.drift_per_s * 0.01;
        let delay_ns = self.noise.bits() % (self.jitter_ns + 1);
        // One reader, one line: records can't overtake each other.
        self.received_ns = (self.host_ns + delay_ns).max(self.received_ns);
        match self.clock.observe(self.received_ns, self.stamp()) {
            StampOutcome::Mapped(stamp) => (stamp, stamp.host_time_ns as i64 - self.host_ns as i64),
            other => panic!("a good stamp was taken for {other:?}"),
        }
    }
}

#[test]
fn the_error_is_below_600_us_after_one_second_and_150_us_with_a_full_window() {
    let mut worst_after_1_s = 0;
    let mut worst_after_7_s = 0;
    for seed in 0..40 {
        for skew in [-0.005, -0.0001, 0.0, 0.002, 0.005] {
            let mut bench = Bench::new(skew, 5_000_000, 3_000_000, seed);
            for record in 0..1_500 {
                let (_, error_ns) = bench.record();
                if record >= 100 {
                    worst_after_1_s = worst_after_1_s.max(error_ns.abs());
                }
                if record >= 700 {
                    worst_after_7_s = worst_after_7_s.max(error_ns.abs());
                }
            }
            let expected_ppm = (1.0 / (1.0 + skew) - 1.0) * 1e6;
            let error_ppm = (bench.clock.skew_ppm() - expected_ppm).abs();
            assert!(error_ppm < 100.0, "skew {skew}: off by {error_ppm} ppm");
        }
    }
    println!("worst error: {worst_after_1_s} ns after 1 s, {worst_after_7_s} ns after 7 s");
    assert!(worst_after_1_s < 600_000, "{worst_after_1_s} ns");
    assert!(worst_after_7_s < 150_000, "{worst_after_7_s} ns");
}

#[test]
fn the_first_second_is_never_worse_than_jitter_and_skew_allow() {
    for seed in 0..40 {
        for skew in [-0.005, 0.0, 0.005] {
            let mut bench = Bench::new(skew, 0, 3_000_000, seed);
            for _ in 0..100 {
                let (_, error_ns) = bench.record();
                assert!(error_ns.abs() <= 3_000_000 + 1_500_000, "{error_ns} ns");
            }
        }
    }
}

#[test]
fn a_resonator_that_warms_up_is_followed() {
    let mut bench = Bench::new(0.003, 0, 3_000_000, 5);
    bench.drift_per_s = 10e-6;
    let mut worst = 0;
    for record in 0..6_000 {
        let (_, error_ns) = bench.record();
        if record >= 700 {
            worst = worst.max(error_ns.abs());
        }
    }
    assert!(worst < 400_000, "{worst} ns");
}

#[test]
fn the_wrap_of_the_boards_microseconds_is_seamless() {
    let mut bench = Bench::new(-0.005, u32::MAX - 4_000_000, 2_000_000, 9);
    let mut elapsed_us = 0;
    let mut last_ns = 0;
    for record in 0..1_000 {
        let (stamp, error_ns) = bench.record();
        assert!(record < 100 || error_ns.abs() < 600_000, "{error_ns} ns");
        assert!(stamp.board_elapsed_us > elapsed_us || record == 0);
        assert!(stamp.host_time_ns >= last_ns);
        elapsed_us = stamp.board_elapsed_us;
        last_ns = stamp.host_time_ns;
    }
    assert!(bench.stamp() < 10_000_000, "the counter has wrapped");
    assert!((9_000_000..10_000_000).contains(&elapsed_us));
}

#[test]
fn the_mapping_is_exact_after_days_of_wrapping() {
    let mut bench = Bench::new(0.005, 17, 1_000_000, 3);
    for _ in 0..200 {
        bench.record();
    }
    // 20 wraps, a record every 10 minutes, then 100 Hz again.
    for _ in 0..150 {
        bench.host_ns += 600_000_000_000;
        bench.board_us += 600e6 * 1.005;
        bench.record();
    }
    for _ in 0..700 {
        bench.record();
    }
    let (stamp, error_ns) = bench.record();
    assert!(stamp.board_elapsed_us > 20 * u64::from(u32::MAX));
    assert!(error_ns.abs() < 250_000, "{error_ns} ns");
}

#[test]
fn the_stated_uncertainty_covers_98_of_100_errors() {
    let mut outside = 0;
    let mut records = 0;
    for seed in 0..20 {
        let mut bench = Bench::new(0.004, 0, 3_000_000, seed);
        for _ in 0..1_000 {
            let (_, error_ns) = bench.record();
            let stated_ns = bench.clock.uncertainty_ns().unwrap();
            records += 1;
            outside += usize::from(error_ns.unsigned_abs() > stated_ns);
        }
        let settled_ns = bench.clock.uncertainty_ns().unwrap();
        assert!(settled_ns < 1_200_000, "{settled_ns} ns says nothing");
    }
    println!("{outside} of {records} outside");
    assert!(outside * 50 < records, "{outside} of {records}");
}

#[test]
fn a_line_that_was_stuck_delivers_old_records_with_their_own_time() {
    let mut bench = Bench::new(0.002, 0, 500_000, 1);
    for _ in 0..300 {
        bench.record();
    }
    // 30 records arrive at once, when the last of them is made.
    let release_ns = bench.host_ns + 300_000_000;
    for _ in 0..30 {
        bench.host_ns += 10_000_000;
        bench.board_us += 10_020.0;
        let StampOutcome::Mapped(stamp) = bench.clock.observe(release_ns, bench.stamp()) else {
            panic!("late is not implausible");
        };
        let error_ns = stamp.host_time_ns as i64 - bench.host_ns as i64;
        assert!(error_ns.abs() < 200_000, "{error_ns} ns");
    }
}

#[test]
fn one_impossible_stamp_is_dropped_and_two_mean_a_restart() {
    let mut bench = Bench::new(0.0, 60_000_000, 0, 1);
    for _ in 0..100 {
        bench.record();
    }
    let before = bench.clock.host_time_ns(bench.stamp());
    let now_ns = bench.host_ns + 1_000_000;
    // Behind, the same again, and an hour ahead.
    for stamp_us in [3_000_000_000, bench.stamp(), 1_000_000_000] {
        let mut clock = bench.clock.clone();
        assert_eq!(clock.observe(now_ns, stamp_us), StampOutcome::Implausible);
        assert_eq!(clock.host_time_ns(bench.stamp()), before);
    }
    bench.clock.observe(now_ns, 3_000_000_000);
    // The record after it fits, and ends the run of impossible ones.
    bench.record();
    let now_ns = bench.host_ns + 1_000_000;
    assert_eq!(bench.clock.observe(now_ns, 10), StampOutcome::Implausible);
    assert_eq!(
        bench.clock.observe(now_ns + 10_000_000, 10_010),
        StampOutcome::Restarted
    );
    bench.clock.restart();
    assert!(matches!(
        bench.clock.observe(now_ns + 20_000_000, 20_010),
        StampOutcome::Mapped(_)
    ));
}

#[test]
fn a_delay_of_the_first_record_does_not_shift_later_ones() {
    let mut clock = BoardClock::default();
    // The first record was held up for 50 ms; the second one shows it.
    let first = clock.observe(START_NS + 50_000_000, 0);
    let second = clock.observe(START_NS + 50_000_001, 10_000);
    let third = clock.observe(START_NS + 50_000_002, 50_000);
    for (observation, at_ns) in [
        (first, START_NS + 50_000_000),
        (second, START_NS + 50_000_001),
        (third, START_NS + 50_000_002),
    ] {
        let StampOutcome::Mapped(stamp) = observation else {
            panic!("{observation:?}");
        };
        assert_eq!(stamp.host_time_ns, at_ns);
    }
}

proptest! {
    #![proptest_config(ProptestConfig {
        failure_persistence: Some(Box::new(FileFailurePersistence::WithSource("regressions"))),
        ..ProptestConfig::default()
    })]

    #[test]
    fn stamps_never_run_backwards_nor_ahead_of_their_arrival(
        steps in prop::collection::vec((0_u64..400_000_000, any::<u32>(), any::<bool>()), 1..300),
    ) {
        let mut clock = BoardClock::default();
        let (mut now_ns, mut board_us, mut last_ns) = (0_u64, 0_u32, 0_u64);
        for (elapsed_ns, random, sane) in steps {
            now_ns += elapsed_ns;
            board_us = if sane {
                board_us.wrapping_add((elapsed_ns / 1_000) as u32)
            } else {
                random
            };
            match clock.observe(now_ns, board_us) {
                StampOutcome::Mapped(stamp) => {
                    prop_assert!(stamp.host_time_ns <= now_ns);
                    prop_assert!(stamp.host_time_ns >= last_ns);
                    last_ns = stamp.host_time_ns;
                }
                StampOutcome::Implausible => {}
                StampOutcome::Restarted => {
                    clock.restart();
                    last_ns = 0;
                }
            }
        }
    }
}
