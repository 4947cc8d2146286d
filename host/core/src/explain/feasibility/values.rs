//! Values that should be looked at by themselves: those of the example file, and those that no sane car
//! has. The latter are within the range of their keys: a bench may need them.

use singletrack_control::{GRAVITY, VehicleParameters};
use singletrack_settings::Section;

use super::Finding;
use crate::config::{
    Config, EXAMPLE_SERVER, LawKind, OuterLoopSection, SECTIONS, scaled_paper, value_at,
};

/// The limit of a watch or a gate over its default beyond which it sees little.
const WIDE: f64 = 5.0;

/// P that is nearer than the car drives in this time, in s, swings with the lag of any servo.
const NEAR_S: f64 = 0.03;

/// A higher gain of the position loop acts faster than servo, motor and cameras, per second.
const HIGH_GAIN: f64 = 10.0;

/// Stamps of the cameras are not wrong by more, in ms: a frame of the slowest.
const STAMPS_MS: f64 = 50.0;

/// No room with cameras is larger, in m.
const ROOM_M: f64 = 100.0;

/// Values that were left as they are in the example file.
pub(super) fn warn_of_examples(config: &Config, findings: &mut Vec<Finding>) {
    if config.motion_capture.server == EXAMPLE_SERVER {
        let (key, value) = ("motion_capture.server", config.motion_capture.server);
        let fix =
            "this is the example's address; give that of the computer that runs the motion capture";
        findings.push(Finding::warning(key, value, fix));
    }
    warn_of_left_out(&config.vehicle, findings);
    if is_example(config, "fence") {
        let (key, value) = ("fence.braking_m_s2", config.fence.braking_m_s2);
        let fix = "this is the example's; let your car roll out and measure it: the fence and the \
                   watch of every stop rest on it";
        findings.push(Finding::warning(key, value, fix));
    }
    for (key, fix) in [
        (
            "board.servo",
            "centre, gain and end stops are those of the simulated car; measure yours with the \
             wheels off the ground: a wrong sign steers the wrong way",
        ),
        (
            "board.esc",
            "the pulses are those of the simulated car; measure yours with the wheels off the \
             ground: with another neutral an unarmed car may drive",
        ),
        (
            "board.speed",
            "pulse distance and gains are those of the simulated car; roll yours over a known \
             distance and count the pulses",
        ),
    ] {
        if is_example(config, key) {
            findings.push(Finding::warning(key, "the example's", fix));
        }
    }
}

/// The whole car, or what follows from its axles because it is left out.
fn warn_of_left_out(vehicle: &VehicleParameters, findings: &mut Vec<Finding>) {
    if *vehicle == VehicleParameters::paper() {
        let fix = "the section is left out; give front_axle_distance_m and rear_axle_distance_m of \
                   your car";
        findings.push(Finding::warning("vehicle", "the paper's car", fix));
        return;
    }
    let scaled = scaled_paper(vehicle.front_axle_distance_m, vehicle.rear_axle_distance_m);
    if vehicle.mass_kg == scaled.mass_kg {
        let mass_kg = format!("{:.2}", vehicle.mass_kg);
        let fix = "left out, and scaled from the paper's car to this wheelbase, as are inertia and \
                   tyres that are left out; the law needs only the axles, but weigh the car and \
                   identify its tyres before you drive near the limits";
        findings.push(Finding::warning("vehicle.mass_kg", mass_kg, fix));
    }
}

/// Whether every value of the section that has an example is that example.
fn is_example(config: &Config, section: &str) -> bool {
    section_of(config, section).is_some_and(|(section, written)| {
        let mut keys = section.keys.iter();
        keys.all(|key| {
            (key.example)().is_none_or(|example| written.get(key.name) == Some(&example))
        })
    })
}

/// Finds what should be looked at, and braking beyond the tyres, which is impossible.
pub fn warn_of_unusual(config: &Config, findings: &mut Vec<Finding>) {
    let grip = config.vehicle.friction * GRAVITY;
    let braking = config.fence.braking_m_s2;
    if braking > grip {
        let fix = format!(
            "no car brakes harder than its tyres hold, {grip:.2} m/s2 (vehicle.friction times \
             gravity); measure how yours brakes, or correct vehicle.friction"
        );
        findings.push(Finding::impossible("fence.braking_m_s2", braking, fix));
    }
    let mut warn = |key, value: String, fix: String| {
        findings.push(Finding::warning(key, value, fix));
    };
    let [width, depth] = extent(&config.fence.corners_m);
    if width.max(depth) > ROOM_M {
        let value = format!("{width:.0} m by {depth:.0} m");
        let fix = "no room is so large: the corners are in m, not in mm; or, if there is no fence, \
                   nothing keeps the car in";
        warn("fence.corners_m", value, fix.to_owned());
    }
    let speed = config.limits.max_speed_m_s;
    let stop_m = 0.5 * speed * speed / config.fence.braking_m_s2;
    if stop_m > width.min(depth) {
        let fix = format!(
            "a stop from there takes {stop_m:.1} m (fence.braking_m_s2), and the fence is {:.1} m \
             wide; lower it to what the room allows",
            width.min(depth)
        );
        warn("limits.max_speed_m_s", speed.to_string(), fix);
    }
    let deceleration = config.control.stop_deceleration_m_s2;
    if deceleration > grip {
        let key = "control.stop_deceleration_m_s2";
        let fix = format!(
            "the tyres hold {grip:.2} m/s2 (vehicle.friction times gravity): a stop that is \
             commanded faster slides"
        );
        warn(key, deceleration.to_string(), fix);
    }
    let distance = config.law.point_distance_m;
    if config.law.kind == LawKind::FrontPoint && distance < NEAR_S * speed {
        let fix = format!(
            "at limits.max_speed_m_s the car drives so far in {:.0} ms, in which no servo steers; \
             `singletrack stability least-p` computes the least",
            1e3 * distance / speed
        );
        warn("law.point_distance_m", distance.to_string(), fix);
    }
    if let OuterLoopSection::Proportional { gain_per_s, .. } = &config.outer_loop
        && gain_per_s.iter().any(|gain| *gain > HIGH_GAIN)
    {
        let fix = format!(
            "an error is to vanish faster than servo, motor and cameras act; beyond about \
             {HIGH_GAIN:.0} the car swings"
        );
        warn("outer_loop.gain_per_s", format!("{gain_per_s:?}"), fix);
    }
    let stamps = config.motion_capture.timing.stamp_offset_ms;
    if stamps.abs() > STAMPS_MS {
        let value = stamps.to_string();
        let fix = "no cameras stamp so wrongly: `singletrack doctor` measures it".to_owned();
        warn("motion_capture.timing.stamp_offset_ms", value, fix);
    }
    for section in ["watch", "motion_capture.pose"] {
        warn_of_wide(section, config, &mut warn);
    }
}

/// Warns of limits that let nearly everything pass.
fn warn_of_wide(
    name: &'static str,
    config: &Config,
    warn: &mut impl FnMut(&'static str, String, String),
) {
    let Some((section, values)) = section_of(config, name) else {
        return;
    };
    for key in section.keys {
        let number =
            |value: &toml::Value| value.as_float().or(value.as_integer().map(|n| n as f64));
        let value = values.get(key.name).and_then(number);
        let default = (key.default)().as_ref().and_then(number);
        if let (Some(value), Some(default)) = (value, default)
            && value > WIDE * default
        {
            let key = key.name;
            let fix = format!("the default is {default}; so wide a limit finds hardly any fault");
            warn(name, format!("{key} = {value}"), fix);
        }
    }
}

/// Width and depth of the rectangle around points.
fn extent(points: &[[f64; 2]]) -> [f64; 2] {
    let along = |axis: fn(&[f64; 2]) -> f64| {
        let values = points.iter().map(axis);
        let most = values.clone().fold(f64::NEG_INFINITY, f64::max);
        most - values.fold(f64::INFINITY, f64::min)
    };
    [along(|[x, _]| *x), along(|[_, y]| *y)]
}

/// The declaration of a section, and what is written in it.
fn section_of(config: &Config, name: &str) -> Option<(&'static Section, toml::Value)> {
    let section = SECTIONS.iter().find(|section| section.name == name)?;
    let whole = toml::Value::try_from(config).ok()?;
    let written = value_at(&whole, name)?.clone();
    Some((section, written))
}
