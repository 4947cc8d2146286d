//! The claims, each with the criterion by which a number agrees with it: the one place
//! where numbers and tolerances stand.

mod analyses;
mod experiments;

use super::{
    Setup,
    claims::{Claim, Criterion, Quantity, Scope},
};

/// All claims, in the order of the report.
pub(super) fn claims(setup: &Setup) -> Vec<Claim> {
    let mut claims = experiments::steps(setup);
    claims.extend(experiments::circle(setup));
    claims.extend(analyses::claims(setup));
    claims.sort_by_key(|claim| claim.section);
    claims
}

/// A claim that begins without quantities.
fn claim(
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
    fn unit(mut self, unit: &'static str) -> Self {
        self.unit = unit;
        self
    }

    fn because(mut self, why: impl Into<String>) -> Self {
        self.why = why.into();
        self
    }

    /// A number that should agree.
    fn agrees(mut self, label: &'static str, name: &str, agrees: Criterion) -> Self {
        self.quantities.push(Quantity {
            label,
            name: name.to_owned(),
            agrees,
            instead: None,
            of_paper_car: false,
        });
        self
    }

    /// A number that should not, and what it is instead.
    fn differs(
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

    /// The last number is of the simulated car, with tolerances for the paper's.
    fn on_the_car(mut self) -> Self {
        if let Some(last) = self.quantities.last_mut() {
            last.of_paper_car = true;
        }
        self
    }
}

const fn near(value: f64, tolerance: f64) -> Criterion {
    Criterion::Near { value, tolerance }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use singletrack_control::VehicleParameters;

    use super::*;

    fn setup() -> Setup {
        Setup {
            vehicle: VehicleParameters::paper(),
            name: "the paper's car".to_owned(),
            quick: false,
        }
    }

    #[test]
    fn every_claim_has_a_name_of_its_own_a_number_and_a_reason() {
        let claims = claims(&setup());
        let ids: BTreeSet<_> = claims.iter().map(|claim| claim.id).collect();
        assert_eq!(ids.len(), claims.len());
        for claim in &claims {
            assert!(!claim.quantities.is_empty(), "{}", claim.id);
            for text in [&claim.claim, &claim.paper, &claim.why] {
                assert!(!text.is_empty(), "{}", claim.id);
                assert!(!text.contains("</"), "{}: {text}", claim.id);
            }
        }
    }

    #[test]
    fn the_documentation_has_every_claim() {
        let page = include_str!("../../../docs/reproduction.md");
        for claim in claims(&setup()) {
            let row = format!("| {} | {} |", claim.section, claim.claim);
            assert!(page.contains(&row), "docs/reproduction.md lacks {row}");
        }
    }

    #[test]
    fn a_slip_cannot_be_what_the_paper_says_as_well() {
        for claim in claims(&setup()) {
            for quantity in &claim.quantities {
                if let Some(Criterion::Near { value, tolerance }) = quantity.instead {
                    for edge in [value - tolerance, value, value + tolerance] {
                        assert!(!quantity.agrees.holds(edge), "{}: {edge}", claim.id);
                    }
                }
            }
        }
    }
}
