//! Tunes the controllers: each has the same number of parameters to try, on the same drives.

use std::fmt::Write as _;

use singletrack_campaign::{Progress, run_units};

use super::{controller::ControllerName, course::PathName, drive::Case, stops::DriveError};

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

/// What a controller came to.
#[derive(Clone, Copy, Debug)]
struct Tried {
    controller: ControllerName,
    parameters: [f64; 2],
}

/// Tunes the controllers, and returns a table.
///
/// # Errors
///
/// A drive can't be simulated.
pub(super) fn tune(controllers: &[ControllerName], threads: usize) -> Result<String, DriveError> {
    let mut tried = Vec::new();
    for &controller in controllers {
        let Some([first, second]) = controller.tried() else {
            continue;
        };
        for &a in first {
            tried.extend(second.iter().map(|&b| Tried {
                controller,
                parameters: [a, b],
            }));
        }
    }
    let units: Vec<u64> = (0..tried.len() as u64).collect();
    let progress = Progress::new("tune", units.len() as u64);
    let costs = run_units(
        &units,
        threads,
        |unit| cost(&tried[unit as usize]),
        || progress.advance(),
    );
    progress.finish();
    let costs = costs?;
    let mut text = "| controller | parameters | mean RMS (mm) |\n|---|---|---|\n".to_owned();
    for &controller in controllers {
        let of_it = tried.iter().zip(&costs);
        let of_it = of_it.filter(|(tried, _)| tried.controller == controller);
        let best = of_it.min_by(|(_, (_, a)), (_, (_, b))| a.total_cmp(b));
        if let Some((tried, (_, cost))) = best {
            // Writing to a string does not fail.
            let _ = writeln!(
                text,
                "| {controller} | {:?} | {:.2} |",
                tried.parameters,
                1e3 * cost
            );
        }
    }
    Ok(text)
}

/// The mean of the root mean squares over the drives, in m.
fn cost(tried: &Tried) -> Result<f64, DriveError> {
    let mut sum = 0.0;
    for (path, speed_m_s) in DRIVES {
        let case = Case {
            drives: tried.controller.with(tried.parameters),
            path,
            speed_m_s,
            condition: tried.controller.tuned_under(),
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
