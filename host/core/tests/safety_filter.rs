//! `[safety_filter]`: what is refused, and what it rests on.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use singletrack_core::config::Config;

const EXAMPLE: &str = include_str!("../../daemon/singletrackd.example.toml");

fn enabled() -> Config {
    let mut config = Config::from_toml(EXAMPLE).unwrap();
    config.safety_filter.enabled = true;
    config
}

fn refusal(config: &Config) -> String {
    match config.validate() {
        Ok(()) => panic!("accepted"),
        Err(error) => error.to_string(),
    }
}

#[test]
fn it_is_off_unless_it_is_enabled() {
    let config = Config::from_toml(EXAMPLE).unwrap();
    assert!(config.pilot().unwrap().safety.is_none());
    enabled().validate().unwrap();
    assert!(enabled().pilot().unwrap().safety.is_some());
}

#[test]
fn a_geofence_that_is_not_convex_is_refused_only_with_it() {
    let mut config = enabled();
    config.fence.corners_m = [
        [0.0, 0.0],
        [4.0, 0.0],
        [4.0, 2.0],
        [2.0, 2.0],
        [2.0, 4.0],
        [0.0, 4.0],
    ]
    .into();
    let message = refusal(&config);
    for part in [
        "fence.corners_m",
        "[2.0, 2.0]",
        "not convex at corner 3",
        "largest convex part",
        "safety_filter.enabled = false",
    ] {
        assert!(message.contains(part), "{part}: {message}");
    }
    config.safety_filter.enabled = false;
    config.validate().unwrap();
}

#[test]
fn a_margin_that_leaves_nothing_is_refused() {
    let mut config = enabled();
    config.fence.margin_m = Some(1.2);
    let message = refusal(&config);
    for part in ["fence.margin_m is 1.2", "nothing is left", "lower it"] {
        assert!(message.contains(part), "{part}: {message}");
    }
}

#[test]
fn a_servo_that_is_slower_than_it_can_follow_is_refused() {
    // 63 ticks of 10 ms are 630 ms; 18 ms, three lags and 40 ms.
    let mut config = enabled();
    config.actuators.steering_lag_ms = 190.0;
    config.validate().unwrap();
    config.actuators.steering_lag_ms = 191.0;
    let message = refusal(&config);
    for part in [
        "actuators.steering_lag_ms is 191",
        "needs 631 ms",
        "for 630 ms",
        "control.period_ms = 10",
        "a faster servo",
    ] {
        assert!(message.contains(part), "{part}: {message}");
    }
    config.safety_filter.enabled = false;
    config.validate().unwrap();
}

#[test]
fn the_reaction_follows_the_motor_unless_it_is_given() {
    let filter = |config: &Config| config.pilot().unwrap().safety;
    let default = enabled();
    let mut slower = enabled();
    slower.actuators.speed_lag_ms += 50.0;
    assert_ne!(filter(&slower), filter(&default));
    // The motor's 36 and 80 ms, and 80 ms.
    let mut stated = enabled();
    stated.safety_filter.reaction_ms = Some(196.0);
    assert_eq!(filter(&stated), filter(&default));
    stated.actuators.speed_lag_ms += 50.0;
    assert_eq!(filter(&stated), filter(&default));
}
