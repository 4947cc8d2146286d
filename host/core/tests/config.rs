//! The configuration: what is accepted. What is not: `config_mistakes.rs`.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "the helpers of tests may fail as tests do"
)]

use singletrack_control::{EstimatorConfig, Limits, Reference, TrackingLoop, VehicleParameters};
use singletrack_core::{
    ConfigError,
    config::{BoardSection, Config, OuterLoopSection, Start},
};
use singletrack_pilot::SupervisorConfig;

const EXAMPLE: &str = include_str!("../../daemon/singletrackd.example.toml");

fn example() -> Config {
    Config::from_toml(EXAMPLE).unwrap()
}

/// The example with its commented-out defaults switched on.
fn spelt_out() -> String {
    EXAMPLE
        .lines()
        .map(|line| match line.strip_prefix('#') {
            Some(rest) if rest.starts_with(|c: char| c.is_ascii_lowercase() || c == '[') => rest,
            _ => line,
        })
        .map(|line| format!("{line}\n"))
        .collect()
}

#[test]
fn the_example_is_accepted_and_its_comments_tell_the_true_defaults() {
    let spelt_out = spelt_out();
    assert_ne!(spelt_out, EXAMPLE);
    assert_eq!(Config::from_toml(&spelt_out).unwrap(), example());
}

#[test]
fn the_example_documents_every_key() {
    let mut missing = Vec::new();
    let written: toml::Table = example().to_toml().unwrap().parse().unwrap();
    let documented: toml::Table = spelt_out().parse().unwrap();
    compare("", &written, &documented, &mut missing);
    assert_eq!(missing, Vec::<String>::new());

    fn compare(path: &str, all: &toml::Table, seen: &toml::Table, missing: &mut Vec<String>) {
        for (key, value) in all {
            let path = format!("{path}{key}");
            match (value, seen.get(key)) {
                (_, None) => missing.push(path),
                (toml::Value::Table(all), Some(toml::Value::Table(seen))) => {
                    compare(&format!("{path}."), all, seen, missing);
                }
                _ => {}
            }
        }
    }
}

#[test]
fn a_configuration_survives_being_written() {
    let config = example();
    assert_eq!(
        Config::from_toml(&config.to_toml().unwrap()).unwrap(),
        config
    );
}

#[test]
fn the_defaults_are_the_papers() {
    let config = example();
    let pilot = config.pilot().unwrap();
    assert_eq!(config.vehicle, VehicleParameters::paper());
    assert_eq!(pilot.limits, Limits::paper().with_tyres(&config.vehicle));
    assert_eq!(pilot.supervisor, SupervisorConfig::paper());
    assert_eq!(
        pilot.estimator,
        EstimatorConfig::for_vehicle(&VehicleParameters::paper())
    );
    assert!(matches!(pilot.reference, Reference::Circle(_)));
    assert!(matches!(pilot.tracking, TrackingLoop::Proportional(_)));
    assert_eq!(pilot.period, 0.01);
    assert_eq!(config.link(1).baud.get(), 115_200);
}

#[test]
fn the_examples_calibration_is_the_simulated_cars() {
    let simulated = singletrack_sim::default_board_configuration();
    assert_eq!(example().board, BoardSection::from(&simulated));
    assert_eq!(BoardSection::from(&simulated).configuration(), simulated);
}

#[test]
fn a_loop_that_is_opened_for_a_while_may_keep_its_gains() {
    let text = EXAMPLE.replacen("\nkind = \"proportional\"\n", "\nkind = \"open-loop\"\n", 1);
    assert_ne!(text, EXAMPLE);
    let config = Config::from_toml(&text).unwrap();
    assert_eq!(config.outer_loop, OuterLoopSection::OpenLoop {});
}

#[test]
fn the_margin_of_the_fence_is_half_a_car_unless_it_is_given() {
    assert_eq!(example().fence.margin_m, Some(0.2));
    let mut config = example();
    config.fence.margin_m = None;
    config.vehicle.front_axle_distance_m *= 2.0;
    config.vehicle.rear_axle_distance_m *= 2.0;
    assert_eq!(config.fence.margin_m(&config.vehicle), 0.4);
    config.fence.margin_m = Some(0.0);
    assert_eq!(config.fence.margin_m(&config.vehicle), 0.0);
}

/// The example with another reference.
fn with_reference(keys: &str) -> Result<Config, ConfigError> {
    let mut table: toml::Table = EXAMPLE.parse().unwrap();
    let reference: toml::Table = keys.parse().unwrap();
    table.insert("reference".to_owned(), reference.into());
    Config::from_toml(&table.to_string())
}

#[test]
fn a_closed_reference_begins_nearest_unless_told_otherwise_and_an_open_one_refuses_that() {
    let eight = "kind = \"figure-of-eight\"\nhalf_length_m = 1.0\nhalf_width_m = 0.5\n\
                 angular_velocity_rad_s = 0.4\n";
    let path = "kind = \"path\"\npoints = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]\nspeed_m_s = 0.5\n";
    let (closed, open) = (format!("{path}closed = true\n"), path.to_owned());
    let (nearest, beginning) = ("start = \"nearest\"", "start = \"beginning\"");
    for (keys, more, start) in [
        (eight, "", Start::Nearest),
        (eight, beginning, Start::Beginning),
        (&closed, "", Start::Nearest),
        (&closed, beginning, Start::Beginning),
        (&open, "", Start::Beginning),
        (&open, beginning, Start::Beginning),
    ] {
        let config = with_reference(&format!("{keys}{more}")).unwrap();
        assert_eq!(config.pilot().unwrap().start, start, "{keys}{more}");
        // What a record has.
        let recorded = config.to_toml().unwrap();
        assert_eq!(Config::from_toml(&recorded).unwrap(), config);
    }
    let waypoints = "kind = \"waypoints\"\nwaypoints = [{ t_s = 0.0, x_m = 0.0, y_m = 0.0 }]\n";
    for (keys, why) in [
        (
            &*open,
            "reference.start is nearest: an open path begins at its beginning",
        ),
        (
            waypoints,
            "reference.start is no key of kind = \"waypoints\": remove it",
        ),
    ] {
        let error = with_reference(&format!("{keys}{nearest}"))
            .unwrap_err()
            .to_string();
        assert!(error.contains(why), "{error}");
    }
}
