//! What several figures have in common.

/// What the shading of every figure means.
pub(super) const LOST: &str = "markers lost";
