//! What a session reports to its owner.

use core::fmt;

use singletrack_protocol::{
    BoardMode, ImuState, RefusalReason, Request, Sequence, Status, Telemetry, VERSION,
};
use singletrack_words::words;

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
    #[must_use]
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
    #[must_use]
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
