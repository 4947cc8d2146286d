//! `singletrack-zenoh`: the control sockets of cars on other computers, by way of a zenoh router.
//!
//! On the computer of a car it is a client of the daemon's control socket; at the desk it offers a
//! socket for each of these cars. What is written to one comes out of the other, so that every
//! program that speaks to a daemon speaks to that of a car elsewhere. A connection ends at both ends
//! when it ends at one of them, or when the router is lost: the daemon then stops a drive that its
//! client held, as when the client dies.

mod arguments;
mod car;
mod connection;
mod desk;
mod network;

use std::{io, process::ExitCode};

use arguments::{Arguments, Side};
use clap::Parser as _;
use tracing_subscriber::{
    filter::{LevelFilter, Targets},
    layer::SubscriberExt as _,
    util::SubscriberInitExt as _,
};

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let filter = std::env::var("RUST_LOG")
        .ok()
        .and_then(|filter| filter.parse::<Targets>().ok())
        .unwrap_or_else(|| {
            Targets::new()
                .with_default(LevelFilter::ERROR)
                .with_target("singletrack_zenoh", LevelFilter::INFO)
        });
    tracing_subscriber::fmt()
        .with_max_level(LevelFilter::TRACE)
        .with_writer(io::stderr)
        .without_time()
        .with_target(false)
        .with_ansi(io::IsTerminal::is_terminal(&io::stderr()))
        .finish()
        .with(filter)
        .init();
    let config = arguments.config.as_deref();
    let ended = match &arguments.side {
        Side::Car(car) => car::serve(config, car),
        Side::Desk { fleet } => desk::offer(config, fleet),
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
