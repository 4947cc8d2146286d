//! The battery: voltage drop under load, and slow discharge.

use serde::{Deserialize, Serialize};

/// A two-cell battery.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BatteryParameters {
    /// Voltage without load at the start, in V.
    pub start_v: f64,
    /// Voltage for which the motor's gain is specified, in V.
    pub nominal_v: f64,
    /// Internal resistance, in Ω.
    pub resistance_ohm: f64,
    /// Current of the electronics, in A.
    pub idle_a: f64,
    /// Motor current per m/s² of driven acceleration, in A.
    pub motor_a_per_m_s2: f64,
    /// Motor current per m/s of speed, in A.
    pub motor_a_per_m_s: f64,
    /// Voltage drop per ampere-hour drawn, in V.
    pub fall_v_per_ah: f64,
    /// Standard deviation of the measured voltage, in V.
    pub noise_v: f64,
    /// Voltage that supplies the board's processor and is its converter's reference, in
    /// V; USB is between 4.4 and 5.25.
    pub supply_v: f64,
    /// The divider is not connected: the board's input floats.
    pub divider_open: bool,
    /// Begin of a dip of the ESC's own supply (BEC), which feeds servo and IMU, in s.
    /// Without it the wheels keep their angle and the IMU restarts.
    pub dip_at_s: Option<f64>,
    /// Duration of the dip, in ms.
    pub dip_ms: f64,
    /// Voltage of the battery during the dip, in V; it stays as it is if left out.
    pub dip_v: Option<f64>,
}

impl Default for BatteryParameters {
    fn default() -> Self {
        Self {
            start_v: 7.9,
            nominal_v: 7.4,
            resistance_ohm: 0.05,
            idle_a: 0.6,
            motor_a_per_m_s2: 2.0,
            motor_a_per_m_s: 2.5,
            fall_v_per_ah: 0.5,
            noise_v: 0.01,
            supply_v: 5.0,
            divider_open: false,
            dip_at_s: None,
            dip_ms: 150.0,
            dip_v: None,
        }
    }
}

/// The battery's charge.
#[derive(Clone, Debug, Default)]
pub(crate) struct Battery {
    drawn_ah: f64,
    current_a: f64,
    /// A dip is underway.
    dips: bool,
    is_unplugged: bool,
}

impl Battery {
    /// Draws the charge of this motion over `seconds`.
    pub(crate) fn draw(
        &mut self,
        p: &BatteryParameters,
        driven: bool,
        speed: f64,
        acceleration: f64,
        seconds: f64,
    ) {
        self.current_a = p.idle_a;
        if driven {
            self.current_a += p.motor_a_per_m_s * speed.abs()
                + p.motor_a_per_m_s2 * (acceleration * speed.signum()).max(0.0);
        }
        self.drawn_ah += self.current_a * seconds / 3600.0;
    }

    /// Draws a charge, in Ah.
    pub(crate) fn drain(&mut self, charge_ah: f64) {
        self.drawn_ah += charge_ah;
    }

    /// Begins or ends a dip.
    pub(crate) const fn set_dip(&mut self, dips: bool) {
        self.dips = dips;
    }

    /// Unplugs the battery, or plugs it in.
    pub(crate) const fn set_plugged(&mut self, plugged: bool) {
        self.is_unplugged = !plugged;
    }

    pub(crate) const fn is_plugged(&self) -> bool {
        !self.is_unplugged
    }

    /// Voltage at the terminals, in V.
    pub(crate) fn voltage(&self, p: &BatteryParameters) -> f64 {
        if self.is_unplugged {
            return 0.0;
        }
        if let (true, Some(dip_v)) = (self.dips, p.dip_v) {
            return dip_v;
        }
        (p.start_v - p.fall_v_per_ah * self.drawn_ah - p.resistance_ohm * self.current_a).max(0.0)
    }
}
