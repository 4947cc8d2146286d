//! A record of the drive would be worth something.

use singletrack_pilot::PilotConfig;
use singletrack_record::Replay;

use super::{Invariant, Verdict};
use crate::observation::Observation;

/// `replayed`: a pilot that is told what the ticks say it was told decides the
/// same, to the bit. With a daemon that is started anew it begins anew.
pub(super) struct Replayed {
    config: PilotConfig,
    replay: Replay,
}

impl Replayed {
    pub(super) fn new(config: PilotConfig) -> Self {
        Self {
            replay: Replay::new(config.clone()),
            config,
        }
    }
}

impl Invariant for Replayed {
    fn name(&self) -> &'static str {
        "replayed"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        match observation.configuration {
            Some((1, pilot)) => self.config = pilot.clone(),
            Some((number, pilot)) => self.replay.configuration(*number, pilot.clone()),
            None => {}
        }
        let Some(tick) = observation.tick.filter(|_| observation.is_replayed) else {
            return Ok(());
        };
        if tick.index == 0 {
            self.replay = Replay::new(self.config.clone());
        }
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
