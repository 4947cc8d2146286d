//! Comparison: a car whose poses are too rare to watch its motion does not drive on.

use std::collections::VecDeque;

use singletrack_pilot::Mode;

use super::{Invariant, Verdict};
use crate::observation::Observation;

/// `compared`: the host follows its reference no longer than 1.5 s without having received two poses
/// between which it can compare the sensors: they are 40 to 120 ms apart, give or take
/// 5 ms by the cameras' stamps.
#[derive(Default)]
pub(super) struct Compared {
    /// Mid-exposures of the last poses that were received, in µs.
    exposed_us: VecDeque<u64>,
    /// When two were last close enough, or the drive began.
    since_us: Option<u64>,
}

const NEAR_US: u64 = 35_000;
const FAR_US: u64 = 125_000;
const DRIVES_ON_US: u64 = 1_500_000;

impl Invariant for Compared {
    fn name(&self) -> &'static str {
        "compared"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        let now_us = observation.now_us;
        if let Some(pose) = observation.newest_pose {
            let exposed_us = pose.exposure.exposed_us;
            if self.exposed_us.back().is_none_or(|last| *last < exposed_us) {
                let from_us = exposed_us.saturating_sub(FAR_US);
                self.exposed_us.retain(|earlier| *earlier >= from_us);
                let mut earlier = self.exposed_us.iter();
                if earlier.any(|earlier| earlier + NEAR_US <= exposed_us) {
                    self.since_us = Some(now_us);
                }
                self.exposed_us.push_back(exposed_us);
            }
        }
        let Some(tick) = observation.tick else {
            return Ok(());
        };
        if tick.output.mode != Mode::Driving {
            self.since_us = None;
            return Ok(());
        }
        let for_us = now_us - *self.since_us.get_or_insert(now_us);
        if for_us > DRIVES_ON_US {
            return Err(format!(
                "driving for {} ms without poses to compare, {} allowed",
                for_us / 1_000,
                DRIVES_ON_US / 1_000
            ));
        }
        Ok(())
    }
}
