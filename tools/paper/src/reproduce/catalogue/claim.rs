//! Constructors of claims.

use crate::reproduce::claims::{Claim, Criterion, Quantity, Scope};

/// A claim that begins without quantities.
pub(super) fn claim(
    id: &'static str,
    section: usize,
    scope: Scope,
    claim: impl Into<String>,
    paper: impl Into<String>,
) -> Claim {
    Claim {
        id,
        section,
        claim: claim.into(),
        paper: paper.into(),
        quantities: Vec::new(),
        unit: "",
        scope,
        why: String::new(),
    }
}

impl Claim {
    pub(super) fn unit(mut self, unit: &'static str) -> Self {
        self.unit = unit;
        self
    }

    pub(super) fn because(mut self, why: impl Into<String>) -> Self {
        self.why = why.into();
        self
    }

    /// A number that should agree.
    pub(super) fn agrees(mut self, label: &'static str, name: &str, agrees: Criterion) -> Self {
        self.quantities.push(Quantity {
            label,
            name: name.to_owned(),
            agrees,
            instead: None,
            of_paper_car: false,
        });
        self
    }

    /// A number that should not agree, and its correct value.
    pub(super) fn differs(
        mut self,
        label: &'static str,
        name: &str,
        agrees: Criterion,
        instead: Criterion,
    ) -> Self {
        self.quantities.push(Quantity {
            label,
            name: name.to_owned(),
            agrees,
            instead: Some(instead),
            of_paper_car: false,
        });
        self
    }

    /// Marks the last number as one of the simulated car, with tolerances for the paper's.
    pub(super) fn on_the_car(mut self) -> Self {
        if let Some(last) = self.quantities.last_mut() {
            last.of_paper_car = true;
        }
        self
    }
}

pub(super) const fn near(value: f64, tolerance: f64) -> Criterion {
    Criterion::Near { value, tolerance }
}
