//! A slot with the operator's newest pulses for the control thread.
//!
//! As for the set-points, newer pulses replace ones that were not taken. They fit into one
//! word, so that neither end ever waits.

use core::sync::atomic::{AtomicU64, Ordering};
use std::sync::Arc;

use singletrack_pilot::Jog;

/// The sending end, for every thread but the control thread.
#[derive(Clone, Debug)]
pub struct JogSender(Arc<AtomicU64>);

/// The receiving end, for the control thread.
#[derive(Debug)]
pub struct JogReceiver {
    shared: Arc<AtomicU64>,
    taken: u32,
}

/// Makes an empty slot.
#[must_use]
pub fn jog_slot() -> (JogSender, JogReceiver) {
    let shared = Arc::new(AtomicU64::new(0));
    (
        JogSender(Arc::clone(&shared)),
        JogReceiver { shared, taken: 0 },
    )
}

impl JogSender {
    /// Replaces the pulses in the slot.
    pub fn send(&self, jog: Jog) {
        // The number in the upper half distinguishes equal pulses.
        self.0
            .fetch_update(Ordering::Release, Ordering::Relaxed, |word| {
                let number = ((word >> 32) as u32).wrapping_add(1);
                let pulses = (u32::from(jog.servo_us) << 16) | u32::from(jog.esc_us);
                Some((u64::from(number) << 32) | u64::from(pulses))
            })
            .ok();
    }
}

impl JogReceiver {
    /// The newest pulses; `None` if they were taken before.
    pub fn take(&mut self) -> Option<Jog> {
        let word = self.shared.load(Ordering::Acquire);
        let number = (word >> 32) as u32;
        if number == self.taken {
            return None;
        }
        self.taken = number;
        Some(Jog {
            servo_us: (word >> 16) as u16,
            esc_us: word as u16,
        })
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
    fn only_the_newest_are_taken_and_only_once_also_if_they_are_equal() {
        let (sender, mut receiver) = jog_slot();
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
        let (sender, mut receiver) = jog_slot();
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
}
