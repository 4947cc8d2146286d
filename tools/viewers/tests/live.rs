//! The live view, through a client of the protocol that Foxglove publishes.

use std::{
    collections::BTreeMap,
    io::{Read as _, Write as _},
    net::{Ipv4Addr, Ipv6Addr, SocketAddr, TcpListener, TcpStream},
    time::Duration,
};

use serde_json::{Value, json};
use singletrack_core::config::LiveSection;
use singletrack_pilot::Mode;
use singletrack_viewers::live::Live;
use singletrackd::{Daemon, StartOptions};
use socket2::{Domain, Socket, Type};
use tempfile::TempDir;
use tungstenite::{Message, WebSocket, client::IntoClientRequest};

use crate::common;

/// A live view for the daemon of this folder.
fn live(folder: &TempDir) -> Live {
    let section = LiveSection {
        port: 0,
        ..LiveSection::default()
    };
    let live = Live::start(folder.path().join("control.sock"), section).unwrap();
    assert!(live.address.ip().is_loopback());
    live
}

fn daemon(folder: &TempDir) -> Daemon {
    Daemon::start(common::config(folder.path()), StartOptions::default()).unwrap()
}

/// A daemon and its live view.
fn start() -> (Daemon, Live, TempDir) {
    let folder = tempfile::tempdir().unwrap();
    let daemon = daemon(&folder);
    let live = live(&folder);
    (daemon, live, folder)
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
        stream
            .set_read_timeout(Some(Duration::from_secs(20)))
            .unwrap();
        let mut request = format!("ws://{address}").into_client_request().unwrap();
        request
            .headers_mut()
            .insert("Sec-WebSocket-Protocol", "foxglove.sdk.v1".parse().unwrap());
        let (socket, _) = tungstenite::client(request, stream).unwrap();
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
        viewer
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
fn a_viewer_of_the_old_protocol_alone_is_turned_away() {
    let folder = tempfile::tempdir().unwrap();
    let live = live(&folder);
    let answer = |protocols: &str| {
        let mut viewer = TcpStream::connect(live.address).unwrap();
        viewer
            .set_read_timeout(Some(Duration::from_secs(20)))
            .unwrap();
        let request = format!(
            "GET / HTTP/1.1\r\nHost: car\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
             Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\
             Sec-WebSocket-Protocol: {protocols}\r\n\r\n"
        );
        viewer.write_all(request.as_bytes()).unwrap();
        let mut answer = [0; 400];
        let length = viewer.read(&mut answer).unwrap();
        String::from_utf8_lossy(&answer[..length]).into_owned()
    };
    let old = answer("foxglove.websocket.v1");
    assert!(old.starts_with("HTTP/1.1 400 "), "{old}");
    let both = answer("foxglove.websocket.v1, foxglove.sdk.v1");
    assert!(both.starts_with("HTTP/1.1 101 "), "{both}");
}

#[test]
fn a_viewer_gets_the_messages_of_the_record_byte_for_byte() {
    const TOPICS: [&str; 2] = ["/singletrack/tick", "/singletrack/log"];
    let (daemon, live, _folder) = start();
    let address = live.address;
    let mut viewer = Viewer::connect(address);
    viewer.subscribe(&TOPICS);
    let seen: Vec<_> = (0..30).map(|_| viewer.message()).collect();

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
    let (daemon, live, _folder) = start();
    let address = live.address;
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
    let (daemon, live, _folder) = start();
    let address = live.address;
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
fn a_port_in_use_is_named() {
    let taken = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    let section = LiveSection {
        port: taken.local_addr().unwrap().port(),
        ..LiveSection::default()
    };
    let error = Live::start("/nowhere.sock".into(), section).unwrap_err();
    for part in [
        "can't listen",
        &taken.local_addr().unwrap().to_string(),
        "live.port",
    ] {
        assert!(error.contains(part), "{error}");
    }
}

#[test]
fn an_address_that_other_computers_reach_is_refused() {
    let section = LiveSection {
        address: Ipv4Addr::UNSPECIFIED.into(),
        ..LiveSection::default()
    };
    let error = Live::start("/nowhere.sock".into(), section).unwrap_err();
    for part in ["0.0.0.0", "live.address", "ssh -L"] {
        assert!(error.contains(part), "{error}");
    }
}

#[test]
fn the_other_loopback_is_served_too() {
    let section = LiveSection {
        address: Ipv6Addr::LOCALHOST.into(),
        port: 0,
    };
    let live = Live::start("/nowhere.sock".into(), section).unwrap();
    Viewer::connect(live.address);
}

#[test]
fn a_daemon_that_restarts_is_found_again_and_its_end_is_shown() {
    let folder = tempfile::tempdir().unwrap();
    let live = live(&folder);
    let mut viewer = Viewer::connect(live.address);
    viewer.subscribe(&["/singletrack/tick"]);
    let mut last = 0;
    for _ in 0..2 {
        let lost = viewer.text("status");
        assert_eq!((&lost["level"], &lost["id"]), (&json!(1), &json!("daemon")));
        let why = lost["message"].as_str().unwrap();
        assert!(why.starts_with("no daemon: "), "{why}");
        let daemon = daemon(&folder);
        assert_eq!(viewer.text("removeStatus")["statusIds"], json!(["daemon"]));
        let (_, time, _) = viewer.message();
        assert!(time > last);
        last = time;
        daemon.stop().unwrap();
    }
}

#[test]
fn a_viewer_that_sends_without_end_is_disconnected() {
    let (_daemon, live, _folder) = start();
    let mut viewer = Viewer::connect(live.address);
    // A message that is never whole, of 2^40 bytes.
    let mut head = vec![0x82, 0xff];
    head.extend((1_u64 << 40).to_be_bytes());
    head.extend([0; 4]);
    let stream = viewer.socket.get_mut();
    stream.write_all(&head).unwrap();
    let part = [0; 65_536];
    let sent = (0..1_000).take_while(|_| stream.write_all(&part).is_ok());
    let sent = sent.count() * part.len();
    assert!(sent < 16 << 20, "{sent} bytes were taken");
}
