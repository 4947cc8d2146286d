//! A slot with the newest values to tune, for the control thread.
//!
//! It is not a queue: however many clients tune, they take no place of a request.

use std::sync::{Arc, Mutex, PoisonError};

use singletrack_pilot::Tuning;

/// The sending end, for every thread but the control thread.
#[derive(Clone, Debug)]
pub struct TuningSender(Arc<Mutex<Option<Tuning>>>);

/// The receiving end, for the control thread.
#[derive(Debug)]
pub struct TuningReceiver(Arc<Mutex<Option<Tuning>>>);

/// Makes an empty slot.
#[must_use]
pub fn tuning_slot() -> (TuningSender, TuningReceiver) {
    let shared = Arc::default();
    (TuningSender(Arc::clone(&shared)), TuningReceiver(shared))
}

impl TuningSender {
    /// Replaces the values in the slot by those that are given. Senders may wait for each other.
    ///
    /// The sender has checked them: [`TuningRule::check`](crate::config::TuningRule::check).
    pub fn send(&self, tuning: Tuning) {
        let mut slot = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        *slot = Some(tuning.or(slot.unwrap_or_default()));
    }
}

impl TuningReceiver {
    /// The newest values; `None` if they were taken before. It never waits: what is just being
    /// sent is for the next tick.
    pub fn take(&mut self) -> Option<Tuning> {
        self.0.try_lock().ok()?.take()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_of_each_value_is_taken_once() {
        let (sender, mut receiver) = tuning_slot();
        let tuning = |gain: Option<f64>, point_distance| Tuning {
            gain: gain.map(|gain| [gain, gain].into()),
            point_distance,
        };
        assert_eq!(receiver.take(), None);
        for number in 0..1_000 {
            sender.send(tuning(Some(f64::from(number)), None));
        }
        sender.send(tuning(None, Some(0.3)));
        assert_eq!(receiver.take(), Some(tuning(Some(999.0), Some(0.3))));
        assert_eq!(receiver.take(), None);
        // A sender that is at it holds up no tick.
        let other = sender.clone();
        let _sending = other.0.lock().unwrap();
        assert_eq!(receiver.take(), None);
    }
}
