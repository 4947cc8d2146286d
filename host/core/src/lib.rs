//! The host without its devices: the configuration, the [`controller::Controller`]
//! that joins link session and pilot, and the loop around it.
//!
//! Everything that runs the car runs this code: the daemon in real time on its
//! threads, simulations and tests in virtual time on one. It has no clock, thread, port or
//! socket; time, bytes and datagrams are arguments.

pub mod config;
mod explain;
mod run;

pub use config::{Config, ConfigError};
pub use config::{record_meta, restart_keys};
pub use controller::pose_event;
pub use explain::{commissioned, diagnosis, feasibility, reasons};
pub use host::{Host, HostOptions};
pub use run::proof::{MAX_PROOFS, Proof, Proofs, configuration_hash};
pub use run::report::{LineCounters, Report, link_phase, pilot_event};
pub use run::requests::{
    ControlRequest, Reconfiguration, ReconfigureError, Refusal, Requests, Stalled,
};
pub use run::{
    cameras, control_loop, controller, grid, host, line, online_calibration, reconfigure, serial,
    setpoint, slot, state_stream, virtual_host,
};
pub use virtual_host::VirtualHost;
