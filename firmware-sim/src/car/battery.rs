//! The battery: voltage drop under load, and slow discharge.

use singletrack_settings::section;

use crate::parameters::ranges::{NOT_NEGATIVE, POSITIVE};

section! {
    /// A two-cell battery.
    "car.battery" => pub BatteryParameters: Copy;
    [default];

    /// Voltage without load at the start, in V.
    start_v: f64 = 7.9;
    /// Voltage for which the motor's gain is specified, in V.
    nominal_v: f64 = 7.4, in POSITIVE;
    /// Internal resistance, in Ω.
    resistance_ohm: f64 = 0.05;
    /// Current of the electronics, in A.
    idle_a: f64 = 0.6;
    /// Motor current per m/s² of driven acceleration, in A.
    motor_a_per_m_s2: f64 = 2.0;
    /// Motor current per m/s of speed, in A.
    motor_a_per_m_s: f64 = 2.5;
    /// Voltage drop per ampere-hour drawn, in V.
    fall_v_per_ah: f64 = 0.5;
    /// Standard deviation of the measured voltage, in V.
    noise_v: f64 = 0.01;
    /// Voltage that supplies the board's processor and is its converter's reference, in
    /// V; USB is between 4.4 and 5.25.
    supply_v: f64 = 5.0, in POSITIVE;
    /// The divider is not connected: the board's input floats.
    divider_open: bool = false;
    /// Begin of a dip of the ESC's own supply (BEC), which feeds servo and IMU, in s.
    /// Without it the wheels keep their angle and the IMU restarts.
    dip_at_s: Option<f64> = None, in NOT_NEGATIVE;
    /// Duration of the dip, in ms.
    dip_ms: f64 = 150.0, in POSITIVE;
    /// Voltage of the battery during the dip, in V; it stays as it is if left out.
    dip_v: Option<f64> = None;
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
