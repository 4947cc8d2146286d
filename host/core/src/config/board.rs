//! `[board]`: what the board must know of the car that it is built into.
//!
//! Calibration has no default: a wrong sign steers the car the wrong way.

use serde::{Deserialize, Serialize};
use singletrack_protocol::{
    Configuration, EscCalibration, FailsafeAction, ServoCalibration, SpeedLoop,
};

/// What the board is given, in the wire's units.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BoardSection {
    /// What the ESC is given when the board stops the car by itself.
    #[serde(default = "default_failsafe")]
    pub failsafe: FailsafeKind,
    /// Oldest pose that the board obeys; at least the time that the host needs
    /// to hold and to stop.
    #[serde(default = "default_max_pose_age")]
    pub max_pose_age_ms: u16,
    /// Whether a normally-closed stop switch is wired.
    #[serde(default)]
    pub stop_input: bool,
    /// The steering servo.
    pub servo: ServoSection,
    /// The electronic speed controller.
    pub esc: EscSection,
    /// The speed loop.
    pub speed: SpeedSection,
}

/// What the ESC is given when the board stops the car by itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FailsafeKind {
    /// Neutral.
    Coast,
    /// The braking pulse until the wheels stand, then neutral.
    Brake,
}

fn default_failsafe() -> FailsafeKind {
    FailsafeKind::Coast
}

fn default_max_pose_age() -> u16 {
    950
}

/// 6 rad/s with the paper's servo.
fn default_servo_slew() -> u16 {
    96
}

fn default_esc_slew() -> u16 {
    40
}

/// The steering servo.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ServoSection {
    /// Pulse that steers straight on.
    pub centre_us: u16,
    /// Pulse change for one radian to the left; negative when the servo is
    /// mounted the other way round.
    pub gain_us_per_rad: i16,
    /// Shortest pulse ever sent.
    pub min_us: u16,
    /// Longest pulse ever sent.
    pub max_us: u16,
    /// Largest change of the pulse in 20 ms.
    #[serde(default = "default_servo_slew")]
    pub slew_us_per_20ms: u16,
}

/// The electronic speed controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EscSection {
    /// Pulse at which the motor is free.
    pub neutral_us: u16,
    /// Half width of the band around neutral in which the motor does not turn.
    pub deadband_us: u16,
    /// Shortest pulse ever sent.
    pub min_us: u16,
    /// Longest pulse ever sent.
    pub max_us: u16,
    /// Largest change of the pulse away from neutral in 20 ms.
    #[serde(default = "default_esc_slew")]
    pub slew_us_per_20ms: u16,
    /// Pulse that brakes.
    pub brake_us: u16,
}

/// The speed loop that the board closes on the motor pulses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SpeedSection {
    /// Distance that the car rolls in one motor pulse.
    pub pulse_distance_um: u16,
    /// Feed-forward gain.
    pub feed_forward_us_per_m_s: u16,
    /// Proportional gain.
    pub proportional_us_per_m_s: u16,
    /// Integral gain.
    pub integral_us_per_m: u16,
    /// Limit of the integral term.
    pub integral_limit_us: u16,
    /// Fastest forward speed that the board obeys.
    pub max_forward_mm_s: u16,
    /// Fastest reverse speed that the board obeys; 0 refuses reverse.
    #[serde(default)]
    pub max_reverse_mm_s: u16,
}

impl BoardSection {
    /// As it is sent.
    #[must_use]
    pub const fn configuration(&self) -> Configuration {
        let Self {
            servo, esc, speed, ..
        } = self;
        Configuration {
            servo: ServoCalibration {
                centre_us: servo.centre_us,
                gain_us_per_rad: servo.gain_us_per_rad,
                min_us: servo.min_us,
                max_us: servo.max_us,
                slew_us_per_20ms: servo.slew_us_per_20ms,
            },
            esc: EscCalibration {
                neutral_us: esc.neutral_us,
                deadband_us: esc.deadband_us,
                min_us: esc.min_us,
                max_us: esc.max_us,
                slew_us_per_20ms: esc.slew_us_per_20ms,
                brake_us: esc.brake_us,
            },
            speed: SpeedLoop {
                pulse_distance_um: speed.pulse_distance_um,
                feed_forward_us_per_m_s: speed.feed_forward_us_per_m_s,
                proportional_us_per_m_s: speed.proportional_us_per_m_s,
                integral_us_per_m: speed.integral_us_per_m,
                integral_limit_us: speed.integral_limit_us,
                max_forward_mm_s: speed.max_forward_mm_s,
                max_reverse_mm_s: speed.max_reverse_mm_s,
            },
            failsafe: match self.failsafe {
                FailsafeKind::Coast => FailsafeAction::Coast,
                FailsafeKind::Brake => FailsafeAction::Brake,
            },
            max_pose_age_ms: self.max_pose_age_ms,
            stop_input: self.stop_input,
        }
    }
}

impl From<&Configuration> for BoardSection {
    fn from(configuration: &Configuration) -> Self {
        let Configuration {
            servo,
            esc,
            speed,
            failsafe,
            max_pose_age_ms,
            stop_input,
        } = configuration;
        Self {
            failsafe: match failsafe {
                FailsafeAction::Coast => FailsafeKind::Coast,
                FailsafeAction::Brake => FailsafeKind::Brake,
            },
            max_pose_age_ms: *max_pose_age_ms,
            stop_input: *stop_input,
            servo: ServoSection {
                centre_us: servo.centre_us,
                gain_us_per_rad: servo.gain_us_per_rad,
                min_us: servo.min_us,
                max_us: servo.max_us,
                slew_us_per_20ms: servo.slew_us_per_20ms,
            },
            esc: EscSection {
                neutral_us: esc.neutral_us,
                deadband_us: esc.deadband_us,
                min_us: esc.min_us,
                max_us: esc.max_us,
                slew_us_per_20ms: esc.slew_us_per_20ms,
                brake_us: esc.brake_us,
            },
            speed: SpeedSection {
                pulse_distance_um: speed.pulse_distance_um,
                feed_forward_us_per_m_s: speed.feed_forward_us_per_m_s,
                proportional_us_per_m_s: speed.proportional_us_per_m_s,
                integral_us_per_m: speed.integral_us_per_m,
                integral_limit_us: speed.integral_limit_us,
                max_forward_mm_s: speed.max_forward_mm_s,
                max_reverse_mm_s: speed.max_reverse_mm_s,
            },
        }
    }
}
