//! What several figures have in common.

use crate::figure::{Axis, Column, Curve, Look, Symbol};

/// What the shading of every figure means.
pub(super) const LOST: &str = "markers lost";

pub(super) const TIME: Axis = Axis::new("time", Some(Symbol::new("t", "")), "s");

pub(super) fn curve(name: &'static str, look: Look, x: &Column, y: Column) -> Curve {
    Curve {
        name,
        look,
        x: x.clone(),
        y,
        time: None,
    }
}
