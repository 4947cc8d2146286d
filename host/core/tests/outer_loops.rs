//! `[outer_loop]`: which loops the configuration gives, and which combinations it refuses.

#![allow(clippy::unwrap_used, reason = "a test may fail")]

use singletrack_control::{DelayedMpc, OuterLoop, TrackingInput, TrackingLoop, Velocity};
use singletrack_core::config::{
    Config, LoopModel, LqiWeights, MpcWeights, OuterLoopSection, OwnLoop, OwnLoopKind,
    OwnLoopSection, link_own_loops,
};
use singletrack_settings::{ValueError, section};

const EXAMPLE: &str = include_str!("../../daemon/singletrackd.example.toml");
const FILE: &str = "kind = \"proportional\"\ngain_per_s = [1.0, 1.0]\n";

/// The example file with this outer loop, and further changes.
fn example(outer_loop: &str, changes: &[(&str, &str)]) -> String {
    let start = EXAMPLE.find("[outer_loop]").unwrap();
    let end = start + EXAMPLE[start..].find("\n[reference]").unwrap();
    let mut text = format!(
        "{}[outer_loop]\n{outer_loop}\n{}",
        &EXAMPLE[..start],
        &EXAMPLE[end..]
    );
    for (from, to) in changes {
        assert!(text.contains(from), "{from}");
        text = text.replacen(from, to, 1);
    }
    text
}

fn refused(text: &str) -> String {
    Config::from_toml(text).unwrap_err().to_string()
}

#[test]
fn every_kind_can_be_selected_and_is_written_out() {
    for (text, expected) in [
        (
            FILE,
            OuterLoopSection::Proportional {
                gain_per_s: [1.0, 1.0],
                feed_forward: false,
            },
        ),
        (
            "kind = \"lqi\"\nintegral_weight = 2.0",
            OuterLoopSection::Lqi(LqiWeights {
                integral_weight: 2.0,
                ..LqiWeights::default()
            }),
        ),
        (
            "kind = \"mpc\"\niterations = 7",
            OuterLoopSection::Mpc(MpcWeights {
                iterations: 7,
                ..MpcWeights::default()
            }),
        ),
        ("kind = \"open-loop\"", OuterLoopSection::OpenLoop {}),
    ] {
        let config = Config::from_toml(&example(text, &[])).unwrap();
        assert_eq!(config.outer_loop, expected);
        let written = Config::from_toml(&config.to_toml().unwrap()).unwrap();
        assert_eq!(written, config);
        assert_eq!(written.pilot().unwrap(), config.pilot().unwrap());
    }
}

#[test]
fn the_predictive_loop_knows_the_dead_time_that_nothing_compensates() {
    let kind = "kind = \"mpc\"";
    let config = Config::from_toml(&example(kind, &[])).unwrap();
    let tracking = config.pilot().unwrap().tracking;
    assert!(matches!(tracking, TrackingLoop::Mpc(DelayedMpc::Prompt(_))));
    let mut off = config;
    off.compensation.actuation = false;
    let tracking = off.pilot().unwrap().tracking;
    assert!(matches!(tracking, TrackingLoop::Mpc(DelayedMpc::Late(_))));
}

#[test]
fn a_key_of_another_kind_and_a_value_out_of_range_are_refused() {
    let surplus = "kind = \"lqi\"\ngain_per_s = [1.0, 1.0]";
    let told = refused(&example(surplus, &[]));
    assert!(
        told.contains("outer_loop.gain_per_s is no key of kind = \"lqi\""),
        "{told}"
    );
    for (key, value) in [
        ("integral_weight", "0.0"),
        ("velocity_weight", "-1.0"),
        ("integral_limit_m_s", "6.0"),
    ] {
        let told = refused(&example(&format!("kind = \"lqi\"\n{key} = {value}"), &[]));
        assert!(told.contains(&format!("outer_loop.{key} is ")), "{told}");
    }
    let told = refused(&example("kind = \"mpc\"\niterations = 0", &[]));
    assert!(told.contains("outer_loop.iterations is 0"), "{told}");
}

#[test]
fn a_loop_that_needs_what_the_reference_does_not_have_is_refused() {
    let circle = "kind = \"circle\"\nradius_m = ";
    let start = EXAMPLE.find(circle).unwrap();
    let circle = &EXAMPLE[start..start + EXAMPLE[start..].find("\n\n").unwrap()];
    let external = [(circle, "kind = \"external\"")];
    let told = refused(&example("kind = \"mpc\"", &external));
    assert!(
        told.contains("outer_loop.kind is mpc") && told.contains("use \"lqi\""),
        "{told}"
    );
    assert!(Config::from_toml(&example("kind = \"lqi\"", &external)).is_ok());
    let steps =
        "kind = \"velocity-steps\"\nsteps = [{ duration_s = 1.0, v_x_m_s = 0.5, v_y_m_s = 0.0 }]";
    for kind in ["lqi", "mpc"] {
        let told = refused(&example(&format!("kind = \"{kind}\""), &[(circle, steps)]));
        assert!(
            told.contains(&format!("outer_loop.kind is {kind}")) && told.contains("open-loop"),
            "{told}"
        );
    }
}

#[test]
fn a_loop_that_does_not_settle_is_refused_with_the_way_out() {
    let slow = "kind = \"lqi\"\nvelocity_weight = 100.0";
    let lags = "\n[compensation]\nactuation = false\n[actuators]\nspeed_lag_ms = 400.0\nsteering_lag_ms = 300.0\n";
    let fast = (
        "radius_m = 0.85\nangular_velocity_rad_s = 0.5",
        "radius_m = 0.85\nangular_velocity_rad_s = 1.5",
    );
    let text = with_sections(&example(slow, &[fast]), lags);
    let told = refused(&text);
    assert!(
        told.contains("outer_loop.velocity_weight is 100")
            && told.contains("1.50 rad/s")
            && told.contains("compensation.actuation = true"),
        "{told}"
    );
    // Where the lags are compensated it settles, and so it does with the defaults.
    assert!(Config::from_toml(&example(slow, &[fast])).is_ok());
    assert!(Config::from_toml(&with_sections(&example("kind = \"lqi\"", &[fast]), lags)).is_ok());
}

#[test]
fn the_predictive_loop_refuses_what_it_cannot_plan_for() {
    let mut config = Config::from_toml(&example("kind = \"mpc\"", &[])).unwrap();
    config.fence.corners_m = vec![
        [-3.0, -3.0],
        [3.0, -3.0],
        [3.0, 3.0],
        [0.0, 0.0],
        [-3.0, 3.0],
    ];
    let told = config.validate().unwrap_err().to_string();
    assert!(
        told.contains("outer_loop.kind is mpc") && told.contains("not convex at corner 3"),
        "{told}"
    );
    config.outer_loop = OuterLoopSection::Lqi(LqiWeights::default());
    config.validate().unwrap();

    let mut config = Config::from_toml(&example("kind = \"mpc\"", &[])).unwrap();
    config.compensation.actuation = false;
    config.actuators.speed_dead_time_ms = 500.0;
    config.actuators.steering_dead_time_ms = 500.0;
    config.control.period_ms = 5;
    let told = config.validate().unwrap_err().to_string();
    assert!(
        told.contains("actuators.speed_dead_time_ms is 500") && told.contains("compensation"),
        "{told}"
    );
}

section! {
    /// The settings of [`Slow`].
    "outer_loop.own" => Settings: Copy;
    [default];

    /// How fast P goes, m/s.
    pace_m_s: f64 = 0.1, in 0.0..=0.5;
}

/// A loop of another crate.
#[derive(Clone, Debug, PartialEq)]
struct Slow(Settings);

impl OuterLoop for Slow {
    fn step(&mut self, _: &TrackingInput<'_>) -> Velocity {
        Velocity::new(self.0.pace_m_s, 0.0)
    }

    fn reset(&mut self) {}
}

impl OwnLoop for Slow {
    const NAME: &'static str = "slow";
    const VERSION: &'static str = "1.2.3";
    type Settings = Settings;

    fn new(settings: Settings, model: &LoopModel<'_>) -> Result<Self, ValueError> {
        let most = model.limits.max_speed;
        if settings.pace_m_s > most {
            let (key, fix) = ("outer_loop.own.pace_m_s", format!("at most {most}"));
            return Err(ValueError::new(key, settings.pace_m_s, fix));
        }
        Ok(Self(settings))
    }
}

#[test]
fn a_loop_of_another_crate_is_written_out_with_its_version() {
    link_own_loops([OwnLoopKind::of::<Slow>()]);
    let text = "kind = \"own\"\nname = \"slow\"\nown = { pace_m_s = 0.2 }";
    let config = Config::from_toml(&example(text, &[])).unwrap();
    let written = config.to_toml().unwrap();
    assert!(written.contains("version = \"1.2.3\""), "{written}");
    let again = Config::from_toml(&written).unwrap();
    assert_eq!(again, config);
    let [tracking, again] = [&config, &again].map(|config| config.pilot().unwrap().tracking);
    assert_eq!(tracking, again);
    let default = OwnLoopSection::new("slow".to_owned(), None, None);
    let mut other = config;
    other.outer_loop = OuterLoopSection::Own(default);
    assert_ne!(other.pilot().unwrap().tracking, tracking);
}

#[test]
fn a_loop_of_another_crate_is_refused_by_name_version_and_key() {
    link_own_loops([OwnLoopKind::of::<Slow>()]);
    for (keys, parts) in [
        ("", &["outer_loop.name is missing", "\"own\""][..]),
        (
            "name = \"fast\"\nversion = \"0.1.0\"",
            &[
                "outer_loop.name is fast: this program has only slow",
                "built with fast 0.1.0",
            ],
        ),
        (
            "name = \"slow\"\nversion = \"1.2.2\"",
            &[
                "outer_loop.version is 1.2.2: this program has slow 1.2.3",
                "built with slow 1.2.2",
            ],
        ),
        (
            "name = \"slow\"\ngain_per_s = [1.0, 1.0]",
            &["outer_loop.gain_per_s is no key of kind = \"own\""],
        ),
        (
            "name = \"slow\"\nown = { pace = 0.2 }",
            &["outer_loop.own.pace: unknown key", "pace_m_s"],
        ),
        (
            "name = \"slow\"\nown = { pace_m_s = \"x\" }",
            &["outer_loop.own.pace_m_s: it must be a number"],
        ),
        (
            "name = \"slow\"\nown = { pace_m_s = 2.0 }",
            &["outer_loop.own.pace_m_s is 2: it must lie between 0 and 0.5"],
        ),
    ] {
        let told = refused(&example(&format!("kind = \"own\"\n{keys}"), &[]));
        for part in parts {
            assert!(told.contains(part), "{keys}: {told}");
        }
    }
    let slow = [("#max_speed_m_s = 1.5", "max_speed_m_s = 0.3")];
    let keys = "kind = \"own\"\nname = \"slow\"\nown = { pace_m_s = 0.4 }";
    let told = refused(&example(keys, &slow));
    assert!(
        told.contains("outer_loop.own.pace_m_s is 0.4: at most 0.3"),
        "{told}"
    );
}

/// The text with these sections in the place of its own.
fn with_sections(text: &str, sections: &str) -> String {
    let mut table: toml::Table = text.parse().unwrap();
    table.extend(sections.parse::<toml::Table>().unwrap());
    toml::to_string(&table).unwrap()
}
