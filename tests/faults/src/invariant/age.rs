//! Limits on the age of commands and poses behind a driving pulse.

use singletrack_pilot::Mode;
use singletrack_protocol::{COMMAND_TIME_TO_LIVE_US, ToBoard};

use super::{Invariant, SERVO_US, Verdict};
use crate::observation::{Observation, ReceivedPose};

/// The period of the supervising interrupt, and the largest lag of its clock, in
/// µs.
const SUPERVISOR_US: u64 = 2_000;

/// Clock error over 100 ms at 0.5 %, in µs.
const SKEW_US: u64 = 500;

/// `command-age`: a driving pulse begins within 95 ms, one servo period and 2 ms of
/// the supervisor (its period and its clock's lag) of the telemetry behind the
/// newest command, by the board's clock.
#[derive(Default)]
pub(super) struct CommandAge {
    newest_us: Option<u32>,
    board_since_us: Option<u64>,
}

impl Invariant for CommandAge {
    fn name(&self) -> &'static str {
        "command-age"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        if observation.board_since_us != self.board_since_us {
            self.board_since_us = observation.board_since_us;
            self.newest_us = None;
        }
        for received in observation.board_received {
            let telemetry_time_us = match received.message {
                ToBoard::Drive(drive) => drive.telemetry_time_us,
                ToBoard::Jog(jog) => jog.telemetry_time_us,
                _ => continue,
            };
            let age = |us: u32| received.board_time_us.wrapping_sub(us);
            let is_newer = self
                .newest_us
                .is_none_or(|newest| age(telemetry_time_us) < age(newest));
            if is_newer && age(telemetry_time_us) < u32::MAX / 2 {
                self.newest_us = Some(telemetry_time_us);
            }
        }
        let limit_us = u64::from(COMMAND_TIME_TO_LIVE_US) + SERVO_US + SUPERVISOR_US;
        for pulse in observation.pulses {
            if !pulse.drives() || observation.board_since_us.is_none() {
                continue;
            }
            let Some(newest_us) = self.newest_us else {
                return Err(format!("ESC pulse {} µs without a command", pulse.esc_us));
            };
            let age_us = pulse.board_time_us.wrapping_sub(newest_us);
            // A command received during the pulse has a negative age.
            if age_us < u32::MAX / 2 && u64::from(age_us) > limit_us {
                return Err(format!(
                    "ESC pulse {} µs with a command {} ms old, {} allowed",
                    pulse.esc_us,
                    age_us / 1_000,
                    limit_us / 1_000
                ));
            }
        }
        Ok(())
    }
}

/// `host-silence`: neutral within 120 ms of the host's last command, whether the
/// daemon pauses or ends, or the line is stuck or unplugged.
///
/// The command can't be newer than the telemetry behind it.
#[derive(Default)]
pub(super) struct HostSilence {
    written_us: Option<u64>,
}

const HOST_SILENCE_US: u64 = 120_000;

impl Invariant for HostSilence {
    fn name(&self) -> &'static str {
        "host-silence"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        let commands = |message: &ToBoard| matches!(message, ToBoard::Drive(_) | ToBoard::Jog(_));
        if observation.written.iter().any(commands) {
            self.written_us = Some(observation.now_us);
        }
        for pulse in observation.pulses {
            if !pulse.drives() {
                continue;
            }
            let after_us = pulse.time_us.saturating_sub(self.written_us.unwrap_or(0));
            if after_us > HOST_SILENCE_US {
                return Err(format!(
                    "ESC pulse {} µs {} ms after the host's last command",
                    pulse.esc_us,
                    after_us / 1_000
                ));
            }
        }
        Ok(())
    }
}

/// Error of the host's exposure time and of the board's telemetry time, in µs: half
/// a round trip each, and the rounding to milliseconds.
const CLOCKS_US: u64 = 4_000;

/// `pose-age`: no pulse drives if the newest pose received by the host was exposed
/// longer ago than the configured limit of the board plus one servo period.
///
/// The true error of the stamps is allowed: the host can't know it. After a step of the
/// server's clock, the age of a pose counts from its arrival:
/// the host can't know the exposure time. A jog needs no pose.
#[derive(Default)]
pub(super) struct PoseAge {
    newest: Option<ReceivedPose>,
}

impl Invariant for PoseAge {
    fn name(&self) -> &'static str {
        "pose-age"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        // Keeps the pose of a killed daemon, whose last command may still be in force.
        self.newest = observation.newest_pose.or(self.newest);
        let limit_us = u64::from(observation.spec.board.max_pose_age_ms) * 1_000
            + SERVO_US
            + SUPERVISOR_US
            + CLOCKS_US
            + 10 * SKEW_US
            + observation.spec.stamp_error_us(observation.now_us);
        for pulse in observation.pulses {
            if !pulse.drives() || observation.jogs {
                continue;
            }
            let since_us = self.newest.map_or(0, |pose| pose.since_us());
            let age_us = pulse.time_us.saturating_sub(since_us);
            if age_us > limit_us {
                return Err(format!(
                    "ESC pulse {} µs with a pose {} ms old, {} allowed",
                    pulse.esc_us,
                    age_us / 1_000,
                    limit_us / 1_000
                ));
            }
        }
        Ok(())
    }
}

/// `host-hold`: the host follows its reference no longer than the configured hold
/// time after the exposure of the newest received pose, and slows down no longer
/// than the configured blind time.
#[derive(Default)]
pub(super) struct HostHold;

impl Invariant for HostHold {
    fn name(&self) -> &'static str {
        "host-hold"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        let Some(tick) = observation.tick else {
            return Ok(());
        };
        let mode = tick.output.mode;
        let limit_us = match mode {
            Mode::Driving => observation.spec.hold_us,
            Mode::Slowing => observation.spec.blind_us,
            _ => return Ok(()),
        } + CLOCKS_US
            + observation.spec.stamp_error_us(observation.now_us);
        let since_us = observation.newest_pose.map_or(0, |pose| pose.since_us());
        let age_us = observation.now_us.saturating_sub(since_us);
        if age_us > limit_us {
            return Err(format!(
                "{mode} on a pose {} ms old, {} allowed",
                age_us / 1_000,
                limit_us / 1_000
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
    fn a_pulse_on_a_pose_beyond_the_boards_limit_is_found() {
        let scene = Scene::new();
        assert_eq!(
            PoseAge::default().check(&scene.observation(950_000)),
            Ok(())
        );
        let old = PoseAge::default().check(&scene.observation(986_000));
        assert!(old.is_err_and(|details| details.contains("986 ms old, 981 allowed")));
        // After a step of the server's clock, the age counts from the arrival.
        let mut stepped = scene.observation(986_000);
        if let Some(pose) = &mut stepped.newest_pose {
            pose.exposure.clock_trusted = false;
        }
        assert_eq!(PoseAge::default().check(&stepped), Ok(()));
    }
}
