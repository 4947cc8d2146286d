//! `singletrack-zenoh`: the control sockets of cars on other computers, by way of a zenoh router.
//!
//! On the computer of a car it is a client of the daemon's control socket; at the desk it offers a
//! socket for each of these cars. What is written to one comes out of the other, so that every
//! program that speaks to a daemon speaks to that of a car elsewhere. A connection ends at both ends
//! when it ends at one of them, or when the router is lost: the daemon then stops a drive that its
//! client held, as when the client dies.

mod connection;
mod network;
mod sides;

use std::{path::PathBuf, process::ExitCode};

use clap::{Parser, Subcommand};
use sides::Car;
use singletrack_api::log;

/// Control sockets of cars on other computers, by way of a zenoh router
///
/// Who reaches the router can drive the cars, unless its configuration asks for a password.
#[derive(Debug, Parser)]
#[command(version)]
struct Arguments {
    /// A configuration file of zenoh (JSON5), such as one with a user and a password
    #[arg(long, value_name = "FILE", global = true)]
    config: Option<PathBuf>,
    #[command(subcommand)]
    side: Side,
}

#[derive(Debug, Subcommand)]
enum Side {
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

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    log::start("singletrack_zenoh", log::LevelFilter::ERROR);
    let config = arguments.config.as_deref();
    let ended = match &arguments.side {
        Side::Car(car) => sides::serve(config, car),
        Side::Desk { fleet } => sides::offer(config, fleet),
        Side::Router {
            listen,
            without_password,
        } => network::route(config, listen, *without_password),
    };
    match ended {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("singletrack-zenoh: {error}");
            ExitCode::FAILURE
        }
    }
}
