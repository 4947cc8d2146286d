//! A slot with the newest value for the control thread.
//!
//! It is not a queue: a newer value replaces one that was not taken, and however many clients
//! send, they take no place of a request. The control thread never waits for a sender: it only
//! tries the lock, and what is just being sent is for its next tick. A sender holds the lock only
//! while it moves a value in; senders may wait for each other.

use std::sync::{Arc, Mutex, PoisonError, TryLockError};

use singletrack_pilot::{Jog, Tuning};

/// The sending end, for every thread but the control thread.
#[derive(Debug)]
pub struct SlotSender<T>(Arc<Mutex<Option<T>>>);

/// The receiving end, for the control thread.
#[derive(Debug)]
pub struct SlotReceiver<T>(Arc<Mutex<Option<T>>>);

/// Makes an empty slot.
#[must_use]
pub fn slot<T>() -> (SlotSender<T>, SlotReceiver<T>) {
    let shared = Arc::new(Mutex::new(None));
    (SlotSender(Arc::clone(&shared)), SlotReceiver(shared))
}

impl<T> Clone for SlotSender<T> {
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}

impl<T> SlotSender<T> {
    /// Replaces the value in the slot by one that may follow from it.
    pub(crate) fn replace(&self, by: impl FnOnce(Option<T>) -> T) {
        let mut slot = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        *slot = Some(by(slot.take()));
    }
}

impl<T> SlotReceiver<T> {
    /// The newest value; `None` if it was taken before.
    pub fn take(&mut self) -> Option<T> {
        match self.0.try_lock() {
            Ok(mut slot) => slot.take(),
            Err(TryLockError::Poisoned(error)) => error.into_inner().take(),
            Err(TryLockError::WouldBlock) => None,
        }
    }
}

impl SlotSender<Jog> {
    /// Replaces the operator's pulses in the slot.
    pub fn send(&self, jog: Jog) {
        self.replace(|_| jog);
    }
}

impl SlotSender<Tuning> {
    /// Replaces the values in the slot by those that are given.
    ///
    /// The sender has checked them: [`TuningRule::check`](crate::config::TuningRule::check).
    pub fn send(&self, tuning: Tuning) {
        self.replace(|waiting| tuning.or(waiting.unwrap_or_default()));
    }
}

#[cfg(test)]
mod tests {
    use std::thread;

    use super::*;

    const fn jog(number: u16) -> Jog {
        Jog {
            servo_us: number,
            esc_us: !number,
        }
    }

    #[test]
    fn only_the_newest_is_taken_and_only_once_also_if_it_is_equal() {
        let (sender, mut receiver) = slot::<Jog>();
        assert_eq!(receiver.take(), None);
        for number in 0..1_000 {
            sender.send(jog(number));
        }
        assert_eq!(receiver.take(), Some(jog(999)));
        assert_eq!(receiver.take(), None);
        sender.clone().send(jog(999));
        assert_eq!(receiver.take(), Some(jog(999)));
    }

    #[test]
    fn pulses_taken_while_others_send_belong_together() {
        const COUNT: u16 = 50_000;
        let (sender, mut receiver) = slot::<Jog>();
        let writer = thread::spawn(move || {
            for number in 1..=COUNT {
                sender.send(jog(number));
            }
        });
        let mut last = 0;
        while last < COUNT {
            if let Some(taken) = receiver.take() {
                assert_eq!(taken, jog(taken.servo_us));
                assert!(taken.servo_us > last);
                last = taken.servo_us;
            }
        }
        writer.join().unwrap();
    }

    #[test]
    fn the_newest_of_each_value_to_tune_is_taken_once() {
        let (sender, mut receiver) = slot::<Tuning>();
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
    }

    #[test]
    fn a_sender_holds_up_no_tick_and_one_that_panicked_no_other() {
        let (sender, mut receiver) = slot::<Jog>();
        sender.send(jog(1));
        {
            let _sending = sender.0.lock().unwrap();
            assert_eq!(receiver.take(), None);
        }
        let other = sender.clone();
        let panicked = thread::spawn(move || other.replace(|_| panic!("while sending"))).join();
        assert!(panicked.is_err());
        sender.send(jog(2));
        assert_eq!(receiver.take(), Some(jog(2)));
    }
}
