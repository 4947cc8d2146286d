//! `[supervisor]`: when the car may drive, and when it must stop.

use serde::{Deserialize, Serialize};
use singletrack_pilot::SupervisorConfig;

use super::{ConfigError, check};

/// When to stop.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SupervisorSection {
    /// For so long after its mid-exposure a pose may be held; then the car slows
    /// down.
    pub hold_ms: u32,
    /// And for so far.
    pub hold_distance_m: f64,
    /// Blind for longer, a car that slows down stops for good.
    pub blind_ms: u32,
    /// And having gone farther.
    pub blind_distance_m: f64,
    /// A pose must be younger than this to arm, and for a slowing car to drive on.
    pub fresh_ms: u32,
    /// No inertial sample for this long stops the car.
    pub imu_silence_ms: u32,
    /// To arm, the yaw rate must have been below this for 0.2 s...
    pub still_yaw_rate_rad_s: f64,
    /// ...and the acceleration below this.
    pub still_acceleration_m_s2: f64,
    /// How long the board may take to arm.
    pub arm_timeout_ms: u32,
    /// Poses that the estimate needs to settle.
    pub settling_poses: u32,
    /// This many implausible poses in a row stop the car.
    pub max_implausible_poses: u32,
    /// Slowing down may take this long; then the board is disarmed anyway.
    pub stop_timeout_ms: u32,
    /// Below this speed the car stands.
    pub standing_speed_m_s: f64,
    /// A battery below this ends a drive; 0 does not look.
    pub min_battery_v: f64,
    /// A battery must be above this to arm; 0 does not look.
    pub arm_battery_v: f64,
    /// More than this part of the frames damaged over a second, either way, ends
    /// a drive.
    pub max_damaged_frames: f64,
    /// Whether the car is only driven in real time.
    pub require_real_time: bool,
}

impl Default for SupervisorSection {
    fn default() -> Self {
        let config = SupervisorConfig::paper();
        // Times in a configuration are a few seconds at most.
        let milliseconds = |seconds: f64| (seconds * 1_000.0).round() as u32;
        Self {
            hold_ms: milliseconds(config.hold),
            hold_distance_m: config.hold_distance,
            blind_ms: milliseconds(config.blind),
            blind_distance_m: config.blind_distance,
            fresh_ms: milliseconds(config.fresh),
            imu_silence_ms: milliseconds(config.imu_silence),
            still_yaw_rate_rad_s: config.still_yaw_rate,
            still_acceleration_m_s2: config.still_acceleration,
            arm_timeout_ms: milliseconds(config.arm_timeout),
            settling_poses: config.settling_poses,
            max_implausible_poses: config.max_implausible,
            stop_timeout_ms: milliseconds(config.stop_timeout),
            standing_speed_m_s: config.standing_speed,
            min_battery_v: config.min_battery,
            arm_battery_v: config.arm_battery,
            max_damaged_frames: config.max_damaged,
            require_real_time: config.require_real_time,
        }
    }
}

impl SupervisorSection {
    /// For the controller.
    #[must_use]
    pub fn config(&self) -> SupervisorConfig {
        SupervisorConfig {
            hold: check::seconds(self.hold_ms),
            hold_distance: self.hold_distance_m,
            blind: check::seconds(self.blind_ms),
            blind_distance: self.blind_distance_m,
            fresh: check::seconds(self.fresh_ms),
            imu_silence: check::seconds(self.imu_silence_ms),
            still_yaw_rate: self.still_yaw_rate_rad_s,
            still_acceleration: self.still_acceleration_m_s2,
            arm_timeout: check::seconds(self.arm_timeout_ms),
            settling_poses: self.settling_poses,
            max_implausible: self.max_implausible_poses,
            stop_timeout: check::seconds(self.stop_timeout_ms),
            standing_speed: self.standing_speed_m_s,
            min_battery: self.min_battery_v,
            arm_battery: self.arm_battery_v,
            max_damaged: self.max_damaged_frames,
            require_real_time: self.require_real_time,
        }
    }

    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        for (key, value, range) in [
            ("supervisor.hold_ms", self.hold_ms, 20..=900),
            ("supervisor.blind_ms", self.blind_ms, self.hold_ms..=950),
            ("supervisor.fresh_ms", self.fresh_ms, 10..=self.hold_ms),
            // The estimator bridges 200 ms.
            ("supervisor.imu_silence_ms", self.imu_silence_ms, 20..=200),
            ("supervisor.arm_timeout_ms", self.arm_timeout_ms, 50..=5_000),
            ("supervisor.settling_poses", self.settling_poses, 1..=10_000),
            (
                "supervisor.max_implausible_poses",
                self.max_implausible_poses,
                1..=100,
            ),
            (
                "supervisor.stop_timeout_ms",
                self.stop_timeout_ms,
                100..=1_700,
            ),
        ] {
            check::within(key, value, range)?;
        }
        check::positive("supervisor.hold_distance_m", self.hold_distance_m, 1.0)?;
        check::within(
            "supervisor.blind_distance_m",
            self.blind_distance_m,
            self.hold_distance_m..=2.0,
        )?;
        check::positive(
            "supervisor.still_yaw_rate_rad_s",
            self.still_yaw_rate_rad_s,
            1.0,
        )?;
        check::positive(
            "supervisor.still_acceleration_m_s2",
            self.still_acceleration_m_s2,
            5.0,
        )?;
        check::positive(
            "supervisor.standing_speed_m_s",
            self.standing_speed_m_s,
            0.2,
        )?;
        check::within("supervisor.min_battery_v", self.min_battery_v, 0.0..=60.0)?;
        check::within(
            "supervisor.arm_battery_v",
            self.arm_battery_v,
            self.min_battery_v..=60.0,
        )?;
        check::positive(
            "supervisor.max_damaged_frames",
            self.max_damaged_frames,
            1.0,
        )
    }

    /// How long after the mid-exposure of its last pose a car may be driven, in
    /// s, that is limited to `max_speed` (m/s) and brakes with `deceleration`
    /// (m/s²).
    ///
    /// At a speed v the pose is held for min(hold, distance/v), then the speed
    /// ramps down for v/deceleration. That has its highest value where the two
    /// budgets meet, or at the highest speed.
    pub(super) fn longest_blind_drive(&self, max_speed: f64, deceleration: f64) -> f64 {
        let config = self.config();
        let both = (config.hold_distance / config.hold).min(max_speed);
        [both, max_speed]
            .map(|speed| config.hold.min(config.hold_distance / speed) + speed / deceleration)
            .into_iter()
            // A car that has slowed down to a stop waits for so long.
            .fold(config.blind, f64::max)
    }
}
