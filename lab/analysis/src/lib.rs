//! Offline analysis of the car: stability and bifurcations of the linearising laws, and
//! identification of the car's parameters.
//!
//! Pure functions of their arguments, with the names, units and frames of
//! [`singletrack_control`], whose vehicle models they share.

#![allow(
    clippy::disallowed_methods,
    reason = "what is fitted or judged here is a result; the drives that it computes are of `singletrack_sim::integrator`, which forbids it"
)]

mod dual;
pub mod identification;
#[cfg(feature = "quadratic")]
pub mod quadratic;
pub mod stability;
