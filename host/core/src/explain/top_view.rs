//! What a top view of the car needs once, as JSON: where the car may be, where it should be, how large
//! it is, and what the reasons mean. The page and the browser's laboratory draw it.

use serde_json::{Map, Value, json};

use crate::{config::Config, feasibility::judge_reference, reasons::explanations};

/// Points of the reference's path.
const POINTS: u32 = 400;

/// For so long the start must be good, in s.
const LONGEST_S: f64 = 60.0;

/// The car's body and axles, in m.
pub fn car(config: &Config) -> Value {
    let (vehicle, law) = (&config.vehicle, &config.law);
    json!({
        "name": config.motion_capture.rigid_body,
        "id": config.board.car_id,
        "length_m": vehicle.body_length_m(),
        "width_m": vehicle.body_width_m(),
        "front_axle_m": law.front_axle_distance_m,
        "rear_axle_m": vehicle.wheelbase_m() - law.front_axle_distance_m,
        "point_m": law.front_axle_distance_m + law.point_distance_m,
    })
}

/// What does not change while the car drives. `number` is that of the configuration.
pub fn setup(number: u32, config: &Config) -> Value {
    let (points_m, is_closed) = reference_path(config);
    json!({
        "version": env!("CARGO_PKG_VERSION"),
        "configuration": number,
        "fence": {
            "corners_m": config.fence.corners_m,
            "margin_m": config.fence.margin_m(&config.vehicle),
        },
        "reference": { "points_m": points_m, "closed": is_closed },
        "start": start(config),
        "car": car(config),
        "max_speed_m_s": config.limits.max_speed_m_s,
        "max_steering_rad": config.limits.max_steering_rad,
        "hold_ms": config.supervisor.hold_ms,
        "arm_battery_v": config.supervisor.arm_battery_v,
        "reasons": reasons(),
    })
}

/// A place from which the car can drive its reference, as `singletrackd --check` names it; null if
/// there is none.
fn start(config: &Config) -> Value {
    let judgement = judge_reference(config, None, Some(LONGEST_S)).unwrap_or_default();
    json!(judgement.start)
}

/// The positions of the reference over its lap or its duration, and whether it closes; none for a
/// reference of velocity only, and for set-points.
fn reference_path(config: &Config) -> (Vec<[f64; 2]>, bool) {
    // A configuration in force has a valid reference.
    let Ok(reference) = config.reference.reference() else {
        return (Vec::new(), false);
    };
    let (time, is_closed) = match reference.lap_time() {
        Some(lap) => (lap, true),
        None => (reference.duration().unwrap_or_default(), false),
    };
    let points = (0..=POINTS)
        .filter_map(|index| {
            let point = reference.at(time * f64::from(index) / f64::from(POINTS));
            point.position.map(|position| [position.x, position.y])
        })
        .collect();
    (points, is_closed)
}

/// Meaning and remedy of every reason, by who decides and by word.
fn reasons() -> Value {
    let mut all = Map::new();
    for row in explanations() {
        let words = all.entry(row.who).or_insert_with(|| json!({}));
        if let Some(words) = words.as_object_mut() {
            let text = json!({ "meaning": row.meaning, "remedy": row.remedy });
            words.insert(row.word.to_owned(), text);
        }
    }
    Value::Object(all)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may fail")]
mod tests {
    use singletrack_pilot::Reason;

    use super::*;
    use crate::config::{ReferenceSection, Start};

    fn example() -> Config {
        Config::from_toml(include_str!("../../../daemon/singletrackd.example.toml")).unwrap()
    }

    #[test]
    fn the_path_of_a_circle_is_the_circle() {
        let mut config = example();
        config.reference = ReferenceSection::Circle {
            radius_m: 0.7,
            angular_velocity_rad_s: -0.4,
            centre_m: [0.1, -0.2],
            start: Start::Beginning,
        };
        let setup = setup(3, &config);
        assert_eq!(setup["configuration"], 3);
        let points: Vec<[f64; 2]> =
            serde_json::from_value(setup["reference"]["points_m"].clone()).unwrap();
        assert_eq!(points.len(), POINTS as usize + 1);
        for [x, y] in &points {
            assert!((libm::hypot(x - 0.1, y + 0.2) - 0.7).abs() < 1e-12);
        }
        let ([x, y], [end_x, end_y]) = (points[0], points[POINTS as usize]);
        assert!(libm::hypot(x - end_x, y - end_y) < 1e-9, "it closes");
        assert_eq!(setup["reference"]["closed"], true);
    }

    #[test]
    fn a_reference_without_places_has_no_path() {
        for toml in [
            "kind = \"external\"",
            "kind = \"velocity-steps\"\nsteps = [{duration_s = 1.0, v_x_m_s = 0.3, v_y_m_s = 0.0}]",
        ] {
            let mut config = example();
            config.reference = toml::from_str(toml).unwrap();
            assert_eq!(
                setup(1, &config)["reference"]["points_m"],
                json!([]),
                "{toml}"
            );
        }
    }

    #[test]
    fn every_reason_of_the_host_has_a_meaning_and_a_remedy() {
        let reasons = reasons();
        for reason in Reason::ALL {
            let text = &reasons["host"][reason.name()];
            for part in ["meaning", "remedy"] {
                assert!(
                    text[part].as_str().is_some_and(|text| !text.is_empty()),
                    "{reason}"
                );
            }
        }
    }
}
