//! From a schedule that breaks something to a small one that breaks the same.

use crate::{
    SetupError, Violation,
    campaign::attempt,
    schedule::{Fault, Schedule, Situation},
    tamper::Tamper,
};

/// So many drives at most are tried.
const MOST_DRIVES: u32 = 400;

/// The smallest schedule that was found to break the same invariant, and how.
///
/// # Errors
///
/// What can't be set up.
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
    // What could not be left out at first may be once others are gone.
    loop {
        let before = shrinker.best.clone();
        shrinker.drop_entries()?;
        shrinker.simplify_situation()?;
        shrinker.weaken()?;
        shrinker.cut_the_end()?;
        if shrinker.best == before || shrinker.drives >= MOST_DRIVES {
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
    /// Takes over a smaller schedule if it breaks the same invariant.
    fn attempt(&mut self, smaller: Schedule) -> Result<bool, SetupError> {
        if smaller == self.best || self.drives >= MOST_DRIVES {
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

    /// Nothing after the violation matters.
    fn cut_the_end(&mut self) -> Result<(), SetupError> {
        let end_ms = u32::try_from(self.violation.time_us / 1_000 + 1).unwrap_or(u32::MAX);
        let mut smaller = self.best.clone();
        smaller.end_ms = smaller.end_ms.min(end_ms);
        smaller.requests.retain(|ask| ask.at_ms < end_ms);
        smaller.faults.retain(|fault| fault.at_ms < end_ms);
        self.attempt(smaller).map(drop)
    }

    fn drop_entries(&mut self) -> Result<(), SetupError> {
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

    /// Everything that can be as usual.
    fn simplify_situation(&mut self) -> Result<(), SetupError> {
        let usual = Situation::default();
        let changes: [fn(&mut Situation, &Situation); 10] = [
            |s, usual| s.reference = usual.reference,
            |s, usual| s.speed_mm_s = usual.speed_mm_s,
            |s, usual| s.fence_mm = usual.fence_mm,
            |s, usual| s.coast = usual.coast,
            |s, usual| s.brake = usual.brake,
            |s, usual| s.stop_input = usual.stop_input,
            |s, usual| s.reset_on_open = usual.reset_on_open,
            |s, usual| s.queue_shows = usual.queue_shows,
            |s, usual| {
                s.camera_latency_ms = usual.camera_latency_ms;
                s.serial_delay_us = usual.serial_delay_us;
            },
            |s, usual| {
                s.board_skew_ppm = usual.board_skew_ppm;
                s.board_clock_ms = usual.board_clock_ms;
            },
        ];
        for change in changes {
            let mut smaller = self.best.clone();
            change(&mut smaller.situation, &usual);
            self.attempt(smaller)?;
        }
        Ok(())
    }

    /// Shorter and milder faults.
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
