//! The root mean square of a sequence.

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
    #[must_use]
    pub fn value(&self) -> Option<f64> {
        (self.count > 0).then(|| (self.squares / self.count as f64).sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
}
