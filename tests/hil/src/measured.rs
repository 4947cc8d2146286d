//! Measurements of the tests, for the table at the end.

use std::sync::{Arc, Mutex, PoisonError};

use crate::{Failure, Outcome};

/// Measurements with their limits, shared by all tests.
#[derive(Clone, Debug, Default)]
pub struct Measurements(Arc<Mutex<Vec<Line>>>);

#[derive(Debug)]
struct Line {
    test: String,
    what: String,
    value: f64,
    limit: f64,
    unit: &'static str,
}

impl Measurements {
    /// Records a value, and fails if it exceeds its limit or is NaN.
    ///
    /// # Errors
    ///
    /// Fails if the value exceeds its limit.
    pub fn at_most(
        &self,
        test: &str,
        what: &str,
        value: f64,
        limit: f64,
        unit: &'static str,
    ) -> Outcome {
        self.0
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .push(Line {
                test: test.to_owned(),
                what: what.to_owned(),
                value,
                limit,
                unit,
            });
        if value <= limit {
            Ok(())
        } else {
            Err(Failure::new(format!(
                "{what}: {value:.1} {unit}, more than {limit} {unit}"
            )))
        }
    }

    /// Removes the measurements of a test that is repeated.
    pub fn forget(&self, test: &str) {
        self.0
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .retain(|line| line.test != test);
    }

    /// The table; empty if nothing was measured.
    #[must_use]
    pub fn table(&self) -> String {
        let lines = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let mut lines: Vec<&Line> = lines.iter().collect();
        // Tests run in parallel, so their lines are mixed.
        lines.sort_by_key(|line| &line.test);
        let mut table = String::new();
        let mut test = "";
        for line in lines {
            if line.test != test {
                test = &line.test;
                table.push_str(&format!("{test}\n"));
            }
            table.push_str(&format!(
                "  {:<62} {:>9.1} of {:>7.1} {}\n",
                line.what, line.value, line.limit, line.unit
            ));
        }
        table
    }
}

/// The smallest value that is not exceeded by `part` (0 to 1) of the sorted values;
/// NaN without values.
#[must_use]
pub fn percentile(sorted: &[f64], part: f64) -> f64 {
    let rank = (part * sorted.len() as f64).ceil() as usize;
    sorted
        .get(rank.saturating_sub(1))
        .copied()
        .unwrap_or(f64::NAN)
}
