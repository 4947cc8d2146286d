//! What the session makes of the bytes that it receives.

use singletrack_protocol::{
    Acknowledgement, FrameError, Hello, ImuState, Message, Refusal, RefusalReason, Request,
    Sequence, Status, TELEMETRY_PERIOD_US, Telemetry, ToHost, UNSOLICITED, VERSION, frame_length,
};

use crate::{
    clock::{Stamp, StampOutcome},
    drive::NewestTelemetry,
    event::{Event, QualityWindow, RestartEvidence, TimedTelemetry, VersionMismatch},
    handshake::{Pending, Phase, SLOW_RETRY_NS},
    session::Session,
};

/// Start bit, eight data bits, stop bit.
const BITS_PER_BYTE: u64 = 10;

impl Session {
    /// Takes bytes that arrived at `now_ns` or just before.
    pub fn handle_bytes(&mut self, now_ns: u64, bytes: &[u8], on_event: &mut impl FnMut(Event)) {
        if matches!(self.phase, Phase::Disconnected) {
            return;
        }
        for &byte in bytes {
            let Some(outcome) = self.decoder.push(byte) else {
                continue;
            };
            match outcome.map(ToHost::decode) {
                Err(error) => self.damaged(now_ns, error),
                Ok(message) => {
                    self.quality.good(now_ns);
                    self.counters.frames_received += 1;
                    match message {
                        Ok(message) => self.message(now_ns, message, on_event),
                        // Messages of another version need not be decoded.
                        Err(_) if !self.phase.is_connected() => self.counters.frames_ignored += 1,
                        Err(_) => self.counters.decode_errors += 1,
                    }
                }
            }
        }
    }

    fn damaged(&mut self, now_ns: u64, error: FrameError) {
        self.quality.damaged(now_ns);
        match error {
            FrameError::CheckSum => self.counters.crc_errors += 1,
            _ => self.counters.decode_errors += 1,
        }
    }

    fn message(&mut self, now_ns: u64, message: ToHost, on_event: &mut impl FnMut(Event)) {
        if let ToHost::Hello(hello) = message {
            return self.hello(now_ns, &hello, on_event);
        }
        if !self.phase.is_connected() {
            let answered = self.phase.greeting().and_then(|greeting| greeting.answered);
            // Only Hello means the same in every version.
            let (Some(software_version), ToHost::Identity(_)) = (answered, message) else {
                self.counters.frames_ignored += 1;
                return;
            };
            self.connected(now_ns, software_version, on_event);
        }
        self.last_heard_ns = self.last_heard_ns.max(now_ns);
        match message {
            ToHost::Hello(_) => {}
            ToHost::Telemetry(telemetry) => self.telemetry(now_ns, telemetry, on_event),
            ToHost::Status(status) => self.status(now_ns, &status, on_event),
            ToHost::Acknowledgement(yes) => self.acknowledgement(now_ns, &yes, on_event),
            ToHost::Refusal(no) => self.refusal(now_ns, &no, on_event),
            ToHost::Identity(identity) => on_event(Event::Identified {
                car_id: identity.car_id,
            }),
        }
    }

    fn hello(&mut self, now_ns: u64, hello: &Hello, on_event: &mut impl FnMut(Event)) {
        if hello.nonce == UNSOLICITED {
            if self.acquainted {
                self.restarted(now_ns, RestartEvidence::Announced, on_event);
            } else if let Some(greeting) = self.phase.greeting_mut() {
                // The board has just begun to listen.
                greeting.next_ns = now_ns;
                greeting.answered = None;
            }
            return;
        }
        match self.phase.greeting_mut() {
            Some(greeting) if greeting.nonce == hello.nonce => {
                if hello.protocol_version == VERSION {
                    greeting.answered = Some(hello.software_version);
                } else {
                    self.version_mismatch(now_ns, hello, on_event);
                }
            }
            _ => self.counters.frames_ignored += 1,
        }
    }

    fn connected(
        &mut self,
        now_ns: u64,
        board_software_version: [u8; 3],
        on_event: &mut impl FnMut(Event),
    ) {
        if !self.acquainted {
            // The bytes of a bootloader say nothing about the line.
            self.quality = QualityWindow::default();
        }
        self.acquainted = true;
        self.last_heard_ns = now_ns;
        if let Some(stop) = &mut self.stop {
            stop.hurry(now_ns);
        }
        self.phase = Phase::configuring(self.take_request_number(), now_ns);
        on_event(Event::Connected {
            board_software_version,
        });
    }

    fn version_mismatch(&mut self, now_ns: u64, hello: &Hello, on_event: &mut impl FnMut(Event)) {
        let mismatch = VersionMismatch {
            board_protocol: hello.protocol_version,
            board_software: hello.software_version,
            host_software: self.config.software_version,
        };
        let known = match self.phase {
            Phase::VersionMismatch { mismatch, .. } => Some(mismatch),
            _ => None,
        };
        self.acquainted = false;
        if let Some(&greeting) = self.phase.greeting() {
            let mut greeting = greeting;
            greeting.next_ns = now_ns.saturating_add(SLOW_RETRY_NS);
            self.phase = Phase::VersionMismatch { greeting, mismatch };
        }
        if known != Some(mismatch) {
            on_event(Event::VersionMismatch(mismatch));
        }
    }

    fn restarted(
        &mut self,
        now_ns: u64,
        evidence: RestartEvidence,
        on_event: &mut impl FnMut(Event),
    ) {
        self.counters.board_restarts += 1;
        self.acquainted = false;
        self.greet(now_ns);
        on_event(Event::BoardRestarted { evidence });
    }

    fn acknowledgement(
        &mut self,
        now_ns: u64,
        yes: &Acknowledgement,
        on_event: &mut impl FnMut(Event),
    ) {
        match yes.request {
            Request::Configure => match self.phase {
                Phase::Configuring { pending, .. } if pending.sequence == yes.sequence => {
                    if yes.configuration_hash == self.configuration_hash {
                        self.phase = Phase::Ready;
                        on_event(Event::ConfigurationAccepted {
                            hash: self.configuration_hash,
                        });
                    } else {
                        let reason = RefusalReason::ConfigurationDiffers;
                        self.configuration_refused(now_ns, reason, on_event);
                    }
                }
                _ => self.counters.frames_ignored += 1,
            },
            Request::Arm => match self.arm {
                Some(arm) if arm.sequence == yes.sequence => self.armed(on_event),
                _ => self.counters.frames_ignored += 1,
            },
            Request::Disarm | Request::EmergencyStop => {
                self.stop_answered(yes.request, yes.sequence, None, on_event);
            }
        }
    }

    fn refusal(&mut self, now_ns: u64, no: &Refusal, on_event: &mut impl FnMut(Event)) {
        let &Refusal {
            request,
            sequence,
            reason,
        } = no;
        match request {
            Request::Configure => match self.phase {
                Phase::Configuring { pending, .. } if pending.sequence == sequence => {
                    self.configuration_refused(now_ns, reason, on_event);
                }
                _ => self.counters.frames_ignored += 1,
            },
            Request::Arm => {
                if self.arm.take_if(|arm| arm.sequence == sequence).is_none() {
                    self.counters.frames_ignored += 1;
                    return;
                }
                on_event(Event::Refused {
                    request,
                    sequence,
                    reason,
                });
                if reason == RefusalReason::NotConfigured
                    || reason == RefusalReason::ConfigurationDiffers
                {
                    self.restarted(now_ns, RestartEvidence::ConfigurationGone, on_event);
                }
            }
            Request::Disarm | Request::EmergencyStop => {
                self.stop_answered(request, sequence, Some(reason), on_event);
            }
        }
    }

    fn configuration_refused(
        &mut self,
        now_ns: u64,
        reason: RefusalReason,
        on_event: &mut impl FnMut(Event),
    ) {
        let known = match self.phase {
            Phase::Configuring { refused, .. } => refused,
            _ => None,
        };
        self.phase = Phase::Configuring {
            pending: Pending::new(
                self.take_request_number(),
                now_ns.saturating_add(SLOW_RETRY_NS),
            ),
            refused: Some(reason),
        };
        if known != Some(reason) {
            on_event(Event::ConfigurationRefused { reason });
        }
    }

    fn armed(&mut self, on_event: &mut impl FnMut(Event)) {
        if let Some(arm) = self.arm.take() {
            on_event(Event::Acknowledged {
                request: Request::Arm,
                sequence: arm.sequence,
            });
        }
    }

    fn stop_answered(
        &mut self,
        request: Request,
        sequence: Sequence,
        refused: Option<RefusalReason>,
        on_event: &mut impl FnMut(Event),
    ) {
        let first = self
            .stop
            .as_mut()
            .is_some_and(|stop| stop.answer(request, sequence));
        match refused {
            _ if !first => self.counters.frames_ignored += 1,
            Some(reason) => on_event(Event::Refused {
                request,
                sequence,
                reason,
            }),
            None => on_event(Event::Acknowledged { request, sequence }),
        }
    }

    fn telemetry(&mut self, now_ns: u64, telemetry: Telemetry, on_event: &mut impl FnMut(Event)) {
        let stamp = match self
            .clock
            .observe(self.leaving_time_ns(now_ns), telemetry.board_time_us)
        {
            StampOutcome::Mapped(stamp) => stamp,
            StampOutcome::Implausible => {
                self.counters.telemetry_implausible += 1;
                return;
            }
            StampOutcome::Restarted => {
                return self.restarted(now_ns, RestartEvidence::ClockRestarted, on_event);
            }
        };
        self.counters.telemetry_missing += missing_before(&stamp);
        self.latency.echoed(now_ns, telemetry.last_sequence);
        self.newest = Some(NewestTelemetry {
            mode: telemetry.mode,
            last_sequence: telemetry.last_sequence,
            board_time_us: telemetry.board_time_us,
            host_time_ns: stamp.host_time_ns,
        });
        on_event(Event::Telemetry(TimedTelemetry {
            telemetry,
            receive_time_ns: now_ns,
            board_time_host_ns: stamp.host_time_ns,
            imu_time_host_ns: self.imu_time_ns(&telemetry, stamp.host_time_ns),
        }));
        // The acknowledgement may have been lost. Waiting for it would send the
        // request again, and would arm a board that has stopped itself meanwhile.
        if telemetry.mode.is_armed() && self.arm.is_some_and(|arm| arm.was_sent()) {
            self.armed(on_event);
        }
        if let Some(stop) = self
            .stop
            .take_if(|stop| stop.is_confirmed_by(telemetry.mode))
        {
            on_event(Event::StopConfirmed {
                request: stop.kind.request(),
            });
        }
    }

    /// When the board began to send the record that ended at `now_ns`.
    fn leaving_time_ns(&self, now_ns: u64) -> u64 {
        const BYTES: u64 = frame_length(Telemetry::PAYLOAD_LENGTH) as u64;
        let on_line_ns = BYTES * BITS_PER_BYTE * 1_000_000_000 / u64::from(self.config.baud.get());
        now_ns.saturating_sub(on_line_ns)
    }

    fn imu_time_ns(&mut self, telemetry: &Telemetry, record_time_ns: u64) -> Option<u64> {
        if telemetry.imu == ImuState::Silent || telemetry.imu_age_100us == u8::MAX {
            return None;
        }
        // A skew of 0.5 % changes the oldest age by 0.1 ms, which is the resolution.
        let age_ns = u64::from(telemetry.imu_age_100us) * 100_000;
        let time_ns = record_time_ns
            .saturating_sub(age_ns)
            .max(self.last_imu_time_ns);
        self.last_imu_time_ns = time_ns;
        Some(time_ns)
    }

    fn status(&mut self, now_ns: u64, status: &Status, on_event: &mut impl FnMut(Event)) {
        self.board_quality.observe(status);
        on_event(Event::Status(*status));
        if matches!(self.phase, Phase::Ready)
            && status.configuration_hash != self.configuration_hash
        {
            self.restarted(now_ns, RestartEvidence::ConfigurationGone, on_event);
        }
    }
}

/// Records that the board made between the last one received and this one.
fn missing_before(stamp: &Stamp) -> u64 {
    let periods = stamp.since_last_us.saturating_add(TELEMETRY_PERIOD_US / 2) / TELEMETRY_PERIOD_US;
    u64::from(periods.saturating_sub(1))
}
