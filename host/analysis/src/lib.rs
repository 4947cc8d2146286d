//! Offline analysis of the car: stability and bifurcations of the linearising laws, and
//! identification of the car's parameters.
//!
//! Pure functions of their arguments, with the names, units and frames of
//! [`singletrack_control`], whose vehicle models they share.

mod dual;
#[cfg(feature = "identification")]
pub mod identification;
pub mod integrator;
pub mod stability;
