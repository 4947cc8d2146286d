//! The page: lengths in mm, and the colour of ink.

/// Size of all text but the axes' names, in mm: 7 pt.
pub(super) const TEXT_SIZE: f64 = 2.47;
/// From one line of a broken name to the next, in mm.
pub(super) const LINE_HEIGHT: f64 = 2.9;
/// Size of the axes' names, in mm: 8 pt.
pub(super) const NAME_SIZE: f64 = 2.82;
/// An area is not lower than this, however wide its data, in mm.
pub(super) const LEAST_HEIGHT: f64 = 30.0;
pub(super) const MARGIN: f64 = 1.5;
/// Below an area: its ticks and the axis' name.
pub(super) const BELOW: f64 = 9.2;
/// Room for the axis' name left of its ticks.
pub(super) const NAME_ROOM: f64 = 4.6;
pub(super) const TICK_GAP: f64 = 1.0;
pub(super) const PANEL_GAP: f64 = 5.0;
/// Between the name of an axis and what is in the row below.
pub(super) const ROW_GAP: f64 = 2.0;
/// Above an area that has a title.
pub(super) const TITLE_HEIGHT: f64 = 4.2;

pub(super) const INK: &str = "#1a1a1a";
