//! The loop that runs the car, in real or virtual time.

pub mod cameras;
pub mod control_loop;
pub mod controller;
pub mod grid;
pub mod host;
pub mod line;
pub mod online_calibration;
pub(crate) mod proof;
pub mod reconfigure;
pub(crate) mod report;
pub(crate) mod requests;
pub mod serial;
pub mod setpoint;
pub mod slot;
pub mod state_stream;
pub mod virtual_host;
