//! What is computed about the car at a desk, not in its loop: stability and
//! bifurcations of the linearising laws, and identification of the car's parameters.
//!
//! Pure functions of their arguments, with the names, units and frames of
//! [`singletrack_control`].

pub mod identification;
pub mod stability;
