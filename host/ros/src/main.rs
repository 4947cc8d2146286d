//! `singletrack-ros`: the car as a node of ROS 2, without an installation of ROS.
//!
//! A process of its own. It is a client of the daemon's control socket, as any other: it
//! publishes the messages of the record, and passes set-points and requests on. If it
//! hangs or dies, the daemon stops the car.

mod frames;
mod incoming;
mod message;
mod node;
mod outgoing;
mod setpoint;
mod shared;

use std::{error::Error, io, process::ExitCode, sync::Arc};

use clap::Parser as _;
use shared::{Arguments, Shared};
use singletrack_api::log;

fn main() -> ExitCode {
    let shared = Arc::new(Shared::new(Arguments::parse()));
    log::start("singletrack_ros", log::LevelFilter::WARN);
    match run(&shared) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("singletrack-ros: {error}");
            ExitCode::FAILURE
        }
    }
}

/// Runs until a signal.
fn run(shared: &Arc<Shared>) -> Result<(), Box<dyn Error>> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_io()
        .build()?;
    let arguments = &shared.arguments;
    let mut node = node::Node::start(arguments)?;
    outgoing::start(&mut node, shared)?;
    if !arguments.publish_only {
        incoming::start(&mut node, shared)?;
    }
    outgoing::start_diagnostics(&mut node, shared)?;
    node.spin()?;
    tracing::info!(
        domain = node.domain,
        namespace = arguments.namespace,
        socket = %arguments.socket.display(),
        "started"
    );
    runtime.block_on(signal())?;
    // The connection that holds a drive ends with the process, and the car stops at once; a
    // disarm slows it down.
    incoming::end(shared);
    Ok(())
}

async fn signal() -> io::Result<()> {
    use tokio::signal::unix::{SignalKind, signal};
    let mut interrupt = signal(SignalKind::interrupt())?;
    let mut terminate = signal(SignalKind::terminate())?;
    tokio::select! {
        _ = interrupt.recv() => {}
        _ = terminate.recv() => {}
    }
    Ok(())
}
