//! ESC pulse from the commanded speed, with the change to reverse and back.
//!
//! After driving forward, a car's ESC interprets the first pulse below neutral as
//! brake, and only a second one, after neutral, as reverse. To change to reverse,
//! the board therefore brakes for at least [`BRAKE_US`] until the wheels stand
//! still, but no longer than [`MAX_BRAKE_US`]; then gives neutral for at least
//! [`PAUSE_US`] until the wheels stand still; and then drives. To change to
//! forward, it gives neutral until the wheels stand still.
//!
//! An ESC of another kind gets no brake before reverse: [`EscKind`].
//!
//! The brake pulse is given only where it brakes, that is, after driving forward.
//! An ESC that has just braked would interpret it as full reverse. It ends after
//! [`MAX_BRAKE_US`], when the wheels stand, and when they speed up again: an ESC that
//! takes the pulse for reverse, whatever the configuration says, drives for a moment
//! only.

use singletrack_protocol::{Configuration, EscCalibration, EscKind, FailsafeAction, JOG_LIMIT_US};

use crate::{
    clock::Stopwatch,
    speed::{Room, SpeedController},
    steering::SlewLimiter,
};

/// ESC pulse before the configuration, in µs: neutral for nearly every ESC.
/// Also that of an emergency stop, which trusts no configuration.
pub(crate) const NEUTRAL_AT_BOOT_US: u16 = 1_500;

/// Shortest braking before reverse.
pub(crate) const BRAKE_US: u32 = 200_000;

/// Shortest neutral between brake and reverse.
pub(crate) const PAUSE_US: u32 = 200_000;

/// Longest braking.
pub(crate) const MAX_BRAKE_US: u32 = 500_000;

/// Driving time without a pause after which the ESC has driven for certain: three
/// servo frames. What lasts for less may have ended before a frame began, and the ESC
/// would take the next pulse below neutral for a second one, which is reverse.
const DRIVEN_US: u32 = 60_000;

/// A car that is faster than its command by this is braked, if the command says so.
/// Below, it rolls: a brake pulse is not worth its jerk.
pub(crate) const BRAKE_ABOVE_MM_S: i16 = 150;

/// A car that is faster than its slowest speed while braking by this, and by a
/// quarter, speeds up.
const SPEEDS_UP_MM_S: i16 = 50;

/// A brake pulse.
#[derive(Clone, Copy, Debug)]
struct Brake {
    since: Stopwatch,
    slowest_mm_s: i16,
}

impl Brake {
    const fn started() -> Self {
        Self {
            since: Stopwatch::started(),
            slowest_mm_s: i16::MAX,
        }
    }

    /// Advances time; whether the pulse must end.
    fn ends(&mut self, elapsed_us: u32, motion: Motion) -> bool {
        self.since.advance(elapsed_us);
        let speed = motion.speed_mm_s;
        self.slowest_mm_s = self.slowest_mm_s.min(speed);
        let slowest = self.slowest_mm_s;
        let speeds_up = speed.saturating_sub(slowest) > slowest / 4 + SPEEDS_UP_MM_S;
        !motion.moving || speeds_up || self.since.elapsed_us() >= MAX_BRAKE_US
    }
}

/// The wheels by the motor pulses.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Motion {
    pub(crate) moving: bool,
    /// Magnitude of the speed.
    pub(crate) speed_mm_s: i16,
    /// The wheels turn for certain, however fast they have slowed down since the last pulse.
    pub(crate) rolls: bool,
}

/// Direction of travel, with the phases before reverse.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Gear {
    Forward,
    /// Braking before reverse.
    Braking,
    /// Neutral before reverse.
    Pausing,
    Reverse,
}

/// The electronic speed controller.
#[derive(Clone, Debug)]
pub(crate) struct Esc {
    gear: Gear,
    in_gear: Stopwatch,
    /// Whether a pulse below neutral brakes: the ESC was driven forward, and has been
    /// neither braked since nor in another gear.
    can_brake: bool,
    /// Whether the wheels have turned for certain ever since the ESC was driven. One whose wheels
    /// stand at neutral takes the next pulse below it for reverse, and pulses that are far apart
    /// show a standstill late.
    rolled_on: bool,
    /// Time for which the pulse has been beyond the deadband, forward.
    driven: Stopwatch,
    /// The brake pulse of a stop, by the board or by the host.
    braking: Option<Brake>,
    /// The slowest speed in [`Gear::Braking`].
    before_reverse: Brake,
    /// Present pulse and target of the slew limiter, relative to neutral, in µs.
    offset_us: i16,
    target_us: i16,
    slew: SlewLimiter,
    speed: SpeedController,
}

impl Esc {
    pub(crate) const fn new() -> Self {
        Self {
            gear: Gear::Forward,
            in_gear: Stopwatch::started(),
            can_brake: false,
            rolled_on: false,
            driven: Stopwatch::started(),
            braking: None,
            before_reverse: Brake::started(),
            offset_us: 0,
            target_us: 0,
            slew: SlewLimiter::new(0),
            speed: SpeedController::new(),
        }
    }

    /// Applies a configuration. A braking stop continues unless the configuration
    /// coasts or the ESC has no brake.
    pub(crate) fn configure(&mut self, configuration: &Configuration) {
        self.slew = SlewLimiter::new(configuration.esc.slew_us_per_20ms);
        let brakes = configuration.failsafe == FailsafeAction::Brake;
        if !brakes || !configuration.esc.kind.has_brake() {
            self.release();
        }
    }

    /// Goes to neutral without braking.
    pub(crate) fn release(&mut self) {
        self.braking = None;
        self.neutral();
        // The ESC stays in reverse, so the gear does too.
        if self.gear != Gear::Reverse {
            self.gear = Gear::Forward;
        }
    }

    /// Goes to neutral, after braking if `brakes` and possible.
    pub(crate) fn stop(&mut self, brakes: bool, motion: Motion) {
        // One that the host or a change to reverse has started continues.
        let before_reverse = (self.gear == Gear::Braking).then_some(self.before_reverse);
        let started = (self.can_brake && self.rolled_on && motion.rolls).then(Brake::started);
        let braking = self.braking.or(before_reverse).or(started);
        self.release();
        if brakes && braking.is_some() {
            self.can_brake = false;
            self.braking = braking;
        }
    }

    /// Starts the brake pulse.
    fn brake(&mut self) {
        self.neutral();
        self.can_brake = false;
        self.braking = Some(Brake::started());
    }

    const fn neutral(&mut self) {
        self.driven = Stopwatch::started();
        self.offset_us = 0;
        self.target_us = 0;
        self.speed.reset();
    }

    /// Whether the ESC is in reverse.
    pub(crate) fn is_reverse(&self) -> bool {
        self.gear == Gear::Reverse
    }

    /// Whether the pulse must turn the motor: beyond the deadband, or resting at
    /// its edge, which drives the car if the configured deadband is too wide.
    pub(crate) const fn is_driving(&self, calibration: &EscCalibration) -> bool {
        match self.gear {
            Gear::Forward | Gear::Reverse => {
                let beyond = self.offset_us.unsigned_abs();
                let rests = self.offset_us != 0 && self.offset_us == self.target_us;
                beyond > calibration.deadband_us || (rests && beyond == calibration.deadband_us)
            }
            Gear::Braking | Gear::Pausing => false,
        }
    }

    /// Advances time while stopped.
    pub(crate) fn advance_stopped(&mut self, elapsed_us: u32, motion: Motion) {
        self.rolled_on &= motion.rolls;
        self.braking
            .take_if(|braking| braking.ends(elapsed_us, motion));
    }

    /// Advances time while driving at `target_mm_s`.
    pub(crate) fn advance_driving(
        &mut self,
        calibration: &EscCalibration,
        elapsed_us: u32,
        target_mm_s: i16,
        brake: bool,
        motion: Motion,
    ) {
        // The pulse that has held since the last poll, however long ago that is.
        let drove = self.earns_brake(calibration);
        let slow = motion.speed_mm_s <= target_mm_s;
        self.braking
            .take_if(|braking| braking.ends(elapsed_us, motion) || !brake || slow);
        self.in_gear.advance(elapsed_us);
        let brake_ends = self.gear == Gear::Braking && self.before_reverse.ends(elapsed_us, motion);
        self.shift(calibration.kind, target_mm_s, motion.moving, brake_ends);
        if self.gear == Gear::Braking {
            self.target_us = offset_us(calibration.brake_us, calibration);
        } else if !self.gear.drives(target_mm_s) {
            self.neutral();
        }
        // Changes towards neutral are immediate, away from it limited. The pulse
        // never crosses neutral: every change of direction starts with neutral, see
        // `shift`.
        if self.target_us.unsigned_abs() < self.offset_us.unsigned_abs() {
            self.offset_us = self.target_us;
        }
        self.offset_us = self
            .slew
            .approach(self.offset_us, self.target_us, elapsed_us);
        if !self.earns_brake(calibration) {
            self.rolled_on &= motion.rolls;
            self.driven = Stopwatch::started();
        } else if drove {
            self.rolled_on = true;
            self.driven.advance(elapsed_us);
            self.can_brake |= self.driven.elapsed_us() >= DRIVEN_US;
        }
    }

    /// Whether the pulse drives forward for certain: not at the edge of the deadband,
    /// where the ESC may not drive.
    fn earns_brake(&self, calibration: &EscCalibration) -> bool {
        self.gear == Gear::Forward && i32::from(self.offset_us) > calibration.deadband_us.into()
    }

    /// Advances time while jogging with the pulse `jog_us`, which is clamped.
    ///
    /// The pulse changes as in a drive: at once towards neutral, slowly away from it,
    /// and through neutral from one side to the other. What an ESC does with a pulse
    /// below neutral is not known here, so that nothing rests on it: jogging ends
    /// without a brake pulse.
    pub(crate) fn advance_jogging(
        &mut self,
        calibration: &EscCalibration,
        elapsed_us: u32,
        jog_us: u16,
    ) {
        let limit_us = JOG_LIMIT_US.cast_signed();
        let pulse_us = jog_us.min(calibration.max_us).max(calibration.min_us);
        self.target_us = offset_us(pulse_us, calibration)
            .min(limit_us)
            .max(-limit_us);
        let crosses = (self.target_us ^ self.offset_us) < 0;
        if crosses {
            self.offset_us = 0;
        } else if self.target_us.unsigned_abs() < self.offset_us.unsigned_abs() {
            self.offset_us = self.target_us;
        }
        self.offset_us = self
            .slew
            .approach(self.offset_us, self.target_us, elapsed_us);
        self.can_brake = false;
        // A stop before this drive may not have ended yet.
        self.braking = None;
        // The sign of the measured speed.
        if self.offset_us != 0 {
            self.gear = if self.offset_us < 0 {
                Gear::Reverse
            } else {
                Gear::Forward
            };
        }
    }

    /// Whether the pulse is neutral.
    pub(crate) const fn is_neutral(&self) -> bool {
        self.offset_us == 0
    }

    /// Runs one control period of the speed loop.
    #[inline(never)]
    pub(crate) fn control(
        &mut self,
        configuration: &Configuration,
        target_mm_s: i16,
        measured_mm_s: i16,
        brake: bool,
    ) {
        let calibration = &configuration.esc;
        let too_fast = measured_mm_s.saturating_sub(target_mm_s) > BRAKE_ABOVE_MM_S;
        if brake
            && too_fast
            && target_mm_s >= 0
            && self.gear == Gear::Forward
            && self.can_brake
            && self.rolled_on
            && calibration.kind.has_brake()
        {
            self.brake();
        }
        if self.braking.is_some() || !self.gear.drives(target_mm_s) {
            return;
        }
        let limit_us = match self.gear {
            Gear::Reverse => -offset_us(calibration.min_us, calibration),
            _ => offset_us(calibration.max_us, calibration),
        };
        let deadband_us = i32::from(calibration.deadband_us);
        let room = Room {
            highest: i32::from(limit_us) - deadband_us,
            lagging: self.offset_us != self.target_us,
        };
        let beyond_us = self.speed.update(
            &configuration.speed,
            i32::from(target_mm_s).abs(),
            measured_mm_s.into(),
            room,
        );
        // A car that is too fast gets neutral, not the brake.
        let pulse_us = (deadband_us + beyond_us).min(limit_us.into()).max(0) as i16;
        self.target_us = match self.gear {
            Gear::Reverse => -pulse_us,
            _ => pulse_us,
        };
    }

    fn shift(&mut self, kind: EscKind, target_mm_s: i16, moving: bool, brake_ends: bool) {
        let backward = target_mm_s < 0;
        let time_us = self.in_gear.elapsed_us();
        let gear = match self.gear {
            Gear::Forward
                if backward && self.can_brake && self.rolled_on && kind == EscKind::Car =>
            {
                Gear::Braking
            }
            Gear::Forward if backward => Gear::Pausing,
            Gear::Braking | Gear::Pausing if !backward => Gear::Forward,
            Gear::Braking if brake_ends && (moving || time_us >= BRAKE_US) => Gear::Pausing,
            Gear::Pausing if time_us >= PAUSE_US && !moving => Gear::Reverse,
            Gear::Reverse if target_mm_s > 0 && !moving => Gear::Forward,
            unchanged => unchanged,
        };
        if gear != self.gear {
            self.can_brake = false;
            self.gear = gear;
            self.in_gear = Stopwatch::started();
            self.before_reverse = Brake::started();
            self.braking = None;
            self.neutral();
        }
    }

    /// The pulse, in µs, always within the limits.
    pub(crate) fn pulse_us(&self, calibration: &EscCalibration) -> u16 {
        if self.braking.is_some() {
            return calibration.brake_us;
        }
        calibration
            .neutral_us
            .saturating_add_signed(self.offset_us)
            .min(calibration.max_us)
            .max(calibration.min_us)
    }
}

impl Gear {
    fn drives(self, target_mm_s: i16) -> bool {
        match self {
            Self::Forward => target_mm_s > 0,
            Self::Reverse => target_mm_s < 0,
            Self::Braking | Self::Pausing => false,
        }
    }
}

/// A validated pulse relative to neutral: at most 1400 µs either way.
fn offset_us(pulse_us: u16, calibration: &EscCalibration) -> i16 {
    (i32::from(pulse_us) - i32::from(calibration.neutral_us)) as i16
}

#[cfg(test)]
mod tests {
    use super::{Brake, MAX_BRAKE_US, Motion};

    const fn rolling(speed_mm_s: i16) -> Motion {
        Motion {
            moving: true,
            speed_mm_s,
            rolls: true,
        }
    }

    #[test]
    fn a_brake_ends_above_its_slowest_speed_by_a_quarter_and_50_mm_s() {
        for (slowest, fastest) in [(0, 50), (300, 425), (1_001, 1_301)] {
            let mut brake = Brake::started();
            assert!(!brake.ends(1_000, rolling(slowest + 200)));
            assert!(!brake.ends(1_000, rolling(slowest)));
            assert!(!brake.ends(1_000, rolling(fastest)), "{slowest}");
            assert!(brake.ends(1_000, rolling(fastest + 1)), "{slowest}");
        }
    }

    #[test]
    fn a_brake_ends_after_half_a_second_or_at_standstill() {
        let mut brake = Brake::started();
        assert!(!brake.ends(MAX_BRAKE_US - 1, rolling(500)));
        assert!(brake.ends(1, rolling(500)));
        let still = Motion {
            moving: false,
            speed_mm_s: 500,
            rolls: false,
        };
        assert!(Brake::started().ends(0, still));
    }
}
