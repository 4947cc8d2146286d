//! The paper's analyses as commands: stability, identification, the reproduction of its
//! experiments, and the comparison of controllers.

#![allow(
    clippy::disallowed_methods,
    reason = "figures and tables; the modules that plan simulated drives forbid it"
)]

pub mod compare;
pub mod identify;
pub mod reproduce;
pub mod stability;
pub mod table;
pub mod vehicle_file;
