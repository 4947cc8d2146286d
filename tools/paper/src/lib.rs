//! The paper's analyses as commands: stability, identification, the reproduction of its
//! experiments, and the comparison of controllers.

pub mod compare;
pub mod identify;
pub mod reproduce;
pub mod stability;
pub mod table;
pub mod vehicle_file;
