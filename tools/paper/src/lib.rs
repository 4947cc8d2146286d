//! The paper's analyses as commands: stability, identification, and the reproduction
//! of its experiments.

pub mod identify;
pub mod reproduce;
pub mod stability;
pub mod vehicle_file;
