//! Seeded random numbers, the same on every machine.

/// One stream of random numbers.
#[derive(Clone, Debug)]
pub(crate) struct Random(singletrack_control::statistics::Random);

/// Consumers with a stream of their own, so that one's draws do not shift
/// another's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Stream {
    Schedule = 1,
    Network = 2,
    Host = 3,
    /// What the program that sends set-points does by mistake.
    Program = 4,
    /// Its faults in a schedule.
    ProgramFaults = 5,
    /// The safety filter and hostile outer loops of a schedule.
    HostileLoops = 6,
    /// What cameras did in the logs of a real car.
    CamerasOfLogs = 7,
    /// Rare poses and floods of requests in a schedule.
    RareAndMany = 8,
    /// Several cars.
    Fleet = 9,
    /// Attended drives and jogging of a schedule.
    Attendance = 10,
    /// What the operator's program sends by mistake.
    Operator = 11,
}

impl Random {
    /// The stream of a seed.
    pub(crate) fn new(seed: u64, stream: Stream) -> Self {
        let seed = seed ^ (stream as u64).wrapping_mul(0xd6e8_feb8_6659_fd93);
        let mut random = singletrack_control::statistics::Random::new(seed);
        // The first output of seeds that differ in one bit is similar.
        random.bits();
        Self(random)
    }

    /// A uniform 64-bit number.
    pub(crate) fn next(&mut self) -> u64 {
        self.0.bits()
    }

    /// A uniform integer from `least` to `most`, inclusive.
    pub(crate) fn between(&mut self, least: u32, most: u32) -> u32 {
        let span = u64::from(most.saturating_sub(least)) + 1;
        least + (((self.next() >> 32) * span) >> 32) as u32
    }

    /// A uniform integer from `least` to `most`, inclusive.
    pub(crate) fn signed(&mut self, least: i32, most: i32) -> i32 {
        let offset = self.between(0, most.abs_diff(least));
        least.saturating_add_unsigned(offset)
    }

    /// An integer from `least` to `most`, with equal probability per octave.
    pub(crate) fn spread(&mut self, least: u32, most: u32) -> u32 {
        let least = least.max(1);
        let octaves = most.max(least).ilog2() - least.ilog2();
        let low = least << self.between(0, octaves);
        self.between(low.min(most), low.saturating_mul(2).min(most))
    }

    /// True with a probability of `permille` / 1000.
    pub(crate) fn happens(&mut self, permille: u32) -> bool {
        self.between(0, 999) < permille
    }

    /// One of the choices, with equal probability.
    pub(crate) fn choose<T: Copy>(&mut self, first: T, others: &[T]) -> T {
        let index = self.between(0, others.len() as u32) as usize;
        if index == 0 {
            first
        } else {
            others.get(index - 1).copied().unwrap_or(first)
        }
    }
}
