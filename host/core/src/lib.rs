//! The host without its devices: the configuration, the [`controller::Controller`]
//! that joins link session and pilot, and the loop around it.
//!
//! Everything that runs the car runs this code: the daemon in real time on its
//! threads, simulations and tests in virtual time on one. It has no clock, thread, port or
//! socket; time, bytes and datagrams are arguments.

pub mod cameras;
pub mod commissioned;
pub mod config;
pub mod control_loop;
pub mod controller;
pub mod diagnosis;
pub mod feasibility;
pub mod grid;
pub mod host;
pub mod line;
pub mod online_calibration;
pub mod reasons;
pub mod reconfigure;
pub mod serial;
pub mod setpoint;
pub mod setpoint_slot;
pub mod slot;
pub mod state_stream;
pub mod virtual_host;

mod alignment;
mod hexadecimal;
mod link_event;
mod meta;
mod neighbours;
mod proof;
mod report;
mod requests;
mod restart_keys;

pub use config::{Config, ConfigError};
pub use controller::pose_event;
pub use host::{Host, HostOptions};
pub use link_event::pilot_event;
pub use meta::record_meta;
pub use proof::{MAX_PROOFS, Proof, Proofs, configuration_hash};
pub use report::{LineCounters, Report, link_phase};
pub use requests::{ControlRequest, Reconfiguration, ReconfigureError, Refusal, Requests, Stalled};
pub use restart_keys::restart_keys;
pub use virtual_host::VirtualHost;
