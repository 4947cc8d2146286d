//! Many schedules on all cores.

use std::{
    any::Any,
    collections::{BTreeMap, BTreeSet},
    panic::{self, AssertUnwindSafe},
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    thread,
};

use singletrack_sim::BoardKind;

use crate::{
    DriveOutcome, SetupError, Untampered, Violation, drive, schedule::Schedule, tamper::Tamper,
};

/// What is done.
#[derive(Clone, Copy, Debug)]
pub struct Campaign {
    /// The first seed; the others follow it.
    pub first_seed: u64,
    /// How many seeds.
    pub count: u64,
    /// What runs on the board.
    pub board: BoardKind,
    /// On how many threads. It makes no difference to the outcome.
    pub threads: usize,
}

/// A schedule that broke something.
#[derive(Clone, Debug, PartialEq)]
pub struct Failure {
    /// The schedule.
    pub schedule: Schedule,
    /// What it broke.
    pub violation: Violation,
}

/// What a campaign came to.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CampaignOutcome {
    /// What broke something, in order of seeds.
    pub failures: Vec<Failure>,
    /// For how long the car was driven in all of them, in s.
    pub driven_s: f64,
    /// For how long they lasted, in s of their own time.
    pub simulated_s: f64,
    /// In how many of them each of the host's reasons not to drive came up.
    pub reasons: BTreeMap<&'static str, u64>,
}

/// Every so many schedules one is driven twice: both must be the same.
const REPEATED: u64 = 50;

impl Campaign {
    /// Runs it; `progress` is called after every schedule, from any thread.
    ///
    /// # Errors
    ///
    /// What can't be set up.
    pub fn run(&self, progress: &(impl Fn() + Sync)) -> Result<CampaignOutcome, SetupError> {
        let next = AtomicU64::new(0);
        let results = Mutex::new(Vec::new());
        thread::scope(|scope| {
            for _ in 0..self.threads.max(1) {
                scope.spawn(|| {
                    loop {
                        let number = next.fetch_add(1, Ordering::Relaxed);
                        if number >= self.count {
                            return;
                        }
                        let result = self.one(self.first_seed.wrapping_add(number));
                        let failed = result.is_err();
                        results
                            .lock()
                            .unwrap_or_else(PoisonError::into_inner)
                            .push((number, result));
                        progress();
                        if failed {
                            // It would be the same for all others.
                            next.store(self.count, Ordering::Relaxed);
                        }
                    }
                });
            }
        });
        let mut results = results.into_inner().unwrap_or_else(PoisonError::into_inner);
        results.sort_by_key(|(number, _)| *number);
        let mut outcome = CampaignOutcome::default();
        for (_, result) in results {
            let (schedule, drive_outcome) = result?;
            outcome.add(schedule, drive_outcome);
        }
        Ok(outcome)
    }

    fn one(&self, seed: u64) -> Result<(Schedule, DriveOutcome), SetupError> {
        let schedule = Schedule::generate(seed, self.board);
        let mut drive_outcome = attempt(&schedule, &mut Untampered)?;
        if drive_outcome.violation.is_none() && seed.is_multiple_of(REPEATED) {
            let again = attempt(&schedule, &mut Untampered)?;
            if again.digest != drive_outcome.digest {
                drive_outcome.violation = Some(Violation {
                    invariant: "repeatable",
                    time_us: u64::from(schedule.end_ms) * 1_000,
                    details: format!("{:016x} and {:016x}", drive_outcome.digest, again.digest),
                });
            }
        }
        Ok((schedule, drive_outcome))
    }
}

impl CampaignOutcome {
    /// Adds what a schedule came to.
    pub fn add(&mut self, schedule: Schedule, drive_outcome: DriveOutcome) {
        self.driven_s += f64::from(drive_outcome.driven_ms) * 1e-3;
        self.simulated_s += f64::from(schedule.end_ms) * 1e-3;
        for reason in drive_outcome.reasons {
            *self.reasons.entry(reason).or_default() += 1;
        }
        self.failures
            .extend(drive_outcome.violation.map(|violation| Failure {
                schedule,
                violation,
            }));
    }
}

/// Drives a schedule; a panic is a violation of the invariant `panic`.
///
/// # Errors
///
/// What can't be set up.
pub fn attempt(schedule: &Schedule, tamper: &mut dyn Tamper) -> Result<DriveOutcome, SetupError> {
    panic::catch_unwind(AssertUnwindSafe(|| drive(schedule, tamper))).unwrap_or_else(|payload| {
        Ok(DriveOutcome {
            digest: 0,
            reasons: BTreeSet::new(),
            violation: Some(Violation {
                invariant: "panic",
                time_us: 0,
                details: message(payload.as_ref()),
            }),
            driven_ms: 0,
        })
    })
}

fn message(payload: &(dyn Any + Send)) -> String {
    let text = payload.downcast_ref::<&str>().map(ToString::to_string);
    text.or_else(|| payload.downcast_ref::<String>().cloned())
        .unwrap_or_else(|| "no message".to_owned())
}
