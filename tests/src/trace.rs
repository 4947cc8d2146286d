//! What came out of the board's pins, in board time.

/// The pulses from one moment on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pulses {
    /// The board's clock, in µs. It starts anew with the board.
    pub board_time_us: u32,
    /// Servo pulse in µs; zero is no pulse.
    pub servo_us: u16,
    /// ESC pulse in µs; zero is no pulse.
    pub esc_us: u16,
}

impl Pulses {
    /// Whether the motor gets nothing: exactly neutral, or no pulse at all.
    #[must_use]
    pub const fn is_neutral(&self, neutral_us: u16) -> bool {
        self.esc_us == 0 || self.esc_us == neutral_us
    }
}

/// The pulses since the rig was built, oldest first.
#[derive(Clone, Debug, Default)]
pub struct Trace(pub Vec<Pulses>);

impl Trace {
    /// How many there are; a place to come back to with [`Self::since`].
    #[must_use]
    pub const fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether there are none.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The pulses from a place on.
    #[must_use]
    pub fn since(&self, place: usize) -> &[Pulses] {
        self.0.get(place..).unwrap_or(&[])
    }

    /// The first pulse from which on, to the end, the motor gets nothing.
    #[must_use]
    pub fn neutral_from(&self, neutral_us: u16) -> Option<Pulses> {
        self.0
            .iter()
            .rev()
            .take_while(|pulses| pulses.is_neutral(neutral_us))
            .last()
            .copied()
    }
}

/// From one board time to a later one, in ms.
#[must_use]
pub(crate) fn elapsed_ms(from_us: u32, to_us: u32) -> f64 {
    // Board time wraps; the later may also be a little earlier.
    f64::from(to_us.wrapping_sub(from_us) as i32) / 1_000.0
}
