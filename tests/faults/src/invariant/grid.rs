//! The grid of the ticks, and its alignment to the cameras.

use core::ops::RangeInclusive;

use singletrack_pilot::{Event, Mode, PoseMissing};

use super::{Invariant, Verdict};
use crate::{
    daemon::host_ns,
    observation::Observation,
    schedule::{FaultKind, FaultTarget},
};

/// Largest slide of the grid in a tick while the car stands and while it is underway, as
/// a divisor of the period.
const SLIDE_STANDING: u64 = 20;
const SLIDE_UNDERWAY: u64 = 500;

/// The time before its deadline in which a frame may begin a tick, in ns: 3 ms, or less if the
/// period is short.
const WINDOW_NS: u64 = 3_000_000;
/// The same as a part of the period.
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
/// By the slide of a drive, 20 µs a tick, the grid moves 2 ms in this time.
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
