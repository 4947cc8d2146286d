//! Figures for print, described without saying how they are drawn.
//!
//! A [`Figure`] is [`Panel`]s, in one row or several, under one legend;
//! [`Figure::to_svg`] draws it. Lengths on the page are in mm.
//!
//! Names and labels that are `String`s, and the names in the legend, may hold symbols
//! between dollar signs: `"−$l_f$"` is a minus sign, an italic l and a small upright f
//! below.

mod contours;
mod map;
mod page;
mod place;
mod scale;
mod svg;
mod thin;
mod typeset;

use singletrack_control::words;

pub use map::{Band, Grid, GridError, Isoline, Map, Shade};
pub use page::{Callout, Callouts, Column, Estimate, Level, Look, MarkKind};
pub(crate) use scale::trimmed;
pub use scale::{Scale, decimals, minus};
pub use typeset::{escaped, plain, superscript};

/// A figure: panels under one legend.
#[derive(Clone, Debug)]
pub struct Figure {
    /// What it shows, in a few words; screen readers read it too.
    pub title: String,
    /// Its message, in a sentence.
    pub caption: String,
    /// How wide it is.
    pub width: Width,
    /// The panels, from left to right, and from top to bottom where one begins a row.
    pub panels: Vec<Panel>,
}

impl Figure {
    /// A figure of one column.
    pub fn column(
        title: impl Into<String>,
        caption: impl Into<String>,
        panels: Vec<Panel>,
    ) -> Self {
        Self {
            title: title.into(),
            caption: caption.into(),
            width: Width::Column,
            panels,
        }
    }

    /// A figure of the whole page.
    pub fn page(title: impl Into<String>, caption: impl Into<String>, panels: Vec<Panel>) -> Self {
        Self {
            width: Width::Page,
            ..Self::column(title, caption, panels)
        }
    }
}

words! {
    /// How wide a figure is in a paper of two columns. Its word is its class in a style sheet.
    pub enum Width {
        /// One column: 85 mm.
        Column = "column",
        /// The whole page: 178 mm.
        Page = "page",
    }
}

impl Width {
    /// In mm.
    pub const fn mm(self) -> f64 {
        match self {
            Self::Column => 85.0,
            Self::Page => 178.0,
        }
    }
}

/// Two axes and what is drawn between them.
#[derive(Clone, Debug, Default)]
pub struct Panel {
    /// What stands above it; may be empty.
    pub title: String,
    /// Whether it begins a new row of panels.
    pub begins_row: bool,
    /// The horizontal axis.
    pub x: Axis,
    /// The vertical axis.
    pub y: Axis,
    /// Height of the area between the axes, in mm.
    pub height_mm: f64,
    /// Whether a unit is as long on both axes.
    pub equal: bool,
    /// Spans of the horizontal axis that are shaded.
    pub spans: Vec<[f64; 2]>,
    /// What the shading means, for the legend.
    pub span_name: &'static str,
    /// A quantity over the whole area, beneath everything else. It sets both axes.
    pub map: Option<Map>,
    /// Values of the vertical axis that matter, such as the ends of a range.
    pub levels: Vec<Level>,
    /// Lines, drawn in this order.
    pub curves: Vec<Curve>,
    /// Points that matter.
    pub marks: Vec<Mark>,
    /// Points with the interval that each is believed to be in.
    pub estimates: Vec<Estimate>,
    /// Points with something written beside them.
    pub callouts: Vec<Callouts>,
    /// Bars of a histogram.
    pub bars: Vec<Bar>,
    /// Values of the horizontal axis with a name.
    pub rules: Vec<Rule>,
    /// Names along the horizontal axis at 0, 1, 2, ..., in place of its numbers and its name. A
    /// name that is too long for its place is broken after hyphens.
    pub names: Vec<String>,
}

impl Panel {
    /// Two axes with nothing between them.
    pub fn new(x: Axis, y: Axis) -> Self {
        Self {
            x,
            y,
            height_mm: 42.0,
            ..Self::default()
        }
    }

    /// The floor, in m: where a point is that has this subscript.
    pub fn floor(point: &'static str) -> Self {
        let axis = |letter| Axis::new("", Some(Symbol::new(letter, point)), "m");
        Self {
            equal: true,
            ..Self::new(axis("x"), axis("y"))
        }
    }

    /// Whether there is anything to see.
    pub fn is_empty(&self) -> bool {
        self.bars.is_empty()
            && self.estimates.is_empty()
            && self.map.as_ref().is_none_or(Map::is_empty)
            && self.curves.iter().all(Curve::is_empty)
    }
}

/// An axis.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Axis {
    /// What is along it.
    pub quantity: &'static str,
    /// Its symbol; none if it has no common one.
    pub symbol: Option<Symbol>,
    /// Its unit.
    pub unit: &'static str,
    /// How values are spread.
    pub scale: Scale,
    /// A value that must be on it, such as the zero of a count.
    pub include: Option<f64>,
}

impl Axis {
    /// Time t, in s.
    pub const TIME: Self = Self::new("time", Some(Symbol::new("t", "")), "s");

    /// A linear axis, as long as its data.
    pub const fn new(quantity: &'static str, symbol: Option<Symbol>, unit: &'static str) -> Self {
        Self {
            quantity,
            symbol,
            unit,
            scale: Scale::Linear,
            include: None,
        }
    }

    /// The axis with a value that must be on it.
    #[must_use]
    pub const fn including(self, value: f64) -> Self {
        Self {
            include: Some(value),
            ..self
        }
    }

    /// The axis on a logarithmic scale.
    #[must_use]
    pub const fn logarithmic(self) -> Self {
        Self {
            scale: Scale::Log,
            ..self
        }
    }
}

/// A symbol of the paper: a letter with what stands below it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Symbol {
    /// The letter, in italics.
    pub letter: &'static str,
    /// The subscript, upright; may be empty.
    pub below: &'static str,
}

impl Symbol {
    /// A letter and what stands below it.
    pub const fn new(letter: &'static str, below: &'static str) -> Self {
        Self { letter, below }
    }
}

/// A line through points, interrupted where a coordinate is not a number.
#[derive(Clone, Debug)]
pub struct Curve {
    /// What it is, for the legend.
    pub name: &'static str,
    /// How it looks.
    pub look: Look,
    /// Horizontal coordinates.
    pub x: Column,
    /// Vertical coordinates.
    pub y: Column,
    /// When each point was, for a line that is not over time.
    pub time: Option<Column>,
}

impl Curve {
    /// A line through points that have no times of their own.
    pub fn new(name: &'static str, look: Look, x: &Column, y: Column) -> Self {
        Self {
            name,
            look,
            x: x.clone(),
            y,
            time: None,
        }
    }

    /// Whether no point of it can be drawn.
    pub fn is_empty(&self) -> bool {
        !self.points().any(|[x, y]| x.is_finite() && y.is_finite())
    }

    /// Its points, in order.
    pub fn points(&self) -> impl Iterator<Item = [f64; 2]> + '_ {
        self.x.iter().zip(self.y.iter()).map(|(x, y)| [*x, *y])
    }
}

/// A point that matters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mark {
    /// What it is, for the legend.
    pub name: &'static str,
    /// What it looks like.
    pub kind: MarkKind,
    /// Where.
    pub point: [f64; 2],
}

/// A bar of a histogram, from zero up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bar {
    /// Where it begins and ends on the horizontal axis.
    pub span: [f64; 2],
    /// How high it is.
    pub height: f64,
}

/// A named value of the horizontal axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Rule {
    /// What it is, with its value.
    pub name: String,
    /// Where.
    pub value: f64,
}
