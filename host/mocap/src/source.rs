//! The session of any protocol.

use core::net::IpAddr;

use crate::{
    codec::DecodeError,
    config::{Protocol, SessionConfig, SessionConfigError},
    pose_source::{Input, Output, PoseSource, Stream},
    qualisys,
    session::{DatagramOutcome, Phase, Session, SessionCounters, Transmit},
    vrpn,
};

/// The session of the configured protocol.
#[derive(Clone, Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "a session is made once, and there is no heap"
)]
pub enum Source {
    /// NatNet: OptiTrack Motive.
    NatNet(Session),
    /// VRPN.
    Vrpn(vrpn::Session),
    /// The real-time protocol of Qualisys QTM.
    Qualisys(qualisys::Session),
}

impl Source {
    /// A session that has not connected yet. With a name, VRPN has frames of that body only;
    /// without one, a frame of each body for itself.
    ///
    /// # Errors
    /// A value of the configuration can't be used.
    pub fn new(config: SessionConfig, body: Option<&str>) -> Result<Self, SessionConfigError> {
        config.validate()?;
        Ok(match config.protocol {
            Protocol::NatNet => Self::NatNet(Session::new(config)?),
            Protocol::Vrpn { sensor } => Self::Vrpn(vrpn::session(config, sensor, body)),
            Protocol::Qualisys => Self::Qualisys(qualisys::session(config)),
        })
    }

    fn inner(&self) -> &dyn PoseSource {
        match self {
            Self::NatNet(session) => session,
            Self::Vrpn(session) => session,
            Self::Qualisys(session) => session,
        }
    }

    fn inner_mut(&mut self) -> &mut dyn PoseSource {
        match self {
            Self::NatNet(session) => session,
            Self::Vrpn(session) => session,
            Self::Qualisys(session) => session,
        }
    }
}

impl PoseSource for Source {
    fn handle_input(
        &mut self,
        now_ns: u64,
        input: Input<'_>,
        on_output: &mut dyn FnMut(Output<'_>),
    ) -> usize {
        self.inner_mut().handle_input(now_ns, input, on_output)
    }

    fn handle_timeout(&mut self, now_ns: u64, on_output: &mut dyn FnMut(Output<'_>)) {
        self.inner_mut().handle_timeout(now_ns, on_output);
    }

    fn poll_transmit(&mut self, now_ns: u64) -> Option<Transmit> {
        self.inner_mut().poll_transmit(now_ns)
    }

    fn poll_timeout(&self) -> Option<u64> {
        self.inner().poll_timeout()
    }

    fn stream(&self) -> Option<Stream> {
        self.inner().stream()
    }

    fn unreadable(&self) -> Option<DecodeError> {
        self.inner().unreadable()
    }

    fn request_names_again(&mut self) {
        self.inner_mut().request_names_again();
    }

    fn set_stamp_offset_ns(&mut self, offset_ns: i64) {
        self.inner_mut().set_stamp_offset_ns(offset_ns);
    }

    fn close(&mut self) {
        self.inner_mut().close();
    }

    fn phase(&self) -> Phase {
        self.inner().phase()
    }

    fn stale_for_ns(&self, now_ns: u64) -> Option<u64> {
        self.inner().stale_for_ns(now_ns)
    }

    fn other_source(&self) -> Option<IpAddr> {
        self.inner().other_source()
    }

    fn is_contradicted(&self, now_ns: u64) -> bool {
        self.inner().is_contradicted(now_ns)
    }

    fn counters(&self) -> SessionCounters {
        self.inner().counters()
    }
}

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
        self.unreadable_definitions()
    }

    fn request_names_again(&mut self) {
        self.request_definitions_again();
    }

    fn set_stamp_offset_ns(&mut self, offset_ns: i64) {
        self.set_stamp_offset_ns(offset_ns);
    }

    fn close(&mut self) {
        self.close();
    }

    fn phase(&self) -> Phase {
        self.phase()
    }

    fn stale_for_ns(&self, now_ns: u64) -> Option<u64> {
        self.stale_for_ns(now_ns)
    }

    fn other_source(&self) -> Option<IpAddr> {
        self.other_source()
    }

    fn is_contradicted(&self, now_ns: u64) -> bool {
        self.is_contradicted(now_ns)
    }

    fn counters(&self) -> SessionCounters {
        self.counters()
    }
}
