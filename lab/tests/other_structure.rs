//! Identification of a car whose structure is not that of the fitted model.

#![allow(clippy::unwrap_used, reason = "a test may fail")]

use singletrack_control::{SlipAngles, Tyres};
use singletrack_lab::identify::study::{StudyPlan, run_study};

/// Left out of `cargo verify`, not of `--all`: they take seconds of processor time each.
mod thorough {
    use super::*;

    /// Pacejka's tyres and exact slip angles, fitted with a hyperbolic tangent and small angles: the
    /// estimates are a few per cent off, far more than their intervals say, and the fit warns.
    #[test]
    fn the_estimates_of_a_car_of_another_structure_stay_near_its_parameters() {
        let plan = StudyPlan {
            first_seed: 1,
            count: 1,
            tyre_curve: Tyres::MagicFormula,
            slip_angles: SlipAngles::Exact,
            ..StudyPlan::default()
        };
        let study = run_study(&plan, |_| {}).unwrap();
        for (summary, within) in study.summaries().iter().zip([0.06, 0.03, 0.06]) {
            let name = summary.parameter.name();
            let error = summary.worst_relative_error;
            println!("{name}: {:.2} % off", 100.0 * error);
            assert!(error < within, "{name}: {summary:?}");
            // It is another car: with the structure of the model they are within 0.5 %.
            assert!(error > 0.005, "{name}: {summary:?}");
        }
        let warnings = study.seeds.iter().flat_map(|seed| &seed.warnings);
        let unexplained = "forces that the model does not explain";
        assert_eq!(
            warnings.filter(|text| text.contains(unexplained)).count(),
            1
        );
        // The simulation of another drive is as good as ever: it does not show the error. Nearly all of
        // it is the vibration of the IMU.
        assert!(
            study.nmpe().iter().all(|nmpe| *nmpe < 0.35),
            "{:?}",
            study.nmpe()
        );
    }
}
