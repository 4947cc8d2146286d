//! What is written or marked in a panel beside its lines.

use super::look::{Look, MarkKind};

/// A value of the vertical axis that matters, drawn across the panel.
#[derive(Clone, Debug, PartialEq)]
pub struct Level {
    /// What it is, for the legend. Both ends of a range have the same name.
    pub name: String,
    /// Where.
    pub value: f64,
    /// What is written beside it; may be empty.
    pub label: String,
    /// How it looks.
    pub look: Look,
}

/// Points of one kind, each with something written beside it at the end of a dotted
/// leader.
#[derive(Clone, Debug, PartialEq)]
pub struct Callouts {
    /// What is written, for the legend.
    pub name: String,
    /// The points.
    pub points: Vec<Callout>,
}

/// A point and what is written beside it.
#[derive(Clone, Debug, PartialEq)]
pub struct Callout {
    /// Where.
    pub point: [f64; 2],
    /// What.
    pub label: String,
}

/// A value, and the interval that it is believed to be in.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// What it is, for the legend.
    pub name: String,
    /// What the point looks like.
    pub kind: MarkKind,
    /// Where it is on the horizontal axis.
    pub x: f64,
    /// The value, on the vertical axis.
    pub value: f64,
    /// The ends of the interval, on the vertical axis.
    pub interval: [f64; 2],
}
