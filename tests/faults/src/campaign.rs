//! Runs many schedules, and adds up what became of them; reduces a failing one to a small one that
//! violates the same invariant.

use std::{
    any::Any,
    collections::{BTreeMap, BTreeSet},
    panic::{self, AssertUnwindSafe},
    path::PathBuf,
};

use serde::{Deserialize, Serialize};
use singletrack_campaign::Experiment;
use singletrack_sim::{BoardKind, Installation};

use crate::{
    DriveOutcome, FilterTicks, SetupError, Untampered, Until, Violation, drive, invariant,
    schedule::{Deviation, Fault, Schedule, ScheduleError, Situation},
    tamper::Tamper,
};

/// The schedules to run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Campaign {
    /// First seed; the others follow consecutively.
    pub first_seed: u64,
    /// Number of seeds.
    pub count: u64,
    /// Implementation of the board.
    pub board: BoardKind,
    /// Where a drive ends.
    pub until: Until,
}

/// What became of a schedule, as a result file has it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SeedOutcome {
    /// The seed of the schedule.
    pub seed: u64,
    /// A hash of all events of the drive, in hexadecimal digits.
    pub digest: String,
    /// How long the drive was simulated at most, in ms.
    pub end_ms: u32,
    /// How long the motor was driven, in ms.
    pub driven_ms: u32,
    /// The names of the reasons for which the host did not drive.
    pub reasons: BTreeSet<String>,
    /// The names of the violated invariants.
    pub violated: BTreeSet<String>,
    /// Whether the schedule has a hostile outer loop.
    pub hostile: bool,
    /// What the safety filter did.
    pub filter: FilterTicks,
    /// The first violation, if there was one.
    pub failure: Option<SeedFailure>,
}

/// The first violation of a schedule, as a result file has it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SeedFailure {
    /// The schedule, in one line.
    pub schedule: String,
    /// The invariant's name.
    pub invariant: String,
    /// When, in µs of the simulation.
    pub time_us: u64,
    /// What the invariant found.
    pub details: String,
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
    /// Number of schedules.
    pub count: u64,
    /// The failures, in order of seeds.
    pub failures: Vec<Failure>,
    /// Number of schedules in which each invariant was violated.
    pub violated: BTreeMap<String, u64>,
    /// Total time with a driving ESC pulse, in s.
    pub driven_s: f64,
    /// Total simulated time, in s.
    pub simulated_s: f64,
    /// Number of schedules in which each of the host's reasons not to drive occurred.
    pub reasons: BTreeMap<String, u64>,
    /// What the safety filter did, without a hostile outer loop and with one; and in how many
    /// schedules it drove.
    pub filter: [(u64, FilterTicks); 2],
}

/// Why a result can't be read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The schedule is of another version.
    #[error("seed {seed}: {source}")]
    Schedule {
        /// The seed.
        seed: u64,
        /// What is wrong with the schedule.
        source: ScheduleError,
    },
    /// The invariant is of another version.
    #[error("seed {seed}: there is no invariant {name:?}")]
    Invariant {
        /// The seed.
        seed: u64,
        /// The invariant's name.
        name: String,
    },
    /// The invariants can't be named.
    #[error(transparent)]
    Setup(#[from] SetupError),
}

/// Every seed divisible by this is run twice; both digests must be equal.
const REPEAT_INTERVAL: u64 = 50;

impl Experiment for Campaign {
    const NAME: &'static str = "faults";
    type Result = SeedOutcome;

    fn units(&self) -> u64 {
        self.count
    }

    fn files(&self) -> Vec<PathBuf> {
        // Without an installation no schedule can be set up, which says so.
        match (self.board, Installation::find()) {
            (BoardKind::Uno, Ok(Installation { program, image })) => vec![program, image],
            _ => Vec::new(),
        }
    }

    fn run(&self, unit: u64) -> singletrack_campaign::Result<SeedOutcome> {
        let seed = self.first_seed.wrapping_add(unit);
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
        Ok(SeedOutcome::new(&schedule, drive_outcome))
    }
}

impl SeedOutcome {
    /// The outcome of a schedule.
    pub fn new(schedule: &Schedule, outcome: DriveOutcome) -> Self {
        let names = |names: BTreeSet<&str>| names.into_iter().map(str::to_owned).collect();
        Self {
            seed: schedule.seed,
            digest: format!("{:016x}", outcome.digest),
            end_ms: schedule.end_ms,
            driven_ms: outcome.driven_ms,
            reasons: names(outcome.reasons),
            hostile: schedule
                .faults
                .iter()
                .any(|fault| fault.kind.is_hostile_loop()),
            filter: outcome.filter,
            violated: names(outcome.violated),
            failure: outcome.violation.map(|violation| SeedFailure {
                schedule: schedule.in_one_line(),
                invariant: violation.invariant.to_owned(),
                time_us: violation.time_us,
                details: violation.details,
            }),
        }
    }

    fn failure(&self, names: &[&'static str]) -> Result<Option<Failure>, ReadError> {
        let seed = self.seed;
        let Some(failure) = &self.failure else {
            return Ok(None);
        };
        let schedule = failure.schedule.parse();
        let invariant = names.iter().find(|name| **name == failure.invariant);
        Ok(Some(Failure {
            schedule: schedule.map_err(|source| ReadError::Schedule { seed, source })?,
            violation: Violation {
                invariant: invariant.ok_or_else(|| ReadError::Invariant {
                    seed,
                    name: failure.invariant.clone(),
                })?,
                time_us: failure.time_us,
                details: failure.details.clone(),
            },
        }))
    }
}

impl CampaignOutcome {
    /// Adds up the outcomes of schedules, in their order.
    ///
    /// # Errors
    ///
    /// An outcome is of another version.
    pub fn of<'a>(outcomes: impl IntoIterator<Item = &'a SeedOutcome>) -> Result<Self, ReadError> {
        let names = invariant::names()?;
        let mut sum = Self::default();
        for outcome in outcomes {
            sum.count += 1;
            sum.driven_s += f64::from(outcome.driven_ms) * 1e-3;
            let [tame, hostile] = &mut sum.filter;
            let (schedules, ticks) = if outcome.hostile { hostile } else { tame };
            *schedules += u64::from(outcome.filter.driving > 0);
            *ticks += outcome.filter;
            sum.simulated_s += f64::from(outcome.end_ms) * 1e-3;
            for (counts, names) in [
                (&mut sum.violated, &outcome.violated),
                (&mut sum.reasons, &outcome.reasons),
            ] {
                for name in names {
                    *counts.entry(name.clone()).or_default() += 1;
                }
            }
            sum.failures.extend(outcome.failure(&names)?);
        }
        Ok(sum)
    }
}

/// Runs a schedule; a panic counts as a violation of the invariant `panic`.
///
/// # Errors
///
/// Fails if a schedule can't be set up.
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
            filter: FilterTicks::default(),
        })
    })
}

pub(crate) fn message(payload: &(dyn Any + Send)) -> String {
    let text = payload.downcast_ref::<&str>().map(ToString::to_string);
    text.or_else(|| payload.downcast_ref::<String>().cloned())
        .unwrap_or_else(|| "no message".to_owned())
}

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
