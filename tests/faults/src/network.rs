//! The network between the camera server and the host, with its faults.

use std::{
    cmp::Reverse,
    collections::{BTreeMap, BinaryHeap, VecDeque},
    net::{IpAddr, Ipv4Addr, SocketAddr},
};

use singletrack_core::cameras::{Channel, Sockets};
use singletrack_mocap::{
    codec::{
        BitstreamVersion, CameraTicks, Echo, Frame, FrameFlags, RigidBody, RigidBodyDefinition,
        ServerMessage,
    },
    encode::{self, Dataset, FrameContent},
};
use singletrack_sim::{CameraFrame, Datagram, Destination, TICKS_PER_SECOND, World};

use crate::{
    random::{Random, Stream},
    schedule::{Fault, FaultKind},
    setting,
};

/// The server's address in the daemon's configuration.
const SERVER: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 1_510);

/// An address that is not the server's.
const STRANGER: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::new(127, 0, 0, 66)), 1_510);

/// Half of the time between two frames, in µs.
const HALF_FRAME_US: u64 = 5_000;

/// Capacity of the socket's queue: 208 KiB, in which a small datagram takes about a
/// kilobyte. What exceeds it is lost.
const MAX_UNREAD: usize = 208;

/// Time for which a step of the server's clock may affect poses, in µs: the host
/// maps the clock by echoes 700 ms apart, of which one may be lost.
const CLOCK_MEMORY_US: u64 = 3_000_000;

/// A streaming id without a body.
const UNUSED_ID: i32 = 99;

/// A pose of the car that the server sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Exposure {
    /// Simulation time of mid-exposure, in µs.
    pub(crate) exposed_us: u64,
    /// False while a clock step may affect the frame's time.
    pub(crate) clock_trusted: bool,
    /// Whether the pose differs from the car's true one.
    pub(crate) falsified: bool,
}

/// A datagram for the host.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Packet {
    pub(crate) source: SocketAddr,
    pub(crate) bytes: Vec<u8>,
    pub(crate) exposure: Option<Exposure>,
}

/// A frame while faults are applied to it.
struct Content {
    number: i32,
    ticks: CameraTicks,
    flags: FrameFlags,
    bodies: Vec<RigidBody>,
    car: Option<RigidBody>,
    exposure: Exposure,
    delay_us: u64,
    lost: bool,
}

/// The network.
#[derive(Debug)]
pub(crate) struct Network {
    random: Random,
    frames: BTreeMap<i32, CameraFrame>,
    under_way: BinaryHeap<Reverse<(u64, u64)>>,
    packets: BTreeMap<u64, Packet>,
    sent: u64,
    /// Arrived, not yet read by the daemon.
    unread: VecDeque<Packet>,
    newest_read: Option<Exposure>,
    /// The car's last true pose.
    last_car: Option<RigidBody>,
    /// Frame number and clock at the last restart of the server.
    first_number: i32,
    first_ticks: u64,
    /// End of the time in which a clock step may affect poses.
    clock_suspect_until_us: u64,
    /// The next frame announces a change of the models.
    announce: bool,
    /// The other body has carried the car's name: the host may still track its id.
    renamed: bool,
    buffer: Vec<u8>,
}

impl Network {
    pub(crate) fn new(seed: u64) -> Self {
        Self {
            random: Random::new(seed, Stream::Network),
            frames: BTreeMap::new(),
            under_way: BinaryHeap::new(),
            packets: BTreeMap::new(),
            sent: 0,
            unread: VecDeque::new(),
            newest_read: None,
            last_car: None,
            first_number: 0,
            first_ticks: 0,
            clock_suspect_until_us: 0,
            announce: false,
            renamed: false,
            buffer: vec![0; 4_096],
        }
    }

    /// Notes that a fault begins or ends.
    pub(crate) const fn note_change(&mut self, kind: FaultKind) {
        if matches!(kind, FaultKind::CameraRenamed) {
            self.announce = true;
            self.renamed = true;
        }
    }

    /// Restarts the server's clock and frame numbers.
    pub(crate) fn restart_server(&mut self, world: &World) {
        let now_us = world.now_us;
        self.first_ticks = world.cameras.ticks(now_us).saturating_sub(TICKS_PER_SECOND);
        self.first_number = i32::try_from(world.cameras.counters.exposed).unwrap_or(0);
        self.clock_suspect_until_us = now_us + CLOCK_MEMORY_US;
    }

    /// Takes the datagrams that the server sends to `client`.
    pub(crate) fn take(&mut self, world: &mut World, client: Option<SocketAddr>, faults: &[Fault]) {
        let now_us = world.now_us;
        while let Some(frame) = world.poll_camera_frame() {
            self.frames.insert(frame.number, frame);
        }
        while let Some(datagram) = world.poll_datagram() {
            let off = is_active(faults, FaultKind::CameraServerRestart);
            if off || Some(datagram.to) != client.map(Destination::Client) {
                continue;
            }
            if datagram.is_frame {
                self.frame(now_us, &datagram, faults);
            } else {
                let bytes = self.answer(world, &datagram, faults);
                let source = if is_active(faults, FaultKind::CameraSecondCard) {
                    STRANGER
                } else {
                    SERVER
                };
                self.send(
                    now_us,
                    Packet {
                        source,
                        bytes,
                        exposure: None,
                    },
                );
            }
        }
        // Frames this old are not needed again.
        while self.frames.len() > 64 {
            self.frames.pop_first();
        }
    }

    /// Delivers the datagrams that are due; they are dropped if no socket is open.
    pub(crate) fn deliver(&mut self, now_us: u64, is_open: bool) {
        while let Some(&Reverse((due_us, number))) = self.under_way.peek()
            && due_us <= now_us
        {
            self.under_way.pop();
            if let Some(packet) = self.packets.remove(&number)
                && is_open
                && self.unread.len() < MAX_UNREAD
            {
                self.unread.push_back(packet);
            }
        }
        if !is_open {
            self.unread.clear();
        }
    }

    /// The next datagram that has arrived. Of several exposures that are read, the newest
    /// is kept.
    fn read(&mut self) -> Option<Packet> {
        let packet = self.unread.pop_front()?;
        if let Some(exposure) = packet.exposure {
            let is_newer = self
                .newest_read
                .is_none_or(|newest| exposure.exposed_us >= newest.exposed_us);
            if is_newer {
                self.newest_read = Some(exposure);
            }
        }
        Some(packet)
    }

    /// The newest exposure that was read since the last call.
    pub(crate) const fn take_read(&mut self) -> Option<Exposure> {
        self.newest_read.take()
    }

    fn send(&mut self, due_us: u64, packet: Packet) {
        self.sent += 1;
        self.under_way.push(Reverse((due_us, self.sent)));
        self.packets.insert(self.sent, packet);
    }

    fn ticks(&self, ticks: u64, faults: &[Fault]) -> u64 {
        if ticks == 0 {
            return 0;
        }
        let mut ticks = ticks.saturating_sub(self.first_ticks);
        for fault in faults {
            let step = u64::from(fault.severity) * (TICKS_PER_SECOND / 1_000);
            match fault.kind {
                FaultKind::CameraClockBackward => ticks = ticks.saturating_sub(step),
                FaultKind::CameraClockForward => ticks += step,
                _ => {}
            }
        }
        ticks
    }

    /// Falsifies an answer of the server, which is any datagram but a frame.
    fn answer(&mut self, world: &World, datagram: &Datagram, faults: &[Fault]) -> Vec<u8> {
        let version = BitstreamVersion::V4_1;
        let encoded = match ServerMessage::decode(&datagram.bytes, version) {
            Ok(ServerMessage::Echo(echo)) => {
                let echo = Echo {
                    server_ticks: self.ticks(echo.server_ticks, faults),
                    ..echo
                };
                encode::echo_response(echo, &mut self.buffer).ok()
            }
            Ok(ServerMessage::ModelDefinitions(_))
                if is_active(faults, FaultKind::CameraRenamed) =>
            {
                let cameras = &world.cameras.parameters;
                let (car, other) = (&cameras.car, cameras.decoys.first());
                let other =
                    other.map_or(("other", UNUSED_ID), |body| (body.name.as_str(), body.id));
                let pairs = [(car.name.as_str(), other.1), (other.0, car.id)];
                let swapped = pairs.map(|(name, id)| {
                    Dataset::RigidBody(RigidBodyDefinition {
                        name: name.as_bytes(),
                        id,
                        parent_id: -1,
                        offset_m: [0.0; 3],
                    })
                });
                encode::model_definitions(version, &swapped, &mut self.buffer).ok()
            }
            _ => None,
        };
        match encoded.and_then(|length| self.buffer.get(..length)) {
            Some(bytes) => bytes.to_vec(),
            None => datagram.bytes.clone(),
        }
    }

    fn frame(&mut self, now_us: u64, datagram: &Datagram, faults: &[Fault]) {
        let Ok(ServerMessage::Frame(decoded)) =
            ServerMessage::decode(&datagram.bytes, BitstreamVersion::V4_1)
        else {
            return;
        };
        let Some(sent) = self.frames.get(&decoded.number).cloned() else {
            return;
        };
        let mut content = self.content(now_us, &decoded, sent, faults);
        if content.car.is_some() && !faults.iter().any(|fault| fault.kind.falsifies_pose()) {
            self.last_car = content.car;
        }
        for fault in faults {
            self.falsify(now_us, &mut content, fault);
        }
        if !content.lost
            && let Some(bytes) = self.encode(&content)
        {
            self.send_frame(now_us, &content, bytes, faults);
        }
    }

    fn content(
        &mut self,
        now_us: u64,
        decoded: &Frame<'_>,
        sent: CameraFrame,
        faults: &[Fault],
    ) -> Content {
        let stepped = |fault: &Fault| {
            matches!(
                fault.kind,
                FaultKind::CameraClockBackward | FaultKind::CameraClockForward
            )
        };
        if faults.iter().any(stepped) {
            self.clock_suspect_until_us = now_us + CLOCK_MEMORY_US;
        }
        let mut flags = decoded.flags;
        if core::mem::take(&mut self.announce) {
            flags = FrameFlags(flags.0 | FrameFlags::MODELS_CHANGED.0);
        }
        let mut bodies = sent.bodies;
        let car = bodies.pop().filter(|_| sent.car_tracked);
        Content {
            number: decoded.number.wrapping_sub(self.first_number),
            ticks: CameraTicks {
                mid_exposure: self.ticks(sent.ticks.mid_exposure, faults),
                received: self.ticks(sent.ticks.received, faults),
                transmit: self.ticks(sent.ticks.transmit, faults),
            },
            flags,
            bodies,
            car,
            exposure: Exposure {
                exposed_us: sent.exposed_us,
                clock_trusted: now_us >= self.clock_suspect_until_us,
                falsified: false,
            },
            delay_us: 0,
            lost: false,
        }
    }

    fn falsify(&mut self, now_us: u64, content: &mut Content, fault: &Fault) {
        let s = fault.severity;
        let metres = s as f32 * 1e-3;
        match fault.kind {
            FaultKind::CameraUntracked => {
                content.car = self.last_car.map(|car| car.with_tracking_valid(false));
            }
            FaultKind::CameraAbsent => content.car = None,
            FaultKind::CameraRare if content.number % (2 + s / 50) as i32 != 0 => {
                content.car = None;
            }
            FaultKind::CameraSilent => content.lost |= self.random.happens(s),
            FaultKind::CameraHidden => {
                if let Some(car) = &mut content.car {
                    car.id = UNUSED_ID;
                }
            }
            FaultKind::CameraFrozen => {
                if let (Some(car), Some(last)) = (&mut content.car, self.last_car) {
                    *car = RigidBody { id: car.id, ..last };
                    content.exposure.falsified = true;
                }
            }
            FaultKind::CameraJump => {
                move_by(&mut content.car, metres);
                content.exposure.falsified = true;
            }
            FaultKind::CameraJumping if content.number % 3 == 0 => {
                move_by(&mut content.car, metres);
                content.exposure.falsified = true;
            }
            FaultKind::CameraSwapped => {
                if let (Some(car), Some(other)) = (&mut content.car, content.bodies.first_mut()) {
                    core::mem::swap(&mut car.id, &mut other.id);
                }
                content.exposure.falsified = true;
            }
            FaultKind::CameraRenamed => content.exposure.falsified = true,
            FaultKind::CameraFlip => {
                turn_by(&mut content.car, metres * core::f32::consts::PI);
                content.exposure.falsified = true;
            }
            FaultKind::CameraLate => content.delay_us += u64::from(s) * 500,
            FaultKind::CameraReordered => {
                content.delay_us += u64::from(self.random.between(0, s * 250));
            }
            FaultKind::CameraDuplicated => {
                if let Some(bytes) = self.encode(content) {
                    let later_us = u64::from(self.random.between(0, s * 1_000));
                    let due_us = now_us + content.delay_us + later_us;
                    // It may arrive before the original.
                    let exposure = self.shows_a_car(content).then_some(content.exposure);
                    self.send_as(SERVER, due_us, bytes, exposure);
                }
            }
            FaultKind::CameraNotANumber => {
                if let Some(car) = &mut content.car {
                    car.position_m = [f32::NAN; 3];
                    car.orientation_xyzw = [f32::NAN; 4];
                }
            }
            FaultKind::CameraInfinite => {
                if let Some(car) = &mut content.car {
                    let [x, _, _] = &mut car.position_m;
                    *x = f32::INFINITY;
                }
            }
            FaultKind::CameraDuplicateId => {
                let mut other = content.car;
                move_by(&mut other, metres);
                content.bodies.extend(other);
            }
            FaultKind::CameraSpoofed | FaultKind::CameraForged => {
                // Half a frame later, in content and in time.
                let (car, ticks, number) = (content.car, content.ticks, content.number);
                if fault.kind == FaultKind::CameraForged {
                    content.number = number.wrapping_add(1);
                    move_by(&mut content.car, metres * since_s(now_us, fault));
                } else {
                    move_by(&mut content.car, metres);
                }
                let later = HALF_FRAME_US * (TICKS_PER_SECOND / 1_000_000);
                content.ticks.mid_exposure += later;
                content.ticks.received += later;
                content.ticks.transmit += later;
                if let Some(bytes) = self.encode(content) {
                    let exposure = self.shows_a_car(content).then_some(Exposure {
                        exposed_us: content.exposure.exposed_us + HALF_FRAME_US,
                        falsified: true,
                        ..content.exposure
                    });
                    let due_us = now_us + content.delay_us + HALF_FRAME_US;
                    self.send_as(SERVER, due_us, bytes, exposure);
                }
                content.car = car;
                content.ticks = ticks;
                content.number = number;
            }
            FaultKind::CameraGhost => {
                let mut noise = || (self.random.between(0, 400) as f32 - 200.0) * 1e-6;
                if let (Some(car), Some(last)) = (&mut content.car, self.last_car) {
                    *car = RigidBody { id: car.id, ..last };
                    for coordinate in &mut car.position_m {
                        *coordinate += noise();
                    }
                }
                move_by(&mut content.car, 10.0 * metres);
                content.exposure.falsified = true;
            }
            FaultKind::CameraDrift => {
                move_by(&mut content.car, metres * since_s(now_us, fault));
                content.exposure.falsified = true;
            }
            _ => {}
        }
    }

    fn encode(&mut self, content: &Content) -> Option<Vec<u8>> {
        let mut bodies = content.bodies.clone();
        bodies.extend(content.car);
        let length = encode::frame(
            BitstreamVersion::V4_1,
            &FrameContent {
                number: content.number,
                rigid_bodies: &bodies,
                timestamp_s: content.ticks.mid_exposure as f64 / TICKS_PER_SECOND as f64,
                ticks: content.ticks,
                flags: content.flags,
                ..FrameContent::default()
            },
            &mut self.buffer,
        );
        Some(self.buffer.get(..length.ok()?)?.to_vec())
    }

    fn send_frame(&mut self, now_us: u64, content: &Content, mut bytes: Vec<u8>, faults: &[Fault]) {
        let mut exposure = self.shows_a_car(content).then_some(content.exposure);
        let source = if is_active(faults, FaultKind::CameraSecondCard) {
            // Dropped.
            exposure = None;
            STRANGER
        } else {
            SERVER
        };
        for fault in faults {
            if fault.kind == FaultKind::CameraMalformed && self.random.happens(fault.severity) {
                self.damage(&mut bytes);
                // It may still decode.
                exposure = exposure.map(|exposure| Exposure {
                    clock_trusted: false,
                    falsified: true,
                    ..exposure
                });
            }
        }
        self.send_as(source, now_us + content.delay_us, bytes, exposure);
    }

    fn send_as(
        &mut self,
        source: SocketAddr,
        due_us: u64,
        bytes: Vec<u8>,
        exposure: Option<Exposure>,
    ) {
        self.send(
            due_us,
            Packet {
                source,
                bytes,
                exposure,
            },
        );
    }

    /// Whether a client may find a pose of the car in it: of exactly one valid body
    /// with one of the car's ids, or with the id that carried the car's name.
    fn shows_a_car(&self, content: &Content) -> bool {
        let bodies = || content.bodies.iter().chain(&content.car);
        bodies().any(|body| {
            let finite = body.position_m.iter().chain(&body.orientation_xyzw);
            let named = setting::CAR_IDS.contains(&body.id)
                || (self.renamed && content.bodies.first().is_some_and(|b| b.id == body.id));
            named
                && body.tracking_valid()
                && finite.copied().all(f32::is_finite)
                && bodies().filter(|other| other.id == body.id).count() == 1
        })
    }

    /// Truncates a datagram, or flips bits in up to four bytes.
    fn damage(&mut self, bytes: &mut Vec<u8>) {
        let last = u32::try_from(bytes.len()).unwrap_or(0).saturating_sub(1);
        if self.random.happens(500) {
            bytes.truncate(self.random.between(0, last) as usize);
            return;
        }
        for _ in 0..self.random.between(1, 4) {
            let index = self.random.between(0, last) as usize;
            if let Some(byte) = bytes.get_mut(index) {
                *byte ^= 1 << self.random.between(0, 7);
            }
        }
    }
}

fn is_active(faults: &[Fault], kind: FaultKind) -> bool {
    faults.iter().any(|fault| fault.kind == kind)
}

/// Time since the onset of the fault, in s.
fn since_s(now_us: u64, fault: &Fault) -> f32 {
    (now_us / 1_000).saturating_sub(fault.at_ms.into()) as f32 * 1e-3
}

fn move_by(body: &mut Option<RigidBody>, metres: f32) {
    if let Some(body) = body {
        let [x, _, _] = &mut body.position_m;
        *x += metres;
    }
}

/// Rotates a body about the vertical, which is y on the wire.
fn turn_by(body: &mut Option<RigidBody>, angle: f32) {
    if let Some(body) = body {
        let (sin, cos) = libm::sincos(f64::from(angle) / 2.0);
        let (s, c) = (sin as f32, cos as f32);
        let [x, y, z, w] = body.orientation_xyzw;
        body.orientation_xyzw = [c * x + s * z, c * y + s * w, c * z - s * x, c * w - s * y];
    }
}

/// The daemon's sockets to the cameras.
pub(crate) struct HostSockets<'a> {
    pub(crate) network: &'a mut Network,
    pub(crate) world: &'a mut World,
    /// The source address of its datagrams.
    pub(crate) address: SocketAddr,
    /// Whether the server receives them.
    pub(crate) is_connected: bool,
}

impl Sockets for HostSockets<'_> {
    fn receive(&mut self, channel: Channel, buffer: &mut [u8]) -> Option<(usize, SocketAddr)> {
        if channel == Channel::Data {
            return None;
        }
        loop {
            let packet = self.network.read()?;
            if let Some(room) = buffer.get_mut(..packet.bytes.len()) {
                room.copy_from_slice(&packet.bytes);
                return Some((packet.bytes.len(), packet.source));
            }
        }
    }

    fn send(&mut self, _: SocketAddr, bytes: &[u8]) {
        if self.is_connected {
            self.world.handle_datagram(self.address, bytes);
        }
    }
}
