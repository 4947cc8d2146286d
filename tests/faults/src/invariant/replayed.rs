//! The drive can be replayed from its record.

use singletrack_pilot::PilotConfig;
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
