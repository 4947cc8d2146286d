//! What happened on the line, counted.

use singletrack_protocol::Status;

/// Counts since the session was made. They wrap after 2^64.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Frames returned to the owner for writing: drive commands, requests, greetings.
    pub frames_sent: u64,
    /// Good frames received.
    pub frames_received: u64,
    /// Frames whose checksum was wrong.
    pub crc_errors: u64,
    /// Frames damaged otherwise: bad stuffing, too long, too short; and good
    /// frames that hold no message of this protocol.
    pub decode_errors: u64,
    /// Good frames that did not fit the state of the session: the answer to a
    /// dropped request, telemetry before the answer to the greeting.
    pub frames_ignored: u64,
    /// Telemetry records that the board made and the host never received.
    pub telemetry_missing: u64,
    /// Telemetry records dropped because their board time is implausible.
    pub telemetry_implausible: u64,
    /// Times that the board was silent for too long.
    pub links_lost: u64,
    /// Times that the port was closed or hung up.
    pub hang_ups: u64,
    /// Times that the board lost its state while connected.
    pub board_restarts: u64,
    /// Requests that the board never answered.
    pub requests_unanswered: u64,
}

/// Good and damaged frames over a span of time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LineQuality {
    /// Frames that arrived whole.
    pub good: u32,
    /// Frames that arrived damaged.
    pub damaged: u32,
}

impl LineQuality {
    /// Smallest number of frames for which a fraction is meaningful.
    const SIGNIFICANT: u32 = 20;

    /// Damaged frames as a fraction of all, 0 to 1; `None` while there are too few.
    ///
    /// One damaged byte damages a frame of n bytes: with telemetry of 40 bytes, 0.5 %
    /// of damaged bytes gives a fraction of about 0.18, and 5 % about 0.87.
    #[must_use]
    pub fn damaged_fraction(&self) -> Option<f32> {
        let all = self.good.saturating_add(self.damaged);
        (all >= Self::SIGNIFICANT).then(|| self.damaged as f32 / all as f32)
    }
}

/// [`LineQuality`] over the last second, in tenths.
#[derive(Clone, Debug, Default)]
pub(crate) struct QualityWindow {
    tenths: [LineQuality; Self::TENTHS],
    /// Number of the tenth that `tenths` was last written in, since time zero.
    newest: u64,
}

impl QualityWindow {
    const TENTHS: usize = 10;
    const TENTH_NS: u64 = 100_000_000;

    pub(crate) fn good(&mut self, now_ns: u64) {
        if let Some(tenth) = self.tenth(now_ns) {
            tenth.good = tenth.good.saturating_add(1);
        }
    }

    pub(crate) fn damaged(&mut self, now_ns: u64) {
        if let Some(tenth) = self.tenth(now_ns) {
            tenth.damaged = tenth.damaged.saturating_add(1);
        }
    }

    pub(crate) fn over_last_second(&self, now_ns: u64) -> LineQuality {
        let now = now_ns / Self::TENTH_NS;
        let mut sum = LineQuality::default();
        for age in 0..Self::TENTHS as u64 {
            // The array stores `newest` and the nine tenths before it.
            let number = self.newest.checked_sub(age);
            if let Some(number) = number
                && now.saturating_sub(number) < Self::TENTHS as u64
                && let Some(tenth) = self.tenths.get(Self::slot(number))
            {
                sum.good = sum.good.saturating_add(tenth.good);
                sum.damaged = sum.damaged.saturating_add(tenth.damaged);
            }
        }
        sum
    }

    fn tenth(&mut self, now_ns: u64) -> Option<&mut LineQuality> {
        let now = now_ns / Self::TENTH_NS;
        if now > self.newest {
            let passed = (now - self.newest).min(Self::TENTHS as u64);
            for back in 0..passed {
                if let Some(tenth) = self.tenths.get_mut(Self::slot(now - back)) {
                    *tenth = LineQuality::default();
                }
            }
            self.newest = now;
        }
        self.tenths.get_mut(Self::slot(self.newest))
    }

    fn slot(number: u64) -> usize {
        (number % Self::TENTHS as u64) as usize
    }
}

/// [`LineQuality`] towards the board, from the board's own counters.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct BoardQuality {
    since: Option<Status>,
    last: Option<LineQuality>,
}

impl BoardQuality {
    const SPAN_US: u32 = 1_000_000;

    pub(crate) fn observe(&mut self, status: &Status) {
        let Some(since) = &self.since else {
            self.since = Some(*status);
            return;
        };
        let span_us = status.board_time_us.wrapping_sub(since.board_time_us);
        if span_us >= Self::SPAN_US {
            let count = |now: u16, then: u16| u32::from(now.wrapping_sub(then));
            self.last = Some(LineQuality {
                good: count(status.frames_received, since.frames_received),
                damaged: count(status.frames_damaged, since.frames_damaged),
            });
            self.since = Some(*status);
        }
    }

    pub(crate) const fn last(&self) -> Option<LineQuality> {
        self.last
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pause_takes_the_oldest_tenths_alone() {
        const TENTH_NS: u64 = 100_000_000;
        let mut window = QualityWindow::default();
        for tenth in 20..30 {
            for _ in 0..=tenth {
                window.good(tenth * TENTH_NS);
            }
        }
        // Three tenths without a frame, and one frame: 23 to 29 are left.
        window.good(33 * TENTH_NS);
        let left: u32 = (24..30).map(|tenth| tenth + 1).sum();
        assert_eq!(window.over_last_second(33 * TENTH_NS).good, left + 1);
    }

    #[test]
    fn the_window_forgets_after_a_second() {
        let mut window = QualityWindow::default();
        for ms in 0..3_000_u64 {
            if ms < 1_000 {
                window.damaged(ms * 1_000_000);
            } else {
                window.good(ms * 1_000_000);
            }
        }
        let at_end = window.over_last_second(2_999_000_000);
        assert_eq!(at_end.damaged, 0);
        assert_eq!(at_end.good, 1_000);
        let later = window.over_last_second(3_450_000_000);
        assert_eq!((later.good, later.damaged), (500, 0));
        assert_eq!(window.over_last_second(9_000_000_000).good, 0);
    }

    #[test]
    fn after_a_long_silence_nothing_old_is_counted() {
        let mut window = QualityWindow::default();
        window.damaged(0);
        window.good(55_550_000_000);
        let quality = window.over_last_second(55_550_000_000);
        assert_eq!((quality.good, quality.damaged), (1, 0));
    }

    #[test]
    fn a_fraction_needs_enough_frames() {
        assert_eq!(
            LineQuality {
                good: 0,
                damaged: 19
            }
            .damaged_fraction(),
            None
        );
        assert_eq!(
            LineQuality {
                good: 15,
                damaged: 5
            }
            .damaged_fraction(),
            Some(0.25)
        );
    }
}
