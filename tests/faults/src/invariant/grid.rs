//! The grid of the ticks, and its alignment to the cameras.

use singletrack_pilot::{Event, Mode};

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

/// `tick-grid`: the deadlines are a period apart, except for the slide towards the
/// cameras; a tick begins between its deadline and the next one.
#[derive(Default)]
pub(super) struct TickGrid {
    last: Option<(u64, Mode)>,
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
        let here = tick.scheduled_ns;
        let last = self.last.replace((here, tick.output.mode));
        let now_ns = host_ns(observation.now_us);
        if tick.start_ns != now_ns || now_ns < here || now_ns >= here + period_ns {
            return Err(format!(
                "the tick of {here} ns began at {} ns; it is {now_ns} ns",
                tick.start_ns
            ));
        }
        let Some((before, mode)) = last.filter(|_| tick.index > 0) else {
            return Ok(());
        };
        let part = if mode.is_underway() {
            SLIDE_UNDERWAY
        } else {
            SLIDE_STANDING
        };
        let due = before + (1 + u64::from(tick.skipped)) * period_ns;
        let slide_ns = here.abs_diff(due);
        if slide_ns > period_ns / part {
            return Err(format!(
                "the grid slid by {slide_ns} ns in mode {mode}, {} allowed",
                period_ns / part
            ));
        }
        Ok(())
    }
}

/// `camera-alignment`: after 6 s without disturbance, a tick of a drive, from its second
/// second on, begins 0.5 to 4.5 ms after the arrival of a frame: the target of 0.75 to 2 ms, the
/// host's polling interval of 1 ms, and the jitter of the cameras. Stamps that leave the frames can't be followed. (While the car stands, the grid slides by 0.5 ms
/// a tick and overshoots now and then.)
#[derive(Default)]
pub(super) struct CameraAlignment {
    calm_from_us: u64,
}

const CALM_US: u64 = 6_000_000;
/// By the slide of a drive, 20 µs a tick, the grid moves 2 ms in this time.
const SETTLING_US: u64 = 1_000_000;
const AGES_NS: core::ops::RangeInclusive<u64> = 500_000..=4_500_000;

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
            Some(age_ns) if !AGES_NS.contains(&age_ns) => Err(format!(
                "the tick began {age_ns} ns after the frame that it saw"
            )),
            _ => Ok(()),
        }
    }
}
