//! The motor's pulse sensor: a pulse every few millimetres of travel.

use singletrack_control::words;
use singletrack_settings::section;

use crate::{
    random::{Random, Stream},
    ranges::EDGE_RATE,
};

section! {
    /// The motor's pulse sensor.
    "car.motor_sensor" => pub MotorSensorParameters: Copy;
    [default];

    /// True distance per pulse, in µm.
    pulse_distance_um: f64 = 3000.0, in in_words("10 or more", |x| x >= 10.0);
    /// Mean number of edges by interference while the ESC drives, per second.
    emi_driven_hz: f64 = 0.0, in EDGE_RATE;
    /// Mean number of edges by interference while it does not, per second.
    emi_standstill_hz: f64 = 0.0, in EDGE_RATE;
    /// Further edges after each true one.
    ringing_edges: u16 = 0, in in_words("1000 or less", |x| x <= 1_000.0);
    /// Duration of the ringing, in µs.
    ringing_us: u64 = 40;
}

words! {
    /// Faults of the motor's pulse sensor.
    pub enum MotorSensorFault {
        /// No fault.
        None = "none",
        /// No pulses.
        Gone = "gone",
        /// Every pulse is doubled.
        Doubled = "doubled",
        /// Every other pulse is missing.
        Halved = "halved",
        /// The right number of pulses, unevenly spaced.
        Erratic = "erratic",
    }
}

impl MotorSensorFault {
    /// Erratic pulses: the seven of fourteen half distances that end with a pulse.
    const UNEVEN: u16 = 0b01_1011_0001_1100;

    /// Distance between possible pulses, relative to the true distance per pulse.
    const fn distance(self) -> f64 {
        match self {
            Self::None | Self::Gone => 1.0,
            Self::Doubled | Self::Erratic => 0.5,
            Self::Halved => 2.0,
        }
    }

    /// Whether the possible pulse with this number is output.
    const fn is_output(self, number: u64) -> bool {
        match self {
            Self::None | Self::Doubled | Self::Halved => true,
            Self::Gone => false,
            Self::Erratic => Self::UNEVEN >> (number % 14) & 1 == 1,
        }
    }
}

/// The pulses so far, as counted and timed by the board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MotorPulses {
    /// Number of pulses, wrapping.
    pub count: u16,
    /// Simulation time of the last pulse, in µs.
    pub last_us: Option<u64>,
}

/// The sensor: converts travel to pulses.
#[derive(Clone, Debug, Default)]
pub(crate) struct MotorSensor {
    /// Travel since the last pulse, in m.
    remainder_m: f64,
    /// Number of possible pulses so far.
    possible: u64,
    pub(crate) pulses: MotorPulses,
    interference: Interference,
}

/// Edges at random times.
#[derive(Clone, Debug)]
struct Interference {
    random: Random,
    /// Expected number of edges until the next one: exponentially distributed, so that
    /// the size of the steps has no effect. `None` before the first draw.
    remaining: Option<f64>,
}

impl Default for Interference {
    fn default() -> Self {
        Self::new(0)
    }
}

impl Interference {
    fn new(seed: u64) -> Self {
        Self {
            random: Random::new(seed, Stream::MotorEdges),
            remaining: None,
        }
    }

    /// The shares of a step, in order, at which an edge falls; `expected` is their mean
    /// number.
    fn edges(&mut self, expected: f64, mut edge: impl FnMut(f64)) {
        if expected <= 0.0 {
            return;
        }
        let mut draw = || -libm::log(1.0 - self.random.uniform());
        let mut next = self.remaining.unwrap_or_else(&mut draw);
        while next < expected {
            edge(next / expected);
            next += draw();
        }
        self.remaining = Some(next - expected);
    }
}

impl MotorSensor {
    /// Sets the seed of the interference.
    pub(crate) fn seed(&mut self, seed: u64) {
        self.interference = Interference::new(seed);
    }

    /// Adds the edges by interference from `start_us` to `end_us`.
    pub(crate) fn interfere(
        &mut self,
        p: &MotorSensorParameters,
        driven: bool,
        start_us: u64,
        end_us: u64,
    ) {
        let (driven_hz, standing_hz) = (p.emi_driven_hz, p.emi_standstill_hz);
        let rate = if driven { driven_hz } else { standing_hz };
        let span_us = (end_us - start_us) as f64;
        let pulses = &mut self.pulses;
        self.interference.edges(rate * span_us * 1e-6, |share| {
            let time_us = start_us + (share * span_us) as u64;
            pulses.count = pulses.count.wrapping_add(1);
            pulses.last_us = pulses.last_us.max(Some(time_us));
        });
    }

    /// Adds `travel_m` of wheel travel (either direction) from `start_us` to
    /// `end_us`, at a constant speed.
    pub(crate) fn roll(
        &mut self,
        p: &MotorSensorParameters,
        fault: MotorSensorFault,
        travel_m: f64,
        start_us: u64,
        end_us: u64,
    ) {
        let distance = p.pulse_distance_um * fault.distance() * 1e-6;
        let before = self.remainder_m;
        let travel = travel_m.abs();
        let total = before + travel;
        if !(total >= distance && distance > 0.0 && travel > 0.0) {
            self.remainder_m = total;
            return;
        }
        let edges = (total / distance).floor();
        let mut edge = 1.0;
        while edge <= edges {
            let share = ((edge * distance - before) / travel).clamp(0.0, 1.0);
            let time_us = start_us + (share * (end_us - start_us) as f64) as u64;
            self.possible += 1;
            if fault.is_output(self.possible) {
                let ringing_us = if p.ringing_edges > 0 { p.ringing_us } else { 0 };
                self.pulses = MotorPulses {
                    count: self.pulses.count.wrapping_add(1 + p.ringing_edges),
                    // The board must not see an edge of the future.
                    last_us: Some((time_us + ringing_us).min(end_us)),
                };
            }
            edge += 1.0;
        }
        self.remainder_m = (total - edges * distance).max(0.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SENSOR: MotorSensorParameters = MotorSensorParameters {
        pulse_distance_um: 3000.0,
        emi_driven_hz: 0.0,
        emi_standstill_hz: 0.0,
        ringing_edges: 0,
        ringing_us: 40,
    };

    fn roll(fault: MotorSensorFault, metres_per_ms: f64, ms: u64) -> MotorPulses {
        let mut sensor = MotorSensor::default();
        for step in 0..ms {
            sensor.roll(
                &SENSOR,
                fault,
                metres_per_ms,
                step * 1000,
                (step + 1) * 1000,
            );
        }
        sensor.pulses
    }

    #[test]
    fn pulses_measure_distance_and_have_the_time_of_their_edge() {
        // 0.4 m/s for 5 s: 2 m, 666 pulses of 7.5 ms.
        let pulses = roll(MotorSensorFault::None, 0.4e-3, 5000);
        assert_eq!(pulses.count, 666);
        assert!(pulses.last_us.unwrap().abs_diff(666 * 7_500) <= 1);
    }

    #[test]
    fn reverse_travel_gives_pulses_too() {
        assert_eq!(roll(MotorSensorFault::None, -0.4e-3, 5000).count, 666);
    }

    #[test]
    fn faults_double_drop_or_shift_the_pulses() {
        assert_eq!(roll(MotorSensorFault::Doubled, 0.4e-3, 5000).count, 1333);
        assert_eq!(
            roll(MotorSensorFault::Gone, 0.4e-3, 5000),
            MotorPulses::default()
        );
        assert_eq!(roll(MotorSensorFault::Halved, 0.4e-3, 5000).count, 333);
        let erratic = roll(MotorSensorFault::Erratic, 0.4e-3, 5000).count;
        assert!(erratic.abs_diff(666) <= 7, "{erratic}");
    }

    #[test]
    fn the_time_is_that_of_the_last_pulse_in_a_step() {
        let mut sensor = MotorSensor::default();
        sensor.roll(&SENSOR, MotorSensorFault::None, 0.010, 0, 1000);
        let pulses = sensor.pulses;
        assert_eq!((pulses.count, pulses.last_us), (3, Some(900)));
    }

    #[test]
    fn interference_has_its_rate_with_any_step_and_also_at_standstill() {
        let p = MotorSensorParameters {
            emi_driven_hz: 200.0,
            emi_standstill_hz: 20.0,
            ..SENSOR
        };
        for step_us in [130, 1_000] {
            for (driven, expected) in [(true, 4_000_u16), (false, 400)] {
                let mut sensor = MotorSensor::default();
                for step in 0..20_000_000 / step_us {
                    sensor.interfere(&p, driven, step * step_us, (step + 1) * step_us);
                }
                let count = sensor.pulses.count;
                // Four standard deviations.
                let room = (4.0 * f64::from(expected).sqrt()) as u16;
                assert!(count.abs_diff(expected) < room, "{count} of {expected}");
            }
        }
    }

    #[test]
    fn ringing_multiplies_the_edges_within_the_step() {
        let p = MotorSensorParameters {
            ringing_edges: 3,
            ..SENSOR
        };
        let mut sensor = MotorSensor::default();
        sensor.roll(&p, MotorSensorFault::None, 0.003, 0, 1000);
        assert_eq!(
            sensor.pulses,
            MotorPulses {
                count: 4,
                last_us: Some(1000)
            }
        );
    }
}
