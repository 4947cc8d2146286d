//! Every source of poses keeps the same promises, whatever its server speaks.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::indexing_slicing,
    reason = "the helpers of tests may fail as tests do"
)]

mod golden;
mod promises;
mod server;

use std::net::{IpAddr, Ipv4Addr, SocketAddr};

use singletrack_mocap::{
    Binding, Input, LocalEnd, Protocol, SessionEvent, Stream, Transport, UpAxis,
    planar::{Observation, PlanarConfig, PlanarEvent, PlanarPose, PlanarSession, PoseState},
};

use crate::server::{Kind, Sent, Server};

pub(crate) const MS: u64 = 1_000_000;
pub(crate) const SERVER: IpAddr = IpAddr::V4(Ipv4Addr::new(192, 168, 1, 10));

/// The cameras' latency, and their period.
pub(crate) const LATENCY_MS: u64 = 6;
const PERIOD_MS: u64 = 10;

pub(crate) struct Bench {
    pub(crate) server: Server,
    pub(crate) session: PlanarSession,
    pub(crate) now_ns: u64,
    /// Nobody answers.
    pub(crate) is_down: bool,
    /// Another program answers, with this.
    pub(crate) impostor: Option<&'static str>,
    /// Datagrams do not arrive.
    pub(crate) blocks_udp: bool,
    /// Time that frames take in addition, in ms.
    pub(crate) delay_ms: u64,
    /// No frame is sent.
    pub(crate) is_paused: bool,
    /// With the time at which they were made.
    pub(crate) observations: Vec<(u64, Observation)>,
    pub(crate) events: Vec<SessionEvent>,
    pub(crate) bindings: Vec<Binding>,
    open: Option<Stream>,
    received: Vec<u8>,
    exposed: Vec<u64>,
}

pub(crate) fn config(kind: Kind, name: &str, transport: Transport) -> PlanarConfig {
    let mut config = PlanarConfig::new(SERVER, transport, name, UpAxis::Z).unwrap();
    config.session.protocol = match kind {
        Kind::NatNet => Protocol::NatNet,
        Kind::Vrpn => Protocol::Vrpn { sensor: 0 },
        Kind::Qualisys(_) => Protocol::Qualisys,
    };
    config.session.command_port = config.session.protocol.default_port();
    config
}

impl Bench {
    /// A client that looks for the body `name`.
    pub(crate) fn of(kind: Kind, name: &str) -> Self {
        let transport = Transport::Unicast { bitstream: None };
        Self::with(config(kind, name, transport), kind)
    }

    pub(crate) fn with(config: PlanarConfig, kind: Kind) -> Self {
        Self {
            server: Server::new(kind),
            session: PlanarSession::new(config).unwrap(),
            now_ns: 5_000_000 * MS,
            is_down: false,
            impostor: None,
            blocks_udp: false,
            delay_ms: 0,
            is_paused: false,
            observations: Vec::new(),
            events: Vec::new(),
            bindings: Vec::new(),
            open: None,
            received: Vec::new(),
            exposed: Vec::new(),
        }
    }

    pub(crate) fn now_us(&self) -> u64 {
        self.now_ns / 1_000
    }

    /// How far the car has come at a time: 0.5 m/s.
    pub(crate) fn x_m(time_ns: u64) -> f64 {
        (time_ns - 5_000_000 * MS) as f64 * 0.5e-9
    }

    pub(crate) fn run(&mut self, ms: u64) -> &mut Self {
        for _ in 0..ms {
            self.now_ns += MS;
            self.keep_stream();
            if self.now_ns.is_multiple_of(PERIOD_MS * MS) {
                self.exposed.push(self.now_ns);
            }
            while let Some(exposed_ns) = self.exposed.first().copied()
                && self.now_ns >= exposed_ns + (LATENCY_MS + self.delay_ms) * MS
            {
                self.exposed.remove(0);
                if !self.is_down && !self.is_paused {
                    let sent = self.server.frame(exposed_ns / 1_000, Self::x_m(exposed_ns));
                    self.deliver(&sent);
                }
            }
            let mut said = Vec::new();
            self.session
                .handle_timeout(self.now_ns, &mut |event| said.push(event));
            self.keep(said);
            while let Some(transmit) = self.session.poll_transmit(self.now_ns) {
                assert_eq!(transmit.destination.ip(), SERVER);
                if !self.is_down && self.impostor.is_none() {
                    let sent = self.server.receive(self.now_ns / 1_000, &transmit.bytes);
                    // The answer takes a tenth of a millisecond.
                    self.now_ns += MS / 10;
                    self.deliver(&sent);
                    self.now_ns -= MS / 10;
                }
            }
            // Nothing is due in the past, or the owner would not sleep.
            let due_ns = self.session.poll_timeout();
            assert!(
                due_ns.is_none_or(|due_ns| due_ns > self.now_ns),
                "{due_ns:?}"
            );
        }
        self
    }

    fn keep_stream(&mut self) {
        let wanted = self.session.stream();
        if wanted == self.open {
            return;
        }
        self.open = wanted;
        self.received.clear();
        if wanted.is_none() {
            return;
        }
        if self.is_down {
            self.input(Input::Closed);
            return;
        }
        self.input(Input::Opened(LocalEnd {
            address: IpAddr::V4(Ipv4Addr::new(192, 168, 1, 20)),
            datagram_port: 40_000,
        }));
        match self.impostor {
            Some(answer) => self.deliver_stream(answer.as_bytes()),
            None => {
                let sent = self.server.connected();
                self.deliver(&sent);
            }
        }
    }

    /// The server goes, and its streams end.
    pub(crate) fn break_down(&mut self) {
        self.is_down = true;
        if self.open.is_some() {
            self.received.clear();
            self.input(Input::Closed);
        }
    }

    pub(crate) fn deliver(&mut self, sent: &Sent) {
        let sent = &Sent {
            stream: in_latin_1(&sent.stream),
            datagrams: sent
                .datagrams
                .iter()
                .map(|bytes| in_latin_1(bytes))
                .collect(),
        };
        if self.blocks_udp && self.server.kind != Kind::NatNet {
            self.deliver_stream(&sent.stream);
            return;
        }
        for datagram in &sent.datagrams {
            let source = SocketAddr::new(SERVER, 1_510);
            self.input(Input::Datagram {
                source,
                bytes: datagram,
            });
        }
        self.deliver_stream(&sent.stream);
    }

    /// In pieces: TCP knows no messages.
    pub(crate) fn deliver_stream(&mut self, bytes: &[u8]) {
        for piece in bytes.chunks(37) {
            self.received.extend_from_slice(piece);
            let received = std::mem::take(&mut self.received);
            let used = self.input(Input::Stream(&received));
            assert!(used <= received.len());
            self.received = received[used..].to_vec();
        }
    }

    pub(crate) fn input(&mut self, input: Input<'_>) -> usize {
        let mut said = Vec::new();
        let used = self
            .session
            .handle_input(self.now_ns, input, &mut |event| said.push(event));
        self.keep(said);
        used
    }

    fn keep(&mut self, said: Vec<PlanarEvent>) {
        for event in said {
            match event {
                PlanarEvent::Observed(observation) => {
                    self.observations.push((self.now_ns, observation));
                }
                PlanarEvent::Other(_) => {}
                PlanarEvent::Session(event) => self.events.push(event),
                PlanarEvent::Binding(binding) => self.bindings.push(binding),
            }
        }
    }

    /// The accepted poses since an observation, with the time of each.
    pub(crate) fn poses(&self, since: usize) -> Vec<(u64, PlanarPose)> {
        let valid = |(at_ns, observation): &(u64, Observation)| match observation.state {
            PoseState::Valid(pose) => Some((*at_ns, pose)),
            _ => None,
        };
        self.observations[since..]
            .iter()
            .filter_map(valid)
            .collect()
    }
}

/// With the name `t@r` as a server in Latin-1 would send it.
fn in_latin_1(bytes: &[u8]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    while let Some(at) = bytes.windows(3).position(|part| part == b"t@r") {
        bytes[at + 1] = 0xfc;
    }
    bytes
}
