//! Root mean squares, straight lines, rates and percentiles of measured values, and [`Random`]
//! numbers from a seed.

#[cfg(any(feature = "alloc", test))]
use alloc::vec::Vec;

/// The longest time between two arrivals.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Gap {
    /// Its length, in ns.
    pub longest_ns: i64,
    /// When it began, in ns.
    pub begin_ns: i64,
}

impl Gap {
    /// A gap of no length, which began at 0.
    pub const fn new() -> Self {
        Self {
            longest_ns: 0,
            begin_ns: 0,
        }
    }

    /// Takes the gap from `begin_ns` to `end_ns` if it is longer.
    pub fn add(&mut self, begin_ns: i64, end_ns: i64) {
        if end_ns - begin_ns > self.longest_ns {
            *self = Self {
                longest_ns: end_ns - begin_ns,
                begin_ns,
            };
        }
    }
}

/// Count, rate and longest gap of arrivals.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Arrivals {
    /// The number of arrivals.
    pub count: u64,
    first_ns: i64,
    last_ns: i64,
    gap: Gap,
}

impl Arrivals {
    /// Adds an arrival, in ns; without a time it counts as simultaneous with the latest.
    pub fn add(&mut self, time_ns: Option<i64>) {
        let time_ns = time_ns.unwrap_or(self.last_ns);
        if self.count == 0 {
            self.first_ns = time_ns;
            self.gap.begin_ns = time_ns;
        } else {
            self.gap.add(self.last_ns, time_ns);
        }
        self.count += 1;
        self.last_ns = self.last_ns.max(time_ns);
    }

    /// Arrivals per second between the first and the latest; none if no time passed.
    pub fn rate_hz(&self) -> Option<f64> {
        let span_s = (self.last_ns - self.first_ns) as f64 / 1e9;
        (self.count > 1 && span_s > 0.0).then(|| (self.count - 1) as f64 / span_s)
    }

    /// The time of the first arrival, in ns.
    pub fn first_ns(&self) -> Option<i64> {
        (self.count > 0).then_some(self.first_ns)
    }

    /// The time of the latest arrival, in ns.
    pub fn last_ns(&self) -> Option<i64> {
        (self.count > 0).then_some(self.last_ns)
    }

    /// The longest time between two arrivals; none with fewer than two.
    pub fn longest_gap(&self) -> Option<Gap> {
        (self.count > 1).then_some(self.gap)
    }
}

/// Values in ascending order; values that are not finite are left out. Its percentiles are
/// nearest-rank percentiles: the smallest value that a given part of all values does not exceed.
#[cfg(any(feature = "alloc", test))]
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Distribution(Vec<f64>);

#[cfg(any(feature = "alloc", test))]
impl Distribution {
    /// The distribution of `values`, in the unit of the values.
    pub fn of(values: impl IntoIterator<Item = f64>) -> Self {
        let finite = values.into_iter().filter(|value| value.is_finite());
        let mut values: Vec<f64> = finite.collect();
        values.sort_unstable_by(f64::total_cmp);
        Self(values)
    }

    /// The values in ascending order.
    pub fn sorted(&self) -> &[f64] {
        &self.0
    }

    /// The number of values.
    pub fn count(&self) -> usize {
        self.0.len()
    }

    /// The smallest value.
    pub fn min(&self) -> Option<f64> {
        self.0.first().copied()
    }

    /// The largest value.
    pub fn max(&self) -> Option<f64> {
        self.0.last().copied()
    }

    /// The smallest value that `part` (0 to 1) of all values do not exceed. It is one of
    /// the values; values between two are not interpolated.
    pub fn quantile(&self, part: f64) -> Option<f64> {
        let rank = libm::ceil(part * self.0.len() as f64) as usize;
        self.0.get(rank.max(1) - 1).copied()
    }

    /// How many values are smaller than `bound`.
    pub fn count_below(&self, bound: f64) -> usize {
        self.0.partition_point(|value| *value < bound)
    }

    /// How many values are at most `bound`.
    pub fn count_up_to(&self, bound: f64) -> usize {
        self.0.partition_point(|value| *value <= bound)
    }

    /// The root mean square of the values.
    pub fn root_mean_square(&self) -> Option<f64> {
        RootMeanSquare::of(self.0.iter().copied()).value()
    }
}

/// The straight line through points by least squares.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Line {
    /// The mean of the points, which is on the line; zero without points.
    pub middle: [f64; 2],
    /// Its slope; zero if all points have the same abscissa.
    pub slope: f64,
    /// The sum of the squared distances of the abscissas from their mean.
    pub spread: f64,
}

impl Line {
    /// The line through points of abscissa and ordinate.
    pub fn through(points: impl Iterator<Item = [f64; 2]> + Clone) -> Self {
        let count = points.clone().count().max(1) as f64;
        let mean = |axis: usize| points.clone().map(|point| point[axis]).sum::<f64>() / count;
        let middle = [mean(0), mean(1)];
        let (mut spread, mut product) = (0.0, 0.0);
        for [x, y] in points {
            spread += (x - middle[0]) * (x - middle[0]);
            product += (x - middle[0]) * (y - middle[1]);
        }
        Self {
            middle,
            slope: if spread > 0.0 { product / spread } else { 0.0 },
            spread,
        }
    }

    /// The ordinate at an abscissa.
    pub fn at(&self, x: f64) -> f64 {
        self.middle[1] + self.slope * (x - self.middle[0])
    }
}

/// Sums squares in the order in which they are added: the root mean square is
/// sqrt(sum of squares / count).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RootMeanSquare {
    squares: f64,
    count: u64,
}

impl RootMeanSquare {
    /// The root mean square of `values`, added in their order.
    pub fn of(values: impl IntoIterator<Item = f64>) -> Self {
        let mut sum = Self::default();
        for value in values {
            sum.add(value);
        }
        sum
    }

    /// Adds a value.
    pub fn add(&mut self, value: f64) {
        self.add_square(value * value);
    }

    /// Adds the square of a value, such as the square of a distance.
    pub fn add_square(&mut self, square: f64) {
        self.squares += square;
        self.count += 1;
    }

    /// The root mean square, in the unit of the values; none without values.
    pub fn value(&self) -> Option<f64> {
        (self.count > 0).then(|| libm::sqrt(self.squares / self.count as f64))
    }
}

/// The generator `SplitMix64` of Steele, Lea and Flood (2014): for tests, campaigns and resampling.
#[derive(Clone, Debug)]
pub struct Random(u64);

impl Random {
    /// The numbers of this seed.
    pub const fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// A uniform number of 64 bits.
    pub const fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform in [0, 1).
    pub const fn uniform(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Uniform between two numbers.
    pub const fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// Below `count`, each number with the same probability; 0 for none.
    pub fn below(&mut self, count: usize) -> usize {
        (self.bits() % count.max(1) as u64) as usize
    }

    /// True with this probability.
    pub const fn happens(&mut self, probability: f64) -> bool {
        self.uniform() < probability
    }

    /// Normal with mean zero (Box and Muller).
    pub fn normal(&mut self, standard_deviation: f64) -> f64 {
        let radius = libm::sqrt(-2.0 * libm::log(1.0 - self.uniform()));
        standard_deviation * radius * libm::cos(core::f64::consts::TAU * self.uniform())
    }
}

#[cfg(test)]
mod tests {
    use std::vec::Vec;

    use super::*;

    #[test]
    fn intervals_count_for_the_rate_and_the_longest_is_the_gap() {
        let mut arrivals = Arrivals::default();
        for ms in [10, 20, 50, 60] {
            arrivals.add(Some(ms * 1_000_000));
        }
        assert_eq!(arrivals.count, 4);
        assert_eq!(arrivals.rate_hz(), Some(60.0));
        assert_eq!(arrivals.first_ns(), Some(10_000_000));
        assert_eq!(arrivals.last_ns(), Some(60_000_000));
        assert_eq!(
            arrivals.longest_gap(),
            Some(Gap {
                longest_ns: 30_000_000,
                begin_ns: 20_000_000
            })
        );
    }

    #[test]
    fn a_single_arrival_has_neither_rate_nor_gap() {
        let mut arrivals = Arrivals::default();
        assert_eq!(arrivals.first_ns(), None);
        arrivals.add(Some(5));
        assert_eq!((arrivals.rate_hz(), arrivals.longest_gap()), (None, None));
        arrivals.add(None);
        assert_eq!(arrivals.rate_hz(), None);
        assert_eq!(arrivals.last_ns(), Some(5));
    }

    #[test]
    fn quantiles_are_values_that_occur() {
        let values = Distribution::of((1..=100).map(f64::from).chain([f64::NAN]));
        assert_eq!(values.count(), 100);
        assert_eq!(values.quantile(0.5), Some(50.0));
        assert_eq!(values.quantile(0.99), Some(99.0));
        assert_eq!(values.quantile(1.0), values.max());
        assert_eq!(values.quantile(0.0), values.min());
        assert_eq!(Distribution::of([]).quantile(0.5), None);
    }

    #[test]
    fn ranks_of_per_mille_are_exact() {
        for count in 1..=2_000_u32 {
            let values = Distribution::of((1..=count).map(f64::from));
            for per_mille in [500, 900, 990, 999] {
                let rank = (count * per_mille).div_ceil(1_000);
                assert_eq!(
                    values.quantile(f64::from(per_mille) / 1_000.0),
                    Some(f64::from(rank)),
                    "{per_mille} of {count}"
                );
            }
        }
    }

    #[test]
    fn a_value_at_a_bound_is_up_to_it_and_not_below_it() {
        let values = Distribution::of([2.0, 1.0, 2.0, 3.0]);
        assert_eq!(values.count_below(2.0), 1);
        assert_eq!(values.count_up_to(2.0), 3);
        assert_eq!(values.sorted(), [1.0, 2.0, 2.0, 3.0]);
    }

    #[test]
    fn only_finite_values_have_a_root_mean_square() {
        assert_eq!(
            Distribution::of([3.0, -4.0]).root_mean_square(),
            Some(12.5_f64.sqrt())
        );
        assert_eq!(Distribution::of([f64::NAN]).root_mean_square(), None);
    }

    #[test]
    fn a_line_is_that_of_the_book() {
        let points = [[1.0, 6.0], [2.0, 5.0], [3.0, 7.0], [4.0, 10.0]];
        let line = Line::through(points.into_iter());
        assert_eq!((line.middle, line.spread), ([2.5, 7.0], 5.0));
        assert!((line.slope - 1.4).abs() < 1e-12 && (line.at(0.0) - 3.5).abs() < 1e-12);
    }

    #[test]
    fn points_that_show_no_slope_have_none() {
        let line = Line::through([[2.0, 1.0], [2.0, 3.0]].into_iter());
        assert_eq!((line.slope, line.at(9.0)), (0.0, 2.0));
        assert_eq!(Line::through([].into_iter()), Line::default());
    }

    #[test]
    fn squares_and_values_give_the_same() {
        let mut squares = RootMeanSquare::default();
        squares.add_square(9.0);
        squares.add_square(16.0);
        assert_eq!(squares, RootMeanSquare::of([3.0, -4.0]));
        assert_eq!(squares.value(), Some(12.5_f64.sqrt()));
    }

    #[test]
    fn nothing_has_none() {
        assert_eq!(RootMeanSquare::default().value(), None);
    }

    #[test]
    fn the_numbers_are_those_of_the_published_generator() {
        let mut random = Random::new(1_234_567);
        let found: Vec<u64> = (0..3).map(|_| random.bits()).collect();
        let published = [
            6_457_827_717_110_365_317,
            3_203_168_211_198_807_973,
            9_817_491_932_198_370_423,
        ];
        assert_eq!(found, published);
    }
}
