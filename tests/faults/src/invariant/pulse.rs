//! Limits on the pulses; brake pulses, the silence after an emergency stop, and the kill output;
//! signs: the car turns the way it steers, and the gyroscope the way the car turns.

use singletrack_pilot::{Event, Mode};
use singletrack_protocol::{BoardMode, StopCause};
use singletrack_sim::PulseRecord;

use super::{Invariant, SERVO_US, Verdict};
use crate::{
    observation::Observation,
    pins::{BRAKE_US, Forward, START_PULSE_US},
    schedule::{Fault, FaultKind},
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

/// How long the board takes to know that the wheels stand, in µs: 150 ms without a motor
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

/// The way that a contradiction may last, in m.
const CONTRADICTED_M: f64 = 0.5;

/// The way that a contradiction may last once the configuration has been proved: the servo has broken
/// since, in m.
const BROKEN_M: f64 = 1.2;

/// The way driven while something is contradicted.
#[derive(Default)]
struct Way {
    metres: f64,
}

impl Way {
    /// Adds the way of a tick; an agreement ends the contradiction, and what shows neither
    /// leaves it.
    fn tick(&mut self, contradicted: Option<bool>, metres: f64) -> f64 {
        match contradicted {
            Some(true) => self.metres += metres,
            Some(false) => self.metres = 0.0,
            None => {}
        }
        self.metres
    }
}

fn is_driving(mode: Mode) -> bool {
    matches!(mode, Mode::Driving | Mode::Slowing)
}

/// `steering-sign`: a car that turns against its steering command does not drive on for
/// half a metre; if its configuration has been proved, for 1.2 m: the watch compares twice over 0.4 m,
/// and may have begun a comparison before.
///
/// Bends of less than 0.2/m and commands of less than 0.1 rad show no sign; the command is
/// that of 0.3 s ago, which servo and car need.
#[derive(Default)]
pub(super) struct SteeringSign {
    way: Way,
    commands: std::collections::VecDeque<f64>,
}

const SERVO_TICKS: usize = 30;

impl Invariant for SteeringSign {
    fn name(&self) -> &'static str {
        "steering-sign"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        let Some(tick) = observation.tick else {
            return Ok(());
        };
        if !is_driving(tick.output.mode) {
            *self = Self::default();
            return Ok(());
        }
        self.commands.push_back(tick.output.actuation.steering);
        if self.commands.len() <= SERVO_TICKS {
            return Ok(());
        }
        self.commands.pop_front();
        // All commands of the last 0.3 s steer to one side.
        let least = self.commands.iter().copied().fold(f64::MAX, f64::min);
        let most = self.commands.iter().copied().fold(f64::MIN, f64::max);
        let side = if least > 0.1 {
            1.0
        } else if most < -0.1 {
            -1.0
        } else {
            0.0
        };
        let truth = &observation.truth;
        let bends = truth.speed > 0.1 && (truth.yaw_rate / truth.speed).abs() > 0.2;
        let contradicted = (side != 0.0 && bends).then_some(truth.yaw_rate * side < 0.0);
        let way = self
            .way
            .tick(contradicted, truth.speed * observation.spec.period_s);
        let limit = if observation.is_proved {
            BROKEN_M
        } else {
            CONTRADICTED_M
        };
        if way > limit {
            return Err(format!("{way:.2} m driven against the steering"));
        }
        Ok(())
    }
}

/// `gyro-sign`: a car whose gyroscope measures a turn to the other side does not drive on
/// for half a metre.
#[derive(Default)]
pub(super) struct GyroSign {
    way: Way,
}

impl Invariant for GyroSign {
    fn name(&self) -> &'static str {
        "gyro-sign"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        let Some(tick) = observation.tick else {
            return Ok(());
        };
        if !is_driving(tick.output.mode) {
            *self = Self::default();
            return Ok(());
        }
        let truth = &observation.truth;
        let mut measured = tick.events.iter().filter_map(|event| match event {
            Event::Board(sample) => Some(sample.inertial?.yaw_rate),
            _ => None,
        });
        let turns = truth.yaw_rate.abs() > 0.2;
        let contradicted = measured
            .next_back()
            .filter(|_| turns)
            .map(|rate| rate * truth.yaw_rate.signum() < -0.1);
        let way = self
            .way
            .tick(contradicted, truth.speed * observation.spec.period_s);
        if way > CONTRADICTED_M {
            return Err(format!("{way:.2} m driven against the gyroscope"));
        }
        Ok(())
    }
}
