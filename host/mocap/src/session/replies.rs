//! What the server answers.

use super::{Connected, Event, Outcome, Phase, RestartReason, Schedule, Server, Session};
use crate::binding::Binding;
use crate::clock::{CaptureClock, EchoSample, SampleUse};
use crate::codec::{BitstreamVersion, Echo, ModelDefinitions, Response, ServerInfo, ServerMessage};
use crate::config::Transport;
use crate::order::Sequence;

impl Session {
    pub(super) fn handle_reply(&mut self, now_ns: u64, reply: &ServerMessage<'_>) -> Outcome {
        let used = match (reply, self.phase) {
            (_, Phase::Closing | Phase::Closed) => false,
            (ServerMessage::ServerInfo(info), _) => self.handle_server_info(now_ns, info),
            (ServerMessage::Disconnect, _) => {
                self.restart(now_ns, RestartReason::ServerLeft);
                let retry_ns = self.config.timing.retry_ns;
                self.schedule.handshake_at(now_ns.saturating_add(retry_ns));
                true
            }
            (ServerMessage::Response(Response::Status(0)), Phase::Negotiating(requested)) => {
                self.begin_streaming(now_ns, requested);
                true
            }
            (
                ServerMessage::Response(Response::Status(_)) | ServerMessage::Unrecognized,
                Phase::Negotiating(requested),
            ) => {
                self.keep_bitstream(now_ns, requested);
                true
            }
            (ServerMessage::ModelDefinitions(definitions), Phase::Streaming(_)) => {
                self.handle_definitions(now_ns, definitions);
                true
            }
            (ServerMessage::Echo(echo), Phase::Streaming(_)) => self.handle_echo(now_ns, *echo),
            _ => false,
        };
        if used {
            Outcome::Reply
        } else {
            self.counters.unsolicited += 1;
            Outcome::Ignored
        }
    }

    fn handle_server_info(&mut self, now_ns: u64, info: &ServerInfo<'_>) -> bool {
        let server = Server {
            natnet_version: info.natnet_version,
            native: info.bitstream(),
            connection: info.connection,
        };
        match self.phase {
            Phase::Connecting => {}
            // The same answer again; a refusal is told once.
            Phase::Refused(_) if self.server == Some(server) => return true,
            Phase::Refused(_) => {}
            _ => {
                if self.server != Some(server) {
                    self.restart(now_ns, RestartReason::ServerChanged);
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
        let multicast = matches!(self.config.transport, Transport::Multicast);
        if let Some(connection) = info.connection
            && connection.data_channel.multicast != multicast
        {
            self.event(Event::TransportMismatch {
                server_multicast: !multicast,
            });
        }
        match self.bitstream_to_request(server) {
            Some(requested) => {
                self.phase = Phase::Negotiating(requested);
                self.schedule = Schedule::begin(now_ns);
            }
            None => self.take_native(now_ns, server),
        }
        true
    }

    /// The bitstream to ask for: one older than the server's own. A newer one it
    /// cannot have, and only servers from 3.0 on can change it, in unicast.
    fn bitstream_to_request(&self, server: Server) -> Option<BitstreamVersion> {
        let Transport::Unicast { bitstream } = self.config.transport else {
            return None;
        };
        let requested = bitstream?;
        let [major, minor, _, _] = server.natnet_version;
        (major >= 3 && (major, minor) > (requested.major(), requested.minor())).then_some(requested)
    }

    /// The server would not change its bitstream to `requested`.
    pub(super) fn keep_bitstream(&mut self, now_ns: u64, requested: BitstreamVersion) {
        let Some(server) = self.server else {
            return;
        };
        if let Ok(kept) = server.native {
            self.event(Event::BitstreamKept { requested, kept });
        }
        self.take_native(now_ns, server);
    }

    fn take_native(&mut self, now_ns: u64, server: Server) {
        match server.native {
            Ok(version) => self.begin_streaming(now_ns, version),
            Err(unsupported) => {
                self.phase = Phase::Refused(unsupported);
                let retry_ns = self.config.timing.retry_ns;
                self.schedule.handshake_at(now_ns.saturating_add(retry_ns));
                self.event(Event::Refused(unsupported));
            }
        }
    }

    fn begin_streaming(&mut self, now_ns: u64, version: BitstreamVersion) {
        self.phase = Phase::Streaming(version);
        self.schedule = Schedule::begin(now_ns);
        let connection = self.server.and_then(|server| server.connection);
        self.event(Event::Connected(Connected {
            version,
            data_port: connection.map(|connection| connection.data_channel.port),
            has_camera_clock: version.has_camera_ticks()
                && connection.is_some_and(|connection| connection.ticks_per_second.is_some()),
        }));
    }

    fn handle_definitions(&mut self, now_ns: u64, definitions: &ModelDefinitions<'_>) {
        let binding = Binding::resolve(definitions, &self.config.rigid_body);
        self.set_binding(binding);
        if matches!(binding, Binding::Bound { .. }) {
            let poll_ns = self.config.timing.model_poll_ns;
            self.schedule.models_at(now_ns.saturating_add(poll_ns));
        }
    }

    fn handle_echo(&mut self, now_ns: u64, echo: Echo) -> bool {
        // Only the newest request's answer: an older one is late by definition.
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
            Some(SampleUse::Backward) => self.restart(now_ns, RestartReason::ClockBackward),
            None => return false,
        }
        true
    }
}
