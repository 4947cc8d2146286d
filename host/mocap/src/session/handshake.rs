//! From CONNECT to a stream, and back to the start.

use super::{
    event::{Connected, Phase, RestartReason, SessionEvent},
    schedule::Schedule,
    state::{Server, Session},
};
use crate::{
    clock::CaptureClock,
    codec::{BitstreamVersion, ServerInfo},
    config::Transport,
    consistency::Consistency,
    order::Sequence,
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
    pub(super) fn handle_server_info(
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

    pub(super) fn begin_streaming(
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
