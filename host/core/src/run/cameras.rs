//! The cameras' packets on their way to the tick: the car's poses, and the other bodies.

use std::{
    net::SocketAddr,
    sync::{
        Arc,
        atomic::{AtomicI64, Ordering},
    },
};

use heapless::Deque;
use rtrb::Producer;
use singletrack_control::{MAX_NEIGHBOURS, NeighbourSample, Position, Time};
use singletrack_mocap::{
    BodyNames, Input, LocalEnd, Stream,
    planar::{Observation, OtherBody, PlanarCounters, PlanarEvent, PlanarSession, PoseState},
};

use crate::{
    config::NeighboursSection,
    diagnosis::{CameraWatch, neighbour},
};

/// The longest datagram of UDP.
const LONGEST: usize = 65_535;

/// The largest number of datagrams of a socket in a poll: during a flood the receiver
/// must still detect silence and request the stream.
const DATAGRAMS: usize = 64;

/// The largest number of events of a stream in a poll, for the same reason.
const STREAM_EVENTS: usize = 16;

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

    /// Opens, keeps or closes the stream, without waiting, and says what happened to it. Received
    /// bytes are appended to `received`.
    fn stream(&mut self, _wanted: Option<Stream>, _received: &mut Vec<u8>) -> StreamEvent {
        StreamEvent::Nothing
    }

    /// Writes to the open stream.
    fn write_stream(&mut self, _bytes: &[u8]) {}
}

/// What happened to a stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StreamEvent {
    /// Nothing since the last question.
    Nothing,
    /// It is open.
    Opened(LocalEnd),
    /// Bytes have arrived.
    Received,
    /// It could not be opened, or has ended.
    Closed,
}

/// A report of the receiver.
#[derive(Clone, Debug)]
pub enum CameraReport {
    /// An observation of the car.
    Observation(Observation),
    /// The counters so far.
    Counters(PlanarCounters),
    /// What is wrong with the cameras, or that nothing is any more.
    Diagnosis(singletrack_api::Cameras),
    /// Which other rigid body is near the car now: see [`singletrack_api::Cameras::neighbour`].
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
    /// What arrived on the stream and was not used.
    stream: Vec<u8>,
    /// Observations of a poll, oldest first.
    fresh: Vec<Observation>,
    /// Passes other bodies on; none if nobody asks for them.
    neighbours: Option<NeighbourFeed>,
    /// Other bodies of a poll.
    others: Vec<OtherBody>,
    watch: CameraWatch,
    /// The other rigid body near the car that was reported last.
    near: Option<i32>,
    is_stale: bool,
    last_frame: i32,
    counters_at_ns: u64,
    /// Observations passed to the control loop.
    pub passed: u64,
    /// Observations lost because the control loop's ring was full.
    pub dropped: u64,
}

impl CameraReceiver {
    /// A receiver at the beginning of a session. Observations go to the control loop and,
    /// in `reports`, to the record; other bodies to `neighbours`. `stamp_offset_ns` replaces that
    /// of the session; it may change at any time. The car is armed with poses that are no older
    /// than `fresh`, in s.
    pub fn new(
        session: PlanarSession,
        stamp_offset_ns: Arc<AtomicI64>,
        observations: Producer<Observation>,
        reports: Producer<CameraReport>,
        neighbours: Option<NeighbourFeed>,
        fresh: f64,
    ) -> Self {
        Self {
            session,
            stamp_offset_ns,
            observations,
            reports,
            buffer: vec![0; LONGEST],
            stream: Vec::new(),
            fresh: Vec::with_capacity(2 * DATAGRAMS),
            neighbours,
            others: Vec::new(),
            watch: CameraWatch::new(fresh),
            near: None,
            is_stale: false,
            last_frame: 0,
            counters_at_ns: 0,
            passed: 0,
            dropped: 0,
        }
    }

    /// The counters of the session.
    pub fn counters(&self) -> PlanarCounters {
        self.session.counters()
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
        let mut fresh = core::mem::take(&mut self.fresh);
        let mut on_event = |event: PlanarEvent| match event {
            PlanarEvent::Observed(observation) => fresh.push(observation),
            PlanarEvent::Other(other) => self.others.push(other),
            event => {
                self.watch.handle(&event);
                on_event(&event);
            }
        };
        for channel in [Channel::Command, Channel::Data] {
            for taken in 1..=DATAGRAMS {
                let Some((length, source)) = sockets.receive(channel, &mut self.buffer) else {
                    break;
                };
                are_left |= taken == DATAGRAMS;
                let bytes = self.buffer.get(..length).unwrap_or(&[]);
                let input = Input::Datagram { source, bytes };
                self.session.handle_input(clock(), input, &mut on_event);
            }
        }
        let wanted = self.session.stream();
        for taken in 1..=STREAM_EVENTS {
            let event = sockets.stream(self.session.stream(), &mut self.stream);
            are_left |= taken == STREAM_EVENTS;
            let input = match event {
                StreamEvent::Nothing => break,
                StreamEvent::Received => {
                    let input = Input::Stream(&self.stream);
                    let used = self.session.handle_input(clock(), input, &mut on_event);
                    self.stream.drain(..used.min(self.stream.len()));
                    continue;
                }
                StreamEvent::Opened(local) => Input::Opened(local),
                StreamEvent::Closed => Input::Closed,
            };
            self.stream.clear();
            self.session.handle_input(clock(), input, &mut on_event);
        }
        let now_ns = clock();
        self.session.handle_timeout(now_ns, &mut on_event);
        // Another stream is opened by the next poll.
        are_left |= self.session.stream() != wanted;
        // They are there before the pose that begins a tick.
        if let (Some(neighbours), Some(newest)) = (&mut self.neighbours, fresh.last()) {
            let (own, names) = (
                self.session.tracker().binding.id(),
                &self.session.tracker().names,
            );
            neighbours.pass(newest.receive_time_ns, own, &self.others, names);
        }
        self.others.clear();
        for observation in fresh.drain(..) {
            self.is_stale = false;
            self.last_frame = observation.frame_number;
            self.observed(observation);
        }
        self.fresh = fresh;
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
        let near = self.session.tracker().neighbour.map(|other| other.id);
        if near != self.near {
            let report = CameraReport::Neighbour(neighbour(&self.session));
            // One without room is made again: the status must not keep a neighbour that has gone.
            if self.reports.push(report).is_ok() {
                self.near = near;
            }
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

    /// Ends the session: sends the disconnect message, closes the stream.
    pub fn close(&mut self, clock: &impl Fn() -> u64, sockets: &mut impl Sockets) {
        self.session.close();
        self.transmit(clock(), sockets);
        sockets.stream(None, &mut self.stream);
    }

    fn transmit(&mut self, now_ns: u64, sockets: &mut impl Sockets) {
        while let Some(transmit) = self.session.poll_transmit(now_ns) {
            if transmit.on_stream {
                sockets.write_stream(&transmit.bytes);
            } else {
                sockets.send(transmit.destination, &transmit.bytes);
            }
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

/// Passes the bodies of the frames on: all but those whose names are ignored, and those that are
/// expected also while the cameras do not list them. Of these, the ones with a higher number
/// yield to this car.
#[derive(Debug)]
pub struct NeighbourFeed {
    /// Quoted, as in [`BodyNames`].
    expected: Vec<String>,
    ignored: Vec<String>,
    samples: Producer<NeighbourSample>,
}

impl NeighbourFeed {
    pub(crate) fn new(section: &NeighboursSection, samples: Producer<NeighbourSample>) -> Self {
        let quoted = |names: &[String]| names.iter().map(|name| format!("{name:?}")).collect();
        Self {
            expected: quoted(&section.expected),
            ignored: quoted(&section.ignored),
            samples,
        }
    }

    /// Frames of which the last one arrived at `received_ns`, with the other bodies of all.
    /// `own` is the number of the car's body.
    pub(crate) fn pass(
        &mut self,
        received_ns: u64,
        own: Option<i32>,
        others: &[OtherBody],
        names: &BodyNames,
    ) {
        let is_among = |id, list: &[String]| {
            let name = names.name(id);
            name.is_some_and(|name| list.iter().any(|listed| listed == name))
        };
        // Both cars of a pair know both numbers.
        let yields = |id| own.is_some_and(|own| own < id) && is_among(id, &self.expected);
        let seen = others
            .iter()
            .filter(|other| !is_among(other.id, &self.ignored));
        let seen = seen.map(|other| NeighbourSample {
            id: other.id,
            capture: Time(other.capture_time_ns),
            position: other.position_m.map(Position::from),
            yields: yields(other.id),
        });
        // A body without a number has one that no server gives.
        let expected = (1..).zip(&self.expected);
        let expected = expected.map(|(number, name)| names.id(name).unwrap_or(-number));
        let lost = expected.filter(|id| others.iter().all(|other| other.id != *id));
        let lost = lost.map(|id| NeighbourSample {
            id,
            capture: Time(received_ns),
            position: None,
            yields: yields(id),
        });
        for sample in seen.chain(lost) {
            // One without room is as one that was not seen.
            let _ = self.samples.push(sample);
        }
    }
}

/// The newest sample of each body that the pilot has not been given.
#[derive(Clone, Debug, Default)]
pub(crate) struct NewestSamples(Deque<NeighbourSample, MAX_NEIGHBOURS>);

impl NewestSamples {
    pub(crate) fn add(&mut self, sample: NeighbourSample) {
        match self.0.iter_mut().find(|newest| newest.id == sample.id) {
            Some(newest) => *newest = sample,
            // One without room comes again with the next frame.
            None => drop(self.0.push_back(sample)),
        }
    }

    /// The one that has waited for longest.
    pub(crate) fn take(&mut self) -> Option<NeighbourSample> {
        self.0.pop_front()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(id: i32, capture: u64) -> NeighbourSample {
        NeighbourSample {
            id,
            capture: Time(capture),
            position: None,
            yields: false,
        }
    }

    #[test]
    fn the_newest_of_each_body_waits_where_its_first_one_did() {
        let mut samples = NewestSamples::default();
        for (id, capture) in [(1, 10), (2, 10), (1, 20)] {
            samples.add(sample(id, capture));
        }
        assert_eq!(samples.take(), Some(sample(1, 20)));
        for id in 3..=MAX_NEIGHBOURS as i32 + 9 {
            samples.add(sample(id, 30));
        }
        let taken = core::iter::from_fn(|| samples.take()).count();
        assert_eq!(taken, MAX_NEIGHBOURS);
    }
}
