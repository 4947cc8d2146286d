//! Authority: the car drives only on request, and stops on request. Attended drives end with the
//! hand that holds them.

use singletrack_control::Time;
use singletrack_pilot::{Arming, Event, Mode, PilotRequest};
use singletrack_protocol::{
    BoardMode, COMMAND_TIME_TO_LIVE_US, JOG_DRIVE_US, JOG_LIMIT_US, JOG_SPEED_MM_S, Sequence,
    ToBoard, UNSOLICITED,
};

use super::{Invariant, SERVO_US, Verdict};
use crate::{
    observation::Observation,
    program::Renewed,
    schedule::{FaultKind, FaultTarget},
    spec::{Spec, TOLERANCE_US},
};

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

/// The longest times between two renewals of a held drive and of a jog: in s, as the host counts them
/// from tick to tick.
const HOLD_S: f64 = 0.5;
const JOG_S: f64 = 0.25;

/// Time for which a daemon that is silenced, or whose line is cut, is still obeyed: see
/// `host-silence`.
const HOST_SILENCE_US: u64 = 120_000;

/// From the last renewal of a jog to neutral, in µs: 0.25 s, a tick and its neighbour, and the board's
/// 45 ms; specified as 0.3 s.
const JOG_ENDS_US: u64 = 300_000;

/// The longest delay of a tick by a fault of the host, in µs.
const LATE_US: u64 = 60_000;

/// How a drive was armed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Armed {
    Unattended,
    Held,
    Jog,
}

/// `dead-man`: nobody who hangs drives. The pilot follows the reference of a held drive for at most 0.5 s
/// after the last renewal, jogs for at most 0.25 s after the last pulses, and the ESC gets neutral as
/// soon after that as after a disarm request.
///
/// A renewal counts from the tick that takes it, and the first one is the request to arm; for a
/// jog, it is its beginning.
#[derive(Default)]
pub(super) struct DeadMan {
    armed: Option<Armed>,
    /// The newest renewals, and the ticks that took them.
    seen: Renewed,
    drive: Option<Time>,
    jog: Option<Time>,
    mode: Option<Mode>,
    /// When the last one of the drive was sent, or when a jog began.
    renewed_us: u64,
    degraded: bool,
    daemon_since_us: Option<u64>,
}

impl DeadMan {
    /// Follows the tick; the time in s for which the pilot has gone on without a renewal, and for how
    /// long it may.
    fn tick(&mut self, observation: &Observation<'_>) -> Option<(f64, f64)> {
        let tick = observation.tick?;
        let now = tick.pilot_time;
        let mode = tick.output.mode;
        let before = self.mode.replace(mode);
        if mode == Mode::Arming && before != Some(Mode::Arming) {
            let armed = tick.events.iter().rev().find_map(|event| match event {
                Event::Request(PilotRequest::Arm(arming)) => Some(match arming {
                    Arming::Unattended => Armed::Unattended,
                    Arming::Held | Arming::Waiting => Armed::Held,
                    Arming::Jog => Armed::Jog,
                }),
                _ => None,
            });
            self.armed = armed;
            self.drive = Some(now);
            self.renewed_us = observation.now_us;
            self.degraded = false;
        }
        if mode == Mode::Jogging && before != Some(Mode::Jogging) {
            self.jog = Some(now);
            self.renewed_us = observation.now_us;
        }
        let seen = core::mem::replace(&mut self.seen, observation.renewed);
        if seen.drive_us != self.seen.drive_us {
            self.drive = Some(now);
        }
        if seen.jog_us != self.seen.jog_us {
            self.jog = Some(now);
        }
        let renewed_us = if mode == Mode::Jogging {
            self.seen.jog_us
        } else {
            self.seen.drive_us
        };
        // What comes after the drive renews nothing.
        if mode.is_underway() {
            self.renewed_us = self.renewed_us.max(renewed_us.unwrap_or(0));
        }
        let (since, longest) = match (self.armed?, mode) {
            (Armed::Held | Armed::Jog, Mode::Arming | Mode::Driving | Mode::Slowing) => {
                (self.drive?, HOLD_S)
            }
            (Armed::Held | Armed::Jog, Mode::Jogging) => (self.jog?, JOG_S),
            _ => return None,
        };
        Some((now.seconds_since(since), longest))
    }

    /// The time from the last renewal to neutral, in µs.
    fn limit_us(&self, spec: &Spec) -> Option<u64> {
        let silence_us = if self.degraded { HOST_SILENCE_US } else { 0 };
        match self.armed? {
            Armed::Unattended => None,
            Armed::Held => {
                let hold_us = (1e6 * HOLD_S) as u64;
                Some(hold_us + LATE_US + spec.stop_timeout_us + 10_000 + HOST_SILENCE_US)
            }
            Armed::Jog => Some(JOG_ENDS_US + silence_us + u64::from(self.degraded) * LATE_US),
        }
    }
}

impl Invariant for DeadMan {
    fn name(&self) -> &'static str {
        "dead-man"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        if observation.daemon_since_us.is_some()
            && observation.daemon_since_us != self.daemon_since_us
        {
            // The last command of its predecessor: see `host-silence`.
            *self = Self {
                daemon_since_us: observation.daemon_since_us,
                ..Self::default()
            };
        }
        self.degraded |= observation.is_blinded();
        if let Some((silent_s, longest_s)) = self.tick(observation)
            && silent_s > longest_s + 1e-9
        {
            return Err(format!(
                "mode {} {silent_s:.3} s after the operator's last renewal, {longest_s} allowed",
                self.mode.map_or("", Mode::name)
            ));
        }
        let Some(limit_us) = self.limit_us(observation.spec) else {
            return Ok(());
        };
        for pulse in observation.pulses {
            let after_us = pulse.time_us.saturating_sub(self.renewed_us);
            if pulse.drives() && after_us > limit_us {
                return Err(format!(
                    "ESC pulse {} µs {} ms after the operator's last renewal, {} allowed",
                    pulse.esc_us,
                    after_us / 1_000,
                    limit_us / 1_000
                ));
            }
        }
        Ok(())
    }
}

/// `at-once`: neutral within 50 ms of the tick that is told to halt, or in which a jog is told to
/// end by anybody, as after an emergency stop, and within 120 ms if line or board have a
/// fault.
#[derive(Default)]
pub(super) struct AtOnce {
    requested_us: Option<u64>,
    degraded: bool,
    mode: Option<Mode>,
}

const AT_ONCE_US: u64 = 50_000;

impl Invariant for AtOnce {
    fn name(&self) -> &'static str {
        "at-once"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        if let Some(tick) = observation.tick {
            let before = self.mode.replace(tick.output.mode);
            let commanded = before.is_some_and(Mode::commands);
            let told = tick.events.iter().any(|event| match event {
                Event::Request(PilotRequest::Halt) => commanded,
                Event::Request(request) => before == Some(Mode::Jogging) && request.is_stop(),
                _ => false,
            });
            if told {
                self.requested_us = Some(observation.now_us);
                self.degraded = false;
            } else if tick.output.mode == Mode::Arming {
                // A later command belongs to another drive, which was requested.
                self.requested_us = None;
            }
        }
        let degrades = |target| matches!(target, FaultTarget::Line | FaultTarget::Board);
        let mut faults = observation.faults.iter();
        self.degraded |= faults.any(|fault| degrades(fault.kind.target()));
        let Some(requested_us) = self.requested_us else {
            return Ok(());
        };
        let limit_us = if self.degraded {
            HOST_SILENCE_US
        } else {
            AT_ONCE_US
        };
        for pulse in observation.pulses {
            let after_us = pulse.time_us.saturating_sub(requested_us);
            if pulse.drives() && after_us > limit_us {
                return Err(format!(
                    "ESC pulse {} µs {} ms after a request to stop at once, {} allowed",
                    pulse.esc_us,
                    after_us / 1_000,
                    limit_us / 1_000
                ));
            }
        }
        Ok(())
    }
}

/// `jog-limits`: while the board jogs, the ESC's pulse is within 150 µs of neutral, drives for at most
/// 10 s without a frame of neutral, and not on for 0.15 s above 1 m/s of the wheels.
///
/// Faults of the motor sensor and interference change the speed that the board sees.
#[derive(Default)]
pub(super) struct JogLimits {
    /// Begin of the frames that drive without a pause, and of the speed beyond the limit.
    driven_us: Option<u64>,
    fast_us: Option<u64>,
}

/// On a clock that may be 0.5 % slow, with the frame in progress and a round of the main loop.
const DRIVEN_US: u64 = JOG_DRIVE_US as u64 + 50_000 + SERVO_US + 10_000;

/// Time in which the board measures a speed from pulses and ends the pulse: two pulses of 3 cm at the limit,
/// 21 ms, and the frame in progress.
const FAST_US: u64 = 150_000;

/// What the speed may exceed its limit by until it is seen.
const FASTER: f64 = 1.1;

impl Invariant for JogLimits {
    fn name(&self) -> &'static str {
        "jog-limits"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        if !observation.jogs {
            *self = Self::default();
            return Ok(());
        }
        let spec = observation.spec;
        let sees_speed = !spec.has_interference
            && [
                FaultKind::PulsesGone,
                FaultKind::PulsesHalved,
                FaultKind::PulsesErratic,
            ]
            .into_iter()
            .all(|kind| !observation.is_active(kind));
        let measured = observation.truth.wheel_speed.abs() / spec.true_pulse_share;
        if sees_speed && measured > FASTER * 1e-3 * f64::from(JOG_SPEED_MM_S) {
            self.fast_us.get_or_insert(observation.now_us);
        } else {
            self.fast_us = None;
        }
        let neutral_us = spec.board.esc.neutral_us;
        for pulse in observation.pulses {
            if !pulse.drives() {
                self.driven_us = None;
                continue;
            }
            let driven_us = *self.driven_us.get_or_insert(pulse.time_us);
            let for_us = pulse.time_us - driven_us;
            let fast_us = self.fast_us.map_or(0, |since_us| {
                pulse.time_us.saturating_sub(since_us.max(driven_us))
            });
            let found = if pulse.esc_us.abs_diff(neutral_us) > JOG_LIMIT_US + TOLERANCE_US {
                format!("{neutral_us} µs is neutral")
            } else if for_us > DRIVEN_US {
                format!("driven for {} ms", for_us / 1_000)
            } else if fast_us > FAST_US {
                format!("{measured:.2} m/s for {} ms", fast_us / 1_000)
            } else {
                continue;
            };
            return Err(format!("ESC pulse {} µs of a jog, {found}", pulse.esc_us));
        }
        Ok(())
    }
}
