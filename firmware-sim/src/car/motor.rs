//! The electronic speed controller, the motor, the gears and the battery, whose voltage drops under
//! load and as it discharges.

use libm::{cos, sin};
use serde::{Deserialize, Serialize};
use singletrack_control::GRAVITY;
use singletrack_settings::section;

use crate::{
    clock::Epoch,
    ranges::{FINITE, LAG, NOT_NEGATIVE, POSITIVE},
};

/// What an ESC makes of its pulses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum EscKind {
    /// A car's ESC: the first pulse below neutral after driving forward brakes; reverse
    /// needs standstill and neutral first.
    #[default]
    Car,
    /// A crawler's or a boat's ESC: a pulse below neutral drives in reverse at once.
    ForwardReverse,
    /// A VESC on its pulse input, with current control without reverse: a pulse below
    /// neutral brakes. Its time-out is 1 s if nothing else is written.
    Vesc,
    /// An ESC like [`EscKind::Car`] whose neutral is the mean of the first
    /// `LEARNED_PULSES` pulses after it has been switched on.
    LearnsNeutral,
}

impl EscKind {
    /// Time without pulses after which an ESC of this kind releases the motor, in µs.
    pub const fn signal_loss_us(self) -> u64 {
        match self {
            Self::Vesc => 1_000_000,
            _ => 100_000,
        }
    }
}

/// Number of pulses from which an ESC learns its neutral.
const LEARNED_PULSES: u32 = 10;

section! {
    /// A push of the car along its axis.
    "car.motor.push" => pub Push: Copy;
    [];

    /// When, in s.
    at_s: f64, in NOT_NEGATIVE;
    /// Change of the speed, in m/s; if `for_s` is above zero, the speed itself.
    speed_m_s: f64, in FINITE;
    /// For how long the car is moved at `speed_m_s`, in s; zero is a blow.
    for_s: f64 = 0.0, in NOT_NEGATIVE;
}

section! {
    /// Response of the drive train to the ESC's pulses.
    ///
    /// Beyond the deadband the wheels settle at `gain · u / (1 + u / saturation)` times
    /// the ratio of battery voltage to nominal voltage, with `u` the pulse beyond
    /// deadband and breakaway. The speed loop must therefore compensate a curve, an
    /// offset and a drift.
    "car.motor" => pub MotorParameters: Copy;
    [default];

    /// The kind of ESC.
    kind: EscKind = EscKind::Car;
    /// Pulse without drive or brake, in µs; [`EscKind::LearnsNeutral`] finds its own.
    neutral_us: u16 = 1500;
    // With the breakaway, 30 µs in which the wheels stand.
    /// Half width of the band around neutral without drive, in µs.
    deadband_us: u16 = 26;
    /// Further pulse needed before the wheels turn, in µs.
    breakaway_us: f64 = 4.0;
    /// Speed per µs of pulse near zero, in m/s per µs.
    gain_m_s_per_us: f64 = 0.01, in POSITIVE;
    /// Pulse at which half of the linear speed is reached, in µs.
    saturation_us: f64 = 400.0, in POSITIVE;
    /// Time constant of the first-order lag, in s.
    lag_s: f64 = 0.08, in LAG;
    /// Time from the start of a pulse to the motor's response, in µs.
    dead_time_us: u64 = 20_000;
    /// Largest acceleration, in m/s².
    max_acceleration_m_s2: f64 = 3.0;
    /// Constant deceleration of the rolling car, in m/s².
    coasting_m_s2: f64 = 0.8, in NOT_NEGATIVE;
    /// Deceleration of the rolling car per speed, in 1/s.
    viscous_per_s: f64 = 1.0, in NOT_NEGATIVE;
    /// Braking per µs of pulse beyond the deadband, in m/s² per µs.
    brake_m_s2_per_us: f64 = 0.02;
    /// Largest braking, in m/s².
    max_brake_m_s2: f64 = 3.0;
    /// Whether a pulse below neutral drives in reverse after standstill and
    /// neutral; otherwise it only brakes. Only for the kinds that brake first.
    reverse: bool = true;
    /// Time at neutral after power-on before the ESC drives, in µs.
    arming_us: u64 = 1_000_000;
    /// Time without pulses after which the ESC releases the motor, in µs.
    signal_loss_us: u64 = 100_000;
    /// From this time on the throttle stays as it is, in s, whatever the pulses say, and
    /// without pulses too. Only cutting its supply releases the motor.
    stuck_from_s: Option<f64> = None, in NOT_NEGATIVE;
    /// When the ESC restarts, in s: it has no power for `reboot_ms`, then needs neutral.
    reboot_at_s: Option<f64> = None, in NOT_NEGATIVE;
    /// Time without power at a restart, in ms.
    reboot_ms: f64 = 300.0, in POSITIVE;
    /// The ESC's supply runs through a relay that the board holds (normally open).
    kill_relay: bool = false;
    /// Slope of the floor, in degrees. It acts along the car only.
    slope_deg: f64 = 0.0, in in_words("from -45 to 45", |x| (-45.0..=45.0).contains(&x));
    /// Direction in which the floor rises, in degrees from the world's x axis.
    slope_heading_deg: f64 = 0.0, in FINITE;
    /// Slip of the driven wheels: the part of their rotation, and of the motor's pulses,
    /// that does not move the car.
    slip: f64 = 0.0, in in_words("from 0 to below 1", |x| (0.0..1.0).contains(&x));
    /// Begin of the slip, in s; always if left out.
    slip_from_s: Option<f64> = None, in NOT_NEGATIVE;
    /// A push.
    push: Option<Push> = None;
}

/// Action of the ESC on the motor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) enum MotorAction {
    /// No drive or brake.
    #[default]
    Free,
    /// Drives towards this wheel speed at nominal voltage, in m/s.
    Towards(f64),
    /// Brakes with this deceleration, in m/s².
    Brake(f64),
}

/// The ESC: arming, the brake-then-reverse rule, signal loss.
#[derive(Clone, Debug, Default)]
pub(crate) struct SpeedController {
    neutral_since_us: Option<u64>,
    pub(crate) armed: bool,
    reverse_ready: bool,
    pub(crate) drive: MotorAction,
    /// Number and sum of the pulses from which neutral is learned, in µs.
    learned: u32,
    learned_sum_us: u32,
}

/// Wheels slower than this count as standing, in m/s.
const STANDING: f64 = 0.02;

impl SpeedController {
    /// Releases the motor after a loss of the signal.
    pub(crate) fn release(&mut self) {
        self.neutral_since_us = None;
        self.reverse_ready = false;
        self.drive = MotorAction::Free;
    }

    /// Processes a pulse at `now_us` with the wheels at `speed`.
    pub(crate) fn pulse(&mut self, p: &MotorParameters, pulse_us: u16, now_us: u64, speed: f64) {
        let Some(neutral_us) = self.neutral(p, pulse_us) else {
            return;
        };
        let deflection = f64::from(pulse_us) - neutral_us;
        let beyond = deflection.abs() - f64::from(p.deadband_us);
        if beyond <= 0.0 {
            let since = *self.neutral_since_us.get_or_insert(now_us);
            self.armed |= now_us.saturating_sub(since) >= p.arming_us;
            self.reverse_ready = speed < STANDING;
            self.drive = MotorAction::Free;
            return;
        }
        self.neutral_since_us = None;
        self.reverse_ready &= deflection < 0.0;
        let driving = (beyond - p.breakaway_us).max(0.0);
        let settled = p.gain_m_s_per_us * driving / (1.0 + driving / p.saturation_us);
        self.drive = if !self.armed {
            MotorAction::Free
        } else if deflection > 0.0 {
            MotorAction::Towards(settled)
        } else if match p.kind {
            EscKind::ForwardReverse => true,
            EscKind::Vesc => false,
            EscKind::Car | EscKind::LearnsNeutral => p.reverse && self.reverse_ready,
        } {
            MotorAction::Towards(-settled)
        } else {
            MotorAction::Brake((p.brake_m_s2_per_us * beyond).min(p.max_brake_m_s2))
        };
    }

    /// Neutral, in µs; `None` while it is being learned.
    fn neutral(&mut self, p: &MotorParameters, pulse_us: u16) -> Option<f64> {
        if p.kind != EscKind::LearnsNeutral {
            return Some(p.neutral_us.into());
        }
        if self.learned < LEARNED_PULSES {
            self.learned += 1;
            self.learned_sum_us += u32::from(pulse_us);
            return None;
        }
        Some(f64::from(self.learned_sum_us) / f64::from(LEARNED_PULSES))
    }
}

impl MotorParameters {
    /// Acceleration of a car with this yaw by gravity, in m/s²; zero on a level floor.
    pub(crate) fn downhill(&self, yaw: f64) -> f64 {
        if self.slope_deg == 0.0 {
            return 0.0;
        }
        let along = cos(yaw - self.slope_heading_deg.to_radians());
        -GRAVITY * sin(self.slope_deg.to_radians()) * along
    }

    /// The drive train while the wheels are off the floor: they and the motor are all that is
    /// accelerated, and the tyres do not roll.
    pub(crate) fn wheels_up(&self) -> Self {
        const INERTIA_SHARE: f64 = 0.15;
        const FRICTION_SHARE: f64 = 0.25;
        let friction = FRICTION_SHARE / INERTIA_SHARE;
        Self {
            // The ESC's own ramp remains.
            lag_s: (self.lag_s * 0.5).max(0.01),
            max_acceleration_m_s2: self.max_acceleration_m_s2 / INERTIA_SHARE,
            coasting_m_s2: self.coasting_m_s2 * friction,
            viscous_per_s: self.viscous_per_s * friction,
            ..*self
        }
    }

    /// Whether friction and brakes hold a standing car against `downhill` (m/s²).
    pub(crate) fn holds(&self, drive: MotorAction, downhill: f64) -> bool {
        let brake = match drive {
            MotorAction::Towards(settled) if settled != 0.0 => return false,
            MotorAction::Brake(brake) => brake,
            MotorAction::Towards(_) | MotorAction::Free => 0.0,
        };
        downhill.abs() <= self.coasting_m_s2 + brake
    }

    /// The part of the wheels' rotation that moves the car.
    pub(crate) fn grip(&self, driven: bool, epoch: Epoch, now_us: u64) -> f64 {
        let slips = self.slip_from_s.is_none() || epoch.has_come(self.slip_from_s, now_us);
        1.0 - if driven && slips { self.slip } else { 0.0 }
    }

    /// Acceleration of the wheels without gravity, in m/s²; `voltage_share` is the
    /// battery's voltage over the nominal one.
    pub(crate) fn acceleration(&self, drive: MotorAction, speed: f64, voltage_share: f64) -> f64 {
        // Friction is continuous over 5 mm/s, which the integrator requires.
        let direction = (speed / 0.005).clamp(-1.0, 1.0);
        let rolling = self.coasting_m_s2 * direction + self.viscous_per_s * speed;
        match drive {
            MotorAction::Towards(settled) => {
                let driven = (settled * voltage_share - speed) / self.lag_s;
                // A motor that turns faster than its target does not brake: the car rolls.
                if settled * direction >= 0.0 && driven * direction < -rolling.abs() {
                    -rolling
                } else {
                    driven.clamp(-self.max_acceleration_m_s2, self.max_acceleration_m_s2)
                }
            }
            MotorAction::Free => -rolling,
            MotorAction::Brake(brake) => -rolling - brake * direction,
        }
    }
}

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
    pub(crate) drawn_ah: f64,
    current_a: f64,
    /// A dip is underway.
    pub(crate) dips: bool,
    pub(crate) is_unplugged: bool,
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
