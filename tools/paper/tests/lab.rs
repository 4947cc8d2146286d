//! The marks of the labs, against closed forms and the linear loop.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use std::{collections::BTreeMap, f64::consts::PI};

use nalgebra::Complex;
use singletrack_analysis::stability::{ClosedLoop, Law, SampledLoop, Servo};
use singletrack_control::VehicleParameters;
use singletrack_paper::lab::{
    Answers, Exercise, Grade, LABS, Marks, Student, exercises, mark, template,
};

const STUDENTS: [&str; 3] = ["Ada Lovelace", "Zhang Wei", "Müller 7"];

fn student(name: &str) -> Student {
    Student::new(name).unwrap()
}

/// The numbers in a text, in order.
fn numbers(text: &str) -> Vec<f64> {
    text.split(|c: char| !(c.is_ascii_digit() || "+-.".contains(c)))
        .filter_map(|word| word.trim_end_matches('.').parse().ok())
        .collect()
}

/// The numbers in the texts of a lab, by the exercise.
fn given(lab: u8, name: &str) -> BTreeMap<&'static str, Vec<f64>> {
    let exercises = exercises(lab, &student(name)).unwrap();
    let of = |exercise: &Exercise| (exercise.id, numbers(&exercise.text));
    exercises.iter().map(of).collect()
}

fn marked(lab: u8, name: &str, values: &[(&str, f64)]) -> Marks {
    let values = values
        .iter()
        .map(|(key, value)| ((*key).to_owned(), *value));
    let (student, values) = (student(name), values.collect());
    mark(&Answers {
        lab,
        student,
        values,
    })
    .unwrap()
}

fn wrong(marks: &Marks) -> Vec<String> {
    let wrong = marks.marks.iter().filter(|mark| mark.grade != Grade::Right);
    wrong
        .map(|mark| {
            format!(
                "{} {}: {:?} {}",
                marks.student, mark.exercise, mark.answers, mark.found
            )
        })
        .collect()
}

/// Full points for the values, none for values that are 7 % larger.
fn check(lab: u8, name: &str, values: &[(&str, f64)]) {
    let marks = marked(lab, name, values);
    assert_eq!(wrong(&marks), Vec::<String>::new());
    assert_eq!(marks.points, marks.of);
    // The design exercises accept a range: an answer far outside of it.
    let far = |key: &str| {
        if key.starts_with("car_p") || key == "gain_per_s" {
            40.0
        } else {
            1.07
        }
    };
    let off: Vec<_> = values
        .iter()
        .map(|(key, value)| (*key, value * far(key)))
        .collect();
    let marks = marked(lab, name, &off);
    assert_eq!(marks.points, 0, "{marks}");
    assert!(
        marks
            .marks
            .iter()
            .all(|mark| mark.grade == Grade::Wrong && mark.hint.is_some())
    );
}

/// The sideslip of the steady circle, from the equations of the car with linear tyres: forces and
/// moments balance, and P moves at `point_speed`.
fn steady_sideslip(rate: f64, point_speed: f64) -> f64 {
    let car = VehicleParameters::paper();
    let (a, b) = (car.front_axle_distance_m, car.rear_axle_distance_m);
    let (front, rear) = (
        car.front_cornering_stiffness_n_rad,
        car.rear_cornering_stiffness_n_rad,
    );
    // Lateral force of each axle: F_f + F_r = m v r and a F_f = b F_r.
    let at = |speed: f64| {
        let lateral = car.mass_kg * speed * rate;
        let (on_front, on_rear) = (lateral * b / (a + b), lateral * a / (a + b));
        let sideslip = b * rate / speed - on_rear / rear;
        let steering = on_front / front + sideslip + a * rate / speed;
        // The velocity of P: that of the front axle, and of p about it.
        let x = speed * sideslip.cos() - 0.35 * rate * steering.sin();
        let y = speed * sideslip.sin() + a * rate + 0.35 * rate * steering.cos();
        (x.hypot(y), sideslip)
    };
    let (mut low, mut high) = (0.01, 3.0);
    for _ in 0..100 {
        let middle = 0.5 * (low + high);
        if at(middle).0 < point_speed {
            low = middle;
        } else {
            high = middle;
        }
    }
    at(low).1
}

#[test]
fn lab_1_accepts_the_closed_forms() {
    for name in STUDENTS {
        let given = given(1, name);
        let [radius, rate, gain, _] = given["1.1"][..] else {
            panic!("{given:?}")
        };
        let root = gain.hypot(rate);
        let wanted = given["1.4"][0];
        let [offset, remaining, duration, _] = given["1.5"][..] else {
            panic!("{given:?}")
        };
        check(
            1,
            name,
            &[
                ("amplitude_m", radius * gain / root),
                ("lag_rad", (rate / gain).atan()),
                ("distance_m", radius * rate / root),
                (
                    "gain_per_s",
                    rate * ((radius / wanted).powi(2) - 1.0).sqrt(),
                ),
                ("decay_gain_per_s", (offset / remaining).ln() / duration),
                ("sideslip_rad", steady_sideslip(rate, radius * rate)),
            ],
        );
    }
}

/// Where `is_below` changes from true to false.
fn bisect(mut low: f64, mut high: f64, is_below: impl Fn(f64) -> bool) -> f64 {
    assert!(is_below(low) && !is_below(high));
    for _ in 0..50 {
        let middle = 0.5 * (low + high);
        if is_below(middle) {
            low = middle;
        } else {
            high = middle;
        }
    }
    low
}

/// The largest real part, by the eigenvalues of the Jacobian and not by the polynomial's roots.
fn largest_real_part(at: &ClosedLoop) -> f64 {
    let values: Vec<Complex<f64>> = at
        .jacobian()
        .complex_eigenvalues()
        .iter()
        .copied()
        .collect();
    values
        .iter()
        .fold(f64::NEG_INFINITY, |most, value| most.max(value.re))
}

#[test]
fn lab_2_accepts_what_the_eigenvalues_say() {
    for name in STUDENTS {
        let given = given(2, name);
        let [mass, front, speed, _] = given["2.1"][..] else {
            panic!("{given:?}")
        };
        let car = VehicleParameters {
            mass_kg: mass,
            front_cornering_stiffness_n_rad: front,
            ..VehicleParameters::paper()
        };
        let at = |law, p, speed, dl| ClosedLoop::new(car, law, p, speed, dl).unwrap();
        let tolerated = bisect(0.0, 0.1, |dl| {
            largest_real_part(&at(Law::VelocityPoint, 0.35, speed, dl)) < 0.0
        });
        let is_unstable = |p| {
            [-car.front_axle_distance_m, car.rear_axle_distance_m]
                .iter()
                .any(|dl| !at(Law::FrontPoint, p, 1e4, *dl).is_stable())
        };
        let [_, fast, other] = given["2.3"][..] else {
            panic!("{given:?}")
        };
        let deviation = given["2.4"][4];
        let angle = given["2.5"][0].to_radians();
        check(
            2,
            name,
            &[
                ("tolerated_dl_mm", 1e3 * tolerated),
                ("least_p_m", bisect(0.1, 2.0, is_unstable)),
                (
                    "largest_real_part_per_s",
                    largest_real_part(&at(Law::FrontPoint, 0.35, fast, other)),
                ),
                ("way_off_on_circle_m", deviation),
                (
                    "way_off_after_turn_m",
                    2.0 * deviation * (angle / 2.0).sin(),
                ),
            ],
        );
    }
}

#[test]
fn lab_3_accepts_the_limits_of_the_linear_loop_and_gains_by_rule() {
    for name in STUDENTS {
        let given = given(3, name);
        let at = |speed, p, delay_ms: f64| {
            let car = VehicleParameters::paper();
            let closed = ClosedLoop::new(car, Law::FrontPoint, p, speed, 0.0).unwrap();
            SampledLoop::new(closed, 0.01, 1e-3 * delay_ms).unwrap()
        };
        let speed = given["3.1"][2];
        let delay_ms = given["3.2"][1];
        let [servo_delay_ms, _, lag_ms, fast] = given["3.3"][..] else {
            panic!("{given:?}")
        };
        let servo = Servo {
            lag: 1e-3 * lag_ms,
            dead_time: 0.012,
        };
        let with_servo = |speed, p| at(speed, p, servo_delay_ms).with_servo(servo).unwrap();
        let [_, ticks_rate, ..] = given["3.5"][..] else {
            panic!("{given:?}")
        };
        let delay = 1e-3 * given["3.5"][4];
        let longest = given["3.6"][2];
        assert!((0.3..0.7).contains(&ticks_rate), "{given:?}");
        check(
            3,
            name,
            &[
                (
                    "delay_margin_ms",
                    bisect(1.0, 490.0, |ms| {
                        at(speed, 0.35, ms).spectral_radius(1) < 1.0
                    }),
                ),
                (
                    "largest_gain_per_s",
                    bisect(0.1, 2.0 * PI / delay_ms * 1e3, |gain| {
                        let at = at(0.5, 0.35, delay_ms).with_position_gain(gain).unwrap();
                        at.spectral_radius(1) < 1.0
                    }),
                ),
                (
                    "least_p_m",
                    bisect(0.005, 5.0, |p| with_servo(fast, p).spectral_radius(1) > 1.0),
                ),
                (
                    "first_unstable_m_s",
                    bisect(0.1, 20.0, |v| {
                        with_servo(v, given["3.4"][0]).spectral_radius(1) < 1.0
                    }),
                ),
                ("gain_per_s", 0.6 / delay),
                ("car_p_m", longest),
                ("car_gain_per_s", 2.0),
            ],
        );
    }
}

#[test]
fn answers_at_the_edge_of_the_tolerance_count() {
    for lab in 1..=LABS {
        let name = "Edge";
        for exercise in exercises(lab, &student(name)).unwrap() {
            let (Some(truth), Some(tolerance)) = (exercise.truth().unwrap(), exercise.tolerance())
            else {
                continue;
            };
            let key = exercise.quantities[0].key;
            for (share, grade) in [
                (1.0 + tolerance, Grade::Right),
                (1.0 - tolerance, Grade::Right),
                (1.0 + 1.01 * tolerance, Grade::Wrong),
                (1.0 - 1.01 * tolerance, Grade::Wrong),
                (-1.0, Grade::Wrong),
            ] {
                let marks = marked(lab, name, &[(key, truth * share)]);
                let mark = marks
                    .marks
                    .iter()
                    .find(|mark| mark.exercise == exercise.id)
                    .unwrap();
                assert_eq!(mark.grade, grade, "{key}: {truth} * {share}");
            }
        }
    }
}

#[test]
fn every_student_has_numbers_that_can_be_computed() {
    for lab in 1..=LABS {
        for number in 0..12 {
            for exercise in exercises(lab, &student(&format!("student {number}"))).unwrap() {
                let truth = exercise
                    .truth()
                    .unwrap_or_else(|error| panic!("{}: {error}", exercise.text));
                if let Some(truth) = truth {
                    assert!(
                        truth.is_finite() && truth != 0.0,
                        "{}: {truth}",
                        exercise.text
                    );
                    assert!(exercise.id == "1.6" || exercise.id == "2.3" || truth > 0.0);
                }
            }
        }
    }
}

#[test]
fn numbers_belong_to_the_name() {
    let text = |lab, name: &str| {
        template(
            lab,
            &student(name),
            &exercises(lab, &student(name)).unwrap(),
        )
    };
    for lab in 1..=LABS {
        assert_eq!(text(lab, "Ada"), text(lab, "Ada"));
        assert_eq!(text(lab, "Ada  Lovelace "), text(lab, "Ada Lovelace"));
        let names: std::collections::BTreeSet<String> = (0..100)
            .map(|number| text(lab, &format!("student {number}")))
            .map(|text| text.split("[answers]").nth(1).unwrap().to_owned())
            .collect();
        assert!(
            names.len() > 95,
            "lab {lab}: only {} different sets",
            names.len()
        );
        // Capitals alone do not make another student.
        let exercises = |name: &str| {
            text(lab, name)
                .split("[answers]")
                .nth(1)
                .unwrap()
                .to_owned()
        };
        assert_eq!(exercises("ADA"), exercises("ada"));
    }
}

#[test]
fn an_empty_sheet_is_marked_and_a_malformed_one_is_explained() {
    for lab in 1..=LABS {
        let ada = student("Ada");
        let sheet = template(lab, &ada, &exercises(lab, &ada).unwrap());
        let marks = mark(&Answers::from_toml(&sheet).unwrap()).unwrap();
        assert_eq!(marks.points, 0);
        assert!(marks.marks.iter().all(|mark| mark.grade == Grade::Open));
    }
    for (sheet, words) in [
        ("lab = 1\nstudent = \"Ada\"\n", &["answers"][..]),
        (
            "lab = 4\nstudent = \"Ada\"\n[answers]\n",
            &["lab = 4", "1 to 3"],
        ),
        ("lab = -1\nstudent = \"Ada\"\n[answers]\n", &["lab = -1"]),
        ("lab = 1\nstudent = \" \"\n[answers]\n", &["student"]),
        (
            "lab = 1\nstudent = \"Ada\"\n[answers]\nlag_deg = 3\n",
            &["lag_deg", "lag_rad"],
        ),
        (
            "lab = 1\nstudent = \"Ada\"\n[answers]\nlag_rad = \"0.4 rad\"\n",
            &["lag_rad", "0.4 rad", "without quotes"],
        ),
        (
            "lab = 1\nstudent = \"Ada\"\n[answers]\nlag_rad = nan\n",
            &["lag_rad", "nan"],
        ),
        (
            "lab = 1\nstudent = \"Ada\"\n[answers]\nlag_rad = \n",
            &["line 4"],
        ),
    ] {
        let error = Answers::from_toml(sheet).unwrap_err().to_string();
        for word in words {
            assert!(error.contains(word), "{error:?} does not say {word:?}");
        }
    }
}

#[test]
fn a_hopeless_choice_is_wrong_and_no_failure() {
    for values in [[0.0, 2.0], [0.15, -1.0], [0.01, 40.0], [f64::MAX, f64::MAX]] {
        let marks = marked(
            3,
            "Ada",
            &[("car_p_m", values[0]), ("car_gain_per_s", values[1])],
        );
        assert_eq!(marks.marks[5].grade, Grade::Wrong, "{values:?}: {marks}");
    }
    let half = marked(3, "Ada", &[("car_p_m", 0.1)]);
    assert_eq!(half.marks[5].grade, Grade::Open);
}
