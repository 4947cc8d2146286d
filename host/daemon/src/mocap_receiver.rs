//! The thread of the camera receiver: waits for datagrams, polls, and logs.

use std::{net::SocketAddr, time::Duration};

use singletrack_core::{
    cameras::{CameraReceiver, Channel, Sockets},
    config::MotionCaptureSection,
};
use singletrack_mocap::{
    Binding, SessionEvent,
    planar::{PlanarCounters, PlanarEvent},
};
use tracing::{info, warn};

use crate::{
    clock::monotonic_ns,
    mocap_socket::MocapSockets,
    wake::{StopFlag, Woken},
};

/// The time without an answer after which the server is reported, in ns.
///
/// Longer than the 2.5 s for which a session negotiates the bitstream.
const ANSWER_TIMEOUT_NS: u64 = 3_000_000_000;

/// The sockets, with a log of the server's reachability.
struct LoggedSockets {
    sockets: MocapSockets,
    is_reachable: bool,
}

impl Sockets for LoggedSockets {
    fn receive(&mut self, channel: Channel, buffer: &mut [u8]) -> Option<(usize, SocketAddr)> {
        self.sockets.receive(channel, buffer)
    }

    fn send(&mut self, to: SocketAddr, bytes: &[u8]) {
        let result = self.sockets.send(to, bytes);
        if let Err(error) = &result
            && self.is_reachable
        {
            warn!(server = %to, %error, "can't send to motion_capture.server");
        }
        self.is_reachable = result.is_ok();
    }
}

/// Detects a server that does not answer, once for each time that the session connects.
#[derive(Clone, Copy, Debug)]
struct AnswerWatch {
    /// Since when the session has been waiting for the first answer; `None` once it has
    /// come or its absence is reported.
    waiting_since_ns: Option<u64>,
}

impl AnswerWatch {
    const fn new(now_ns: u64) -> Self {
        Self {
            waiting_since_ns: Some(now_ns),
        }
    }

    const fn handle(&mut self, now_ns: u64, event: &PlanarEvent) {
        match event {
            PlanarEvent::Session(SessionEvent::Connected(_) | SessionEvent::Refused(_)) => {
                self.waiting_since_ns = None;
            }
            PlanarEvent::Session(SessionEvent::Restarted(_)) => {
                self.waiting_since_ns = Some(now_ns);
            }
            _ => {}
        }
    }

    /// True once, [`ANSWER_TIMEOUT_NS`] after the session began to wait.
    fn has_timed_out(&mut self, now_ns: u64) -> bool {
        let timed_out = |since: &mut u64| now_ns.saturating_sub(*since) >= ANSWER_TIMEOUT_NS;
        self.waiting_since_ns.take_if(timed_out).is_some()
    }
}

/// Runs until `stop` is raised. Returns the counters, and the number of observations that
/// found no room in the ring to the control loop.
pub(crate) fn run(
    mut receiver: CameraReceiver,
    sockets: MocapSockets,
    config: &MotionCaptureSection,
    stop: &StopFlag,
) -> (PlanarCounters, u64) {
    let mut sockets = LoggedSockets {
        sockets,
        is_reachable: true,
    };
    let mut answers = AnswerWatch::new(monotonic_ns());
    loop {
        let until_ns = receiver.poll(&monotonic_ns, &mut sockets, &mut |event| {
            answers.handle(monotonic_ns(), event);
            log(event, config);
        });
        if answers.has_timed_out(monotonic_ns()) {
            warn!(
                server = %config.server,
                command_port = config.command_port,
                "motion_capture.server does not answer; requests go on"
            );
        }
        let wait = Duration::from_nanos(until_ns.saturating_sub(monotonic_ns()));
        if stop.wait(&sockets.sockets.files(), wait) == Woken::Stop {
            receiver.close(&monotonic_ns, &mut sockets);
            return (receiver.counters(), receiver.dropped());
        }
    }
}

fn log(event: &PlanarEvent, config: &MotionCaptureSection) {
    let name = config.rigid_body.as_str();
    match event {
        PlanarEvent::Session(SessionEvent::Connected(connected)) => {
            info!(
                bitstream = %connected.version,
                camera_clock = connected.has_camera_clock,
                "motion capture connected"
            );
        }
        PlanarEvent::Session(SessionEvent::Refused(version)) => warn!("motion capture: {version}"),
        PlanarEvent::Session(SessionEvent::BitstreamKept { requested, kept }) => warn!(
            %requested, %kept,
            "motion_capture.server keeps its own bitstream, which is decoded instead"
        ),
        PlanarEvent::Session(SessionEvent::TransportMismatch { server_multicast }) => warn!(
            server_multicast,
            "motion_capture.transport differs from the server's: frames may not arrive"
        ),
        PlanarEvent::Binding(Binding::Bound { id }) => info!(name, id, "rigid body found"),
        PlanarEvent::Binding(Binding::Missing) => warn!(
            name,
            "motion_capture.rigid_body is not among the server's rigid bodies; check its spelling \
             and that the server streams it"
        ),
        PlanarEvent::Binding(Binding::Ambiguous { count }) => warn!(
            name,
            count, "several of the server's rigid bodies have the name motion_capture.rigid_body"
        ),
        PlanarEvent::Binding(Binding::Unresolved) => {
            info!(name, "the server's rigid bodies are requested again");
        }
        PlanarEvent::Session(SessionEvent::Stale) => {
            warn!("frames of the motion capture have stopped");
        }
        PlanarEvent::Session(SessionEvent::Restarted(reason)) => {
            warn!(?reason, "motion capture reconnects");
        }
        event => info!(?event, "motion capture"),
    }
}

#[cfg(test)]
mod tests {
    use singletrack_mocap::{RestartReason, codec::BitstreamVersion};

    use super::*;

    #[test]
    fn a_silent_server_is_reported_once_per_connection_and_an_answer_prevents_it() {
        let mut watch = AnswerWatch::new(1_000);
        assert!(!watch.has_timed_out(ANSWER_TIMEOUT_NS + 999));
        assert!(watch.has_timed_out(ANSWER_TIMEOUT_NS + 1_000));
        assert!(!watch.has_timed_out(u64::MAX), "reported before");

        let restarted_event = PlanarEvent::Session(SessionEvent::Restarted(RestartReason::Silence));
        let restarted = 10 * ANSWER_TIMEOUT_NS;
        watch.handle(restarted, &restarted_event);
        assert!(!watch.has_timed_out(restarted + ANSWER_TIMEOUT_NS - 1));
        watch.handle(restarted, &PlanarEvent::Session(SessionEvent::Stale));
        assert!(watch.has_timed_out(restarted + ANSWER_TIMEOUT_NS));

        watch.handle(0, &restarted_event);
        let refused = BitstreamVersion::new(1, 0).unwrap_err();
        let answer = PlanarEvent::Session(SessionEvent::Refused(refused));
        watch.handle(1, &answer);
        assert!(!watch.has_timed_out(u64::MAX), "answered");
    }
}
