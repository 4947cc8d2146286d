//! Invariants of a drive against another run of the same code: its replay, what it learned, its twin.

use std::collections::VecDeque;

use singletrack_control::Time;
use singletrack_pilot::{Event, Learned, Mode, PilotConfig};
use singletrack_record::Replay;

use super::{Invariant, Verdict};
use crate::observation::Observation;

/// `replayed`: a pilot that gets the recorded inputs of the ticks makes the same
/// decisions, to the bit. The replay restarts with every daemon: a configuration that a
/// daemon is given before its first tick belongs to it.
pub(super) struct Replayed {
    replay: Replay,
}

impl Replayed {
    pub(super) fn new(config: PilotConfig) -> Self {
        Self {
            replay: Replay::new(config),
        }
    }
}

impl Invariant for Replayed {
    fn name(&self) -> &'static str {
        "replayed"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        match observation.configuration {
            Some((1, pilot)) => self.replay = Replay::new(pilot.clone()),
            Some((number, pilot)) => self.replay.configuration(*number, pilot.clone()),
            None => {}
        }
        let Some(tick) = observation.tick.filter(|_| observation.is_replayed) else {
            return Ok(());
        };
        let output = self
            .replay
            .tick(tick)
            .map_err(|error| format!("tick {}: {error}", tick.index))?;
        if tick.is_output(&output) {
            return Ok(());
        }
        Err(match tick.differences(&output).first() {
            Some(difference) => format!("tick {}: {difference}", tick.index),
            None => format!("tick {} differs", tick.index),
        })
    }
}

/// The time in which a correction may go from none to its most, and for which the pilot may follow
/// what it was told, s.
const TO_MOST: f64 = 10.0;
const VALID: f64 = 2.0;

/// `learned`: corrections are none when a drive begins, and never more than their most. They change
/// only while the car drives, towards what the pilot was told less than two seconds before, and no
/// faster than from none to the most in ten seconds.
#[derive(Default)]
pub(super) struct Learns {
    last: Option<Learned>,
    told: Option<(Time, Learned)>,
    /// Whether the tick before was one of a drive.
    drove: bool,
}

impl Invariant for Learns {
    fn name(&self) -> &'static str {
        "learned"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        if observation.configuration.is_some() {
            *self = Self::default();
        }
        let (Some(tick), Some(learned)) = (observation.tick, observation.learned) else {
            return Ok(());
        };
        let now = tick.pilot_time;
        let drives = matches!(tick.output.mode, Mode::Driving | Mode::Slowing);
        if !core::mem::replace(&mut self.drove, drives) && drives {
            (self.last, self.told) = (None, None);
        } else {
            for event in &tick.events {
                if let Event::Learned(told) = event {
                    self.told = Some((now, *told));
                }
            }
        }
        let last = self.last.replace(learned).unwrap_or_default();
        if learned == last {
            return Ok(());
        }
        let told = self
            .told
            .filter(|(since, _)| now.seconds_since(*since) <= VALID);
        let Some((_, told)) = told.filter(|_| tick.output.mode == Mode::Driving) else {
            return Err(format!("{learned:?} after {last:?}, told nothing"));
        };
        let most = Learned::MOST.values();
        for (index, (now, before)) in learned.values().into_iter().zip(last.values()).enumerate() {
            let most = most[index];
            let change = most * observation.spec.period_s / TO_MOST + 1e-12;
            let towards = told.values()[index].clamp(-most, most) - before;
            // A NaN fits nothing.
            if !(now.abs() <= most
                && (now - before).abs() <= change
                && (now == before || (now - before) * towards > 0.0))
            {
                return Err(format!("{learned:?} after {last:?}, told {told:?}"));
            }
        }
        Ok(())
    }
}

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
