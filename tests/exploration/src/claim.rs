//! What must hold in every tick, of every interleaving; and mistakes that the exploration must
//! find.

use singletrack_board::Outputs;
use singletrack_protocol::{BoardMode, COMMAND_TIME_TO_LIVE_US, Configuration, ToBoard};

/// The longest age of the telemetry behind a command that drives, in µs.
const COMMAND_US: u32 = COMMAND_TIME_TO_LIVE_US;

/// The longest time from a stop that the board must be told of to neutral: as without a line.
const STOP_TICKS: u32 = 12;

/// The longest time from a request to disarm to neutral: the ramp is done by the host.
const DISARM_TICKS: u32 = 170;

/// The longest time for which an arm request is in effect after the operator took it back: it was
/// under way, and late.
const ARM_TICKS: u32 = 3;

/// Time of neutral before the first drive after a start, in ticks.
const NEUTRAL_TICKS: u32 = 200;

/// Ticks without a pose beyond which no claim tells them apart: more than any configuration allows.
const LONG: u32 = 120;

/// What an operator wants.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Wish {
    /// A drive.
    Drive,
    /// Pulses by hand.
    Jog,
}

/// How a wish ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Ended {
    /// The car slows down first.
    Ramp,
    /// At once.
    AtOnce,
}

/// What is known from outside: operator, line, cameras.
#[derive(Clone, Debug)]
pub(crate) struct Claims {
    /// The last wish, and the configuration that it was for.
    wish: Option<(Wish, Configuration)>,
    /// How the operator took it back, and for how long it has been so.
    ended: Option<(Ended, u32)>,
    /// Board time of the newest telemetry behind a command that has reached the board, in µs.
    behind: Option<u32>,
    since_pose: u32,
    since_board_start: u32,
    latched: bool,
    last_mode: BoardMode,
}

/// A claim that does not hold.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Violation {
    /// Its name.
    pub claim: &'static str,
    /// The values against it.
    pub found: String,
}

/// What the claims are checked against in a tick.
#[derive(Debug)]
pub(crate) struct Facts<'a> {
    pub(crate) mode: BoardMode,
    pub(crate) outputs: &'a Outputs,
    pub(crate) configuration: Option<&'a Configuration>,
    /// The board's clock, in µs.
    pub(crate) board_us: u32,
    /// Board time of the telemetry behind a command that has reached the board, in µs.
    pub(crate) behind: Option<u32>,
    /// Whether the cameras see the car.
    pub(crate) pose: bool,
}

/// Whether the ESC's pulse may drive: there is no reverse here, and a pulse below neutral brakes.
pub(crate) fn drives(outputs: &Outputs) -> bool {
    outputs
        .esc_us
        .is_some_and(|pulse| pulse > outputs.esc_neutral_us)
}

impl Claims {
    pub(crate) const fn new() -> Self {
        Self {
            wish: None,
            ended: None,
            behind: None,
            since_pose: LONG,
            since_board_start: 0,
            latched: false,
            last_mode: BoardMode::Boot,
        }
    }

    /// The operator asks for a drive. What was wanted before, and is not over, is not wanted again.
    pub(crate) fn wished(&mut self, wish: Wish, configuration: Configuration) {
        self.wish = Some((wish, configuration));
        self.ended = None;
    }

    /// The wish is over.
    pub(crate) fn end(&mut self, how: Ended) {
        self.ended = match (self.ended, how) {
            // A stop on top of a disarm.
            (Some((Ended::Ramp, _)) | None, Ended::AtOnce) => Some((how, 0)),
            (None, Ended::Ramp) => Some((how, 0)),
            (ended, _) => ended,
        };
    }

    pub(crate) const fn board_restarted(&mut self) {
        self.since_board_start = 0;
        self.behind = None;
        self.latched = false;
        self.last_mode = BoardMode::Boot;
    }

    /// Counts a tick, and checks the claims.
    pub(crate) fn check(&mut self, facts: &Facts<'_>) -> Result<(), Violation> {
        let newest = self.behind.max(facts.behind);
        // Of a motor at neutral nothing is claimed.
        let moves = drives(facts.outputs);
        self.behind = newest.filter(|_| moves || facts.behind.is_some());
        self.since_pose = if facts.pose {
            0
        } else {
            (self.since_pose + 1).min(LONG)
        };
        self.since_board_start = (self.since_board_start + 1).min(NEUTRAL_TICKS);
        if let Some((_, ticks)) = &mut self.ended {
            *ticks += 1;
        }
        let (armed, was_armed) = (facts.mode.is_armed(), self.last_mode.is_armed());
        // Within a poll it may be disarmed and armed again.
        let begins = matches!(facts.mode, BoardMode::Armed | BoardMode::PoweringUp);
        let drove = matches!(self.last_mode, BoardMode::Driving | BoardMode::Jogging);
        let arms = armed && (!was_armed || (begins && drove));
        let verdict = self.judge(facts, armed, arms);
        if was_armed && !armed {
            // Another drive needs another wish.
            self.end(Ended::AtOnce);
        }
        self.last_mode = facts.mode;
        // A board that boots, or has latched a stop, does not arm so soon.
        let rests = matches!(facts.mode, BoardMode::Boot | BoardMode::EmergencyStopped);
        if !armed
            && self
                .ended
                .is_some_and(|(_, ticks)| rests || ticks > ARM_TICKS)
        {
            self.wish = None;
            self.ended = None;
        }
        self.latched |= facts.mode == BoardMode::EmergencyStopped;
        verdict
    }

    fn judge(&self, facts: &Facts<'_>, armed: bool, arms: bool) -> Result<(), Violation> {
        let claim = |holds: bool, claim, found: &dyn core::fmt::Debug| {
            if holds {
                return Ok(());
            }
            Err(Violation {
                claim,
                found: format!("{found:?}, board {:?}, {self:?}", facts.mode),
            })
        };
        let drives = drives(facts.outputs);
        let esc = &facts.outputs.esc_us;
        let commanded = matches!(facts.mode, BoardMode::Driving | BoardMode::Jogging);
        claim(!drives || commanded, "unarmed", esc)?;
        let age_us = self
            .behind
            .map(|behind| facts.board_us.wrapping_sub(behind));
        claim(
            !drives || age_us.is_some_and(|age_us| age_us <= COMMAND_US),
            "command-age",
            &age_us,
        )?;
        let latched = facts.mode == BoardMode::EmergencyStopped;
        claim(!self.latched || latched, "latched", &facts.mode)?;
        claim(
            !drives || self.since_board_start >= NEUTRAL_TICKS,
            "neutral-first",
            &self.since_board_start,
        )?;
        // Nothing arms, and nothing drives, that nobody wants.
        let Some((wish, configuration)) = &self.wish else {
            return claim(!armed, "unasked", &"no wish");
        };
        if let Some((how, ticks)) = self.ended {
            claim(!arms || ticks <= ARM_TICKS, "unasked", &how)?;
            let longest = match how {
                Ended::Ramp => DISARM_TICKS,
                Ended::AtOnce => STOP_TICKS,
            };
            claim(!drives || ticks <= longest, "stop", &how)?;
        }
        let other = match wish {
            Wish::Drive => BoardMode::Jogging,
            Wish::Jog => BoardMode::Driving,
        };
        claim(facts.mode != other, "mode", wish)?;
        if armed {
            claim(
                facts.configuration == Some(configuration),
                "configuration",
                wish,
            )?;
        }
        let pose_ticks = (u32::from(configuration.max_pose_age_ms) * 1_000 + COMMAND_US) / 10_000;
        claim(
            !drives || facts.mode == BoardMode::Jogging || self.since_pose <= pose_ticks,
            "pose-age",
            &self.since_pose,
        )
    }
}

/// A mistake on the way to the board, or at the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Planted {
    /// An emergency stop is not passed on to the supervisor.
    StopIgnored,
    /// A command counts from its arrival, not from the telemetry behind it.
    CommandRenewed,
    /// A request to disarm is passed on as one to arm.
    DisarmArms,
    /// The board does not hear that it is to disarm.
    DisarmLost,
}

impl Planted {
    /// All of them.
    pub const ALL: [Self; 4] = [
        Self::StopIgnored,
        Self::CommandRenewed,
        Self::DisarmArms,
        Self::DisarmLost,
    ];

    pub(crate) fn tamper(self, arrived: &mut Vec<ToBoard>, board_us: u32) {
        match self {
            Self::StopIgnored | Self::DisarmArms => {}
            Self::CommandRenewed => {
                for message in arrived {
                    if let ToBoard::Drive(drive) = message {
                        drive.telemetry_time_us = board_us;
                    }
                }
            }
            Self::DisarmLost => arrived.retain(|message| !matches!(message, ToBoard::Disarm(_))),
        }
    }
}
