//! A configuration comes into force as a whole, and never during a drive.

use singletrack_pilot::{Event, Mode};
use singletrack_protocol::ToBoard;

use super::{Invariant, Verdict};
use crate::observation::Observation;

/// `reconfigured-underway`: no configuration comes into force during a drive.
#[derive(Default)]
pub(super) struct ReconfiguredUnderway {
    last: Option<Mode>,
}

impl Invariant for ReconfiguredUnderway {
    fn name(&self) -> &'static str {
        "reconfigured-underway"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        let Some(tick) = observation.tick else {
            return Ok(());
        };
        let before = self.last.replace(tick.output.mode);
        let changed = tick.events.iter().find_map(|event| match event {
            Event::Reconfigured(number) => Some(number),
            _ => None,
        });
        match (changed, before) {
            (Some(number), Some(mode)) if tick.index > 0 && mode.is_underway() => Err(format!(
                "configuration {number} came into force after a tick in mode {mode}"
            )),
            _ => Ok(()),
        }
    }
}

/// `armed-configuration`: a request to arm carries the hash of the configuration in
/// force.
#[derive(Default)]
pub(super) struct ArmedConfiguration;

impl Invariant for ArmedConfiguration {
    fn name(&self) -> &'static str {
        "armed-configuration"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        let hash = observation.spec.board.hash();
        for message in observation.written {
            if let ToBoard::Arm(arm) = message
                && arm.configuration_hash != hash
            {
                return Err(format!(
                    "a request to arm with configuration {:08x}, {hash:08x} is in force",
                    arm.configuration_hash
                ));
            }
        }
        Ok(())
    }
}
