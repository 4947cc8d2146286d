//! The serial reader: opens the board's port, reads it, and opens it again after a
//! hang-up.
//!
//! A state machine without a clock or a device. The caller polls it when the port is
//! readable or the returned deadline has passed.

use rtrb::{Consumer, Producer, PushError};

use crate::line::{Line, Port, PortRead};

/// The largest number of bytes in a [`Chunk`].
pub const CHUNK: usize = 240;

/// Delays between two attempts to open the port.
const FIRST_RETRY_NS: u64 = 50_000_000;
const LAST_RETRY_NS: u64 = 400_000_000;

/// The longest wait for the write half after a hang-up, until the port is closed.
const RETURN_PATIENCE_NS: u64 = 200_000_000;

/// Delay between two attempts to hand an event over or to get the write half back.
const HAND_OVER_NS: u64 = 1_000_000;

/// The longest wait on a silent port.
const IDLE_NS: u64 = 200_000_000;

/// The largest number of reads in a poll: a flood of bytes must not block the caller.
const READS: u32 = 512;

/// An event of the serial line, for the control loop.
#[derive(Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "the control thread must not allocate to receive one"
)]
pub enum SerialEvent<L> {
    /// The port was opened; this is its write half.
    Opened(L),
    /// Bytes were received.
    Bytes(Chunk),
    /// The port has hung up. The control loop returns the write half.
    Closed {
        /// When the hang-up was noticed.
        time_ns: u64,
    },
}

/// Bytes of one read.
#[derive(Clone, Debug)]
pub struct Chunk {
    /// When they were read.
    pub time_ns: u64,
    bytes: heapless::Vec<u8, CHUNK>,
}

impl Chunk {
    /// The first [`CHUNK`] bytes of `bytes`, read at `time_ns`.
    pub fn new(time_ns: u64, bytes: &[u8]) -> Self {
        let bytes = bytes.iter().copied().take(CHUNK).collect();
        Self { time_ns, bytes }
    }

    /// The bytes.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }
}

/// Counters of the serial reader.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ReaderCounters {
    /// The number of times that the port was opened.
    pub opened: u64,
    /// Bytes received.
    pub bytes: u64,
    /// Bytes lost because the control loop's ring was full.
    pub bytes_dropped: u64,
}

/// When to poll the serial reader again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReaderWait {
    /// Whether it ends as soon as the port is readable.
    pub readable: bool,
    /// At the latest.
    pub until_ns: u64,
}

#[derive(Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "a reader has one phase, and must not allocate to change it"
)]
enum Phase<L> {
    Closed {
        retry_at_ns: u64,
    },
    /// The event waits for room in the control loop's ring.
    HandingOver(SerialEvent<L>),
    Open,
    /// The port has hung up; the control loop still has the write half.
    Returning {
        until_ns: u64,
    },
}

/// Reads the board's port for the control loop.
#[derive(Debug)]
pub struct SerialReader<L> {
    events: Producer<SerialEvent<L>>,
    returned: Consumer<L>,
    phase: Phase<L>,
    retry_ns: u64,
    /// The counters so far.
    pub counters: ReaderCounters,
}

impl<L: Line> SerialReader<L> {
    /// A reader whose port is closed. `returned` is the ring on which the control loop
    /// returns write halves.
    pub fn new(events: Producer<SerialEvent<L>>, returned: Consumer<L>) -> Self {
        Self {
            events,
            returned,
            phase: Phase::Closed { retry_at_ns: 0 },
            retry_ns: FIRST_RETRY_NS,
            counters: ReaderCounters::default(),
        }
    }

    /// Opens, reads or closes the port, whichever is due. Bytes get the time of `clock`
    /// after the read.
    pub fn poll(&mut self, clock: &impl Fn() -> u64, port: &mut impl Port<Line = L>) -> ReaderWait {
        let wait = |until_ns| ReaderWait {
            readable: false,
            until_ns,
        };
        loop {
            let now_ns = clock();
            match core::mem::replace(&mut self.phase, Phase::Open) {
                Phase::Closed { retry_at_ns } if now_ns < retry_at_ns => {
                    self.phase = Phase::Closed { retry_at_ns };
                    return wait(retry_at_ns);
                }
                Phase::Closed { .. } => match self.reopen(port) {
                    Some(line) => {
                        self.counters.opened += 1;
                        self.retry_ns = FIRST_RETRY_NS;
                        self.phase = Phase::HandingOver(SerialEvent::Opened(line));
                    }
                    // Dated after the attempt, which may have taken longer than the delay.
                    None => self.retry_later(clock()),
                },
                Phase::HandingOver(event) => {
                    let closes = matches!(event, SerialEvent::Closed { .. });
                    match self.events.push(event) {
                        Err(PushError::Full(event)) => {
                            self.phase = Phase::HandingOver(event);
                            return wait(now_ns.saturating_add(HAND_OVER_NS));
                        }
                        Ok(()) if closes => {
                            self.phase = Phase::Returning {
                                until_ns: now_ns.saturating_add(RETURN_PATIENCE_NS),
                            };
                        }
                        Ok(()) => {}
                    }
                }
                Phase::Open => {
                    if let Some(wait) = self.read(clock, port) {
                        return wait;
                    }
                }
                Phase::Returning { until_ns } => {
                    if self.returned.pop().is_err() && now_ns < until_ns {
                        self.phase = Phase::Returning { until_ns };
                        return wait(now_ns.saturating_add(HAND_OVER_NS));
                    }
                    port.close();
                    self.retry_later(clock());
                }
            }
        }
    }

    /// Reads until no bytes are left or the port hangs up.
    fn read(
        &mut self,
        clock: &impl Fn() -> u64,
        port: &mut impl Port<Line = L>,
    ) -> Option<ReaderWait> {
        let mut buffer = [0; CHUNK];
        for _ in 0..READS {
            match port.read(&mut buffer) {
                PortRead::Bytes(count) => {
                    let chunk = Chunk::new(clock(), buffer.get(..count).unwrap_or(&[]));
                    self.counters.bytes += count as u64;
                    if self.events.push(SerialEvent::Bytes(chunk)).is_err() {
                        self.counters.bytes_dropped += count as u64;
                    }
                }
                PortRead::Nothing => break,
                PortRead::HungUp => {
                    self.phase = Phase::HandingOver(SerialEvent::Closed { time_ns: clock() });
                    return None;
                }
            }
        }
        Some(ReaderWait {
            readable: true,
            until_ns: clock().saturating_add(IDLE_NS),
        })
    }

    /// Opens the port. A write half that came back after the patience with it had ended is
    /// of an earlier connection.
    fn reopen(&mut self, port: &mut impl Port<Line = L>) -> Option<L> {
        while self.returned.pop().is_ok() {}
        port.open()
    }

    fn retry_later(&mut self, now_ns: u64) {
        self.phase = Phase::Closed {
            retry_at_ns: now_ns.saturating_add(self.retry_ns),
        };
        self.retry_ns = (2 * self.retry_ns).min(LAST_RETRY_NS);
    }
}

#[cfg(test)]
mod tests {
    use core::cell::Cell;

    use rtrb::RingBuffer;

    use super::*;
    use crate::line::Sent;

    struct NoLine;

    impl Line for NoLine {
        fn write_frame(&mut self, _: &[u8]) -> Sent {
            Sent::Dropped
        }
    }

    /// A port that is plugged in or not, with bytes waiting in it.
    #[derive(Default)]
    struct Scripted {
        plugged: bool,
        waiting: Vec<u8>,
        attempts: u32,
    }

    impl Port for Scripted {
        type Line = NoLine;

        fn open(&mut self) -> Option<NoLine> {
            self.attempts += 1;
            self.plugged.then_some(NoLine)
        }

        fn read(&mut self, buffer: &mut [u8]) -> PortRead {
            if !self.plugged {
                return PortRead::HungUp;
            }
            let count = buffer.len().min(self.waiting.len());
            for (to, from) in buffer.iter_mut().zip(self.waiting.drain(..count)) {
                *to = from;
            }
            match count {
                0 => PortRead::Nothing,
                count => PortRead::Bytes(count),
            }
        }

        fn close(&mut self) {}
    }

    const MS: u64 = 1_000_000;

    #[test]
    fn a_missing_port_is_tried_at_growing_intervals() {
        let (events, _taken) = RingBuffer::new(4);
        let (_back, returned) = RingBuffer::new(2);
        let mut reader = SerialReader::new(events, returned);
        let mut port = Scripted::default();
        let mut now_ns = 0;
        let mut waits = Vec::new();
        for _ in 0..6 {
            let wait = reader.poll(&|| now_ns, &mut port);
            assert!(!wait.readable);
            waits.push((wait.until_ns - now_ns) / MS);
            now_ns = wait.until_ns;
        }
        assert_eq!(waits, [50, 100, 200, 400, 400, 400]);
        assert_eq!(port.attempts, 6);
    }

    /// A device that does not answer: each attempt to open it takes a second and fails.
    struct Unanswered<'a> {
        now_ns: &'a Cell<u64>,
        attempts: u32,
    }

    impl Port for Unanswered<'_> {
        type Line = NoLine;

        fn open(&mut self) -> Option<NoLine> {
            self.attempts += 1;
            assert_eq!(self.attempts, 1, "the poll must return after an attempt");
            self.now_ns.set(self.now_ns.get() + 1_000 * MS);
            None
        }

        fn read(&mut self, _: &mut [u8]) -> PortRead {
            PortRead::HungUp
        }

        fn close(&mut self) {}
    }

    #[test]
    fn a_slow_attempt_is_followed_by_the_whole_delay() {
        let (events, _taken) = RingBuffer::new(4);
        let (_back, returned) = RingBuffer::new(2);
        let now_ns = Cell::new(0);
        let mut port = Unanswered {
            now_ns: &now_ns,
            attempts: 0,
        };
        let wait = SerialReader::new(events, returned).poll(&|| now_ns.get(), &mut port);
        assert_eq!(wait.until_ns, 1_050 * MS);
    }

    #[test]
    fn a_hang_up_waits_for_the_write_half_before_the_port_is_opened_again() {
        let (events, mut taken) = RingBuffer::new(4);
        let (mut back, returned) = RingBuffer::new(2);
        let mut reader = SerialReader::new(events, returned);
        let mut port = Scripted {
            plugged: true,
            waiting: vec![7; 300],
            ..Scripted::default()
        };
        let wait = reader.poll(&|| 5, &mut port);
        assert!(wait.readable);
        let Ok(SerialEvent::Opened(line)) = taken.pop() else {
            unreachable!("the port opens first");
        };
        let lengths: Vec<usize> = core::iter::from_fn(|| match taken.pop() {
            Ok(SerialEvent::Bytes(chunk)) => Some(chunk.bytes().len()),
            _ => None,
        })
        .collect();
        assert_eq!(lengths, [240, 60]);

        port.plugged = false;
        reader.poll(&|| 10 * MS, &mut port);
        assert!(matches!(taken.pop(), Ok(SerialEvent::Closed { time_ns }) if time_ns == 10 * MS));
        port.plugged = true;
        reader.poll(&|| 100 * MS, &mut port);
        assert_eq!(reader.counters.opened, 1, "the write half is still out");
        assert!(back.push(line).is_ok());
        let wait = reader.poll(&|| 101 * MS, &mut port);
        assert_eq!(wait.until_ns, 151 * MS);
        reader.poll(&|| 151 * MS, &mut port);
        assert_eq!(reader.counters.opened, 2);
    }

    #[test]
    fn a_control_loop_that_takes_nothing_loses_bytes_and_no_hang_up() {
        let (events, mut taken) = RingBuffer::new(2);
        let (_back, returned) = RingBuffer::new(2);
        let mut reader = SerialReader::new(events, returned);
        let mut port = Scripted {
            plugged: true,
            waiting: vec![7; 3 * CHUNK],
            ..Scripted::default()
        };
        reader.poll(&|| 0, &mut port);
        assert_eq!(reader.counters.bytes_dropped, 2 * CHUNK as u64);
        port.plugged = false;
        for ms in 1..50 {
            reader.poll(&|| ms * MS, &mut port);
        }
        assert!(matches!(taken.pop(), Ok(SerialEvent::Opened(_))));
        assert!(matches!(taken.pop(), Ok(SerialEvent::Bytes(_))));
        reader.poll(&|| 50 * MS, &mut port);
        assert!(matches!(taken.pop(), Ok(SerialEvent::Closed { .. })));
    }
}
