//! What an invariant is given in each step: ground truth, and the outputs of the
//! host.

use singletrack_control::SteeringMap;
use singletrack_core::config::{Config, ConfigError, ReferenceSection};
use singletrack_pilot::{Fence, Learned, PilotConfig, PilotRequest};
use singletrack_protocol::{BoardMode, Configuration, EscKind, StopCause, ToBoard};
use singletrack_record::TickRecord;
use singletrack_sim::{EscKind as TrueEsc, ReceivedMessage, SimulationConfig, Truth};

use crate::{
    network::Exposure,
    pins::Pulse,
    schedule::{Fault, FaultKind, FaultTarget, Schedule, Situation},
    stop::Stop,
};

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

/// A pose that the daemon has received.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ReceivedPose {
    pub(crate) exposure: Exposure,
    pub(crate) received_us: u64,
}

impl ReceivedPose {
    /// Time from which its age counts: the arrival, if the server's clock is not
    /// trusted.
    pub(crate) const fn since_us(&self) -> u64 {
        if self.exposure.clock_trusted {
            self.exposure.exposed_us
        } else {
            self.received_us
        }
    }
}

/// One step of a drive.
#[derive(Debug)]
pub(crate) struct Observation<'a> {
    /// Simulation time, in µs.
    pub(crate) now_us: u64,
    pub(crate) spec: &'a Spec,
    /// Ground truth of the vehicle.
    pub(crate) truth: Truth,
    /// Pulses since the last step.
    pub(crate) pulses: &'a [Pulse],
    /// The stop of the drive that has ended, or is about to.
    pub(crate) stop: Option<&'a Stop>,
    /// Messages that reached the board in this step.
    pub(crate) board_received: &'a [ReceivedMessage],
    /// Start time of the board's code; none while the board is not running.
    pub(crate) board_since_us: Option<u64>,
    /// Mode in the board's last telemetry.
    pub(crate) board_mode: Option<BoardMode>,
    /// Cause of its last stop, there.
    pub(crate) board_cause: Option<StopCause>,
    /// Whether the running board was armed at that time.
    pub(crate) board_is_armed: bool,
    /// Whether the configuration in force is proved.
    pub(crate) is_proved: bool,
    /// True way since the car was armed, in m.
    pub(crate) way_since_arm: f64,
    /// Whether the ESC has its supply.
    pub(crate) esc_has_power: bool,
    /// Whether somebody pushes the car, or it still rolls from that.
    pub(crate) moved_by_hand: bool,
    /// The daemon's tick in this step, if any.
    pub(crate) tick: Option<&'a TickRecord>,
    /// Whether the tick's output must follow from its inputs; see
    /// [`crate::Tamper::is_replayed`].
    pub(crate) is_replayed: bool,
    /// Messages that the daemon wrote in this step.
    pub(crate) written: &'a [ToBoard],
    /// Whether the daemon read bytes from the board in this step.
    pub(crate) has_read: bool,
    /// Start time of the running daemon.
    pub(crate) daemon_since_us: Option<u64>,
    /// The newest pose that the daemon has received.
    pub(crate) newest_pose: Option<ReceivedPose>,
    /// Active faults, in order of onset.
    pub(crate) faults: &'a [Fault],
    /// Faults that began in this step.
    pub(crate) new_faults: &'a [Fault],
    /// Requests accepted since the last tick: the tick of this step must contain
    /// them.
    pub(crate) pending_requests: &'a [PilotRequest],
    /// The configuration that has just come into force, with its number: 1 for that of a
    /// daemon that was started.
    pub(crate) configuration: Option<&'a (u32, PilotConfig)>,
    /// The host's time of the newest valid set-point that the daemon was sent.
    pub(crate) newest_setpoint_ns: Option<u64>,
    /// The pilot's corrections after its last tick; none if it does not learn.
    pub(crate) learned: Option<Learned>,
}

impl Observation<'_> {
    pub(crate) fn is_active(&self, kind: FaultKind) -> bool {
        self.faults.iter().any(|fault| fault.kind == kind)
    }

    /// Whether a person moves the car.
    pub(crate) const fn is_moved_by_hand(&self) -> bool {
        self.moved_by_hand
    }

    /// Whether the board gets no motor pulses.
    pub(crate) fn is_without_motor_pulses(&self) -> bool {
        self.is_effective(FaultKind::PulsesGone)
    }

    /// Whether the throttle is stuck, and no kill output can end that.
    pub(crate) fn is_unstoppable(&self) -> bool {
        self.is_active(FaultKind::EscStuck) && !self.spec.situation.kill_output
    }

    /// Whether line, sensors, cameras, board or host have a fault: they may not see what
    /// the car does.
    pub(crate) fn is_blinded(&self) -> bool {
        let blinds = |fault: &Fault| !matches!(fault.kind.target(), FaultTarget::Car);
        self.faults.iter().any(blinds) || self.new_faults.iter().any(blinds)
    }

    /// Whether the fault is in effect: of several faults with the same subject,
    /// only the latest is.
    pub(crate) fn is_effective(&self, kind: FaultKind) -> bool {
        let mut rivals = self.faults.iter().rev();
        rivals
            .find(|fault| fault.kind.subject() == kind.subject())
            .is_some_and(|fault| fault.kind == kind)
    }
}

/// Observations for tests of invariants that no planted bug reaches, because
/// another invariant fails first.
#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test fails by panicking")]
pub(crate) mod scene {
    use singletrack_sim::PulseRecord;

    use super::{
        Exposure, Observation, Pulse, ReceivedPose, Schedule, SimulationConfig, Spec, Truth,
    };
    use crate::{
        pins::Effect,
        setting::{self, ConfigurationFile},
    };

    /// A step in which a car drives without faults.
    pub(crate) struct Scene {
        pub(crate) spec: Spec,
        pub(crate) pulses: Vec<Pulse>,
        pub(crate) truth: Truth,
    }

    impl Scene {
        pub(crate) fn new() -> Self {
            let schedule: Schedule = "seed 1; end_ms 9000".parse().unwrap();
            let config =
                setting::config(&schedule.situation, ConfigurationFile::default()).unwrap();
            Self {
                spec: Spec::new(&schedule, &SimulationConfig::default(), &config).unwrap(),
                pulses: vec![Pulse {
                    record: PulseRecord {
                        time_us: 5_000_000,
                        board_time_us: 5_000_000,
                        servo_us: 1_500,
                        esc_us: 1_560,
                        cut: false,
                    },
                    effect: Effect::Drive,
                }],
                truth: Truth::default(),
            }
        }

        /// The step with a pose of the given age.
        pub(crate) fn observation(&self, pose_age_us: u64) -> Observation<'_> {
            let now_us = 5_000_000;
            Observation {
                now_us,
                spec: &self.spec,
                truth: self.truth,
                pulses: &self.pulses,
                stop: None,
                board_received: &[],
                board_since_us: Some(65_000),
                board_mode: None,
                board_cause: None,
                board_is_armed: true,
                is_proved: true,
                way_since_arm: 2.0,
                esc_has_power: true,
                moved_by_hand: false,
                tick: None,
                is_replayed: true,
                written: &[],
                has_read: true,
                daemon_since_us: Some(0),
                newest_pose: Some(ReceivedPose {
                    exposure: Exposure {
                        exposed_us: now_us - pose_age_us,
                        clock_trusted: true,
                        falsified: false,
                    },
                    received_us: now_us,
                }),
                faults: &[],
                new_faults: &[],
                pending_requests: &[],
                configuration: None,
                newest_setpoint_ns: None,
                learned: None,
            }
        }
    }
}
