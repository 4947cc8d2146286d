//! What board and link say, as the words of status and log.

use singletrack_link::{LossCause, RestartEvidence};
use singletrack_protocol::{BoardMode, RefusalReason, Request, StopCause};
use singletrack_record::LinkPhase;

/// The word that status, log and record use.
#[must_use]
pub const fn link_name(phase: LinkPhase) -> &'static str {
    match phase {
        LinkPhase::Disconnected => "disconnected",
        LinkPhase::Greeting => "greeting",
        LinkPhase::VersionMismatch => "version-mismatch",
        LinkPhase::Configuring => "configuring",
        LinkPhase::ConfigurationRefused => "configuration-refused",
        LinkPhase::Ready => "ready",
    }
}

/// The word that status, log and record use.
#[must_use]
pub const fn board_mode_name(mode: BoardMode) -> &'static str {
    match mode {
        BoardMode::Boot => "boot",
        BoardMode::Neutral => "neutral",
        BoardMode::Armed => "armed",
        BoardMode::Driving => "driving",
        BoardMode::Failsafe => "failsafe",
        BoardMode::EmergencyStopped => "emergency-stopped",
    }
}

/// The word that status, log and record use.
#[must_use]
pub const fn stop_cause_name(cause: StopCause) -> &'static str {
    match cause {
        StopCause::None => "none",
        StopCause::Disarmed => "disarmed",
        StopCause::CommandTimeout => "command-timeout",
        StopCause::PoseTooOld => "pose-too-old",
        StopCause::MotorSensor => "motor-sensor",
        StopCause::StopInput => "stop-input",
        StopCause::EmergencyStop => "emergency-stop",
        StopCause::HostRestarted => "host-restarted",
    }
}

/// The word that status, log and record use.
#[must_use]
pub const fn request_name(request: Request) -> &'static str {
    match request {
        Request::Configure => "configure",
        Request::Arm => "arm",
        Request::Disarm => "disarm",
        Request::EmergencyStop => "emergency-stop",
    }
}

/// The word that status, log and record use.
#[must_use]
pub const fn refusal_name(reason: RefusalReason) -> &'static str {
    match reason {
        RefusalReason::None => "none",
        RefusalReason::NotConfigured => "not-configured",
        RefusalReason::ConfigurationDiffers => "configuration-differs",
        RefusalReason::InvalidConfiguration => "invalid-configuration",
        RefusalReason::Busy => "busy",
        RefusalReason::NotYetNeutral => "not-yet-neutral",
        RefusalReason::Moving => "moving",
        RefusalReason::StopInputOpen => "stop-input-open",
        RefusalReason::EmergencyStopLatched => "emergency-stop-latched",
        RefusalReason::Stale => "stale",
        RefusalReason::OutOfSequence => "out-of-sequence",
        RefusalReason::PoseTooOld => "pose-too-old",
        RefusalReason::NotArmed => "not-armed",
        RefusalReason::ReverseDisabled => "reverse-disabled",
        RefusalReason::VersionDiffers => "version-differs",
    }
}

/// The word that status, log and record use.
#[must_use]
pub const fn restart_name(evidence: RestartEvidence) -> &'static str {
    match evidence {
        RestartEvidence::Announced => "announced",
        RestartEvidence::ClockRestarted => "clock-restarted",
        RestartEvidence::ConfigurationGone => "configuration-gone",
    }
}

/// The word that status, log and record use.
#[must_use]
pub const fn loss_name(cause: LossCause) -> &'static str {
    match cause {
        LossCause::Silence => "silence",
        LossCause::HangUp => "hang-up",
    }
}
