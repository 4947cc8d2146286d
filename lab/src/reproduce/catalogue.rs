//! The claims, each with its criterion: `catalogue.toml` is the only place with numbers and
//! tolerances.

use serde::Deserialize;
use singletrack_control::VehicleParameters;
use singletrack_figures::template::fill;

use super::{
    claims::Claim,
    comparison::{DEVIATION_M, WRONG},
    setup::{GAIN, Setup, TURN_RATE},
    text::{metres, mm, number, with_digits},
};

#[derive(Deserialize)]
struct Catalogue {
    claim: Vec<Claim>,
}

/// All claims, in the order of the report.
pub(super) fn claims(setup: &Setup) -> Result<Vec<Claim>, toml::de::Error> {
    let text = fill(include_str!("catalogue.toml"), &numbers(setup));
    Ok(toml::from_str::<Catalogue>(&text)?.claim)
}

/// What depends on the car, by its name in the catalogue: with every digit in the criteria, and
/// as the reader sees it in the texts.
fn numbers(setup: &Setup) -> [(&'static str, String); 20] {
    let VehicleParameters {
        front_axle_distance_m: l_f,
        rear_axle_distance_m: l_r,
        front_cornering_stiffness_n_rad: c_f,
        rear_cornering_stiffness_n_rad: c_r,
        ..
    } = setup.vehicle;
    let (radius, wheelbase) = (setup.radius_m(), setup.vehicle.wheelbase_m());
    let rear = setup.rear_deviation_m();
    let dl = DEVIATION_M * setup.scale();
    // Of two integrators under proportional control.
    let gain = 1.0 / (1.0 + (TURN_RATE / GAIN).powi(2)).sqrt();
    let lag = (TURN_RATE / GAIN).atan();
    let distance = radius / (1.0 + (GAIN / TURN_RATE).powi(2)).sqrt();
    // The appendix's law uses the distances only in C_r l_r − C_f l_f.
    let stiffness_ratio = (c_f + c_r) / c_f;
    [
        ("minus_l_f", (-l_f).to_string()),
        ("minus_l_f_m", number(-l_f)),
        ("l_r_m", number(l_r)),
        ("wheelbase", wheelbase.to_string()),
        ("wheelbase_m", metres(wheelbase)),
        ("rear", rear.to_string()),
        ("rear_m", metres(rear)),
        ("twice_rear_m", metres(2.0 * rear)),
        ("dl", dl.to_string()),
        ("dl_mm", mm(dl)),
        ("percent", number(WRONG * 100.0)),
        ("radius", radius.to_string()),
        ("radius_m", metres(radius)),
        ("gain_rounded", with_digits(gain, 6)),
        ("amplitude", (gain * radius).to_string()),
        ("lag", lag.to_string()),
        ("lag_rounded", with_digits(lag, 6)),
        ("distance", distance.to_string()),
        ("stiffness_ratio", stiffness_ratio.to_string()),
        ("stiffness_ratio_rounded", with_digits(stiffness_ratio, 4)),
    ]
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
        let claims = claims(&setup()).unwrap();
        let ids: BTreeSet<_> = claims.iter().map(|claim| &claim.id).collect();
        assert_eq!(ids.len(), claims.len());
        for claim in &claims {
            assert!(!claim.quantities.is_empty(), "{}", claim.id);
            for text in [&claim.claim, &claim.paper, &claim.why] {
                assert!(!text.is_empty(), "{}", claim.id);
                assert!(!text.contains(['{', '\n']), "{}: {text}", claim.id);
                assert!(!text.contains("</"), "{}: {text}", claim.id);
            }
        }
    }

    #[test]
    fn the_documentation_has_every_claim() {
        let page = include_str!("../../../docs/reproduction.md");
        for claim in claims(&setup()).unwrap() {
            let row = format!("| {} | {} |", claim.section, claim.claim);
            assert!(page.contains(&row), "docs/reproduction.md lacks {row}");
        }
    }

    #[test]
    fn a_slip_cannot_be_what_the_paper_says_as_well() {
        for claim in claims(&setup()).unwrap() {
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
