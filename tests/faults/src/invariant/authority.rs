//! Authority: the car drives only on request, and stops on request.

use singletrack_pilot::{Arming, Event, Mode, PilotRequest};
use singletrack_protocol::{BoardMode, COMMAND_TIME_TO_LIVE_US, Sequence, ToBoard, UNSOLICITED};

use super::{Invariant, SERVO_US, Verdict};
use crate::{observation::Observation, schedule::FaultKind};

/// Time from the withdrawal of authority to the neutral pulse, in µs: up to 10 ms
/// until the main loop processes it, 1 ms until the supervisor applies it, up to 20
/// ms until the next pulse, on a clock that may be 0.5 % slow; specified as 45 ms.
const WITHDRAWAL_US: u64 = 45_000;

/// Time for which a command is in force: its time to live, plus a millisecond each
/// by which the image's clock and its polling may lag.
const IN_FORCE_US: u32 = COMMAND_TIME_TO_LIVE_US + 2_000;

/// `unarmed-drive`: a pulse drives only if the board received an arm request and
/// after it a sufficiently recent command, and since then nothing that withdraws
/// authority: disarm, emergency stop, a greeting of another session, a start of the
/// board, an open stop switch, or the expiry of the command.
///
/// It models the board from the bytes that reach it. The model may be armed when
/// the board is not, never the reverse.
#[derive(Default)]
pub(super) struct Unarmed {
    armed: bool,
    session: Option<(u32, u16)>,
    /// The last request to arm; repeated, it does not arm again.
    arm_request: Option<Sequence>,
    /// Board time of the telemetry behind the command in force.
    command_us: Option<u32>,
    /// That command is older than the last request to arm. The board may have stopped for a
    /// reason that this model does not know, so that the request has armed it again: the
    /// end of the command does not end that.
    command_is_old: bool,
    /// Time and cause of the last withdrawal.
    withdrawn: Option<(u64, &'static str)>,
    board_since_us: Option<u64>,
}

impl Unarmed {
    fn withdraw(&mut self, now_us: u64, cause: &'static str) {
        if self.armed {
            self.withdrawn = Some((now_us, cause));
        }
        self.armed = false;
        self.command_us = None;
    }

    fn expire(&mut self, now_us: u64) {
        let cause = "the last command expired";
        if self.command_is_old {
            self.withdrawn = Some((now_us, cause));
            self.command_us = None;
        } else {
            self.withdraw(now_us, cause);
        }
    }

    fn receive(&mut self, time_us: u64, board_time_us: u32, message: &ToBoard) {
        match message {
            ToBoard::Hello(hello) if hello.nonce != UNSOLICITED => {
                let session = Some((hello.nonce, hello.protocol_version));
                if self.session != session {
                    self.session = session;
                    self.withdraw(time_us, "a greeting of another session");
                }
            }
            ToBoard::Arm(arm) => {
                self.command_is_old |= self.arm_request.replace(arm.request) != Some(arm.request);
                self.armed = true;
            }
            ToBoard::Disarm(_) => self.withdraw(time_us, "a disarm request"),
            ToBoard::EmergencyStop(_) => self.withdraw(time_us, "an emergency stop request"),
            ToBoard::Drive(drive) => self.command(board_time_us, drive.telemetry_time_us),
            ToBoard::Jog(jog) => self.command(board_time_us, jog.telemetry_time_us),
            ToBoard::Hello(_) | ToBoard::Configure(_) => {}
        }
    }

    const fn command(&mut self, board_time_us: u32, telemetry_time_us: u32) {
        if self.armed && board_time_us.wrapping_sub(telemetry_time_us) <= IN_FORCE_US {
            self.command_us = Some(telemetry_time_us);
            self.command_is_old = false;
        }
    }
}

impl Invariant for Unarmed {
    fn name(&self) -> &'static str {
        "unarmed-drive"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        if observation.board_since_us != self.board_since_us {
            self.board_since_us = observation.board_since_us;
            self.session = None;
            self.withdraw(observation.now_us, "a reset of the board");
        }
        for received in observation.board_received {
            self.receive(received.time_us, received.board_time_us, &received.message);
        }
        if observation.spec.board.stop_input && observation.is_active(FaultKind::StopInputOpen) {
            self.withdraw(observation.now_us, "the stop switch opened");
        }
        for pulse in observation.pulses {
            if let Some(command_us) = self.command_us {
                let age_us = pulse.board_time_us.wrapping_sub(command_us);
                if age_us < u32::MAX / 2 && age_us > IN_FORCE_US {
                    self.expire(pulse.time_us);
                }
            }
            if !pulse.drives() || (self.armed && self.command_us.is_some()) {
                continue;
            }
            let (since_us, cause) = self.withdrawn.unwrap_or((0, "power-on, never armed"));
            let after_us = pulse.time_us.saturating_sub(since_us);
            if after_us > WITHDRAWAL_US {
                return Err(format!(
                    "ESC pulse {} µs {} ms after {cause}",
                    pulse.esc_us,
                    after_us / 1_000
                ));
            }
        }
        Ok(())
    }
}

/// `unasked-drive`: the daemon goes from standby to arming or driving only in a
/// tick with an arm request, and obeys every request that ends a drive in the tick that
/// receives it: an operator's who asks, lets go, is gone, or whose time is over. Recovery needs an
/// explicit request.
#[derive(Default)]
pub(super) struct Unasked {
    daemon_since_us: Option<u64>,
    underway: bool,
}

impl Invariant for Unasked {
    fn name(&self) -> &'static str {
        "unasked-drive"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        if observation.daemon_since_us != self.daemon_since_us {
            self.daemon_since_us = observation.daemon_since_us;
            self.underway = false;
        }
        let Some(tick) = observation.tick else {
            return Ok(());
        };
        let requested = |request| tick.events.contains(&Event::Request(request));
        let mode = tick.output.mode;
        let was_underway = core::mem::replace(&mut self.underway, mode.is_underway());
        let armed = Arming::ALL
            .into_iter()
            .any(|arming| requested(PilotRequest::Arm(arming)));
        if self.underway && !was_underway && !armed {
            return Err(format!("mode {mode} without an arm request"));
        }
        // A stop must not be lost, even among many requests.
        let mut pending = observation.pending_requests.iter().copied();
        if let Some(stop) = pending.find(|request| request.is_stop() && !requested(*request)) {
            return Err(format!("the pilot did not receive the request {stop}"));
        }
        if requested(PilotRequest::EmergencyStop) && mode != Mode::Fault {
            return Err(format!(
                "mode {mode} in the tick of an emergency stop request"
            ));
        }
        let follows = matches!(
            mode,
            Mode::Arming | Mode::Driving | Mode::Slowing | Mode::Jogging
        );
        let mut stops = PilotRequest::ALL.into_iter().filter(|stop| stop.is_stop());
        if was_underway
            && follows
            && let Some(stop) = stops.find(|stop| requested(*stop))
        {
            return Err(format!("mode {mode} in the tick of the request {stop}"));
        }
        if was_underway && requested(PilotRequest::Halt) && mode == Mode::Stopping {
            return Err("a ramp in the tick of a request to halt".to_owned());
        }
        if (tick.output.command.is_some() || tick.output.jog.is_some()) && !self.underway {
            return Err(format!("a command in mode {mode}"));
        }
        Ok(())
    }
}

/// `waits-still`: a car that was armed for a later start is commanded to stand until then.
#[derive(Default)]
pub(super) struct Waits {
    waiting: bool,
    underway: bool,
    daemon_since_us: Option<u64>,
}

impl Invariant for Waits {
    fn name(&self) -> &'static str {
        "waits-still"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        if observation.daemon_since_us != self.daemon_since_us {
            self.daemon_since_us = observation.daemon_since_us;
            (self.waiting, self.underway) = (false, false);
        }
        let Some(tick) = observation.tick else {
            return Ok(());
        };
        let output = &tick.output;
        for event in &tick.events {
            match event {
                // One that comes in a drive is without effect.
                Event::Request(PilotRequest::Arm(Arming::Waiting)) => {
                    self.waiting |= !self.underway;
                }
                Event::Request(PilotRequest::Arm(_)) => {
                    self.waiting &= self.underway;
                }
                Event::Begin(_) => self.waiting = false,
                _ => {}
            }
        }
        self.underway = output.mode.is_underway();
        self.waiting &= self.underway;
        match output.command {
            Some(command) if self.waiting && command.rear_speed != 0.0 => Err(format!(
                "{} m/s commanded before the start",
                command.rear_speed
            )),
            _ => Ok(()),
        }
    }
}

/// `latched-stop`: after the board has reported a latched emergency stop, it does
/// not drive until it is reset.
#[derive(Default)]
pub(super) struct Latched {
    latched_us: Option<u64>,
    board_since_us: Option<u64>,
}

impl Invariant for Latched {
    fn name(&self) -> &'static str {
        "latched-stop"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        if observation.board_since_us != self.board_since_us {
            self.board_since_us = observation.board_since_us;
            self.latched_us = None;
        }
        if observation.board_mode == Some(BoardMode::EmergencyStopped) {
            self.latched_us.get_or_insert(observation.now_us);
        }
        let Some(latched_us) = self.latched_us else {
            return Ok(());
        };
        for pulse in observation.pulses {
            // The telemetry may arrive before the pulse that it describes.
            if pulse.drives() && pulse.time_us > latched_us + SERVO_US + 1_000 {
                return Err(format!(
                    "ESC pulse {} µs with a latched emergency stop",
                    pulse.esc_us
                ));
            }
        }
        Ok(())
    }
}
