//! How lines and marks look, and the numbers that they are drawn through.

use std::sync::Arc;

use serde::Serialize;

/// Numbers of a curve, shared by all that draw them.
pub type Column = Arc<[f64]>;

/// The style of a line: distinguishable without colour, by grey, width and dashes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Look {
    /// The nominal value: wide and grey, as in the paper.
    Nominal,
    /// The actual value: thin and black, as in the paper.
    Actual,
    /// A measurement: thin and light.
    Measured,
    /// Ground truth, which only a simulation has: dashed.
    Truth,
    /// Where something was missing: a wide band of the shading's colour.
    Lost,
    /// The other of two that are compared: black, in long dashes.
    Other,
    /// Where one kind of behaviour turns into another: thick and black.
    Boundary,
    /// The end of a range: thin, dashed.
    RangeEnd,
    /// An asymptote: thin, dashes and dots.
    Asymptote,
}

impl Look {
    /// Its name in a style sheet.
    #[must_use]
    pub const fn class(self) -> &'static str {
        match self {
            Self::Nominal => "nominal",
            Self::Actual => "actual",
            Self::Measured => "measured",
            Self::Truth => "truth",
            Self::Lost => "lost",
            Self::Other => "other",
            Self::Boundary => "boundary",
            Self::RangeEnd => "range-end",
            Self::Asymptote => "asymptote",
        }
    }
}

/// What a mark looks like.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum MarkKind {
    /// Where a trajectory starts: a triangle.
    Start,
    /// Where it ends: a circle.
    End,
    /// A value that was found: a dot.
    Found,
    /// One of several kinds of value: a filled square.
    Square,
    /// One of several kinds of value: a diamond.
    Diamond,
    /// What has no value: a cross.
    None,
}

impl MarkKind {
    /// Its name in a style sheet.
    #[must_use]
    pub const fn class(self) -> &'static str {
        match self {
            Self::Start => "start",
            Self::End => "end",
            Self::Found => "found",
            Self::Square => "square",
            Self::Diamond => "diamond",
            Self::None => "none",
        }
    }
}
