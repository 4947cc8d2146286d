//! Which procedures a car has passed with which configuration.
//!
//! `doctor`, `bring-up` and `calibrate` follow each other, and each changes the configuration. A
//! procedure that passes therefore carries the earlier results over to the configuration that it
//! leaves, if they held for the one that it began with and it reports each of its changes. After
//! any other change, also one between an interruption and the end, they no longer count.

use core::fmt;

use serde::{Deserialize, Serialize};
use singletrack_control::words;

use crate::run::proof::hexadecimal;

words! {
    /// A procedure that a car passes before it drives, in their order.
    #[derive(PartialOrd, Ord, Hash)]
    pub enum Procedure: serde {
        /// Checks and measurements without driving.
        Doctor = "doctor",
        /// Steering and motor, with the wheels off the floor.
        BringUp = "bring-up",
        /// Measurements of drives on the floor.
        Calibrate = "calibrate",
    }
}

words! {
    /// The state that a procedure reports.
    pub enum ProcedureResult {
        /// It begins.
        Begun = "begun",
        /// It continues after an interruption.
        Resumed = "resumed",
        /// It has put another configuration in force.
        Changed = "changed",
        /// It has ended, and the next procedure may begin.
        Passed = "passed",
        /// It has ended, and the next procedure must not begin.
        Failed = "failed",
    }
}

/// A car with a configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Subject {
    /// The hash of the configuration: [`configuration_hash`](crate::configuration_hash).
    pub configuration: u64,
    /// The number of the car; 0 for a board without one.
    pub car_id: u16,
}

/// A result.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ProcedureEntry {
    /// The procedure.
    pub procedure: Procedure,
    /// The hash of the configuration.
    #[serde(with = "hexadecimal")]
    pub configuration: u64,
    /// The number of the car.
    pub car_id: u16,
    /// When, in seconds since 1970.
    pub time_s: u64,
}

/// A procedure that is under way, or was interrupted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Beginning {
    procedure: Procedure,
    car_id: u16,
    /// The hash of the configuration at the beginning.
    #[serde(with = "hexadecimal")]
    since: u64,
    /// The hash after the last change by the procedure itself.
    #[serde(with = "hexadecimal")]
    reached: u64,
}

/// Most results that are kept; older ones are dropped.
const MOST: usize = 64;

/// How long a result counts, in days: a car wears, and marker bodies are moved.
pub const VALID_DAYS: u64 = 90;

const DAY_S: u64 = 86_400;

/// What the cars have passed.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Commissioned {
    passed: Vec<ProcedureEntry>,
    begun: Vec<Beginning>,
}

/// Why a car may not be armed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NotCommissioned {
    /// The first procedure that has to be done.
    pub procedure: Procedure,
    /// Why its result does not count.
    pub why: Lapsed,
    /// The number of the car.
    pub car_id: u16,
}

/// Why the result of a procedure does not count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lapsed {
    /// There is none.
    Missing,
    /// It is of another configuration of this car.
    OtherConfiguration,
    /// It is of another car.
    OtherCar(u16),
    /// It is too old: days.
    Old(u64),
    /// It is dated in the future.
    Future,
}

impl fmt::Display for NotCommissioned {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (name, car) = (self.procedure.name(), self.car_id);
        match self.why {
            Lapsed::Missing => write!(f, "`singletrack {name}` has not passed on car {car}")?,
            Lapsed::OtherConfiguration => write!(
                f,
                "`singletrack {name}` has passed on car {car} with another configuration"
            )?,
            Lapsed::OtherCar(other) => write!(
                f,
                "`singletrack {name}` has passed on car {other} only, and this is car {car}"
            )?,
            Lapsed::Old(days) => write!(
                f,
                "the result of `singletrack {name}` is {days} days old, and counts for {VALID_DAYS}"
            )?,
            Lapsed::Future => write!(
                f,
                "the result of `singletrack {name}` is dated in the future: set the clock"
            )?,
        }
        write!(
            f,
            ". Run `singletrack {name}`, or give --uncalibrated: the car then drives with \
             values that have not been measured on it, and can steer to the wrong side, be faster \
             than commanded and stop later than the geofence allows"
        )
    }
}

impl Commissioned {
    /// Records the state of a procedure on a car, at a time in seconds since 1970.
    pub fn note(
        &mut self,
        procedure: Procedure,
        result: ProcedureResult,
        subject: Subject,
        time_s: u64,
    ) {
        let (configuration, car_id) = (subject.configuration, subject.car_id);
        let is_same = |other: &Beginning| other.procedure == procedure && other.car_id == car_id;
        let begun = self.begun.iter().copied().find(is_same);
        match result {
            ProcedureResult::Changed => {
                for begun in self.begun.iter_mut().filter(|other| is_same(other)) {
                    begun.reached = configuration;
                }
            }
            ProcedureResult::Resumed
                if begun.is_some_and(|begun| begun.reached == configuration) => {}
            ProcedureResult::Begun | ProcedureResult::Resumed => {
                self.begun.retain(|other| !is_same(other));
                let beginning = Beginning {
                    procedure,
                    car_id,
                    since: configuration,
                    reached: configuration,
                };
                push(&mut self.begun, beginning);
            }
            ProcedureResult::Passed => {
                if let Some(begun) = begun.filter(|begun| begun.reached == configuration) {
                    for other in &mut self.passed {
                        if other.car_id == car_id
                            && other.configuration == begun.since
                            && other.procedure < procedure
                        {
                            other.configuration = configuration;
                        }
                    }
                }
                self.begun.retain(|other| !is_same(other));
                self.forget(procedure, car_id);
                let entry = ProcedureEntry {
                    procedure,
                    configuration,
                    car_id,
                    time_s,
                };
                push(&mut self.passed, entry);
            }
            // It can be resumed, as after an interruption.
            ProcedureResult::Failed => self.forget(procedure, car_id),
        }
    }

    /// Drops the result of a procedure on a car.
    fn forget(&mut self, procedure: Procedure, car_id: u16) {
        self.passed
            .retain(|other| other.procedure != procedure || other.car_id != car_id);
    }

    /// The first procedure that has to be done before this car may be armed, at a time in
    /// seconds since 1970; `None` if all have passed.
    pub fn missing(&self, subject: Subject, now_s: u64) -> Option<NotCommissioned> {
        Procedure::ALL.into_iter().find_map(|procedure| {
            Some(NotCommissioned {
                procedure,
                why: self.lapsed(procedure, subject, now_s)?,
                car_id: subject.car_id,
            })
        })
    }

    /// The first procedure that has to be done before this one may begin, or go on after an
    /// interruption, on this car, at a time in seconds since 1970. What it has changed itself does not
    /// count against the earlier ones.
    pub fn missing_before(
        &self,
        procedure: Procedure,
        result: ProcedureResult,
        subject: Subject,
        now_s: u64,
    ) -> Option<NotCommissioned> {
        let goes_on = self.begun.iter().find(|begun| {
            result == ProcedureResult::Resumed
                && begun.procedure == procedure
                && begun.car_id == subject.car_id
                && begun.reached == subject.configuration
        });
        let since = goes_on.map_or(subject, |begun| Subject {
            configuration: begun.since,
            ..subject
        });
        self.missing(since, now_s)
            .filter(|missing| missing.procedure < procedure)
    }

    /// The results on this car, with any configuration.
    pub fn of_car(&self, car_id: u16) -> impl Iterator<Item = &ProcedureEntry> {
        self.passed
            .iter()
            .filter(move |entry| entry.car_id == car_id)
    }

    fn lapsed(&self, procedure: Procedure, subject: Subject, now_s: u64) -> Option<Lapsed> {
        let mut results = self
            .passed
            .iter()
            .filter(|entry| entry.procedure == procedure)
            .rev();
        let Some(entry) = results.clone().find(|entry| entry.car_id == subject.car_id) else {
            let other = results.next();
            return Some(other.map_or(Lapsed::Missing, |other| Lapsed::OtherCar(other.car_id)));
        };
        if entry.configuration != subject.configuration {
            return Some(Lapsed::OtherConfiguration);
        }
        // Clocks of two computers may differ by a few minutes.
        if entry.time_s > now_s + DAY_S {
            return Some(Lapsed::Future);
        }
        let days = now_s.saturating_sub(entry.time_s) / DAY_S;
        (days >= VALID_DAYS).then_some(Lapsed::Old(days))
    }
}

fn push<T>(entries: &mut Vec<T>, entry: T) {
    let too_many = (entries.len() + 1).saturating_sub(MOST);
    entries.drain(..too_many);
    entries.push(entry);
}

#[cfg(test)]
mod tests {
    use ProcedureResult::{Begun, Changed, Failed, Passed, Resumed};

    use super::*;

    const NOW: u64 = 1_800_000_000;

    fn subject(configuration: u64) -> Subject {
        Subject {
            configuration,
            car_id: 7,
        }
    }

    /// Each procedure changes the configuration once: 1 to 2, 2 to 3, 3 to 4.
    fn all_passed() -> Commissioned {
        let mut known = Commissioned::default();
        for (before, procedure) in (1..).zip(Procedure::ALL) {
            known.note(procedure, Begun, subject(before), NOW);
            known.note(procedure, Changed, subject(before + 1), NOW);
            known.note(procedure, Passed, subject(before + 1), NOW);
        }
        known
    }

    fn why(known: &Commissioned, subject: Subject, now_s: u64) -> Option<(Procedure, Lapsed)> {
        known
            .missing(subject, now_s)
            .map(|missing| (missing.procedure, missing.why))
    }

    #[test]
    fn a_car_that_has_passed_all_three_in_order_may_be_armed() {
        let known = all_passed();
        assert_eq!(why(&known, subject(4), NOW), None);
        assert_eq!(known.of_car(7).count(), 3);
    }

    #[test]
    fn the_first_procedure_that_is_missing_is_named() {
        let mut known = Commissioned::default();
        let missing =
            |known: &Commissioned, configuration| why(known, subject(configuration), NOW).unwrap();
        assert_eq!(missing(&known, 1), (Procedure::Doctor, Lapsed::Missing));
        known.note(Procedure::Doctor, Begun, subject(1), NOW);
        assert_eq!(missing(&known, 1), (Procedure::Doctor, Lapsed::Missing));
        known.note(Procedure::Doctor, Passed, subject(2), NOW);
        assert_eq!(missing(&known, 2), (Procedure::BringUp, Lapsed::Missing));
        known.note(Procedure::BringUp, Passed, subject(2), NOW);
        assert_eq!(missing(&known, 2), (Procedure::Calibrate, Lapsed::Missing));
    }

    #[test]
    fn a_change_by_hand_leaves_all_results_behind_and_the_next_procedure_takes_none_along() {
        let mut known = all_passed();
        let lapsed = Some((Procedure::Doctor, Lapsed::OtherConfiguration));
        assert_eq!(why(&known, subject(5), NOW), lapsed);
        known.note(Procedure::Calibrate, Begun, subject(5), NOW);
        known.note(Procedure::Calibrate, Passed, subject(6), NOW);
        assert_eq!(why(&known, subject(6), NOW), lapsed);
    }

    #[test]
    fn an_earlier_procedure_that_changes_something_wants_the_later_ones_again() {
        let mut known = all_passed();
        known.note(Procedure::Doctor, Begun, subject(4), NOW);
        known.note(Procedure::Doctor, Passed, subject(4), NOW);
        assert_eq!(why(&known, subject(4), NOW), None);
        known.note(Procedure::Doctor, Begun, subject(4), NOW);
        known.note(Procedure::Doctor, Changed, subject(5), NOW);
        known.note(Procedure::Doctor, Passed, subject(5), NOW);
        let lapsed = Some((Procedure::BringUp, Lapsed::OtherConfiguration));
        assert_eq!(why(&known, subject(5), NOW), lapsed);
    }

    #[test]
    fn an_interrupted_procedure_takes_the_results_along_from_where_it_first_began() {
        let mut known = Commissioned::default();
        known.note(Procedure::Doctor, Passed, subject(2), NOW);
        known.note(Procedure::BringUp, Begun, subject(2), NOW);
        known.note(Procedure::BringUp, Changed, subject(3), NOW);
        // It was killed.
        known.note(Procedure::BringUp, Resumed, subject(3), NOW);
        known.note(Procedure::BringUp, Changed, subject(4), NOW);
        known.note(Procedure::BringUp, Passed, subject(4), NOW);
        let missing = Some((Procedure::Calibrate, Lapsed::Missing));
        assert_eq!(why(&known, subject(4), NOW), missing);
    }

    #[test]
    fn what_is_changed_by_hand_while_a_procedure_is_interrupted_is_not_taken_along() {
        let begun = || {
            let mut known = Commissioned::default();
            known.note(Procedure::Doctor, Passed, subject(2), NOW);
            known.note(Procedure::BringUp, Begun, subject(2), NOW);
            known.note(Procedure::BringUp, Changed, subject(3), NOW);
            known
        };
        let lapsed = Some((Procedure::Doctor, Lapsed::OtherConfiguration));
        // From 3 to 4 by hand: before it is resumed, and while it runs.
        let mut known = begun();
        known.note(Procedure::BringUp, Resumed, subject(4), NOW);
        known.note(Procedure::BringUp, Changed, subject(5), NOW);
        known.note(Procedure::BringUp, Passed, subject(5), NOW);
        assert_eq!(why(&known, subject(5), NOW), lapsed);
        let mut known = begun();
        known.note(Procedure::BringUp, Passed, subject(4), NOW);
        assert_eq!(why(&known, subject(4), NOW), lapsed);
    }

    #[test]
    fn a_procedure_begins_after_the_earlier_ones_and_goes_on_with_what_it_has_changed() {
        let before = |known: &Commissioned, procedure, result, configuration| {
            known
                .missing_before(procedure, result, subject(configuration), NOW)
                .map(|missing| (missing.procedure, missing.why))
        };
        let (doctor, bring_up) = (Procedure::Doctor, Procedure::BringUp);
        let mut known = Commissioned::default();
        assert_eq!(before(&known, doctor, Begun, 1), None);
        let missing = Some((doctor, Lapsed::Missing));
        for procedure in [bring_up, Procedure::Calibrate] {
            assert_eq!(before(&known, procedure, Begun, 1), missing);
        }
        known.note(doctor, Passed, subject(2), NOW);
        assert_eq!(before(&known, bring_up, Begun, 2), None);
        let missing = Some((bring_up, Lapsed::Missing));
        assert_eq!(before(&known, Procedure::Calibrate, Begun, 2), missing);
        // It changes something, and is interrupted.
        known.note(bring_up, Begun, subject(2), NOW);
        known.note(bring_up, Changed, subject(3), NOW);
        assert_eq!(before(&known, bring_up, Resumed, 3), None);
        let lapsed = Some((doctor, Lapsed::OtherConfiguration));
        assert_eq!(before(&known, bring_up, Begun, 3), lapsed);
        assert_eq!(before(&known, bring_up, Resumed, 4), lapsed, "by hand");
        known.note(bring_up, Passed, subject(3), NOW);
        assert_eq!(before(&known, Procedure::Calibrate, Begun, 3), None);
        // Once more, for what it has passed before.
        known.note(Procedure::Calibrate, Passed, subject(3), NOW);
        assert_eq!(before(&known, bring_up, Begun, 3), None);
    }

    #[test]
    fn a_procedure_that_fails_takes_its_earlier_result_back() {
        let mut known = all_passed();
        known.note(Procedure::Doctor, Failed, subject(4), NOW);
        let missing = Some((Procedure::Doctor, Lapsed::Missing));
        assert_eq!(why(&known, subject(4), NOW), missing);
    }

    #[test]
    fn results_of_another_car_old_ones_and_those_of_the_future_do_not_count() {
        let known = all_passed();
        let other = Subject {
            configuration: 4,
            car_id: 8,
        };
        let doctor = |why| Some((Procedure::Doctor, why));
        assert_eq!(why(&known, other, NOW), doctor(Lapsed::OtherCar(7)));
        let days = |days: u64| NOW + days * DAY_S;
        assert_eq!(why(&known, subject(4), days(90) - 1), None);
        assert_eq!(why(&known, subject(4), days(90)), doctor(Lapsed::Old(90)));
        assert_eq!(why(&known, subject(4), NOW - DAY_S), None);
        assert_eq!(
            why(&known, subject(4), NOW - DAY_S - 1),
            doctor(Lapsed::Future)
        );
    }

    #[test]
    fn a_refusal_names_the_command_and_what_uncalibrated_means() {
        let text = Commissioned::default()
            .missing(subject(1), NOW)
            .unwrap()
            .to_string();
        for part in [
            "has not passed on car 7",
            "Run `singletrack doctor`",
            "--uncalibrated: the car then drives with values that have not been measured",
        ] {
            assert!(text.contains(part), "{text}");
        }
    }
}
