//! A plot of a measurement.

/// A plot of a measurement, for the page of the procedure.
#[derive(Clone, Debug, PartialEq)]
pub struct Plot {
    /// Its name, such as `latency`; in one procedure each has one.
    pub name: &'static str,
    /// What it shows, in a few words.
    pub title: &'static str,
    /// Quantity and unit of the horizontal axis.
    pub x: (&'static str, &'static str),
    /// Quantity and unit of the vertical axis.
    pub y: (&'static str, &'static str),
    /// Whether a unit is as long on both axes: for places.
    pub equal: bool,
    /// The lines.
    pub lines: Vec<PlotLine>,
}

impl Plot {
    /// Places on the floor, in m.
    pub(crate) const fn of_places(
        name: &'static str,
        title: &'static str,
        lines: Vec<PlotLine>,
    ) -> Self {
        Self {
            name,
            title,
            x: ("x", "m"),
            y: ("y", "m"),
            equal: true,
            lines,
        }
    }

    /// Lines over the time in s.
    #[must_use]
    pub fn over_time(
        name: &'static str,
        title: &'static str,
        y: (&'static str, &'static str),
        lines: Vec<PlotLine>,
    ) -> Self {
        Self {
            name,
            title,
            x: ("time", "s"),
            y,
            equal: false,
            lines,
        }
    }
}

/// A line of a [`Plot`].
#[derive(Clone, Debug, PartialEq)]
pub struct PlotLine {
    /// Its name in the legend.
    pub name: &'static str,
    /// Whether its points are readings or a fit.
    pub kind: PlotKind,
    /// Its points; it is interrupted where one is not a number.
    pub points: Vec<[f64; 2]>,
}

impl PlotLine {
    pub(crate) const fn new(name: &'static str, kind: PlotKind, points: Vec<[f64; 2]>) -> Self {
        Self { name, kind, points }
    }
}

/// What a line of a [`Plot`] is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlotKind {
    /// Readings.
    Measured,
    /// Other readings, to compare with.
    Other,
    /// A fit.
    Fitted,
}
