//! The host without its devices: the configuration, the [`controller::Controller`]
//! that joins link session and pilot, and the loop around it.
//!
//! Everything that runs the car runs this code: the daemon in real time on its
//! threads, simulations and tests in virtual time on one. It has no clock, thread, port or
//! socket; time, bytes and datagrams are arguments.

pub mod config;
/// What is told to people: what a reason means, what is wrong with the cameras, whether a reference can
/// be driven, and what is still to be done with a new car.
mod explain {
    pub mod certificate;
    pub mod commissioned;
    pub(crate) mod diagnosis;
    pub mod feasibility;
    pub mod reasons;
    pub mod top_view;
}

/// The loop that runs the car, in real or virtual time.
mod run {
    pub mod cameras;
    pub mod control_loop;
    pub mod controller;
    pub mod grid;
    pub mod host;
    pub mod line;
    pub(crate) mod messages;
    pub mod online_calibration;
    pub(crate) mod proof;
    pub(crate) mod queue;
    pub mod reconfigure;
    pub mod serial;
    pub mod setpoint;
    pub mod slot;
    pub mod state_stream;
}

pub use config::{Config, ConfigError, record_meta, restart_keys};
pub use controller::pose_event;
pub(crate) use explain::diagnosis;
pub use explain::{certificate, commissioned, feasibility, reasons, top_view};
pub use host::{Host, HostOptions, VirtualHost};
pub use run::messages::{
    ControlRequest, LineCounters, Reconfiguration, Refusal, Report, Requests, Stalled, link_phase,
};
pub use run::proof::{MAX_PROOFS, Proof, Proofs, configuration_hash};
pub use run::queue::pilot_event;
pub use run::{
    cameras, control_loop, controller, grid, host, line, online_calibration, reconfigure, serial,
    setpoint, slot, state_stream,
};
