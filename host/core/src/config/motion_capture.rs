//! `[motion_capture]`: the cameras.

use core::{
    net::{IpAddr, Ipv4Addr},
    str::FromStr,
};

use serde::{Deserialize, Deserializer, Serialize, Serializer, de};
use singletrack_mocap::{
    DEFAULT_COMMAND_PORT, DEFAULT_DATA_PORT, DEFAULT_MULTICAST_GROUP,
    DEFAULT_QUATERNION_NORM_TOLERANCE, PoseLimits, Timing, Transport, UpAxis,
    codec::BitstreamVersion, planar::PlanarConfig,
};

use super::{ConfigError, check};

/// Where the cameras are and what is believed of them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotionCaptureSection {
    /// Address of the NatNet server.
    pub server: Ipv4Addr,
    /// Name of the car's rigid body, as in the server's asset list.
    pub rigid_body: String,
    /// The axis that points up in the stream: a setting of the server that is
    /// not on the wire.
    pub up_axis: UpAxisKind,
    /// Address of the local network interface; mandatory for multicast.
    #[serde(default = "default_interface")]
    pub interface: Ipv4Addr,
    /// How the frames come.
    #[serde(default = "default_transport")]
    pub transport: TransportKind,
    /// The bitstream to ask the server for (unicast); its own if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bitstream: Option<Bitstream>,
    /// The server's command port.
    #[serde(default = "default_command_port")]
    pub command_port: u16,
    /// The port that multicast frames come to.
    #[serde(default = "default_data_port")]
    pub data_port: u16,
    /// The multicast group.
    #[serde(default = "default_group")]
    pub group: Ipv4Addr,
    /// Position of the rigid body's pivot from the centre of mass: forward, left.
    #[serde(default)]
    pub marker_offset_m: [f64; 2],
    /// Yaw of the rigid body when the car's yaw is zero.
    #[serde(default)]
    pub marker_yaw_rad: f64,
    /// What a believable pose is.
    #[serde(default)]
    pub pose: PoseSection,
    /// Intervals, time-outs and assumptions.
    #[serde(default)]
    pub timing: TimingSection,
}

/// The axis that points up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum UpAxisKind {
    /// Motive's default.
    Y,
    /// As in our world.
    Z,
}

/// How the frames come.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TransportKind {
    /// To us alone.
    Unicast,
    /// To a group.
    Multicast,
}

/// A NatNet bitstream version, written `"4.1"`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bitstream(pub BitstreamVersion);

impl FromStr for Bitstream {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (major, minor) = text
            .split_once('.')
            .and_then(|(major, minor)| Some((major.parse().ok()?, minor.parse().ok()?)))
            .ok_or_else(|| format!("bitstream is {text:?}: write it as \"4.1\""))?;
        BitstreamVersion::new(major, minor)
            .map(Self)
            .map_err(|error| error.to_string())
    }
}

impl Serialize for Bitstream {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(&self.0)
    }
}

impl<'de> Deserialize<'de> for Bitstream {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?
            .parse()
            .map_err(de::Error::custom)
    }
}

fn default_interface() -> Ipv4Addr {
    Ipv4Addr::UNSPECIFIED
}

fn default_transport() -> TransportKind {
    TransportKind::Unicast
}

fn default_command_port() -> u16 {
    DEFAULT_COMMAND_PORT
}

fn default_data_port() -> u16 {
    DEFAULT_DATA_PORT
}

fn default_group() -> Ipv4Addr {
    DEFAULT_MULTICAST_GROUP
}

/// What a believable pose is.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PoseSection {
    /// Largest mean marker error.
    pub max_mean_error_m: f64,
    /// Fastest the body can move.
    pub max_speed_m_s: f64,
    /// Distance allowed on top of what speed and time explain.
    pub jump_margin_m: f64,
    /// Fastest the body can yaw.
    pub max_yaw_rate_rad_s: f64,
    /// Yaw allowed on top of what yaw rate and time explain.
    pub yaw_margin_rad: f64,
    /// Largest angle between the body's up axis and the world's.
    pub max_tilt_rad: f64,
    /// Largest deviation of the quaternion's norm from one.
    pub quaternion_norm_tolerance: f64,
    /// Rejected poses in a row until the body counts as lost.
    pub max_consecutive_rejects: u32,
}

impl Default for PoseSection {
    fn default() -> Self {
        let limits = PoseLimits::default();
        Self {
            max_mean_error_m: limits.max_mean_error_m,
            max_speed_m_s: limits.max_speed_m_s,
            jump_margin_m: limits.jump_margin_m,
            max_yaw_rate_rad_s: limits.max_yaw_rate_rad_s,
            yaw_margin_rad: limits.yaw_margin_rad,
            max_tilt_rad: limits.max_tilt_rad,
            quaternion_norm_tolerance: DEFAULT_QUATERNION_NORM_TOLERANCE,
            max_consecutive_rejects: limits.max_consecutive_rejects,
        }
    }
}

/// Intervals, time-outs and assumptions.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TimingSection {
    /// A stream silent for longer is stale.
    pub stale_after_ms: u32,
    /// A stream silent for longer is connected to anew.
    pub reconnect_after_ms: u32,
    /// Without echoes (before NatNet 3.0): the network delay assumed.
    pub assumed_network_delay_us: u32,
    /// Without mid-exposure time: the age assumed of a frame when it arrives.
    pub assumed_latency_us: u32,
}

/// Nanoseconds in a microsecond and in a millisecond.
const US: u64 = 1_000;
const MS: u64 = 1_000_000;

impl Default for TimingSection {
    fn default() -> Self {
        let timing = Timing::default();
        // The defaults are seconds at most.
        let in_units = |ns: u64, unit: u64| (ns / unit) as u32;
        Self {
            stale_after_ms: in_units(timing.stale_after_ns, MS),
            reconnect_after_ms: in_units(timing.reconnect_after_ns, MS),
            assumed_network_delay_us: in_units(timing.assumed_network_delay_ns, US),
            assumed_latency_us: in_units(timing.assumed_latency_ns, US),
        }
    }
}

impl MotionCaptureSection {
    /// A unicast server with its own bitstream and default ports.
    #[must_use]
    pub fn new(server: Ipv4Addr, rigid_body: impl Into<String>, up_axis: UpAxisKind) -> Self {
        Self {
            server,
            rigid_body: rigid_body.into(),
            up_axis,
            interface: default_interface(),
            transport: default_transport(),
            bitstream: None,
            command_port: default_command_port(),
            data_port: default_data_port(),
            group: default_group(),
            marker_offset_m: [0.0; 2],
            marker_yaw_rad: 0.0,
            pose: PoseSection::default(),
            timing: TimingSection::default(),
        }
    }

    /// For the session.
    ///
    /// # Errors
    ///
    /// The name of a rigid body that NatNet cannot carry.
    pub fn session(&self) -> Result<PlanarConfig, ConfigError> {
        let mut config = PlanarConfig::new(
            IpAddr::V4(self.server),
            match self.transport {
                TransportKind::Unicast => Transport::Unicast {
                    bitstream: self.bitstream.map(|bitstream| bitstream.0),
                },
                TransportKind::Multicast => Transport::Multicast,
            },
            &self.rigid_body,
            match self.up_axis {
                UpAxisKind::Y => UpAxis::Y,
                UpAxisKind::Z => UpAxis::Z,
            },
        )
        .map_err(|error| {
            ConfigError::value(
                "motion_capture.rigid_body",
                format!("{:?}", self.rigid_body),
                error.to_string(),
            )
        })?;
        let session = &mut config.session;
        session.command_port = self.command_port;
        let pose = &self.pose;
        session.quaternion_norm_tolerance = pose.quaternion_norm_tolerance;
        let timing = &self.timing;
        session.timing.stale_after_ns = u64::from(timing.stale_after_ms) * MS;
        session.timing.reconnect_after_ns = u64::from(timing.reconnect_after_ms) * MS;
        session.timing.assumed_network_delay_ns = u64::from(timing.assumed_network_delay_us) * US;
        session.timing.assumed_latency_ns = u64::from(timing.assumed_latency_us) * US;
        config.limits = PoseLimits {
            max_mean_error_m: pose.max_mean_error_m,
            max_speed_m_s: pose.max_speed_m_s,
            jump_margin_m: pose.jump_margin_m,
            max_yaw_rate_rad_s: pose.max_yaw_rate_rad_s,
            yaw_margin_rad: pose.yaw_margin_rad,
            max_tilt_rad: pose.max_tilt_rad,
            max_consecutive_rejects: pose.max_consecutive_rejects,
        };
        Ok(config)
    }

    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        self.validate_network()?;
        for (key, value, highest) in [
            (
                "motion_capture.pose.max_mean_error_m",
                self.pose.max_mean_error_m,
                0.1,
            ),
            (
                "motion_capture.pose.max_speed_m_s",
                self.pose.max_speed_m_s,
                50.0,
            ),
            (
                "motion_capture.pose.jump_margin_m",
                self.pose.jump_margin_m,
                1.0,
            ),
            (
                "motion_capture.pose.max_yaw_rate_rad_s",
                self.pose.max_yaw_rate_rad_s,
                100.0,
            ),
            (
                "motion_capture.pose.yaw_margin_rad",
                self.pose.yaw_margin_rad,
                3.0,
            ),
            (
                "motion_capture.pose.max_tilt_rad",
                self.pose.max_tilt_rad,
                1.5,
            ),
            (
                "motion_capture.pose.quaternion_norm_tolerance",
                self.pose.quaternion_norm_tolerance,
                0.5,
            ),
        ] {
            check::positive(key, value, highest)?;
        }
        for (key, value, range) in [
            (
                "motion_capture.pose.max_consecutive_rejects",
                self.pose.max_consecutive_rejects,
                1..=1_000,
            ),
            (
                "motion_capture.timing.stale_after_ms",
                self.timing.stale_after_ms,
                20..=1_000,
            ),
            (
                "motion_capture.timing.reconnect_after_ms",
                self.timing.reconnect_after_ms,
                500..=60_000,
            ),
            (
                "motion_capture.timing.assumed_network_delay_us",
                self.timing.assumed_network_delay_us,
                0..=20_000,
            ),
            (
                "motion_capture.timing.assumed_latency_us",
                self.timing.assumed_latency_us,
                0..=50_000,
            ),
        ] {
            check::within(key, value, range)?;
        }
        for value in self.marker_offset_m {
            check::within("motion_capture.marker_offset_m", value, -1.0..=1.0)?;
        }
        check::within(
            "motion_capture.marker_yaw_rad",
            self.marker_yaw_rad,
            -core::f64::consts::PI..=core::f64::consts::PI,
        )
    }

    fn validate_network(&self) -> Result<(), ConfigError> {
        if self.server.is_unspecified() || self.server.is_multicast() || self.server.is_broadcast()
        {
            return Err(ConfigError::value(
                "motion_capture.server",
                self.server,
                "give the address of the computer that runs the motion capture",
            ));
        }
        check::within(
            "motion_capture.command_port",
            self.command_port,
            1..=u16::MAX,
        )?;
        check::within("motion_capture.data_port", self.data_port, 1..=u16::MAX)?;
        if self.transport == TransportKind::Unicast {
            return Ok(());
        }
        if !self.group.is_multicast() {
            return Err(ConfigError::value(
                "motion_capture.group",
                self.group,
                "it must be a multicast address, 224.0.0.0 to 239.255.255.255",
            ));
        }
        if self.interface.is_unspecified() {
            return Err(ConfigError::value(
                "motion_capture.interface",
                self.interface,
                "multicast needs the local address of the cameras' network",
            ));
        }
        if let Some(bitstream) = self.bitstream {
            return Err(ConfigError::value(
                "motion_capture.bitstream",
                bitstream.0,
                "a server only changes it for unicast; leave it out, or use transport = \"unicast\"",
            ));
        }
        Ok(())
    }
}
