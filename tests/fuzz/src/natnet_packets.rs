//! Fuzz target: datagrams to the motion capture client.

use core::{
    f64::consts::PI,
    net::{IpAddr, Ipv4Addr, SocketAddr},
    num::NonZeroU64,
};

use singletrack_mocap::{
    Binding, Input, Phase, Transport, UpAxis,
    codec::{
        BitstreamVersion, CameraTicks, ClientMessage, Connection, DataChannel, Echo, FrameFlags,
        RigidBody, RigidBodyDefinition, ServerInfo, ServerMessage,
    },
    encode::{self, Dataset, EncodeError, FrameContent},
    planar::{Observation, PlanarConfig, PlanarEvent, PlanarPose, PlanarSession, PoseState},
};

use crate::choices::Choices;

const MS: u64 = 1_000_000;
const CAR: i32 = 7;
const TICKS_PER_SECOND: u64 = 10_000_000;

const SERVER: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::new(192, 168, 1, 10)), 1510);
const STRANGER: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::new(192, 168, 1, 66)), 1510);

/// Largest number of datagrams that the session sends at one time: an echo, a
/// request for the models, a keep-alive, and the greeting after a silence.
const TRANSMITS: usize = 4;

/// The most events of one call: the stream is stale, the body's id is forgotten, the
/// session starts over; and one to spare.
const EVENTS: usize = 4;

const VERSIONS: [(u8, u8); 9] = [
    (2, 7),
    (2, 9),
    (2, 11),
    (3, 0),
    (3, 1),
    (4, 0),
    (4, 1),
    (4, 2),
    (4, 4),
];

// No room for a heap: what a session needs, it has from the start.
const _: () = assert!(size_of::<PlanarSession>() <= 12_288);

/// Runs the motion capture session on datagrams from the server and from other
/// addresses, at any time.
///
/// The first bytes select the server's version, the configuration of the session
/// and its initial state.
///
/// # Panics
///
/// If an accepted pose is not finite, out of range, captured after its reception or
/// before the last one, of another body, not tracked, or farther from the last one
/// than the body can move; if an accepted frame is not newer than the last one, or
/// precedes the greeting; if a datagram from another address changes anything
/// except its counter; if the session sends bytes that are not a message, to
/// another address, or without bound; if it requests a wake-up in the past; if the
/// counters are inconsistent.
///
/// Returns the number of datagrams passed to the session.
pub fn natnet_packets(data: &[u8]) -> u64 {
    let mut choices = Choices::new(data);
    let mut bench = Bench::at_stage(&mut choices);
    while !choices.is_empty() {
        bench.step(&mut choices);
    }
    bench.datagrams
}

struct Bench {
    session: PlanarSession,
    now_ns: u64,
    version: BitstreamVersion,
    /// Ticks of the server at local time zero.
    ticks_at_zero: u64,
    number: i32,
    x_m: f32,
    echo_stamp: u64,
    last_valid: Option<PlanarPose>,
    /// A buffer for datagrams, as large as they get.
    buffer: Vec<u8>,
    /// Number of datagrams passed to the session.
    datagrams: u64,
}

impl Bench {
    fn at_stage(choices: &mut Choices<'_>) -> Self {
        let options = choices.byte();
        let stage = options & 3;
        let is = |bit: u8| options & (1 << bit) != 0;
        let (major, minor) = choices.one_of(VERSIONS);
        let version = BitstreamVersion::new(major, minor).expect("all of these are supported");
        let transport = if is(2) {
            Transport::Multicast
        } else {
            Transport::Unicast {
                bitstream: is(3).then_some(BitstreamVersion::V4_1),
            }
        };
        let up_axis = if is(4) { UpAxis::Y } else { UpAxis::Z };
        let config = PlanarConfig::new(SERVER.ip(), transport, "car", up_axis)
            .expect("the configuration is a good one");
        let mut bench = Self {
            session: PlanarSession::new(config).expect("the configuration is a good one"),
            now_ns: 1_000_000 * MS,
            version,
            ticks_at_zero: if is(5) {
                u64::MAX - 10
            } else {
                50 * TICKS_PER_SECOND
            },
            number: 100,
            x_m: 0.0,
            echo_stamp: 0,
            last_valid: None,
            buffer: vec![0; 65_536],
            datagrams: 0,
        };
        bench.settle();
        if stage >= 1 {
            bench.inform(Some(TICKS_PER_SECOND), is(2));
            if matches!(bench.session.source().phase(), Phase::Negotiating(_)) {
                bench.send(|out| encode::response_status(0, out));
                bench.version = BitstreamVersion::V4_1;
            }
            bench.answer_echo(0);
        }
        if stage >= 2 {
            bench.define(&[("other", 3), ("car", CAR)]);
        }
        if stage >= 3 {
            for _ in 0..3 {
                bench.drive_on();
            }
        }
        bench
    }

    fn step(&mut self, choices: &mut Choices<'_>) {
        let operation = choices.byte();
        // A quarter of all datagrams also comes from another address.
        if operation & 0xC0 == 0xC0 {
            self.receive_from_stranger(operation, choices);
            return;
        }
        match operation % 20 {
            0 => self.receive(SERVER, choices.bytes()),
            1 => {
                let id = choices.byte();
                let datagram = with_header(id.into(), choices.bytes());
                self.receive(SERVER, &datagram);
            }
            2 => {
                let id = choices.u16();
                let datagram = with_header(id, choices.rest());
                self.receive(SERVER, &datagram);
            }
            3 => {
                let (major, minor) = if choices.flag() {
                    choices.one_of(VERSIONS)
                } else {
                    (choices.byte(), choices.byte())
                };
                if let Ok(version) = BitstreamVersion::new(major, minor) {
                    self.version = version;
                }
                let ticks_per_second = match choices.byte() % 4 {
                    0 => None,
                    1 => Some(choices.u64()),
                    2 if major < 3 => None,
                    _ => Some(TICKS_PER_SECOND),
                };
                let multicast = choices.flag();
                self.inform_as([major, minor, 0, 0], ticks_per_second, multicast);
            }
            4 => {
                let status = choices.one_of([0, 1, -1]);
                self.send(|out| encode::response_status(status, out));
            }
            5 => self.send(encode::unrecognized),
            6 => match choices.byte() % 4 {
                0 => self.define(&[]),
                1 => self.define(&[("car", choices.i32())]),
                2 => self.define(&[("car", CAR), ("car", choices.i32())]),
                _ => self.define(&[("other", CAR), ("car", CAR)]),
            },
            7..=9 => {
                for _ in 0..choices.byte() % 16 {
                    self.drive_on();
                }
            }
            10 => {
                let body = self.car(choices.f32(), choices.f32());
                self.frame(&[body], 1, FrameFlags::default());
            }
            11 => {
                let bodies = [(); 3].map(|()| any_body(choices));
                let count = usize::from(choices.byte() % 4);
                let step = choices.byte().cast_signed().into();
                let flags = FrameFlags(choices.byte().into());
                self.frame(bodies.get(..count).unwrap_or_default(), step, flags);
            }
            // A valid frame with some bytes changed, or truncated.
            12 | 13 => {
                let mut datagram = self.nominal_frame();
                for _ in 0..choices.byte() % 8 {
                    let at = usize::from(choices.u16()) % datagram.len();
                    if let Some(byte) = datagram.get_mut(at) {
                        *byte = choices.byte();
                    }
                }
                if choices.byte() & 7 == 7 {
                    datagram.truncate(choices.u16().into());
                }
                self.receive(SERVER, &datagram);
            }
            14 => self.answer_echo(choices.i16().into()),
            15 => {
                let server_ticks = choices.u64();
                let client_stamp = if choices.flag() {
                    self.echo_stamp
                } else {
                    choices.u64()
                };
                let echo = Echo {
                    client_stamp,
                    server_ticks,
                };
                self.send(|out| encode::echo_response(echo, out));
            }
            16 => self.pass(u64::from(choices.u16()) * 1_000),
            17 => self.pass(u64::from(choices.u16()) * MS),
            18 => {
                // The server's clock steps.
                self.ticks_at_zero = self.ticks_at_zero.wrapping_add(choices.u64());
                self.number = choices.i32();
            }
            _ => self.send(encode::disconnect),
        }
    }

    fn car(&self, x_m: f32, y_m: f32) -> RigidBody {
        // Upright whichever axis is up: the quaternion of no rotation.
        match self.session.config().session.up_axis {
            UpAxis::Z => RigidBody::tracked(CAR, [x_m, y_m, 0.05], [0.0, 0.0, 0.0, 1.0]),
            UpAxis::Y => RigidBody::tracked(CAR, [x_m, 0.05, -y_m], [0.0, 0.0, 0.0, 1.0]),
        }
    }

    fn ticks_at(&self, local_ns: u64) -> u64 {
        self.ticks_at_zero
            .wrapping_add(local_ns / (1_000_000_000 / TICKS_PER_SECOND))
    }

    fn encode_frame(&mut self, bodies: &[RigidBody], step: i32, flags: FrameFlags) -> Vec<u8> {
        self.number = self.number.wrapping_add(step);
        let capture_ns = self.now_ns - 8 * MS;
        let transmit = self.ticks_at(self.now_ns - 100_000);
        let content = FrameContent {
            number: self.number,
            rigid_bodies: bodies,
            timestamp_s: capture_ns as f64 * 1e-9,
            ticks: CameraTicks {
                mid_exposure: self.ticks_at(capture_ns),
                received: transmit,
                transmit,
            },
            flags,
            ..FrameContent::default()
        };
        self.encode(|version, out| encode::frame(version, &content, out))
    }

    fn nominal_frame(&mut self) -> Vec<u8> {
        let body = self.car(self.x_m, 0.0);
        self.encode_frame(&[body], 1, FrameFlags::default())
    }

    fn frame(&mut self, bodies: &[RigidBody], step: i32, flags: FrameFlags) {
        let datagram = self.encode_frame(bodies, step, flags);
        self.receive(SERVER, &datagram);
    }

    /// Moves for 10 ms at 0.5 m/s, and sends a frame.
    fn drive_on(&mut self) {
        self.pass(10 * MS);
        self.x_m += 0.005;
        let datagram = self.nominal_frame();
        self.receive(SERVER, &datagram);
    }

    fn inform(&mut self, ticks_per_second: Option<u64>, multicast: bool) {
        self.inform_as(self.version.to_wire(), ticks_per_second, multicast);
    }

    fn inform_as(&mut self, version: [u8; 4], ticks_per_second: Option<u64>, multicast: bool) {
        let connection = (version[0] >= 3).then_some(Connection {
            ticks_per_second: ticks_per_second.and_then(NonZeroU64::new),
            data_channel: DataChannel {
                port: 1511,
                multicast,
                group: Ipv4Addr::new(239, 255, 42, 99),
            },
        });
        let info = ServerInfo {
            application: "Fuzz",
            application_version: [1, 0, 0, 0],
            natnet_version: version,
            connection,
        };
        self.send(|out| encode::server_info(&info, out));
    }

    fn define(&mut self, bodies: &[(&str, i32)]) {
        let datasets: Vec<_> = bodies
            .iter()
            .map(|&(name, id)| {
                Dataset::RigidBody(RigidBodyDefinition {
                    name: name.as_bytes(),
                    id,
                    parent_id: -1,
                    offset_m: [0.0; 3],
                })
            })
            .collect();
        let datagram =
            self.encode(|version, out| encode::model_definitions(version, &datasets, out));
        self.receive(SERVER, &datagram);
    }

    fn answer_echo(&mut self, error_us: i64) {
        let echo = Echo {
            client_stamp: self.echo_stamp,
            server_ticks: self
                .ticks_at(self.now_ns)
                .wrapping_add_signed(error_us * 10),
        };
        self.now_ns += 200_000;
        self.send(|out| encode::echo_response(echo, out));
    }

    fn encode(
        &mut self,
        encode: impl FnOnce(BitstreamVersion, &mut [u8]) -> Result<usize, EncodeError>,
    ) -> Vec<u8> {
        let length = encode(self.version, &mut self.buffer).unwrap_or_default();
        self.buffer.get(..length).unwrap_or_default().to_vec()
    }

    fn send(&mut self, encode: impl FnOnce(&mut [u8]) -> Result<usize, EncodeError>) {
        let datagram = self.encode(|_, out| encode(out));
        self.receive(SERVER, &datagram);
    }

    fn receive_from_stranger(&mut self, operation: u8, choices: &mut Choices<'_>) {
        let datagram = match operation % 4 {
            0 => choices.bytes().to_vec(),
            1 => {
                let id = choices.byte();
                with_header(id.into(), choices.bytes())
            }
            2 => self.nominal_frame(),
            _ => self.encode(|_, out| encode::disconnect(out)),
        };
        let mut expected = self.session.clone();
        let before = expected.counters();
        self.receive(STRANGER, &datagram);
        let mut counters = self.session.counters();
        assert_eq!(
            counters.session.wrong_source,
            before.session.wrong_source + 1
        );
        counters.session.wrong_source = before.session.wrong_source;
        assert_eq!(counters, before, "a stranger is counted as something else");
        // What is counted is all that differs.
        let nothing = Input::Datagram {
            source: STRANGER,
            bytes: &[],
        };
        expected.handle_input(self.now_ns, nothing, &mut |_| {});
        assert_eq!(
            format!("{expected:?}"),
            format!("{:?}", self.session),
            "a foreign datagram changed the session"
        );
    }

    fn receive(&mut self, source: SocketAddr, datagram: &[u8]) {
        self.datagrams += 1;
        let phase = self.session.source().phase();
        let binding = self.session.tracker().binding;
        let frames = self.session.counters().session.frames;
        let mut events = 0;
        let mut observed = None;
        let input = Input::Datagram {
            source,
            bytes: datagram,
        };
        self.session
            .handle_input(self.now_ns, input, &mut |event| match event {
                PlanarEvent::Observed(observation) => observed = Some(observation),
                _ => events += 1,
            });
        assert!(events <= EVENTS, "{events} events of one datagram");
        match observed {
            Some(observation) => {
                assert_eq!(source, SERVER);
                assert_eq!(self.session.counters().session.frames, frames + 1);
                let Phase::Streaming(version) = phase else {
                    panic!("a frame is accepted in {phase:?}");
                };
                assert_eq!(observation.receive_time_ns, self.now_ns);
                self.check_observation(&observation, version, binding, datagram);
            }
            None => assert_eq!(self.session.counters().session.frames, frames),
        }
        self.settle();
    }

    fn check_observation(
        &mut self,
        observation: &Observation,
        version: BitstreamVersion,
        binding: Binding,
        datagram: &[u8],
    ) {
        let PoseState::Valid(pose) = observation.state else {
            return;
        };
        let Binding::Bound { id } = binding else {
            panic!("a pose of a body that is {binding:?}");
        };
        let Ok(ServerMessage::Frame(frame)) = ServerMessage::decode(datagram, version) else {
            panic!("a pose from a datagram that is not a frame");
        };
        let bodies: Vec<_> = frame.rigid_bodies().filter(|body| body.id == id).collect();
        let [body] = bodies.as_slice() else {
            panic!("a pose of {} bodies", bodies.len());
        };
        assert!(body.tracking_valid(), "a pose of an untracked body");
        assert_eq!(pose.frame_number, frame.number);
        self.check_pose(&pose);
        self.last_valid = Some(pose);
    }

    fn check_pose(&self, pose: &PlanarPose) {
        let limits = &self.session.config().limits;
        let numbers = [
            pose.x_m,
            pose.y_m,
            pose.z_m,
            pose.yaw_rad,
            pose.tilt_rad,
            pose.mean_error_m,
        ];
        assert!(
            numbers.iter().all(|number| number.is_finite()),
            "{pose:?} is not finite"
        );
        assert!(pose.yaw_rad.abs() <= PI && (0.0..=limits.max_tilt_rad).contains(&pose.tilt_rad));
        assert!(pose.mean_error_m <= limits.max_mean_error_m);
        assert_eq!(pose.receive_time_ns, self.now_ns);
        assert!(
            pose.capture_time_ns <= pose.receive_time_ns,
            "captured in the future"
        );
        let Some(last) = self.last_valid else {
            assert!(pose.reacquired, "the first pose has no predecessor");
            return;
        };
        if !pose.reacquired {
            let backward_ns = last.capture_time_ns.saturating_sub(pose.capture_time_ns);
            assert!(
                backward_ns <= last.capture_uncertainty_ns + pose.capture_uncertainty_ns,
                "captured {backward_ns} ns before the last one"
            );
            let elapsed_s = pose.capture_time_ns.saturating_sub(last.capture_time_ns) as f64 * 1e-9;
            let distance_m = [
                pose.x_m - last.x_m,
                pose.y_m - last.y_m,
                pose.z_m - last.z_m,
            ]
            .iter()
            .map(|difference| difference * difference)
            .sum::<f64>()
            .sqrt();
            let reach_m = limits.jump_margin_m + limits.max_speed_m_s * elapsed_s;
            assert!(
                distance_m <= reach_m * (1.0 + 1e-12),
                "moved {distance_m} m in {elapsed_s} s"
            );
        }
    }

    fn pass(&mut self, span_ns: u64) {
        self.now_ns += span_ns;
        self.settle();
    }

    /// Lets the session send what is due and report its events.
    fn settle(&mut self) {
        let mut events = 0;
        self.session
            .handle_timeout(self.now_ns, &mut |_| events += 1);
        assert!(events <= EVENTS, "{events} events of one moment");
        let mut sent = 0;
        while let Some(datagram) = self.session.poll_transmit(self.now_ns) {
            sent += 1;
            assert!(sent <= TRANSMITS, "unbounded sending");
            assert_eq!(datagram.destination, SERVER);
            match ClientMessage::decode(&datagram.bytes) {
                Ok(ClientMessage::EchoRequest { client_stamp }) => self.echo_stamp = client_stamp,
                Ok(_) => {}
                Err(error) => panic!("sent bytes that are not a message: {error}"),
            }
        }
        if let Some(wake_ns) = self.session.poll_timeout() {
            assert!(wake_ns > self.now_ns, "a wake-up in the past");
        }
        let counters = self.session.counters();
        let rejected = counters.rejected.total();
        assert_eq!(
            counters.session.frames,
            counters.valid + counters.untracked + counters.absent + counters.unbound + rejected,
            "frames without an outcome"
        );
    }
}

/// A datagram with a valid header, for any message and payload.
fn with_header(id: u16, payload: &[u8]) -> Vec<u8> {
    let length = u16::try_from(payload.len()).unwrap_or(u16::MAX);
    let payload = payload.get(..length.into()).unwrap_or_default();
    [&id.to_le_bytes(), &length.to_le_bytes(), payload].concat()
}

fn any_body(choices: &mut Choices<'_>) -> RigidBody {
    RigidBody {
        id: choices.one_of([CAR, CAR, 3, -1]),
        position_m: [choices.f32(), choices.f32(), choices.f32()],
        orientation_xyzw: if choices.flag() {
            [0.0, 0.0, 0.0, 1.0]
        } else {
            [choices.f32(), choices.f32(), choices.f32(), choices.f32()]
        },
        mean_error_m: if choices.flag() { 0.0 } else { choices.f32() },
        params: choices.byte().into(),
    }
}

#[cfg(test)]
mod tests {
    use super::{Bench, Binding, CAR, Choices, Phase, PoseState, VERSIONS};

    #[test]
    fn the_first_bytes_select_the_initial_state() {
        for options in 0..64_u8 {
            for version in 0..VERSIONS.len() as u8 {
                let bench = Bench::at_stage(&mut Choices::new(&[options, version]));
                let session = &bench.session;
                let what = format!("options {options:#08b}, version {version}");
                let streams =
                    matches!(session.source().phase(), Phase::Streaming(v) if v == bench.version);
                assert_eq!(streams, options & 3 >= 1, "{what}");
                let bound = session.tracker().binding == Binding::Bound { id: CAR };
                assert_eq!(bound, options & 3 >= 2, "{what}");
                let valid = matches!(session.pose_state(bench.now_ns), PoseState::Valid(_));
                assert_eq!(valid, options & 3 == 3, "{what}: {session:?}");
            }
        }
    }
}
