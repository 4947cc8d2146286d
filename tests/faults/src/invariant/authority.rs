//! Who has asked for what the car does.

use singletrack_pilot::{Event, Mode, Request};
use singletrack_protocol::{BoardMode, COMMAND_TIME_TO_LIVE_US, ToBoard, UNSOLICITED};

use super::{Invariant, SERVO_US, Verdict};
use crate::{observation::Observation, schedule::FaultKind};

/// From the moment that takes away the right to drive until the neutral pulse,
/// in µs: up to 10 ms until the main loop has heard of it, 1 ms until the
/// supervisor has passed it on, up to 20 ms until the next pulse; on a clock
/// that may be 0.5 % slow, stated as 45 ms.
const WITHDRAWAL_US: u64 = 45_000;

/// How long a command is in force by our reckoning: the image's clock is up to a
/// millisecond behind the one that it is judged by, and so is its polling.
const IN_FORCE_US: u32 = COMMAND_TIME_TO_LIVE_US + 2_000;

/// `unarmed-drive`: a pulse drives only if the board has been sent a request to
/// arm, after it and not too long ago a command, and since then nothing that
/// takes the right away: disarm, emergency stop, another session's greeting, a
/// start of the board, an open stop switch, or a command that ran out.
///
/// A board of our own, made from what passes its end of the line: it may think
/// that it is armed when the real one knows better, never the reverse.
#[derive(Default)]
pub(super) struct Unarmed {
    armed: bool,
    session: Option<(u32, u16)>,
    /// Board time of the telemetry behind the command in force.
    command_us: Option<u32>,
    /// Since when the right is gone, and what took it.
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

    fn hear(&mut self, time_us: u64, board_time_us: u32, message: &ToBoard) {
        match message {
            ToBoard::Hello(hello) if hello.nonce != UNSOLICITED => {
                let session = Some((hello.nonce, hello.protocol_version));
                if self.session != session {
                    self.session = session;
                    self.withdraw(time_us, "another session greeted");
                }
            }
            ToBoard::Arm(_) => self.armed = true,
            ToBoard::Disarm(_) => self.withdraw(time_us, "the board was told to disarm"),
            ToBoard::EmergencyStop(_) => self.withdraw(time_us, "the board was told to stop"),
            ToBoard::Drive(drive) if self.armed => {
                if board_time_us.wrapping_sub(drive.telemetry_time_us) <= IN_FORCE_US {
                    self.command_us = Some(drive.telemetry_time_us);
                }
            }
            ToBoard::Drive(_) | ToBoard::Hello(_) | ToBoard::Configure(_) => {}
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
            self.withdraw(observation.now_us, "the board was reset");
        }
        for heard in observation.heard {
            self.hear(heard.time_us, heard.board_time_us, &heard.message);
        }
        if observation.spec.board.stop_input && observation.is_active(FaultKind::StopInputOpen) {
            self.withdraw(observation.now_us, "the stop switch opened");
        }
        for pulse in observation.pulses {
            if let Some(command_us) = self.command_us {
                let age_us = pulse.board_time_us.wrapping_sub(command_us);
                if age_us < u32::MAX / 2 && age_us > IN_FORCE_US {
                    self.withdraw(pulse.time_us, "the last command had run out");
                }
            }
            if !observation.spec.drives(pulse) || (self.armed && self.command_us.is_some()) {
                continue;
            }
            let (since_us, cause) = self.withdrawn.unwrap_or((0, "nobody had armed the board"));
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

/// `unasked-drive`: the daemon sets out (goes from standing by to arming or
/// driving) only in a tick in which somebody asked for it, and a disarm or a
/// stop takes effect in the tick that hears of it. Recovery is an explicit act.
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
        if self.underway && !was_underway && !requested(Request::Arm) {
            return Err(format!("mode {mode}, and nobody asked to arm"));
        }
        // However much has come at once, a stop is not lost on the way.
        let stop = Request::EmergencyStop;
        if observation.pending_requests.contains(&stop) && !requested(stop) {
            return Err("an emergency stop was asked for, and the pilot does not know".to_owned());
        }
        if requested(Request::EmergencyStop) && mode != Mode::Fault {
            return Err(format!("mode {mode} in the tick of an emergency stop"));
        }
        if was_underway
            && requested(Request::Disarm)
            && matches!(mode, Mode::Arming | Mode::Driving | Mode::Slowing)
        {
            return Err(format!("mode {mode} in the tick of a request to disarm"));
        }
        if tick.output.command.is_some() && !self.underway {
            return Err(format!("a command in mode {mode}"));
        }
        Ok(())
    }
}

/// `latched-stop`: once the board has said that an emergency stop is latched, it
/// drives no more until it is reset.
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
            // The record may be on the line before the pulse that it tells of.
            if observation.spec.drives(pulse) && pulse.time_us > latched_us + SERVO_US + 1_000 {
                return Err(format!(
                    "ESC pulse {} µs, and an emergency stop is latched",
                    pulse.esc_us
                ));
            }
        }
        Ok(())
    }
}
