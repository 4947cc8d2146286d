//! Invariants, which are checked in every step of a drive.

mod age;
mod authority;
mod cause;
mod fence;
mod host;
mod proving;
mod pulse;
mod replayed;
mod stand;

use singletrack_pilot::{Event, PilotConfig, PilotRequest};

pub(crate) use proving::{METRE, is_contradiction};

use crate::{
    SetupError,
    observation::Observation,
    schedule::Situation,
    setting::{self, ConfigurationFile},
};

/// Result of a check; the error describes the violation, with values.
pub(crate) type Verdict = Result<(), String>;

/// A property that must hold in every step.
pub(crate) trait Invariant {
    /// Name in the report of a violation.
    fn name(&self) -> &'static str;

    /// Checks one step.
    fn check(&mut self, observation: &Observation<'_>) -> Verdict;
}

/// One servo period on the board's clock, in µs: the longest time from a decision
/// to its pulse.
const SERVO_US: u64 = 20_000;

/// The names of all invariants, and of the two that the campaign itself checks.
///
/// # Errors
///
/// The default configuration is invalid.
pub fn names() -> Result<Vec<&'static str>, SetupError> {
    let config = setting::config(&Situation::default(), ConfigurationFile::default())?;
    let pilot = config.pilot().map_err(SetupError::Config)?;
    let invariants = all(pilot);
    let names = invariants.iter().map(|invariant| invariant.name());
    Ok(names.chain(["repeatable", "panic"]).collect())
}

/// All invariants, for one drive with this pilot.
pub(crate) fn all(pilot: PilotConfig) -> Vec<Box<dyn Invariant>> {
    vec![
        Box::<pulse::Limits>::default(),
        Box::<pulse::ServoSlew>::default(),
        Box::<pulse::EscSlew>::default(),
        Box::<pulse::NeutralFirst>::default(),
        Box::<authority::Unarmed>::default(),
        Box::<authority::Unasked>::default(),
        Box::<authority::Waits>::default(),
        Box::<authority::Latched>::default(),
        Box::<authority::DeadMan>::default(),
        Box::<authority::AtOnce>::default(),
        Box::<authority::JogLimits>::default(),
        Box::<age::CommandAge>::default(),
        Box::<age::HostSilence>::default(),
        Box::<age::PoseAge>::default(),
        Box::<age::HostHold>::default(),
        Box::<cause::EmergencyStop>::default(),
        Box::<cause::Disarm>::default(),
        Box::<cause::MainLoop>::default(),
        Box::<cause::MotorPulses>::default(),
        Box::<cause::ImuSilence>::default(),
        Box::<cause::ImuStuck>::default(),
        Box::<cause::SetpointSilence>::default(),
        Box::<replayed::Compared>::default(),
        Box::<proving::ReconfiguredUnderway>::default(),
        Box::<proving::ArmedConfiguration>::default(),
        Box::<host::TickGrid>::default(),
        Box::<host::CameraAlignment>::default(),
        Box::<fence::Fence>::default(),
        Box::<fence::EstimateError>::default(),
        Box::<fence::Filter>::default(),
        Box::<stand::Stands>::default(),
        Box::<stand::WeakBrakes>::default(),
        Box::<stand::StopNotObeyed>::default(),
        Box::<stand::UnarmedMotion>::default(),
        Box::<stand::ArmingMotion>::default(),
        Box::<stand::Backward>::default(),
        Box::<pulse::BrakePulse>::default(),
        Box::<pulse::SilentStop>::default(),
        Box::<pulse::KillOutput>::default(),
        Box::<proving::ProvingSpeed>::default(),
        Box::<proving::FalseProof>::default(),
        Box::<proving::Acknowledged>::default(),
        Box::<proving::FaultClears>::default(),
        Box::<proving::FalseAlarm>::default(),
        Box::<pulse::SteeringSign>::default(),
        Box::<pulse::GyroSign>::default(),
        Box::<host::CommandLimits>::default(),
        Box::<host::CommandRate>::default(),
        Box::<host::ModeAndReason>::default(),
        Box::<host::Finite>::default(),
        Box::<host::NoQueue>::default(),
        Box::<replayed::Learns>::default(),
        Box::new(replayed::Replayed::new(pilot)),
    ]
}

/// Whether the operator asks to disarm, after carrying the car or not.
fn disarms(events: &[Event]) -> bool {
    let asked = |request| events.contains(&Event::Request(request));
    asked(PilotRequest::Disarm) || asked(PilotRequest::Carried)
}
