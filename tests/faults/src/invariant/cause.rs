//! Neutral within the specified time of each stop cause.

use singletrack_pilot::{Event, Mode, PilotRequest};
use singletrack_protocol::ToBoard;
use singletrack_sim::BoardKind;

use super::{Invariant, SERVO_US, Verdict, disarms};
use crate::{
    observation::Observation,
    schedule::{FaultKind, FaultTarget},
};

/// Longest time for which a command is obeyed; see `host-silence`.
const HOST_SILENCE_US: u64 = 120_000;

/// `emergency-stop`: neutral within 50 ms of the tick that receives an emergency
/// stop request (at most 10 ms on the line, and the board's 31 ms of
/// `unarmed-drive`), and within 120 ms if line or board have a fault.
#[derive(Default)]
pub(super) struct EmergencyStop {
    requested_us: Option<u64>,
    degraded: bool,
}

const EMERGENCY_STOP_US: u64 = 50_000;

impl Invariant for EmergencyStop {
    fn name(&self) -> &'static str {
        "emergency-stop"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        let requested = observation.tick.is_some_and(|tick| {
            tick.events
                .contains(&Event::Request(PilotRequest::EmergencyStop))
        });
        if requested && self.requested_us.is_none() {
            self.requested_us = Some(observation.now_us);
            self.degraded = false;
        }
        let degrades = |target| matches!(target, FaultTarget::Line | FaultTarget::Board);
        self.degraded |= observation
            .faults
            .iter()
            .any(|fault| degrades(fault.kind.target()));
        // A later command belongs to another drive, which was requested.
        if observation
            .tick
            .is_some_and(|tick| tick.output.mode.is_underway())
        {
            self.requested_us = None;
        }
        let Some(requested_us) = self.requested_us else {
            return Ok(());
        };
        let limit_us = if self.degraded {
            HOST_SILENCE_US
        } else {
            EMERGENCY_STOP_US
        };
        for pulse in observation.pulses {
            let after_us = pulse.time_us.saturating_sub(requested_us);
            if pulse.drives() && after_us > limit_us {
                return Err(format!(
                    "ESC pulse {} µs {} ms after an emergency stop request, {} allowed",
                    pulse.esc_us,
                    after_us / 1_000,
                    limit_us / 1_000
                ));
            }
        }
        Ok(())
    }
}

/// `disarm`: neutral within the configured stop timeout and the host silence limit
/// of the tick that receives a disarm request.
#[derive(Default)]
pub(super) struct Disarm {
    requested_us: Option<u64>,
}

impl Invariant for Disarm {
    fn name(&self) -> &'static str {
        "disarm"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        if let Some(tick) = observation.tick {
            if disarms(&tick.events) && tick.output.mode.is_underway() {
                self.requested_us.get_or_insert(observation.now_us);
            } else if matches!(tick.output.mode, Mode::Arming | Mode::Driving) {
                self.requested_us = None;
            }
        }
        let Some(requested_us) = self.requested_us else {
            return Ok(());
        };
        // The tick that ends the ramp may be a period late.
        let limit_us = observation.spec.stop_timeout_us + 10_000 + HOST_SILENCE_US;
        for pulse in observation.pulses {
            let after_us = pulse.time_us.saturating_sub(requested_us);
            if pulse.drives() && after_us > limit_us {
                return Err(format!(
                    "ESC pulse {} µs {} ms after a disarm request, {} allowed",
                    pulse.esc_us,
                    after_us / 1_000,
                    limit_us / 1_000
                ));
            }
        }
        Ok(())
    }
}

/// `main-loop`: neutral within 45 ms of a hang of the board's main loop (20 ms
/// until the supervisor detects it, 1 ms until it acts, 20 ms until the next
/// pulse), until the board restarts.
#[derive(Default)]
pub(super) struct MainLoop {
    hung_us: Option<u64>,
    board_since_us: Option<u64>,
}

const MAIN_LOOP_US: u64 = 45_000;

impl Invariant for MainLoop {
    fn name(&self) -> &'static str {
        "main-loop"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        if observation.board_since_us != self.board_since_us {
            self.board_since_us = observation.board_since_us;
            self.hung_us = None;
        }
        let hangs = observation
            .new_faults
            .iter()
            .any(|fault| fault.kind == FaultKind::BoardHang);
        if hangs && self.board_since_us.is_some() {
            self.hung_us.get_or_insert(observation.now_us);
        }
        let Some(hung_us) = self.hung_us else {
            return Ok(());
        };
        for pulse in observation.pulses {
            let after_us = pulse.time_us.saturating_sub(hung_us);
            if pulse.drives() && after_us > MAIN_LOOP_US {
                return Err(format!(
                    "ESC pulse {} µs {} ms after the main loop hung",
                    pulse.esc_us,
                    after_us / 1_000
                ));
            }
        }
        Ok(())
    }
}

/// `motor-pulses`: without a motor pulse the ESC is driven beyond the deadband for at most
/// 150 ms, or over 2.5 pulse distances and 15 mm at the commanded speed (which counts from
/// 150 ms after a start) if that takes longer, and for at most 600 ms; then one servo
/// period and one round of the main loop. Pauses shorter than 150 ms do not restart this.
#[derive(Default)]
pub(super) struct MotorPulses {
    driven_us: u64,
    commanded_um: u64,
    speed_mm_s: u64,
    /// Since the last pulse.
    fastest_mm_s: u64,
    last_driven_us: u64,
}

/// Time before and after which the board detects a dead motor sensor.
const SENSOR_PATIENCE_US: u64 = 150_000;
const SENSOR_TIMEOUT_US: u64 = 600_000;
/// Way by which a car that starts off may be behind its command.
const LATE_UM: u64 = 15_000;
/// Time at a start in which the way does not count yet, in µs.
const START_US: u64 = 150_000;

impl Invariant for MotorPulses {
    fn name(&self) -> &'static str {
        "motor-pulses"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        let board = &observation.spec.board;
        for received in observation.board_received {
            match received.message {
                ToBoard::Drive(drive) => {
                    self.speed_mm_s = drive.speed_mm_s.unsigned_abs().into();
                }
                // It has no speed.
                ToBoard::Jog(_) => self.speed_mm_s = 0,
                _ => {}
            }
        }
        if !observation.is_effective(FaultKind::PulsesGone) || observation.spec.has_interference {
            self.driven_us = 0;
            self.commanded_um = 0;
            self.fastest_mm_s = 0;
            return Ok(());
        }
        let distance_um = u64::from(board.speed.pulse_distance_um);
        let patience_um = distance_um * 5 / 2 + LATE_UM;
        for pulse in observation.pulses {
            if pulse.time_us.saturating_sub(self.last_driven_us) >= SENSOR_PATIENCE_US {
                self.driven_us = 0;
                self.commanded_um = 0;
            }
            // 10 ms: a round of the main loop; 20 ms: the current frame.
            let late_us = 2 * SERVO_US + 10_000;
            let is_late = (self.driven_us > SENSOR_PATIENCE_US + late_us
                && self.commanded_um
                    > patience_um + self.fastest_mm_s * (START_US + late_us) / 1_000)
                || self.driven_us > SENSOR_TIMEOUT_US + late_us;
            if pulse.esc_us > board.esc.neutral_us + board.esc.deadband_us {
                if is_late {
                    return Err(format!(
                        "ESC pulse {} µs, driven for {} ms and {} mm without a motor pulse",
                        pulse.esc_us,
                        self.driven_us / 1_000,
                        self.commanded_um / 1_000
                    ));
                }
                self.last_driven_us = pulse.time_us;
                self.fastest_mm_s = self.fastest_mm_s.max(self.speed_mm_s);
                self.driven_us += SERVO_US;
                self.commanded_um += self.speed_mm_s * SERVO_US / 1_000;
            }
        }
        Ok(())
    }
}

/// `imu-silence`: the host follows its reference no longer than the configured time
/// after the last IMU sample that it accepted.
///
/// Counted from the time that samples stop, when the last one is at most 10 ms old, and that
/// nothing delays the line.
#[derive(Default)]
pub(super) struct ImuSilence {
    silent_us: Option<u64>,
}

impl Invariant for ImuSilence {
    fn name(&self) -> &'static str {
        "imu-silence"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        let is_delayed = observation.is_active(FaultKind::LineDelay);
        if observation.is_effective(FaultKind::ImuSilent) && !is_delayed {
            self.silent_us.get_or_insert(observation.now_us);
        } else {
            self.silent_us = None;
        }
        let (Some(silent_us), Some(tick)) = (self.silent_us, observation.tick) else {
            return Ok(());
        };
        // 1.2 ms of transmission, and the error of the board's clock. The image
        // polls the sensor every 10 ms and dates a sample by the poll. A constant
        // delay of the line can't be distinguished from a clock offset and makes
        // samples look younger.
        let poll_us = match observation.spec.situation.board {
            BoardKind::Native => 0,
            BoardKind::Uno => 10_000,
        };
        let late_us = u64::from(observation.spec.situation.serial_delay_us);
        let limit_us = observation.spec.imu_silence_us + 5_000 + poll_us + late_us;
        let after_us = observation.now_us.saturating_sub(silent_us);
        if tick.output.mode == Mode::Driving && after_us > limit_us {
            return Err(format!(
                "driving {} ms after the IMU fell silent, {} allowed",
                after_us / 1_000,
                limit_us / 1_000
            ));
        }
        Ok(())
    }
}

/// `imu-stuck`: the host follows its reference no longer than needed to detect
/// repeated IMU samples: the configured number of samples plus one, and 30 ms until
/// the last of them is sent and received, if no other fault delays samples.
#[derive(Default)]
pub(super) struct ImuStuck {
    stuck_us: Option<u64>,
}

const IMU_PERIOD_US: u64 = 10_000;

impl Invariant for ImuStuck {
    fn name(&self) -> &'static str {
        "imu-stuck"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        let undisturbed = observation.faults.iter().all(|fault| {
            fault.kind == FaultKind::ImuStuck || matches!(fault.kind.target(), FaultTarget::Cameras)
        });
        if observation.is_effective(FaultKind::ImuStuck) && undisturbed {
            self.stuck_us.get_or_insert(observation.now_us);
        } else {
            self.stuck_us = None;
        }
        let (Some(stuck_us), Some(tick)) = (self.stuck_us, observation.tick) else {
            return Ok(());
        };
        let samples = u64::from(observation.spec.stuck_samples) + 1;
        let limit_us = samples * IMU_PERIOD_US + 30_000;
        let after_us = observation.now_us.saturating_sub(stuck_us);
        if tick.output.mode == Mode::Driving && samples > 1 && after_us > limit_us {
            return Err(format!(
                "driving {} ms after the IMU began to repeat itself, {} allowed",
                after_us / 1_000,
                limit_us / 1_000
            ));
        }
        Ok(())
    }
}

/// `setpoint-silence`: a car whose reference is external does not drive on by a
/// set-point that is older than its time-out.
#[derive(Default)]
pub(super) struct SetpointSilence;

impl Invariant for SetpointSilence {
    fn name(&self) -> &'static str {
        "setpoint-silence"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        let (Some(tick), Some(timeout_ns)) =
            (observation.tick, observation.spec.setpoint_timeout_ns)
        else {
            return Ok(());
        };
        if tick.output.mode != Mode::Driving {
            return Ok(());
        }
        let newest_ns = observation.newest_setpoint_ns.unwrap_or(0);
        let age_ns = tick.pilot_time.0.saturating_sub(newest_ns);
        if age_ns > timeout_ns {
            return Err(format!(
                "driving by a set-point of {} ms ago, {} allowed",
                age_ns / 1_000_000,
                timeout_ns / 1_000_000
            ));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observation::scene::Scene;

    #[test]
    fn a_late_pulse_after_a_disarm_request_is_found() {
        let scene = Scene::new();
        let observation = scene.observation(0);
        let requested = |ms_ago: u64| Disarm {
            requested_us: Some(observation.now_us - ms_ago * 1_000),
        };
        assert_eq!(requested(1_620).check(&observation), Ok(()));
        let late = requested(1_640).check(&observation);
        assert!(late.is_err_and(|details| details.contains("1640 ms after a disarm request")));
    }
}
