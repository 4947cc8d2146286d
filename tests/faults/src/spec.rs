//! The limits that a configuration promises.

use singletrack_control::SteeringMap;
use singletrack_core::config::{Config, ConfigError, ReferenceSection};
use singletrack_pilot::Fence;
use singletrack_protocol::{Configuration, EscKind};
use singletrack_sim::{EscKind as TrueEsc, SimulationConfig};

use crate::schedule::{Schedule, Situation};

/// The limits that the configuration promises, in the units of the invariants.
#[derive(Clone, Debug)]
pub(crate) struct Spec {
    pub(crate) situation: Situation,
    /// Whether the true car is calibrated well enough that it must drive.
    pub(crate) is_tolerable: bool,
    pub(crate) board: Configuration,
    pub(crate) hold_us: u64,
    /// Pose age that ends even a controlled stop.
    pub(crate) blind_us: u64,
    /// Distance without a pose that ends a drive, in m.
    pub(crate) blind_m: f64,
    pub(crate) imu_silence_us: u64,
    pub(crate) stuck_samples: u32,
    pub(crate) stop_timeout_us: u64,
    pub(crate) max_speed: f64,
    pub(crate) max_reverse_speed: f64,
    pub(crate) max_acceleration: f64,
    pub(crate) stop_deceleration: f64,
    /// Deceleration that the geofence assumes, in m/s².
    pub(crate) braking: f64,
    /// The longest roll-out from the highest speed, in µs.
    pub(crate) max_roll_out_us: u64,
    /// Neutral of the true ESC, in µs, if it does not learn it from its pulses, and the half
    /// width of the band around it in which it does not drive.
    pub(crate) true_neutral_us: Option<u16>,
    pub(crate) true_deadband_us: u16,
    /// Time without pulses after which the true ESC releases the motor.
    pub(crate) true_signal_loss_us: u64,
    /// Time from a neutral pulse until the true motor is free, in µs: the dead time of its
    /// ESC, and 80 ms.
    pub(crate) true_release_us: u64,
    /// True over configured distance of a motor pulse.
    pub(crate) true_pulse_share: f64,
    /// How much younger than they are the server's stamps make poses: in µs, and its
    /// growth per µs.
    true_stamp_error: [f64; 2],
    /// Whether interference makes edges on the motor sensor's wire.
    pub(crate) has_interference: bool,
    /// The angle of the front wheels over the servo's pulse, as configured.
    steering: SteeringMap,
    pub(crate) max_steering: f64,
    pub(crate) max_steering_rate: f64,
    pub(crate) period_s: f64,
    /// How long a set-point is in force.
    pub(crate) setpoint_timeout_ns: Option<u64>,
    pub(crate) fence: Fence,
}

impl Spec {
    pub(crate) fn new(
        schedule: &Schedule,
        world: &SimulationConfig,
        config: &Config,
    ) -> Result<Self, ConfigError> {
        let us = |ms: u32| u64::from(ms) * 1_000;
        let situation = &schedule.situation;
        let limits = &config.limits;
        let board = config.board_configuration();
        Ok(Self {
            situation: *situation,
            is_tolerable: schedule.is_tolerable(),
            board,
            hold_us: us(config.supervisor.hold_ms),
            blind_us: us(config.supervisor.blind_ms),
            blind_m: config.supervisor.blind_distance_m,
            imu_silence_us: us(config.supervisor.imu_silence_ms),
            stuck_samples: config.watch.stuck_samples,
            stop_timeout_us: us(config.supervisor.stop_timeout_ms),
            max_speed: limits.max_speed_m_s,
            max_reverse_speed: limits.max_reverse_speed_m_s,
            max_acceleration: limits.max_acceleration_m_s2,
            stop_deceleration: config.control.stop_deceleration_m_s2,
            braking: config.fence.braking_m_s2,
            max_roll_out_us: us(board.max_roll_out_ms.into()),
            true_neutral_us: (world.car.motor.kind != TrueEsc::LearnsNeutral)
                .then_some(world.car.motor.neutral_us),
            true_deadband_us: world.car.motor.deadband_us,
            true_signal_loss_us: world.car.motor.signal_loss_us,
            true_release_us: world.car.motor.dead_time_us + 80_000,
            true_pulse_share: world.car.motor_sensor.pulse_distance_um
                / f64::from(board.speed.pulse_distance_um),
            true_stamp_error: [
                1e3 * world.cameras.stamp_bias_ms,
                1e-6 * world.cameras.stamp_drift_ppm,
            ],
            has_interference: {
                let sensor = &world.car.motor_sensor;
                sensor.emi_driven_hz + sensor.emi_standstill_hz > 0.0 || sensor.ringing_edges > 0
            },
            steering: config.steering_map()?,
            max_steering: limits.max_steering_rad,
            max_steering_rate: limits.max_steering_rate_rad_s,
            setpoint_timeout_ns: match config.reference {
                ReferenceSection::External {
                    setpoint_timeout_ms,
                    ..
                } => Some(u64::from(setpoint_timeout_ms) * 1_000_000),
                _ => None,
            },
            period_s: f64::from(config.control.period_ms) * 1e-3,
            fence: config.fence.fence(&config.vehicle)?,
        })
    }

    /// The angle of the front wheels that is believed of an angle that the board is commanded,
    /// both in rad.
    pub(crate) fn believed_angle(&self, commanded_rad: f64) -> f64 {
        let servo = &self.board.servo;
        let gain = f64::from(servo.gain_us_per_rad);
        self.steering
            .angle(f64::from(servo.centre_us) + commanded_rad * gain)
    }

    /// How much younger than it is a pose may look to the host, in µs.
    pub(crate) fn stamp_error_us(&self, now_us: u64) -> u64 {
        let [bias_us, growth] = self.true_stamp_error;
        (bias_us + growth * now_us as f64).max(0.0) as u64
    }

    /// Whether the stamps leave the frames by more than 0.05 ms a second.
    pub(crate) const fn stamps_drift(&self) -> bool {
        let [_, growth] = self.true_stamp_error;
        growth.abs() > 5e-5
    }

    /// Whether the board may brake.
    pub(crate) const fn brakes(&self) -> bool {
        !matches!(self.board.esc.kind, EscKind::ForwardReverse)
    }
}

/// Tolerance of a pulse width, in µs: the rounding of a measured one.
pub(crate) const TOLERANCE_US: u16 = 1;
