//! Closed loops in virtual time: scenario files, the host against the simulated car,
//! and the law alone against the paper's equations.

pub mod csv_text;
pub mod simulate;
pub mod simulated;
pub mod tracking;
pub mod virtual_drive;
pub mod virtual_record;
