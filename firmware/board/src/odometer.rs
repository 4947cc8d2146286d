//! Speed from the motor pulses.

use crate::{
    MotorPulses,
    clock::{Stopwatch, age_us},
};

/// Time without a pulse after which the wheels count as standing still: at least
/// this, and at least that of the speed [`STANDSTILL_US_PER_UM`] with a long pulse
/// distance.
const STANDSTILL_US: u32 = 150_000;

/// 50 mm/s.
const STANDSTILL_US_PER_UM: u32 = 20;

/// Driving time without a pulse before which the sensor has not failed: with a dead
/// sensor, the speed loop would go to full throttle.
const SENSOR_PATIENCE_US: u32 = 150_000;

/// Driving time at a start for which no pulse is expected, where the pulses are far
/// apart: the speed loop does not yet help a car that is slower than configured.
const START_US: u32 = 100_000;

/// Driving time without a pulse after which the sensor has failed in any case.
const SENSOR_TIMEOUT_US: u32 = 600_000;

/// A car this slow may stand before an ESC answers.
const ROLLS_MM_S: u32 = 50;

/// Pulse distance assumed before the configuration, in µm: the longest one, so that
/// wheels that turn are not taken for standing.
const UNKNOWN_DISTANCE_UM: u16 = 30_000;

/// Time without a pulse after which the speed is zero. The next pulse only starts a
/// new interval.
const INTERVAL_TIMEOUT_US: u32 = 500_000;

/// Pulses after a standstill until the speed has been measured: two that are an
/// interval apart.
const FIRST_PULSES: u8 = 2;

/// Pulse distance up to which the second pulse comes before a standstill that has not
/// been measured matters: to the speed loop, which gains little speed on the way, and
/// to the watch, which waits for longer than a car needs to follow its command.
const FINE_DISTANCE_UM: u16 = 5_000;

/// Larger numbers of pulses are halved, together with their time, so that the
/// product with the distance fits in 32 bits: 2^16 · 1000 · 64 < 2^32.
const MAX_PULSES: u32 = 64;

/// Speed and state of the motor sensor.
#[derive(Clone, Debug)]
pub(crate) struct Odometer {
    /// The newest pulse; `None` before the first poll.
    newest: Option<MotorPulses>,
    /// First pulse of the current interval.
    reference: Option<MotorPulses>,
    since_pulse: Stopwatch,
    /// Driving time since the last pulse, without short pauses.
    driven: Stopwatch,
    not_driven: Stopwatch,
    /// Distance commanded in that driving time, in units of 1.024 µm.
    commanded: u32,
    /// Commanded distance within which a pulse must come, in the same units.
    patience: u32,
    /// The pulses are far apart: [`FINE_DISTANCE_UM`].
    coarse: bool,
    standstill_us: u32,
    creep_us: u32,
    speed_mm_s: i16,
    /// Pulses until the speed of this drive has been measured.
    unmeasured: u8,
    /// Driving time since this drive began, or since its last pulse.
    without_pulse: Stopwatch,
}

/// What the ESC was doing since the last poll.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Driven {
    /// Its pulse was beyond the deadband.
    pub(crate) driven: bool,
    /// Magnitude of the commanded speed.
    pub(crate) target_mm_s: u16,
}

impl Odometer {
    pub(crate) const fn new() -> Self {
        Self {
            newest: None,
            reference: None,
            since_pulse: Stopwatch::started_ago(u32::MAX),
            driven: Stopwatch::started(),
            not_driven: Stopwatch::started(),
            commanded: 0,
            patience: patience(UNKNOWN_DISTANCE_UM),
            coarse: true,
            standstill_us: standstill_us(UNKNOWN_DISTANCE_UM),
            creep_us: standstill_us(UNKNOWN_DISTANCE_UM),
            speed_mm_s: 0,
            unmeasured: FIRST_PULSES,
            without_pulse: Stopwatch::started(),
        }
    }

    /// Adapts the waiting times to the sensor.
    pub(crate) const fn configure(&mut self, pulse_distance_um: u16) {
        self.patience = patience(pulse_distance_um);
        self.coarse = pulse_distance_um > FINE_DISTANCE_UM;
        self.standstill_us = standstill_us(pulse_distance_um);
        // Half the speed.
        self.creep_us = standstill_us(pulse_distance_um.saturating_mul(2));
    }

    /// Updates the pulses in every poll.
    pub(crate) fn observe(
        &mut self,
        now_us: u32,
        elapsed_us: u32,
        pulses: MotorPulses,
        esc: Driven,
    ) {
        self.since_pulse.advance(elapsed_us);
        if esc.target_mm_s == 0 {
            self.unmeasured = FIRST_PULSES;
            self.without_pulse = Stopwatch::started();
        }
        if esc.driven {
            self.driven.advance(elapsed_us);
            self.without_pulse.advance(elapsed_us);
            // A car that starts follows its command late.
            if !self.starts() || self.driven.elapsed_us() >= START_US {
                // A poll later than this is a fault of its own.
                let elapsed_us = u16::try_from(elapsed_us).unwrap_or(u16::MAX);
                let commanded = (u32::from(esc.target_mm_s) * u32::from(elapsed_us)) >> 10;
                // The time-out comes before an overflow: below 2^21 per poll.
                self.commanded = self.commanded.wrapping_add(commanded);
            }
            self.not_driven = Stopwatch::started();
        } else {
            self.not_driven.advance(elapsed_us);
            // A shorter pause does not reset time and distance, so that driving in
            // bursts can't hide a dead sensor.
            if self.not_driven.elapsed_us() >= self.standstill_us {
                self.expect_pulse();
            }
        }
        let newest = *self.newest.get_or_insert(pulses);
        if newest.count != pulses.count {
            self.newest = Some(pulses);
            let new = pulses.count.wrapping_sub(newest.count);
            let new = u8::try_from(new).unwrap_or(u8::MAX);
            self.unmeasured = self.unmeasured.saturating_sub(new);
            // An edge later than `now_us` counts as an edge now.
            let age = age_us(now_us, pulses.last_edge_us).unwrap_or(0);
            self.since_pulse = Stopwatch::started_ago(age);
            self.without_pulse = Stopwatch::started();
            self.expect_pulse();
        }
    }

    /// Starts to wait for a pulse again.
    const fn expect_pulse(&mut self) {
        self.driven = Stopwatch::started();
        self.commanded = 0;
    }

    /// Pulses so far, wrapping.
    pub(crate) fn count(&self) -> u16 {
        self.newest.map_or(0, |newest| newest.count)
    }

    pub(crate) const fn is_moving(&self) -> bool {
        self.since_pulse.elapsed_us() < self.standstill_us
    }

    /// Whether the wheels may still creep, at 25 mm/s or more.
    pub(crate) const fn is_creeping(&self) -> bool {
        self.since_pulse.elapsed_us() < self.creep_us
    }

    /// Whether the wheels have come to rest: a car that has just been driven may roll
    /// before its first pulse.
    pub(crate) const fn is_at_rest(&self) -> bool {
        !self.is_moving() && self.not_driven.elapsed_us() >= self.standstill_us
    }

    /// Whether the motor has been driven for too long without a pulse: over a
    /// commanded distance, because a pulse takes distance, and over a time, because
    /// a car that is commanded to crawl must move too.
    pub(crate) const fn has_failed(&self) -> bool {
        let driven_us = self.driven.elapsed_us();
        driven_us >= SENSOR_PATIENCE_US
            && self.since_pulse.elapsed_us() >= SENSOR_PATIENCE_US
            && (self.commanded >= self.patience || driven_us >= SENSOR_TIMEOUT_US)
    }

    /// Measures the speed; called once per control period.
    ///
    /// The speed is the number of pulses since the last call over the time between
    /// the first and the last of them. Without pulses, it is limited to one pulse
    /// in the time since the last one.
    #[inline(never)]
    pub(crate) fn measure(&mut self, pulse_distance_um: u16) {
        let Some(newest) = self.newest else { return };
        let waited_us = self.since_pulse.elapsed_us();
        let new_pulses = self
            .reference
            .map_or(0, |reference| newest.count.wrapping_sub(reference.count));
        self.speed_mm_s = match self.reference {
            Some(reference) if new_pulses != 0 => {
                let span_us = newest.last_edge_us.wrapping_sub(reference.last_edge_us);
                speed_mm_s(pulse_distance_um, new_pulses.into(), span_us)
            }
            _ if waited_us >= INTERVAL_TIMEOUT_US => 0,
            _ => self
                .speed_mm_s
                .min(speed_mm_s(pulse_distance_um, 1, waited_us)),
        };
        self.reference = (waited_us < INTERVAL_TIMEOUT_US).then_some(newest);
        if self.reference.is_none() {
            self.unmeasured = FIRST_PULSES;
        }
    }

    /// Whether a drive has not had its second pulse yet, and that is a long way.
    const fn starts(&self) -> bool {
        self.coarse && self.unmeasured != 0
    }

    /// The speed on which the speed loop acts.
    ///
    /// At a start, zero is no measurement, and a loop that acts on it makes the car much
    /// faster than its command before the second pulse. The car is therefore taken to
    /// follow its command until it is late, and then for as fast as one that has
    /// travelled a pulse distance since it was driven or gave its last pulse.
    pub(crate) fn controlled_mm_s(&self, pulse_distance_um: u16, target_mm_s: i16) -> i16 {
        if !self.starts() {
            return self.speed_mm_s;
        }
        let possible = speed_mm_s(pulse_distance_um, 1, self.without_pulse.elapsed_us());
        self.speed_mm_s
            .max(possible.min(target_mm_s.saturating_abs()))
    }

    /// Whether the wheels turn for certain: faster than [`ROLLS_MM_S`] even if they have slowed down
    /// by 3.9 m/s² since the last pulse. The speed is a mean over the last interval, so that it holds
    /// up to 3 m/s², more than a car slows down at neutral.
    pub(crate) fn rolls(&self) -> bool {
        // Without a division.
        let slowed_mm_s = self.since_pulse.elapsed_us() >> 8;
        u32::from(self.speed_mm_s.unsigned_abs()) > slowed_mm_s.saturating_add(ROLLS_MM_S)
    }

    /// Magnitude of the speed, in mm/s.
    pub(crate) const fn speed_mm_s(&self) -> i16 {
        self.speed_mm_s
    }
}

/// Two and a half pulse distances: one until the first edge, wherever the wheel
/// stands, and the rest for a car that follows its command late. With 2 m/s², one that
/// is late by 0.09 s is behind by [`LATE_UM`] when it has made 12 mm.
const fn patience(pulse_distance_um: u16) -> u32 {
    let distance = pulse_distance_um as u32;
    2 * distance + distance / 2 + LATE_UM
}

/// Way by which a car that starts off is behind its command, beyond its pulses.
const LATE_UM: u32 = 15_000;

const fn standstill_us(pulse_distance_um: u16) -> u32 {
    let us = pulse_distance_um as u32 * STANDSTILL_US_PER_UM;
    if us > STANDSTILL_US {
        us
    } else {
        STANDSTILL_US
    }
}

/// Speed of `pulses` pulses in `span_us`, in mm/s, saturating.
#[inline(never)]
fn speed_mm_s(pulse_distance_um: u16, mut pulses: u32, mut span_us: u32) -> i16 {
    while pulses > MAX_PULSES {
        pulses /= 2;
        span_us /= 2;
    }
    let distance_nm = u32::from(pulse_distance_um) * 1_000 * pulses;
    match distance_nm.checked_div(span_us) {
        Some(speed) if speed < i16::MAX.unsigned_abs().into() => speed as i16,
        _ => i16::MAX,
    }
}

#[cfg(test)]
mod tests {
    use std::vec::Vec;

    use super::{Driven, Odometer};
    use crate::MotorPulses;

    const COASTING: Driven = Driven {
        driven: false,
        target_mm_s: 0,
    };

    const PULSE_UM: u16 = 5_000;

    /// Pulses at a constant rate, polled every millisecond, measured every 10 ms;
    /// returns all measured speeds.
    fn run(odometer: &mut Odometer, from_us: u32, period_us: u32, total_us: u32) -> Vec<i16> {
        let mut speeds = Vec::new();
        for elapsed in (0..=total_us).step_by(1_000) {
            let pulses = elapsed / period_us;
            odometer.observe(
                from_us.wrapping_add(elapsed),
                1_000,
                MotorPulses {
                    count: (pulses as u16).wrapping_add(65_530),
                    last_edge_us: from_us.wrapping_add(pulses * period_us),
                },
                COASTING,
            );
            if elapsed % 10_000 == 0 {
                odometer.measure(PULSE_UM);
                speeds.push(odometer.speed_mm_s());
            }
        }
        speeds
    }

    #[test]
    fn a_constant_rate_gives_a_constant_speed_across_both_wraps() {
        for period_us in [150, 500, 2_500, 10_000, 33_000, 140_000] {
            let speeds = run(&mut Odometer::new(), u32::MAX - 300_000, period_us, 600_000);
            let exact = f64::from(PULSE_UM) * 1_000.0 / f64::from(period_us);
            let exact = exact.min(32_767.0);
            let settled = &speeds[35..];
            assert!(
                settled
                    .iter()
                    .all(|&speed| (f64::from(speed) - exact).abs() <= 1.0 + exact / 100.0),
                "{period_us}: {settled:?} instead of {exact}"
            );
        }
    }

    #[test]
    fn without_pulses_the_speed_falls_to_zero() {
        let mut odometer = Odometer::new();
        run(&mut odometer, 0, 5_000, 100_000);
        let start = odometer.speed_mm_s();
        assert_eq!(start, 1_000);
        let last = MotorPulses {
            count: 65_530_u16.wrapping_add(20),
            last_edge_us: 100_000,
        };
        let mut before = start;
        for elapsed in (10_000..=600_000_u32).step_by(10_000) {
            odometer.observe(100_000 + elapsed, 10_000, last, COASTING);
            odometer.measure(PULSE_UM);
            let now = odometer.speed_mm_s();
            assert!(now <= before && u32::from(now.unsigned_abs()) <= 5_000_000 / elapsed);
            before = now;
        }
        assert_eq!(before, 0);
    }

    #[test]
    fn the_first_pulse_after_a_standstill_gives_no_speed() {
        let mut odometer = Odometer::new();
        run(&mut odometer, 0, 1_000_000, 900_000);
        let first = MotorPulses {
            count: 65_531,
            last_edge_us: 905_000,
        };
        odometer.observe(910_000, 10_000, first, COASTING);
        odometer.measure(PULSE_UM);
        assert_eq!(odometer.speed_mm_s(), 0);
        let second = MotorPulses {
            count: 65_532,
            last_edge_us: 915_000,
        };
        odometer.observe(920_000, 10_000, second, COASTING);
        odometer.measure(PULSE_UM);
        assert_eq!(odometer.speed_mm_s(), 500);
    }

    #[test]
    fn the_interval_ends_exactly_at_its_timeout() {
        for (silent_us, silent_mm_s, next_mm_s) in
            [(499_999, 10, 9), (500_000, 0, 0), (500_001, 0, 0)]
        {
            let mut odometer = Odometer::new();
            run(&mut odometer, 0, 5_000, 100_000);
            let pulse = |pulses: u16, last_edge_us| MotorPulses {
                count: 65_530_u16.wrapping_add(pulses),
                last_edge_us,
            };
            odometer.observe(100_000 + silent_us, silent_us, pulse(20, 100_000), COASTING);
            odometer.measure(PULSE_UM);
            assert_eq!(odometer.speed_mm_s(), silent_mm_s, "{silent_us}");
            let edge_us = 105_000 + silent_us;
            odometer.observe(edge_us, 5_000, pulse(21, edge_us), COASTING);
            odometer.measure(PULSE_UM);
            assert_eq!(odometer.speed_mm_s(), next_mm_s, "{silent_us}");
        }
    }

    #[test]
    fn the_pulses_of_a_late_measurement_give_their_mean_speed() {
        for (pulses, span_us) in [
            (64, 9_767),
            (65, 19_999),
            (640, 1_999_999),
            (40_000, 9_999_999),
        ] {
            let mut odometer = Odometer::new();
            let mut measure = |count, last_edge_us| {
                let pulses = MotorPulses {
                    count,
                    last_edge_us,
                };
                odometer.observe(last_edge_us, 0, pulses, COASTING);
                odometer.measure(PULSE_UM);
                odometer.speed_mm_s()
            };
            measure(7, 0);
            // The first pulse only starts the interval.
            measure(8, 1_000);
            let measured = measure(8_u16.wrapping_add(pulses), 1_000 + span_us);
            let exact = f64::from(PULSE_UM) * 1_000.0 * f64::from(pulses) / f64::from(span_us);
            let error = exact - f64::from(measured);
            // Up to 64 pulses are not halved.
            let tolerance = if pulses <= 64 { 1.0 } else { exact / 50.0 };
            assert!(error.abs() < tolerance, "{pulses}: {measured} for {exact}");
        }
    }

    #[test]
    fn impossible_pulses_saturate() {
        let mut odometer = Odometer::new();
        for count in [0, 40_000, 14_464] {
            odometer.observe(
                7,
                0,
                MotorPulses {
                    count,
                    last_edge_us: 7,
                },
                COASTING,
            );
            odometer.measure(u16::MAX);
        }
        assert_eq!(odometer.speed_mm_s(), i16::MAX);
    }
}
