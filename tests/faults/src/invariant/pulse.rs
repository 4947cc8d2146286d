//! Limits on the pulses.

use singletrack_sim::PulseRecord;

use super::{Invariant, SERVO_US, Verdict};
use crate::{
    observation::Observation,
    pins::START_PULSE_US,
    spec::{Spec, TOLERANCE_US},
};

/// `pulse-limits`: every pulse is absent or within the configured limits, and none
/// drives in reverse, which no configuration here allows, but an operator who jogs.
///
/// A pulse cut by a reset may be shorter.
#[derive(Default)]
pub(super) struct Limits;

impl Invariant for Limits {
    fn name(&self) -> &'static str {
        "pulse-limits"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        let (servo, esc) = (&observation.spec.board.servo, &observation.spec.board.esc);
        for pulse in observation.pulses {
            for (name, us, least, most) in [
                ("servo", pulse.servo_us, servo.min_us, servo.max_us),
                ("ESC", pulse.esc_us, esc.min_us, esc.max_us),
            ] {
                let least = if pulse.cut { 0 } else { least - TOLERANCE_US };
                if us != 0 && !(least..=most + TOLERANCE_US).contains(&us) {
                    return Err(format!("{name} pulse {us} µs, allowed {least} to {most}"));
                }
            }
            if pulse.esc_us < esc.neutral_us && pulse.drives() && !observation.jogs {
                return Err(format!("ESC pulse {} µs drives in reverse", pulse.esc_us));
            }
        }
        Ok(())
    }
}

/// Longest period of the board's main loop, in µs: two frames may be decided this
/// much farther apart than one servo period.
const POLL_US: u64 = 10_000;

/// Largest change of a pulse between two frames.
fn slew_us(per_20ms: u16, before: &PulseRecord, after: &PulseRecord) -> u16 {
    let apart_us = u64::from(after.board_time_us.wrapping_sub(before.board_time_us));
    let us = u64::from(per_20ms) * (apart_us + POLL_US) / SERVO_US;
    u16::try_from(us)
        .unwrap_or(u16::MAX)
        .saturating_add(2 * TOLERANCE_US)
}

/// `servo-slew`: between two frames the servo's pulse changes by no more than the
/// configured rate allows for the time between them and one round of the main loop.
/// The first pulse after a pause is free.
#[derive(Default)]
pub(super) struct ServoSlew {
    last: Option<PulseRecord>,
}

impl Invariant for ServoSlew {
    fn name(&self) -> &'static str {
        "servo-slew"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        for pulse in observation.pulses {
            let last = self.last.replace(pulse.record);
            let Some(last) = last.filter(|last| last.servo_us != 0 && pulse.servo_us != 0) else {
                continue;
            };
            let most = slew_us(observation.spec.board.servo.slew_us_per_20ms, &last, pulse);
            let change = pulse.servo_us.abs_diff(last.servo_us);
            if change > most && !pulse.cut {
                return Err(format!(
                    "servo pulse from {} to {} µs, at most {most} µs allowed",
                    last.servo_us, pulse.servo_us
                ));
            }
        }
        Ok(())
    }
}

/// `esc-slew`: away from neutral the ESC's pulse changes by no more than
/// configured; changes to neutral, to the brake, and to the start pulse of an emergency stop
/// are immediate.
#[derive(Default)]
pub(super) struct EscSlew {
    last: Option<PulseRecord>,
}

impl EscSlew {
    fn above_neutral(spec: &Spec, pulse: &PulseRecord) -> u16 {
        pulse.esc_us.saturating_sub(spec.board.esc.neutral_us)
    }
}

impl Invariant for EscSlew {
    fn name(&self) -> &'static str {
        "esc-slew"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        for pulse in observation.pulses {
            let last = self.last.replace(pulse.record);
            let Some(last) = last else { continue };
            let (from, to) = (
                Self::above_neutral(observation.spec, &last),
                Self::above_neutral(observation.spec, pulse),
            );
            let most = slew_us(observation.spec.board.esc.slew_us_per_20ms, &last, pulse);
            if to.saturating_sub(from) > most && pulse.esc_us != START_PULSE_US {
                return Err(format!(
                    "ESC pulse from {} to {} µs, at most {most} µs more allowed",
                    last.esc_us, pulse.esc_us
                ));
            }
        }
        Ok(())
    }
}

/// `neutral-first`: no pulse drives in the first two seconds after the board's
/// start, in which the ESC arms. (By the board's clock, which may be 0.5 % fast.)
#[derive(Default)]
pub(super) struct NeutralFirst;

const NEUTRAL_FIRST_US: u64 = 1_990_000;

impl Invariant for NeutralFirst {
    fn name(&self) -> &'static str {
        "neutral-first"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        for pulse in observation.pulses {
            if !pulse.drives() {
                continue;
            }
            // A board that is not running makes no pulses.
            let Some(since_us) = observation.board_since_us else {
                continue;
            };
            let age_us = pulse.time_us.saturating_sub(since_us);
            if pulse.time_us >= since_us && age_us < NEUTRAL_FIRST_US {
                return Err(format!(
                    "ESC pulse {} µs {} ms after the board started",
                    pulse.esc_us,
                    age_us / 1_000
                ));
            }
        }
        Ok(())
    }
}
