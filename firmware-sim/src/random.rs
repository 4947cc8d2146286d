//! Seeded random numbers, the same on every machine and in every build.

use libm::{log, sqrt};
use rand_chacha::{
    ChaCha8Rng,
    rand_core::{Rng, SeedableRng},
};

/// Consumers with a stream of their own.
///
/// Every sensor and every fault has one, so that disabling one does not change the
/// draws of the others.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Stream {
    Gyroscope = 1,
    Accelerometer = 2,
    Attitude = 3,
    Battery = 4,
    CameraNoise = 5,
    CameraLatency = 6,
    HostToBoard = 7,
    BoardToHost = 8,
    Bootloader = 9,
    MotorEdges = 10,
    Vibration = 11,
    TornSamples = 12,
    DecoyNoise = 13,
}

/// One stream of random numbers.
#[derive(Clone, Debug)]
pub(crate) struct Random {
    generator: ChaCha8Rng,
    /// The second of two normal values that were made at once.
    normal: Option<f64>,
}

impl Random {
    pub(crate) fn new(seed: u64, stream: Stream) -> Self {
        let mut generator = ChaCha8Rng::seed_from_u64(seed);
        generator.set_stream(stream as u64);
        Self {
            generator,
            normal: None,
        }
    }

    /// Uniform in [0, 1).
    pub(crate) fn uniform(&mut self) -> f64 {
        const SCALE: f64 = 1.0 / (1_u64 << 53) as f64;
        (self.generator.next_u64() >> 11) as f64 * SCALE
    }

    /// True with the given probability. Always draws one number, so that the
    /// probability does not change later draws.
    pub(crate) fn happens(&mut self, probability: f64) -> bool {
        self.uniform() < probability
    }

    /// Leaves out `words` numbers of 32 bits: [`happens`](Self::happens) draws two, and
    /// [`below`](Self::below) one.
    pub(crate) fn skip(&mut self, words: u64) {
        let position = self.generator.get_word_pos();
        self.generator.set_word_pos(position + u128::from(words));
    }

    /// A uniform integer below `n`, for small `n`.
    pub(crate) fn below(&mut self, n: u32) -> u32 {
        ((u64::from(self.generator.next_u32()) * u64::from(n)) >> 32) as u32
    }

    /// Standard normal (Marsaglia's polar method).
    ///
    /// Not `rand_distr`: its logarithm depends on the platform if any crate of the
    /// build enables `std` of `num-traits`.
    pub(crate) fn normal(&mut self) -> f64 {
        if let Some(second) = self.normal.take() {
            return second;
        }
        loop {
            let [x, y] = [(); 2].map(|()| 2.0 * self.uniform() - 1.0);
            let square = x * x + y * y;
            if square < 1.0 && square > 0.0 {
                let factor = sqrt(-2.0 * log(square) / square);
                self.normal = Some(y * factor);
                return x * factor;
            }
        }
    }

    /// Three independent normal values of one standard deviation.
    pub(crate) fn normal3(&mut self, standard_deviation: f64) -> [f64; 3] {
        [(); 3].map(|()| standard_deviation * self.normal())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_left_out_is_what_would_have_been_drawn() {
        let draw = |random: &mut Random| {
            let _ = (random.happens(0.5), random.happens(0.5), random.below(8));
        };
        for count in 0..60 {
            let mut drawn = Random::new(7, Stream::HostToBoard);
            let mut skipped = drawn.clone();
            for _ in 0..count {
                draw(&mut drawn);
            }
            // Also in the middle of a block.
            draw(&mut drawn);
            draw(&mut skipped);
            skipped.skip(5 * count);
            assert_eq!(drawn.uniform(), skipped.uniform(), "{count}");
        }
    }

    #[test]
    fn normal_values_have_mean_zero_and_unit_variance() {
        let mut random = Random::new(1, Stream::Gyroscope);
        let n = 100_000;
        let (mut sum, mut square, mut fourth) = (0.0, 0.0, 0.0);
        for _ in 0..n {
            let x = random.normal();
            sum += x;
            square += x * x;
            fourth += x * x * x * x;
        }
        let n = f64::from(n);
        assert!((sum / n).abs() < 0.015);
        assert!((square / n - 1.0).abs() < 0.02);
        assert!((fourth / n - 3.0).abs() < 0.15);
    }

    #[test]
    fn streams_of_one_seed_differ_and_repeat() {
        let draw = |stream| Random::new(7, stream).normal3(1.0);
        assert_eq!(draw(Stream::Gyroscope), draw(Stream::Gyroscope));
        assert_ne!(draw(Stream::Gyroscope), draw(Stream::Accelerometer));
    }

    #[test]
    fn values_below_a_bound_cover_it() {
        let mut random = Random::new(3, Stream::HostToBoard);
        let mut seen = [false; 8];
        for _ in 0..1000 {
            seen[random.below(8) as usize] = true;
        }
        assert_eq!(seen, [true; 8]);
    }
}
