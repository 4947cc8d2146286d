//! The messages of ROS that this program reads and writes itself, and the clocks: stamps of ROS are on the
//! wall clock, those of the daemon on `CLOCK_MONOTONIC`.

use std::time::{SystemTime, UNIX_EPOCH};

use ros2_client::Message;
use rustix::time::{ClockId, clock_gettime};
use serde::{Deserialize, Serialize};

const SECOND_NS: i128 = 1_000_000_000;

/// Both clocks at one moment, in ns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Now {
    /// `CLOCK_MONOTONIC`.
    pub(crate) monotonic: i128,
    /// The wall clock, since 1970.
    pub(crate) wall: i128,
}

impl Now {
    pub(crate) fn read() -> Self {
        let monotonic = clock_gettime(ClockId::Monotonic);
        let wall = SystemTime::now()
            .duration_since(UNIX_EPOCH)
            .map_or(0, |since| since.as_nanos());
        Self {
            // The fields have 32 bits on the Odroid.
            #[allow(clippy::useless_conversion, reason = "the type depends on the target")]
            monotonic: i128::from(monotonic.tv_sec) * SECOND_NS + i128::from(monotonic.tv_nsec),
            wall: i128::try_from(wall).unwrap_or(i128::MAX),
        }
    }

    /// The time of `CLOCK_MONOTONIC` at `wall` of the wall clock.
    pub(crate) const fn monotonic_at(&self, wall: i128) -> i128 {
        self.monotonic + (wall - self.wall)
    }

    /// How far the wall clock is ahead of another moment of both clocks, in s.
    pub(crate) const fn wall_step_s(&self, other: Self) -> f64 {
        ((self.wall - other.wall) - (self.monotonic - other.monotonic)) as f64 * 1e-9
    }
}

/// `builtin_interfaces/msg/Time`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Time {
    pub(crate) sec: i32,
    pub(crate) nanosec: u32,
}

impl Time {
    /// Nanoseconds since 1970.
    pub(crate) fn ns(self) -> i128 {
        i128::from(self.sec) * SECOND_NS + i128::from(self.nanosec)
    }

    pub(crate) fn from_ns(ns: i128) -> Self {
        Self {
            sec: i32::try_from(ns.div_euclid(SECOND_NS)).unwrap_or(i32::MAX),
            nanosec: ns.rem_euclid(SECOND_NS) as u32,
        }
    }
}

/// `std_msgs/msg/Header`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Header {
    pub(crate) stamp: Time,
    pub(crate) frame_id: String,
}

/// `geometry_msgs/msg/Vector3` and `geometry_msgs/msg/Point`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Vector3 {
    pub(crate) x: f64,
    pub(crate) y: f64,
    pub(crate) z: f64,
}

/// `geometry_msgs/msg/TwistStamped`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct TwistStamped {
    pub(crate) header: Header,
    pub(crate) linear: Vector3,
    pub(crate) angular: Vector3,
}

/// `ackermann_msgs/msg/AckermannDriveStamped`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct AckermannDriveStamped {
    pub(crate) header: Header,
    pub(crate) steering_angle: f32,
    pub(crate) steering_angle_velocity: f32,
    pub(crate) speed: f32,
    pub(crate) acceleration: f32,
    pub(crate) jerk: f32,
}

/// `geometry_msgs/msg/PoseStamped`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct PoseStamped {
    pub(crate) header: Header,
    pub(crate) position: Vector3,
    /// x, y, z, w.
    pub(crate) orientation: [f64; 4],
}

/// `nav_msgs/msg/Path`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Path {
    pub(crate) header: Header,
    pub(crate) poses: Vec<PoseStamped>,
}

/// The request of `std_srvs/srv/Trigger`: an empty message has one byte.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct TriggerRequest {
    structure_needs_at_least_one_member: u8,
}

/// The answer of `std_srvs/srv/Trigger`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct TriggerResponse {
    pub(crate) success: bool,
    pub(crate) message: String,
}

impl Message for TriggerRequest {}
impl Message for TriggerResponse {}

/// `std_msgs/msg/String`.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Text {
    pub(crate) data: String,
}

/// `diagnostic_msgs/msg/DiagnosticStatus`.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct DiagnosticStatus {
    pub(crate) level: u8,
    pub(crate) name: &'static str,
    pub(crate) message: String,
    pub(crate) hardware_id: &'static str,
    /// `diagnostic_msgs/msg/KeyValue`.
    pub(crate) values: Vec<(&'static str, String)>,
}

/// `diagnostic_msgs/msg/DiagnosticArray`.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct DiagnosticArray {
    pub(crate) header: Header,
    pub(crate) status: Vec<DiagnosticStatus>,
}
