//! The camera receiver: the session with the motion capture between its sockets and
//! the control loop.
//!
//! A state machine without a clock or a socket. The caller polls it when a datagram
//! waits or the returned deadline has passed.

use std::{
    net::SocketAddr,
    sync::{
        Arc,
        atomic::{AtomicI64, Ordering},
    },
};

use rtrb::Producer;
use singletrack_mocap::planar::{
    Observation, PlanarCounters, PlanarEvent, PlanarOutcome, PlanarSession, PoseState,
};

use crate::diagnosis::{CameraWatch, Diagnosis};

/// The longest datagram of UDP.
const LONGEST: usize = 65_535;

/// The largest number of datagrams of a socket in a poll: during a flood the receiver
/// must still detect silence and request the stream.
const DATAGRAMS: usize = 64;

/// The longest wait between two polls.
const IDLE_NS: u64 = 100_000_000;

/// Interval at which the counters are reported.
const COUNTERS_NS: u64 = 200_000_000;

/// A socket to the motion capture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Channel {
    /// Replies of the server, and frames if they are unicast.
    Command,
    /// Multicast frames.
    Data,
}

/// The sockets to the motion capture.
pub trait Sockets {
    /// Takes the next datagram that waits, without waiting.
    fn receive(&mut self, channel: Channel, buffer: &mut [u8]) -> Option<(usize, SocketAddr)>;

    /// Sends a datagram. The session repeats lost ones.
    fn send(&mut self, to: SocketAddr, bytes: &[u8]);
}

/// A report of the receiver.
#[derive(Clone, Debug)]
pub enum CameraReport {
    /// An observation of the car.
    Observation(Observation),
    /// The counters so far.
    Counters(PlanarCounters),
    /// What is wrong with the cameras, or that nothing is any more.
    Diagnosis(Diagnosis),
    /// Which other rigid body is near the car now: see [`Diagnosis::neighbour`].
    Neighbour(Option<String>),
}

/// The session with the cameras, which passes observations to the control loop.
#[derive(Debug)]
pub struct CameraReceiver {
    session: PlanarSession,
    stamp_offset_ns: Arc<AtomicI64>,
    observations: Producer<Observation>,
    reports: Producer<CameraReport>,
    buffer: Vec<u8>,
    watch: CameraWatch,
    is_stale: bool,
    last_frame: i32,
    counters_at_ns: u64,
    passed: u64,
    dropped: u64,
}

impl CameraReceiver {
    /// A receiver at the beginning of a session. Observations go to the control loop and,
    /// in `reports`, to the record. `stamp_offset_ns` replaces that of the session; it may
    /// change at any time.
    #[must_use]
    pub fn new(
        session: PlanarSession,
        stamp_offset_ns: Arc<AtomicI64>,
        observations: Producer<Observation>,
        reports: Producer<CameraReport>,
    ) -> Self {
        Self {
            session,
            stamp_offset_ns,
            observations,
            reports,
            buffer: vec![0; LONGEST],
            watch: CameraWatch::default(),
            is_stale: false,
            last_frame: 0,
            counters_at_ns: 0,
            passed: 0,
            dropped: 0,
        }
    }

    /// The counters of the session.
    #[must_use]
    pub const fn counters(&self) -> PlanarCounters {
        self.session.counters()
    }

    /// Observations passed to the control loop.
    #[must_use]
    pub const fn passed(&self) -> u64 {
        self.passed
    }

    /// Observations lost because the control loop's ring was full.
    #[must_use]
    pub const fn dropped(&self) -> u64 {
        self.dropped
    }

    /// Handles the received datagrams, sends those that are due, and reports silence.
    /// Returns the time of the next poll at the latest, in ns.
    pub fn poll(
        &mut self,
        clock: &impl Fn() -> u64,
        sockets: &mut impl Sockets,
        on_event: &mut impl FnMut(&PlanarEvent),
    ) -> u64 {
        let offset_ns = self.stamp_offset_ns.load(Ordering::Relaxed);
        self.session.set_stamp_offset_ns(offset_ns);
        let mut are_left = false;
        let mut watch = core::mem::take(&mut self.watch);
        let mut on_event = |event: &PlanarEvent| {
            watch.handle(event);
            on_event(event);
        };
        for channel in [Channel::Command, Channel::Data] {
            for taken in 1..=DATAGRAMS {
                let Some((length, source)) = sockets.receive(channel, &mut self.buffer) else {
                    break;
                };
                are_left |= taken == DATAGRAMS;
                let now_ns = clock();
                let datagram = self.buffer.get(..length).unwrap_or(&[]);
                if let PlanarOutcome::Frame(observation) =
                    self.session
                        .handle_datagram(now_ns, source, datagram, &mut |event| on_event(&event))
                {
                    self.is_stale = false;
                    self.last_frame = observation.frame_number;
                    self.observed(observation);
                }
            }
        }
        let now_ns = clock();
        self.session
            .handle_timeout(now_ns, &mut |event| on_event(&event));
        self.transmit(now_ns, sockets);
        let state = self.session.pose_state(now_ns);
        if matches!(state, PoseState::Stale { .. }) && !self.is_stale {
            self.is_stale = true;
            self.observed(Observation {
                frame_number: self.last_frame,
                receive_time_ns: now_ns,
                state,
            });
        }
        self.watch = watch;
        // A report without room is made again: the status must not keep a neighbour that has gone.
        if let Some((id, neighbour)) = self.watch.look_around(&self.session)
            && self
                .reports
                .push(CameraReport::Neighbour(neighbour))
                .is_ok()
        {
            self.watch.reported_neighbour(id);
        }
        if now_ns >= self.counters_at_ns {
            self.counters_at_ns = now_ns.saturating_add(COUNTERS_NS);
            if let Some(diagnosis) = self.watch.look(now_ns, &self.session) {
                // A lost report: the log lacks it, and the next cause is reported again.
                let _ = self.reports.push(CameraReport::Diagnosis(diagnosis));
            }
            // A lost report is superseded by the next.
            let _ = self
                .reports
                .push(CameraReport::Counters(self.session.counters()));
        }
        if are_left {
            return now_ns;
        }
        let idle_ns = now_ns.saturating_add(IDLE_NS).min(self.counters_at_ns);
        self.session.poll_timeout().unwrap_or(idle_ns).min(idle_ns)
    }

    /// Ends the session and sends the disconnect message.
    pub fn close(&mut self, clock: &impl Fn() -> u64, sockets: &mut impl Sockets) {
        self.session.close();
        self.transmit(clock(), sockets);
    }

    fn transmit(&mut self, now_ns: u64, sockets: &mut impl Sockets) {
        while let Some(datagram) = self.session.poll_transmit(now_ns) {
            sockets.send(datagram.destination, &datagram.bytes);
        }
    }

    fn observed(&mut self, observation: Observation) {
        // A report that finds no room is missing in the record only.
        let _ = self.reports.push(CameraReport::Observation(observation));
        match self.observations.push(observation) {
            Ok(()) => self.passed += 1,
            Err(_) => self.dropped += 1,
        }
    }
}
