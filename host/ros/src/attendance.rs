//! The drive that a node of ROS has armed, held by a connection of this process; the services
//! `arm`, `disarm` and `stop`.
//!
//! The daemon's dead-man switch is this connection. The controller behind it is watched by the
//! age of its set-points: a drive can only be armed while set-points are passed on, and the
//! daemon stops the car when they end.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use futures::executor::block_on;
use singletrack_api::{ClientError, HeldDrive, Reply, Request, ask};

use crate::{
    message::TriggerResponse,
    node::{Node, start},
    shared::Shared,
};

/// The longest wait for a line, so that renewals are not late.
const WAIT: Duration = Duration::from_millis(20);

/// The longest wait for a daemon that does not read.
const PATIENCE: Duration = Duration::from_millis(200);

/// Arms a drive, and holds it until it ends. Returns once the car drives.
fn arm(shared: &Arc<Shared>) -> Result<(), String> {
    {
        let mut state = shared.state();
        if let Some(refusal) = state.refusal(Instant::now()) {
            return Err(format!("can't arm: {refusal}"));
        }
        state.is_held = true;
    }
    let held = Held(Arc::clone(shared));
    let socket = &shared.arguments.socket;
    let mut drive = HeldDrive::arm(socket, PATIENCE, WAIT).map_err(|error| error.to_string())?;
    start("hold", move || {
        let ended = hold(&mut drive);
        drop(held);
        match ended {
            Ok(ended) => tracing::info!("the drive has ended: {ended}"),
            Err(error) => tracing::warn!("the drive has ended: {error}"),
        }
    })
}

/// Asks the daemon to slow the car down and stop it, or to stop it at once, until the board is reset.
fn tell(shared: &Shared, request: &Request) -> Result<(), String> {
    let answer = ask(request, &shared.arguments.socket);
    answer.map(drop).map_err(|error| error.to_string())
}

/// Disarms a drive of this process.
pub(crate) fn end(shared: &Shared) {
    let is_held = shared.state().is_held;
    if is_held && let Err(error) = tell(shared, &Request::DISARM) {
        tracing::warn!("{error}");
    }
}

/// A drive is held for as long as this lives.
struct Held(Arc<Shared>);

impl Drop for Held {
    fn drop(&mut self) {
        self.0.state().is_held = false;
    }
}

/// Renews a drive until it has ended; returns how.
fn hold(drive: &mut HeldDrive) -> Result<String, ClientError> {
    loop {
        if let Some(Reply::Ended { ended, .. }) = drive.next(WAIT)? {
            return Ok(ended.to_string());
        }
    }
}

/// Offers the services `arm`, `disarm` and `stop`, each on a thread of its own: an arm that waits
/// does not delay a stop.
pub(crate) fn offer(node: &mut Node, shared: &Arc<Shared>) -> Result<(), String> {
    serve(node, "arm", shared, arm)?;
    serve(node, "disarm", shared, |shared| {
        tell(shared, &Request::DISARM)
    })?;
    serve(node, "stop", shared, |shared| {
        tell(shared, &Request::Stop {})
    })
}

fn serve(
    node: &mut Node,
    name: &'static str,
    shared: &Arc<Shared>,
    obey: fn(&Arc<Shared>) -> Result<(), String>,
) -> Result<(), String> {
    let server = node.trigger(name)?;
    let shared = Arc::clone(shared);
    start(name, move || {
        loop {
            let request = match block_on(server.async_receive_request()) {
                Ok((request, _)) => request,
                Err(error) => {
                    tracing::warn!("{name}: {error}");
                    continue;
                }
            };
            let done = obey(&shared);
            match &done {
                Ok(()) => tracing::info!("{name}: done"),
                Err(error) => tracing::warn!("{name}: {error}"),
            }
            let answer = TriggerResponse {
                success: done.is_ok(),
                message: done.err().unwrap_or_default(),
            };
            if let Err(error) = server.send_response(request, answer) {
                tracing::warn!("{name}: the answer is not sent: {error}");
            }
        }
    })
}
