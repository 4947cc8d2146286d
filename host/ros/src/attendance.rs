//! The drive that a node of ROS has armed, held by a connection of this process; the services
//! `arm`, `disarm` and `stop`.
//!
//! The daemon's dead-man switch is this connection. The controller behind it is watched by the
//! age of its set-points: a drive can only be armed while set-points are passed on, and the
//! daemon stops the car when they end.

use std::{
    path::PathBuf,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use futures::executor::block_on;
use singletrack_api::{ClientError, HeldDrive, Reply, Request, ask};

use crate::{
    message::TriggerResponse,
    node::{Node, start},
};

/// The longest wait for a line, so that renewals are not late.
const WAIT: Duration = Duration::from_millis(20);

/// The longest wait for a daemon that does not read.
const PATIENCE: Duration = Duration::from_millis(200);

/// The last set-point before an arm may be this old.
const ATTENDED: Duration = Duration::from_millis(500);

/// Arms, disarms and stops.
#[derive(Clone, Debug)]
pub(crate) struct Attendance {
    socket: PathBuf,
    state: Arc<Mutex<State>>,
}

#[derive(Debug, Default)]
struct State {
    /// When a set-point was passed on, and when the daemon rejected one.
    passed: Option<Instant>,
    rejected: Option<Instant>,
    /// A drive of this process is being armed, or driven.
    is_held: bool,
}

impl State {
    /// Why no drive may be armed now.
    fn refusal(&self, now: Instant) -> Option<&'static str> {
        let recent =
            |time: Option<Instant>| time.is_some_and(|time| now.duration_since(time) <= ATTENDED);
        if self.is_held {
            return Some("a drive of this node is under way");
        }
        if !recent(self.passed) {
            return Some(
                "no set-points come: send them to drive, cmd_vel, point_velocity or path first, then \
                 arm",
            );
        }
        if recent(self.rejected) {
            return Some(
                "the daemon rejects the set-points (see /diagnostics); is reference.kind \
                 \"external\"?",
            );
        }
        None
    }
}

impl Attendance {
    pub(crate) fn new(socket: PathBuf) -> Self {
        Self {
            socket,
            state: Arc::default(),
        }
    }

    /// A set-point was passed on to the daemon.
    pub(crate) fn passed(&self) {
        self.state().passed = Some(Instant::now());
    }

    /// The daemon rejected a set-point.
    pub(crate) fn rejected(&self) {
        self.state().rejected = Some(Instant::now());
    }

    /// Arms a drive, and holds it until it ends. Returns once the car drives.
    pub(crate) fn arm(&self) -> Result<(), String> {
        {
            let mut state = self.state();
            if let Some(refusal) = state.refusal(Instant::now()) {
                return Err(format!("can't arm: {refusal}"));
            }
            state.is_held = true;
        }
        let held = Held(self.clone());
        let mut drive =
            HeldDrive::arm(&self.socket, PATIENCE, WAIT).map_err(|error| error.to_string())?;
        start("hold", move || {
            let ended = hold(&mut drive);
            drop(held);
            match ended {
                Ok(ended) => tracing::info!("the drive has ended: {ended}"),
                Err(error) => tracing::warn!("the drive has ended: {error}"),
            }
        })
    }

    /// Slows the car down and stops it.
    pub(crate) fn disarm(&self) -> Result<(), String> {
        self.tell(&Request::DISARM)
    }

    /// Stops the car at once, until the board is reset.
    pub(crate) fn stop(&self) -> Result<(), String> {
        self.tell(&Request::Stop {})
    }

    /// Disarms a drive of this process.
    pub(crate) fn end(&self) {
        if self.state().is_held
            && let Err(error) = self.disarm()
        {
            tracing::warn!("{error}");
        }
    }

    fn tell(&self, request: &Request) -> Result<(), String> {
        ask(request, &self.socket)
            .map(drop)
            .map_err(|error| error.to_string())
    }

    fn state(&self) -> MutexGuard<'_, State> {
        // The state holds no invariant that a panic could break.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A drive is held for as long as this lives.
struct Held(Attendance);

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
pub(crate) fn offer(node: &mut Node, attendance: &Attendance) -> Result<(), String> {
    serve(node, "arm", attendance, Attendance::arm)?;
    serve(node, "disarm", attendance, Attendance::disarm)?;
    serve(node, "stop", attendance, Attendance::stop)
}

fn serve(
    node: &mut Node,
    name: &'static str,
    attendance: &Attendance,
    obey: impl Fn(&Attendance) -> Result<(), String> + Send + 'static,
) -> Result<(), String> {
    let server = node.trigger(name)?;
    let attendance = attendance.clone();
    start(name, move || {
        loop {
            let request = match block_on(server.async_receive_request()) {
                Ok((request, _)) => request,
                Err(error) => {
                    tracing::warn!("{name}: {error}");
                    continue;
                }
            };
            let done = obey(&attendance);
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_drive_is_armed_only_while_set_points_come_and_are_taken() {
        let now = Instant::now() + Duration::from_secs(10);
        let ago = |ms| Some(now - Duration::from_millis(ms));
        let refusal = |passed, rejected, is_held| {
            let state = State {
                passed,
                rejected,
                is_held,
            };
            state.refusal(now).unwrap_or("none").to_owned()
        };
        assert_eq!(refusal(ago(10), None, false), "none");
        assert_eq!(refusal(ago(10), ago(501), false), "none");
        assert!(refusal(ago(10), ago(10), false).contains("rejects"));
        assert!(refusal(ago(501), None, false).contains("no set-points"));
        assert!(refusal(None, None, false).contains("no set-points"));
        assert!(refusal(ago(10), None, true).contains("under way"));
    }
}
