//! The first metre of an unproved configuration, and what a contradiction entails; a configuration
//! comes into force as a whole, and never during a drive.

use singletrack_pilot::{Event, Mode, PilotRequest, Reason};
use singletrack_protocol::ToBoard;

use super::{Invariant, Verdict, disarms};
use crate::{observation::Observation, schedule::FaultKind};

/// `proving-speed`: on the first metre after an arm of an unproved configuration, the car is
/// commanded at most 0.3 m/s, and drives at most a third and 0.1 m/s faster: the tolerance of its motor
/// sensor, and the overshoot of the board's speed loop.
///
/// An ESC whose throttle is stuck drives at any speed. Faults of the motor sensor and interference
/// make the loop drive faster; then, and until
/// the loop has settled, only the command is judged. The host measures the metre with a fifth of
/// tolerance: the body's pivot may be wrong.
#[derive(Default)]
pub(super) struct ProvingSpeed {
    /// True way at the arm, in m.
    from: f64,
    /// Whether the drive began, or went on, with a proved configuration: a contradiction that
    /// ends it counts from the next drive on.
    was_proved: bool,
    /// When the loop has settled after the last fault.
    settled_us: u64,
}

/// Time in which the board's speed loop settles, in µs.
const SETTLES_US: u64 = 500_000;

pub(crate) const METRE: f64 = 0.8;

const PROVING_MM_S: i16 = 300;
const PROVING_M_S: f64 = 0.3 * 1.34 + 0.1;

impl Invariant for ProvingSpeed {
    fn name(&self) -> &'static str {
        "proving-speed"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        let arms = observation
            .tick
            .is_some_and(|tick| tick.output.mode == Mode::Arming);
        let way = observation.truth.way;
        if observation.is_blinded() {
            self.settled_us = observation.now_us + SETTLES_US;
        }
        if arms || observation.configuration.is_some() {
            self.from = way;
            self.was_proved = false;
        }
        self.was_proved |= observation.is_proved;
        if self.was_proved || way - self.from > METRE {
            return Ok(());
        }
        for message in observation.written {
            if let ToBoard::Drive(drive) = message
                && drive.speed_mm_s > PROVING_MM_S
            {
                return Err(format!(
                    "a speed command of {} mm/s before the configuration is proved",
                    drive.speed_mm_s
                ));
            }
        }
        let speed = observation.truth.speed.abs();
        let judged = observation.spec.is_tolerable
            && observation.board_is_armed
            // A jog has limits of its own: see `jog-limits`.
            && !observation.jogs
            && !observation.moved_by_hand
            && !observation.is_active(FaultKind::EscStuck)
            && observation.now_us >= self.settled_us;
        if judged && speed > PROVING_M_S {
            return Err(format!("{speed:.2} m/s before the configuration is proved"));
        }
        Ok(())
    }
}

/// `false-proof`: a configuration is proved only by a car that has truly driven a metre
/// since it was armed, within the tolerance of `proving-speed`.
///
/// Only where the cameras show the true car, and nobody has pushed it.
#[derive(Default)]
pub(super) struct FalseProof {
    deceived: bool,
}

impl Invariant for FalseProof {
    fn name(&self) -> &'static str {
        "false-proof"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        let Some(tick) = observation.tick else {
            return Ok(());
        };
        if tick.output.mode == Mode::Arming {
            self.deceived = false;
        }
        self.deceived |= observation.moved_by_hand
            || observation
                .faults
                .iter()
                .any(|fault| fault.kind.falsifies_pose() || fault.kind.forges_frames());
        let way = observation.way_since_arm;
        if tick.output.proved && way < METRE && !self.deceived {
            return Err(format!("proved after {way:.2} m"));
        }
        Ok(())
    }
}

/// Whether a drive that ended by this showed that sensors, actuators and configuration
/// contradict each other: it revokes a proof.
pub(crate) fn is_contradiction(reason: Reason) -> bool {
    CONTRADICTIONS.contains(&reason)
}

/// Words of sensors, actuators and configuration that contradict each other.
const CONTRADICTIONS: &[Reason] = &[
    Reason::SteeringReversed,
    Reason::SteeringDiffers,
    Reason::GyroDiffers,
    Reason::BodyYawWrong,
    Reason::AccelerometerDiffers,
    Reason::SideslipImplausible,
];

/// Further words that a calibrated car without a fault must not hear.
const ALARMS: &[Reason] = &[
    Reason::MotorSpeedMismatch,
    Reason::EstimateInconsistent,
    Reason::CaptureTimeUncertain,
    Reason::ImuTilted,
    Reason::TiltDiffers,
    Reason::PoseFrozen,
    Reason::PosesTooRare,
    Reason::PoseHeight,
    Reason::ImuImplausible,
    Reason::ImuStuck,
    Reason::ImuFault,
    Reason::Overspeed,
    Reason::BatteryOpen,
    Reason::RunsAtNeutral,
    Reason::StopNotObeyed,
    Reason::BrakesLessThanConfigured,
];

/// `acknowledged`: after a contradiction has ended a drive, nothing is armed until somebody
/// has asked for a disarm; an emergency stop is none. While the configuration is unproved,
/// motor and cameras that differ count too.
///
/// A daemon that was started or reconfigured since may arm. It has no proof any more, so
/// that `proving-speed` holds.
#[derive(Default)]
pub(super) struct Acknowledged {
    contradiction: Option<Reason>,
    mode: Option<Mode>,
    daemon_since_us: Option<u64>,
}

impl Invariant for Acknowledged {
    fn name(&self) -> &'static str {
        "acknowledged"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        if observation.daemon_since_us != self.daemon_since_us
            || observation.configuration.is_some()
        {
            *self = Self {
                daemon_since_us: observation.daemon_since_us,
                ..Self::default()
            };
        }
        let Some(tick) = observation.tick else {
            return Ok(());
        };
        let mode = tick.output.mode;
        let before = self.mode.replace(mode);
        if disarms(&tick.events) {
            self.contradiction = None;
        }
        if mode == Mode::Arming
            && let Some(reason) = self.contradiction
        {
            return Err(format!("armed after {reason}, which nobody acknowledged"));
        }
        let ends = matches!(before, Some(Mode::Driving | Mode::Slowing))
            && !matches!(mode, Mode::Driving | Mode::Slowing);
        if ends {
            self.contradiction = tick.output.reason.filter(|&reason| {
                let differs = reason == Reason::MotorSpeedMismatch;
                is_contradiction(reason) || (differs && !observation.is_proved)
            });
        }
        Ok(())
    }
}

/// `fault-clears`: the fault of a stop that was not obeyed is left by a disarm
/// request only.
#[derive(Default)]
pub(super) struct FaultClears {
    declared: bool,
    daemon_since_us: Option<u64>,
}

impl Invariant for FaultClears {
    fn name(&self) -> &'static str {
        "fault-clears"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        if observation.daemon_since_us != self.daemon_since_us {
            self.daemon_since_us = observation.daemon_since_us;
            self.declared = false;
        }
        let Some(tick) = observation.tick else {
            return Ok(());
        };
        let output = &tick.output;
        let requested = |request| tick.events.contains(&Event::Request(request));
        if output.mode == Mode::Fault {
            self.declared |= output.reason == Some(Reason::StopNotObeyed);
            if requested(PilotRequest::EmergencyStop) {
                // Another fault, which ends otherwise.
                self.declared = false;
            }
            return Ok(());
        }
        let declared = core::mem::replace(&mut self.declared, false);
        if declared && !disarms(&tick.events) {
            return Err(format!(
                "mode {} after a stop that was not obeyed, without a disarm request",
                output.mode
            ));
        }
        Ok(())
    }
}

/// `false-alarm`: a calibrated car hears no word of a contradiction or of an implausible
/// sensor before the first fault of its schedule, and before somebody takes it into the hand: it then
/// moves without its wheels, or they without it. A wrong bit here and there is no fault: what no car
/// can do is not believed, and leads no pose astray.
#[derive(Default)]
pub(super) struct FalseAlarm {
    disturbed: bool,
    wrong_bits: bool,
}

impl Invariant for FalseAlarm {
    fn name(&self) -> &'static str {
        "false-alarm"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        let mut faults = observation.faults.iter().chain(observation.new_faults);
        self.disturbed |=
            observation.moved_by_hand || faults.any(|fault| fault.kind != FaultKind::ImuWrongBit);
        self.wrong_bits |= !observation.faults.is_empty();
        if self.disturbed || !observation.spec.is_tolerable {
            return Ok(());
        }
        let reason = observation.tick.and_then(|tick| tick.output.reason);
        match reason {
            Some(reason)
                if CONTRADICTIONS.contains(&reason)
                    || ALARMS.contains(&reason)
                    || (self.wrong_bits && reason == Reason::PoseImplausible) =>
            {
                Err(format!("{reason}, with a calibrated car and no fault"))
            }
            _ => Ok(()),
        }
    }
}

/// `reconfigured-underway`: no configuration comes into force during a drive.
#[derive(Default)]
pub(super) struct ReconfiguredUnderway {
    last: Option<Mode>,
}

impl Invariant for ReconfiguredUnderway {
    fn name(&self) -> &'static str {
        "reconfigured-underway"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        let Some(tick) = observation.tick else {
            return Ok(());
        };
        let before = self.last.replace(tick.output.mode);
        let changed = tick.events.iter().find_map(|event| match event {
            Event::Reconfigured(number) => Some(number),
            _ => None,
        });
        match (changed, before) {
            (Some(number), Some(mode)) if tick.index > 0 && mode.is_underway() => Err(format!(
                "configuration {number} came into force after a tick in mode {mode}"
            )),
            _ => Ok(()),
        }
    }
}

/// `armed-configuration`: a request to arm carries the hash of the configuration in
/// force.
#[derive(Default)]
pub(super) struct ArmedConfiguration;

impl Invariant for ArmedConfiguration {
    fn name(&self) -> &'static str {
        "armed-configuration"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        let hash = observation.spec.board.hash();
        for message in observation.written {
            if let ToBoard::Arm(arm) = message
                && arm.configuration_hash != hash
            {
                return Err(format!(
                    "a request to arm with configuration {:08x}, {hash:08x} is in force",
                    arm.configuration_hash
                ));
            }
        }
        Ok(())
    }
}
