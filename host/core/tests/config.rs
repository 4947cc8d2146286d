//! The configuration: what is accepted, and that no key is without effect; `[board]` and
//! `[safety_filter]`. What is refused elsewhere: `config_mistakes.rs`.

use singletrack_control::{
    Estimate, EstimatorConfig, Limits, Position, Reference, Time, TrackingLoop, VehicleParameters,
};
use singletrack_core::{
    ConfigError,
    config::{BoardSection, Config, OuterLoopSection, SECTIONS, Start},
};
use singletrack_pilot::SupervisorConfig;
use singletrack_protocol::{EscKind, FailsafeAction, ImuAxes, ImuAxis};
use toml::{Table, Value};

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

/// Sections and keys that their users read as they are: threads, files, sockets, the page.
const READ_AS_THEY_ARE: &[&str] = &[
    "serial",
    "socket",
    "record",
    "state",
    "page",
    "live",
    "supervisor.require_calibration",
    "control.align_to_cameras",
    "control.realtime_priority",
    "online_calibration",
];

/// Sections whose keys depend on a kind, or come together; they have tests of their own.
const TOGETHER: &[&str] = &[
    "motion_capture.sensor",
    "outer_loop",
    "reference",
    "vehicle",
    "tuning",
    "limits.max_reverse_speed_m_s",
];

fn example_with_all() -> Table {
    let mut file: Table =
        toml::from_str(include_str!("../../daemon/singletrackd.example.toml")).unwrap();
    // On, so that their keys count.
    for section in ["safety_filter", "governor", "neighbours"] {
        let table = file.entry(section).or_insert_with(|| Table::new().into());
        let table = table.as_table_mut().unwrap();
        table.insert("enabled".to_owned(), true.into());
    }
    file
}

/// What pilot, link, board and cameras are given.
fn given(file: &Table) -> Option<String> {
    let config = Config::from_toml(&toml::to_string(file).unwrap()).ok()?;
    let pilot = config.pilot().ok()?;
    let link = config.link(0);
    let steering = config.steering_map().ok()?;
    let cameras = &config.motion_capture;
    Some(format!("{pilot:?} {link:?} {steering:?} {cameras:?}"))
}

/// Other values of the same type, a little and much away.
fn others(value: &Value) -> Vec<Value> {
    match value {
        Value::Boolean(is) => vec![(!is).into()],
        Value::Integer(number) => [1, -1, 100, -100, 1_000]
            .map(|by| (number + by).into())
            .into(),
        Value::Float(number) => [1.01, 0.99, 1.5, 0.5]
            .map(|by| (number * by).into())
            .into_iter()
            .chain([(number + 0.01).into(), (number + 1.0).into()])
            .collect(),
        Value::Array(values) => {
            let Some(first) = values.first() else {
                return Vec::new();
            };
            let changed = others(first).into_iter().map(|first| {
                let mut values = values.clone();
                values[0] = first;
                values.into()
            });
            changed.collect()
        }
        _ => Vec::new(),
    }
}

#[test]
fn every_number_and_every_switch_reaches_who_acts_by_it() {
    let file = example_with_all();
    let before = given(&file).unwrap();
    let mut without = Vec::new();
    let mut count = 0;
    for section in SECTIONS {
        let names: Vec<&str> = section.name.split('.').collect();
        for key in section.keys {
            let path = format!("{}.{}", section.name, key.name);
            let is_known = |known: &&str| *known == names[0] || *known == path;
            if READ_AS_THEY_ARE.iter().chain(TOGETHER).any(is_known) {
                continue;
            }
            let mut file = file.clone();
            let table = names.iter().fold(&mut file, |table, name| {
                let entry = table.entry(*name).or_insert_with(|| Table::new().into());
                entry.as_table_mut().unwrap()
            });
            let written = table.get(key.name).cloned();
            let Some(value) = written.or((key.example)()).or((key.default)()) else {
                continue;
            };
            let others = others(&value);
            let differing = others.iter().filter(|other| **other != value).cloned();
            let after = differing.into_iter().find_map(|other| {
                let mut file = file.clone();
                let table = names.iter().fold(&mut file, |table, name| {
                    table[*name].as_table_mut().unwrap()
                });
                table.insert(key.name.to_owned(), other);
                given(&file)
            });
            count += 1;
            if after.is_none_or(|after| after == before) && !others.is_empty() {
                without.push(path);
            }
        }
    }
    assert!(count > 100, "{count}");
    assert_eq!(without, [""; 0]);
}

/// The example with these lines of a section changed or added.
fn with(changes: &[(&str, &str, &str)]) -> Result<Config, String> {
    let mut tables: toml::Table = EXAMPLE.parse().unwrap();
    for &(section, key, value) in changes {
        let mut table = &mut tables;
        for name in section.split('.') {
            table = table
                .entry(name)
                .or_insert_with(|| toml::Table::new().into())
                .as_table_mut()
                .unwrap();
        }
        if value.is_empty() {
            table.remove(key);
        } else {
            let value: toml::Table = format!("value = {value}").parse().unwrap();
            table.insert(key.to_owned(), value["value"].clone());
        }
    }
    Config::from_toml(&tables.to_string()).map_err(|error| error.to_string())
}

const NO_KIND: [(&str, &str, &str); 2] = [("board.esc", "kind", ""), ("board.esc", "brake_us", "")];

#[test]
fn an_esc_of_no_stated_kind_never_gets_a_pulse_below_neutral() {
    let config = with(&NO_KIND).unwrap();
    let configuration = config.board_configuration();
    assert_eq!(configuration.esc.kind, EscKind::ForwardReverse);
    assert_eq!(configuration.failsafe, FailsafeAction::Coast);
    assert_eq!(configuration.speed.max_reverse_mm_s, 0);
}

#[test]
fn the_kind_is_needed_where_a_pulse_below_neutral_is_asked_for() {
    for change in [
        ("board", "failsafe", "\"brake\""),
        ("board.speed", "max_reverse_mm_s", "300"),
    ] {
        let error = with(&[&NO_KIND[..], &[change]].concat()).unwrap_err();
        assert!(error.contains("board.esc.kind"), "{error}");
        assert!(error.contains("forward-reverse"), "{error}");
        let stated = [
            ("board.esc", "kind", "\"car\""),
            ("board.esc", "brake_us", "1350"),
            change,
        ];
        assert!(with(&stated).is_ok());
    }
}

#[test]
fn what_a_kind_cannot_do_is_refused_by_name() {
    for (changes, key) in [
        (
            vec![
                ("board.esc", "kind", "\"forward-reverse\""),
                ("board", "failsafe", "\"brake\""),
            ],
            "board.failsafe",
        ),
        (
            vec![
                ("board.esc", "kind", "\"vesc\""),
                ("board.speed", "max_reverse_mm_s", "300"),
            ],
            "board.speed.max_reverse_mm_s",
        ),
        (
            vec![
                ("board.esc", "kind", "\"car\""),
                ("board.esc", "brake_us", ""),
            ],
            "board.esc.brake_us",
        ),
        (
            vec![
                ("board", "kill_output", "true"),
                ("board", "failsafe", "\"brake\""),
            ],
            "board.failsafe",
        ),
    ] {
        let error = with(&changes).unwrap_err();
        assert!(error.starts_with(key), "{error}");
    }
}

#[test]
fn the_mounting_and_the_car_reach_the_board() {
    let config = with(&[
        ("board.imu", "forward", "\"-y\""),
        ("board.imu", "left", "\"+x\""),
        ("board", "car_id", "7"),
        ("board", "kill_output", "true"),
    ])
    .unwrap();
    let configuration = config.board_configuration();
    assert_eq!(
        configuration.imu_axes,
        ImuAxes {
            forward: ImuAxis::MinusY,
            left: ImuAxis::PlusX,
            up: ImuAxis::PlusZ,
        }
    );
    assert_eq!((configuration.car_id, configuration.kill_output), (7, true));
    let mirrored = with(&[("board.imu", "forward", "\"-x\"")]).unwrap_err();
    assert!(mirrored.starts_with("board.imu"), "{mirrored}");
}

#[test]
fn the_longest_roll_out_follows_from_speed_and_braking() {
    let longest_ms = |braking: &str, speed: &str| {
        let config = with(&[
            ("fence", "braking_m_s2", braking),
            ("limits", "max_speed_m_s", speed),
            ("board", "failsafe", "\"coast\""),
        ])
        .unwrap();
        config.board_configuration().max_roll_out_ms
    };
    // Twice the time to stand, and a second.
    assert_eq!(longest_ms("2.0", "1.0"), 2_000);
    assert_eq!(longest_ms("0.5", "1.0"), 5_000);
    assert_eq!(longest_ms("0.01", "1.0"), 30_000);
}

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

#[test]
fn what_the_servo_lacks_after_three_lags_counts_as_an_error_of_the_curvature() {
    // e^-3 of a change by 0.9 rad, up to 0.45 rad: (tan 0.45 - tan 0.405192)/0.26 m = 0.2082 1/m.
    let bends_as_assumed = |error: f64, curvature: f64| {
        let mut config = enabled();
        config.safety_filter.curvature_error_per_m = error;
        let filter = config.pilot().unwrap().safety.unwrap();
        let estimate = Estimate {
            time: Time(0),
            position: Position::origin(),
            yaw: 0.0,
            yaw_rate: curvature,
            sideslip: 0.0,
            speed: 1.0,
            pose_time: Time(0),
        };
        filter.bends_as_assumed(&estimate, 0.0)
    };
    for error in [0.0, 0.1, 0.208] {
        assert!(
            bends_as_assumed(error, 0.2081) && !bends_as_assumed(error, 0.2083),
            "{error}"
        );
    }
    // An error that is stated has it inside.
    assert!(bends_as_assumed(0.3, 0.2999) && !bends_as_assumed(0.3, 0.3001));
}

#[test]
fn what_servo_and_motor_lack_counts_unless_more_is_stated() {
    let filter = |change: &dyn Fn(&mut Config)| {
        let mut config = enabled();
        change(&mut config);
        config.pilot().unwrap().safety.unwrap()
    };
    // The sideslip of the servo's error is 0.0256 rad; 36 ms and 40 ms of braking by 0.9 m/s2 are
    // 0.0684 m/s.
    let course = |error: f64| filter(&|config| config.safety_filter.course_error_rad = error);
    assert_eq!(course(0.0), course(0.0256));
    assert_ne!(course(0.0), course(0.0257));
    let speed = |error: f64| filter(&|config| config.safety_filter.speed_error_m_s = error);
    assert_eq!(speed(0.0), speed(0.0683));
    assert_ne!(speed(0.0), speed(0.0685));
}
