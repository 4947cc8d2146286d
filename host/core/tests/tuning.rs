//! `[tuning]`: which bounds a configuration may have, and which requests they allow.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "the helpers of tests may fail as tests do"
)]

use singletrack_control::Velocity;
use singletrack_core::{
    Config,
    config::{LqiWeights, OuterLoopSection, TuningSection},
    configuration_hash,
    feasibility::{Severity, judge_reference},
};
use singletrack_pilot::{Tuned, Tuning};

const EXAMPLE: &str = include_str!("../../daemon/singletrackd.example.toml");

/// `[tuning]`, enabled, with these keys.
fn section(keys: &str) -> TuningSection {
    let keys: toml::Table = format!("enabled = true\n{keys}").parse().unwrap();
    keys.try_into().unwrap()
}

/// The example with this section.
fn config(keys: &str) -> Config {
    let mut config = Config::from_toml(EXAMPLE).unwrap();
    config.tuning = section(keys);
    config.validate().unwrap();
    config
}

const BOTH: &str = "gain_per_s = [0.5, 4.0]\npoint_distance_m = [0.3, 0.4]\n";

fn refusal(keys: &str, change: impl FnOnce(&mut Config)) -> String {
    let mut config = Config::from_toml(EXAMPLE).unwrap();
    change(&mut config);
    config.tuning = section(keys);
    config.validate().unwrap_err().to_string()
}

fn lqi() -> OuterLoopSection {
    OuterLoopSection::Lqi(LqiWeights::default())
}

fn gain(x: f64, y: f64) -> Tuning {
    Tuning {
        gain: Some(Velocity::new(x, y)),
        point_distance: None,
    }
}

const fn distance(distance: f64) -> Tuning {
    Tuning {
        gain: None,
        point_distance: Some(distance),
    }
}

#[test]
fn it_is_off_unless_it_is_enabled_and_what_is_proved_does_not_depend_on_it() {
    let plain = Config::from_toml(EXAMPLE).unwrap();
    assert_eq!(plain.tuning, TuningSection::default());
    assert_eq!(plain.pilot().unwrap().tuning, None);
    let error = plain.tuning_rule().check(&gain(2.0, 2.0), None);
    let error = error.unwrap_err().to_string();
    assert!(error.starts_with("nothing can be tuned: "), "{error}");
    let tunable = config(BOTH);
    let bounds = tunable.pilot().unwrap().tuning.unwrap();
    assert_eq!(bounds.gain, Some([0.5, 4.0]));
    assert_eq!(bounds.point_distance, Some([0.3, 0.4]));
    assert_eq!(
        configuration_hash(&plain).unwrap(),
        configuration_hash(&tunable).unwrap()
    );
}

#[test]
fn bounds_that_the_car_could_not_be_configured_with_are_refused_with_key_value_and_fix() {
    type Change = fn(&mut Config);
    let same: Change = |_| {};
    let cases: [(&str, Change, &[&str]); 9] = [
        (
            "",
            same,
            &["tuning.enabled is true", "give tuning.gain_per_s"],
        ),
        (
            "gain_per_s = [2.0, 4.0]",
            same,
            &[
                "tuning.gain_per_s is [2.0, 4.0]",
                "outer_loop.gain_per_s has 1",
            ],
        ),
        (
            "gain_per_s = [4.0, 0.5]",
            same,
            &["tuning.gain_per_s is [4.0, 0.5]", "lower bound first"],
        ),
        (
            "gain_per_s = [0.5, 101.0]",
            same,
            &["tuning.gain_per_s is 101", "between 0 and 100"],
        ),
        (
            "point_distance_m = [0.4, 0.5]",
            same,
            &[
                "tuning.point_distance_m is [0.4, 0.5]",
                "law.point_distance_m is 0.35",
            ],
        ),
        (
            "point_distance_m = [0.0, 0.5]",
            same,
            &["tuning.point_distance_m is 0", "above 0"],
        ),
        (
            "point_distance_m = [0.3, 0.4]",
            |config| config.governor.enabled = true,
            &[
                "tuning.point_distance_m",
                "governor.enabled is true",
                "leave it out",
            ],
        ),
        (
            "gain_per_s = [0.5, 4.0]",
            |config| config.outer_loop = lqi(),
            &["tuning.gain_per_s", "\"lqi\"", "Riccati", "leave it out"],
        ),
        (
            "gain_per_s = [0.5, nan]",
            same,
            &["tuning.gain_per_s is NaN"],
        ),
    ];
    for (keys, change, parts) in cases {
        let refused = refusal(keys, change);
        for part in parts {
            assert!(refused.contains(part), "{keys}: {refused}");
        }
    }
}

#[test]
fn p_can_be_tuned_with_a_loop_whose_gains_can_not() {
    let mut config = config("point_distance_m = [0.3, 0.4]\n");
    config.outer_loop = lqi();
    config.validate().unwrap();
    let rule = config.tuning_rule();
    assert_eq!(rule.check(&distance(0.4), None), Ok(()));
    let refused = rule.check(&gain(2.0, 2.0), None).unwrap_err().to_string();
    assert!(refused.contains("Riccati"), "{refused}");
}

#[test]
fn a_request_outside_the_bounds_is_refused_with_them() {
    let config = config(BOTH);
    let rule = config.tuning_rule();
    for allowed in [gain(0.5, 4.0), distance(0.3), distance(0.4)] {
        assert_eq!(rule.check(&allowed, None), Ok(()));
    }
    for (refused, parts) in [
        (gain(4.5, 1.0), ["gain_per_s is 4.5", "between 0.5 and 4"]),
        (gain(1.0, 0.4), ["gain_per_s is 0.4", "between 0.5 and 4"]),
        (
            gain(f64::NAN, 1.0),
            ["gain_per_s is NaN", "between 0.5 and 4"],
        ),
        (
            distance(0.41),
            ["point_distance_m is 0.41", "between 0.3 and 0.4"],
        ),
        (
            Tuning {
                gain: gain(1.0, 1.0).gain,
                point_distance: Some(f64::INFINITY),
            },
            ["point_distance_m is inf", "between 0.3 and 0.4"],
        ),
    ] {
        let error = rule.check(&refused, None).unwrap_err().to_string();
        for part in parts {
            assert!(error.contains(part), "{error}");
        }
    }
    let error = rule.check(&Tuning::default(), None);
    let error = error.unwrap_err().to_string();
    assert!(error.starts_with("there is nothing to tune: "), "{error}");
    let tuned = Tuned {
        gain: gain(2.0, 2.0).gain,
        point_distance: 0.36,
        wanted_point_distance: 0.4,
    };
    let again = Tuning {
        gain: tuned.gain,
        point_distance: Some(0.4),
    };
    let error = rule.check(&again, Some(&tuned)).unwrap_err().to_string();
    assert!(error.starts_with("nothing changes: "), "{error}");
    assert_eq!(
        rule.check(&distance(0.36), Some(&tuned)),
        Ok(()),
        "it turns back"
    );
    assert!(rule.differs(&tuned));
}

#[test]
fn the_ends_of_the_bounds_are_judged_as_the_configured_values_are() {
    // The example's circle of 0.85 m: P comes down to 0.76 m with the gain of 1/s, and with less
    // gain to a circle that the wheels can't be steered for.
    let narrow = config("gain_per_s = [0.9, 4.0]\n");
    assert!(judge_reference(&narrow, None, None).unwrap().is_possible());
    let wide = config("gain_per_s = [0.4, 4.0]\n");
    let judgement = judge_reference(&wide, None, None).unwrap();
    let finding = judgement
        .findings
        .iter()
        .find(|finding| finding.severity == Severity::Impossible)
        .unwrap();
    let text = finding.to_string();
    for part in [
        "tuning.gain_per_s is [0.4, 4.0]",
        "gains of 0.4/s",
        "reference.radius_m",
        "narrow the bounds",
    ] {
        assert!(text.contains(part), "{text}");
    }
}

#[test]
fn a_long_p_is_judged_by_the_circle_and_the_geofence() {
    let config = config("point_distance_m = [0.3, 0.7]\n");
    let judgement = judge_reference(&config, None, None).unwrap();
    assert!(!judgement.is_possible());
    let text = judgement.findings.last().unwrap().to_string();
    assert!(text.contains("p at 0.7 m"), "{text}");
}
