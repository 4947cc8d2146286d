//! The command line.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand};

/// Control sockets of cars on other computers, by way of a zenoh router
///
/// Who reaches the router can drive the cars, unless its configuration asks for a password.
#[derive(Debug, Parser)]
#[command(version)]
pub(crate) struct Arguments {
    /// A configuration file of zenoh (JSON5), such as one with a user and a password
    #[arg(long, value_name = "FILE", global = true)]
    pub(crate) config: Option<PathBuf>,
    #[command(subcommand)]
    pub(crate) side: Side,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Side {
    /// On the computer of a car: lets others use the daemon's socket
    Car(Car),
    /// On another computer: offers a socket for each car of a fleet that names a router
    Desk {
        /// The cars
        #[arg(long, value_name = "FILE", default_value = "fleet.toml")]
        fleet: PathBuf,
    },
    /// The router, which runs once and which all others reach; zenohd can take its place
    Router {
        /// Where it listens: tcp/[::]:7447 for all computers
        #[arg(long, value_name = "ENDPOINT", default_value = "tcp/127.0.0.1:7447")]
        listen: String,
        /// Let everyone in who reaches it, and drive the cars: only in a network of the cars alone
        #[arg(long)]
        without_password: bool,
    },
}

#[derive(Debug, Args)]
pub(crate) struct Car {
    /// Of the car, as in the file of the fleet
    #[arg(long)]
    pub(crate) name: String,
    /// The daemon's control socket
    #[arg(
        long,
        value_name = "PATH",
        env = "SINGLETRACK_SOCKET",
        hide_env_values = true,
        default_value = "/run/singletrackd/control.sock"
    )]
    pub(crate) socket: PathBuf,
    /// The router, such as tcp/192.168.1.30:7447
    #[arg(long, value_name = "ENDPOINT")]
    pub(crate) router: String,
}
