//! From the pulse of the steering servo to the angle of the front wheels, and back.

use heapless::Vec;
use serde::{Deserialize, Serialize};

/// Most pairs of a [`SteeringTable`].
pub const MAX_STEERING_PAIRS: usize = 32;

type Pairs = Vec<[f64; 2], MAX_STEERING_PAIRS>;

/// What a steering linkage makes of the servo's pulse: pairs of pulse in µs and angle of the
/// front wheels in rad, with straight lines between them.
///
/// It need not be symmetric, has a dead band where neighbours have the same angle, and is
/// constant beyond its ends, where the linkage or the servo has reached its stop.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Pairs", into = "Pairs")]
pub struct SteeringTable(Pairs);

/// Why pairs are no [`SteeringTable`].
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum SteeringTableError {
    /// Too few or too many.
    #[error("{0} pairs of pulse and angle: give 2 to {MAX_STEERING_PAIRS}")]
    Count(usize),
    /// Not a number, or infinite.
    #[error("[{}, {}] is not a pulse in us and an angle in rad", .0[0], .0[1])]
    NotFinite([f64; 2]),
    /// The pulses do not increase: one in µs, and that of the next pair.
    #[error("{1} us after {0} us: put the pairs in the order of their pulses")]
    Order(f64, f64),
    /// The angles neither all rise nor all fall.
    #[error("the wheels turn back at {0} us: the angles must all rise, or all fall")]
    TurnsBack(f64),
    /// All angles are the same.
    #[error("all its angles are {0} rad: such a car can't be steered")]
    Fixed(f64),
}

impl SteeringTable {
    /// A table of these pairs, in the order of their pulses.
    ///
    /// # Errors
    ///
    /// The pairs are too few, too many, not in order, or not monotone.
    pub fn new(pairs: &[[f64; 2]]) -> Result<Self, SteeringTableError> {
        let pairs = match Pairs::from_slice(pairs) {
            Ok(within) if within.len() >= 2 => within,
            _ => return Err(SteeringTableError::Count(pairs.len())),
        };
        Self::try_from(pairs)
    }

    /// Its pairs.
    pub fn pairs(&self) -> &[[f64; 2]] {
        &self.0
    }

    /// The angle of the front wheels at a pulse, in rad.
    pub fn angle(&self, pulse_us: f64) -> f64 {
        interpolate(&self.0, pulse_us)
    }

    /// The pulse for an angle of the front wheels, in µs: the middle of a dead band, and the
    /// inner end of a stop; what is not finite stays as it is.
    pub fn pulse(&self, angle_rad: f64) -> f64 {
        if !angle_rad.is_finite() {
            return angle_rad;
        }
        let [least, most] = self.reach();
        let angle_rad = angle_rad.clamp(least, most);
        let [first, last] = self.ends();
        // Whether the wheels reach the angle at this pulse, from the first pair on.
        let sense = if first[1] < last[1] { 1.0 } else { -1.0 };
        let is_before = |angle: f64| sense * angle < sense * angle_rad;
        let is_behind = |angle: f64| sense * angle > sense * angle_rad;
        let from = self.0.partition_point(|pair| is_before(pair[1]));
        let to = self.0.partition_point(|pair| !is_behind(pair[1]));
        let crossing = |place: usize| match (place.checked_sub(1), self.0.get(place)) {
            (None, _) => first[0],
            (_, None) => last[0],
            (Some(before), Some(&[pulse, angle])) => {
                let [from_pulse, from_angle] = self.0[before];
                from_pulse + (angle_rad - from_angle) / (angle - from_angle) * (pulse - from_pulse)
            }
        };
        if from == to {
            return crossing(from);
        }
        // Pairs with this very angle.
        match (from, to) {
            (0, _) => self.0[to - 1][0],
            (_, to) if to == self.0.len() => self.0[from][0],
            _ => f64::midpoint(self.0[from][0], self.0[to - 1][0]),
        }
    }

    /// The least and the greatest angle that it reaches, in rad.
    pub fn reach(&self) -> [f64; 2] {
        let [[_, one], [_, other]] = self.ends();
        [one.min(other), one.max(other)]
    }

    fn ends(&self) -> [[f64; 2]; 2] {
        [self.0[0], self.0[self.0.len() - 1]]
    }
}

impl TryFrom<Pairs> for SteeringTable {
    type Error = SteeringTableError;

    fn try_from(pairs: Pairs) -> Result<Self, SteeringTableError> {
        use SteeringTableError::{Count, Fixed, NotFinite, Order, TurnsBack};
        let [[_, first], .., [_, last]] = *pairs else {
            return Err(Count(pairs.len()));
        };
        if let Some(pair) = pairs
            .iter()
            .find(|pair| !pair.iter().all(|x| x.is_finite()))
        {
            return Err(NotFinite(*pair));
        }
        for steps in pairs.windows(2) {
            let [[before, from], [after, to]] = [steps[0], steps[1]];
            if after <= before {
                return Err(Order(before, after));
            }
            if (to - from) * (last - first) < 0.0 {
                return Err(TurnsBack(before));
            }
        }
        if first == last {
            // Angles that rise and fall again are no table either.
            return Err(match pairs.iter().find(|pair| pair[1] != first) {
                Some(&[pulse_us, _]) => TurnsBack(pulse_us),
                None => Fixed(first),
            });
        }
        Ok(Self(pairs))
    }
}

impl From<SteeringTable> for Pairs {
    fn from(table: SteeringTable) -> Self {
        table.0
    }
}

/// The value at `x` of straight lines between pairs of x and value, in the order of x; beyond
/// the ends that of the end, and 0 without pairs.
pub fn interpolate(pairs: &[[f64; 2]], x: f64) -> f64 {
    let after = pairs.partition_point(|[at, _]| *at <= x);
    let before = after.checked_sub(1).and_then(|place| pairs.get(place));
    match (before, pairs.get(after)) {
        (Some([from, value]), Some([to, next])) => {
            value + (x - from) / (to - from) * (next - value)
        }
        (Some([_, value]), None) | (None, Some([_, value])) => *value,
        (None, None) => 0.0,
    }
}

/// The angle of the front wheels over the servo's pulse.
///
/// The board makes a pulse of a commanded angle by a straight line, in integers, and has the last
/// word on the pulse. What the steering makes of a pulse only the host knows: with a table it
/// commands the angle for which the board's line has the right pulse.
#[derive(Clone, Debug, PartialEq)]
pub struct SteeringMap {
    /// The pulse of straight wheels by the board's line, in µs.
    pub centre_us: f64,
    /// The pulse for one radian more to the left by that line, in µs/rad.
    pub gain_us_per_rad: f64,
    /// What holds instead of the line.
    pub table: Option<SteeringTable>,
}

impl SteeringMap {
    /// The angle of the front wheels at a pulse, in rad.
    pub fn angle(&self, pulse_us: f64) -> f64 {
        match &self.table {
            Some(table) => table.angle(pulse_us),
            None => (pulse_us - self.centre_us) / self.gain_us_per_rad,
        }
    }

    /// The angle to command the board for this one of the front wheels, both in rad; what is not
    /// finite stays as it is.
    pub fn commanded(&self, wheels_rad: f64) -> f64 {
        match &self.table {
            Some(table) => (table.pulse(wheels_rad) - self.centre_us) / self.gain_us_per_rad,
            None => wheels_rad,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::{string::ToString, vec::Vec};

    use proptest::prelude::*;

    use super::*;

    /// A longer pulse steers to the right; a dead band of 20 us; a stop on the left.
    const CAR: [[f64; 2]; 7] = [
        [1_080.0, 0.45],
        [1_120.0, 0.45],
        [1_300.0, 0.22],
        [1_490.0, 0.0],
        [1_510.0, 0.0],
        [1_700.0, -0.16],
        [1_920.0, -0.31],
    ];

    #[test]
    fn an_angle_has_the_pulse_that_steers_it() {
        let table = SteeringTable::new(&CAR).unwrap();
        for (angle, pulse) in [
            (0.0, 1_500.0),
            (0.22, 1_300.0),
            (0.11, 1_395.0),
            (-0.16, 1_700.0),
            (-0.235, 1_810.0),
            // A stop is not leaned against.
            (0.45, 1_120.0),
            (0.6, 1_120.0),
            (-0.31, 1_920.0),
            (-0.5, 1_920.0),
        ] {
            assert!((table.pulse(angle) - pulse).abs() < 1e-9, "{angle}");
        }
        assert!(table.pulse(f64::NAN).is_nan());
        assert!(table.pulse(f64::INFINITY).is_infinite());
        assert_eq!(table.reach(), [-0.31, 0.45]);
        for (pulse, angle) in [
            (800.0, 0.45),
            (1_495.0, 0.0),
            (1_605.0, -0.08),
            (2_200.0, -0.31),
        ] {
            assert!((table.angle(pulse) - angle).abs() < 1e-9, "{pulse}");
        }
    }

    #[test]
    fn the_board_is_commanded_the_angle_whose_pulse_steers_the_wheels() {
        let mut map = SteeringMap {
            centre_us: 1_500.0,
            gain_us_per_rad: -800.0,
            table: SteeringTable::new(&CAR).ok(),
        };
        // 1300 us.
        assert!((map.commanded(0.22) - 0.25).abs() < 1e-12);
        assert_eq!(map.angle(1_300.0), 0.22);
        assert!(map.commanded(f64::NAN).is_nan());
        map.table = None;
        assert_eq!((map.commanded(0.22), map.angle(1_300.0)), (0.22, 0.25));
    }

    #[test]
    fn what_is_no_table_is_refused_with_the_reason() {
        let refused = |pairs: &[[f64; 2]]| SteeringTable::new(pairs).unwrap_err().to_string();
        for (pairs, reason) in [
            (
                &[[1_500.0, 0.0]][..],
                "1 pairs of pulse and angle: give 2 to 32",
            ),
            (
                &[[1_500.0, 0.0], [1_500.0, 0.1]],
                "1500 us after 1500 us: put the pairs in the order of their pulses",
            ),
            (
                &[
                    [1_100.0, 0.4],
                    [1_500.0, 0.0],
                    [1_600.0, 0.1],
                    [1_900.0, -0.4],
                ],
                "the wheels turn back at 1500 us: the angles must all rise, or all fall",
            ),
            (
                &[[1_100.0, 0.0], [1_500.0, 0.2], [1_900.0, 0.0]],
                "the wheels turn back at 1500 us: the angles must all rise, or all fall",
            ),
            (
                &[[1_100.0, 0.1], [1_900.0, 0.1]],
                "all its angles are 0.1 rad: such a car can't be steered",
            ),
            (
                &[[1_100.0, f64::NAN], [1_900.0, 0.1]],
                "[1100, NaN] is not a pulse in us and an angle in rad",
            ),
        ] {
            assert_eq!(refused(pairs), reason);
        }
        let many: Vec<[f64; 2]> = (0..33).map(|i| [f64::from(i), f64::from(i)]).collect();
        assert_eq!(refused(&many), "33 pairs of pulse and angle: give 2 to 32");
    }

    proptest! {
        #[test]
        fn the_pulse_of_an_angle_in_reach_gives_that_angle(
            steps in proptest::collection::vec((1.0..200.0, 0.0..0.2), 2..31),
            falls: bool,
            share in 0.0..1.0,
        ) {
            let mut pair = [800.0, -0.5];
            let mut pairs: Vec<[f64; 2]> = std::vec![pair];
            for (pulse, angle) in steps {
                pair = [pair[0] + pulse, pair[1] + angle];
                pairs.push(pair);
            }
            if falls {
                for pair in &mut pairs {
                    pair[1] = -pair[1];
                }
            }
            prop_assume!(pairs[0][1] != pair[1]);
            let table = SteeringTable::new(&pairs).unwrap();
            let [least, most] = table.reach();
            let angle = least + share * (most - least);
            let pulse = table.pulse(angle);
            prop_assert!((pairs[0][0]..=pair[0]).contains(&pulse));
            prop_assert!((table.angle(pulse) - angle).abs() < 1e-9);
        }
    }
}
