//! Values of different sections that must agree.

use core::fmt::Display;

use singletrack_control::GRAVITY;

use super::{Config, ConfigError};

/// From the command to stand to a disarmed board, s: the supervisor's rest, a tick, and the
/// request on the line, sent twice.
const REST_S: f64 = 0.15;

/// Refuses values that contradict each other. Host and board must agree on what the car does.
pub(super) fn validate(config: &Config) -> Result<(), ConfigError> {
    let Config {
        limits,
        board,
        supervisor,
        control,
        watch,
        ..
    } = config;
    let fastest = f64::from(board.speed.max_forward_mm_s) / 1_000.0;
    refuse_if(
        limits.max_speed_m_s > fastest,
        "limits.max_speed_m_s",
        limits.max_speed_m_s,
        format!(
            "the board obeys at most {fastest} m/s; lower it, or raise board.speed.max_forward_mm_s"
        ),
    )?;
    let fastest = f64::from(board.speed.max_reverse_mm_s) / 1_000.0;
    refuse_if(
        limits.max_reverse_speed_m_s > fastest,
        "limits.max_reverse_speed_m_s",
        limits.max_reverse_speed_m_s,
        format!(
            "the board obeys at most {fastest} m/s; lower it, or raise board.speed.max_reverse_mm_s"
        ),
    )?;
    let servo = &board.servo;
    let room_us = (servo.max_us.saturating_sub(servo.centre_us))
        .min(servo.centre_us.saturating_sub(servo.min_us));
    let reach_rad = f64::from(room_us) / f64::from(servo.gain_us_per_rad).abs();
    refuse_if(
        limits.max_steering_rad > reach_rad,
        "limits.max_steering_rad",
        limits.max_steering_rad,
        format!(
            "the servo's pulses reach {reach_rad:.3} rad; lower it, or widen board.servo.min_us and max_us"
        ),
    )?;
    let pose = &config.motion_capture.pose;
    refuse_if(
        pose.max_speed_m_s <= limits.max_speed_m_s,
        "motion_capture.pose.max_speed_m_s",
        pose.max_speed_m_s,
        format!(
            "poses of a car at limits.max_speed_m_s, {} m/s, would be refused; raise it",
            limits.max_speed_m_s
        ),
    )?;
    refuse_if(
        watch.max_gap_ms < 2 * control.period_ms,
        "watch.max_gap_ms",
        watch.max_gap_ms,
        format!(
            "every tick would be late: give it two periods, {} ms, or lower control.period_ms",
            2 * control.period_ms
        ),
    )?;
    let ticks_per_s = 1_000 / control.period_ms;
    refuse_if(
        watch.max_missed_ticks_per_s >= ticks_per_s,
        "watch.max_missed_ticks_per_s",
        watch.max_missed_ticks_per_s,
        format!(
            "with control.period_ms = {} there are {ticks_per_s} ticks in a second; lower it",
            control.period_ms
        ),
    )?;
    let grip = config.vehicle.friction * GRAVITY;
    refuse_if(
        limits.max_lateral_acceleration_m_s2 > grip,
        "limits.max_lateral_acceleration_m_s2",
        limits.max_lateral_acceleration_m_s2,
        format!(
            "the tyres hold {grip:.2} m/s2 (vehicle.friction times gravity); lower it to that at most"
        ),
    )?;
    let blind_s =
        supervisor.longest_blind_drive(limits.max_speed_m_s, control.stop_deceleration_m_s2);
    let blind_ms = 1_000.0 * (blind_s + REST_S);
    refuse_if(
        blind_ms > f64::from(board.max_pose_age_ms),
        "board.max_pose_age_ms",
        board.max_pose_age_ms,
        format!(
            "the host holds a lost pose for supervisor.hold_ms or hold_distance_m, stops from \
             limits.max_speed_m_s and disarms within {blind_ms:.0} ms, and must be first; raise it \
             (up to 1000), shorten the hold, lower the speed or brake harder"
        ),
    )
}

fn refuse_if(
    is_wrong: bool,
    key: &'static str,
    value: impl Display,
    fix: String,
) -> Result<(), ConfigError> {
    match is_wrong {
        true => Err(ConfigError::value(key, value, fix)),
        false => Ok(()),
    }
}
