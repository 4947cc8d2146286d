//! A quantity over two others: shaded by bands of its values, with lines of equal value.

use std::{fmt, sync::Arc};

use singletrack_control::words;

use super::page::Column;

/// A quantity at the crossings of a rectangular grid.
#[derive(Clone)]
pub struct Grid {
    x: Column,
    y: Column,
    values: Column,
    pub(super) is_reached: Option<IsReached>,
}

/// Whether a place has a value or more.
pub(super) type IsReached = Arc<dyn Fn([f64; 2], f64) -> bool>;

impl fmt::Debug for Grid {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { x, y, values, .. } = self;
        (x, y, values).fmt(formatter)
    }
}

/// Why numbers are not a grid.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{0}")]
pub struct GridError(String);

impl Grid {
    /// `values` row by row: all along `x` for the first `y`, then for the second. What
    /// is not a number is left blank.
    ///
    /// # Errors
    ///
    /// If `x` or `y` has less than two values or does not ascend, or `values` has not
    /// one for each crossing.
    pub fn new(x: Column, y: Column, values: Column) -> Result<Self, GridError> {
        ascending('x', &x)?;
        ascending('y', &y)?;
        if values.len() != x.len() * y.len() {
            let [columns, rows, count] = [&x, &y, &values].map(|numbers| numbers.len());
            return Err(GridError(format!(
                "a grid of {columns} by {rows} has {} values, not {count}",
                columns * rows
            )));
        }
        Ok(Self {
            x,
            y,
            values,
            is_reached: None,
        })
    }

    /// Has lines and shades end between neighbours where the place, by this, no longer has the value or more,
    /// for a quantity that jumps.
    #[must_use]
    pub fn bisected(self, is_reached: impl Fn([f64; 2], f64) -> bool + 'static) -> Self {
        Self {
            is_reached: Some(Arc::new(is_reached)),
            ..self
        }
    }

    /// The values of a function of `x` and `y`.
    ///
    /// # Errors
    ///
    /// If `x` or `y` has less than two values or does not ascend.
    pub fn of(
        x: Column,
        y: Column,
        mut value: impl FnMut(f64, f64) -> f64,
    ) -> Result<Self, GridError> {
        let mut values = Vec::with_capacity(x.len() * y.len());
        for y in y.iter() {
            values.extend(x.iter().map(|x| value(*x, *y)));
        }
        Self::new(x, y, values.into())
    }

    /// Where its columns are.
    pub fn x(&self) -> &[f64] {
        &self.x
    }

    /// Where its rows are.
    pub fn y(&self) -> &[f64] {
        &self.y
    }

    /// Its values, row by row.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// Whether any of its values is in a band.
    pub(super) fn has(&self, band: &Band) -> bool {
        let within =
            |value: &f64| *value >= band.from && (*value < band.to || band.to.is_infinite());
        self.values.iter().any(within)
    }

    /// The least and the greatest of its finite values.
    pub fn range(&self) -> Option<[f64; 2]> {
        let values = self.values.iter().copied();
        let finite = values.filter(|value| value.is_finite());
        Some([finite.clone().reduce(f64::min)?, finite.reduce(f64::max)?])
    }
}

fn ascending(axis: char, values: &[f64]) -> Result<(), GridError> {
    if values.len() < 2 {
        let count = values.len();
        return Err(GridError(format!(
            "a grid needs two values or more along {axis}, and has {count}"
        )));
    }
    let mut before = f64::NEG_INFINITY;
    for value in values.iter().copied() {
        if !(value.is_finite() && value > before) {
            return Err(GridError(format!(
                "a grid's values along {axis} must be finite and ascend: {value} can't follow {before}"
            )));
        }
        before = value;
    }
    Ok(())
}

/// How a grid is drawn.
#[derive(Clone, Debug)]
pub struct Map {
    /// What is drawn.
    pub grid: Grid,
    /// Which values are shaded, and how. Values in no band are left blank.
    pub bands: Vec<Band>,
    /// Dotted lines of equal value, each with its label written in it where there is
    /// room.
    pub isolines: Vec<Isoline>,
    /// What the isolines show, for the legend.
    pub isoline_name: String,
}

impl Map {
    /// A map without shades and lines.
    pub const fn new(grid: Grid) -> Self {
        Self {
            grid,
            bands: Vec::new(),
            isolines: Vec::new(),
            isoline_name: String::new(),
        }
    }

    /// Whether there is no number in it.
    pub fn is_empty(&self) -> bool {
        self.grid.values.iter().all(|value| value.is_nan())
    }
}

/// Values from one up to another.
#[derive(Clone, Debug, PartialEq)]
pub struct Band {
    /// What they mean, for the legend.
    pub name: String,
    /// The least of them; may be infinite.
    pub from: f64,
    /// The first that is too great; may be infinite.
    pub to: f64,
    /// How the band looks.
    pub shade: Shade,
}

words! {
    /// How an area looks: greys that print as such, and one without grey. Its word is its class in a
    /// style sheet.
    pub enum Shade {
        /// Nearly white.
        Palest = "palest",
        /// The paper's light grey.
        Light = "light",
        /// The paper's dark grey.
        Dark = "dark",
        /// Oblique lines, not grey.
        Hatched = "hatched",
    }
}

/// A line of equal value.
#[derive(Clone, Debug, PartialEq)]
pub struct Isoline {
    /// The value.
    pub value: f64,
    /// What is written in it; may be empty.
    pub label: String,
}

impl Isoline {
    /// A line labelled by its value, with this number of decimals.
    pub fn new(value: f64, decimals: usize) -> Self {
        let label = super::scale::minus(format!("{value:.decimals$}"));
        Self { value, label }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn column(values: &[f64]) -> Column {
        values.into()
    }

    #[test]
    fn a_grid_that_is_none_is_refused_and_says_why() {
        let two = column(&[0.0, 1.0]);
        let error = |x: &[f64], count: usize| {
            let grid = Grid::new(column(x), two.clone(), vec![0.0; count].into());
            grid.map(|_| ()).map_err(|error| error.to_string())
        };
        assert_eq!(error(&[0.0, 1.0], 4), Ok(()));
        for (x, count, why) in [
            (&[0.0][..], 2, "two values or more along x, and has 1"),
            (&[0.0, 0.0], 4, "0 can't follow 0"),
            (&[0.0, f64::NAN], 4, "NaN can't follow 0"),
            (&[0.0, 1.0], 5, "2 by 2 has 4 values, not 5"),
        ] {
            let said = error(x, count).err().unwrap_or_default();
            assert!(said.contains(why), "{said}");
        }
    }

    #[test]
    fn a_grid_of_a_function_goes_along_its_rows() {
        let grid = Grid::of(column(&[1.0, 2.0, 3.0]), column(&[10.0, 20.0]), |x, y| {
            x + y
        })
        .unwrap();
        assert_eq!(grid.values(), [11.0, 12.0, 13.0, 21.0, 22.0, 23.0]);
        assert_eq!(grid.range(), Some([11.0, 23.0]));
    }

    #[test]
    fn labels_have_the_digits_that_were_asked_for_and_a_real_minus() {
        assert_eq!(Isoline::new(-0.5, 1).label, "\u{2212}0.5");
        assert_eq!(Isoline::new(0.0, 0).label, "0");
    }
}
