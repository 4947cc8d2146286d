//! Why the cameras give no pose: the cause, and what to do about it.
//!
//! Counters show what arrives. [`Cameras`] names the likely cause in one word, which is the
//! same in status, log and documentation, and in a sentence with addresses and names.

use core::net::IpAddr;

use singletrack_api::Cameras;
use singletrack_mocap::{
    Binding, Phase, Protocol, RejectReason, SessionEvent, Transport, UpAxis,
    codec::DecodeError,
    planar::{NEAR_M, PlanarCounters, PlanarEvent, PlanarSession, PoseState},
};

/// The cause by itself.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Cause {
    Starting,
    Good,
    NoServer,
    OtherAddress(IpAddr),
    UnsupportedVersion,
    OtherTransport,
    NoFrames,
    /// The stamps do not advance, or go back.
    StampsStand,
    TwoSenders,
    UnreadableNames(DecodeError),
    NoSuchBody,
    AmbiguousBody(usize),
    BodyAbsent,
    Untracked,
    UpAxis,
    Rejected(RejectReason),
    /// The stamps are not by the clock that the server shows when it is asked.
    StampsOff,
    LatePoses,
    LowRate,
}

impl Cause {
    const fn word(self) -> &'static str {
        match self {
            Self::Starting => "starting",
            Self::Good => "good",
            Self::NoServer => "no-server",
            Self::OtherAddress(_) => "other-address",
            Self::UnsupportedVersion => "unsupported-version",
            Self::OtherTransport => "other-transport",
            Self::NoFrames => "no-frames",
            Self::StampsStand | Self::StampsOff => "wrong-clock",
            Self::TwoSenders => "two-senders",
            Self::UnreadableNames(_) => "unreadable-names",
            Self::NoSuchBody => "no-such-body",
            Self::AmbiguousBody(_) => "ambiguous-body",
            Self::BodyAbsent => "body-absent",
            Self::Untracked => "untracked",
            Self::UpAxis => "up-axis",
            Self::Rejected(_) => "rejected",
            Self::LatePoses => "late-poses",
            Self::LowRate => "low-rate",
        }
    }

    /// Whether poses arrive, good ones or not.
    const fn delivers(self) -> bool {
        matches!(self, Self::Good | Self::LatePoses | Self::LowRate)
    }

    const fn is_silence(self) -> bool {
        matches!(
            self,
            Self::NoServer | Self::NoFrames | Self::OtherTransport | Self::StampsStand
        )
    }

    /// How long it must last before it is reported, ns: frames may pause, and a session
    /// negotiates for up to 2.5 s.
    const fn patience_ns(self) -> u64 {
        match self {
            Self::Starting | Self::Good | Self::TwoSenders => 0,
            Self::NoServer | Self::NoFrames | Self::OtherTransport => 3_000_000_000,
            _ => 1_000_000_000,
        }
    }
}

/// Reports over which the counters are compared: a second.
const WINDOW: usize = 5;

/// An older pose has a stamp of another clock, ns: no network and no camera takes as long.
const ANOTHER_CLOCK_NS: u64 = 1_000_000_000;

/// After poses, silence is reported when it has lasted for this time beyond the window, ns.
const STOPPED_NS: u64 = 1_000_000_000;

/// A look at the session.
#[derive(Clone, Copy, Debug, Default)]
struct Look {
    at_ns: u64,
    counters: PlanarCounters,
    /// The age of the newest good pose when it arrived.
    age_ns: Option<u64>,
}

/// What the last looks say of the poses.
#[derive(Clone, Copy, Debug, Default)]
struct Measured {
    /// Frames a second; none at the beginning.
    rate_hz: Option<f64>,
    /// The least age of a good pose at its arrival, ns.
    age_ns: Option<u64>,
    /// Whether most frames were no newer than the one before.
    repeats: bool,
}

/// Watches a session, and says what is wrong with it.
#[derive(Debug, Default)]
pub(crate) struct CameraWatch {
    /// The age up to which a pose may be driven by, ns.
    fresh_ns: u64,
    /// The last looks, oldest first.
    past: heapless::Deque<Look, WINDOW>,
    measured: Measured,
    /// The cause found last, and since when.
    found: Option<(Cause, u64)>,
    /// The cause reported last, and when.
    reported: Option<(Cause, u64)>,
    wrong_transport: bool,
}

impl CameraWatch {
    /// For a car that is armed with poses that are no older than this, in s.
    pub(crate) fn new(fresh: f64) -> Self {
        Self {
            fresh_ns: (1e9 * fresh) as u64,
            ..Self::default()
        }
    }

    pub(crate) fn handle(&mut self, event: &PlanarEvent) {
        match event {
            PlanarEvent::Session(SessionEvent::TransportMismatch { .. }) => {
                self.wrong_transport = true;
            }
            PlanarEvent::Session(SessionEvent::Restarted(_)) => self.wrong_transport = false,
            _ => {}
        }
    }

    /// Looks at the session, about five times a second. Returns a diagnosis when it changes.
    pub(crate) fn look(&mut self, now_ns: u64, session: &PlanarSession) -> Option<Cameras> {
        let counters = session.counters();
        let before = self.past.front().copied().unwrap_or_default();
        if self.past.is_full() {
            self.past.pop_front();
        }
        let age_ns = match session.pose_state(now_ns) {
            PoseState::Valid(pose) => {
                Some(pose.receive_time_ns.saturating_sub(pose.capture_time_ns))
            }
            _ => None,
        };
        // There is room: see above.
        let _ = self.past.push_back(Look {
            at_ns: now_ns,
            counters,
            age_ns,
        });
        let frames = counters.session.frames - before.counters.session.frames;
        let old = |it: &PlanarCounters| it.session.duplicates + it.session.late;
        let seconds = now_ns.saturating_sub(before.at_ns) as f64 * 1e-9;
        self.measured = Measured {
            rate_hz: self.past.is_full().then(|| frames as f64 / seconds),
            age_ns: self.past.iter().filter_map(|look| look.age_ns).min(),
            repeats: old(&counters) - old(&before.counters) > frames,
        };
        let cause = self.cause(now_ns, session, &before.counters, &counters);
        let since_ns = match self.found {
            // Details, such as the newest reason of a rejection, may alternate. A server that has
            // gone sends no frames at first, and then does not answer.
            Some((found, since_ns))
                if found.word() == cause.word() || (found.is_silence() && cause.is_silence()) =>
            {
                since_ns
            }
            _ => now_ns,
        };
        self.found = Some((cause, since_ns));
        let has_stopped = cause.is_silence() && self.reported.is_some_and(|(it, _)| it.delivers());
        let patience_ns = if has_stopped {
            STOPPED_NS
        } else {
            cause.patience_ns()
        };
        let has_lasted = |since_ns: u64| now_ns.saturating_sub(since_ns) >= patience_ns;
        let is_news = match self.reported {
            Some((reported, _)) if reported == cause => false,
            // Other details of the same word: not more often than its patience.
            Some((reported, at_ns)) if reported.word() == cause.word() => has_lasted(at_ns),
            _ => true,
        };
        if !is_news || !has_lasted(since_ns) {
            return None;
        }
        self.reported = Some((cause, now_ns));
        Some(Cameras {
            diagnosis: cause.word().into(),
            text: describe(cause, session, &self.measured),
            neighbour: neighbour(session),
        })
    }

    fn cause(
        &self,
        now_ns: u64,
        session: &PlanarSession,
        before: &PlanarCounters,
        counters: &PlanarCounters,
    ) -> Cause {
        let grew = |count: fn(&PlanarCounters) -> u64| count(counters) > count(before);
        if session.source().is_contradicted(now_ns) {
            return Cause::TwoSenders;
        }
        if !grew(|counters| counters.session.frames) {
            return match (session.source().phase(), session.source().other_source()) {
                (Phase::Refused(_) | Phase::Foreign, _) => Cause::UnsupportedVersion,
                (_, Some(address)) if grew(|counters| counters.session.wrong_source) => {
                    Cause::OtherAddress(address)
                }
                (Phase::Streaming(_), _) if self.wrong_transport => Cause::OtherTransport,
                (Phase::Open, _)
                    if grew(|counters| counters.session.duplicates + counters.session.late) =>
                {
                    Cause::StampsStand
                }
                // Without frames of the body, VRPN still has names.
                (Phase::Open, _) => match session.tracker().binding {
                    Binding::Missing => Cause::NoSuchBody,
                    _ => Cause::NoFrames,
                },
                (Phase::Streaming(_), _) => Cause::NoFrames,
                _ => Cause::NoServer,
            };
        }
        match session.tracker().binding {
            Binding::Missing => return Cause::NoSuchBody,
            Binding::Ambiguous { count } => return Cause::AmbiguousBody(count),
            Binding::Unresolved => {
                return match session.source().unreadable() {
                    Some(error) => Cause::UnreadableNames(error),
                    // They are on their way.
                    None => Cause::Starting,
                };
            }
            Binding::Bound { .. } => {}
        }
        let is_seen = grew(|counters| counters.valid + counters.rejected.total());
        let level = session.tracker().level.filter(|_| is_seen);
        if level.is_some_and(|level| level.suggests_other_axis()) {
            return Cause::UpAxis;
        }
        if grew(|counters| counters.valid) {
            return self.quality();
        }
        match session.pose_state(now_ns) {
            // Where two senders are at work, that was found above.
            PoseState::Rejected(RejectReason::CaptureTime)
            | PoseState::LockedOut(RejectReason::CaptureTime) => Cause::StampsOff,
            PoseState::Rejected(reason) | PoseState::LockedOut(reason) => Cause::Rejected(reason),
            PoseState::Untracked => Cause::Untracked,
            PoseState::Absent => Cause::BodyAbsent,
            _ => Cause::Starting,
        }
    }

    /// What is wrong with poses that arrive.
    fn quality(&self) -> Cause {
        let age_ns = self.measured.age_ns.unwrap_or_default();
        let Some(rate_hz) = self.measured.rate_hz.filter(|hz| *hz > 0.0) else {
            return Cause::Good;
        };
        // How old a pose is when the next one replaces it.
        let period_ns = (1e9 / rate_hz) as u64;
        match age_ns.saturating_add(period_ns) {
            _ if self.measured.repeats => Cause::StampsStand,
            _ if age_ns >= ANOTHER_CLOCK_NS => Cause::StampsOff,
            oldest_ns if oldest_ns <= self.fresh_ns => Cause::Good,
            _ if age_ns >= period_ns => Cause::LatePoses,
            _ => Cause::LowRate,
        }
    }
}

/// The other rigid body near the car, in words.
pub(crate) fn neighbour(session: &PlanarSession) -> Option<String> {
    let id = session.tracker().neighbour?.id;
    let car = &session.config().rigid_body;
    let name = session.tracker().names.name(id).unwrap_or("without a name");
    Some(format!(
        "the rigid body {name} (streaming id {id}) is within {NEAR_M} m of {car:?}: were its markers \
         taken for the car's?"
    ))
}

fn describe(cause: Cause, session: &PlanarSession, measured: &Measured) -> String {
    let (config, rigid_body) = (&session.config().session, &session.config().rigid_body);
    let server = config.server;
    match cause {
        Cause::Starting if config.protocol == Protocol::Qualisys => {
            "waiting for a list of bodies that fits the frames: are all bodies of the project \
             tracked?"
                .to_owned()
        }
        Cause::Starting => "waiting for the rigid bodies of the server".to_owned(),
        Cause::Good => "poses arrive".to_owned(),
        Cause::NoServer
            if session.stream().is_some() && session.counters().session.restarts > 0 =>
        {
            format!(
                "what is at motion_capture.server = {server}, TCP port {}, accepts connections and \
                 ends them, or has gone: is it the right program, and does it run?",
                config.command_port
            )
        }
        Cause::NoServer => format!(
            "nothing comes from motion_capture.server = {server}: is the address right, the \
             program running there with streaming on, the cable plugged in, {} port {} open in \
             both firewalls?",
            match config.protocol {
                Protocol::NatNet => "UDP",
                Protocol::Vrpn { .. } | Protocol::Qualisys => "TCP",
            },
            config.command_port
        ),
        Cause::OtherAddress(address) => format!(
            "packets come from {address}, not from motion_capture.server = {server}: the server \
             probably has a second network card; set motion_capture.server = \"{address}\" if \
             that is its address, or choose the network in the server's streaming settings"
        ),
        Cause::UnsupportedVersion if session.source().phase() == Phase::Foreign => format!(
            "what answers at {server}, TCP port {}, says nothing or is no {}: look at motion_capture.kind and \
             command_port",
            config.command_port,
            match config.protocol {
                Protocol::Vrpn { .. } => "VRPN server of version 07",
                Protocol::NatNet | Protocol::Qualisys => "QTM server of version 1.13 or later",
            }
        ),
        Cause::UnsupportedVersion => {
            "the server's bitstream is not supported; set motion_capture.bitstream = \"4.1\", or \
             update the server"
                .to_owned()
        }
        Cause::OtherTransport => {
            "the server streams with the other transport, unicast or multicast; change \
             motion_capture.transport or the server's setting"
                .to_owned()
        }
        Cause::NoFrames if config.protocol != Protocol::NatNet => {
            let on_udp = if config.transport == Transport::Stream {
                ""
            } else {
                "; where UDP from the server is closed, TCP is tried after 1.5 s"
            };
            format!(
                "the server at {server} answers and sends no poses of {rigid_body:?}: do the \
                 cameras see it, and is a measurement running{on_udp}?"
            )
        }
        Cause::NoFrames => format!(
            "the server at {server} answered and sends no frames: does it run and stream? Open \
             UDP port 1511 (motion_capture.data_port) if frames are multicast"
        ),
        Cause::StampsStand => format!(
            "the server at {server} sends poses whose stamps repeat or go back, so that few or \
             none are newer than the last: it must stamp each with the time of its exposure, in microseconds"
        ),
        Cause::StampsOff => {
            let age = match measured.age_ns {
                Some(age_ns) if age_ns >= ANOTHER_CLOCK_NS => {
                    format!("{:.0} s before they arrive", age_ns as f64 * 1e-9)
                }
                _ => "out of order, after their arrival, or long before it".to_owned(),
            };
            format!(
                "the stamps of the frames from {server} say that they were exposed {age}: the server \
                 must stamp by the clock that it answers with (VRPN: UTC, not the local time, nor \
                 that of another computer); see timing.stamp_offset_ms"
            )
        }
        Cause::LatePoses | Cause::LowRate => {
            let age_ms = measured.age_ns.unwrap_or_default() as f64 * 1e-6;
            let advice = match cause {
                Cause::LatePoses => "lower the latency of cameras, their program and network",
                _ => {
                    "raise the cameras' frame rate (100 Hz is best), and look whether frames get lost"
                }
            };
            format!(
                "poses come at {:.0} Hz and are {age_ms:.0} ms old then: arming wants at most \
                 supervisor.fresh_ms with the pause to the next one; {advice}",
                measured.rate_hz.unwrap_or_default()
            )
        }
        Cause::UnreadableNames(error) => format!(
            "the server's list of rigid bodies can't be read: {error}; remove the asset that it is \
             about, or set motion_capture.bitstream"
        ),
        Cause::TwoSenders => format!(
            "frames from {server} contradict each other: another program sends with the server's \
             address, and no pose is used; give the cameras a network of their own"
        ),
        Cause::NoSuchBody => {
            let names = &session.tracker().names;
            if names.is_empty() {
                format!(
                    "the server has no rigid body; define one named {rigid_body:?} and stream it"
                )
            } else {
                let unreadable = session
                    .source()
                    .unreadable()
                    .map_or_else(String::new, |error| {
                        format!("; a body that is not listed can't be read: {error}")
                    });
                format!(
                    "motion_capture.rigid_body = {rigid_body:?} is not among the server's rigid \
                     bodies {names}; check spelling and case, and that it is streamed{unreadable}"
                )
            }
        }
        Cause::AmbiguousBody(count) => format!(
            "{count} rigid bodies of the server have the name {rigid_body:?}; rename all but one"
        ),
        Cause::BodyAbsent => format!(
            "{rigid_body:?} is defined and is not in the frames; switch on that it is streamed"
        ),
        Cause::Untracked => format!(
            "the cameras do not see {rigid_body:?}: more markers, a better view, or a new \
             calibration"
        ),
        Cause::UpAxis => {
            let (configured, other) = match config.up_axis {
                UpAxis::Y => ("y", "z"),
                UpAxis::Z => ("z", "y"),
            };
            let level = session.tracker().level.map_or_else(String::new, |level| {
                format!(
                    ": height {:.2} m and tilt {:.0} degrees; with {other:?} they are {:.2} m and \
                     {:.0} degrees",
                    level.height_m,
                    level.tilt_rad.to_degrees(),
                    level.other_height_m,
                    level.other_tilt_rad.to_degrees()
                )
            });
            format!(
                "motion_capture.up_axis = {configured:?} makes no sense of the pose{level}; it is \
                 probably {other:?}"
            )
        }
        Cause::Rejected(reason) => format!(
            "poses of {rigid_body:?} arrive and are rejected: {}; see docs/reasons.md",
            reason.name()
        ),
    }
}
