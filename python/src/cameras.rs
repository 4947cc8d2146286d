//! The session with a motion capture server: the native half of `singletrack.cameras`, which has the
//! sockets and the clock.

use std::{
    collections::{BTreeMap, btree_map::Entry},
    fs::File,
    io::BufWriter,
    net::{IpAddr, Ipv4Addr, SocketAddr},
    path::PathBuf,
};

use mcap::{Writer, records::MessageHeader};
use pyo3::{exceptions::PyOSError, prelude::*, types::PyBytes};
use singletrack_core::config::{MotionCaptureSection, ServerKind, TransportKind, UpAxis};
use singletrack_mocap::{
    Body, BodyState, DEFAULT_COMMAND_PORT, Input, LocalEnd, NameText, Output, Phase, SessionEvent,
    Source,
    codec::ClientMessage,
    encode,
    qualisys::packet::{DISCOVERY_PORT, discovery},
};

use crate::{fail, refuse};

/// The middle of an exposure with the bound on its error, in ns, and how it was found.
type Exposure = (u64, u64, &'static str);
/// Position (m), orientation as x, y, z, w, and mean error (m).
type Pose = ((f64, f64, f64), (f64, f64, f64, f64), f64);
/// A rigid body: its number and name, the number of its frame, when that arrived (ns), and its pose.
type Seen = (
    i32,
    Option<String>,
    i32,
    u64,
    Option<Exposure>,
    Option<Pose>,
);
/// How many bytes the session used, and the bodies and notes for Python.
type Said = (usize, Vec<Seen>, Vec<String>);

/// A session with a server of any kind, without I/O.
#[pyclass]
pub(crate) struct CameraSession {
    source: Source,
    names: BTreeMap<i32, String>,
}

fn address(key: &str, text: &str) -> PyResult<Ipv4Addr> {
    let example = "write an IPv4 address, such as 192.168.1.10";
    let wrong = |_| refuse(format!("{key} is {text:?}: {example}"));
    text.parse().map_err(wrong)
}

fn word<T>(key: &str, word: &str, named: Option<T>, known: &[&str]) -> PyResult<T> {
    let known = known.join(", ");
    named.ok_or_else(|| refuse(format!("{key} is {word:?}: it is one of {known}")))
}

/// What a rare event means to an operator; none where it is no news.
fn note(event: &SessionEvent) -> Option<String> {
    Some(match event {
        SessionEvent::Refused(version) => version.to_string(),
        SessionEvent::Foreign => {
            "what answers speaks something else: another kind, or port?".into()
        }
        SessionEvent::DatagramsBlocked => {
            "poses come over TCP: none arrive over UDP, which a firewall closes".into()
        }
        SessionEvent::TransportMismatch { server_multicast } => {
            let sent = if *server_multicast {
                "multicast"
            } else {
                "unicast"
            };
            format!("the server sends {sent}: set transport to it")
        }
        SessionEvent::DefinitionsUnreadable(error) => {
            format!("a part of the list of bodies can't be read: {error}")
        }
        SessionEvent::OtherSource(other) => {
            format!("packets come from {other}: a second network card?")
        }
        SessionEvent::Contradicted => "two programs send with the server's address".into(),
        _ => return None,
    })
}

impl CameraSession {
    /// Lets the source act, and returns what it said and how many bytes it used.
    fn act(&mut self, act: impl FnOnce(&mut Source, &mut dyn FnMut(Output<'_>)) -> usize) -> Said {
        let Self { source, names } = self;
        let (mut bodies, mut notes) = (Vec::new(), Vec::new());
        let used = act(source, &mut |output| match output {
            Output::Event(event) => notes.extend(note(&event)),
            Output::Names(all) => {
                names.clear();
                all.for_each(&mut |id, name| {
                    names.insert(id, NameText(name).to_string());
                });
            }
            Output::Frame(frame) => {
                let exposure = frame.capture.map(|capture| {
                    let bound_ns = capture.uncertainty_ns;
                    (capture.time_ns, bound_ns, capture.source.name())
                });
                let (number, receive_ns) = (frame.number, frame.receive_time_ns);
                bodies.extend(frame.bodies().map(|body| {
                    let name = names.get(&body.id).cloned();
                    (body.id, name, number, receive_ns, exposure, pose(&body))
                }));
            }
        });
        (used, bodies, notes)
    }

    /// Takes an input, as [`act`](Self::act) does.
    fn take(&mut self, now_ns: u64, input: Input<'_>) -> Said {
        self.act(|source, on| source.handle_input(now_ns, input, on))
    }
}

/// The pose of a body that is tracked.
const fn pose(body: &Body) -> Option<Pose> {
    let BodyState::Tracked(pose) = body.state else {
        return None;
    };
    let ([x, y, z], [qx, qy, qz, w]) = (pose.position_m, pose.orientation_xyzw);
    Some(((x, y, z), (qx, qy, qz, w), pose.mean_error_m))
}

#[pymethods]
impl CameraSession {
    #[new]
    #[pyo3(signature = (server, *, kind, port, transport, interface, up_axis, group, data_port))]
    #[expect(clippy::too_many_arguments, reason = "keywords of Python")]
    fn new(
        server: &str,
        kind: &str,
        port: Option<u16>,
        transport: &str,
        interface: &str,
        up_axis: Option<&str>,
        group: Option<&str>,
        data_port: Option<u16>,
    ) -> PyResult<Self> {
        let kinds = ServerKind::ALL.map(ServerKind::name);
        let kind = word("kind", kind, ServerKind::named(kind), &kinds)?;
        let up_axis = match up_axis {
            Some(axis) => word("up_axis", axis, UpAxis::named(axis), &["y", "z"])?,
            None if kind == ServerKind::NatNet => UpAxis::Y,
            None => UpAxis::Z,
        };
        let transports = TransportKind::ALL.map(TransportKind::name);
        let named = TransportKind::named(transport);
        let mut section = MotionCaptureSection {
            kind,
            command_port: port,
            transport: word("transport", transport, named, &transports)?,
            interface: address("interface", interface)?,
            ..MotionCaptureSection::new(address("server", server)?, "body", up_axis)
        };
        if let Some(group) = group {
            section.group = address("group", group)?;
        }
        section.data_port = data_port.unwrap_or(section.data_port);
        section.validate().map_err(refuse)?;
        let config = section.session().map_err(refuse)?.session;
        Ok(Self {
            source: Source::new(config, None).map_err(refuse)?,
            names: BTreeMap::new(),
        })
    }

    /// Takes a datagram.
    fn datagram(&mut self, now_ns: u64, source: (String, u16), bytes: &[u8]) -> PyResult<Said> {
        let source = SocketAddr::new(IpAddr::V4(address("source", &source.0)?), source.1);
        Ok(self.take(now_ns, Input::Datagram { source, bytes }))
    }

    /// The stream is open, from this address; datagrams arrive at the port.
    fn opened(&mut self, now_ns: u64, local: &str, datagram_port: u16) -> PyResult<Said> {
        let end = LocalEnd {
            address: IpAddr::V4(address("local", local)?),
            datagram_port,
        };
        Ok(self.take(now_ns, Input::Opened(end)))
    }

    /// Takes all bytes of the stream that were not used; returns how many were now.
    fn received(&mut self, now_ns: u64, bytes: &[u8]) -> Said {
        self.take(now_ns, Input::Stream(bytes))
    }

    /// The stream could not be opened, or has ended.
    fn closed(&mut self, now_ns: u64) -> Said {
        self.take(now_ns, Input::Closed)
    }

    /// Acts on silence.
    fn timeout(&mut self, now_ns: u64) -> Said {
        self.act(|source, on| {
            source.handle_timeout(now_ns, on);
            0
        })
    }

    /// The next bytes to send: whether they go to the stream, where else, and the bytes.
    fn transmit<'py>(
        &mut self,
        py: Python<'py>,
        now_ns: u64,
    ) -> Option<(bool, (String, u16), Bound<'py, PyBytes>)> {
        let transmit = self.source.poll_transmit(now_ns)?;
        let to = transmit.destination;
        let to = (to.ip().to_string(), to.port());
        Some((transmit.on_stream, to, PyBytes::new(py, &transmit.bytes)))
    }

    /// The stream to keep open, and the number of the attempt.
    fn stream(&self) -> Option<((String, u16), u32)> {
        let stream = self.source.stream()?;
        let server = (stream.server.ip().to_string(), stream.server.port());
        Some((server, stream.attempt))
    }

    /// When the session must be called again, in ns.
    fn wake_ns(&self) -> Option<u64> {
        self.source.poll_timeout()
    }

    /// Leaves the server.
    fn close(&mut self) {
        self.source.close();
    }

    /// Whether the server has answered.
    fn answers(&self) -> bool {
        !matches!(self.source.phase(), Phase::Connecting | Phase::Foreign)
    }

    /// Frames taken, lost, late and damaged so far.
    fn counters(&self) -> BTreeMap<&'static str, u64> {
        let counters = self.source.counters();
        BTreeMap::from([
            ("frames", counters.frames),
            ("lost", counters.lost),
            ("late", counters.late + counters.duplicates),
            ("malformed", counters.malformed),
        ])
    }
}

/// The questions for servers: port, kind, and bytes, whose answers go to the port `own`.
#[pyfunction]
pub(crate) fn camera_questions(
    py: Python<'_>,
    own: u16,
) -> PyResult<Vec<(&'static str, u16, Bound<'_, PyBytes>)>> {
    let mut natnet = [0; 64];
    let length = encode::client_message(&ClientMessage::Discovery, &mut natnet).map_err(fail)?;
    let natnet = natnet.get(..length).unwrap_or_default();
    let qualisys = PyBytes::new(py, &discovery(own));
    Ok(vec![
        ("natnet", DEFAULT_COMMAND_PORT, PyBytes::new(py, natnet)),
        ("qualisys", DISCOVERY_PORT, qualisys),
    ])
}

/// The schema that viewers know a pose by, with what is known of its time.
const SCHEMA: &str = r#"{"title":"foxglove.PoseInFrame","type":"object","properties":{
"timestamp":{"type":"object","properties":{"sec":{"type":"integer"},"nsec":{"type":"integer"}}},
"frame_id":{"type":"string"},
"pose":{"type":"object","properties":{
"position":{"type":"object","properties":{"x":{"type":"number"},"y":{"type":"number"},"z":{"type":"number"}}},
"orientation":{"type":"object","properties":{"x":{"type":"number"},"y":{"type":"number"},"z":{"type":"number"},"w":{"type":"number"}}}}},
"mean_error_m":{"type":"number"},"latency_s":{"type":"number"},"uncertainty_s":{"type":"number"}}}"#;

/// Writes poses into an MCAP file, a topic for each body.
#[pyclass]
pub(crate) struct PoseWriter {
    writer: Option<Writer<BufWriter<File>>>,
    schema: u16,
    channels: BTreeMap<String, (u16, u32)>,
}

fn unwritten(error: impl ToString) -> PyErr {
    PyOSError::new_err(error.to_string())
}

#[pymethods]
impl PoseWriter {
    #[new]
    fn new(path: PathBuf) -> PyResult<Self> {
        let named = |error| unwritten(format!("{}: {error}", path.display()));
        let file = File::create_new(&path).map_err(named)?;
        let mut writer = Writer::new(BufWriter::new(file)).map_err(unwritten)?;
        let schema = writer.add_schema("foxglove.PoseInFrame", "jsonschema", SCHEMA.as_bytes());
        Ok(Self {
            schema: schema.map_err(unwritten)?,
            writer: Some(writer),
            channels: BTreeMap::new(),
        })
    }

    /// Adds a message of a body, which was captured and arrived at these times since 1970.
    fn write(&mut self, body: &str, capture_ns: u64, receive_ns: u64, json: &str) -> PyResult<()> {
        let Some(writer) = &mut self.writer else {
            return Err(fail("the file is closed"));
        };
        let (channel_id, sequence) = match self.channels.entry(body.to_owned()) {
            Entry::Occupied(known) => known.into_mut(),
            Entry::Vacant(new) => {
                let topic = format!("/poses/{body}");
                let channel = writer.add_channel(self.schema, &topic, "json", &BTreeMap::new());
                new.insert((channel.map_err(unwritten)?, 0))
            }
        };
        *sequence += 1;
        let header = MessageHeader {
            channel_id: *channel_id,
            sequence: *sequence,
            log_time: receive_ns,
            publish_time: capture_ns,
        };
        writer
            .write_to_known_channel(&header, json.as_bytes())
            .map_err(unwritten)
    }

    /// Completes the file.
    fn close(&mut self) -> PyResult<()> {
        match self.writer.take() {
            Some(mut writer) => writer.finish().map(drop).map_err(unwritten),
            None => Ok(()),
        }
    }
}
