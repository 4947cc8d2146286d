//! The serial line: bytes paced at the baud rate, with faults.

use std::collections::VecDeque;

use singletrack_settings::section;

use crate::{
    random::{Random, Stream},
    ranges::PROBABILITY,
};

section! {
    /// The line and its faults.
    "wire" => pub WireParameters: Copy;
    [default];

    /// Bits per second; a byte takes ten (8N1).
    baud: u32 = 115_200, in in_words("300 or more", |x| x >= 300.0);
    /// Initial faults; [`SerialWire::faults`] are those in force.
    faults: WireFaults = WireFaults::default();
}

section! {
    /// Faults of the line, in both directions.
    "wire.faults" => pub WireFaults: Copy;
    [default];

    /// Probability that a byte is lost.
    drop: f64 = 0.0, in PROBABILITY;
    /// Probability that one bit of a byte is flipped.
    corrupt: f64 = 0.0, in PROBABILITY;
    /// Additional delay of every byte, in µs.
    delay_us: u64 = 0;
    /// Nothing passes; sent bytes wait until this ends.
    stuck: bool = false;
}

/// One direction of the line.
#[derive(Clone, Debug)]
struct Direction {
    random: Random,
    /// Bytes for which nothing has been drawn, because nothing could happen to them.
    undrawn: u64,
    /// Time at which the last byte has passed, in picoseconds: a byte at 115200
    /// baud does not take a whole number of microseconds.
    free_at_ps: u64,
    /// Bytes in transit with their arrival times.
    under_way: VecDeque<(u64, u8)>,
}

const PS_PER_US: u64 = 1_000_000;

/// Random numbers of 32 bits that are drawn for each byte.
const WORDS_PER_BYTE: u64 = 5;

impl Direction {
    fn new(seed: u64, stream: Stream) -> Self {
        Self {
            random: Random::new(seed, stream),
            undrawn: 0,
            free_at_ps: 0,
            under_way: VecDeque::new(),
        }
    }

    /// Sends a byte, paced at the baud rate.
    fn send(&mut self, now_us: u64, byte: u8, byte_ps: u64, faults: &WireFaults) {
        self.free_at_ps = self.free_at_ps.max(now_us * PS_PER_US) + byte_ps;
        self.pass(self.free_at_ps.div_ceil(PS_PER_US), byte, faults);
    }

    /// Sends a byte whose stop bit ends at the given time.
    fn pass(&mut self, sent_us: u64, byte: u8, faults: &WireFaults) {
        let byte = if faults.drop > 0.0 || faults.corrupt > 0.0 {
            self.random
                .skip(WORDS_PER_BYTE * core::mem::take(&mut self.undrawn));
            // Always three draws, so that faults do not affect each other's draws.
            let dropped = self.random.happens(faults.drop);
            let corrupted = self.random.happens(faults.corrupt);
            let bit = self.random.below(8);
            if dropped {
                return;
            }
            if corrupted { byte ^ (1 << bit) } else { byte }
        } else {
            self.undrawn += 1;
            byte
        };
        let mut arrival = sent_us + faults.delay_us;
        if let Some((last, _)) = self.under_way.back() {
            // A decreasing delay must not reorder bytes.
            arrival = arrival.max(*last);
        }
        self.under_way.push_back((arrival, byte));
    }

    fn receive(&mut self, now_us: u64, mut take: impl FnMut(u64, u8)) {
        let is_here = |(arrival, _): &mut (u64, u8)| *arrival <= now_us;
        while let Some((arrival, byte)) = self.under_way.pop_front_if(is_here) {
            take(arrival, byte);
        }
    }

    fn clear(&mut self, now_us: u64) {
        self.under_way.clear();
        self.free_at_ps = now_us * PS_PER_US;
    }
}

/// The line between host and board, with the USB bridge at the host's end.
///
/// A stuck bridge holds the host's bytes before the line and the board's bytes
/// after it. After release, the first are paced and the second arrive at once.
#[derive(Clone, Debug)]
pub struct SerialWire {
    byte_ps: u64,
    /// The present faults.
    pub faults: WireFaults,
    connected: bool,
    to_board: Direction,
    to_host: Direction,
    /// Bytes of the host held by a stuck bridge.
    held: VecDeque<u8>,
}

impl SerialWire {
    /// An idle line.
    pub fn new(parameters: &WireParameters, seed: u64) -> Self {
        Self {
            byte_ps: 10 * 1_000_000 * PS_PER_US / u64::from(parameters.baud.max(1)),
            faults: parameters.faults,
            connected: true,
            to_board: Direction::new(seed, Stream::HostToBoard),
            to_host: Direction::new(seed, Stream::BoardToHost),
            held: VecDeque::new(),
        }
    }

    /// Whether both ends are plugged in.
    pub const fn is_connected(&self) -> bool {
        self.connected
    }

    /// Unplugs or plugs in the line; bytes in transit are lost.
    pub fn set_connected(&mut self, now_us: u64, connected: bool) {
        if self.connected != connected {
            self.connected = connected;
            self.held.clear();
            self.to_board.clear(now_us);
            self.to_host.clear(now_us);
        }
    }

    /// Sends bytes from the host; lost if the line is unplugged.
    pub fn host_write(&mut self, now_us: u64, bytes: &[u8]) {
        if !self.connected {
            return;
        }
        self.held.extend(bytes);
        self.pass_held(now_us);
    }

    /// Appends the bytes that have arrived at the host to `bytes`.
    pub fn host_read(&mut self, now_us: u64, bytes: &mut Vec<u8>) {
        if !self.faults.stuck {
            self.to_host.receive(now_us, |_, byte| bytes.push(byte));
        }
    }

    /// Number of bytes from the host that have not reached the board.
    pub fn bytes_to_board(&self) -> usize {
        self.held.len() + self.to_board.under_way.len()
    }

    /// Sends bytes from the board.
    pub(crate) fn board_write(&mut self, now_us: u64, bytes: &[u8]) {
        if self.connected {
            for &byte in bytes {
                self.to_host.send(now_us, byte, self.byte_ps, &self.faults);
            }
        }
    }

    /// Sends a byte of the board whose stop bit ended at the given time.
    pub(crate) fn board_sent(&mut self, sent_us: u64, byte: u8) {
        if self.connected {
            self.to_host.pass(sent_us, byte, &self.faults);
        }
    }

    /// Number of bytes from the board that have not left it.
    pub(crate) fn board_backlog(&self, now_us: u64) -> usize {
        let waiting = self.to_host.free_at_ps.saturating_sub(now_us * PS_PER_US);
        usize::try_from(waiting.div_ceil(self.byte_ps)).unwrap_or(usize::MAX)
    }

    /// Appends the bytes that have arrived at the board to `bytes`.
    pub(crate) fn board_read(&mut self, now_us: u64, bytes: &mut Vec<u8>) {
        self.board_read_timed(now_us, |_, byte| bytes.push(byte));
    }

    /// Takes the bytes that have arrived at the board, with their times, in µs.
    pub(crate) fn board_read_timed(&mut self, now_us: u64, take: impl FnMut(u64, u8)) {
        self.pass_held(now_us);
        self.to_board.receive(now_us, take);
    }

    fn pass_held(&mut self, now_us: u64) {
        if !self.faults.stuck {
            for byte in self.held.drain(..) {
                self.to_board.send(now_us, byte, self.byte_ps, &self.faults);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wire(faults: WireFaults) -> SerialWire {
        SerialWire::new(
            &WireParameters {
                faults,
                ..WireParameters::default()
            },
            1,
        )
    }

    fn board_reads(wire: &mut SerialWire, now_us: u64) -> Vec<u8> {
        let mut bytes = Vec::new();
        wire.board_read(now_us, &mut bytes);
        bytes
    }

    fn host_reads(wire: &mut SerialWire, now_us: u64) -> Vec<u8> {
        let mut bytes = Vec::new();
        wire.host_read(now_us, &mut bytes);
        bytes
    }

    #[test]
    fn bytes_pass_at_the_baud_rate() {
        let mut wire = wire(WireFaults::default());
        let sent: Vec<u8> = (0..2304_u32).map(|i| i as u8).collect();
        wire.host_write(500, &sent);
        assert_eq!(board_reads(&mut wire, 500 + 86), []);
        assert_eq!(board_reads(&mut wire, 500 + 87), [0]);
        // 11.52 bytes per millisecond, independent of the time of reading.
        let mut received = 1;
        for ms in 1..200 {
            received += board_reads(&mut wire, 500 + ms * 1000).len();
            assert_eq!(received as u64, ms * 1152 / 100, "{ms} ms");
        }
        assert_eq!(board_reads(&mut wire, 500 + 200_000), sent[received..]);
    }

    #[test]
    fn both_directions_are_independent_and_full_duplex() {
        let mut wire = wire(WireFaults::default());
        wire.host_write(0, &[1, 2, 3]);
        wire.board_write(0, &[4, 5, 6]);
        assert_eq!(wire.board_backlog(0), 3);
        assert_eq!(wire.board_backlog(100), 2);
        assert_eq!(host_reads(&mut wire, 261), [4, 5, 6]);
        assert_eq!(board_reads(&mut wire, 261), [1, 2, 3]);
    }

    #[test]
    fn faults_follow_their_probability_and_seed() {
        let faults = WireFaults {
            drop: 0.02,
            corrupt: 0.05,
            ..WireFaults::default()
        };
        let run = || {
            let mut wire = wire(faults);
            wire.host_write(0, &[0; 100_000]);
            board_reads(&mut wire, 10_000_000)
        };
        let received = run();
        assert_eq!(received, run());
        let lost = 100_000 - received.len();
        assert!((1_850..2_150).contains(&lost), "{lost}");
        let damaged = received.iter().filter(|&&byte| byte != 0).count();
        assert!((4_650..5_150).contains(&damaged), "{damaged}");
        assert!(received.iter().all(|byte| byte.count_ones() <= 1));
    }

    #[test]
    fn faults_are_independent() {
        let run = |corrupt| {
            let mut wire = wire(WireFaults {
                drop: 0.5,
                corrupt,
                ..WireFaults::default()
            });
            let sent: Vec<u8> = (0..100).map(|i| i * 2).collect();
            wire.host_write(0, &sent);
            board_reads(&mut wire, 1_000_000).len()
        };
        assert_eq!(run(0.0), run(1.0));
    }

    #[test]
    fn a_stuck_line_holds_all_bytes_until_release() {
        let mut wire = wire(WireFaults {
            stuck: true,
            ..WireFaults::default()
        });
        wire.host_write(0, &[7; 1000]);
        wire.board_write(0, &[8; 1000]);
        assert_eq!(board_reads(&mut wire, 1_000_000), []);
        assert_eq!(host_reads(&mut wire, 1_000_000), []);
        assert_eq!(wire.bytes_to_board(), 1000);
        wire.faults.stuck = false;
        assert_eq!(host_reads(&mut wire, 1_000_000).len(), 1000);
        assert_eq!(board_reads(&mut wire, 1_000_000), []);
        assert_eq!(board_reads(&mut wire, 1_010_000).len(), 115);
        assert_eq!(board_reads(&mut wire, 1_090_000).len(), 885);
    }

    #[test]
    fn the_end_of_a_delay_does_not_reorder_bytes() {
        let mut wire = wire(WireFaults {
            delay_us: 50_000,
            ..WireFaults::default()
        });
        wire.host_write(0, &[1]);
        wire.faults.delay_us = 0;
        wire.host_write(1_000, &[2]);
        assert_eq!(board_reads(&mut wire, 50_000), []);
        assert_eq!(board_reads(&mut wire, 50_087), [1, 2]);
    }

    #[test]
    fn unplugging_loses_bytes_in_transit() {
        let mut wire = wire(WireFaults::default());
        wire.host_write(0, &[1; 100]);
        wire.set_connected(1_000, false);
        wire.host_write(1_000, &[2; 100]);
        wire.board_write(1_000, &[3; 100]);
        wire.set_connected(2_000, true);
        assert_eq!(board_reads(&mut wire, 100_000), []);
        assert_eq!(host_reads(&mut wire, 100_000), []);
        wire.host_write(100_000, &[4]);
        assert_eq!(board_reads(&mut wire, 101_000), [4]);
    }
}
