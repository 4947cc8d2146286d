//! The thread that talks to the motion capture.

use std::time::Duration;

use rtrb::Producer;
use singletrack_mocap::planar::{
    Observation, PlanarCounters, PlanarEvent, PlanarOutcome, PlanarSession, PoseState,
};
use singletrack_mocap::{Binding, SessionEvent};
use tracing::{info, warn};

use crate::{
    clock::monotonic_ns,
    mocap_socket::{Channel, MocapSockets},
    wake::{StopFlag, Woken},
};

/// The longest datagram of UDP.
const LONGEST: usize = 65_535;

/// So many datagrams of a socket are read before something else is looked after: who sends
/// them faster than they are read must not keep it from saying goodbye, from
/// noticing silence, or from asking for the stream.
const DATAGRAMS: usize = 64;

/// How long the receiver waits before it looks around without a reason.
const LOOK_AROUND: Duration = Duration::from_millis(100);

/// How often the counters are told.
const COUNTERS_NS: u64 = 200_000_000;

/// What the receiver tells those who keep the records.
#[derive(Clone, Copy, Debug)]
pub(crate) enum MocapReport {
    /// What a frame, or silence, says of the car.
    Observation(Observation),
    /// What was counted so far.
    Counters(PlanarCounters),
}

/// Everything on the receiver's thread.
pub(crate) struct MocapReceiver {
    pub(crate) session: PlanarSession,
    pub(crate) sockets: MocapSockets,
    /// To the control thread.
    pub(crate) observations: Producer<Observation>,
    /// To the records.
    pub(crate) reports: Producer<MocapReport>,
    pub(crate) stop: StopFlag,
}

impl MocapReceiver {
    /// Runs until it is told to stop; returns what it counted, and how many
    /// observations found no room on their way to the control thread.
    pub(crate) fn run(mut self) -> (PlanarCounters, u64) {
        let mut buffer = vec![0; LONGEST];
        let mut dropped = 0;
        let mut stale = false;
        let mut last_frame = 0;
        let mut sent = true;
        let mut counters_ns = 0;
        loop {
            for channel in [Channel::Command, Channel::Data] {
                for _ in 0..DATAGRAMS {
                    let Some((length, source)) = self.sockets.receive(channel, &mut buffer) else {
                        break;
                    };
                    let now_ns = monotonic_ns();
                    let datagram = buffer.get(..length).unwrap_or(&[]);
                    if let PlanarOutcome::Frame(observation) =
                        self.session
                            .handle_datagram(now_ns, source, datagram, &mut |event| log(&event))
                    {
                        stale = false;
                        last_frame = observation.frame_number;
                        dropped += self.tell(observation);
                    }
                }
            }
            let now_ns = monotonic_ns();
            self.session
                .handle_timeout(now_ns, &mut |event| log(&event));
            while let Some(datagram) = self.session.poll_transmit(now_ns) {
                let result = self.sockets.send(datagram.destination, &datagram.bytes);
                if let Err(error) = &result
                    && sent
                {
                    warn!(server = %datagram.destination, %error, "can't reach the motion capture");
                }
                sent = result.is_ok();
            }
            let state = self.session.pose_state(now_ns);
            if matches!(state, PoseState::Stale { .. }) && !stale {
                stale = true;
                dropped += self.tell(Observation {
                    frame_number: last_frame,
                    receive_time_ns: now_ns,
                    state,
                });
            }
            if now_ns >= counters_ns {
                counters_ns = now_ns + COUNTERS_NS;
                // They are told again soon.
                let _ = self
                    .reports
                    .push(MocapReport::Counters(self.session.counters()));
            }
            let due_ns = self.session.poll_timeout().unwrap_or(u64::MAX);
            let wait = Duration::from_nanos(due_ns.saturating_sub(now_ns)).min(LOOK_AROUND);
            if self.stop.wait(&self.sockets.files(), wait) == Woken::Stop {
                self.say_goodbye();
                return (self.session.counters(), dropped);
            }
        }
    }

    /// Returns how many found no room: the control thread has stalled.
    fn tell(&mut self, observation: Observation) -> u64 {
        // Those who keep the records may miss one.
        let _ = self.reports.push(MocapReport::Observation(observation));
        u64::from(self.observations.push(observation).is_err())
    }

    fn say_goodbye(&mut self) {
        self.session.close();
        while let Some(datagram) = self.session.poll_transmit(monotonic_ns()) {
            // The server notices by itself, only later.
            let _ = self.sockets.send(datagram.destination, &datagram.bytes);
        }
    }
}

fn log(event: &PlanarEvent) {
    let event = match event {
        PlanarEvent::Session(event) => event,
        PlanarEvent::Binding(binding) => return log_binding(*binding),
    };
    match event {
        SessionEvent::Connected(connected) => {
            info!(
                bitstream = %connected.version,
                camera_clock = connected.has_camera_clock,
                "motion capture connected"
            );
        }
        SessionEvent::Refused(version) => warn!("motion capture: {version}"),
        SessionEvent::BitstreamKept { requested, kept } => warn!(
            %requested, %kept,
            "the motion capture did not change its bitstream; its own is read"
        ),
        SessionEvent::TransportMismatch { server_multicast } => warn!(
            server_multicast,
            "motion_capture.transport is not the server's: frames will hardly come"
        ),
        SessionEvent::Stale => warn!("the motion capture is silent"),
        SessionEvent::Restarted(reason) => warn!(?reason, "motion capture: starting over"),
        event => info!(?event, "motion capture"),
    }
}

fn log_binding(binding: Binding) {
    match binding {
        Binding::Bound { id } => info!(id, "rigid body found"),
        Binding::Missing => {
            warn!("motion_capture.rigid_body is not among the server's rigid bodies");
        }
        Binding::Ambiguous { count } => {
            warn!(
                count,
                "several rigid bodies have the name motion_capture.rigid_body"
            );
        }
        Binding::Unresolved => info!("rigid bodies are read anew"),
    }
}
