//! What `[board]` says about an ESC, a sensor's mounting and a car, and what is refused.

#![allow(clippy::unwrap_used, reason = "a test may fail")]

use singletrack_core::config::Config;
use singletrack_protocol::{EscKind, FailsafeAction, ImuAxes, ImuAxis};

const EXAMPLE: &str = include_str!("../../daemon/singletrackd.example.toml");

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
