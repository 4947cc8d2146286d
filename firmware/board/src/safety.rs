//! The safety state machine: permission to drive, and its end.
//!
//! ```text
//! Boot --2 s of neutral--> Neutral --Arm--> Armed --Drive--> Driving
//!                             ^               |----Jog----> Jogging
//!                             |               |                 |
//!                             +----Disarm-----+-----------------+
//! Failsafe          from Armed, Driving and Jogging; left by Arm
//! EmergencyStopped  from every state; left only by a reset
//! ```
//!
//! With a kill output, `PoweringUp` lies between `Arm` and `Armed`: the ESC's supply
//! is switched on and its neutral is held for two seconds.
//!
//! `Armed` lasts for a second at most: a host that drives sends its first command at
//! once.
//!
//! From `Armed` the first command decides: a board that drives refuses [`Jog`], and one
//! that jogs refuses [`Drive`], until it is armed again.
//!
//! A command is in force until its own time to live or the age limit of its pose
//! ends, whichever is first. Both are measured on the board's clock from the
//! telemetry that the host had received, so that a delay on the line does not
//! prolong a command.

use singletrack_protocol::{
    Arm, BoardMode, COMMAND_TIME_TO_LIVE_US, Configuration, Drive, Jog, RefusalReason, Sequence,
    StopCause,
};

use crate::clock::{Stopwatch, age_us};

/// Time at neutral before arming; ESCs arm after a second or more.
pub(crate) const NEUTRAL_HOLD_US: u32 = 2_000_000;

/// Time for which an emergency stop gives a neutral pulse before the pin falls
/// silent: an ESC that holds its last pulse for a while holds this one. Ten servo
/// frames are enough for that, and an ESC whose neutral is another one drives on for
/// no longer.
pub(crate) const SILENCE_AFTER_US: u32 = 200_000;

/// Longest time between arming, or the end of powering up, and the first command. A
/// host that is gone must leave neither an armed board nor a held kill output.
const FIRST_COMMAND_US: u32 = 1_000_000;

/// Conditions for arming, besides the state of the machine.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ArmingConditions {
    pub(crate) configuration_hash: Option<u32>,
    pub(crate) version_differs: bool,
    pub(crate) moving: bool,
    /// False unless the stop input is configured.
    pub(crate) stop_input_open: bool,
    /// The ESC gets its supply only now.
    pub(crate) kill_output: bool,
}

/// What a command asks of servo and ESC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Action {
    /// A [`Drive`].
    Drive {
        speed_mm_s: i16,
        /// Brake down to the speed.
        brake: bool,
    },
    /// A [`Jog`].
    Jog { esc_us: u16 },
}

/// A command that was accepted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Command {
    pub(crate) action: Action,
    /// Board time of the telemetry behind it.
    telemetry_time_us: u32,
    /// Time after that until its pose reaches the configured age.
    pose_time_to_live_us: u32,
}

impl Command {
    /// Time after `telemetry_time_us` for which it is in force, and the cause of its
    /// end.
    const fn time_to_live(&self) -> (u32, StopCause) {
        let cause = match self.action {
            Action::Drive { .. } => StopCause::CommandTimeout,
            Action::Jog { .. } => StopCause::JogTimeout,
        };
        if self.pose_time_to_live_us < COMMAND_TIME_TO_LIVE_US {
            (self.pose_time_to_live_us, StopCause::PoseTooOld)
        } else {
            (COMMAND_TIME_TO_LIVE_US, cause)
        }
    }

    const fn deadline_us(&self) -> u32 {
        self.telemetry_time_us.wrapping_add(self.time_to_live().0)
    }
}

#[derive(Clone, Debug)]
pub(crate) struct Safety {
    mode: BoardMode,
    cause: StopCause,
    /// Time since the present neutral pulse was first output.
    neutral: Stopwatch,
    /// Time since the last stop by the board.
    failed: Stopwatch,
    /// Time since arming; in `Armed`, since the ESC was ready.
    armed: Stopwatch,
    /// The last request that armed; repeated, it does not arm again.
    arm_request: Option<Sequence>,
    /// The command in force; only while driving or jogging.
    command: Option<Command>,
    last_sequence: Sequence,
    /// The switch was closed once; only then can it open.
    stop_input_closed: bool,
}

impl Safety {
    pub(crate) const fn new() -> Self {
        Self {
            mode: BoardMode::Boot,
            cause: StopCause::None,
            neutral: Stopwatch::started(),
            failed: Stopwatch::started_ago(u32::MAX),
            armed: Stopwatch::started(),
            arm_request: None,
            command: None,
            last_sequence: Sequence(0),
            stop_input_closed: false,
        }
    }

    pub(crate) const fn mode(&self) -> BoardMode {
        self.mode
    }

    pub(crate) const fn cause(&self) -> StopCause {
        self.cause
    }

    pub(crate) const fn last_sequence(&self) -> Sequence {
        self.last_sequence
    }

    /// The command in force; only while driving or jogging.
    pub(crate) const fn command(&self) -> Option<&Command> {
        self.command.as_ref()
    }

    pub(crate) fn drive_deadline_us(&self) -> Option<u32> {
        self.command.as_ref().map(Command::deadline_us)
    }

    /// Whether the stop is latched.
    pub(crate) const fn is_latched(&self) -> bool {
        matches!(self.mode, BoardMode::EmergencyStopped)
    }

    /// Whether the ESC gets no pulses any more: a while after a latched stop, and at
    /// once where it is the neutral pulse that drives.
    pub(crate) const fn is_silent(&self) -> bool {
        self.is_latched()
            && (self.failed.elapsed_us() >= SILENCE_AFTER_US
                || matches!(self.cause, StopCause::RunsAtNeutral))
    }

    pub(crate) const fn is_armed(&self) -> bool {
        self.mode.is_armed()
    }

    /// Advances time. Runs before received bytes are processed, so that a late
    /// command does not revive an expired one.
    pub(crate) fn advance(&mut self, now_us: u32, elapsed_us: u32) {
        self.neutral.advance(elapsed_us);
        self.failed.advance(elapsed_us);
        self.armed.advance(elapsed_us);
        if self.mode == BoardMode::PoweringUp && self.armed.elapsed_us() >= NEUTRAL_HOLD_US {
            self.mode = BoardMode::Armed;
            self.armed = Stopwatch::started();
        }
        if self.mode == BoardMode::Armed && self.armed.elapsed_us() >= FIRST_COMMAND_US {
            self.fail(StopCause::CommandTimeout);
        }
        if self.mode == BoardMode::Boot && self.neutral.elapsed_us() >= NEUTRAL_HOLD_US {
            self.mode = BoardMode::Neutral;
        }
        if let Some(command) = &self.command {
            let (time_to_live_us, cause) = command.time_to_live();
            let age = age_us(now_us, command.telemetry_time_us);
            if age.is_none_or(|age| age > time_to_live_us) {
                self.fail(cause);
            }
        }
    }

    /// Processes the level of a configured stop input.
    pub(crate) const fn observe_stop_input(&mut self, open: bool) {
        if !open {
            self.stop_input_closed = true;
        } else if self.stop_input_closed {
            self.latch(StopCause::StopInput);
        }
    }

    /// Notes a new configuration.
    pub(crate) const fn configured(&mut self, neutral_changed: bool) {
        self.stop_input_closed = false;
        if neutral_changed {
            self.neutral = Stopwatch::started();
            if matches!(self.mode, BoardMode::Neutral) {
                self.mode = BoardMode::Boot;
            }
        }
    }

    /// Whether a configuration is accepted in this state.
    pub(crate) const fn may_configure(&self) -> Result<(), RefusalReason> {
        match self.mode {
            BoardMode::Boot | BoardMode::Neutral | BoardMode::Failsafe => Ok(()),
            BoardMode::Armed | BoardMode::Driving | BoardMode::PoweringUp | BoardMode::Jogging => {
                Err(RefusalReason::Busy)
            }
            BoardMode::EmergencyStopped => Err(RefusalReason::EmergencyStopLatched),
        }
    }

    pub(crate) fn arm(
        &mut self,
        now_us: u32,
        arm: &Arm,
        conditions: ArmingConditions,
    ) -> Result<(), RefusalReason> {
        if self.is_armed() {
            // Repeated because the answer was lost.
            return if self.arm_request == Some(arm.request) {
                Ok(())
            } else {
                Err(RefusalReason::Busy)
            };
        }
        if conditions.stop_input_open {
            return Err(RefusalReason::StopInputOpen);
        }
        if self.mode == BoardMode::EmergencyStopped {
            return Err(RefusalReason::EmergencyStopLatched);
        }
        if conditions.version_differs {
            return Err(RefusalReason::VersionDiffers);
        }
        match conditions.configuration_hash {
            None => return Err(RefusalReason::NotConfigured),
            Some(hash) if hash != arm.configuration_hash => {
                return Err(RefusalReason::ConfigurationDiffers);
            }
            Some(_) => {}
        }
        let age = fresh_age_us(now_us, arm.telemetry_time_us)?;
        if age > self.failed.elapsed_us() {
            // The host sent it before it knew of the stop.
            return Err(RefusalReason::Stale);
        }
        if self.arm_request == Some(arm.request) {
            // It armed once; the board has stopped the car since.
            return Err(RefusalReason::OutOfSequence);
        }
        if self.mode == BoardMode::Boot || self.neutral.elapsed_us() < NEUTRAL_HOLD_US {
            return Err(RefusalReason::NotYetNeutral);
        }
        if conditions.moving {
            return Err(RefusalReason::Moving);
        }
        self.armed = Stopwatch::started();
        self.mode = if conditions.kill_output {
            BoardMode::PoweringUp
        } else {
            BoardMode::Armed
        };
        self.arm_request = Some(arm.request);
        Ok(())
    }

    pub(crate) fn drive(
        &mut self,
        now_us: u32,
        drive: &Drive,
        configuration: Option<&Configuration>,
    ) -> Result<(), RefusalReason> {
        let Some(configuration) = configuration else {
            // Not armed either.
            return Err(if self.is_latched() {
                RefusalReason::EmergencyStopLatched
            } else {
                RefusalReason::NotConfigured
            });
        };
        let age = self.may_command(
            now_us,
            drive.sequence,
            drive.telemetry_time_us,
            BoardMode::Driving,
        )?;
        let pose_time_to_live_us = configuration
            .max_pose_age_ms
            .checked_sub(drive.pose_age_ms)
            .map(|left_ms| u32::from(left_ms) * 1_000)
            .filter(|&left_us| age <= left_us)
            .ok_or(RefusalReason::PoseTooOld)?;
        let speed = &configuration.speed;
        if drive.speed_mm_s < 0 && speed.max_reverse_mm_s == 0 {
            return Err(RefusalReason::ReverseDisabled);
        }
        let action = Action::Drive {
            speed_mm_s: i32::from(drive.speed_mm_s)
                .min(speed.max_forward_mm_s.into())
                .max(-i32::from(speed.max_reverse_mm_s)) as i16,
            brake: drive.brake,
        };
        self.mode = BoardMode::Driving;
        self.last_sequence = drive.sequence;
        self.command = Some(Command {
            action,
            telemetry_time_us: drive.telemetry_time_us,
            pose_time_to_live_us,
        });
        Ok(())
    }

    /// Accepts pulses instead of a drive. They rest on no pose.
    pub(crate) fn jog(&mut self, now_us: u32, jog: &Jog) -> Result<(), RefusalReason> {
        self.may_command(
            now_us,
            jog.sequence,
            jog.telemetry_time_us,
            BoardMode::Jogging,
        )?;
        self.mode = BoardMode::Jogging;
        self.last_sequence = jog.sequence;
        self.command = Some(Command {
            action: Action::Jog { esc_us: jog.esc_us },
            telemetry_time_us: jog.telemetry_time_us,
            pose_time_to_live_us: u32::MAX,
        });
        Ok(())
    }

    /// Whether a command with this number that leads to `mode` is accepted; the age of
    /// the telemetry behind it.
    #[inline(never)]
    fn may_command(
        &self,
        now_us: u32,
        sequence: Sequence,
        telemetry_time_us: u32,
        mode: BoardMode,
    ) -> Result<u32, RefusalReason> {
        match self.mode {
            BoardMode::EmergencyStopped => return Err(RefusalReason::EmergencyStopLatched),
            BoardMode::PoweringUp => return Err(RefusalReason::NotYetNeutral),
            BoardMode::Boot | BoardMode::Neutral | BoardMode::Failsafe => {
                return Err(RefusalReason::NotArmed);
            }
            BoardMode::Armed => {}
            BoardMode::Driving | BoardMode::Jogging => {
                if self.mode != mode {
                    return Err(RefusalReason::Busy);
                }
            }
        }
        let age = fresh_age_us(now_us, telemetry_time_us)?;
        if self.mode == mode && !sequence.is_newer_than(self.last_sequence) {
            return Err(RefusalReason::OutOfSequence);
        }
        Ok(age)
    }

    /// Ends driving at the request of the host.
    pub(crate) const fn disarm(&mut self) {
        if self.is_armed() {
            self.mode = BoardMode::Neutral;
            self.cause = StopCause::Disarmed;
            self.command = None;
        }
    }

    /// Stops: a new session does not know what was armed.
    pub(crate) const fn host_restarted(&mut self) {
        self.fail(StopCause::HostRestarted);
        self.arm_request = None;
    }

    /// Stops until armed again; no effect unless armed.
    pub(crate) const fn fail(&mut self, cause: StopCause) {
        if self.is_armed() {
            self.mode = BoardMode::Failsafe;
            self.failed = Stopwatch::started();
            self.cause = cause;
            self.command = None;
        }
    }

    /// Stops until reset. The first cause is kept.
    pub(crate) const fn latch(&mut self, cause: StopCause) {
        if !matches!(self.mode, BoardMode::EmergencyStopped) {
            self.mode = BoardMode::EmergencyStopped;
            self.failed = Stopwatch::started();
            self.cause = cause;
            self.command = None;
        }
    }
}

/// Age of the telemetry behind a request, if within the time to live.
fn fresh_age_us(now_us: u32, telemetry_time_us: u32) -> Result<u32, RefusalReason> {
    age_us(now_us, telemetry_time_us)
        .filter(|&age| age <= COMMAND_TIME_TO_LIVE_US)
        .ok_or(RefusalReason::Stale)
}
