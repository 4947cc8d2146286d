//! What is compared: the rows, the drives of each, and the tuning of the controllers.

use std::fmt::Display;

use serde::{Deserialize, Serialize};
use singletrack_campaign::{Experiment, run_shown};
use singletrack_control::Reference;

use super::{
    controller::{Controller, ControllerName, Drives},
    counted::{DriveResult, OwnPoint},
    course::{Course, PathName},
    drive::{Case, Condition, Decide},
};
use crate::Result;

/// A comparison: every controller on every path at every speed under every condition, with
/// the same seeds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Comparison {
    /// The controllers.
    pub controllers: Vec<Controller>,
    /// The paths.
    pub paths: Vec<PathName>,
    /// The speeds, in m/s.
    pub speeds_m_s: Vec<f64>,
    /// The conditions.
    pub conditions: Vec<Condition>,
    /// The first seed; the others follow consecutively.
    pub first_seed: u64,
    /// The number of seeds of a row.
    pub seeds: u64,
    /// The number of seeds with which the added delay is searched, if it is less.
    pub delay_seeds: u64,
}

/// A row of the table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    /// The controller.
    pub controller: Controller,
    /// The path.
    pub path: PathName,
    /// The speed, in m/s.
    pub speed_m_s: f64,
    /// The condition.
    pub condition: Condition,
}

impl Comparison {
    /// The rows, in the order of the table: the controllers of a case follow each other.
    pub fn rows(&self) -> impl Iterator<Item = Row> + '_ {
        let paths = self.paths.iter();
        paths.flat_map(move |&path| {
            self.speeds_m_s.iter().flat_map(move |&speed_m_s| {
                self.conditions.iter().flat_map(move |&condition| {
                    let controllers = self.controllers.iter().copied();
                    controllers
                        .filter(move |controller| is_driven(*controller, path, condition))
                        .map(move |controller| Row {
                            controller,
                            path,
                            speed_m_s,
                            condition,
                        })
                })
            })
        })
    }

    /// The number of seeds of a row under a condition. They make no difference to the ideal
    /// plant.
    pub(super) fn seeds_under(&self, condition: Condition) -> u64 {
        match condition {
            Condition::IdealPlant => self.seeds.min(1),
            Condition::AddedDelay => self.seeds.min(self.delay_seeds),
            _ => self.seeds,
        }
    }

    /// Whether a unit is a drive of the program's own controller.
    pub fn is_yours(&self, unit: u64) -> bool {
        self.case(unit)
            .is_ok_and(|case| matches!(case.drives, Drives::Yours(_)))
    }

    /// The reference of a unit, and the time (s) until which its drive is counted.
    ///
    /// # Errors
    ///
    /// There is no such unit.
    pub fn path(&self, unit: u64) -> Result<(Reference, f64)> {
        let case = self.case(unit)?;
        let course = Course::new(case.path, case.speed_m_s);
        let reference = course.reference.reference();
        let reference = reference.map_err(of(unit))?;
        Ok((reference, course.counted[1]))
    }

    /// Drives a unit by the set-points of a program, which follows the path with `own`. The car, its
    /// seeds and what is counted are those of every other controller.
    ///
    /// # Errors
    ///
    /// There is no such unit, or it can't be simulated.
    pub fn drive_yours(
        &self,
        unit: u64,
        own: OwnPoint,
        decide: &mut Decide<'_>,
    ) -> Result<DriveResult> {
        let case = Case {
            drives: Drives::Yours(own),
            ..self.case(unit)?
        };
        let result = case.drive_by(decide);
        Ok(result.map_err(of(unit))?)
    }

    /// The row and the seed of a unit.
    fn case(&self, unit: u64) -> Result<Case> {
        let mut index = unit;
        let mut rows = self.rows();
        let row = rows.find(|row| {
            let seeds = self.seeds_under(row.condition);
            let own = index < seeds;
            if !own {
                index -= seeds;
            }
            own
        });
        let row = row.ok_or_else(|| format!("there is no drive {unit} in this comparison"))?;
        Ok(Case {
            drives: row.controller.drives(),
            path: row.path,
            speed_m_s: row.speed_m_s,
            condition: row.condition,
            seed: self.first_seed.wrapping_add(index),
        })
    }
}

/// Whether a row has a meaning. A program's own controller drives the car, once with each seed. On a
/// circle that no car can drive there is nothing to diverge from.
fn is_driven(controller: Controller, path: PathName, condition: Condition) -> bool {
    let is_yours = controller == ControllerName::Yours.into();
    match condition {
        Condition::IdealPlant => !is_yours,
        Condition::AddedDelay => !is_yours && path != PathName::InfeasibleCircle,
        _ => true,
    }
}

/// Says which drive failed.
fn of<E: Display>(unit: u64) -> impl Fn(E) -> String {
    move |error| format!("drive {unit}: {error}")
}

impl Experiment for Comparison {
    const NAME: &'static str = "compare";
    type Result = DriveResult;

    fn units(&self) -> u64 {
        let seeds = self.rows().map(|row| self.seeds_under(row.condition));
        seeds.sum()
    }

    fn run(&self, unit: u64) -> Result<DriveResult> {
        let result = self.case(unit)?.drive();
        Ok(result.map_err(of(unit))?)
    }
}

/// The parameters that each controller may try.
pub const BUDGET: usize = 25;

/// The seed of the tuning, which no row has unless it is asked for.
const SEED: u64 = 0;

/// What is driven with each parameter: path, and speed in m/s.
const DRIVES: [(PathName, f64); 4] = [
    (PathName::Circle, 1.0),
    (PathName::Eight, 1.0),
    (PathName::Eight, 1.5),
    (PathName::LaneChange, 1.5),
];

/// What a drive that stops costs, in m.
const STOPPED_M: f64 = 1.0;

/// Tunes the controllers, and returns a table.
///
/// # Errors
///
/// A drive can't be simulated.
pub(super) fn tune(controllers: &[Controller], threads: usize) -> Result<String> {
    let controllers = controllers
        .iter()
        .filter_map(|controller| match controller {
            Controller::Known(controller) => Some(*controller),
            Controller::Own(_) => None,
        });
    let mut tried = Vec::new();
    for controller in controllers.clone() {
        let [first, second] = controller.tried().unwrap_or_default();
        for &a in first {
            tried.extend(second.iter().map(|&b| (controller, [a, b])));
        }
    }
    let units: Vec<u64> = (0..tried.len() as u64).collect();
    let work = |unit: u64| cost(tried[unit as usize]);
    let costs = run_shown("tune", &units, threads, work)?;
    let mut text = "| controller | parameters | mean RMS (mm) |\n|---|---|---|\n".to_owned();
    for controller in controllers {
        let of_it = tried.iter().zip(&costs);
        let of_it = of_it.filter(|((tried, _), _)| *tried == controller);
        let best = of_it.min_by(|(_, (_, a)), (_, (_, b))| a.total_cmp(b));
        if let Some(((_, parameters), (_, cost))) = best {
            let cost_mm = 1e3 * cost;
            text += &format!("| {controller} | {parameters:?} | {cost_mm:.2} |\n");
        }
    }
    Ok(text)
}

/// The mean of the root mean squares over the drives, in m.
fn cost((controller, parameters): (ControllerName, [f64; 2])) -> Result<f64> {
    let mut sum = 0.0;
    for (path, speed_m_s) in DRIVES {
        let case = Case {
            drives: controller.with(parameters),
            path,
            speed_m_s,
            condition: Condition::Nominal,
            seed: SEED,
        };
        let result = case.drive()?;
        let errors = result.own.filter(|_| result.stopped.is_none());
        sum += errors.map_or(STOPPED_M, |errors| errors.rms);
    }
    Ok(sum / DRIVES.len() as f64)
}

#[cfg(test)]
mod tests {
    use clap::ValueEnum as _;

    use super::*;

    #[test]
    fn every_tuned_controller_has_the_same_budget_and_drives_with_what_was_tried() {
        for &controller in ControllerName::value_variants() {
            if let Some([first, second]) = controller.tried() {
                assert_eq!(first.len() * second.len(), BUDGET, "{}", controller.name());
                let [a, b] = controller.parameters();
                assert!(first.contains(&a) && second.contains(&b), "{controller:?}");
            }
        }
    }
}
