//! Tunings that a scenario plans.

use std::path::Path;

use singletrack_scenario::simulate::{Row, Scenario, simulate};

const BOUNDS: &str = "[tuning]\nenabled = true\ngain_per_s = [0.5, 4.0]\n\
                      point_distance_m = [0.3, 0.4]\n";

fn scenario(more: &str) -> Result<Scenario, String> {
    let text = include_str!("../../scenarios/circle-car.toml");
    let text = format!("{text}\n{more}").replace("duration_s = 40.0", "duration_s = 20.0");
    Scenario::from_toml(&text, Path::new("scenario.toml")).map_err(|error| error.to_string())
}

fn rows(more: &str) -> Vec<Row> {
    simulate(&scenario(more).unwrap()).unwrap().rows
}

/// The radius on which P goes round at the end, in m.
fn radius(rows: &[Row]) -> f64 {
    let last = rows.last().unwrap();
    last.x_p.hypot(last.y_p)
}

#[test]
fn twice_the_gain_brings_p_to_the_radius_of_that_gain() {
    // Without feed-forward the radius of P is 1/sqrt(1 + (w/K)^2) of the reference's.
    let radius_of = |gain: f64| 1.0 / (0.5_f64 / gain).hypot(1.0);
    let plain = rows(BOUNDS);
    assert!(
        (radius(&plain) - radius_of(1.0)).abs() < 0.01,
        "{}",
        radius(&plain)
    );
    let tuned = rows(&format!(
        "{BOUNDS}[[tune]]\nat_s = 8.0\ngain_per_s = [2.0, 2.0]\n"
    ));
    assert!(
        (radius(&tuned) - radius_of(2.0)).abs() < 0.01,
        "{}",
        radius(&tuned)
    );
    // Up to the tuning they are the same drive.
    let before = |row: &&Row| row.t < 8.0;
    assert!(plain.iter().filter(before).eq(tuned.iter().filter(before)));
}

#[test]
fn a_tuning_that_the_daemon_would_refuse_is_refused_with_its_time_and_the_bounds() {
    for (tune, parts) in [
        (
            "gain_per_s = [9.0, 2.0]",
            ["gain_per_s is 9", "between 0.5 and 4"],
        ),
        (
            "point_distance_m = 0.5",
            ["point_distance_m is 0.5", "between 0.3 and 0.4"],
        ),
        ("", ["nothing to tune", "gain_per_s"]),
    ] {
        let refused = scenario(&format!("{BOUNDS}[[tune]]\nat_s = 5.0\n{tune}\n")).unwrap_err();
        assert!(refused.contains("at_s = 5"), "{refused}");
        for part in parts {
            assert!(refused.contains(part), "{tune}: {refused}");
        }
    }
    let refused = scenario("[[tune]]\nat_s = 5.0\ngain_per_s = [2.0, 2.0]\n").unwrap_err();
    assert!(refused.contains("tuning.enabled"), "{refused}");
    let ideal = include_str!("../../scenarios/circle.toml");
    let ideal = format!("{ideal}\n[[tune]]\nat_s = 5.0\ngain_per_s = [2.0, 2.0]\n");
    let refused = Scenario::from_toml(&ideal, Path::new("scenario.toml")).unwrap_err();
    assert!(
        refused.to_string().contains("neither pilot nor board"),
        "{refused}"
    );
}

#[test]
fn a_predictive_loop_stays_within_its_bounds_while_p_is_tuned() {
    let tuning = "[tuning]\nenabled = true\npoint_distance_m = [0.2, 0.5]\n\
                  [[tune]]\nat_s = 8.0\npoint_distance_m = 0.25\n\
                  [[tune]]\nat_s = 10.0\npoint_distance_m = 0.5\n\
                  [[tune]]\nat_s = 12.0\npoint_distance_m = 0.2\n";
    let text = include_str!("../../scenarios/circle-car.toml");
    let text = format!("{text}\n{tuning}").replace("duration_s = 40.0", "duration_s = 20.0");
    let proportional = "kind = \"proportional\"\ngain_per_s = [1.0, 1.0]\nfeed_forward = false\n";
    assert!(text.contains(proportional));
    let mpc = text.replace(proportional, "kind = \"mpc\"\n");
    let scenario = Scenario::from_toml(&mpc, Path::new("scenario.toml")).unwrap();
    let simulation = simulate(&scenario).unwrap();
    assert_eq!(simulation.notes, [""; 0], "the car drove to the end");
    let last = simulation.rows.last().unwrap();
    assert!((last.x_p - last.x_ref).hypot(last.y_p - last.y_ref) < 0.02);
    for row in &simulation.rows {
        assert!(row.t < 5.0 || row.x_p.hypot(row.y_p) < 1.1, "{}", row.t);
    }
}
