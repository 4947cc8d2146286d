//! How long a drive command takes to the board and back.

use singletrack_protocol::Sequence;

/// Commands remembered until their echo: 320 ms at 100 Hz, more than the time to
/// live of a command on the board.
const REMEMBERED: usize = 32;

/// Time from handing out a [`Drive`](singletrack_protocol::Drive) to the
/// arrival of the first telemetry that names it as accepted.
///
/// It includes both ways on the wire and up to one telemetry period of waiting.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RoundTrip {
    /// The shortest so far, in nanoseconds.
    pub min_ns: u64,
    /// The last, in nanoseconds.
    pub last_ns: u64,
}

/// Matches commands with their echoes.
#[derive(Clone, Debug, Default)]
pub(crate) struct Latency {
    sent: [Option<(Sequence, u64)>; REMEMBERED],
    round_trip: Option<RoundTrip>,
}

impl Latency {
    pub(crate) fn sent(&mut self, now_ns: u64, sequence: Sequence) {
        if let Some(slot) = self.sent.get_mut(slot(sequence)) {
            *slot = Some((sequence, now_ns));
        }
    }

    /// Telemetry reports `sequence` as the last accepted command.
    pub(crate) fn echoed(&mut self, now_ns: u64, sequence: Sequence) {
        let Some(slot) = self.sent.get_mut(slot(sequence)) else {
            return;
        };
        if let Some((sent, sent_ns)) = *slot
            && sent == sequence
        {
            *slot = None;
            let last_ns = now_ns.saturating_sub(sent_ns);
            let min_ns = self
                .round_trip
                .map_or(last_ns, |before| before.min_ns.min(last_ns));
            self.round_trip = Some(RoundTrip { min_ns, last_ns });
        }
    }

    /// Forgets the commands that wait for an echo, and keeps the measured times.
    pub(crate) fn forget_sent(&mut self) {
        self.sent = [None; REMEMBERED];
    }

    pub(crate) fn round_trip(&self) -> Option<RoundTrip> {
        self.round_trip
    }
}

fn slot(sequence: Sequence) -> usize {
    usize::from(sequence.0) % REMEMBERED
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_echo_counts_and_repeats_do_not() {
        let mut latency = Latency::default();
        latency.sent(1_000, Sequence(7));
        latency.echoed(9_000, Sequence(7));
        latency.echoed(19_000, Sequence(7));
        latency.sent(20_000, Sequence(8));
        latency.echoed(25_000, Sequence(8));
        assert_eq!(
            latency.round_trip(),
            Some(RoundTrip {
                min_ns: 5_000,
                last_ns: 5_000
            })
        );
    }

    #[test]
    fn an_echo_of_another_session_measures_nothing() {
        let mut latency = Latency::default();
        latency.sent(1_000, Sequence(7));
        latency.echoed(9_000, Sequence(39));
        latency.forget_sent();
        latency.echoed(9_000, Sequence(7));
        assert_eq!(latency.round_trip(), None);
    }
}
