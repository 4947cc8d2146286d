//! What is true of a small car, and what chance makes it.

use singletrack_statistics::Random;

/// The random numbers of a car.
pub(crate) fn numbers(seed: u64) -> Random {
    Random::new(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ 0x5EED)
}

/// What a pulse below neutral does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Car,
    ForwardReverse,
    Vesc,
}

impl Kind {
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Car => "car",
            Self::ForwardReverse => "forward-reverse",
            Self::Vesc => "vesc",
        }
    }
}

/// What is true of the car.
#[derive(Clone, Debug)]
pub(crate) struct Truth {
    pub(crate) centre_us: f64,
    pub(crate) gain_us_per_rad: f64,
    pub(crate) stop_rad: f64,
    pub(crate) play_us: f64,
    pub(crate) kind: Kind,
    pub(crate) neutral_us: f64,
    pub(crate) ignored_us: f64,
    pub(crate) breakaway_us: f64,
    pub(crate) gain_m_s_per_us: f64,
    pub(crate) saturation_us: f64,
    pub(crate) lag_s: f64,
    pub rolling_m_s2: f64,
    pub(crate) pulse_distance_m: f64,
    pub(crate) on_stand: bool,
    pub(crate) swapped: bool,
    pub(crate) backward: bool,
    pub(crate) sensor_dead: bool,
    pub(crate) kill_output: bool,
    pub(crate) relay_works: bool,
    /// The board has a supply besides the cable.
    pub(crate) own_supply: bool,
    /// The ESC holds its last pulse for so long after a change to neutral.
    pub(crate) holds_s: f64,
    /// The ESC drives on without pulses.
    pub(crate) runs_without_pulses: bool,
    pub(crate) switch_works: bool,
    /// The car falls off its stand when it is disarmed while its wheels turn.
    pub(crate) falls_off: bool,
}

impl Truth {
    pub(crate) fn random(random: &mut Random) -> Self {
        let sign = if random.between(0.0, 1.0) < 0.5 {
            -1.0
        } else {
            1.0
        };
        let kind = [Kind::Car, Kind::ForwardReverse, Kind::Vesc][random.between(0.0, 3.0) as usize];
        Self {
            centre_us: random.between(1_430.0, 1_570.0),
            gain_us_per_rad: sign * random.between(600.0, 1_000.0),
            stop_rad: random.between(0.4, 0.6),
            play_us: random.between(0.0, 12.0),
            kind,
            neutral_us: random.between(1_490.0, 1_510.0).round(),
            ignored_us: random.between(15.0, 40.0).round(),
            breakaway_us: random.between(1.0, 8.0),
            gain_m_s_per_us: random.between(0.006, 0.016),
            saturation_us: random.between(300.0, 600.0),
            lag_s: random.between(0.04, 0.12),
            rolling_m_s2: random.between(0.5, 2.0),
            pulse_distance_m: random.between(0.001, 0.025),
            on_stand: true,
            swapped: false,
            backward: false,
            sensor_dead: false,
            kill_output: random.between(0.0, 1.0) < 0.5,
            relay_works: true,
            own_supply: false,
            holds_s: 0.0,
            runs_without_pulses: false,
            switch_works: true,
            falls_off: false,
        }
    }
}
