//! The example `ideal_car` against the theory of two integrators.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

#[path = "../examples/ideal_car.rs"]
#[allow(dead_code, reason = "its main function is not called here")]
mod ideal_car;

/// 1/√1.25, in m.
const AMPLITUDE: f64 = 0.894_427;
/// atan(0.5), in rad.
const LAG: f64 = 0.463_648;
/// Half of the last digit above.
const ROUNDING: f64 = 5e-7;

fn output() -> (ideal_car::SettledCircle, String) {
    let mut out = vec![];
    let settled = ideal_car::run(&mut out).unwrap();
    (settled, String::from_utf8(out).unwrap())
}

#[test]
fn the_point_settles_where_two_integrators_do() {
    let (settled, _) = output();
    assert!(
        (settled.amplitude - AMPLITUDE).abs() < ROUNDING,
        "{settled:?}"
    );
    assert!((settled.lag - LAG).abs() < ROUNDING, "{settled:?}");
    let theory = ideal_car::theory(1.0);
    assert!((settled.amplitude - theory.amplitude).abs() < 1e-9);
    assert!((settled.lag - theory.lag).abs() < 1e-9);
}

#[test]
fn the_table_has_a_line_every_four_seconds_and_ends_with_the_theory() {
    let (_, out) = output();
    let lines: Vec<_> = out.lines().collect();
    let [_, _, table @ .., blank, _, settled, theory] = lines.as_slice() else {
        panic!("{out}");
    };
    let rows: Vec<Vec<f64>> = table
        .iter()
        .map(|line| {
            line.split_whitespace()
                .map(|cell| cell.parse().unwrap())
                .collect()
        })
        .collect();
    let times: Vec<f64> = rows.iter().map(|row| row[0]).collect();
    let every_four: Vec<f64> = (0..=10).map(|line| 4.0 * f64::from(line)).collect();
    assert_eq!(times, every_four, "{out}");
    // The error begins at the initial distance and settles at the distance between two
    // circles of different radius and phase.
    assert_eq!(rows[0][5], 0.5);
    let between = (1.0 + AMPLITUDE * AMPLITUDE - 2.0 * AMPLITUDE * LAG.cos()).sqrt();
    assert!((rows[10][5] - between).abs() < 1e-4, "{out}");
    assert!(blank.is_empty());
    let digits = ["0.894427", "0.463648"];
    for (name, line) in [("settled", settled), ("theory", theory)] {
        let cells: Vec<_> = line.split_whitespace().collect();
        assert_eq!(cells, [name, digits[0], digits[1]], "{out}");
    }
}
