//! What an invariant is given in each step: ground truth and the outputs of the host; a hash of the
//! events of a drive.

use singletrack_pilot::{Learned, PilotConfig, PilotRequest};
use singletrack_protocol::{BoardMode, StopCause, ToBoard};
use singletrack_record::TickRecord;
use singletrack_sim::{ReceivedMessage, Truth};

use crate::{
    network::Exposure,
    pins::Pulse,
    program::Renewed,
    schedule::{Fault, FaultKind, FaultTarget},
    spec::Spec,
    stop::Stop,
};

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
    /// Whether the board was last given pulses of a jog.
    pub(crate) jogs: bool,
    /// When the operator's program last renewed its drive.
    pub(crate) renewed: Renewed,
    /// True way since the car was armed, in m.
    pub(crate) way_since_arm: f64,
    /// Whether the ESC has its supply.
    pub(crate) esc_has_power: bool,
    /// Whether somebody pushes, lifts or holds the car, or it still rolls from that.
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
        let blinds = |fault: &Fault| {
            !matches!(
                fault.kind.target(),
                FaultTarget::Car | FaultTarget::Operator
            )
        };
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
    use singletrack_sim::{PulseRecord, SimulationConfig};

    use super::{Exposure, Observation, Pulse, ReceivedPose, Renewed, Spec, Truth};
    use crate::{
        pins::Effect,
        schedule::Schedule,
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
                jogs: false,
                renewed: Renewed::default(),
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

/// FNV-1a over words.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Digest(u64);

impl Default for Digest {
    fn default() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }
}

impl Digest {
    fn word(&mut self, word: u64) {
        self.0 = (self.0 ^ word).wrapping_mul(0x0000_0100_0000_01b3);
        self.0 ^= self.0 >> 29;
    }

    fn text(&mut self, text: &str) {
        for byte in text.bytes() {
            self.word(byte.into());
        }
    }

    /// Hashes the events of a step.
    pub(crate) fn add(&mut self, observation: &Observation<'_>) {
        for pulse in observation.pulses {
            self.word(pulse.time_us);
            self.word(u64::from(pulse.servo_us) << 16 | u64::from(pulse.esc_us));
        }
        for received in observation.board_received {
            self.word(received.time_us);
        }
        if let Some(tick) = observation.tick {
            self.word(observation.now_us);
            self.word(tick.events.len() as u64);
            let output = &tick.output;
            self.text(output.mode.name());
            self.text(output.reason.map_or("", |reason| reason.name()));
            self.word(output.actuation.speed.to_bits());
            self.word(output.actuation.steering.to_bits());
            self.word(observation.truth.x.to_bits());
            self.word(observation.truth.y.to_bits());
        }
    }

    pub(crate) const fn value(self) -> u64 {
        self.0
    }
}
