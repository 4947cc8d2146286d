//! What the pilot has learned.

use singletrack_control::Time;
use singletrack_pilot::{Event, Learned, Mode};

use super::{Invariant, Verdict};
use crate::observation::Observation;

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
