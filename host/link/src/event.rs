//! Events of a session, and what it counts.

use core::fmt;

use singletrack_protocol::words;
use singletrack_protocol::{
    BoardMode, ImuState, RefusalReason, Request, Sequence, Status, Telemetry, VERSION,
};

/// What happened. The handlers pass events to their owner in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// The board answered the greeting and speaks the session's version.
    Connected {
        /// The board's software: major, minor, patch.
        board_software_version: [u8; 3],
    },
    /// The board named the car that it is built into: after
    /// [`Event::Connected`].
    Identified {
        /// The number of its image; zero for none.
        car_id: u16,
    },
    /// The board answered and speaks another version: one side must be updated.
    /// Reported once; the session greets the board again every second.
    VersionMismatch(VersionMismatch),
    /// The board has the session's configuration: the session is ready.
    ConfigurationAccepted {
        /// Its [`hash`](singletrack_protocol::Configuration::hash).
        hash: u32,
    },
    /// The board refused the configuration. Reported once for each reason; the
    /// session offers it again every second.
    ConfigurationRefused {
        /// Why.
        reason: RefusalReason,
    },
    /// The board has lost all its state. The session greets and configures it again,
    /// and then waits: whether to arm again is the owner's decision.
    BoardRestarted {
        /// How it was noticed.
        evidence: RestartEvidence,
    },
    /// A telemetry record, with its times.
    Telemetry(TimedTelemetry),
    /// A status record.
    Status(Status),
    /// The board carried out the request: it is armed, or it has accepted the stop.
    /// (An accepted configuration is [`Event::ConfigurationAccepted`].)
    Acknowledged {
        /// The request.
        request: Request,
        /// The number that the request returned.
        sequence: Sequence,
    },
    /// The board refused the request.
    Refused {
        /// The request.
        request: Request,
        /// The number that the request returned.
        sequence: Sequence,
        /// Why.
        reason: RefusalReason,
    },
    /// The board did not answer; the request is dropped.
    Unanswered {
        /// The request.
        request: Request,
        /// The number that the request returned.
        sequence: Sequence,
    },
    /// Telemetry shows that a [`Request::Disarm`] or
    /// [`Request::EmergencyStop`] has had its effect.
    StopConfirmed {
        /// The request.
        request: Request,
    },
    /// The board is silent, or the port was closed. A pending request to arm is
    /// dropped. While the port is open, the session greets the board.
    Lost {
        /// How it was noticed.
        cause: LossCause,
    },
}

/// A call of the owner: its time, and who is told what happens.
pub(crate) struct Wake<'a> {
    pub(crate) now_ns: u64,
    pub(crate) on_event: &'a mut dyn FnMut(Event),
}

impl Wake<'_> {
    pub(crate) fn tell(&mut self, event: Event) {
        (self.on_event)(event);
    }
}

/// A telemetry record in host time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TimedTelemetry {
    /// The record.
    pub telemetry: Telemetry,
    /// When the record's last byte was received, in host nanoseconds.
    pub receive_time_ns: u64,
    /// When the board made the record, in host nanoseconds: never before that
    /// of an earlier record, never after `receive_time_ns`.
    pub board_time_host_ns: u64,
    /// When the IMU took its sample, in host nanoseconds. `None` when the IMU
    /// is [`ImuState::Silent`] or the age is beyond the wire's range.
    pub imu_time_host_ns: Option<u64>,
}

impl TimedTelemetry {
    /// Whether the record carries an IMU sample that none before it carried.
    pub fn has_fresh_imu_sample(&self) -> bool {
        self.telemetry.imu == ImuState::Fresh && self.imu_time_host_ns.is_some()
    }
}

words! {
    /// How a restart of the board was noticed.
    pub enum RestartEvidence {
        /// The board reported it: a [`Hello`](singletrack_protocol::Hello) that answers no
        /// greeting.
        Announced = "announced",
        /// Its clock started again.
        ClockRestarted = "clock-restarted",
        /// It no longer has the session's configuration.
        ConfigurationGone = "configuration-gone",
    }
}

words! {
    /// How the loss of the board was noticed.
    pub enum LossCause {
        /// No good frame for [`LINK_TIMEOUT_NS`](crate::LINK_TIMEOUT_NS).
        Silence = "silence",
        /// The port was closed or hung up.
        HangUp = "hang-up",
    }
}

/// Two protocol versions that differ.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct VersionMismatch {
    /// The protocol version that the board speaks.
    pub board_protocol: u16,
    /// The board's software: major, minor, patch.
    pub board_software: [u8; 3],
    /// The host's software: major, minor, patch.
    pub host_software: [u8; 3],
}

impl VersionMismatch {
    /// The protocol version that the host speaks.
    pub const HOST_PROTOCOL: u16 = VERSION;

    /// The side to update.
    pub fn outdated(&self) -> Side {
        if self.board_protocol < Self::HOST_PROTOCOL {
            Side::Board
        } else {
            Side::Host
        }
    }
}

impl fmt::Display for VersionMismatch {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            board_protocol,
            board_software: board,
            host_software: host,
        } = self;
        write!(
            formatter,
            "the board (software {}.{}.{}) speaks protocol {board_protocol}, the host (software {}.{}.{}) speaks protocol {VERSION}: ",
            board[0], board[1], board[2], host[0], host[1], host[2]
        )?;
        formatter.write_str(match self.outdated() {
            Side::Board => "flash the board with the firmware of the host's release",
            Side::Host => "install the host software of the board's release",
        })
    }
}

impl core::error::Error for VersionMismatch {}

/// One of the two computers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// The Odroid.
    Host,
    /// The Arduino.
    Board,
}

/// How far a session is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// The port is closed.
    Disconnected,
    /// The session greets the board, which has not answered yet. An UNO that was reset
    /// by opening the port needs up to 3 s.
    Greeting {
        /// Since when, in host nanoseconds.
        since_ns: u64,
    },
    /// Board and host speak different versions.
    VersionMismatch(VersionMismatch),
    /// The session has sent the configuration, and the board has not answered yet.
    Configuring,
    /// The board refused the configuration.
    ConfigurationRefused {
        /// Why.
        reason: RefusalReason,
    },
    /// The board has the configuration. It drives only in
    /// [`BoardMode::Armed`] and [`BoardMode::Driving`].
    Ready {
        /// The board's mode by the newest telemetry; `None` before the first.
        mode: Option<BoardMode>,
    },
}

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
        let good = &mut self.tenth(now_ns).good;
        *good = good.saturating_add(1);
    }

    pub(crate) fn damaged(&mut self, now_ns: u64) {
        let damaged = &mut self.tenth(now_ns).damaged;
        *damaged = damaged.saturating_add(1);
    }

    pub(crate) fn over_last_second(&self, now_ns: u64) -> LineQuality {
        let now = now_ns / Self::TENTH_NS;
        let span = Self::TENTHS as u64;
        let mut sum = LineQuality::default();
        // The array stores `newest` and the nine tenths before it.
        let stored = self.newest.saturating_sub(span - 1)..=self.newest;
        for number in stored.filter(|number| now.saturating_sub(*number) < span) {
            let tenth = self.tenths[Self::slot(number)];
            sum.good = sum.good.saturating_add(tenth.good);
            sum.damaged = sum.damaged.saturating_add(tenth.damaged);
        }
        sum
    }

    fn tenth(&mut self, now_ns: u64) -> &mut LineQuality {
        let now = now_ns / Self::TENTH_NS;
        if now > self.newest {
            let passed = (now - self.newest).min(Self::TENTHS as u64);
            for back in 0..passed {
                self.tenths[Self::slot(now - back)] = LineQuality::default();
            }
            self.newest = now;
        }
        &mut self.tenths[Self::slot(self.newest)]
    }

    fn slot(number: u64) -> usize {
        (number % Self::TENTHS as u64) as usize
    }
}

/// [`LineQuality`] towards the board, from the board's own counters.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct BoardQuality {
    since: Option<Status>,
    /// The quality over the last span; none before two reports.
    pub(crate) last: Option<LineQuality>,
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
