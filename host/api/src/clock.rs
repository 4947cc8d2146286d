//! The offset of a daemon's clock.

use std::time::Duration;

use crate::{ClientError, Connection, Reply, Request};

/// The number of exchanges, of which the fastest counts.
const EXCHANGES: usize = 8;

/// How far a daemon's `CLOCK_MONOTONIC` is ahead of a client's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClockOffset {
    /// The daemon's time less the client's, in ns.
    pub offset_ns: i64,
    /// The largest error of the offset: half the round trip, in ns.
    pub bound_ns: u64,
}

impl ClockOffset {
    /// The daemon's time at `client_ns` of the client's.
    pub const fn daemon_ns(&self, client_ns: u64) -> u64 {
        client_ns.saturating_add_signed(self.offset_ns)
    }

    /// Offset by one exchange: asked at `sent_ns` and answered at `received_ns` of the client's clock,
    /// with `daemon_ns` between.
    const fn of(sent_ns: u64, daemon_ns: u64, received_ns: u64) -> Self {
        let bound_ns = received_ns.saturating_sub(sent_ns).div_ceil(2);
        Self {
            // Two clocks that count from the start of a computer differ by less than 292 years.
            offset_ns: daemon_ns
                .wrapping_sub(sent_ns.saturating_add(bound_ns))
                .cast_signed(),
            bound_ns,
        }
    }
}

impl Connection {
    /// Measures how far the daemon's clock is ahead of `clock`. Each exchange waits for `patience`
    /// at most.
    ///
    /// # Errors
    ///
    /// The connection is lost, or the daemon does not answer with its clock.
    pub fn clock_offset(
        &mut self,
        clock: impl Fn() -> u64,
        patience: Duration,
    ) -> Result<ClockOffset, ClientError> {
        let mut exchange = || -> Result<ClockOffset, ClientError> {
            let sent_ns = clock();
            self.send(&Request::Clock {})?;
            let reply = self.receive_within::<Reply>(patience)?;
            let received_ns = clock();
            let answer = reply.ok_or(ClientError::Ended)?.agreed()?;
            let clocks = answer.clocks.ok_or(ClientError::Ended)?;
            Ok(ClockOffset::of(sent_ns, clocks.monotonic_ns, received_ns))
        };
        let mut best = exchange()?;
        for _ in 1..EXCHANGES {
            let next = exchange()?;
            if next.bound_ns < best.bound_ns {
                best = next;
            }
        }
        Ok(best)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_offset_is_within_its_bound_wherever_the_daemon_read_its_clock() {
        for ahead in [0, 3_000_000_000, -5_000] {
            for read_ns in [10_000, 12_345, 20_001] {
                let daemon_ns = u64::saturating_add_signed(read_ns, ahead);
                let ClockOffset {
                    offset_ns,
                    bound_ns,
                } = ClockOffset::of(10_000, daemon_ns, 20_001);
                assert!(offset_ns.abs_diff(ahead) <= bound_ns, "{ahead} {read_ns}");
            }
        }
    }
}
