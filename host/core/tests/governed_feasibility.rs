//! The judgement of what a car with a governor can do.

use singletrack_core::feasibility::{Finding, Judgement, Severity};

use crate::feasibility::{circle, found, only, own, square};

/// The finding that says what the governor makes of a reference.
fn governed(judgement: &Judgement) -> &Finding {
    let finding = only(judgement);
    assert_eq!(finding.what.key, "governor.enabled");
    finding
}

#[test]
fn with_a_governor_the_governed_reference_is_judged() {
    let mut config = own();
    config.outer_loop =
        toml::from_str("kind = \"proportional\"\ngain_per_s = [1.0, 1.0]\nfeed_forward = true")
            .unwrap();
    config.fence.corners_m = square(3.0);
    // Too tight, too fast for the tyres, and too fast for the car.
    let usual = config.limits.max_lateral_acceleration_m_s2;
    for (radius, rate, lateral, word, wide) in [
        (0.45, 1.0, usual, "(steering)", true),
        (1.0, 1.25, 1.0, "(tyres)", false),
        (1.5, 1.2, usual, "(speed)", false),
    ] {
        config.limits.max_lateral_acceleration_m_s2 = lateral;
        config.reference = circle(radius, rate);
        config.governor.enabled = false;
        assert!(!found(&config).is_possible(), "{radius} m");
        config.governor.enabled = true;
        let judgement = found(&config);
        let finding = governed(&judgement).to_string();
        assert!(
            judgement.is_possible() && judgement.start.is_some(),
            "{finding}"
        );
        assert!(finding.contains(word), "{finding}");
        assert_eq!(finding.contains("beside the path"), wide, "{finding}");
    }
    // What the car can follow is judged as without it.
    config.reference = circle(1.0, 0.5);
    let governed = found(&config);
    config.governor.enabled = false;
    assert_eq!(governed, found(&config));
    assert_eq!(governed.findings, []);
}

#[test]
fn a_governor_does_not_make_up_for_a_fence_or_for_a_loop_that_lags() {
    let mut config = own();
    config.governor.enabled = true;
    config.reference = circle(0.45, 1.0);
    // Without feed-forward P settles on a circle that can't be steered.
    config.fence.corners_m = square(3.0);
    let judgement = found(&config);
    assert!(!judgement.is_possible());
    let keys: Vec<_> = judgement
        .findings
        .iter()
        .map(|finding| finding.what.key)
        .collect();
    assert_eq!(keys, ["governor.enabled", "reference.radius_m"]);
    config.outer_loop =
        toml::from_str("kind = \"proportional\"\ngain_per_s = [1.0, 1.0]\nfeed_forward = true")
            .unwrap();
    config.fence.corners_m = square(0.7);
    let judgement = found(&config);
    assert!(!judgement.is_possible());
    let last = judgement.findings.last().unwrap();
    assert_eq!(last.what.key, "fence.corners_m");
    assert_eq!(last.severity, Severity::Impossible);
}

#[test]
fn a_governed_path_may_lead_to_the_geofence_but_not_out_of_it() {
    let mut config = own();
    config.governor.enabled = true;
    config.outer_loop =
        toml::from_str("kind = \"proportional\"\ngain_per_s = [1.0, 1.0]\nfeed_forward = true")
            .unwrap();
    config.reference = toml::from_str(
        "kind = \"path\"
        points = [[0.0, 0.0], [1.2, 0.0], [2.4, 0.0], [3.2, 0.7], [2.4, 1.6], [1.2, 1.8]]
        speed_m_s = 1.0",
    )
    .unwrap();
    let mut judged = |to_x: f64| {
        config.fence.corners_m = vec![[-2.0, -2.0], [to_x, -2.0], [to_x, 4.0], [-2.0, 4.0]];
        found(&config)
    };
    // The car is half a metre behind P.
    let near = judged(3.32);
    assert!(near.is_possible(), "{near:?}");
    let out = judged(2.9);
    assert!(!out.is_possible());
    let [finding] = out.findings.as_slice() else {
        panic!("{out:?}");
    };
    assert_eq!(finding.what.key, "fence.corners_m");
    assert!(finding.to_string().contains("it waits there for ever"));
}

#[test]
fn a_governor_needs_a_convex_geofence_with_room_inside() {
    let mut config = own();
    config.governor.enabled = true;
    config.fence.margin_m = Some(0.98);
    let refused = config.pilot().unwrap_err().to_string();
    assert!(
        refused.contains("the governor keeps 5 cm more"),
        "{refused}"
    );
    config.fence.margin_m = None;
    config.fence.corners_m = vec![[0.0, 0.0], [4.0, 0.0], [1.0, 1.0], [0.0, 4.0]];
    let refused = config.pilot().unwrap_err().to_string();
    assert!(refused.contains("governor.enabled = false"), "{refused}");
    config.governor.enabled = false;
    assert!(config.pilot().is_ok());
}
