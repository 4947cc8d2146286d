//! The claims, each with its criterion: the only place with numbers and tolerances.

mod analyses;
mod assumptions;
mod claim;
mod experiments;

use super::{claims::Claim, setup::Setup};

/// All claims, in the order of the report.
pub(super) fn claims(setup: &Setup) -> Vec<Claim> {
    let mut claims = experiments::steps(setup);
    claims.extend(experiments::circle(setup));
    claims.extend(analyses::claims(setup));
    claims.extend(assumptions::claims(setup));
    claims.sort_by_key(|claim| claim.section);
    claims
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use singletrack_control::VehicleParameters;

    use super::*;
    use crate::reproduce::claims::Criterion;

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
        let page = include_str!("../../../../docs/reproduction.md");
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
