//! Runs many schedules on all cores.

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
    DriveOutcome, SetupError, Untampered, Until, Violation, drive, schedule::Schedule,
    tamper::Tamper,
};

/// The schedules to run.
#[derive(Clone, Copy, Debug)]
pub struct Campaign {
    /// First seed; the others follow consecutively.
    pub first_seed: u64,
    /// Number of seeds.
    pub count: u64,
    /// Implementation of the board.
    pub board: BoardKind,
    /// Number of threads. It does not affect the outcome.
    pub threads: usize,
    /// Where a drive ends.
    pub until: Until,
}

/// A schedule that violated an invariant.
#[derive(Clone, Debug, PartialEq)]
pub struct Failure {
    /// The failing schedule.
    pub schedule: Schedule,
    /// The first violation.
    pub violation: Violation,
}

/// Results of a campaign.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CampaignOutcome {
    /// The failures, in order of seeds.
    pub failures: Vec<Failure>,
    /// Number of schedules in which each invariant was violated.
    pub violated: BTreeMap<&'static str, u64>,
    /// Total time with a driving ESC pulse, in s.
    pub driven_s: f64,
    /// Total simulated time, in s.
    pub simulated_s: f64,
    /// Number of schedules in which each of the host's reasons not to drive occurred.
    pub reasons: BTreeMap<&'static str, u64>,
}

/// Every seed divisible by this is run twice; both digests must be equal.
const REPEAT_INTERVAL: u64 = 50;

impl Campaign {
    /// Runs all schedules; calls `progress` after each, from any thread.
    ///
    /// # Errors
    ///
    /// Fails if a schedule cannot be set up.
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
                        let result = self.run_seed(self.first_seed.wrapping_add(number));
                        let failed = result.is_err();
                        results
                            .lock()
                            .unwrap_or_else(PoisonError::into_inner)
                            .push((number, result));
                        progress();
                        if failed {
                            // The other schedules would fail in the same way.
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

    fn run_seed(&self, seed: u64) -> Result<(Schedule, DriveOutcome), SetupError> {
        let schedule = Schedule::generate(seed, self.board);
        let mut drive_outcome = attempt_until(&schedule, &mut Untampered, self.until)?;
        if drive_outcome.violation.is_none() && seed.is_multiple_of(REPEAT_INTERVAL) {
            let again = attempt_until(&schedule, &mut Untampered, self.until)?;
            if again.digest != drive_outcome.digest {
                drive_outcome.violated.insert("repeatable");
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
    /// Adds the outcome of one schedule.
    pub fn add(&mut self, schedule: Schedule, drive_outcome: DriveOutcome) {
        self.driven_s += f64::from(drive_outcome.driven_ms) * 1e-3;
        self.simulated_s += f64::from(schedule.end_ms) * 1e-3;
        for invariant in drive_outcome.violated {
            *self.violated.entry(invariant).or_default() += 1;
        }
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

/// Runs a schedule; a panic counts as a violation of the invariant `panic`.
///
/// # Errors
///
/// Fails if a schedule cannot be set up.
pub fn attempt(schedule: &Schedule, tamper: &mut dyn Tamper) -> Result<DriveOutcome, SetupError> {
    attempt_until(schedule, tamper, Until::Violation)
}

/// Like [`attempt`], to the end that is given.
pub(crate) fn attempt_until(
    schedule: &Schedule,
    tamper: &mut dyn Tamper,
    until: Until,
) -> Result<DriveOutcome, SetupError> {
    let drive = AssertUnwindSafe(|| drive(schedule, tamper, until));
    panic::catch_unwind(drive).unwrap_or_else(|payload| {
        Ok(DriveOutcome {
            digest: 0,
            reasons: BTreeSet::new(),
            violated: BTreeSet::from(["panic"]),
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
