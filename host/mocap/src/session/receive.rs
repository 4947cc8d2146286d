//! From CONNECT to a stream, and back to the start; and what the session makes of the datagrams that
//! it receives.

use core::net::SocketAddr;

use super::{Schedule, Server, Session};
use crate::{
    body::{Bodies, BodiesOf, CaptureTime},
    clock::{CaptureClock, EchoSample, SampleUse},
    codec::{
        BitstreamVersion, DecodeError, Echo, Frame, FrameFlags, MessageId, Packet, Response,
        ServerInfo, ServerMessage,
    },
    config::Transport,
    consistency::{Arrival, Consistency, Evidence, Order, Sequence, digest},
    names::Names,
    pose_source::{Connected, Output, Phase, PoseFrame, RestartReason, SessionEvent, Wake},
};

/// This number of frames in a row that can't be decoded, over a time for which a
/// stream may be silent, means that the bitstream is another one.
const UNDECODABLE: u32 = 20;

/// While the flag "models changed" stays set, the definitions are read at this
/// interval.
const MODELS_CHANGED_NS: u64 = 1_000_000_000;

impl Session {
    /// Starts over with CONNECT.
    pub(super) fn restart(&mut self, reason: RestartReason, wake: &mut Wake<'_>) {
        if self.common.is_closing() {
            return;
        }
        self.common.counters.restarts += 1;
        self.common.phase = Phase::Connecting;
        self.schedule = Schedule::begin(wake.now_ns);
        self.server = None;
        self.echo_stamp = None;
        self.undecodable = 0;
        self.models_changed = false;
        self.forget_definitions(wake);
        wake.tell(SessionEvent::Restarted(reason));
    }

    fn forget_definitions(&mut self, wake: &mut Wake<'_>) {
        if self.definitions_current {
            self.definitions_current = false;
            wake.tell(SessionEvent::DefinitionsOutdated);
        }
    }

    /// Takes the answer to CONNECT; false when nothing asked for it.
    fn server_info(&mut self, info: &ServerInfo<'_>, wake: &mut Wake<'_>) -> bool {
        let server = Server {
            natnet_version: info.natnet_version,
            connection: info.connection,
        };
        match self.common.phase {
            Phase::Connecting => {}
            // The same answer again: a refusal is reported once.
            Phase::Refused(_) if self.server == Some(server) => return true,
            Phase::Refused(_) => {}
            _ => {
                if self.server != Some(server) {
                    self.restart(RestartReason::ServerChanged, wake);
                }
                return self.server.is_none();
            }
        }
        self.server = Some(server);
        let frequency = info.connection.and_then(|known| known.ticks_per_second);
        self.clock = CaptureClock::new(frequency, &self.common.config.timing);
        self.sequence = Sequence::default();
        self.consistency = Consistency::new(frequency);
        let server_multicast = !matches!(self.common.config.transport, Transport::Multicast);
        if let Some(connection) = info.connection
            && connection.data_channel.multicast == server_multicast
        {
            wake.tell(SessionEvent::TransportMismatch { server_multicast });
        }
        match self.bitstream_to_request(server) {
            Some(requested) => {
                self.common.phase = Phase::Negotiating(requested);
                self.schedule = Schedule::begin(wake.now_ns);
            }
            None => self.take_native(server, wake),
        }
        true
    }

    /// The bitstream to request: one older than the server's own. A server can't
    /// send a newer one, and only servers from 3.0 on can change it, in unicast.
    fn bitstream_to_request(&self, server: Server) -> Option<BitstreamVersion> {
        let Transport::Unicast { bitstream } = self.common.config.transport else {
            return None;
        };
        let requested = bitstream?;
        let [major, minor, _, _] = server.natnet_version;
        (major >= 3 && (major, minor) > (requested.major(), requested.minor())).then_some(requested)
    }

    /// The server did not change its bitstream to `requested`.
    pub(super) fn keep_bitstream(&mut self, requested: BitstreamVersion, wake: &mut Wake<'_>) {
        let Some(server) = self.server else {
            return;
        };
        if let Ok(kept) = BitstreamVersion::from_wire(server.natnet_version) {
            wake.tell(SessionEvent::BitstreamKept { requested, kept });
        }
        self.take_native(server, wake);
    }

    fn take_native(&mut self, server: Server, wake: &mut Wake<'_>) {
        match BitstreamVersion::from_wire(server.natnet_version) {
            Ok(version) => self.begin_streaming(version, wake),
            Err(unsupported) => {
                self.common.phase = Phase::Refused(unsupported);
                self.try_later(wake.now_ns);
                wake.tell(SessionEvent::Refused(unsupported));
            }
        }
    }

    /// The handshake goes on after a pause.
    pub(super) fn try_later(&mut self, now_ns: u64) {
        let retry_ns = self.common.config.timing.retry_ns;
        self.schedule.handshake_ns = now_ns.saturating_add(retry_ns);
    }

    fn begin_streaming(&mut self, version: BitstreamVersion, wake: &mut Wake<'_>) {
        self.common.phase = Phase::Streaming(version);
        self.schedule = Schedule::begin(wake.now_ns);
        let connection = self.server.and_then(|server| server.connection);
        wake.tell(SessionEvent::Connected(Connected {
            version,
            data_port: connection.map(|connection| connection.data_channel.port),
            has_camera_clock: version >= BitstreamVersion::V3_0
                && connection.is_some_and(|connection| connection.ticks_per_second.is_some()),
        }));
    }

    pub(super) fn datagram(&mut self, source: SocketAddr, datagram: &[u8], wake: &mut Wake<'_>) {
        // Frames come from the command port or the data port, replies from the
        // command port, multicast from any port: only the address is checked here, and
        // that frames do not come from two ports at a time below.
        if !self.common.is_server(source.ip(), wake) {
            return;
        }
        let id = Packet::parse(datagram).map(|packet| packet.message_id());
        let is_frame = id == Ok(Some(MessageId::Frame));
        let version = match self.common.phase {
            Phase::Streaming(version) => version,
            _ if is_frame => {
                self.common.counters.early += 1;
                return;
            }
            // Only frames and definitions depend on it.
            _ => BitstreamVersion::NEWEST,
        };
        match ServerMessage::decode(datagram, version) {
            Ok(ServerMessage::Frame(frame)) => {
                self.undecodable = 0;
                let arrival = Arrival {
                    now_ns: wake.now_ns,
                    port: source.port(),
                    number: frame.number,
                    ticks: frame.ticks.unwrap_or_default().transmit,
                    digest: digest(datagram),
                };
                self.frame(&arrival, &frame, wake);
            }
            Ok(reply) => {
                if !self.reply(reply, wake) {
                    self.common.counters.unsolicited += 1;
                }
            }
            Err(error) => {
                if id == Ok(Some(MessageId::ModelDefinitions)) {
                    self.definitions_unreadable(error, wake);
                }
                self.malformed(is_frame, error, wake);
            }
        }
    }

    /// The first error of some definitions is worth a line in the log.
    fn definitions_unreadable(&mut self, error: DecodeError, wake: &mut Wake<'_>) {
        if self.unreadable.replace(error) != Some(error) {
            wake.tell(SessionEvent::DefinitionsUnreadable(error));
        }
    }

    fn malformed(&mut self, is_frame: bool, error: DecodeError, wake: &mut Wake<'_>) {
        self.common.counters.malformed += 1;
        if is_frame {
            self.undecodable = self.undecodable.saturating_add(1);
            // While other frames can be decoded, these come from another sender and
            // are not another bitstream. A sender that is quick must not restart the
            // session continuously.
            let lasts_ns = wake.now_ns.saturating_sub(self.decodable_until_ns());
            let is_long = lasts_ns >= self.common.config.timing.stale_after_ns;
            if self.undecodable >= UNDECODABLE && is_long {
                self.restart(RestartReason::Undecodable(error), wake);
            }
        }
    }

    /// Takes a reply; false when nothing asked for it.
    fn reply(&mut self, reply: ServerMessage<'_>, wake: &mut Wake<'_>) -> bool {
        match (reply, self.common.phase) {
            (_, Phase::Closing | Phase::Closed) => return false,
            (ServerMessage::ServerInfo(info), _) => return self.server_info(&info, wake),
            (ServerMessage::Disconnect, _) => {
                self.restart(RestartReason::ServerLeft, wake);
                self.try_later(wake.now_ns);
            }
            (ServerMessage::Response(Response::Status(0)), Phase::Negotiating(requested)) => {
                self.begin_streaming(requested, wake);
            }
            (
                ServerMessage::Response(Response::Status(_)) | ServerMessage::Unrecognized,
                Phase::Negotiating(requested),
            ) => self.keep_bitstream(requested, wake),
            (ServerMessage::ModelDefinitions(definitions), Phase::Streaming(_)) => {
                match definitions.unreadable {
                    Some(error) => self.definitions_unreadable(error, wake),
                    None => self.unreadable = None,
                }
                self.definitions_current = true;
                let poll_ns = self.common.config.timing.model_poll_ns;
                self.schedule.models_read(wake.now_ns, poll_ns);
                (wake.on_output)(Output::Names(Names::Definitions(definitions)));
            }
            (ServerMessage::Echo(echo), Phase::Streaming(_)) => return self.echo(echo, wake),
            _ => return false,
        }
        true
    }

    fn echo(&mut self, echo: Echo, wake: &mut Wake<'_>) -> bool {
        // Only the answer to the newest request is used: an older answer is late.
        if self.echo_stamp != Some(echo.client_stamp) || wake.now_ns < echo.client_stamp {
            return false;
        }
        self.echo_stamp = None;
        let sample = EchoSample {
            sent_ns: echo.client_stamp,
            received_ns: wake.now_ns,
            server_ticks: echo.server_ticks,
        };
        let Some(clock) = &mut self.clock.echo else {
            return false;
        };
        match clock.add(sample) {
            SampleUse::Backward => self.restart(RestartReason::ClockBackward, wake),
            used => {
                self.common.counters.echoes += 1;
                self.common.counters.clock_steps += u64::from(used == SampleUse::Stepped);
            }
        }
        true
    }

    fn frame(&mut self, arrival: &Arrival, frame: &Frame<'_>, wake: &mut Wake<'_>) {
        let now_ns = wake.now_ns;
        let key = CaptureClock::order_key(frame);
        let stale_after_ns = self.common.config.timing.stale_after_ns;
        let order = match self.consistency.judge(arrival, stale_after_ns) {
            Evidence::Agrees => self.sequence.place(frame.number, key),
            Evidence::OtherSender => return self.contradicted(wake),
            Evidence::AheadOfTime => {
                self.contradicted(wake);
                self.sequence.suspect(frame.number, key)
            }
        };
        let counters = &mut self.common.counters;
        match order {
            Order::Newest { lost } => counters.lost += lost,
            Order::Renumbered => counters.renumbered += 1,
            Order::Duplicate => return counters.duplicates += 1,
            Order::Late => return counters.late += 1,
            Order::Restarted => {
                counters.late += 1;
                return self.restart(RestartReason::FramesBackward, wake);
            }
        }
        self.consistency.taken(*arrival);
        self.common.frame(now_ns);
        self.watch_models(frame.flags, wake);
        (wake.on_output)(Output::Frame(PoseFrame {
            number: frame.number,
            receive_time_ns: now_ns,
            capture: self.capture(frame, now_ns),
            flags: frame.flags,
            definitions_current: self.definitions_current,
            bodies: Bodies {
                of: BodiesOf::NatNet(frame.rigid_bodies(), self.common.config.reading()),
                up_axis: self.common.config.up_axis,
            },
        }));
    }

    fn contradicted(&mut self, wake: &mut Wake<'_>) {
        self.common.counters.contradictions += 1;
        if self.consistency.contradicted(wake.now_ns) {
            wake.tell(SessionEvent::Contradicted);
        }
    }

    /// When the models change, an id may mean another body from this frame on: the
    /// definitions are not valid until they have been read again.
    fn watch_models(&mut self, flags: FrameFlags, wake: &mut Wake<'_>) {
        let changed = flags.contains(FrameFlags::MODELS_CHANGED);
        if changed && !self.models_changed {
            self.forget_definitions(wake);
            self.schedule.models_by(wake.now_ns);
        } else if changed {
            let later_ns = wake.now_ns.saturating_add(MODELS_CHANGED_NS);
            self.schedule.models_by(later_ns);
        }
        self.models_changed = changed;
    }

    /// When the frame was captured: never after it arrived.
    fn capture(&mut self, frame: &Frame<'_>, now_ns: u64) -> Option<CaptureTime> {
        let capture = self.clock.capture(frame, now_ns)?;
        if self.consistency.is_distrusted(now_ns) {
            self.common.counters.distrusted += 1;
            return None;
        }
        self.common.at_arrival(capture, now_ns)
    }
}
