//! `[supervisor]`: when the car may drive, and when it must stop.

use serde::{Deserialize, Serialize};
use singletrack_control::SupervisorConfig;

use super::{ConfigError, check};

/// When to stop.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SupervisorSection {
    /// A pose older than this stops the car.
    pub hold_ms: u32,
    /// A pose must be younger than this to arm.
    pub fresh_ms: u32,
    /// No inertial sample for this long stops the car.
    pub imu_silence_ms: u32,
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
}

impl Default for SupervisorSection {
    fn default() -> Self {
        let config = SupervisorConfig::paper();
        // Times in a configuration are a few seconds at most.
        let milliseconds = |seconds: f64| (seconds * 1_000.0).round() as u32;
        Self {
            hold_ms: milliseconds(config.hold),
            fresh_ms: milliseconds(config.fresh),
            imu_silence_ms: milliseconds(config.imu_silence),
            arm_timeout_ms: milliseconds(config.arm_timeout),
            settling_poses: config.settling_poses,
            max_implausible_poses: config.max_implausible,
            stop_timeout_ms: milliseconds(config.stop_timeout),
            standing_speed_m_s: config.standing_speed,
        }
    }
}

impl SupervisorSection {
    /// For the controller.
    #[must_use]
    pub fn config(&self) -> SupervisorConfig {
        SupervisorConfig {
            hold: check::seconds(self.hold_ms),
            fresh: check::seconds(self.fresh_ms),
            imu_silence: check::seconds(self.imu_silence_ms),
            arm_timeout: check::seconds(self.arm_timeout_ms),
            settling_poses: self.settling_poses,
            max_implausible: self.max_implausible_poses,
            stop_timeout: check::seconds(self.stop_timeout_ms),
            standing_speed: self.standing_speed_m_s,
        }
    }

    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        for (key, value, range) in [
            ("supervisor.hold_ms", self.hold_ms, 20..=900),
            ("supervisor.fresh_ms", self.fresh_ms, 10..=self.hold_ms),
            ("supervisor.imu_silence_ms", self.imu_silence_ms, 20..=500),
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
        check::positive(
            "supervisor.standing_speed_m_s",
            self.standing_speed_m_s,
            0.2,
        )
    }
}
