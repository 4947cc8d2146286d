//! The live view of a daemon without board and cameras, through a client of the protocol
//! that Foxglove publishes.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "the helpers of tests may fail as tests do"
)]

use std::{
    collections::BTreeMap,
    io::Read as _,
    net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream},
    time::{Duration, Instant},
};

use serde_json::{Value, json};
use singletrack_core::{Config, config::LiveSection};
use singletrack_pilot::Mode;
use singletrackd::{Daemon, StartError, StartOptions};
use socket2::{Domain, Socket, Type};
use tempfile::TempDir;
use tungstenite::{Message, WebSocket, client::IntoClientRequest};

use crate::common;

fn config(folder: &TempDir) -> Config {
    let mut config = common::config(folder.path());
    config.live = LiveSection {
        enabled: true,
        port: 0,
        ..LiveSection::default()
    };
    config
}

fn start() -> (Daemon, SocketAddr, TempDir) {
    let folder = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(config(&folder), StartOptions::default()).unwrap();
    let address = daemon.snapshot().live.unwrap().address;
    assert!(address.ip().is_loopback());
    (daemon, address, folder)
}

struct Viewer {
    socket: WebSocket<TcpStream>,
    info: Value,
    /// The advertised channels, by topic.
    channels: BTreeMap<String, Value>,
}

impl Viewer {
    fn connect(address: SocketAddr) -> Self {
        Self::on(TcpStream::connect(address).unwrap(), address)
    }

    /// Connects with a small receive buffer: by default the kernel queues some seconds of
    /// messages.
    fn connect_slowly(address: SocketAddr) -> Self {
        let socket = Socket::new(Domain::for_address(address), Type::STREAM, None).unwrap();
        socket.set_recv_buffer_size(4_096).unwrap();
        socket.connect(&address.into()).unwrap();
        Self::on(socket.into(), address)
    }

    fn on(stream: TcpStream, address: SocketAddr) -> Self {
        Self::try_on(stream, address).unwrap()
    }

    /// A viewer, unless the server turns it away.
    fn try_connect(address: SocketAddr) -> Option<Self> {
        Self::try_on(TcpStream::connect(address).unwrap(), address)
    }

    fn try_on(stream: TcpStream, address: SocketAddr) -> Option<Self> {
        stream
            .set_read_timeout(Some(Duration::from_secs(20)))
            .unwrap();
        let mut request = format!("ws://{address}").into_client_request().unwrap();
        request
            .headers_mut()
            .insert("Sec-WebSocket-Protocol", "foxglove.sdk.v1".parse().unwrap());
        let (socket, _) = tungstenite::client(request, stream).ok()?;
        let mut viewer = Self {
            socket,
            info: Value::Null,
            channels: BTreeMap::new(),
        };
        viewer.info = viewer.text("serverInfo");
        let advertised = viewer.text("advertise");
        for channel in advertised["channels"].as_array().unwrap() {
            let topic = channel["topic"].as_str().unwrap().to_owned();
            viewer.channels.insert(topic, channel.clone());
        }
        Some(viewer)
    }

    /// The next text message with this `op`.
    fn text(&mut self, op: &str) -> Value {
        loop {
            if let Message::Text(text) = self.socket.read().unwrap() {
                let message: Value = serde_json::from_str(&text).unwrap();
                if message["op"] == op {
                    return message;
                }
            }
        }
    }

    fn send(&mut self, message: &Value) {
        let message = Message::text(message.to_string());
        self.socket.send(message).unwrap();
    }

    /// Subscribes to topics; the index of a topic is the id of its subscription.
    fn subscribe(&mut self, topics: &[&str]) {
        let subscriptions: Vec<_> = topics
            .iter()
            .enumerate()
            .map(|(id, topic)| json!({"id": id, "channelId": self.channels[*topic]["id"]}))
            .collect();
        self.send(&json!({"op": "subscribe", "subscriptions": subscriptions}));
    }

    /// The next message of a subscription: its id, log time and bytes.
    fn message(&mut self) -> (u32, u64, Vec<u8>) {
        loop {
            let Message::Binary(bytes) = self.socket.read().unwrap() else {
                continue;
            };
            if let [1, rest @ ..] = &bytes[..] {
                let (id, rest) = rest.split_first_chunk().unwrap();
                let (time, bytes) = rest.split_first_chunk().unwrap();
                return (
                    u32::from_le_bytes(*id),
                    u64::from_le_bytes(*time),
                    bytes.to_vec(),
                );
            }
        }
    }
}

#[test]
fn a_viewer_gets_the_messages_of_the_record_byte_for_byte() {
    const TOPICS: [&str; 2] = ["/singletrack/tick", "/singletrack/log"];
    let (daemon, address, _folder) = start();
    let mut viewer = Viewer::connect(address);
    viewer.subscribe(&TOPICS);
    let seen: Vec<_> = (0..30).map(|_| viewer.message()).collect();
    assert_eq!(daemon.snapshot().live.unwrap().viewers, 1);

    let record = daemon.stop().unwrap().record.unwrap();
    let file = std::fs::read(record).unwrap();
    let recorded: Vec<_> = mcap::MessageStream::new(&file)
        .unwrap()
        .map(Result::unwrap)
        .collect();
    assert!(recorded.len() > seen.len());
    for (id, log_time, bytes) in &seen {
        let topic = TOPICS[usize::try_from(*id).unwrap()];
        let same = recorded.iter().any(|message| {
            message.channel.topic == topic
                && message.log_time == *log_time
                && message.data[..] == bytes[..]
        });
        assert!(same, "{topic} at {log_time} is not in the record");
    }
    // The advertised channels and schemas are those of the record, too.
    for message in &recorded {
        let channel = &message.channel;
        let schema = channel.schema.as_ref().unwrap();
        let advertised = &viewer.channels[&channel.topic];
        assert_eq!(advertised["encoding"], channel.message_encoding);
        assert_eq!(advertised["schemaName"], schema.name);
        assert_eq!(advertised["schemaEncoding"], schema.encoding);
        assert_eq!(
            advertised["schema"].as_str().unwrap().as_bytes(),
            &schema.data[..]
        );
    }
}

#[test]
fn a_viewer_can_only_subscribe() {
    let (daemon, address, _folder) = start();
    let mut viewer = Viewer::connect(address);
    assert_eq!(viewer.info["capabilities"], json!([]));
    viewer.send(&json!({"op": "advertise", "channels": [
        {"id": 1, "topic": "/cmd", "encoding": "cdr", "schemaName": "ackermann_msgs/msg/AckermannDriveStamped"}
    ]}));
    viewer.send(
        &json!({"op": "setParameters", "parameters": [{"name": "mode", "value": "driving"}]}),
    );
    for _ in 0..2 {
        // Level 2 is an error.
        assert_eq!(viewer.text("status")["level"], 2);
    }
    assert_eq!(daemon.snapshot().mode(), Mode::Disconnected);
    daemon.stop().unwrap();
}

#[test]
fn viewers_that_never_read_delay_no_other() {
    let (daemon, address, _folder) = start();
    let _idle: Vec<_> = (0..7)
        .map(|_| {
            let mut viewer = Viewer::connect_slowly(address);
            let topics: Vec<_> = viewer.channels.keys().cloned().collect();
            let topics: Vec<_> = topics.iter().map(String::as_str).collect();
            viewer.subscribe(&topics);
            viewer
        })
        .collect();
    let mut viewer = Viewer::connect(address);
    viewer.subscribe(&["/singletrack/tick"]);
    let times: Vec<_> = (0..200).map(|_| viewer.message().1).collect();
    assert!(times.is_sorted());
    let summary = daemon.stop().unwrap();
    assert_eq!(summary.figures.dropped.record_entries, 0);
}

#[test]
fn a_port_in_use_is_named_and_leaves_no_record() {
    let taken = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let mut config = config(&folder);
    config.live.port = taken.local_addr().unwrap().port();
    let error = Daemon::start(config.clone(), StartOptions::default()).unwrap_err();
    assert!(matches!(error, StartError::Live(_)), "{error}");
    let text = error.to_string();
    for part in [
        &taken.local_addr().unwrap().to_string(),
        "live.port",
        "live.enabled = false",
    ] {
        assert!(text.contains(part), "{text}");
    }
    assert!(!config.record.directory.exists());
}

#[test]
fn eight_viewers_are_served_a_ninth_is_turned_away_and_a_free_place_is_taken() {
    let (daemon, address, _folder) = start();
    let mut viewers: Vec<_> = (0..8).map(|_| Viewer::connect(address)).collect();
    let mut ninth = TcpStream::connect(address).unwrap();
    ninth
        .set_read_timeout(Some(Duration::from_secs(20)))
        .unwrap();
    assert_eq!(ninth.read(&mut [0]).unwrap_or(0), 0, "closed");
    for viewer in &mut viewers {
        viewer.subscribe(&["/singletrack/tick"]);
        viewer.message();
    }
    assert_eq!(daemon.snapshot().live.unwrap().viewers, 8);
    viewers.pop();
    // The relay needs a moment to see that the place is free.
    let begin = Instant::now();
    let mut taken = None;
    while taken.is_none() && begin.elapsed() < Duration::from_secs(20) {
        taken = Viewer::try_connect(address);
    }
    let mut taken = taken.unwrap();
    taken.subscribe(&["/singletrack/tick"]);
    taken.message();
}

#[test]
fn a_client_that_says_nothing_does_not_keep_its_place() {
    let (_daemon, address, _folder) = start();
    let silent: Vec<_> = (0..8)
        .map(|_| TcpStream::connect(address).unwrap())
        .collect();
    for mut client in silent {
        client
            .set_read_timeout(Some(Duration::from_secs(20)))
            .unwrap();
        assert_eq!(client.read(&mut [0]).unwrap(), 0, "closed");
    }
    Viewer::connect(address).subscribe(&["/singletrack/tick"]);
}
