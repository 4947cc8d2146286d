//! Brake pulses, the silence after an emergency stop, and the kill output.

use singletrack_protocol::{BoardMode, StopCause};

use super::{Invariant, SERVO_US, Verdict};
use crate::{
    observation::Observation,
    pins::{BRAKE_US, Forward, START_PULSE_US},
    schedule::{Fault, FaultKind},
    spec::TOLERANCE_US,
};

/// `brake-pulse`: while reverse is disabled, a pulse below the deadband is the brake pulse
/// of a board that may brake. It comes once after driving forward beyond the deadband for
/// 60 ms (three servo frames without a pause, so that the ESC has seen it), lasts at most half a
/// second, and ends when the wheels have stood for as long as the board needs to tell; it
/// can't tell where interference makes edges.
#[derive(Default)]
pub(super) struct BrakePulse {
    since_us: Option<u64>,
    last_us: u64,
    forward: Forward,
    stood_us: Option<u64>,
}

/// Time in which the board tells that the wheels stand, in µs: 150 ms without a motor
/// pulse, the pulse in progress and the round of the main loop; and for every millimetre
/// between two motor pulses beyond three, 20 ms.
fn standstill_us(pulse_distance_um: u16) -> u64 {
    let beyond_um = u64::from(pulse_distance_um).saturating_sub(3_000);
    200_000 + beyond_um * 20
}

impl Invariant for BrakePulse {
    fn name(&self) -> &'static str {
        "brake-pulse"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        let spec = observation.spec;
        let esc = &spec.board.esc;
        if spec.board.speed.max_reverse_mm_s != 0 {
            return Ok(());
        }
        if observation.truth.wheel_speed.abs() > 0.005 {
            self.stood_us = None;
        } else {
            self.stood_us.get_or_insert(observation.now_us);
        }
        for pulse in observation.pulses {
            // An operator who jogs may ask for reverse.
            let below = pulse.esc_us != 0
                && !pulse.cut
                && !observation.jogs
                && pulse.esc_us < esc.neutral_us - esc.deadband_us;
            if !below {
                if self.since_us.take().is_some() {
                    self.forward = Forward::default();
                }
                self.forward.frame(spec, pulse);
                continue;
            }
            self.last_us = pulse.time_us;
            let since_us = *self.since_us.get_or_insert(pulse.time_us);
            let found = if !spec.brakes() {
                "of a board that must not brake"
            } else if !self.forward.has_driven() {
                "without a drive forward before it"
            } else if pulse.time_us - since_us > BRAKE_US {
                "for over half a second"
            } else if !spec.has_interference
                && self.stood_us.is_some_and(|stood_us| {
                    pulse.time_us > stood_us + standstill_us(spec.board.speed.pulse_distance_um)
                })
            {
                "although the wheels stand"
            } else {
                continue;
            };
            return Err(format!(
                "ESC pulse {} µs {found}, {} ms after the first one",
                pulse.esc_us,
                (pulse.time_us - since_us) / 1_000
            ));
        }
        Ok(())
    }
}

/// `silent-stop`: a board that has latched an emergency stop gives a pulse of 1500 µs for
/// 200 ms, then no ESC pulses until it is reset: an ESC that takes the configured neutral
/// for a drive stops too. One that has latched because the car runs at neutral gives no
/// more pulse. In both cases the frame in progress is completed first.
///
/// A main loop that hangs in these 200 ms can't end the pulses: they stay at 1500 µs until the
/// watchdog resets the board, 110 ms later.
#[derive(Default)]
pub(super) struct SilentStop {
    latched_us: Option<u64>,
    hung_us: Option<u64>,
    board_since_us: Option<u64>,
}

/// Time for which it is given, on a clock that may be 0.5 % slow; the frame in progress at
/// its end; and the period of the telemetry that shows the stop.
const NEUTRAL_FOR_US: u64 = 201_000;
const TELEMETRY_US: u64 = 10_000;

/// Time from a hang to the watchdog's reset, in µs.
const WATCHDOG_US: u64 = 110_000;

impl Invariant for SilentStop {
    fn name(&self) -> &'static str {
        "silent-stop"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        if observation.board_since_us != self.board_since_us {
            self.board_since_us = observation.board_since_us;
            self.latched_us = None;
            self.hung_us = None;
        }
        let hangs = |fault: &Fault| fault.kind == FaultKind::BoardHang;
        if observation.new_faults.iter().any(hangs) {
            self.hung_us.get_or_insert(observation.now_us);
        }
        if observation.board_mode == Some(BoardMode::EmergencyStopped) {
            self.latched_us.get_or_insert(observation.now_us);
        }
        let Some(latched_us) = self.latched_us else {
            return Ok(());
        };
        let runs = observation.board_cause == Some(StopCause::RunsAtNeutral);
        let neutral_us = if runs { 0 } else { NEUTRAL_FOR_US };
        let found = observation.pulses.iter().find(|pulse| {
            // The telemetry may arrive before the pulse that it describes.
            let after_us = pulse.time_us.saturating_sub(latched_us + SERVO_US + 1_000);
            let is_neutral = pulse.esc_us.abs_diff(START_PULSE_US) <= TOLERANCE_US;
            let hangs = self.hung_us.is_some_and(|hung_us| {
                hung_us <= latched_us + neutral_us && pulse.time_us <= hung_us + WATCHDOG_US
            });
            let is_late = after_us > neutral_us + TELEMETRY_US && !hangs;
            pulse.esc_us != 0 && after_us > 0 && (is_late || !is_neutral)
        });
        match found {
            Some(pulse) => Err(format!(
                "ESC pulse {} µs {} ms after a stop was latched{}",
                pulse.esc_us,
                (pulse.time_us - latched_us) / 1_000,
                if runs {
                    ", because the car runs at neutral"
                } else {
                    ""
                }
            )),
            None => Ok(()),
        }
    }
}

/// `kill-output`: the ESC has no power while a board with a kill output is not armed, from
/// 100 ms on: telemetry every 10 ms, a round of the main loop, and the relay.
#[derive(Default)]
pub(super) struct KillOutput {
    since_us: Option<u64>,
}

const CUT_US: u64 = 100_000;

impl Invariant for KillOutput {
    fn name(&self) -> &'static str {
        "kill-output"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        if !observation.spec.situation.kill_output
            || observation.board_is_armed
            || !observation.esc_has_power
        {
            self.since_us = None;
            return Ok(());
        }
        let since_us = *self.since_us.get_or_insert(observation.now_us);
        if observation.now_us - since_us <= CUT_US {
            return Ok(());
        }
        Err("the ESC has power while the board is not armed".to_owned())
    }
}
