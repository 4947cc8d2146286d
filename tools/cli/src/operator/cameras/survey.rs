//! The servers that answer on the network, and what the frames of one say of its bodies and times.

use std::{
    io,
    net::{Ipv4Addr, SocketAddr, SocketAddrV4, UdpSocket},
    time::{Duration, Instant},
};

use serde::Serialize;
use singletrack_control::statistics::RootMeanSquare;
use singletrack_core::config::ServerKind;
use singletrack_mocap::{
    Body, BodyPose, BodyState, CaptureTimeSource, DEFAULT_COMMAND_PORT, NameText, Output,
    PoseFrame, SessionEvent,
    codec::ClientMessage,
    encode,
    qualisys::packet::{DISCOVERY_PORT, discovery},
};

/// A body, from all frames in which it was listed.
#[derive(Clone, Debug, Default)]
struct Seen {
    id: i32,
    name: Option<String>,
    is_utf8: bool,
    listed: u64,
    tracked: u64,
    invalid: u64,
    doubled: u64,
    repeated: u64,
    last: Option<BodyPose>,
    arrivals_ns: Vec<u64>,
    positions_m: Vec<[f64; 3]>,
}

/// Everything that was seen.
#[derive(Debug, Default)]
pub(super) struct Survey {
    bodies: Vec<Seen>,
    /// Frames so far; with VRPN, poses.
    pub(super) frames: u64,
    ages_ns: Vec<u64>,
    uncertainty_ns: u64,
    source: Option<CaptureTimeSource>,
    pub(super) events: Vec<SessionEvent>,
}

/// What is known of a body.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct BodyReport {
    /// Its name; none if the server lists none.
    pub(super) name: Option<String>,
    /// Its streaming id; with VRPN a thousand times the sender's number, and the sensor's.
    pub(super) id: i32,
    /// Poses a second.
    pub(super) rate_hz: f64,
    /// Standard deviation of the time between two poses, in ms.
    pub(super) jitter_ms: f64,
    /// Part of the frames that list it in which it is seen.
    pub(super) seen: f64,
    /// Part of its poses that repeat the one before to the bit.
    pub(super) repeated: f64,
    /// Standard deviation of the position: the noise, if it stands. In mm.
    pub(super) spread_mm: f64,
    /// Its last position, in m.
    pub(super) position_m: Option<[f64; 3]>,
    /// Its last yaw, in degrees.
    pub(super) yaw_deg: Option<f64>,
    /// What an operator should look at.
    pub(super) remarks: Vec<&'static str>,
}

/// What is known of the frames' times.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Times {
    /// Mean age of a pose at its arrival, in ms.
    pub(super) latency_ms: f64,
    /// Bound on its error, in ms.
    pub(super) uncertainty_ms: f64,
    /// How it was found.
    pub(super) source: &'static str,
}

impl Survey {
    pub(super) fn take(&mut self, output: &Output<'_>) {
        match output {
            Output::Event(event) => self.events.push(*event),
            Output::Names(names) => {
                self.bodies.iter_mut().for_each(|body| body.name = None);
                names.for_each(&mut |id, name| {
                    let name = NameText(name);
                    let body = self.body(id);
                    (body.name, body.is_utf8) = (Some(name.to_string()), name.is_utf8());
                });
            }
            Output::Frame(frame) => self.frame(frame),
        }
    }

    fn body(&mut self, id: i32) -> &mut Seen {
        let index = self.bodies.iter().position(|body| body.id == id);
        let index = index.unwrap_or_else(|| {
            self.bodies.push(Seen {
                id,
                ..Seen::default()
            });
            self.bodies.len() - 1
        });
        &mut self.bodies[index]
    }

    fn frame(&mut self, frame: &PoseFrame<'_>) {
        self.frames += 1;
        if let Some(capture) = frame.capture {
            self.ages_ns
                .push(frame.receive_time_ns.saturating_sub(capture.time_ns));
            self.uncertainty_ns = capture.uncertainty_ns;
            self.source = Some(capture.source);
        }
        let bodies: Vec<Body> = frame.bodies().collect();
        for body in &bodies {
            let is_doubled = bodies.iter().filter(|other| other.id == body.id).count() > 1;
            let seen = self.body(body.id);
            seen.listed += 1;
            seen.doubled += u64::from(is_doubled);
            match body.state {
                BodyState::Tracked(pose) => {
                    seen.tracked += 1;
                    seen.repeated += u64::from(seen.last == Some(pose));
                    seen.last = Some(pose);
                    seen.arrivals_ns.push(frame.receive_time_ns);
                    seen.positions_m.push(pose.position_m);
                }
                BodyState::Invalid(_) => seen.invalid += 1,
                BodyState::Untracked => {}
            }
        }
    }

    /// None before the first frame with a time.
    pub(super) fn times(&self) -> Option<Times> {
        let source = self.source?.name();
        let ages: Vec<f64> = self.ages_ns.iter().map(|age| *age as f64 * 1e-6).collect();
        Some(Times {
            latency_ms: mean(&ages),
            uncertainty_ms: self.uncertainty_ns as f64 * 1e-6,
            source,
        })
    }

    /// The bodies, in the order of the server, after `seconds`.
    pub(super) fn bodies(&self, seconds: f64) -> Vec<BodyReport> {
        let report = |body: &Seen| body.report(seconds);
        self.bodies.iter().map(report).collect()
    }
}

impl Seen {
    fn report(&self, seconds: f64) -> BodyReport {
        let part = |count: u64, of: u64| count as f64 / of.max(1) as f64;
        let pairs = self.arrivals_ns.windows(2);
        let gaps = pairs.map(|pair| pair[1].saturating_sub(pair[0]) as f64 * 1e-6);
        let gaps: Vec<f64> = gaps.collect();
        let spread_m = |axis: usize| {
            let positions_m: Vec<f64> = self.positions_m.iter().map(|at| at[axis]).collect();
            deviation(&positions_m)
        };
        let spread_mm = (0..3).map(spread_m).fold(0.0, libm::hypot) * 1e3;
        let repeated = part(self.repeated, self.tracked.saturating_sub(1));
        let mut remarks = Vec::new();
        if self.name.is_none() {
            remarks.push("no name in the server's list");
        } else if !self.is_utf8 {
            remarks.push("its name is not UTF-8: a body that is followed needs another one");
        }
        if self.tracked == 0 {
            remarks.push("never seen: a ghost of the list, or out of view");
        }
        if self.doubled > 0 {
            remarks.push("its id is listed twice");
        }
        if self.invalid > 0 {
            remarks.push("some of its poses are no numbers or no rotation");
        }
        // A body that is measured never has the same bits twice.
        if self.tracked > 10 && repeated > 0.5 {
            remarks.push("repeats its pose to the bit: not measured");
        }
        BodyReport {
            name: self.name.clone(),
            id: self.id,
            rate_hz: self.tracked as f64 / seconds.max(1e-3),
            jitter_ms: deviation(&gaps),
            seen: part(self.tracked, self.listed),
            repeated,
            spread_mm,
            position_m: self.last.map(|pose| pose.position_m),
            yaw_deg: self.last.map(|pose| {
                let [x, y, z, w] = pose.orientation_xyzw;
                let (sin, cos) = (2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z));
                libm::atan2(sin, cos).to_degrees()
            }),
            remarks,
        }
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

fn deviation(values: &[f64]) -> f64 {
    let mean = mean(values);
    let deviations = RootMeanSquare::of(values.iter().map(|value| value - mean));
    deviations.value().unwrap_or(0.0)
}

/// How long answers are waited for.
const ANSWERS: Duration = Duration::from_secs(1);

/// The servers that answer a question to this address, which may be that of a whole network.
pub(super) fn servers(asked: Ipv4Addr) -> io::Result<Vec<(ServerKind, Ipv4Addr)>> {
    let natnet = socket()?;
    let mut question = [0; 64];
    let length = encode::client_message(&ClientMessage::Discovery, &mut question)
        .map_err(io::Error::other)?;
    let question = question.get(..length).unwrap_or_default();
    natnet.send_to(question, SocketAddrV4::new(asked, DEFAULT_COMMAND_PORT))?;
    let qualisys = socket()?;
    let question = discovery(qualisys.local_addr()?.port());
    qualisys.send_to(&question, SocketAddrV4::new(asked, DISCOVERY_PORT))?;
    let mut found = Vec::new();
    for (kind, socket) in [
        (ServerKind::NatNet, natnet),
        (ServerKind::Qualisys, qualisys),
    ] {
        let until = Instant::now() + ANSWERS / 2;
        while Instant::now() < until {
            if let Ok((_, SocketAddr::V4(from))) = socket.recv_from(&mut [0; 2_048])
                && !found.contains(&(kind, *from.ip()))
            {
                found.push((kind, *from.ip()));
            }
        }
    }
    Ok(found)
}

fn socket() -> io::Result<UdpSocket> {
    let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?;
    socket.set_broadcast(true)?;
    socket.set_read_timeout(Some(ANSWERS / 8))?;
    Ok(socket)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may fail")]
mod tests {
    use singletrack_sim::{RealTimeConfig, RealTimeSimulator, UdpConfig};

    use super::*;

    #[test]
    fn a_server_answers_with_its_kind_and_address() {
        // Their usual ports, at an address of this computer that no other test uses.
        let address = Ipv4Addr::new(127, 0, 36, 1);
        let start = |cameras, command_port| {
            RealTimeSimulator::start(RealTimeConfig {
                cameras,
                udp: UdpConfig {
                    interface: address,
                    command_port,
                    data_port: 0,
                },
                ..RealTimeConfig::default()
            })
            .unwrap()
        };
        let _natnet = start(singletrack_sim::ServerKind::NatNet, 1_510);
        let _qualisys = start(singletrack_sim::ServerKind::Qualisys, 22_223);
        let expected = [
            (ServerKind::NatNet, address),
            (ServerKind::Qualisys, address),
        ];
        assert_eq!(servers(address).unwrap(), expected);
    }
}
