//! Reduces a failing schedule to a small one that violates the same invariant.

use crate::{
    SetupError, Violation,
    campaign::attempt,
    schedule::{Deviation, Fault, Schedule, Situation},
    tamper::Tamper,
};

/// Maximum number of drives.
const MAX_DRIVES: u32 = 400;

/// Returns the smallest schedule found that violates the same invariant, and the
/// violation.
///
/// # Errors
///
/// Fails if a schedule can't be set up.
pub fn shrink<T: Tamper>(
    schedule: &Schedule,
    violation: &Violation,
    tamper: impl Fn() -> T,
) -> Result<(Schedule, Violation), SetupError> {
    let mut shrinker = Shrinker {
        best: schedule.clone(),
        violation: violation.clone(),
        drives: 0,
        tamper,
    };
    shrinker.cut_the_end()?;
    // An entry may become removable once others are gone.
    loop {
        let before = shrinker.best.clone();
        shrinker.drop_entries()?;
        shrinker.simplify_situation()?;
        shrinker.weaken()?;
        shrinker.cut_the_end()?;
        if shrinker.best == before || shrinker.drives >= MAX_DRIVES {
            return Ok((shrinker.best, shrinker.violation));
        }
    }
}

struct Shrinker<F> {
    best: Schedule,
    violation: Violation,
    drives: u32,
    tamper: F,
}

impl<T: Tamper, F: Fn() -> T> Shrinker<F> {
    /// Adopts a smaller schedule if it violates the same invariant.
    fn attempt(&mut self, smaller: Schedule) -> Result<bool, SetupError> {
        if smaller == self.best || self.drives >= MAX_DRIVES {
            return Ok(false);
        }
        self.drives += 1;
        let drive_outcome = attempt(&smaller, &mut (self.tamper)())?;
        match drive_outcome.violation {
            Some(violation) if violation.invariant == self.violation.invariant => {
                self.best = smaller;
                self.violation = violation;
                Ok(true)
            }
            _ => Ok(false),
        }
    }

    /// Removes everything after the violation.
    fn cut_the_end(&mut self) -> Result<(), SetupError> {
        let end_ms = u32::try_from(self.violation.time_us / 1_000 + 1).unwrap_or(u32::MAX);
        let mut smaller = self.best.clone();
        smaller.end_ms = smaller.end_ms.min(end_ms);
        smaller.requests.retain(|ask| ask.at_ms < end_ms);
        smaller.faults.retain(|fault| fault.at_ms < end_ms);
        self.attempt(smaller).map(drop)
    }

    fn drop_entries(&mut self) -> Result<(), SetupError> {
        let mut smaller = self.best.clone();
        smaller.truth.esc = None;
        self.attempt(smaller)?;
        for deviation in Deviation::ALL {
            let mut smaller = self.best.clone();
            smaller.truth.deviations.remove(deviation);
            self.attempt(smaller)?;
        }
        let mut index = 0;
        while index < self.best.faults.len() {
            let mut smaller = self.best.clone();
            smaller.faults.remove(index);
            if !self.attempt(smaller)? {
                index += 1;
            }
        }
        let mut index = 0;
        while index < self.best.requests.len() {
            let mut smaller = self.best.clone();
            smaller.requests.remove(index);
            if !self.attempt(smaller)? {
                index += 1;
            }
        }
        Ok(())
    }

    /// Resets what it can of the situation to defaults.
    fn simplify_situation(&mut self) -> Result<(), SetupError> {
        let default = Situation::default();
        let changes: [fn(&mut Situation, &Situation); 18] = [
            |s, default| s.reference = default.reference,
            |s, default| s.speed_mm_s = default.speed_mm_s,
            |s, default| s.fence_mm = default.fence_mm,
            |s, default| s.kill_output = default.kill_output,
            |s, default| s.esc_kind = default.esc_kind,
            |s, default| s.proved = default.proved,
            |s, default| s.neutral_us = default.neutral_us,
            |s, default| s.braking_mm_s2 = default.braking_mm_s2,
            |s, default| s.pulse_distance_um = default.pulse_distance_um,
            |s, default| s.attended = default.attended,
            |s, default| s.coast = default.coast,
            |s, default| s.brake = default.brake,
            |s, default| s.stop_input = default.stop_input,
            |s, default| s.reset_on_open = default.reset_on_open,
            |s, default| s.own_supply = default.own_supply,
            |s, default| s.queue_shows = default.queue_shows,
            |s, default| {
                s.camera_latency_ms = default.camera_latency_ms;
                s.serial_delay_us = default.serial_delay_us;
            },
            |s, default| {
                s.board_skew_ppm = default.board_skew_ppm;
                s.board_clock_ms = default.board_clock_ms;
            },
        ];
        for change in changes {
            let mut smaller = self.best.clone();
            change(&mut smaller.situation, &default);
            self.attempt(smaller)?;
        }
        Ok(())
    }

    /// Shortens and weakens the faults.
    fn weaken(&mut self) -> Result<(), SetupError> {
        for index in 0..self.best.faults.len() {
            self.halve(index, |fault| &mut fault.for_ms)?;
            self.halve(index, |fault| &mut fault.severity)?;
        }
        Ok(())
    }

    fn halve(&mut self, index: usize, part: fn(&mut Fault) -> &mut u32) -> Result<(), SetupError> {
        loop {
            let mut smaller = self.best.clone();
            let Some(fault) = smaller.faults.get_mut(index) else {
                return Ok(());
            };
            let value = part(fault);
            *value = (*value / 2).max(1);
            if !self.attempt(smaller)? {
                return Ok(());
            }
        }
    }
}
