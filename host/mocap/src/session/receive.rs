//! From CONNECT to a stream, and back to the start; and what the session makes of the datagrams that
//! it receives.

use core::net::SocketAddr;

use super::{
    Connected, DatagramOutcome, Phase, PoseFrame, RestartReason, Server, Session, SessionEvent,
    transmit::Schedule,
};
use crate::{
    body::{Bodies, BodiesOf, CaptureTime},
    clock::{CaptureClock, EchoSample, SampleUse},
    codec::{
        BitstreamVersion, DecodeError, Echo, Frame, FrameFlags, MessageId, Packet, Response,
        ServerInfo, ServerMessage,
    },
    config::Transport,
    consistency::{Arrival, Consistency, Evidence, Order, Sequence, digest},
};

impl Session {
    /// Starts over with CONNECT.
    pub(super) fn restart(
        &mut self,
        now_ns: u64,
        reason: RestartReason,
        on_event: &mut impl FnMut(SessionEvent),
    ) {
        if matches!(self.phase, Phase::Closing | Phase::Closed) {
            return;
        }
        self.counters.restarts += 1;
        self.phase = Phase::Connecting;
        self.schedule = Schedule::connect_at(now_ns);
        self.server = None;
        self.echo_stamp = None;
        self.undecodable = 0;
        self.models_changed = false;
        self.forget_definitions(on_event);
        on_event(SessionEvent::Restarted(reason));
    }

    /// Takes the answer to CONNECT; false when nothing asked for it.
    fn handle_server_info(
        &mut self,
        now_ns: u64,
        info: &ServerInfo<'_>,
        on_event: &mut impl FnMut(SessionEvent),
    ) -> bool {
        let server = Server {
            natnet_version: info.natnet_version,
            native: info.bitstream(),
            connection: info.connection,
        };
        match self.phase {
            Phase::Connecting => {}
            // The same answer again: a refusal is reported once.
            Phase::Refused(_) if self.server == Some(server) => return true,
            Phase::Refused(_) => {}
            _ => {
                if self.server != Some(server) {
                    self.restart(now_ns, RestartReason::ServerChanged, on_event);
                }
                return self.server.is_none();
            }
        }
        self.server = Some(server);
        let frequency = info
            .connection
            .and_then(|connection| connection.ticks_per_second);
        self.clock = CaptureClock::new(frequency, &self.config.timing);
        self.sequence = Sequence::default();
        self.consistency = Consistency::new(frequency);
        let multicast = matches!(self.config.transport, Transport::Multicast);
        if let Some(connection) = info.connection
            && connection.data_channel.multicast != multicast
        {
            on_event(SessionEvent::TransportMismatch {
                server_multicast: !multicast,
            });
        }
        match self.bitstream_to_request(server) {
            Some(requested) => {
                self.phase = Phase::Negotiating(requested);
                self.schedule = Schedule::begin(now_ns);
            }
            None => self.take_native(now_ns, server, on_event),
        }
        true
    }

    /// The bitstream to request: one older than the server's own. A server can't
    /// send a newer one, and only servers from 3.0 on can change it, in unicast.
    fn bitstream_to_request(&self, server: Server) -> Option<BitstreamVersion> {
        let Transport::Unicast { bitstream } = self.config.transport else {
            return None;
        };
        let requested = bitstream?;
        let [major, minor, _, _] = server.natnet_version;
        (major >= 3 && (major, minor) > (requested.major(), requested.minor())).then_some(requested)
    }

    /// The server did not change its bitstream to `requested`.
    pub(super) fn keep_bitstream(
        &mut self,
        now_ns: u64,
        requested: BitstreamVersion,
        on_event: &mut impl FnMut(SessionEvent),
    ) {
        let Some(server) = self.server else {
            return;
        };
        if let Ok(kept) = server.native {
            on_event(SessionEvent::BitstreamKept { requested, kept });
        }
        self.take_native(now_ns, server, on_event);
    }

    fn take_native(
        &mut self,
        now_ns: u64,
        server: Server,
        on_event: &mut impl FnMut(SessionEvent),
    ) {
        match server.native {
            Ok(version) => self.begin_streaming(now_ns, version, on_event),
            Err(unsupported) => {
                self.phase = Phase::Refused(unsupported);
                let retry_ns = self.config.timing.retry_ns;
                self.schedule.handshake_ns = now_ns.saturating_add(retry_ns);
                on_event(SessionEvent::Refused(unsupported));
            }
        }
    }

    fn begin_streaming(
        &mut self,
        now_ns: u64,
        version: BitstreamVersion,
        on_event: &mut impl FnMut(SessionEvent),
    ) {
        self.phase = Phase::Streaming(version);
        self.schedule = Schedule::begin(now_ns);
        let connection = self.server.and_then(|server| server.connection);
        on_event(SessionEvent::Connected(Connected {
            version,
            data_port: connection.map(|connection| connection.data_channel.port),
            has_camera_clock: version.has_camera_ticks()
                && connection.is_some_and(|connection| connection.ticks_per_second.is_some()),
        }));
    }
}

/// This number of frames in a row that can't be decoded, over a time for which a
/// stream may be silent, means that the bitstream is another one.
const UNDECODABLE: u32 = 20;

/// While the flag "models changed" stays set, the definitions are read at this
/// interval.
const MODELS_CHANGED_NS: u64 = 1_000_000_000;

impl Session {
    /// Takes a datagram that arrived at `now_ns` from `source`.
    ///
    /// The result borrows the datagram: a frame's poses are read from it.
    pub fn handle_datagram<'a>(
        &mut self,
        now_ns: u64,
        source: SocketAddr,
        datagram: &'a [u8],
        on_event: &mut impl FnMut(SessionEvent),
    ) -> DatagramOutcome<'a> {
        // Frames come from the command port or the data port, replies from the
        // command port, multicast from any port: only the address is checked here, and
        // that frames do not come from two ports at a time below.
        if source.ip() != self.config.server {
            self.counters.wrong_source += 1;
            self.other_source = Some(source.ip());
            if !self.other_sources.contains(&source.ip())
                && self.other_sources.push(source.ip()).is_ok()
            {
                on_event(SessionEvent::OtherSource(source.ip()));
            }
            return DatagramOutcome::WrongSource;
        }
        let id = Packet::parse(datagram).map(|packet| packet.message_id());
        let is_frame = id == Ok(Some(MessageId::Frame));
        let version = match self.phase {
            Phase::Streaming(version) => version,
            _ if is_frame => {
                self.counters.early += 1;
                return DatagramOutcome::Ignored;
            }
            // Only frames and definitions depend on it.
            _ => BitstreamVersion::NEWEST,
        };
        match ServerMessage::decode(datagram, version) {
            Ok(ServerMessage::Frame(frame)) => {
                self.undecodable = 0;
                let arrival = Arrival {
                    now_ns,
                    port: source.port(),
                    number: frame.number,
                    ticks: frame.ticks.unwrap_or_default().transmit,
                    digest: digest(datagram),
                };
                self.handle_frame(&arrival, &frame, on_event)
            }
            Ok(reply) => self.handle_reply(now_ns, reply, on_event),
            Err(error) => {
                if id == Ok(Some(MessageId::ModelDefinitions)) {
                    self.definitions_unreadable(error, on_event);
                }
                self.handle_malformed(now_ns, is_frame, error, on_event);
                DatagramOutcome::Malformed(error)
            }
        }
    }

    /// The first error of some definitions is worth a line in the log.
    fn definitions_unreadable(
        &mut self,
        error: DecodeError,
        on_event: &mut impl FnMut(SessionEvent),
    ) {
        if self.unreadable.replace(error) != Some(error) {
            on_event(SessionEvent::DefinitionsUnreadable(error));
        }
    }

    fn handle_malformed(
        &mut self,
        now_ns: u64,
        is_frame: bool,
        error: DecodeError,
        on_event: &mut impl FnMut(SessionEvent),
    ) {
        self.counters.malformed += 1;
        if is_frame {
            self.undecodable = self.undecodable.saturating_add(1);
            // While other frames can be decoded, these come from another sender and
            // are not another bitstream. A sender that is quick must not restart the
            // session continuously.
            let lasts_ns = now_ns.saturating_sub(self.decodable_until_ns());
            if self.undecodable >= UNDECODABLE && lasts_ns >= self.config.timing.stale_after_ns {
                self.restart(now_ns, RestartReason::Undecodable(error), on_event);
            }
        }
    }

    fn handle_reply<'a>(
        &mut self,
        now_ns: u64,
        reply: ServerMessage<'a>,
        on_event: &mut impl FnMut(SessionEvent),
    ) -> DatagramOutcome<'a> {
        let used = match (reply, self.phase) {
            (_, Phase::Closing | Phase::Closed) => false,
            (ServerMessage::ServerInfo(info), _) => {
                self.handle_server_info(now_ns, &info, on_event)
            }
            (ServerMessage::Disconnect, _) => {
                self.restart(now_ns, RestartReason::ServerLeft, on_event);
                let retry_ns = self.config.timing.retry_ns;
                self.schedule.handshake_ns = now_ns.saturating_add(retry_ns);
                true
            }
            (ServerMessage::Response(Response::Status(0)), Phase::Negotiating(requested)) => {
                self.begin_streaming(now_ns, requested, on_event);
                true
            }
            (
                ServerMessage::Response(Response::Status(_)) | ServerMessage::Unrecognized,
                Phase::Negotiating(requested),
            ) => {
                self.keep_bitstream(now_ns, requested, on_event);
                true
            }
            (ServerMessage::ModelDefinitions(definitions), Phase::Streaming(_)) => {
                match definitions.unreadable {
                    Some(error) => self.definitions_unreadable(error, on_event),
                    None => self.unreadable = None,
                }
                self.definitions_current = true;
                let poll_ns = self.config.timing.model_poll_ns;
                self.schedule.models_read(now_ns, poll_ns);
                return DatagramOutcome::Definitions(definitions);
            }
            (ServerMessage::Echo(echo), Phase::Streaming(_)) => {
                self.handle_echo(now_ns, echo, on_event)
            }
            _ => false,
        };
        if used {
            DatagramOutcome::Reply
        } else {
            self.counters.unsolicited += 1;
            DatagramOutcome::Ignored
        }
    }

    fn handle_echo(
        &mut self,
        now_ns: u64,
        echo: Echo,
        on_event: &mut impl FnMut(SessionEvent),
    ) -> bool {
        // Only the answer to the newest request is used: an older answer is late.
        if self.echo_stamp != Some(echo.client_stamp) || now_ns < echo.client_stamp {
            return false;
        }
        self.echo_stamp = None;
        let sample = EchoSample {
            sent_ns: echo.client_stamp,
            received_ns: now_ns,
            server_ticks: echo.server_ticks,
        };
        match self.clock.echo_mut().map(|clock| clock.add(sample)) {
            Some(SampleUse::Agreed) => self.counters.echoes += 1,
            Some(SampleUse::Stepped) => {
                self.counters.echoes += 1;
                self.counters.clock_steps += 1;
            }
            Some(SampleUse::Backward) => {
                self.restart(now_ns, RestartReason::ClockBackward, on_event);
            }
            None => return false,
        }
        true
    }

    fn handle_frame<'a>(
        &mut self,
        arrival: &Arrival,
        frame: &Frame<'a>,
        on_event: &mut impl FnMut(SessionEvent),
    ) -> DatagramOutcome<'a> {
        let now_ns = arrival.now_ns;
        let key = CaptureClock::order_key(frame);
        let stale_after_ns = self.config.timing.stale_after_ns;
        let order = match self.consistency.judge(arrival, stale_after_ns) {
            Evidence::Agrees => self.sequence.place(frame.number, key),
            Evidence::OtherSender => {
                self.contradicted(now_ns, on_event);
                return DatagramOutcome::Late;
            }
            Evidence::AheadOfTime => {
                self.contradicted(now_ns, on_event);
                self.sequence.suspect(frame.number, key)
            }
        };
        match order {
            Order::Newest { lost } => self.counters.lost += lost,
            Order::Renumbered => self.counters.renumbered += 1,
            Order::Duplicate => {
                self.counters.duplicates += 1;
                return DatagramOutcome::Duplicate;
            }
            Order::Late => {
                self.counters.late += 1;
                return DatagramOutcome::Late;
            }
            Order::Restarted => {
                self.counters.late += 1;
                self.restart(now_ns, RestartReason::FramesBackward, on_event);
                return DatagramOutcome::Late;
            }
        }
        self.consistency.taken(*arrival);
        self.counters.frames += 1;
        self.last_frame_ns = Some(now_ns);
        self.stale = false;
        self.watch_models(now_ns, frame.flags, on_event);
        DatagramOutcome::Frame(PoseFrame {
            number: frame.number,
            receive_time_ns: now_ns,
            capture: self.capture(frame, now_ns),
            flags: frame.flags,
            definitions_current: self.definitions_current,
            bodies: Bodies {
                of: BodiesOf::NatNet(frame.rigid_bodies(), self.config.reading()),
                up_axis: self.config.up_axis,
            },
        })
    }

    fn contradicted(&mut self, now_ns: u64, on_event: &mut impl FnMut(SessionEvent)) {
        self.counters.contradictions += 1;
        if self.consistency.contradicted(now_ns) {
            on_event(SessionEvent::Contradicted);
        }
    }

    /// When the models change, an id may mean another body from this frame on: the
    /// definitions are not valid until they have been read again.
    fn watch_models(
        &mut self,
        now_ns: u64,
        flags: FrameFlags,
        on_event: &mut impl FnMut(SessionEvent),
    ) {
        let changed = flags.contains(FrameFlags::MODELS_CHANGED);
        if changed && !self.models_changed {
            self.forget_definitions(on_event);
            self.schedule.models_by(now_ns);
        } else if changed {
            self.schedule
                .models_by(now_ns.saturating_add(MODELS_CHANGED_NS));
        }
        self.models_changed = changed;
    }

    /// When the frame was captured: never after it arrived.
    fn capture(&mut self, frame: &Frame<'_>, now_ns: u64) -> Option<CaptureTime> {
        let capture = self.clock.capture(frame, now_ns)?;
        if self.consistency.is_distrusted(now_ns) {
            self.counters.distrusted += 1;
            return None;
        }
        let offset_ns = self.config.timing.stamp_offset_ns;
        let (capture, was_clamped) = capture.at_arrival(now_ns, offset_ns)?;
        self.counters.capture_clamped += u64::from(was_clamped);
        Some(capture)
    }
}
