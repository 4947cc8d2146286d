//! A slot with the newest set-point for the control thread.
//!
//! It is not a queue: a newer set-point replaces one that was not taken. Sender and
//! receiver never wait for each other.

use core::sync::atomic::{AtomicU64, Ordering, fence};
use std::sync::{Arc, Mutex, PoisonError};

use singletrack_control::{Position, Setpoint, Time, Velocity};

/// The words of a set-point: whether it has a position, the position, the velocity, the
/// time.
const WORDS: usize = 6;

/// Attempts of the reader to copy a set-point that is not being overwritten.
const ATTEMPTS: usize = 3;

/// Two copies, and the number of set-points so far. Its lowest bit selects the complete
/// copy; the next set-point is written to the other one.
#[derive(Debug, Default)]
struct Shared {
    written: AtomicU64,
    copies: [[AtomicU64; WORDS]; 2],
}

/// The sending end, for every thread but the control thread.
#[derive(Clone, Debug)]
pub struct SetpointSender(Arc<Mutex<Arc<Shared>>>);

/// The receiving end, for the control thread.
#[derive(Debug)]
pub struct SetpointReceiver {
    shared: Arc<Shared>,
    taken: u64,
}

/// Makes an empty slot.
#[must_use]
pub fn setpoint_slot() -> (SetpointSender, SetpointReceiver) {
    let shared = Arc::new(Shared::default());
    let sender = SetpointSender(Arc::new(Mutex::new(Arc::clone(&shared))));
    (sender, SetpointReceiver { shared, taken: 0 })
}

impl Shared {
    const fn copy(&self, number: u64) -> &[AtomicU64; WORDS] {
        let [even, odd] = &self.copies;
        if number.is_multiple_of(2) { even } else { odd }
    }
}

impl SetpointSender {
    /// Replaces the set-point in the slot. Senders may wait for each other.
    pub fn send(&self, setpoint: &Setpoint) {
        // The slot is consistent: a sender that panicked while writing left the copy that
        // is read unchanged.
        let shared = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let number = shared.written.load(Ordering::Relaxed).wrapping_add(1);
        // A reader that sees any of the following stores also sees the number read above,
        // and so that its copy is being replaced.
        fence(Ordering::Release);
        for (word, value) in shared.copy(number).iter().zip(words(setpoint)) {
            word.store(value, Ordering::Relaxed);
        }
        shared.written.store(number, Ordering::Release);
    }
}

impl SetpointReceiver {
    /// The newest set-point; `None` if it was taken before.
    pub fn take(&mut self) -> Option<Setpoint> {
        for _ in 0..ATTEMPTS {
            let number = self.shared.written.load(Ordering::Acquire);
            if number == self.taken {
                return None;
            }
            let mut values = [0; WORDS];
            for (value, word) in values.iter_mut().zip(self.shared.copy(number)) {
                *value = word.load(Ordering::Relaxed);
            }
            // If any of these words is of a newer set-point, the number is newer too.
            fence(Ordering::Acquire);
            if self.shared.written.load(Ordering::Relaxed) == number {
                self.taken = number;
                return Some(setpoint(values));
            }
        }
        // Senders write without a pause. The next tick tries again.
        None
    }
}

fn words(setpoint: &Setpoint) -> [u64; WORDS] {
    let position = setpoint.position.unwrap_or_default();
    [
        u64::from(setpoint.position.is_some()),
        position.x.to_bits(),
        position.y.to_bits(),
        setpoint.velocity.x.to_bits(),
        setpoint.velocity.y.to_bits(),
        setpoint.time.0,
    ]
}

const fn setpoint([has_position, x, y, v_x, v_y, time]: [u64; WORDS]) -> Setpoint {
    Setpoint {
        position: if has_position == 0 {
            None
        } else {
            Some(Position::new(f64::from_bits(x), f64::from_bits(y)))
        },
        velocity: Velocity::new(f64::from_bits(v_x), f64::from_bits(v_y)),
        time: Time(time),
    }
}

#[cfg(test)]
mod tests {
    use std::thread;

    use super::*;

    fn numbered(number: u64) -> Setpoint {
        let value = number as f64;
        Setpoint {
            position: number
                .is_multiple_of(3)
                .then(|| Position::new(value, -value)),
            velocity: Velocity::new(2.0 * value, 3.0 * value),
            time: Time(number),
        }
    }

    #[test]
    fn only_the_newest_is_taken_and_only_once() {
        let (sender, mut receiver) = setpoint_slot();
        assert_eq!(receiver.take(), None);
        for number in 1..=1_000 {
            sender.send(&numbered(number));
        }
        assert_eq!(receiver.take(), Some(numbered(1_000)));
        assert_eq!(receiver.take(), None);
        sender.clone().send(&numbered(3));
        assert_eq!(receiver.take(), Some(numbered(3)));
    }

    #[test]
    fn set_points_taken_while_others_send_are_complete_and_in_order() {
        const COUNT: u64 = 200_000;
        let (sender, mut receiver) = setpoint_slot();
        let writer = thread::spawn(move || {
            for number in 1..=COUNT {
                sender.send(&numbered(number));
            }
        });
        let mut last = 0;
        while last < COUNT {
            if let Some(taken) = receiver.take() {
                assert_eq!(taken, numbered(taken.time.0));
                assert!(taken.time.0 > last);
                last = taken.time.0;
            }
        }
        writer.join().unwrap();
    }
}
