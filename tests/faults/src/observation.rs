//! What an invariant may look at: the world as it really is, and what the host
//! did.

use singletrack_core::config::{Config, ConfigError, ReferenceSection};
use singletrack_pilot::{Fence, PilotConfig, Request};
use singletrack_protocol::{BoardMode, Configuration, ToBoard};
use singletrack_record::TickRecord;
use singletrack_sim::{Heard, PulseRecord, Truth};

use crate::{
    network::Exposure,
    schedule::{Fault, FaultKind, Situation},
};

/// What the configuration promises, in the units of the invariants.
#[derive(Clone, Debug)]
pub(crate) struct Spec {
    pub(crate) situation: Situation,
    pub(crate) board: Configuration,
    pub(crate) hold_us: u64,
    /// A pose this old ends even slowing down.
    pub(crate) blind_us: u64,
    pub(crate) imu_silence_us: u64,
    pub(crate) stuck_samples: u32,
    pub(crate) stop_timeout_us: u64,
    pub(crate) max_speed: f64,
    pub(crate) max_reverse_speed: f64,
    pub(crate) max_acceleration: f64,
    pub(crate) stop_deceleration: f64,
    /// What the fence counts on, m/s².
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
            board: config.board.configuration(),
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
            fence: config.fence.fence()?,
        })
    }

    /// Whether the ESC's pulse drives the motor: neither neutral, nor absent, nor
    /// the brake of a board that brakes by itself. What a reset cut short drives
    /// only if it is longer than neutral all the same.
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

/// What the width of a pulse may be off by, in µs: the rounding of a measured one.
pub(crate) const TOLERANCE_US: u16 = 1;

/// A pose that has reached the daemon.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ReceivedPose {
    pub(crate) exposure: Exposure,
    pub(crate) received_us: u64,
}

impl ReceivedPose {
    /// Since when it is at least as old as the daemon can know.
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
    /// What is really so.
    pub(crate) truth: Truth,
    /// The pulses that were new.
    pub(crate) pulses: &'a [PulseRecord],
    /// What has reached the board.
    pub(crate) heard: &'a [Heard],
    /// When the board's code began to run; none while it does not.
    pub(crate) board_since_us: Option<u64>,
    /// What the board last said of itself.
    pub(crate) board_mode: Option<BoardMode>,
    /// The daemon's tick, if there was one.
    pub(crate) tick: Option<&'a TickRecord>,
    /// Whether what it decided must follow from what it was told.
    pub(crate) is_replayed: bool,
    /// What the daemon wrote.
    pub(crate) written: &'a [ToBoard],
    /// Whether the daemon has read bytes of the board.
    pub(crate) has_read: bool,
    /// When the daemon that runs was started.
    pub(crate) daemon_since_us: Option<u64>,
    /// The newest pose that has reached it.
    pub(crate) newest_pose: Option<ReceivedPose>,
    /// The faults in force.
    pub(crate) faults: &'a [Fault],
    /// Those that have just begun.
    pub(crate) new_faults: &'a [Fault],
    /// The requests that were taken since the last tick but one: this one must
    /// know of them.
    pub(crate) pending_requests: &'a [Request],
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

    /// Whether it is in force: of faults with the same subject the one that began
    /// last is.
    pub(crate) fn is_effective(&self, kind: FaultKind) -> bool {
        let mut rivals = self.faults.iter().rev();
        rivals
            .find(|fault| fault.kind.subject() == kind.subject())
            .is_some_and(|fault| fault.kind == kind)
    }
}

/// Sights made up for the tests of invariants that no planted bug reaches: others
/// find what would lead there before.
#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test fails by panicking")]
pub(crate) mod scene {
    use singletrack_sim::PulseRecord;

    use super::{Exposure, Observation, ReceivedPose, Situation, Spec, Truth};
    use crate::setting::{self, ConfigurationFile};

    /// A moment in which a car is driven as it should be.
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

        /// With a pose that is so old.
        pub(crate) fn observation(&self, pose_age_us: u64) -> Observation<'_> {
            let now_us = 5_000_000;
            Observation {
                now_us,
                spec: &self.spec,
                truth: self.truth,
                pulses: &self.pulses,
                heard: &[],
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
