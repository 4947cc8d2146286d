//! The host's commands and outputs, whether obeyed or not; the grid of its ticks, and its alignment
//! to the cameras.

use core::ops::RangeInclusive;

use singletrack_control::Time;
use singletrack_pilot::{Event, Mode, Output, PoseMissing};
use singletrack_protocol::ToBoard;

use super::{Invariant, Verdict};
use crate::{
    daemon::host_ns,
    observation::Observation,
    schedule::{FaultKind, FaultTarget},
};

/// Half of the wire format's resolution: 1 mm/s, 0.1 mrad.
const SPEED_STEP: f64 = 0.000_5;
const STEERING_STEP: f64 = 0.000_05;

/// `command-limits`: every command is within the configured speed and angle of the front
/// wheels, to half a step of the wire format.
#[derive(Default)]
pub(super) struct CommandLimits;

impl Invariant for CommandLimits {
    fn name(&self) -> &'static str {
        "command-limits"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        let spec = observation.spec;
        for message in observation.written {
            let ToBoard::Drive(drive) = message else {
                continue;
            };
            let speed = f64::from(drive.speed_mm_s) * 1e-3;
            let steering = spec.believed_angle(f64::from(drive.steering_100urad) * 1e-4);
            if speed > spec.max_speed + SPEED_STEP || speed < -spec.max_reverse_speed - SPEED_STEP {
                return Err(format!("speed command of {speed:.3} m/s"));
            }
            if steering.abs() > spec.max_steering + STEERING_STEP {
                return Err(format!("steering command of {steering:.4} rad"));
            }
        }
        Ok(())
    }
}

/// `command-rate`: between two commands, the speed of G changes by no more than the
/// configured acceleration (or stop deceleration) allows in a period, and the
/// steering angle by no more than its rate does. A drive starts at zero speed. While the
/// car is told to roll out, the speed falls with it; a stop makes up for late ticks.
#[derive(Default)]
pub(super) struct CommandRate {
    last: Option<(f64, f64)>,
    last_tick: Option<Time>,
    rolled: bool,
}

impl Invariant for CommandRate {
    fn name(&self) -> &'static str {
        "command-rate"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        let Some(tick) = observation.tick else {
            return Ok(());
        };
        let last_tick = self.last_tick.replace(tick.pilot_time);
        if tick.output.command.is_none() {
            // A stopping car whose estimate restarts has no command for a tick.
            if !tick.output.mode.is_underway() {
                self.last = None;
            }
            return Ok(());
        }
        let actuation = tick.output.actuation;
        let spec = observation.spec;
        let (speed, steering) = self.last.unwrap_or((0.0, actuation.steering));
        let most = spec.max_acceleration.max(spec.stop_deceleration) * spec.period_s;
        let change = (actuation.speed - speed).abs();
        // A car that is told to roll out is commanded the speed to which it has rolled.
        let rolls = tick
            .output
            .command
            .is_some_and(|command| command.rear_speed == 0.0);
        let falls = actuation.speed < speed && (rolls || self.rolled);
        self.rolled = rolls;
        let elapsed = last_tick.map_or(0.0, |last| tick.pilot_time.seconds_since(last));
        let periods = if tick.output.mode == Mode::Driving {
            1.0
        } else {
            libm::rint(elapsed / spec.period_s).max(1.0)
        };
        if change > periods * most + 1e-9 && !falls {
            return Err(format!(
                "speed commanded from {speed} to {} m/s in a period, {most} allowed",
                actuation.speed
            ));
        }
        let most = spec.max_steering_rate * spec.period_s;
        let change = (actuation.steering - steering).abs();
        if change > most + 1e-9 {
            return Err(format!(
                "steering commanded from {steering} to {} rad in a period, {most} allowed",
                actuation.steering
            ));
        }
        self.last = Some((actuation.speed, actuation.steering));
        Ok(())
    }
}

/// `mode-and-reason`: a car that does not drive has a reason, a car that drives has
/// none, and commands are given only in modes that drive.
#[derive(Default)]
pub(super) struct ModeAndReason;

impl Invariant for ModeAndReason {
    fn name(&self) -> &'static str {
        "mode-and-reason"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        let Some(tick) = observation.tick else {
            return Ok(());
        };
        let Output {
            mode,
            reason,
            command,
            jog,
            ..
        } = tick.output;
        let is_consistent = match mode {
            Mode::Driving | Mode::Arming | Mode::Jogging => reason.is_none(),
            // The reason why the last drive ended, if any.
            Mode::Ready => true,
            _ => reason.is_some(),
        };
        if !is_consistent {
            return Err(format!("mode {mode} with reason {reason:?}"));
        }
        if command.is_some() && !mode.commands() {
            return Err(format!("a command in mode {mode}"));
        }
        if jog.is_some() && mode != Mode::Jogging {
            return Err(format!("pulses of a jog in mode {mode}"));
        }
        if mode == Mode::Driving && command.is_none() {
            return Err("driving without a command".to_owned());
        }
        Ok(())
    }
}

/// `finite`: every output of the pilot is finite.
#[derive(Default)]
pub(super) struct Finite;

impl Invariant for Finite {
    fn name(&self) -> &'static str {
        "finite"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        let Some(tick) = observation.tick else {
            return Ok(());
        };
        let output = &tick.output;
        let mut values = vec![
            output.actuation.speed,
            output.actuation.steering,
            output.actuation.steering_rate,
        ];
        values.extend(output.drive_time);
        if let Some(estimate) = &output.estimate {
            values.extend([
                estimate.position.x,
                estimate.position.y,
                estimate.yaw,
                estimate.yaw_rate,
                estimate.sideslip,
                estimate.speed,
            ]);
        }
        if let Some(point) = &output.point {
            values.extend([point.x, point.y]);
        }
        if let Some(velocity) = &output.point_velocity {
            values.extend([velocity.x, velocity.y]);
        }
        if let Some(command) = &output.command {
            values.extend([command.rear_speed, command.steering]);
        }
        match values.iter().find(|value| !value.is_finite()) {
            Some(value) => Err(format!("{value} in {output:?}")),
            None => Ok(()),
        }
    }
}

/// `no-queue`: at most two commands are written to a board that does not send.
#[derive(Default)]
pub(super) struct NoQueue {
    unanswered: u32,
}

impl Invariant for NoQueue {
    fn name(&self) -> &'static str {
        "no-queue"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        if observation.has_read {
            self.unanswered = 0;
        }
        for message in observation.written {
            self.unanswered += u32::from(matches!(message, ToBoard::Drive(_) | ToBoard::Jog(_)));
        }
        if self.unanswered > 2 {
            return Err(format!("{} commands to a silent board", self.unanswered));
        }
        Ok(())
    }
}

/// Largest slide of the grid in a tick while the car stands and while it is underway, as
/// a divisor of the period.
const SLIDE_STANDING: u64 = 20;
const SLIDE_UNDERWAY: u64 = 500;

/// The time before its deadline in which a frame may begin a tick, in ns: 3 ms, or less if the
/// period is short.
const WINDOW_NS: u64 = 3_000_000;
/// The most that this time may be, as a part of the period.
const WINDOW_PART: (u64, u64) = (3, 10);

/// `tick-grid`: the deadlines are a period apart, except for the slide towards the cameras. A
/// tick is due at its deadline, or with a frame up to 3 ms before it, and begins before the next
/// deadline.
#[derive(Default)]
pub(super) struct TickGrid {
    last: Option<(RangeInclusive<u64>, Mode)>,
}

/// Whether a frame may have begun this tick.
fn is_begun_by_frame(event: &Event, due_ns: u64, period_ns: u64) -> bool {
    match event {
        // It arrived when the tick was due, or within half a period before the deadline and was
        // kept waiting: the window was not open, or the tick before had been late.
        Event::Pose(pose) => (pose.receive.0..=pose.receive.0 + period_ns / 2).contains(&due_ns),
        Event::PoseMissing(missing) => *missing != PoseMissing::Stale,
        _ => false,
    }
}

impl Invariant for TickGrid {
    fn name(&self) -> &'static str {
        "tick-grid"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        let Some(tick) = observation.tick else {
            return Ok(());
        };
        let period_ns = (observation.spec.period_s * 1e9) as u64;
        let window_ns = WINDOW_NS.min(period_ns * WINDOW_PART.0 / WINDOW_PART.1);
        let due_ns = tick.scheduled_ns;
        let now_ns = host_ns(observation.now_us);
        let by_frame = |event| is_begun_by_frame(event, due_ns, period_ns);
        // The event of its frame may be one of those that found no room.
        let latest_ns = if tick.events_dropped > 0 || tick.events.iter().any(by_frame) {
            due_ns + window_ns
        } else {
            due_ns
        };
        if tick.start_ns != now_ns || now_ns < due_ns || now_ns >= latest_ns + period_ns {
            return Err(format!(
                "the tick of {due_ns} ns began at {} ns; it is {now_ns} ns",
                tick.start_ns
            ));
        }
        let mode = tick.output.mode;
        let Some((before, mode_before)) = self.last.take().filter(|_| tick.index > 0) else {
            self.last = Some((due_ns..=latest_ns, mode));
            return Ok(());
        };
        let part = if mode_before.is_underway() {
            SLIDE_UNDERWAY
        } else {
            SLIDE_STANDING
        };
        let slide_ns = period_ns / part;
        let periods_ns = (1 + u64::from(tick.skipped)) * period_ns;
        let from_ns = due_ns.max(before.start() + periods_ns - slide_ns);
        let to_ns = latest_ns.min(before.end() + periods_ns + slide_ns);
        self.last = Some((from_ns..=to_ns, mode));
        if from_ns > to_ns {
            return Err(format!(
                "the deadline of the tick was between {due_ns} and {latest_ns} ns, {} to {} ns after \
                 the one before, in mode {mode_before}; it may slide by {slide_ns} ns",
                due_ns.saturating_sub(*before.end()),
                latest_ns - before.start(),
            ));
        }
        Ok(())
    }
}

/// `camera-alignment`: after 6 s without disturbance, a tick of a drive, from its second
/// second on, begins at most 1 ms after the arrival of its frame. Stamps that leave the frames
/// can't be followed. (While the car stands, the grid slides by 0.5 ms a tick and overshoots now
/// and then.)
#[derive(Default)]
pub(super) struct CameraAlignment {
    calm_from_us: u64,
}

const CALM_US: u64 = 6_000_000;
/// Time in which the grid moves by 2 ms, by the slide of a drive, 20 µs a tick.
const SETTLING_US: u64 = 1_000_000;
const AGE_NS: u64 = 1_000_000;

impl Invariant for CameraAlignment {
    fn name(&self) -> &'static str {
        "camera-alignment"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        let disturbs =
            |kind: FaultKind| matches!(kind.target(), FaultTarget::Cameras) || kind.delays_host();
        let is_disturbed = observation.faults.iter().any(|fault| disturbs(fault.kind))
            || observation
                .new_faults
                .iter()
                .any(|fault| disturbs(fault.kind))
            || observation.spec.stamps_drift()
            || observation.daemon_since_us.is_none();
        if is_disturbed {
            self.calm_from_us = observation.now_us + CALM_US;
        }
        let Some(tick) = observation.tick else {
            return Ok(());
        };
        if !tick.output.mode.is_underway() {
            // The first ticks of a drive are where the faster slide of a standing car left them.
            self.calm_from_us = self.calm_from_us.max(observation.now_us + SETTLING_US);
        }
        let since_us = observation.daemon_since_us.unwrap_or(0) + CALM_US;
        if observation.now_us < self.calm_from_us.max(since_us) {
            return Ok(());
        }
        let received = tick.events.iter().rev().find_map(|event| match event {
            Event::Pose(pose) => Some(pose.receive.0),
            _ => None,
        });
        let age_ns = received.map(|received| tick.start_ns.saturating_sub(received));
        match age_ns {
            Some(age_ns) if age_ns > AGE_NS => Err(format!(
                "the tick began {age_ns} ns after the frame that it saw"
            )),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use singletrack_protocol::{Drive, Sequence};

    use super::*;
    use crate::observation::scene::Scene;

    fn drive(speed_mm_s: i16, steering_100urad: i16) -> ToBoard {
        ToBoard::Drive(Drive {
            sequence: Sequence(1),
            speed_mm_s,
            steering_100urad,
            telemetry_time_us: 0,
            pose_age_ms: 0,
            brake: false,
        })
    }

    #[test]
    fn commands_beyond_the_limits_are_found() {
        let scene = Scene::new();
        for (message, found) in [
            (drive(1_500, 4_500), None),
            (drive(0, -4_500), None),
            (drive(1_501, 0), Some("1.501 m/s")),
            (drive(-1, 0), Some("-0.001 m/s")),
            (drive(0, 4_501), Some("0.4501 rad")),
        ] {
            let written = [message];
            let mut observation = scene.observation(0);
            observation.written = &written;
            let verdict = CommandLimits.check(&observation);
            match found {
                None => assert_eq!(verdict, Ok(())),
                Some(part) => assert!(verdict.is_err_and(|details| details.contains(part))),
            }
        }
    }

    #[test]
    fn a_third_command_to_a_silent_board_is_found() {
        let scene = Scene::new();
        let written = [drive(500, 0)];
        let mut invariant = NoQueue::default();
        let mut check = |has_read| {
            let mut observation = scene.observation(0);
            observation.written = &written;
            observation.has_read = has_read;
            invariant.check(&observation)
        };
        assert_eq!(
            [true, false, true, false].map(&mut check),
            [Ok(()), Ok(()), Ok(()), Ok(())]
        );
        assert!(check(false).is_err());
    }
}
