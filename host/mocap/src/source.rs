//! What every source of poses has in common, whatever the protocol of its server.

use core::net::{IpAddr, SocketAddr};

use crate::{
    codec::ModelDefinitions,
    config::{Protocol, SessionConfig, SessionConfigError},
    counters::SessionCounters,
    qualisys,
    session::{DatagramOutcome, Phase, PoseFrame, Session, SessionEvent, Transmit},
    vrpn,
};

/// A session with a server of poses, without I/O.
///
/// It is called as every session ([order of the calls](crate#order-of-the-calls)). A protocol
/// over a stream also says which stream its owner must keep open ([`stream`](Self::stream)).
pub trait PoseSource {
    /// Takes what arrived at `now_ns`. Returns how many bytes of a stream were used: the rest
    /// begins a message that is not complete, and is handed over again with what follows it.
    fn handle_input(
        &mut self,
        now_ns: u64,
        input: Input<'_>,
        on_output: &mut dyn FnMut(Output<'_>),
    ) -> usize;

    /// Acts on silence.
    fn handle_timeout(&mut self, now_ns: u64, on_output: &mut dyn FnMut(Output<'_>));

    /// The next bytes to send now; call it until it returns `None`.
    fn poll_transmit(&mut self, now_ns: u64) -> Option<Transmit>;

    /// When the session must be called next, on the local clock; `None` once it is closed.
    fn poll_timeout(&self) -> Option<u64>;

    /// The stream to keep open. Another value than before: close the old one, and open this.
    fn stream(&self) -> Option<Stream> {
        None
    }

    /// The names lack the body that is needed: ask for them again soon.
    fn request_names_again(&mut self) {}

    /// Replaces [`Timing::stamp_offset_ns`](crate::Timing), from the next frame on.
    fn set_stamp_offset_ns(&mut self, offset_ns: i64);

    /// Leaves the server.
    fn close(&mut self);

    /// How far the session is.
    fn phase(&self) -> Phase;

    /// For how long the stream of frames has been silent, if that is longer than
    /// [`Timing::stale_after_ns`](crate::Timing).
    fn stale_for_ns(&self, now_ns: u64) -> Option<u64>;

    /// The address of the last datagram that did not come from the server's.
    fn other_source(&self) -> Option<IpAddr> {
        None
    }

    /// Whether the frames are distrusted, because two senders use the server's address.
    fn is_contradicted(&self, _now_ns: u64) -> bool {
        false
    }

    /// What was counted so far.
    fn counters(&self) -> SessionCounters;
}

/// What arrives at a session.
#[derive(Clone, Copy, Debug)]
pub enum Input<'a> {
    /// A datagram, and from where.
    Datagram {
        /// Address and port of the sender.
        source: SocketAddr,
        /// Contents.
        bytes: &'a [u8],
    },
    /// The stream is open.
    Opened(LocalEnd),
    /// All bytes of the stream that have not been used.
    Stream(&'a [u8]),
    /// The stream could not be opened, or has ended.
    Closed,
}

/// The owner's end of a stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LocalEnd {
    /// The address from which the stream was opened.
    pub address: IpAddr,
    /// The port at which the owner receives datagrams.
    pub datagram_port: u16,
}

/// A stream that the owner keeps open.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stream {
    /// The server's address and port.
    pub server: SocketAddr,
    /// Counts the attempts: another number is another stream to the same server.
    pub attempt: u32,
}

/// What a session says to its owner, in order.
#[derive(Clone, Debug)]
pub enum Output<'a> {
    /// A rare event.
    Event(SessionEvent),
    /// The names of the server's bodies.
    Names(Names<'a>),
    /// The newest frame.
    Frame(PoseFrame<'a>),
}

/// The names of a server's bodies.
#[derive(Clone, Debug)]
pub enum Names<'a> {
    /// As NatNet defines them.
    Definitions(ModelDefinitions<'a>),
    /// As VRPN's server describes its senders.
    Senders(&'a vrpn::Senders),
    /// As QTM lists them.
    Listed(qualisys::BodyList<'a>),
}

impl Names<'_> {
    /// Passes each body's id and name to `visit`, in the order of the server.
    pub fn for_each(&self, visit: &mut dyn FnMut(i32, &str)) {
        match self {
            Self::Definitions(definitions) => definitions
                .rigid_bodies()
                .for_each(|definition| visit(definition.id, definition.name)),
            Self::Senders(senders) => senders.iter().for_each(|(id, name)| visit(id, name)),
            Self::Listed(list) => (0..)
                .zip(list.clone())
                .for_each(|(id, name)| visit(id, &name)),
        }
    }
}

impl<'a> From<ModelDefinitions<'a>> for Names<'a> {
    fn from(definitions: ModelDefinitions<'a>) -> Self {
        Self::Definitions(definitions)
    }
}

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
