//! The thread of the camera receiver: waits for datagrams, and polls.

use std::{net::SocketAddr, time::Duration};

use singletrack_core::cameras::{CameraReceiver, Channel, Sockets};
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

/// The sockets, with a log of the server's reachability.
struct Logged {
    sockets: MocapSockets,
    is_reachable: bool,
}

impl Sockets for Logged {
    fn receive(&mut self, channel: Channel, buffer: &mut [u8]) -> Option<(usize, SocketAddr)> {
        self.sockets.receive(channel, buffer)
    }

    fn send(&mut self, to: SocketAddr, bytes: &[u8]) {
        let result = self.sockets.send(to, bytes);
        if let Err(error) = &result
            && self.is_reachable
        {
            warn!(server = %to, %error, "can't reach the motion capture");
        }
        self.is_reachable = result.is_ok();
    }
}

/// Runs until `stop` is raised. Returns the counters, and how many observations found
/// no room on their way to the control loop.
pub(crate) fn run(
    mut receiver: CameraReceiver,
    sockets: MocapSockets,
    stop: &StopFlag,
) -> (PlanarCounters, u64) {
    let mut sockets = Logged {
        sockets,
        is_reachable: true,
    };
    loop {
        let until_ns = receiver.poll(&monotonic_ns, &mut sockets, &mut log);
        let wait = Duration::from_nanos(until_ns.saturating_sub(monotonic_ns()));
        if stop.wait(&sockets.sockets.files(), wait) == Woken::Stop {
            receiver.close(&monotonic_ns, &mut sockets);
            return (receiver.counters(), receiver.dropped());
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
