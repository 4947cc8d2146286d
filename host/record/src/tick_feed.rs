//! A ring for ticks between the control thread and the rest.
//!
//! A [`TickRecord`] has room for many events and mostly holds two or three. To
//! push all of it, room and all, costs the control thread a microsecond and more,
//! because the ring's memory was last seen by another processor. So the events go
//! in a ring of their own: as many as there are.

use rtrb::{Consumer, Producer, RingBuffer};
use singletrack_control::Time;
use singletrack_pilot::{Event, Output};

use crate::{DriveWrite, LinkPhase, MAX_EVENTS, TickRecord};

/// The end of a ring where ticks go in. Neither waits nor allocates.
#[derive(Debug)]
pub struct TickInput {
    /// Never none but while its memory is being touched.
    heads: Producer<Option<Head>>,
    events: Producer<Event>,
}

/// The end of a ring where ticks come out.
#[derive(Debug)]
pub struct TickOutput {
    heads: Consumer<Option<Head>>,
    events: Consumer<Event>,
}

/// A tick without its events.
#[derive(Clone, Copy, Debug)]
struct Head {
    index: u64,
    scheduled_ns: u64,
    start_ns: u64,
    finish_ns: u64,
    skipped: u32,
    pilot_time: Time,
    events: usize,
    events_dropped: u32,
    output: Output,
    drive: Option<DriveWrite>,
    link: LinkPhase,
}

/// A ring for `capacity` ticks, however many events they have.
///
/// Its memory is there when this returns, as far as the system keeps it: pushing
/// has no page to wait for.
#[must_use]
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
    /// Hands a tick over; false if the ring is full.
    pub fn push(&mut self, tick: &TickRecord) -> bool {
        let TickRecord {
            index,
            scheduled_ns,
            start_ns,
            finish_ns,
            skipped,
            pilot_time,
            ref events,
            events_dropped,
            ref output,
            drive,
            link,
        } = *tick;
        // There is room for its events wherever there is room for a tick.
        if self.heads.is_full() {
            return false;
        }
        let Ok(room) = self.events.write_chunk_uninit(events.len()) else {
            return false;
        };
        room.fill_from_iter(events.iter().copied());
        // Last: who sees it sees its events as well.
        let head = Head {
            index,
            scheduled_ns,
            start_ns,
            finish_ns,
            skipped,
            pilot_time,
            events: events.len(),
            events_dropped,
            output: *output,
            drive,
            link,
        };
        self.heads.push(Some(head)).is_ok()
    }
}

impl TickOutput {
    /// The next tick, if there is one.
    pub fn pop(&mut self) -> Option<TickRecord> {
        // The head goes last: until then its place is taken, and so is that of
        // its events.
        let head = (*self.heads.peek().ok()?)?;
        let mut events = heapless::Vec::new();
        if let Ok(chunk) = self.events.read_chunk(head.events) {
            // No more than were in a tick.
            events.extend(chunk);
        }
        let _ = self.heads.pop();
        Some(TickRecord {
            index: head.index,
            scheduled_ns: head.scheduled_ns,
            start_ns: head.start_ns,
            finish_ns: head.finish_ns,
            skipped: head.skipped,
            pilot_time: head.pilot_time,
            events,
            events_dropped: head.events_dropped,
            output: head.output,
            drive: head.drive,
            link: head.link,
        })
    }

    /// Whether nobody pushes any more.
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

    /// With this many events, the same one over and over.
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
    fn whoever_empties_the_ring_on_another_thread_gets_every_event_of_every_tick() {
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
