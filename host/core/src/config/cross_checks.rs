//! Values of different sections that must agree.

use singletrack_control::GRAVITY;

use singletrack_pilot::REST;
use singletrack_settings::seconds;

use super::{Config, ConfigError, ReferenceSection, refuse_if};

/// From a disarm request to a disarmed board, ms: the request on the line, sent twice, the
/// board's next round, and the error of its clock.
const LINE_MS: u32 = 30;

/// Refuses values that contradict each other. Host and board must agree on what the car does.
pub(super) fn validate(config: &Config) -> Result<(), ConfigError> {
    let (limits, board) = (&config.limits, &config.board);
    let (control, watch) = (&config.control, &config.watch);
    let obeyed = |mm_s: u16, key: &str| {
        let fastest = f64::from(mm_s) / 1_000.0;
        let fix = format!("the board obeys at most {fastest} m/s; lower it, or raise {key}");
        (fastest, fix)
    };
    let (fastest, fix) = obeyed(board.speed.max_forward_mm_s, "board.speed.max_forward_mm_s");
    at_most("limits.max_speed_m_s", limits.max_speed_m_s, fastest, fix)?;
    let (fastest, fix) = obeyed(board.speed.max_reverse_mm_s, "board.speed.max_reverse_mm_s");
    let reverse = limits.max_reverse_speed_m_s;
    at_most("limits.max_reverse_speed_m_s", reverse, fastest, fix)?;
    let servo = &board.servo;
    let room_us = (servo.max_us.saturating_sub(servo.centre_us))
        .min(servo.centre_us.saturating_sub(servo.min_us));
    let (reach_rad, fix) = match config.steering_map()?.table {
        None => (
            f64::from(room_us) / f64::from(servo.gain_us_per_rad).abs(),
            "widen board.servo.min_us and max_us",
        ),
        Some(table) => {
            let [right, left] = table.reach();
            (left.min(-right), "correct actuators.steering_table")
        }
    };
    let fix = format!("the servo's pulses reach {reach_rad:.3} rad; lower it, or {fix}");
    let steering = limits.max_steering_rad;
    at_most("limits.max_steering_rad", steering, reach_rad, fix)?;
    let (pose, fastest) = (&config.motion_capture.pose, limits.max_speed_m_s);
    let (key, accepted) = ("motion_capture.pose.max_speed_m_s", pose.max_speed_m_s);
    let fix = format!(
        "poses of a car at limits.max_speed_m_s, {fastest} m/s, would be refused; raise it"
    );
    refuse_if(accepted <= fastest, key, accepted, fix)?;
    let (gap_ms, two_ms) = (watch.max_gap_ms, 2 * control.period_ms);
    let fix = format!(
        "every tick would be late: give it two periods, {two_ms} ms, or lower control.period_ms"
    );
    refuse_if(gap_ms < two_ms, "watch.max_gap_ms", gap_ms, fix)?;
    let (missed, ticks_per_s) = (watch.max_missed_ticks_per_s, 1_000 / control.period_ms);
    let fix = format!(
        "with control.period_ms = {} there are {ticks_per_s} ticks in a second; lower it",
        control.period_ms
    );
    let key = "watch.max_missed_ticks_per_s";
    refuse_if(missed >= ticks_per_s, key, missed, fix)?;
    let grip = config.vehicle.friction * GRAVITY;
    let lateral = limits.max_lateral_acceleration_m_s2;
    let fix = format!(
        "the tyres hold {grip:.2} m/s2 (vehicle.friction times gravity); lower it to that at most"
    );
    at_most("limits.max_lateral_acceleration_m_s2", lateral, grip, fix)?;
    let esc = board.configuration().esc;
    let edge_us = esc.neutral_us.saturating_add(esc.deadband_us);
    let fix = format!(
        "the wheels turn beyond {edge_us} us only (neutral_us and deadband_us): the car would \
         never drive"
    );
    refuse_if(esc.max_us <= edge_us, "board.esc.max_us", esc.max_us, fix)?;
    path_within_limits(config)?;
    let [low, high] = pose.height_m.unwrap_or_default();
    let fix = format!("the band ends at {high} m; give the lower value first");
    at_most("motion_capture.pose.height_m", low, high, fix)?;
    let disarmed_ms = disarmed_ms(config, limits.max_speed_m_s);
    let is_late = disarmed_ms > f64::from(board.max_pose_age_ms) + ROUNDING;
    let fix = format!(
        "the host holds a lost pose for supervisor.hold_ms or hold_distance_m, stops from \
         limits.max_speed_m_s and disarms within {disarmed_ms:.0} ms, and must be first; raise it \
         (up to 1000), shorten the hold, lower the speed or brake harder; with 1000 ms this \
         braking (control.stop_deceleration_m_s2) allows {:.2} m/s",
        config.fastest_stopped_m_s()
    );
    refuse_if(is_late, "board.max_pose_age_ms", board.max_pose_age_ms, fix)?;
    let ramp = control.stop_deceleration_m_s2;
    let fix = format!(
        "a stop is commanded with control.stop_deceleration_m_s2 = {ramp} m/s2, so the car does \
         not slow down faster; lower it, or raise that"
    );
    at_most("fence.braking_m_s2", config.fence.braking_m_s2, ramp, fix)
}

/// Refuses a path whose speed profile goes beyond what the controller lets the car do.
fn path_within_limits(config: &Config) -> Result<(), ConfigError> {
    let ReferenceSection::Path {
        speed_m_s,
        lateral_acceleration_m_s2,
        acceleration_m_s2,
        ..
    } = config.reference
    else {
        return Ok(());
    };
    let limits = &config.limits;
    let lateral = limits.max_lateral_acceleration_m_s2;
    let less = |limit: &str, most: f64| {
        format!("limits.{limit} is {most}; lower it to that at most, better to less")
    };
    let fix = less("max_speed_m_s", limits.max_speed_m_s);
    at_most("reference.speed_m_s", speed_m_s, limits.max_speed_m_s, fix)?;
    let fix = less("max_lateral_acceleration_m_s2", lateral);
    let key = "reference.lateral_acceleration_m_s2";
    at_most(key, lateral_acceleration_m_s2, lateral, fix)?;
    let most = limits.max_acceleration_m_s2;
    let fix = less("max_acceleration_m_s2", most);
    at_most("reference.acceleration_m_s2", acceleration_m_s2, most, fix)
}

/// What rounding adds to a time in ms.
const ROUNDING: f64 = 1e-6;

/// The longest `board.max_pose_age_ms`.
const LONGEST_POSE_AGE_MS: f64 = 1_000.0;

/// The largest `limits.max_speed_m_s`; a speed is found to this part of it: 2 to the power of this.
const FASTEST: f64 = 20.0;
const HALVES: u32 = 50;

/// The age of the last pose, in s, at which the host disarms the board whatever the car does:
/// one tick later the request would come too late.
pub(super) fn disarm_age(config: &Config) -> f64 {
    let age_ms = u32::from(config.board.max_pose_age_ms);
    seconds(age_ms.saturating_sub(LINE_MS + config.control.period_ms))
}

/// The age of the last pose, in ms, at which a car without markers is disarmed at the latest, from
/// any speed up to `max_speed` (m/s).
fn disarmed_ms(config: &Config, max_speed: f64) -> f64 {
    1_000.0 * (longest_blind_drive(config, max_speed) + seconds(LINE_MS))
}

impl Config {
    /// The highest `limits.max_speed_m_s` that the configured braking allows, in m/s, rounded down
    /// to cm/s: without a pose, the host holds, stops (`control.stop_deceleration_m_s2`) and disarms
    /// the car within the longest `board.max_pose_age_ms`, a second.
    pub fn fastest_stopped_m_s(&self) -> f64 {
        let (mut in_time, mut late) = (0.0, FASTEST);
        for _ in 0..HALVES {
            let middle = 0.5 * (in_time + late);
            if disarmed_ms(self, middle) <= LONGEST_POSE_AGE_MS + ROUNDING {
                in_time = middle;
            } else {
                late = middle;
            }
        }
        (100.0 * in_time + ROUNDING).floor() / 100.0
    }
}

/// The age of the last pose, in s, at which the disarm request of a car without markers is
/// written at the latest, from any speed up to `max_speed` (m/s).
///
/// Ticks are a period apart, so each age is noticed up to a period late. The ramp begins in
/// the tick that notices. A stop for good begins to rest in the tick after its command to
/// stand, and rests for whole ticks.
fn longest_blind_drive(config: &Config, max_speed: f64) -> f64 {
    let period = seconds(config.control.period_ms);
    let deceleration = config.control.stop_deceleration_m_s2;
    let supervisor = config.supervisor.config();
    let (hold, hold_distance) = (supervisor.hold, supervisor.hold_distance);
    // At a speed v the pose is held for min(hold, distance/v), then the speed ramps down for
    // v/deceleration. That has its highest value where the two budgets meet, or at the highest
    // speed.
    let both = (hold_distance / hold).min(max_speed);
    let ramp_ends = [both, max_speed]
        .map(|speed| hold.min(hold_distance / speed) + period + speed / deceleration)
        .into_iter()
        .fold(0.0, f64::max);
    // A car that has slowed down to a stop waits for this long.
    let stops = ramp_ends.max(supervisor.blind + period);
    stops + period + (REST / period - 1e-9).ceil() * period
}

/// Refuses a value above `most`.
fn at_most(key: &'static str, value: f64, most: f64, fix: String) -> Result<(), ConfigError> {
    refuse_if(value > most, key, value, fix)
}
