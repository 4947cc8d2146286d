//! The session as a source of poses.

use core::net::IpAddr;

use super::{DatagramOutcome, Phase, Session, SessionCounters, Transmit};
use crate::{
    codec::DecodeError,
    pose_source::{Input, Output, PoseSource},
};

impl PoseSource for Session {
    fn handle_input(
        &mut self,
        now_ns: u64,
        input: Input<'_>,
        on_output: &mut dyn FnMut(Output<'_>),
    ) -> usize {
        // NatNet has datagrams only.
        if let Input::Datagram { source, bytes } = input {
            let on_event = &mut |event| on_output(Output::Event(event));
            match self.handle_datagram(now_ns, source, bytes, on_event) {
                DatagramOutcome::Frame(frame) => on_output(Output::Frame(frame)),
                DatagramOutcome::Definitions(definitions) => {
                    on_output(Output::Names(definitions.into()));
                }
                _ => {}
            }
        }
        0
    }

    fn handle_timeout(&mut self, now_ns: u64, on_output: &mut dyn FnMut(Output<'_>)) {
        self.handle_timeout(now_ns, &mut |event| on_output(Output::Event(event)));
    }

    fn poll_transmit(&mut self, now_ns: u64) -> Option<Transmit> {
        self.poll_transmit(now_ns)
    }

    fn poll_timeout(&self) -> Option<u64> {
        self.poll_timeout()
    }

    fn unreadable(&self) -> Option<DecodeError> {
        self.unreadable
    }

    /// Call it directly after the [`Definitions`](DatagramOutcome::Definitions) that lack the body:
    /// they are requested within half a second, not after
    /// [`Timing::model_poll_ns`](crate::Timing).
    fn request_names_again(&mut self) {
        self.schedule.models_incomplete();
    }

    fn set_stamp_offset_ns(&mut self, offset_ns: i64) {
        self.config.timing.stamp_offset_ns = offset_ns;
    }

    /// [`poll_transmit`](Self::poll_transmit) returns the disconnect message and then nothing more.
    fn close(&mut self) {
        self.phase = Phase::Closing;
    }

    fn phase(&self) -> Phase {
        self.phase
    }

    fn stale_for_ns(&self, now_ns: u64) -> Option<u64> {
        self.last_frame_ns
            .map(|last_ns| now_ns.saturating_sub(last_ns))
            .filter(|silent_ns| *silent_ns > self.config.timing.stale_after_ns)
    }

    fn other_source(&self) -> Option<IpAddr> {
        self.other_source
    }

    fn is_contradicted(&self, now_ns: u64) -> bool {
        self.consistency.is_distrusted(now_ns)
    }

    fn counters(&self) -> SessionCounters {
        self.counters
    }
}
