//! What a session must be told.

use core::net::{IpAddr, Ipv4Addr};

use crate::codec::BitstreamVersion;
use crate::pose::UpAxis;

/// The server's command port, unless configured otherwise.
pub const DEFAULT_COMMAND_PORT: u16 = 1510;
/// The server's data port, unless configured otherwise.
pub const DEFAULT_DATA_PORT: u16 = 1511;
/// The multicast group, unless configured otherwise.
pub const DEFAULT_MULTICAST_GROUP: Ipv4Addr = Ipv4Addr::new(239, 255, 42, 99);

/// A rigid body's name as in the server's asset list.
pub type RigidBodyName = heapless::String<255>;

/// The configuration of a [`Session`](crate::Session).
#[derive(Debug, Clone, PartialEq)]
pub struct Config {
    /// The server's address. Datagrams from elsewhere are counted and dropped.
    pub server: IpAddr,
    /// The server's command port.
    pub command_port: u16,
    /// How the frames come.
    pub transport: Transport,
    /// The body to follow.
    pub rigid_body: RigidBodyName,
    /// The server's up axis, which is not on the wire.
    pub up_axis: UpAxis,
    /// What a believable pose is.
    pub limits: PoseLimits,
    /// Intervals, time-outs and what is assumed of delays and clocks.
    pub timing: Timing,
}

/// How the frames come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Transport {
    /// The server sends to us alone, as long as we keep it alive.
    Unicast {
        /// The bitstream to ask a newer server for. `None` takes its own.
        bitstream: Option<BitstreamVersion>,
    },
    /// The server sends its own bitstream to a group that the socket joined.
    Multicast,
}

/// What a believable pose is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseLimits {
    /// Largest mean marker error, in metres.
    pub max_mean_error_m: f64,
    /// Fastest the body can move, in metres per second.
    pub max_speed_m_s: f64,
    /// Distance allowed on top of what speed and time explain, in metres.
    pub jump_margin_m: f64,
    /// Fastest the body can yaw, in radians per second.
    pub max_yaw_rate_rad_s: f64,
    /// Yaw allowed on top of what yaw rate and time explain, in radians.
    pub yaw_margin_rad: f64,
    /// Largest angle between the body's up axis and the world's, in radians.
    pub max_tilt_rad: f64,
    /// Largest deviation of the quaternion's norm from one.
    pub quaternion_norm_tolerance: f64,
    /// After this many rejected poses in a row the state says that the body is
    /// locked out; after as many more that agree with each other, they are
    /// believed again.
    pub max_consecutive_rejects: u32,
}

impl Default for PoseLimits {
    /// Limits for a model car on a floor.
    fn default() -> Self {
        Self {
            max_mean_error_m: 0.005,
            max_speed_m_s: 5.0,
            jump_margin_m: 0.05,
            max_yaw_rate_rad_s: 10.0,
            yaw_margin_rad: 0.3,
            max_tilt_rad: 0.5,
            quaternion_norm_tolerance: 0.01,
            max_consecutive_rejects: 10,
        }
    }
}

/// Intervals, time-outs and assumptions, in nanoseconds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Timing {
    /// Between two attempts to connect, or to have the bitstream changed.
    pub retry_ns: u64,
    /// Between two keep-alives (unicast).
    pub keep_alive_ns: u64,
    /// Between two echo requests, once the clock is known.
    pub echo_ns: u64,
    /// Between two requests for the model definitions, once the body is bound.
    pub model_poll_ns: u64,
    /// A stream silent for longer is stale.
    pub stale_after_ns: u64,
    /// A stream silent for longer is connected to anew.
    pub reconnect_after_ns: u64,
    /// Without echoes: the network delay assumed, half of it either way unknown.
    pub assumed_network_delay_ns: u64,
    /// Without mid-exposure time: the age assumed of a frame's timestamp when
    /// it arrives.
    pub assumed_latency_ns: u64,
    /// How far the two clocks' rates can differ.
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
            max_clock_skew_ppm: 200.0,
        }
    }
}

/// Why a configuration is refused.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum ConfigError {
    /// No name, or one that NatNet cannot carry.
    #[error("the rigid body's name is {len} bytes long, it must be 1 to 255")]
    RigidBodyName {
        /// Length of the name.
        len: usize,
    },
    /// A limit that is not a positive number.
    #[error("{key} is {value}, it must be a positive number")]
    NotPositive {
        /// The configuration's field.
        key: &'static str,
        /// Its value.
        value: f64,
    },
    /// An interval or a count that is zero.
    #[error("{key} is 0, it must be at least 1")]
    Zero {
        /// The configuration's field.
        key: &'static str,
    },
}

impl Config {
    /// A configuration with default ports, limits and timing.
    ///
    /// # Errors
    /// The name is empty or longer than 255 bytes.
    pub fn new(
        server: IpAddr,
        transport: Transport,
        rigid_body: &str,
        up_axis: UpAxis,
    ) -> Result<Self, ConfigError> {
        let config = Self {
            server,
            command_port: DEFAULT_COMMAND_PORT,
            transport,
            rigid_body: RigidBodyName::try_from(rigid_body).map_err(|_| {
                ConfigError::RigidBodyName {
                    len: rigid_body.len(),
                }
            })?,
            up_axis,
            limits: PoseLimits::default(),
            timing: Timing::default(),
        };
        config.validate()?;
        Ok(config)
    }

    pub(crate) fn validate(&self) -> Result<(), ConfigError> {
        if self.rigid_body.is_empty() {
            return Err(ConfigError::RigidBodyName { len: 0 });
        }
        let limits = &self.limits;
        for (key, value) in [
            ("max_mean_error_m", limits.max_mean_error_m),
            ("max_speed_m_s", limits.max_speed_m_s),
            ("jump_margin_m", limits.jump_margin_m),
            ("max_yaw_rate_rad_s", limits.max_yaw_rate_rad_s),
            ("yaw_margin_rad", limits.yaw_margin_rad),
            ("max_tilt_rad", limits.max_tilt_rad),
            (
                "quaternion_norm_tolerance",
                limits.quaternion_norm_tolerance,
            ),
            ("max_clock_skew_ppm", self.timing.max_clock_skew_ppm),
        ] {
            if !(value.is_finite() && value > 0.0) {
                return Err(ConfigError::NotPositive { key, value });
            }
        }
        let timing = &self.timing;
        for (key, value) in [
            ("retry_ns", timing.retry_ns),
            ("keep_alive_ns", timing.keep_alive_ns),
            ("echo_ns", timing.echo_ns),
            ("model_poll_ns", timing.model_poll_ns),
            ("stale_after_ns", timing.stale_after_ns),
            ("reconnect_after_ns", timing.reconnect_after_ns),
            (
                "max_consecutive_rejects",
                u64::from(limits.max_consecutive_rejects),
            ),
        ] {
            if value == 0 {
                return Err(ConfigError::Zero { key });
            }
        }
        Ok(())
    }
}
