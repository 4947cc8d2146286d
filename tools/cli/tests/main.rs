//! The command line, as it is typed.

#![allow(
    clippy::disallowed_methods,
    reason = "what a test expects is compared within a tolerance"
)]
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test may fail"
)]

mod accept_command;
mod arm_command;
mod cameras_command;
mod command_line;
mod control_command;
#[path = "../../../host/daemon/tests/common/mod.rs"]
mod daemon;
mod demo_command;
mod fleet_command;
#[allow(dead_code, reason = "other tests use the rest")]
#[path = "../../figures/tests/picture/mod.rs"]
mod picture;
mod plot_animation;
mod plot_command;
mod pty;
mod recorded;
mod records_command;
mod replay_command;
mod setpoint_command;
mod simulate_command;
mod status_command;
mod viewers_command;
