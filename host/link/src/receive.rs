//! What the session makes of the bytes that it receives.

use singletrack_protocol::{
    FrameError, Hello, Identity, ImuState, Message, RefusalReason, Request, Sequence, Status,
    TELEMETRY_PERIOD_US, Telemetry, ToHost, UNSOLICITED, VERSION, frame_length,
};

use crate::{
    clock::{Stamp, StampOutcome},
    drive::NewestTelemetry,
    event::{Event, QualityWindow, RestartEvidence, TimedTelemetry, VersionMismatch, Wake},
    handshake::{Phase, SLOW_RETRY_NS},
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
        let wake = &mut Wake { now_ns, on_event };
        for &byte in bytes {
            let Some(outcome) = self.decoder.push(byte) else {
                continue;
            };
            if outcome.is_ok() {
                self.quality.good(now_ns);
                self.counters.frames_received += 1;
            } else {
                self.quality.damaged(now_ns);
            }
            match outcome.map(ToHost::decode) {
                Ok(Ok(message)) => self.message(message, wake),
                // Messages of another version need not be decoded.
                Ok(Err(_)) if !self.phase.is_connected() => self.counters.frames_ignored += 1,
                Err(FrameError::CheckSum) => self.counters.crc_errors += 1,
                Ok(Err(_)) | Err(_) => self.counters.decode_errors += 1,
            }
        }
    }

    fn message(&mut self, message: ToHost, wake: &mut Wake<'_>) {
        if let ToHost::Hello(hello) = message {
            return self.hello(&hello, wake);
        }
        if !self.phase.is_connected() {
            let greeting = self.phase.greeting_mut();
            let answered = greeting.and_then(|greeting| greeting.answered);
            // Only Hello means the same in every version.
            let (Some(software_version), ToHost::Identity(_)) = (answered, message) else {
                self.counters.frames_ignored += 1;
                return;
            };
            self.connected(software_version, wake);
        }
        self.last_heard_ns = self.last_heard_ns.max(wake.now_ns);
        match message {
            ToHost::Hello(_) => {}
            ToHost::Telemetry(telemetry) => self.telemetry(telemetry, wake),
            ToHost::Status(status) => self.status(&status, wake),
            ToHost::Acknowledgement(yes) => {
                let hash = yes.configuration_hash;
                self.answered((yes.request, yes.sequence), Ok(hash), wake);
            }
            ToHost::Refusal(no) => self.answered((no.request, no.sequence), Err(no.reason), wake),
            ToHost::Identity(Identity { car_id }) => wake.tell(Event::Identified { car_id }),
        }
    }

    fn hello(&mut self, hello: &Hello, wake: &mut Wake<'_>) {
        if hello.nonce == UNSOLICITED {
            if self.acquainted {
                self.restarted(RestartEvidence::Announced, wake);
            } else if let Some(greeting) = self.phase.greeting_mut() {
                // The board has just begun to listen.
                greeting.next_ns = wake.now_ns;
                greeting.answered = None;
            }
            return;
        }
        let greeting = self.phase.greeting_mut();
        match greeting.filter(|greeting| greeting.nonce == hello.nonce) {
            Some(greeting) if hello.protocol_version == VERSION => {
                greeting.answered = Some(hello.software_version);
            }
            Some(_) => self.version_mismatch(hello, wake),
            None => self.counters.frames_ignored += 1,
        }
    }

    fn connected(&mut self, board_software_version: [u8; 3], wake: &mut Wake<'_>) {
        if !self.acquainted {
            // The bytes of a bootloader say nothing about the line.
            self.quality = QualityWindow::default();
        }
        self.acquainted = true;
        self.last_heard_ns = wake.now_ns;
        if let Some(stop) = &mut self.stop {
            // The board has just begun to listen.
            stop.next_ns = wake.now_ns;
        }
        self.phase = Phase::configuring(self.take_request_number(), wake.now_ns, None);
        wake.tell(Event::Connected {
            board_software_version,
        });
    }

    fn version_mismatch(&mut self, hello: &Hello, wake: &mut Wake<'_>) {
        let mismatch = VersionMismatch {
            board_protocol: hello.protocol_version,
            board_software: hello.software_version,
            host_software: self.config.software_version,
        };
        self.acquainted = false;
        let Some(greeting) = self.phase.greeting_mut() else {
            return;
        };
        greeting.next_ns = wake.now_ns.saturating_add(SLOW_RETRY_NS);
        if greeting.mismatch.replace(mismatch) != Some(mismatch) {
            wake.tell(Event::VersionMismatch(mismatch));
        }
    }

    fn restarted(&mut self, evidence: RestartEvidence, wake: &mut Wake<'_>) {
        self.counters.board_restarts += 1;
        self.acquainted = false;
        self.greet(wake.now_ns);
        wake.tell(Event::BoardRestarted { evidence });
    }

    /// The board has carried out a request, with this hash of its configuration, or refuses it.
    fn answered(
        &mut self,
        (request, sequence): (Request, Sequence),
        answer: Result<u32, RefusalReason>,
        wake: &mut Wake<'_>,
    ) {
        let is_awaited = match request {
            Request::Configure => {
                if let Phase::Configuring { pending, .. } = self.phase
                    && pending.sequence == sequence
                {
                    return self.configure_answered(answer, wake);
                }
                false
            }
            Request::Arm => self.arm.take_if(|arm| arm.sequence == sequence).is_some(),
            Request::Disarm | Request::EmergencyStop => {
                let stop = self.stop.as_mut();
                stop.is_some_and(|stop| stop.answer(request, sequence))
            }
        };
        if !is_awaited {
            self.counters.frames_ignored += 1;
            return;
        }
        wake.tell(match answer {
            Ok(_) => Event::Acknowledged { request, sequence },
            Err(reason) => Event::Refused {
                request,
                sequence,
                reason,
            },
        });
        if let (Request::Arm, Err(reason)) = (request, answer)
            && (reason == RefusalReason::NotConfigured
                || reason == RefusalReason::ConfigurationDiffers)
        {
            self.restarted(RestartEvidence::ConfigurationGone, wake);
        }
    }

    fn configure_answered(&mut self, answer: Result<u32, RefusalReason>, wake: &mut Wake<'_>) {
        let reason = match answer {
            Ok(hash) if hash == self.configuration_hash => {
                self.phase = Phase::Ready;
                return wake.tell(Event::ConfigurationAccepted { hash });
            }
            Ok(_) => RefusalReason::ConfigurationDiffers,
            Err(reason) => reason,
        };
        let known = match self.phase {
            Phase::Configuring { refused, .. } => refused,
            _ => None,
        };
        let again_ns = wake.now_ns.saturating_add(SLOW_RETRY_NS);
        let sequence = self.take_request_number();
        self.phase = Phase::configuring(sequence, again_ns, Some(reason));
        if known != Some(reason) {
            wake.tell(Event::ConfigurationRefused { reason });
        }
    }

    fn telemetry(&mut self, telemetry: Telemetry, wake: &mut Wake<'_>) {
        let left_ns = self.leaving_time_ns(wake.now_ns);
        let stamp = match self.clock.observe(left_ns, telemetry.board_time_us) {
            StampOutcome::Mapped(stamp) => stamp,
            StampOutcome::Implausible => {
                self.counters.telemetry_implausible += 1;
                return;
            }
            StampOutcome::Restarted => {
                return self.restarted(RestartEvidence::ClockRestarted, wake);
            }
        };
        self.counters.telemetry_missing += missing_before(&stamp);
        self.latency.echoed(wake.now_ns, telemetry.last_sequence);
        self.newest = Some(NewestTelemetry {
            mode: telemetry.mode,
            last_sequence: telemetry.last_sequence,
            board_time_us: telemetry.board_time_us,
            host_time_ns: stamp.host_time_ns,
        });
        wake.tell(Event::Telemetry(TimedTelemetry {
            telemetry,
            receive_time_ns: wake.now_ns,
            board_time_host_ns: stamp.host_time_ns,
            imu_time_host_ns: self.imu_time_ns(&telemetry, stamp.host_time_ns),
        }));
        // The acknowledgement may have been lost. Waiting for it would send the
        // request again, and would arm a board that has stopped itself meanwhile.
        let is_armed = telemetry.mode.is_armed();
        if let Some(arm) = self.arm.take_if(|arm| is_armed && arm.was_sent()) {
            wake.tell(Event::Acknowledged {
                request: Request::Arm,
                sequence: arm.sequence,
            });
        }
        let mode = telemetry.mode;
        if let Some(stop) = self.stop.take_if(|stop| stop.is_confirmed_by(mode)) {
            wake.tell(Event::StopConfirmed {
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
        let time_ns = record_time_ns.saturating_sub(age_ns);
        self.last_imu_time_ns = self.last_imu_time_ns.max(time_ns);
        Some(self.last_imu_time_ns)
    }

    fn status(&mut self, status: &Status, wake: &mut Wake<'_>) {
        self.board_quality.observe(status);
        wake.tell(Event::Status(*status));
        let differs = status.configuration_hash != self.configuration_hash;
        if differs && matches!(self.phase, Phase::Ready) {
            self.restarted(RestartEvidence::ConfigurationGone, wake);
        }
    }
}

/// Records that the board made between the last one received and this one.
fn missing_before(stamp: &Stamp) -> u64 {
    let periods = stamp.since_last_us.saturating_add(TELEMETRY_PERIOD_US / 2) / TELEMETRY_PERIOD_US;
    u64::from(periods.saturating_sub(1))
}
