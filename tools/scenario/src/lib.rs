//! Closed loops in virtual time: scenario files, the host against the simulated car,
//! and the law alone against the paper's equations.

#[cfg(feature = "files")]
pub mod csv_text;
pub mod laboratory;
#[cfg(feature = "files")]
pub mod simulate;
pub mod simulated;
#[cfg(feature = "files")]
pub mod tracking;
pub mod virtual_drive;
pub mod virtual_fleet;
#[cfg_attr(not(feature = "records"), path = "no_record.rs")]
pub mod virtual_record;
