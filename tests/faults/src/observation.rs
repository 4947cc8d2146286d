//! What an invariant is given in each step: ground truth, and the outputs of the
//! host.

use singletrack_core::config::{Config, ConfigError, ReferenceSection};
use singletrack_pilot::{Fence, PilotConfig, PilotRequest};
use singletrack_protocol::{BoardMode, Configuration, ToBoard};
use singletrack_record::TickRecord;
use singletrack_sim::{PulseRecord, ReceivedMessage, Truth};

use crate::{
    network::Exposure,
    schedule::{Fault, FaultKind, Situation},
};

/// The limits that the configuration promises, in the units of the invariants.
#[derive(Clone, Debug)]
pub(crate) struct Spec {
    pub(crate) situation: Situation,
    pub(crate) board: Configuration,
    pub(crate) hold_us: u64,
    /// Pose age that ends even a controlled stop.
    pub(crate) blind_us: u64,
    pub(crate) imu_silence_us: u64,
    pub(crate) stuck_samples: u32,
    pub(crate) stop_timeout_us: u64,
    pub(crate) max_speed: f64,
    pub(crate) max_reverse_speed: f64,
    pub(crate) max_acceleration: f64,
    pub(crate) stop_deceleration: f64,
    /// Deceleration that the geofence assumes, in m/s².
    pub(crate) braking: f64,
    pub(crate) max_steering: f64,
    pub(crate) max_steering_rate: f64,
    pub(crate) period_s: f64,
    /// How long a set-point is in force.
    pub(crate) setpoint_timeout_ns: Option<u64>,
    pub(crate) fence: Fence,
}

impl Spec {
    pub(crate) fn new(situation: &Situation, config: &Config) -> Result<Self, ConfigError> {
        let us = |ms: u32| u64::from(ms) * 1_000;
        let limits = &config.limits;
        Ok(Self {
            situation: *situation,
            board: config.board_configuration(),
            hold_us: us(config.supervisor.hold_ms),
            blind_us: us(config.supervisor.blind_ms),
            imu_silence_us: us(config.supervisor.imu_silence_ms),
            stuck_samples: config.watch.stuck_samples,
            stop_timeout_us: us(config.supervisor.stop_timeout_ms),
            max_speed: limits.max_speed_m_s,
            max_reverse_speed: limits.max_reverse_speed_m_s,
            max_acceleration: limits.max_acceleration_m_s2,
            stop_deceleration: config.control.stop_deceleration_m_s2,
            braking: config.fence.braking_m_s2,
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

    /// Whether the ESC pulse drives the motor: not neutral, not absent, and not the
    /// brake pulse of a board that brakes by itself. A pulse cut by a reset drives
    /// only if it is longer than neutral.
    pub(crate) fn drives(&self, pulse: &PulseRecord) -> bool {
        let esc = &self.board.esc;
        let brakes = self.situation.brake && pulse.esc_us.abs_diff(esc.brake_us) <= TOLERANCE_US;
        let short = pulse.cut && pulse.esc_us < esc.neutral_us;
        pulse.esc_us != 0
            && pulse.esc_us.abs_diff(esc.neutral_us) > TOLERANCE_US
            && !brakes
            && !short
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
    pub(crate) pulses: &'a [PulseRecord],
    /// Messages that reached the board in this step.
    pub(crate) board_received: &'a [ReceivedMessage],
    /// Start time of the board's code; none while the board is not running.
    pub(crate) board_since_us: Option<u64>,
    /// Mode in the board's last telemetry.
    pub(crate) board_mode: Option<BoardMode>,
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
}

impl Observation<'_> {
    pub(crate) fn is_active(&self, kind: FaultKind) -> bool {
        self.faults.iter().any(|fault| fault.kind == kind)
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

    use super::{Exposure, Observation, ReceivedPose, Situation, Spec, Truth};
    use crate::setting::{self, ConfigurationFile};

    /// A step in which a car drives without faults.
    pub(crate) struct Scene {
        pub(crate) spec: Spec,
        pub(crate) pulses: Vec<PulseRecord>,
        pub(crate) truth: Truth,
    }

    impl Scene {
        pub(crate) fn new() -> Self {
            let situation = Situation::default();
            let config = setting::config(&situation, ConfigurationFile::default()).unwrap();
            Self {
                spec: Spec::new(&situation, &config).unwrap(),
                pulses: vec![PulseRecord {
                    time_us: 5_000_000,
                    board_time_us: 5_000_000,
                    servo_us: 1_500,
                    esc_us: 1_560,
                    cut: false,
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
                board_received: &[],
                board_since_us: Some(65_000),
                board_mode: None,
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
            }
        }
    }
}
