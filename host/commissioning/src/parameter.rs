//! A measured value and what it is believed to be worth.

/// An estimate with its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interval {
    /// The estimate.
    pub value: f64,
    /// Lower end of the 95 % interval.
    pub low: f64,
    /// Upper end of the 95 % interval.
    pub high: f64,
}

impl Interval {
    /// A symmetric interval.
    #[must_use]
    pub fn around(value: f64, half_width: f64) -> Self {
        Self {
            value,
            low: value - half_width,
            high: value + half_width,
        }
    }
}

/// A parameter of the car that was measured.
#[derive(Clone, Debug)]
pub struct Parameter {
    /// Its name, such as `servo-centre`; in one procedure each has one.
    pub name: &'static str,
    /// Its unit, such as `us`.
    pub unit: &'static str,
    /// The estimate, in the unit.
    pub estimate: Interval,
    /// The key of the configuration that takes it, such as `board.servo.centre_us`, with the
    /// value as TOML; none if there is none.
    pub key: Option<(&'static str, toml_edit::Value)>,
}
