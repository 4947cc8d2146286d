//! Takes set-points and passes them on to the daemon.

use std::{
    path::PathBuf,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicU32, Ordering},
    },
    time::Duration,
};

use futures::{StreamExt as _, executor::block_on};
use ros2_client::qos::{Reliability, WhenFull};
use serde::de::DeserializeOwned;
use singletrack_api::{Answer, ClientError, Code, Connection, Refused, Request, Setpoint};

use crate::{
    arguments::Arguments,
    attendance::Attendance,
    car::SharedCar,
    clocks::Now,
    node::{Node, start as start_thread},
    setpoint::{Arrival, Judge, ignored_of_drive, ignored_of_twist},
    tally::Tally,
};

/// The longest wait for a daemon that does not read.
const PATIENCE: Duration = Duration::from_millis(20);

/// The newest set-point counts, and one that is lost is replaced by the next.
const NEWEST: Reliability = Reliability::BestEffort;

/// A path is sent once.
const ONCE: Reliability = Reliability::Reliable {
    when_full: WhenFull::DEFAULT,
};

pub(crate) fn start(
    node: &mut Node,
    arguments: &Arguments,
    car: &SharedCar,
    attendance: &Attendance,
    tally: &Arc<Tally>,
) -> Result<(), String> {
    let way = Arc::new(Way {
        judge: Judge {
            max_age: arguments.max_age(),
            frames: arguments.frames.clone(),
        },
        car: car.clone(),
        socket: arguments.socket.clone(),
        connection: Mutex::new(None),
        sequence: AtomicU32::new(1),
        attendance: attendance.clone(),
        tally: Arc::clone(tally),
    });
    let twist = ("geometry_msgs", "TwistStamped");
    let topic = ("point_velocity", twist, NEWEST);
    take(node, &way, topic, |way, message, arrival| {
        way.judge.velocity(message, arrival)
    })?;
    let topic = ("cmd_vel", twist, NEWEST);
    take(node, &way, topic, |way, message, arrival| {
        ignored_of_twist(message).for_each(|text| way.tally.warn_once(text));
        way.judge.twist(message, way.car.get(), arrival)
    })?;
    let topic = ("drive", ("ackermann_msgs", "AckermannDriveStamped"), NEWEST);
    take(node, &way, topic, |way, message, arrival| {
        ignored_of_drive(message).for_each(|text| way.tally.warn_once(text));
        way.judge.drive(message, arrival)
    })?;
    let topic = ("path", ("nav_msgs", "Path"), ONCE);
    take(node, &way, topic, |way, message, arrival| {
        way.judge.path(message, arrival)
    })
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
    car: SharedCar,
    socket: PathBuf,
    connection: Mutex<Option<Connection>>,
    /// The number of the next set-point.
    sequence: AtomicU32,
    attendance: Attendance,
    tally: Arc<Tally>,
}

impl Way {
    fn pass(&self, name: &str, setpoint: Result<Setpoint, Refused>) {
        let mut setpoint = match setpoint {
            Ok(setpoint) => setpoint,
            Err(Refused { code, text }) => {
                let code = code.name();
                *self.tally.lock().refused.entry(code).or_default() += 1;
                self.warn(&format!("{name}: refused: {code}: {text}"));
                return;
            }
        };
        let mut connection = self
            .connection
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        // The lock keeps the numbers in order.
        setpoint.sequence = Some(self.sequence.fetch_add(1, Ordering::Relaxed));
        match self.send(&mut connection, &Request::Setpoint(setpoint)) {
            Ok(()) => {
                self.tally.lock().passed += 1;
                self.attendance.passed();
            }
            Err(error) => {
                // A line may have been cut: the next set-point begins with a new connection.
                *connection = None;
                self.tally.lock().lost += 1;
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
            None => connection.insert(Connection::open(&self.socket, PATIENCE)?),
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
        self.attendance.rejected();
        let error = answer
            .error
            .unwrap_or_else(|| "without a reason".to_owned());
        *self.tally.lock().rejected.entry(code).or_default() += 1;
        self.warn(&format!("the daemon rejects a set-point: {error}"));
    }

    fn warn(&self, text: &str) {
        // Numbers in a reason do not make it another one.
        let reason: String = text.chars().filter(|c| !c.is_ascii_digit()).collect();
        self.tally.warn(&reason, text);
    }
}
