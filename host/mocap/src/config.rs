//! The configuration of a session.

use core::net::{IpAddr, Ipv4Addr};

use crate::{
    body::{BodyReading, UpAxis},
    codec::BitstreamVersion,
};

/// The command port of a NatNet server, unless configured otherwise.
pub const DEFAULT_COMMAND_PORT: u16 = 1510;
/// The port of a VRPN server, unless configured otherwise.
pub const DEFAULT_VRPN_PORT: u16 = 3883;
/// The little-endian port of a QTM server, unless configured otherwise.
pub const DEFAULT_QUALISYS_PORT: u16 = 22_223;
/// The server's data port, unless configured otherwise.
pub const DEFAULT_DATA_PORT: u16 = 1511;
/// The multicast group, unless configured otherwise.
pub const DEFAULT_MULTICAST_GROUP: Ipv4Addr = Ipv4Addr::new(239, 255, 42, 99);

/// Largest deviation of a quaternion's norm from one, unless configured otherwise.
pub const DEFAULT_QUATERNION_NORM_TOLERANCE: f64 = 0.01;

/// The configuration of a [`Session`](crate::Session).
///
/// Make one with [`new`](Self::new), then set the fields that differ:
///
/// ```
/// # use singletrack_mocap::{SessionConfig, Transport, UpAxis};
/// let server = "192.168.1.10".parse().expect("an address");
/// let mut config = SessionConfig::new(server, Transport::Multicast, UpAxis::Y);
/// config.timing.stale_after_ns = 50_000_000;
/// ```
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct SessionConfig {
    /// The server's address. Datagrams from other addresses are counted and
    /// dropped.
    pub server: IpAddr,
    /// What the server speaks.
    pub protocol: Protocol,
    /// The server's command port.
    pub command_port: u16,
    /// How the frames arrive.
    pub transport: Transport,
    /// The server's up axis, which is not on the wire.
    pub up_axis: UpAxis,
    /// Largest deviation of a quaternion's norm from one.
    pub quaternion_norm_tolerance: f64,
    /// Intervals, time-outs, and assumptions about delays and clocks.
    pub timing: Timing,
}

/// What the server speaks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Protocol {
    /// NatNet, on UDP.
    NatNet,
    /// VRPN, on TCP and UDP: a body is a sensor of a tracker.
    Vrpn {
        /// The sensor's number.
        sensor: i32,
    },
    /// The real-time protocol of Qualisys QTM, on TCP and UDP.
    Qualisys,
}

impl Protocol {
    /// The server's port, unless configured otherwise.
    pub const fn default_port(self) -> u16 {
        match self {
            Self::NatNet => DEFAULT_COMMAND_PORT,
            Self::Vrpn { .. } => DEFAULT_VRPN_PORT,
            Self::Qualisys => DEFAULT_QUALISYS_PORT,
        }
    }
}

/// How the frames arrive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Transport {
    /// The server sends to this client alone, as long as it is kept alive.
    Unicast {
        /// The bitstream to request from a newer server. `None` takes the server's
        /// own.
        bitstream: Option<BitstreamVersion>,
    },
    /// The server sends its own bitstream to a group that the socket has joined (NatNet).
    Multicast,
    /// The server sends frames over the stream, not as datagrams (VRPN, Qualisys).
    Stream,
}

/// Intervals, time-outs and assumptions, in nanoseconds.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Timing {
    /// Between two attempts to connect, or to have the bitstream changed.
    pub retry_ns: u64,
    /// Between two keep-alives (unicast).
    pub keep_alive_ns: u64,
    /// Between two echo requests, once the clock is known.
    pub echo_ns: u64,
    /// Between two requests for the model definitions, once they have been read.
    pub model_poll_ns: u64,
    /// A stream that is silent for longer is stale.
    pub stale_after_ns: u64,
    /// After a longer silence the session connects again.
    pub reconnect_after_ns: u64,
    /// Without echoes: the network delay assumed. Half of it is unknown either way.
    pub assumed_network_delay_ns: u64,
    /// Without mid-exposure time: the age assumed of a frame's timestamp when the
    /// frame arrives.
    pub assumed_latency_ns: u64,
    /// Constant error of the server's time stamps, which is subtracted from every capture
    /// time. Positive: the stamps are too late.
    pub stamp_offset_ns: i64,
    /// Largest difference between the rates of the two clocks.
    pub max_clock_skew_ppm: f64,
}

impl Default for Timing {
    fn default() -> Self {
        Self {
            retry_ns: 500_000_000,
            keep_alive_ns: 1_000_000_000,
            echo_ns: 700_000_000,
            model_poll_ns: 5_000_000_000,
            stale_after_ns: 100_000_000,
            reconnect_after_ns: 2_000_000_000,
            assumed_network_delay_ns: 300_000,
            assumed_latency_ns: 4_000_000,
            stamp_offset_ns: 0,
            max_clock_skew_ppm: 200.0,
        }
    }
}

/// Why a session refuses its configuration.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SessionConfigError {
    /// A limit that is not a positive number.
    #[error("{key} is {value}, it must be a positive number")]
    NotPositive {
        /// The configuration's field.
        key: &'static str,
        /// Its value.
        value: f64,
    },
    /// An interval that is zero.
    #[error("{key} is 0, it must be at least 1")]
    Zero {
        /// The configuration's field.
        key: &'static str,
    },
}

impl SessionConfig {
    /// A configuration with the default command port, tolerance and timing.
    pub fn new(server: IpAddr, transport: Transport, up_axis: UpAxis) -> Self {
        Self {
            server,
            protocol: Protocol::NatNet,
            command_port: DEFAULT_COMMAND_PORT,
            transport,
            up_axis,
            quaternion_norm_tolerance: DEFAULT_QUATERNION_NORM_TOLERANCE,
            timing: Timing::default(),
        }
    }

    /// How bodies are read.
    pub(crate) const fn reading(&self) -> BodyReading {
        BodyReading {
            up_axis: self.up_axis,
            quaternion_norm_tolerance: self.quaternion_norm_tolerance,
        }
    }

    /// Checks the values, as [`Session::new`](crate::Session::new) does.
    ///
    /// # Errors
    /// The first field whose value can't be used.
    pub fn validate(&self) -> Result<(), SessionConfigError> {
        let timing = &self.timing;
        positive(&[
            ("quaternion_norm_tolerance", self.quaternion_norm_tolerance),
            ("max_clock_skew_ppm", timing.max_clock_skew_ppm),
        ])?;
        not_zero(&[
            ("retry_ns", timing.retry_ns),
            ("keep_alive_ns", timing.keep_alive_ns),
            ("echo_ns", timing.echo_ns),
            ("model_poll_ns", timing.model_poll_ns),
            ("stale_after_ns", timing.stale_after_ns),
            ("reconnect_after_ns", timing.reconnect_after_ns),
        ])
    }
}

/// Refuses the first value that is not a positive number.
pub(crate) fn positive(values: &[(&'static str, f64)]) -> Result<(), SessionConfigError> {
    let is_wrong = |(_, value): &&(_, f64)| !(value.is_finite() && *value > 0.0);
    match values.iter().find(is_wrong) {
        Some(&(key, value)) => Err(SessionConfigError::NotPositive { key, value }),
        None => Ok(()),
    }
}

/// Refuses the first value that is zero.
pub(crate) fn not_zero(values: &[(&'static str, u64)]) -> Result<(), SessionConfigError> {
    match values.iter().find(|(_, value)| *value == 0) {
        Some(&(key, _)) => Err(SessionConfigError::Zero { key }),
        None => Ok(()),
    }
}
