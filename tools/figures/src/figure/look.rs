//! How lines and marks look, and the numbers that they are drawn through.

use std::sync::Arc;

use singletrack_words::words;

/// Numbers of a curve, shared by all that draw them.
pub type Column = Arc<[f64]>;

words! {
    /// The style of a line: distinguishable without colour, by grey, width and dashes. Its word is
    /// its class in a style sheet.
    pub enum Look {
        /// The nominal value: wide and grey, as in the paper.
        Nominal = "nominal",
        /// The actual value: thin and black, as in the paper.
        Actual = "actual",
        /// A measurement: thin and light.
        Measured = "measured",
        /// Ground truth, which only a simulation has: dashed.
        Truth = "truth",
        /// Where something was missing: a wide band of the shading's colour.
        Lost = "lost",
        /// The other of two that are compared: black, in long dashes.
        Other = "other",
        /// Where one kind of behaviour turns into another: thick and black.
        Boundary = "boundary",
        /// The end of a range: thin, dashed.
        RangeEnd = "range-end",
        /// An asymptote: thin, dashes and dots.
        Asymptote = "asymptote",
    }
}

words! {
    /// What a mark looks like. Its word is its class in a style sheet.
    pub enum MarkKind: serde {
        /// Where a trajectory starts: a triangle.
        Start = "start",
        /// Where it ends: a circle.
        End = "end",
        /// A value that was found: a dot.
        Found = "found",
        /// One of several kinds of value: a filled square.
        Square = "square",
        /// One of several kinds of value: a diamond.
        Diamond = "diamond",
        /// What has no value: a cross.
        None = "none",
    }
}
