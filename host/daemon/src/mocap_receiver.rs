//! The thread of the camera receiver: waits for datagrams, polls, and logs.

use std::{thread::Thread, time::Duration};

use singletrack_core::{cameras::CameraReceiver, config::MotionCaptureSection};
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

/// Lines that the cameras may write to the log in a span of time: a server that is out of order
/// must not fill it.
const LINES: u32 = 20;
const SPAN_NS: u64 = 10_000_000_000;

/// What is left of them.
#[derive(Debug, Default)]
struct LogBudget {
    since_ns: u64,
    lines: u32,
}

impl LogBudget {
    /// Whether a line may be written; the last one says that no other follows.
    fn allows(&mut self, now_ns: u64) -> bool {
        if now_ns.saturating_sub(self.since_ns) >= SPAN_NS {
            (self.since_ns, self.lines) = (now_ns, 0);
        }
        self.lines = self.lines.saturating_add(1);
        if self.lines == LINES {
            warn!("motion capture: more of this is not logged for some seconds");
        }
        self.lines < LINES
    }
}

/// How often a stream that is being opened is looked at.
const OPENING: Duration = Duration::from_millis(5);

/// Runs until `stop` is raised, and wakes `control` for every observation. Returns the counters,
/// and the number of observations that found no room in the ring to the control loop.
pub(crate) fn run(
    mut receiver: CameraReceiver,
    mut sockets: MocapSockets,
    config: &MotionCaptureSection,
    stop: &StopFlag,
    control: &Thread,
) -> (PlanarCounters, u64) {
    let mut budget = LogBudget::default();
    let mut passed = 0;
    loop {
        let until_ns = receiver.poll(&monotonic_ns, &mut sockets, &mut |event| {
            if budget.allows(monotonic_ns()) {
                log(event, config);
            }
        });
        if receiver.passed != passed {
            passed = receiver.passed;
            control.unpark();
        }
        let mut wait = Duration::from_nanos(until_ns.saturating_sub(monotonic_ns()));
        if sockets.is_opening() {
            wait = wait.min(OPENING);
        }
        if stop.wait(&sockets.files(), wait) == Woken::Stop {
            receiver.close(&monotonic_ns, &mut sockets);
            return (receiver.counters(), receiver.dropped);
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
        PlanarEvent::Session(SessionEvent::Opened) => info!("motion capture connected"),
        PlanarEvent::Session(SessionEvent::Foreign) => warn!(
            server = %config.server, port = config.port(), kind = config.kind.name(),
            "what answers speaks another protocol or an unsupported version of it: look at \
             motion_capture.kind and command_port"
        ),
        PlanarEvent::Session(SessionEvent::DatagramsBlocked) => warn!(
            "poses come over TCP, because none arrive over UDP: open UDP from the server in this \
             computer's firewall, or set motion_capture.transport = \"tcp\""
        ),
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
        // The diagnosis names the server's bodies.
        PlanarEvent::Binding(Binding::Missing | Binding::Ambiguous { .. }) => {}
        PlanarEvent::Session(SessionEvent::OtherSource(address)) => warn!(
            %address, server = %config.server,
            "packets from another address than motion_capture.server are ignored"
        ),
        PlanarEvent::Session(SessionEvent::DefinitionsUnreadable(error)) => warn!(
            %error,
            "a part of the server's list of bodies can't be read; the others are known"
        ),
        PlanarEvent::Session(SessionEvent::Contradicted) => warn!(
            server = %config.server,
            "frames contradict each other: another program sends with the server's address"
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
    use super::*;

    #[test]
    fn a_server_that_is_out_of_order_writes_few_lines_and_is_heard_again_later() {
        let mut budget = LogBudget::default();
        let lines =
            |budget: &mut LogBudget, now_ns| (0..1_000).filter(|_| budget.allows(now_ns)).count();
        assert_eq!(lines(&mut budget, SPAN_NS), 19);
        assert_eq!(lines(&mut budget, 2 * SPAN_NS - 1), 0);
        assert_eq!(lines(&mut budget, 2 * SPAN_NS), 19);
    }
}
