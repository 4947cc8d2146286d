//! `[motion_capture]`: the cameras.

use core::{
    f64::consts::PI,
    net::{IpAddr, Ipv4Addr},
};

use serde::{Deserialize, Serialize};
use singletrack_control::words;
use singletrack_mocap::{
    DEFAULT_DATA_PORT, DEFAULT_MULTICAST_GROUP, DEFAULT_QUATERNION_NORM_TOLERANCE, PoseLimits,
    Protocol, Timing, Transport, UpAxis, codec::BitstreamVersion, planar::PlanarConfig,
};
use singletrack_settings::{Declared as _, Maps as _, section};

use super::ConfigError;

/// The address in the example file: a place for the real one.
pub(crate) const EXAMPLE_SERVER: Ipv4Addr = Ipv4Addr::new(192, 168, 1, 10);

section! {
    /// The cameras: a server of poses.
    "motion_capture" => pub MotionCaptureSection;
    [new];

    /// Address of the computer that runs the server.
    @restart server: Ipv4Addr, example EXAMPLE_SERVER;
    /// Name of the car's rigid body in the server's list; with VRPN of the tracker. Its x axis
    /// points forward, or see `marker_yaw_rad`.
    @restart rigid_body: String, example "car";
    /// The axis that points up, a streaming setting of the server ("y" by default in Motive,
    /// "z" in QTM). It is not on the wire: ask the server's operator, and check that a car driven forward
    /// moves forward.
    @restart up_axis: UpAxis, words UpAxis, example UpAxis::Y;
    /// What the server speaks: "natnet" (OptiTrack Motive, 2.7 to 4.4), "vrpn" (Vicon and many
    /// others, 07.xx) or "qualisys" (QTM, 1.13 and later).
    @restart kind: ServerKind = ServerKind::NatNet, words ServerKind;
    /// Number of the tracker's sensor (VRPN).
    @restart sensor: u16 = 0, in 0..=999;
    /// Address of the local network interface to the cameras; mandatory for multicast.
    @restart interface: Ipv4Addr = Ipv4Addr::UNSPECIFIED;
    /// How the frames arrive: "unicast" on UDP; "multicast" to `group` (NatNet); "tcp" (VRPN,
    /// Qualisys), which is also what takes over where no UDP arrives.
    @restart transport: TransportKind = TransportKind::Unicast, words TransportKind;
    /// NatNet bitstream to request from the server (unicast only); the server's own if left out.
    @restart bitstream: Option<Bitstream> = None, text "2.7 to 4.4", example "4.1";
    /// Port of the server. Left out: 1510 (NatNet), 3883 (VRPN), 22223 (Qualisys, little-endian;
    /// a big-endian port serves as well).
    @restart command_port: Option<u16> = None, in 1..=65_535, example 1510;
    /// Port on which multicast frames arrive; unicast needs none.
    @restart data_port: u16 = DEFAULT_DATA_PORT, in 1..=65_535;
    /// Multicast group to which the server sends.
    @restart group: Ipv4Addr = DEFAULT_MULTICAST_GROUP, text "224.0.0.0 to 239.255.255.255";
    /// Position of the rigid body's pivot from the centre of mass: forward, left.
    marker_offset_m: [f64; 2] = [0.0; 2], in -1.0..=1.0;
    /// Yaw of the rigid body when the car's yaw is zero.
    marker_yaw_rad: f64 = 0.0, in -PI..=PI;
    /// Which poses are accepted.
    pose: PoseSection = PoseSection::default();
    /// Intervals, time-outs and assumptions.
    timing: TimingSection = TimingSection::default();
}

words! {
    /// How the frames arrive.
    pub enum TransportKind: serde {
        /// Sent to this host alone.
        Unicast = "unicast",
        /// Sent to a group.
        Multicast = "multicast",
        /// Sent on the connection.
        Tcp = "tcp",
    }
}

words! {
    /// What the server speaks.
    pub enum ServerKind: serde {
        /// OptiTrack Motive.
        NatNet = "natnet",
        /// Vicon and many others.
        Vrpn = "vrpn",
        /// Qualisys Track Manager.
        Qualisys = "qualisys",
    }
}

section! {
    /// Which poses are accepted, before the estimator uses them.
    "motion_capture.pose" => pub PoseSection: Copy;
    [maps PoseLimits = PoseLimits::default()];

    /// Largest mean marker error.
    @restart max_mean_error_m: f64 => max_mean_error_m, in up_to(0.1);
    /// Faster movement is a jump.
    @restart max_speed_m_s: f64 => max_speed_m_s, in up_to(50.0);
    /// Distance allowed on top of what speed and time explain.
    @restart jump_margin_m: f64 => jump_margin_m, in up_to(1.0);
    /// Faster rotation is a jump.
    @restart max_yaw_rate_rad_s: f64 => max_yaw_rate_rad_s, in up_to(100.0);
    /// Yaw allowed on top of what yaw rate and time explain.
    @restart yaw_margin_rad: f64 => yaw_margin_rad, in up_to(3.0);
    /// Largest angle between the body's up axis and the world's. Beyond it the car lies on
    /// its side.
    @restart max_tilt_rad: f64 => max_tilt_rad, in up_to(1.5);
    /// Height band of the body's pivot: to arm, the car must be in it. Left out, the height
    /// is not checked.
    height_m: Option<[f64; 2]> = None, in -100.0..=100.0, example [0.05, 0.25];
    /// Largest deviation of the quaternion's norm from one.
    @restart quaternion_norm_tolerance: f64 = DEFAULT_QUATERNION_NORM_TOLERANCE, in up_to(0.5);
    /// After this many rejected poses in a row the body counts as lost.
    @restart max_consecutive_rejects: u32 => max_consecutive_rejects, in 1..=1_000;
}

section! {
    /// Intervals, time-outs and assumptions.
    "motion_capture.timing" => pub TimingSection: Copy;
    [maps Timing = Timing::default()];

    /// A stream silent for longer is stale.
    @restart stale_after_ms: u32 => stale_after_ns, in 20..=1_000;
    /// After a longer silence the daemon connects to the server again.
    @restart reconnect_after_ms: u32 => reconnect_after_ns, in 500..=60_000;
    /// Network delay assumed of servers before NatNet 3.0, which answer no echo requests.
    @restart assumed_network_delay_us: u32 => assumed_network_delay_ns, in 0..=20_000;
    /// Age assumed of a frame at its arrival, if the server sends no mid-exposure time, or its
    /// clock can't be asked (Qualisys).
    @restart assumed_latency_us: u32 => assumed_latency_ns, in 0..=50_000;
    /// Constant error of the server's time stamps, subtracted from every mid-exposure.
    /// Positive: the stamps are too late. `singletrack doctor` measures it.
    stamp_offset_ms: f64 => stamp_offset_ns, in -200.0..=200.0;
}

impl TimingSection {
    /// The constant error of the time stamps, in ns.
    pub(crate) fn stamp_offset_ns(self) -> i64 {
        self.apply_to(Timing::default()).stamp_offset_ns
    }
}

/// A NatNet bitstream version, written `"4.1"`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Bitstream(pub BitstreamVersion);

impl TryFrom<String> for Bitstream {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        let (major, minor) = text
            .split_once('.')
            .and_then(|(major, minor)| Some((major.parse().ok()?, minor.parse().ok()?)))
            .ok_or_else(|| format!("bitstream is {text:?}: write it as \"4.1\""))?;
        BitstreamVersion::new(major, minor)
            .map(Self)
            .map_err(|error| error.to_string())
    }
}

impl From<Bitstream> for String {
    fn from(bitstream: Bitstream) -> Self {
        bitstream.0.to_string()
    }
}

impl MotionCaptureSection {
    const fn protocol(&self) -> Protocol {
        match self.kind {
            ServerKind::NatNet => Protocol::NatNet,
            ServerKind::Vrpn => Protocol::Vrpn {
                sensor: self.sensor as i32,
            },
            ServerKind::Qualisys => Protocol::Qualisys,
        }
    }

    /// Port of the server.
    pub fn port(&self) -> u16 {
        self.command_port
            .unwrap_or_else(|| self.protocol().default_port())
    }

    /// For the session.
    ///
    /// # Errors
    ///
    /// The name of a rigid body that NatNet can't carry.
    pub fn session(&self) -> Result<PlanarConfig, ConfigError> {
        let transport = match self.transport {
            TransportKind::Unicast => Transport::Unicast {
                bitstream: self.bitstream.map(|bitstream| bitstream.0),
            },
            TransportKind::Multicast => Transport::Multicast,
            TransportKind::Tcp => Transport::Stream,
        };
        let mut config = PlanarConfig::new(
            IpAddr::V4(self.server),
            transport,
            &self.rigid_body,
            self.up_axis,
        )
        .map_err(|error| {
            let value = format!("{:?}", self.rigid_body);
            let fix = error.to_string();
            ConfigError::value("motion_capture.rigid_body", value, fix)
        })?;
        config.session.protocol = self.protocol();
        config.session.command_port = self.port();
        config.session.quaternion_norm_tolerance = self.pose.quaternion_norm_tolerance;
        config.session.timing = self.timing.apply_to(config.session.timing);
        config.limits = self.pose.apply_to(config.limits);
        Ok(config)
    }

    /// Refuses a value that can't be used.
    ///
    /// # Errors
    ///
    /// The first such key, with its value and what it may be.
    pub fn validate(&self) -> Result<(), ConfigError> {
        self.validate_network()?;
        self.pose.check()?;
        self.timing.check()?;
        Ok(self.check()?)
    }

    fn validate_network(&self) -> Result<(), ConfigError> {
        let (server, body) = (self.server, &self.rigid_body);
        let is_no_host = server.is_unspecified() || server.is_multicast() || server.is_broadcast();
        let bitstream = self.bitstream.map(|bitstream| bitstream.0.to_string());
        let (key, value, fix) = match (self.kind, self.transport, bitstream) {
            _ if is_no_host => (
                "motion_capture.server",
                server.to_string(),
                "give the address of the computer that runs the motion capture",
            ),
            (ServerKind::NatNet, TransportKind::Tcp, _) => (
                "motion_capture.transport",
                "\"tcp\"".to_owned(),
                "NatNet sends frames on UDP: \"unicast\" or \"multicast\"",
            ),
            (ServerKind::Vrpn | ServerKind::Qualisys, TransportKind::Multicast, _) => (
                "motion_capture.transport",
                "\"multicast\"".to_owned(),
                "only NatNet has it: write \"unicast\" or \"tcp\"",
            ),
            (ServerKind::Vrpn | ServerKind::Qualisys, _, Some(bitstream)) => (
                "motion_capture.bitstream",
                bitstream,
                "only NatNet has it: leave it out",
            ),
            (ServerKind::NatNet | ServerKind::Qualisys, ..) if self.sensor != 0 => (
                "motion_capture.sensor",
                self.sensor.to_string(),
                "only kind = \"vrpn\" has sensors: leave it out",
            ),
            (ServerKind::Vrpn, ..) if body.len() > 99 || body.contains('@') => (
                "motion_capture.rigid_body",
                format!("{body:?}"),
                "write the tracker's name alone, of at most 99 bytes: \"car\" for \
                 car@192.168.1.10:3883, with server = \"192.168.1.10\" and command_port = 3883",
            ),
            (_, TransportKind::Unicast | TransportKind::Tcp, _) => return Ok(()),
            _ if !self.group.is_multicast() => (
                "motion_capture.group",
                self.group.to_string(),
                "it must be a multicast address, 224.0.0.0 to 239.255.255.255",
            ),
            _ if self.interface.is_unspecified() => (
                "motion_capture.interface",
                self.interface.to_string(),
                "multicast needs the local address of the cameras' network",
            ),
            (_, _, Some(bitstream)) => (
                "motion_capture.bitstream",
                bitstream,
                "a server only changes it for unicast; leave it out, or use transport = \"unicast\"",
            ),
            (_, _, None) => return Ok(()),
        };
        Err(ConfigError::value(key, value, fix))
    }
}
