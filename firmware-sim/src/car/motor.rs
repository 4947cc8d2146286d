//! The electronic speed controller, the motor and the gears.

use serde::{Deserialize, Serialize};

/// Response of the drive train to the ESC's pulses.
///
/// Beyond the deadband the wheels settle at `gain · u / (1 + u / saturation)` times
/// the ratio of battery voltage to nominal voltage, with `u` the pulse beyond
/// deadband and breakaway. The speed loop must therefore compensate a curve, an
/// offset and a drift.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MotorParameters {
    /// Pulse without drive or brake, in µs.
    pub neutral_us: u16,
    /// Half width of the band around neutral without drive, in µs.
    pub deadband_us: u16,
    /// Further pulse needed before the wheels turn, in µs.
    pub breakaway_us: f64,
    /// Speed per µs of pulse near zero, in m/s per µs.
    pub gain_m_s_per_us: f64,
    /// Pulse at which half of the linear speed is reached, in µs.
    pub saturation_us: f64,
    /// Time constant of the first-order lag, in s.
    pub lag_s: f64,
    /// Time from the start of a pulse to the motor's response, in µs.
    pub dead_time_us: u64,
    /// Largest acceleration, in m/s².
    pub max_acceleration_m_s2: f64,
    /// Constant deceleration of the rolling car, in m/s².
    pub coasting_m_s2: f64,
    /// Deceleration of the rolling car per speed, in 1/s.
    pub viscous_per_s: f64,
    /// Braking per µs of pulse beyond the deadband, in m/s² per µs.
    pub brake_m_s2_per_us: f64,
    /// Largest braking, in m/s².
    pub max_brake_m_s2: f64,
    /// Whether a pulse below neutral drives in reverse after standstill and
    /// neutral; otherwise it only brakes.
    pub reverse: bool,
    /// Time at neutral after power-on before the ESC drives, in µs.
    pub arming_us: u64,
    /// Time without pulses after which the ESC releases the motor, in µs.
    pub signal_loss_us: u64,
}

impl Default for MotorParameters {
    fn default() -> Self {
        Self {
            neutral_us: 1500,
            // With the breakaway, 30 µs in which the wheels stand.
            deadband_us: 26,
            breakaway_us: 4.0,
            gain_m_s_per_us: 0.01,
            saturation_us: 400.0,
            lag_s: 0.08,
            dead_time_us: 20_000,
            max_acceleration_m_s2: 3.0,
            coasting_m_s2: 0.8,
            viscous_per_s: 1.0,
            brake_m_s2_per_us: 0.02,
            max_brake_m_s2: 3.0,
            reverse: true,
            arming_us: 1_000_000,
            signal_loss_us: 100_000,
        }
    }
}

/// Action of the ESC on the motor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Drive {
    /// No drive or brake.
    Free,
    /// Drives towards this wheel speed at nominal voltage, in m/s.
    Towards(f64),
    /// Brakes with this deceleration, in m/s².
    Brake(f64),
}

/// The ESC: arming, the brake-then-reverse rule, signal loss.
#[derive(Clone, Debug)]
pub(crate) struct SpeedController {
    neutral_since_us: Option<u64>,
    armed: bool,
    reverse_ready: bool,
    drive: Drive,
}

/// Wheels slower than this count as standing, in m/s.
const STANDING: f64 = 0.02;

impl SpeedController {
    pub(crate) const fn new() -> Self {
        Self {
            neutral_since_us: None,
            armed: false,
            reverse_ready: false,
            drive: Drive::Free,
        }
    }

    pub(crate) const fn drive(&self) -> Drive {
        self.drive
    }

    pub(crate) const fn is_armed(&self) -> bool {
        self.armed
    }

    /// Releases the motor after a loss of the signal.
    pub(crate) fn release(&mut self) {
        self.neutral_since_us = None;
        self.reverse_ready = false;
        self.drive = Drive::Free;
    }

    /// Processes a pulse at `now_us` with the wheels at `speed`.
    pub(crate) fn pulse(&mut self, p: &MotorParameters, pulse_us: u16, now_us: u64, speed: f64) {
        let deflection = f64::from(pulse_us) - f64::from(p.neutral_us);
        let beyond = deflection.abs() - f64::from(p.deadband_us);
        if beyond <= 0.0 {
            let since = *self.neutral_since_us.get_or_insert(now_us);
            self.armed |= now_us.saturating_sub(since) >= p.arming_us;
            self.reverse_ready = speed < STANDING;
            self.drive = Drive::Free;
            return;
        }
        self.neutral_since_us = None;
        self.reverse_ready &= deflection < 0.0;
        let driving = (beyond - p.breakaway_us).max(0.0);
        let settled = p.gain_m_s_per_us * driving / (1.0 + driving / p.saturation_us);
        self.drive = if !self.armed {
            Drive::Free
        } else if deflection > 0.0 {
            Drive::Towards(settled)
        } else if p.reverse && self.reverse_ready {
            Drive::Towards(-settled)
        } else {
            Drive::Brake((p.brake_m_s2_per_us * beyond).min(p.max_brake_m_s2))
        };
    }
}

impl MotorParameters {
    /// Acceleration of the wheels, in m/s²; `voltage_share` is the battery's
    /// voltage over the nominal one.
    pub(crate) fn acceleration(&self, drive: Drive, speed: f64, voltage_share: f64) -> f64 {
        // Friction is continuous over 5 mm/s, which the integrator requires.
        let direction = (speed / 0.005).clamp(-1.0, 1.0);
        let rolling = self.coasting_m_s2 * direction + self.viscous_per_s * speed;
        match drive {
            Drive::Towards(settled) => {
                let driven = (settled * voltage_share - speed) / self.lag_s;
                // A motor that turns faster than its target does not brake: the car rolls.
                if settled * direction >= 0.0 && driven * direction < -rolling.abs() {
                    -rolling
                } else {
                    driven.clamp(-self.max_acceleration_m_s2, self.max_acceleration_m_s2)
                }
            }
            Drive::Free => -rolling,
            Drive::Brake(brake) => -rolling - brake * direction,
        }
    }
}
