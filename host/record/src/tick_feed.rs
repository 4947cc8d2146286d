//! A ring for ticks, from the control thread to the other threads.
//!
//! A [`TickRecord`] has room for many events and mostly holds two or three. To push
//! the whole record costs the control thread more than a microsecond, because the memory
//! of the ring is in the cache of another processor. So the events have a ring of their
//! own, which takes only those that exist.

use rtrb::{Consumer, Producer, RingBuffer};
use singletrack_pilot::Event;

use crate::{MAX_EVENTS, TickRecord};

/// The input of a ring of ticks. It neither waits nor allocates.
#[derive(Debug)]
pub struct TickInput {
    /// None only while [`tick_feed`] touches the memory.
    heads: Producer<Option<Head>>,
    events: Producer<Event>,
}

/// The output of a ring of ticks.
#[derive(Debug)]
pub struct TickOutput {
    heads: Consumer<Option<Head>>,
    events: Consumer<Event>,
}

/// A tick without its events, and their number.
#[derive(Clone, Debug)]
struct Head {
    tick: TickRecord<0>,
    events: usize,
}

/// A ring for `capacity` ticks, each with up to [`MAX_EVENTS`] events.
///
/// All its memory has been touched when this returns: a later push meets no page fault,
/// unless the system has swapped the memory out.
#[must_use]
#[inline]
pub fn tick_feed(capacity: usize) -> (TickInput, TickOutput) {
    let (mut heads, mut heads_out) = RingBuffer::new(capacity);
    let (mut events, mut events_out) = RingBuffer::new(capacity.saturating_mul(MAX_EVENTS));
    while heads.push(None).is_ok() {}
    while heads_out.pop().is_ok() {}
    while events.push(Event::ArmRefused).is_ok() {}
    while events_out.pop().is_ok() {}
    (
        TickInput { heads, events },
        TickOutput {
            heads: heads_out,
            events: events_out,
        },
    )
}

impl TickInput {
    // Inlined, with its opposite: the Python package compiles this crate without optimisation.
    /// Pushes a tick; false if the ring is full.
    #[inline]
    pub fn push(&mut self, tick: &TickRecord) -> bool {
        // Where there is room for a tick, there is room for its events.
        if self.heads.is_full() {
            return false;
        }
        let Ok(room) = self.events.write_chunk_uninit(tick.events.len()) else {
            return false;
        };
        room.fill_from_iter(tick.events.iter().copied());
        // Pushed last: a reader that sees the head sees the events as well.
        let head = Head {
            tick: tick.without_events(),
            events: tick.events.len(),
        };
        self.heads.push(Some(head)).is_ok()
    }
}

impl TickOutput {
    /// The next tick; none if the ring is empty.
    #[inline]
    pub fn pop(&mut self) -> Option<TickRecord> {
        // The head is removed last: until then its place and that of its events stay
        // taken.
        let head = self.heads.peek().ok()?.as_ref()?;
        let mut events = heapless::Vec::new();
        if let Ok(chunk) = self.events.read_chunk(head.events) {
            // At most as many as a tick has.
            events.extend(chunk);
        }
        let tick = head.tick.with_events(events);
        let _ = self.heads.pop();
        Some(tick)
    }

    /// Whether the input is gone.
    #[must_use]
    pub fn is_abandoned(&self) -> bool {
        self.heads.is_abandoned()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test may fail")]

    use std::thread;

    use super::*;
    use crate::tick::tests::{empty, full};

    /// A tick with this number of events, the same ones repeated.
    fn with_events(index: u64, events: usize) -> TickRecord {
        let mut tick = full();
        tick.index = index;
        tick.events = full().events.into_iter().cycle().take(events).collect();
        tick
    }

    #[test]
    fn ticks_come_out_as_they_went_in() {
        let (mut input, mut output) = tick_feed(3);
        assert_eq!(output.pop(), None);
        let ticks = [empty(), full(), with_events(2, MAX_EVENTS)];
        for tick in &ticks {
            assert!(input.push(tick));
        }
        for tick in ticks {
            assert_eq!(output.pop(), Some(tick));
        }
        assert_eq!(output.pop(), None);
        assert!(!output.is_abandoned());
        drop(input);
        assert!(output.is_abandoned());
    }

    #[test]
    fn a_full_ring_takes_no_tick_and_loses_none() {
        let (mut input, mut output) = tick_feed(2);
        for round in 0..5 {
            let ticks = [0, 1].map(|index| with_events(2 * round + index, MAX_EVENTS));
            assert!(ticks.iter().all(|tick| input.push(tick)));
            assert!(!input.push(&full()));
            for tick in ticks {
                assert_eq!(output.pop(), Some(tick));
            }
        }
    }

    #[test]
    fn another_thread_gets_every_event_of_every_tick() {
        const TICKS: u64 = 20_000;
        let (mut input, mut output) = tick_feed(8);
        let emptying = thread::spawn(move || {
            for index in 0..TICKS {
                let tick = loop {
                    match output.pop() {
                        Some(tick) => break tick,
                        None => thread::yield_now(),
                    }
                };
                assert_eq!(tick.index, index);
                assert_eq!(tick.events.len() as u64, index % (MAX_EVENTS as u64 + 1));
            }
        });
        for index in 0..TICKS {
            let tick = with_events(index, (index % (MAX_EVENTS as u64 + 1)) as usize);
            while !input.push(&tick) {
                thread::yield_now();
            }
        }
        emptying.join().unwrap();
    }
}
