//! Takes set-points and passes them on to the daemon; and the services `arm`, `disarm` and `stop`, with
//! the drive that a node of ROS has armed, held by a connection of this process.
//!
//! The daemon's dead-man switch is the connection that holds the drive, not that of the set-points. The
//! controller behind it is watched by the age of its set-points: a drive can only be armed while set-points are passed on, and the
//! daemon stops the car when they end.

use std::{
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};

use futures::{StreamExt as _, executor::block_on};
use ros2_client::qos::{Reliability, WhenFull};
use serde::de::DeserializeOwned;
use singletrack_api::{
    Answer, ClientError, Code, Connection, HeldDrive, Refused, Reply, Request, Setpoint, ask,
};

use crate::{
    message::{Now, TriggerResponse},
    node::{Node, start_thread},
    setpoint::{Arrival, Judge, ignored_of_drive, ignored_of_twist},
    shared::Shared,
};

/// The longest wait for a daemon that does not read set-points.
const PATIENCE: Duration = Duration::from_millis(20);

/// The newest set-point counts, and one that is lost is replaced by the next.
const NEWEST: Reliability = Reliability::BestEffort;

/// A path is sent once.
const ONCE: Reliability = Reliability::Reliable {
    when_full: WhenFull::DEFAULT,
};

pub(crate) fn start(node: &mut Node, shared: &Arc<Shared>) -> Result<(), String> {
    let way = Arc::new(Way {
        judge: Judge {
            max_age: shared.arguments.max_age(),
            frames: shared.arguments.frames.clone(),
        },
        daemon: Mutex::new((None, 1)),
        shared: Arc::clone(shared),
    });
    let twist = ("geometry_msgs", "TwistStamped");
    let topic = ("point_velocity", twist, NEWEST);
    take(node, &way, topic, |way, message, arrival| {
        way.judge.velocity(message, arrival)
    })?;
    let topic = ("cmd_vel", twist, NEWEST);
    take(node, &way, topic, |way, message, arrival| {
        way.shared.warn_once(ignored_of_twist(message));
        let car = way.shared.state().car;
        way.judge.twist(message, car, arrival)
    })?;
    let topic = ("drive", ("ackermann_msgs", "AckermannDriveStamped"), NEWEST);
    take(node, &way, topic, |way, message, arrival| {
        way.shared.warn_once(ignored_of_drive(message));
        way.judge.drive(message, arrival)
    })?;
    let topic = ("path", ("nav_msgs", "Path"), ONCE);
    take(node, &way, topic, |way, message, arrival| {
        way.judge.path(message, arrival)
    })?;
    offer(node, shared)
}

/// Passes the messages of a topic on, on a thread of its own.
fn take<M: DeserializeOwned + Send + 'static>(
    node: &mut Node,
    way: &Arc<Way>,
    (name, kind, reliability): (&'static str, (&str, &str), Reliability),
    judge: fn(&Way, &M, &Arrival) -> Result<Setpoint, Refused>,
) -> Result<(), String> {
    let subscription = node.subscription(name, kind, reliability)?;
    let way = Arc::clone(way);
    start_thread(name, move || {
        let mut messages = Box::pin(subscription.async_stream());
        while let Some(message) = block_on(messages.next()) {
            match message {
                Ok((message, info)) => {
                    let sent = info.source_timestamp();
                    let arrival = Arrival {
                        now: Now::read(),
                        sent: sent.map(|sent| sent.to_nanos().into()),
                    };
                    way.pass(name, judge(&way, &message, &arrival));
                }
                Err(error) => way.warn(&format!("{name}: {error}")),
            }
        }
    })
}

/// The way to the daemon.
struct Way {
    judge: Judge,
    /// The connection, and the number of the next set-point: the lock keeps the numbers in order.
    daemon: Mutex<(Option<Connection>, u32)>,
    shared: Arc<Shared>,
}

impl Way {
    fn pass(&self, name: &str, setpoint: Result<Setpoint, Refused>) {
        let mut setpoint = match setpoint {
            Ok(setpoint) => setpoint,
            Err(Refused { code, text }) => {
                let code = code.name();
                *self.shared.state().counts.refused.entry(code).or_default() += 1;
                self.warn(&format!("{name}: refused: {code}: {text}"));
                return;
            }
        };
        let mut daemon = self.daemon.lock().unwrap_or_else(PoisonError::into_inner);
        let (connection, sequence) = &mut *daemon;
        setpoint.sequence = Some(*sequence);
        *sequence = sequence.wrapping_add(1);
        match self.send(connection, &Request::Setpoint(setpoint)) {
            Ok(()) => {
                let mut state = self.shared.state();
                state.counts.passed += 1;
                state.passed = Some(Instant::now());
            }
            Err(error) => {
                // A line may have been cut: the next set-point begins with a new connection.
                *connection = None;
                self.shared.state().counts.lost += 1;
                self.warn(&format!("{name}: lost: {error}"));
            }
        }
    }

    /// Sends a request, and reads what the daemon has answered to earlier ones.
    fn send(
        &self,
        connection: &mut Option<Connection>,
        request: &Request,
    ) -> Result<(), ClientError> {
        let open = match connection {
            Some(open) => open,
            None => connection.insert(Connection::open(&self.shared.arguments.socket, PATIENCE)?),
        };
        open.send(request)?;
        while let Some(answer) = open.receive()? {
            self.rejected(answer);
        }
        Ok(())
    }

    /// Counts and reports a set-point that the daemon rejected.
    fn rejected(&self, answer: Answer) {
        let code = answer.code.unwrap_or(Code::Other).name();
        let error = answer.error.unwrap_or("without a reason".to_owned());
        let mut state = self.shared.state();
        state.rejected = Some(Instant::now());
        *state.counts.rejected.entry(code).or_default() += 1;
        drop(state);
        self.warn(&format!("the daemon rejects a set-point: {error}"));
    }

    fn warn(&self, text: &str) {
        // Numbers in a reason do not make it another one.
        let reason: String = text.chars().filter(|c| !c.is_ascii_digit()).collect();
        self.shared.warn(&reason, text);
    }
}

/// The longest wait for a line, so that renewals are not late.
const WAIT: Duration = Duration::from_millis(20);

/// The longest wait for a daemon that does not read a request.
const REQUEST_PATIENCE: Duration = Duration::from_millis(200);

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
    let mut drive =
        HeldDrive::arm(socket, REQUEST_PATIENCE, WAIT).map_err(|error| error.to_string())?;
    start_thread("hold", move || {
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
fn offer(node: &mut Node, shared: &Arc<Shared>) -> Result<(), String> {
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
    start_thread(name, move || {
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
