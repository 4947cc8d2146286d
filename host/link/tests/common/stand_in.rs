//! A stand-in for the firmware: it speaks the protocol and keeps its rules of
//! arming and stopping, without pins, pulses or a speed loop.

use singletrack_protocol::{
    Acknowledgement, BoardMode, COMMAND_TIME_TO_LIVE_US, Configuration, Decoder, Hello, ImuState,
    Refusal, RefusalReason, Request, ResetCause, Sequence, Status, StopCause, TELEMETRY_PERIOD_US,
    Telemetry, ToBoard, ToHost, UNSOLICITED, VERSION,
};

/// How long the ESC is held at neutral after the start.
const BOOT_US: u32 = 2_000_000;

pub(crate) struct StandIn {
    decoder: Decoder,
    started_us: u32,
    next_telemetry_us: u32,
    records: u32,
    pub(crate) mode: BoardMode,
    cause: StopCause,
    pub(crate) configuration: Option<Configuration>,
    pub(crate) last_sequence: Sequence,
    valid_until_us: u32,
    frames: (u16, u16),
    refused: (u16, RefusalReason),
    /// Requests to arm that were obeyed, and commands likewise.
    pub(crate) armed: u32,
    pub(crate) driven: u32,
    tx: Vec<u8>,
}

impl StandIn {
    pub(crate) fn started(now_us: u32) -> Self {
        let mut board = Self {
            decoder: Decoder::new(),
            started_us: now_us,
            next_telemetry_us: now_us,
            records: 0,
            mode: BoardMode::Boot,
            cause: StopCause::None,
            configuration: None,
            last_sequence: Sequence(0),
            valid_until_us: 0,
            frames: (0, 0),
            refused: (0, RefusalReason::None),
            armed: 0,
            driven: 0,
            tx: vec![0],
        };
        board.say(Hello {
            protocol_version: VERSION,
            software_version: [0, 1, 0],
            nonce: UNSOLICITED,
        });
        board
    }

    /// What the board does at `now_us` with the bytes that have arrived; what it says.
    pub(crate) fn poll(&mut self, now_us: u32, bytes: &[u8]) -> Vec<u8> {
        for &byte in bytes {
            let message = match self.decoder.push(byte) {
                None => continue,
                Some(packet) => packet.map(ToBoard::decode),
            };
            match message {
                Ok(Ok(message)) => {
                    self.frames.0 = self.frames.0.wrapping_add(1);
                    self.message(now_us, message);
                }
                _ => self.frames.1 = self.frames.1.wrapping_add(1),
            }
        }
        if self.mode == BoardMode::Boot && now_us.wrapping_sub(self.started_us) >= BOOT_US {
            self.mode = BoardMode::Neutral;
        }
        if self.is_armed() && now_us.wrapping_sub(self.valid_until_us) < u32::MAX / 2 {
            self.mode = BoardMode::Failsafe;
            self.cause = StopCause::CommandTimeout;
        }
        if now_us.wrapping_sub(self.next_telemetry_us) < u32::MAX / 2 {
            self.next_telemetry_us = self.next_telemetry_us.wrapping_add(TELEMETRY_PERIOD_US);
            self.report(now_us);
        }
        std::mem::take(&mut self.tx)
    }

    fn is_armed(&self) -> bool {
        matches!(self.mode, BoardMode::Armed | BoardMode::Driving)
    }

    fn hash(&self) -> u32 {
        self.configuration.map_or(0, |it| it.hash())
    }

    fn say(&mut self, message: impl Into<ToHost>) {
        self.tx.extend(message.into().encode().as_bytes());
    }

    fn answer(&mut self, request: Request, sequence: Sequence, result: Result<(), RefusalReason>) {
        let configuration_hash = self.hash();
        match result {
            Ok(()) => self.say(Acknowledgement {
                request,
                sequence,
                configuration_hash,
            }),
            Err(reason) => self.say(Refusal {
                request,
                sequence,
                reason,
            }),
        }
    }

    fn stop(&mut self, mode: BoardMode, cause: StopCause) {
        if self.is_armed() {
            self.mode = mode;
            self.cause = cause;
        }
    }

    fn message(&mut self, now_us: u32, message: ToBoard) {
        match message {
            ToBoard::Hello(hello) => {
                self.stop(BoardMode::Failsafe, StopCause::HostRestarted);
                self.say(Hello {
                    protocol_version: VERSION,
                    software_version: [0, 1, 0],
                    nonce: hello.nonce,
                });
            }
            ToBoard::Configure(configure) => {
                let result = if self.is_armed() {
                    Err(RefusalReason::Busy)
                } else {
                    self.configuration = Some(configure.configuration);
                    Ok(())
                };
                self.answer(Request::Configure, configure.request, result);
            }
            ToBoard::Arm(arm) => {
                let result = if self.mode == BoardMode::EmergencyStopped {
                    Err(RefusalReason::EmergencyStopLatched)
                } else if self.configuration.is_none() {
                    Err(RefusalReason::NotConfigured)
                } else if self.hash() != arm.configuration_hash {
                    Err(RefusalReason::ConfigurationDiffers)
                } else if self.mode == BoardMode::Boot {
                    Err(RefusalReason::NotYetNeutral)
                } else if now_us.wrapping_sub(arm.telemetry_time_us) > COMMAND_TIME_TO_LIVE_US {
                    Err(RefusalReason::Stale)
                } else {
                    self.armed += 1;
                    self.mode = BoardMode::Armed;
                    self.valid_until_us = now_us.wrapping_add(500_000);
                    Ok(())
                };
                self.answer(Request::Arm, arm.request, result);
            }
            ToBoard::Disarm(disarm) => {
                self.stop(BoardMode::Neutral, StopCause::Disarmed);
                self.answer(Request::Disarm, disarm.request, Ok(()));
            }
            ToBoard::EmergencyStop(stop) => {
                self.mode = BoardMode::EmergencyStopped;
                self.answer(Request::EmergencyStop, stop.request, Ok(()));
            }
            ToBoard::Drive(drive) => {
                let age_us = now_us.wrapping_sub(drive.telemetry_time_us);
                let refusal = if !self.is_armed() {
                    Some(RefusalReason::NotArmed)
                } else if !drive.sequence.is_newer_than(self.last_sequence) {
                    Some(RefusalReason::OutOfSequence)
                } else if age_us > COMMAND_TIME_TO_LIVE_US {
                    Some(RefusalReason::Stale)
                } else {
                    None
                };
                if let Some(reason) = refusal {
                    self.refused = (self.refused.0.wrapping_add(1), reason);
                } else {
                    self.driven += 1;
                    self.mode = BoardMode::Driving;
                    self.last_sequence = drive.sequence;
                    self.valid_until_us = drive
                        .telemetry_time_us
                        .wrapping_add(COMMAND_TIME_TO_LIVE_US);
                }
            }
        }
    }

    fn report(&mut self, now_us: u32) {
        self.say(Telemetry {
            stop_cause: self.cause,
            imu: ImuState::Fresh,
            ..super::telemetry(now_us, self.mode, self.last_sequence)
        });
        if self.records % 20 == 7 {
            self.say(Status {
                board_time_us: now_us,
                configuration_hash: self.hash(),
                reset_cause: ResetCause::External,
                stop_input_open: false,
                battery_mv: 7_400,
                frames_received: self.frames.0,
                frames_damaged: self.frames.1,
                drives_refused: self.refused.0,
                last_refusal: self.refused.1,
                frames_dropped: 0,
                bytes_overrun: 0,
                imu_errors: 0,
            });
        }
        self.records = self.records.wrapping_add(1);
    }
}
