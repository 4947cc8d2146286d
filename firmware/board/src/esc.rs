//! From speed to ESC pulse, and the way into reverse and back.
//!
//! A car's ESC takes the first pulse below neutral, after driving forward, for
//! the brake, and only a second one, after neutral, for reverse. Into reverse
//! the board therefore brakes for [`BRAKE_US`] and on until the wheels stand
//! still, but no longer than [`LONGEST_BRAKE_US`]; shows neutral for [`PAUSE_US`]
//! and on until the wheels stand still; and then drives. Back to forward it
//! shows neutral until the wheels stand still.
//!
//! The braking pulse is given only while it brakes, that is, after driving
//! forward: to an ESC that has just braked it means reverse, at full length.

use singletrack_protocol::{Configuration, EscCalibration, FailsafeAction};

use crate::clock::Stopwatch;
use crate::slew::SlewLimiter;
use crate::speed::{Room, SpeedController};

/// Neutral of nearly every ESC, in µs: what it is given before the board is told.
pub(crate) const NEUTRAL_AT_BOOT_US: u16 = 1_500;

/// Shortest braking on the way into reverse.
pub(crate) const BRAKE_US: u32 = 200_000;

/// Neutral between brake and reverse.
pub(crate) const PAUSE_US: u32 = 200_000;

/// Longest braking, on the way into reverse and when the board stops the car.
pub(crate) const LONGEST_BRAKE_US: u32 = 500_000;

/// The direction in which the board drives, and the way into reverse.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Gear {
    Forward,
    /// On the way into reverse.
    Braking,
    /// On the way into reverse, in neutral.
    Pausing,
    Reverse,
}

/// The electronic speed controller.
#[derive(Debug)]
pub(crate) struct Esc {
    gear: Gear,
    in_gear: Stopwatch,
    /// Whether the ESC takes a pulse below neutral for the brake: it was
    /// driven forward, and has not been braked since.
    can_brake: bool,
    /// Braking because the board stops the car by itself.
    stopping: Option<Stopwatch>,
    /// Of the pulse from neutral, in µs: what is shown, and what it slews to.
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
            stopping: None,
            offset_us: 0,
            target_us: 0,
            slew: SlewLimiter::new(0),
            speed: SpeedController::new(),
        }
    }

    /// Uses a configuration from now on; a stop that brakes goes on braking
    /// unless it says to coast.
    pub(crate) fn configure(&mut self, configuration: &Configuration) {
        self.slew = SlewLimiter::new(configuration.esc.slew_us_per_20ms);
        if configuration.failsafe == FailsafeAction::Coast {
            self.release();
        }
    }

    /// Neutral from now on, without braking.
    pub(crate) fn release(&mut self) {
        self.stopping = None;
        self.neutral();
        if self.gear == Gear::Braking {
            self.can_brake = false;
        }
        // Reverse is kept: the ESC keeps it too.
        if self.gear != Gear::Reverse {
            self.gear = Gear::Forward;
        }
    }

    /// Neutral from now on, after braking if that is configured and helps.
    pub(crate) fn stop(&mut self, action: FailsafeAction) {
        let brakes = action == FailsafeAction::Brake && self.can_brake;
        self.release();
        if brakes {
            self.can_brake = false;
            self.stopping = Some(Stopwatch::started());
        }
    }

    const fn neutral(&mut self) {
        self.offset_us = 0;
        self.target_us = 0;
        self.speed.reset();
    }

    /// Whether the car was last driven in reverse.
    pub(crate) fn is_reverse(&self) -> bool {
        self.gear == Gear::Reverse
    }

    /// Whether the pulse is such that the motor has to turn: beyond the deadband,
    /// or resting at its very edge, where a deadband that was measured too wide
    /// drives the car.
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

    /// Time goes by while stopped.
    pub(crate) fn advance_stopped(&mut self, elapsed_us: u32, moving: bool) {
        if let Some(braking) = &mut self.stopping {
            braking.advance(elapsed_us);
            if !moving || braking.elapsed_us() >= LONGEST_BRAKE_US {
                self.stopping = None;
            }
        }
    }

    /// Time goes by while driving at the speed `wanted_mm_s`.
    pub(crate) fn advance_driving(
        &mut self,
        calibration: &EscCalibration,
        elapsed_us: u32,
        wanted_mm_s: i16,
        moving: bool,
    ) {
        self.stopping = None;
        self.in_gear.advance(elapsed_us);
        self.shift(wanted_mm_s, moving);
        if self.gear == Gear::Braking {
            self.target_us = offset_us(calibration.brake_us, calibration);
        } else if !self.gear.drives(wanted_mm_s) {
            self.neutral();
        }
        // Towards neutral at once, away from it slowly. Never across: every
        // change of direction begins with neutral, see `shift`.
        if self.target_us.unsigned_abs() < self.offset_us.unsigned_abs() {
            self.offset_us = self.target_us;
        }
        self.offset_us = self
            .slew
            .approach(self.offset_us, self.target_us, elapsed_us);
        if self.gear == Gear::Forward && self.is_driving(calibration) {
            self.can_brake = true;
        }
    }

    /// One control period of the speed loop.
    #[inline(never)]
    pub(crate) fn control(
        &mut self,
        configuration: &Configuration,
        wanted_mm_s: i16,
        measured_mm_s: i16,
    ) {
        if !self.gear.drives(wanted_mm_s) {
            return;
        }
        let calibration = &configuration.esc;
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
            i32::from(wanted_mm_s).abs(),
            measured_mm_s.into(),
            room,
        );
        // Too fast is neutral, not the brake.
        let pulse_us = (deadband_us + beyond_us).min(limit_us.into()).max(0) as i16;
        self.target_us = match self.gear {
            Gear::Reverse => -pulse_us,
            _ => pulse_us,
        };
    }

    fn shift(&mut self, wanted_mm_s: i16, moving: bool) {
        let backward = wanted_mm_s < 0;
        let time_us = self.in_gear.elapsed_us();
        let gear = match self.gear {
            Gear::Forward if backward && self.can_brake => Gear::Braking,
            Gear::Forward if backward => Gear::Pausing,
            Gear::Braking | Gear::Pausing if !backward => Gear::Forward,
            Gear::Braking if time_us >= LONGEST_BRAKE_US => Gear::Pausing,
            Gear::Braking if time_us >= BRAKE_US && !moving => Gear::Pausing,
            Gear::Pausing if time_us >= PAUSE_US && !moving => Gear::Reverse,
            Gear::Reverse if wanted_mm_s > 0 && !moving => Gear::Forward,
            unchanged => unchanged,
        };
        if gear != self.gear {
            if self.gear == Gear::Braking {
                self.can_brake = false;
            }
            self.gear = gear;
            self.in_gear = Stopwatch::started();
            self.neutral();
        }
    }

    /// The pulse, in µs, between the limits whatever happened.
    pub(crate) fn pulse_us(&self, calibration: &EscCalibration) -> u16 {
        if self.stopping.is_some() {
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
    fn drives(self, wanted_mm_s: i16) -> bool {
        match self {
            Self::Forward => wanted_mm_s > 0,
            Self::Reverse => wanted_mm_s < 0,
            Self::Braking | Self::Pausing => false,
        }
    }
}

/// A validated pulse relative to neutral: at most 1400 µs either way.
fn offset_us(pulse_us: u16, calibration: &EscCalibration) -> i16 {
    (i32::from(pulse_us) - i32::from(calibration.neutral_us)) as i16
}
