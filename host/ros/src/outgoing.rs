//! Publishes the messages of the record, as the daemon encodes them, and the counts of this program once a
//! second, beside the daemon's diagnostics.

use std::{collections::BTreeMap, sync::Arc, thread, time::Duration};

use ros2_client::{Publisher, WriteError};
use singletrack_api::{ClientError, Clocks, MessageStream, Received, Request, ask_within};

use crate::{
    frames::Encoded,
    message::{DiagnosticArray, DiagnosticStatus, Header, Now, Text, Time},
    node::{Node, latched, prompt, start_thread},
    shared::{Arguments, Car, Counts, Shared},
};

/// The topics of the record, each with its type. The node's has the same name, with `_` within it; there is
/// one log for all nodes.
const TOPICS: [(&str, (&str, &str)); 9] = [
    ("/odom", ("nav_msgs", "Odometry")),
    ("/tf", ("tf2_msgs", "TFMessage")),
    ("/imu", ("sensor_msgs", "Imu")),
    ("/diagnostics", ("diagnostic_msgs", "DiagnosticArray")),
    ("/point_p", ("geometry_msgs", "PointStamped")),
    ("/reference", ("geometry_msgs", "PointStamped")),
    ("/mocap/pose", ("geometry_msgs", "PoseStamped")),
    ("/cmd", ("ackermann_msgs", "AckermannDriveStamped")),
    ("/rosout", ("rcl_interfaces", "Log")),
];

/// The topic of the record on which a change of the configuration is seen.
const CONFIGURATION: &str = "/singletrack/configuration";

/// A daemon that is silent for so long hangs: there are 100 ticks a second.
const SILENCE: Duration = Duration::from_secs(2);

/// The pause before the next try to reach the daemon.
const PAUSE: Duration = Duration::from_millis(500);

/// The clocks of stamps and of this computer may differ by this, in s.
const CLOCK_STEP: f64 = 0.02;

pub(crate) fn start(node: &mut Node, shared: &Arc<Shared>) -> Result<(), String> {
    let mut publishers = BTreeMap::new();
    for (channel, kind) in TOPICS {
        let own = channel.trim_start_matches('/').replace('/', "_");
        let topic = if channel == "/rosout" { channel } else { &own };
        publishers.insert(channel, (kind.1, node.publisher(topic, kind, prompt())?));
    }
    let outgoing = Outgoing {
        publishers,
        description: node.publisher("robot_description", ("std_msgs", "String"), latched())?,
        shared: Arc::clone(shared),
    };
    start_thread("outgoing", move || outgoing.run())
}

struct Outgoing {
    /// The publishers by the topic of the record, each with its type.
    publishers: BTreeMap<&'static str, (&'static str, Publisher<Encoded>)>,
    description: Publisher<Text>,
    shared: Arc<Shared>,
}

impl Outgoing {
    fn run(&self) {
        loop {
            let Err(error) = self.publish();
            let reason = error.to_string();
            let text = format!("nothing is published: {reason}");
            self.shared.warn(&reason, &text);
            thread::sleep(PAUSE);
        }
    }

    /// Publishes until the daemon is lost.
    fn publish(&self) -> Result<core::convert::Infallible, ClientError> {
        let own = self.publishers.keys().copied();
        let topics: Vec<_> = own.chain([CONFIGURATION]).collect();
        let mut stream = MessageStream::open(&self.shared.arguments.socket, &topics, SILENCE)?;
        tracing::info!("connected to the daemon");
        warn_of_clocks(stream.clocks);
        self.describe()?;
        loop {
            match stream.receive()? {
                Received::Missed(count) => self.shared.state().counts.missed += count,
                Received::Message(message) if message.topic == CONFIGURATION => self.describe()?,
                Received::Message(message) => {
                    let Some((kind, publisher)) = self.publishers.get(message.topic) else {
                        continue;
                    };
                    let Some(encoded) = self.shared.arguments.frames.encode(kind, message.bytes)
                    else {
                        continue;
                    };
                    match publisher.publish(encoded) {
                        Ok(()) => {}
                        Err(WriteError::WouldBlock { .. }) => {
                            self.shared.state().counts.held_up += 1;
                        }
                        Err(error) => {
                            let error = error.to_string();
                            let text = format!("{}: {error}", message.topic);
                            self.shared.warn(&error, &text);
                        }
                    }
                }
            }
        }
    }

    /// Publishes the car of the configuration in force.
    fn describe(&self) -> Result<(), ClientError> {
        let Arguments { socket, frames, .. } = &self.shared.arguments;
        let answer = ask_within(&Request::Configuration {}, socket, SILENCE)?;
        let Some(car) = answer.toml.as_deref().and_then(Car::of) else {
            tracing::warn!("the daemon's configuration has no axles: cmd_vel is refused");
            return Ok(());
        };
        self.shared.state().car = Some(car);
        let data = car.urdf(&frames.base);
        if let Err(error) = self.description.publish(Text { data }) {
            tracing::warn!("robot_description: {error}");
        }
        Ok(())
    }
}

/// Stamps follow the wall clock as it was when the daemon's record began.
fn warn_of_clocks(clocks: Clocks) {
    let then = Now {
        monotonic: clocks.monotonic_ns.into(),
        wall: clocks.wall_ns.into(),
    };
    let step = Now::read().wall_step_s(then);
    if step.abs() > CLOCK_STEP {
        tracing::warn!(
            "the clock was set by {step:.3} s since the daemon was started: the stamps of what is \
             published are off by this; restart the daemon"
        );
    }
}

const INTERVAL: Duration = Duration::from_secs(1);

/// Levels of `diagnostic_msgs/msg/DiagnosticStatus`.
const OK: u8 = 0;
const WARN: u8 = 1;

pub(crate) fn start_diagnostics(node: &mut Node, shared: &Arc<Shared>) -> Result<(), String> {
    let kind = ("diagnostic_msgs", "DiagnosticArray");
    let publisher = node.publisher("diagnostics", kind, prompt())?;
    let shared = Arc::clone(shared);
    start_thread("diagnostics", move || {
        let mut before = 0;
        loop {
            thread::sleep(INTERVAL);
            let counts = shared.state().counts.clone();
            let codes = counts.refused.values().chain(counts.rejected.values());
            let refused = codes.sum();
            let level = if refused > before { WARN } else { OK };
            before = refused;
            // A slow subscriber sees the next one.
            let _ = publisher.publish(report(&counts, level, Now::read()));
        }
    })
}

fn report(counts: &Counts, level: u8, now: Now) -> DiagnosticArray {
    let message = match level {
        OK => "set-points pass",
        _ => "set-points are refused",
    };
    DiagnosticArray {
        header: Header {
            stamp: Time::from_ns(now.wall),
            frame_id: String::new(),
        },
        status: vec![DiagnosticStatus {
            level,
            name: "singletrack-ros",
            message: message.to_owned(),
            hardware_id: "",
            values: vec![
                ("set-points passed on", counts.passed.to_string()),
                ("set-points refused", by_code(&counts.refused)),
                (
                    "set-points rejected by the daemon",
                    by_code(&counts.rejected),
                ),
                ("set-points lost", counts.lost.to_string()),
                ("entries missed", counts.missed.to_string()),
                ("messages held up", counts.held_up.to_string()),
            ],
        }],
    }
}

/// Codes with how often each came.
fn by_code(counts: &BTreeMap<&str, u64>) -> String {
    let codes = counts.iter().map(|(code, count)| format!("{code} {count}"));
    codes.collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
#[allow(clippy::indexing_slicing, reason = "a test may fail")]
mod tests {
    use singletrack_record::StandardTopic;

    use super::*;

    #[test]
    fn every_topic_of_the_record_with_a_type_of_ros_is_published_with_this_type() {
        assert_eq!(TOPICS.len(), StandardTopic::ALL.len());
        for (channel, (package, kind)) in TOPICS {
            let standard = StandardTopic::ALL
                .into_iter()
                .find(|standard| standard.channel() == channel);
            let name = standard.map(StandardTopic::schema_name);
            assert_eq!(name, Some(format!("{package}/msg/{kind}")), "{channel}");
        }
    }

    #[test]
    fn every_reason_is_reported_with_its_count() {
        let mut counts = Counts::default();
        counts.refused.insert("old", 3);
        counts.refused.insert("invalid", 1);
        let now = Now {
            monotonic: 0,
            wall: 1_500_000_000,
        };
        let report = report(&counts, WARN, now);
        assert_eq!(
            report.header.stamp,
            Time {
                sec: 1,
                nanosec: 500_000_000
            }
        );
        assert_eq!(report.status[0].values[1].1, "invalid 1, old 3");
    }
}
