//! The messages of ROS that this program reads and writes itself.

use ros2_client::Message;
use serde::{Deserialize, Serialize};

/// `builtin_interfaces/msg/Time`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Time {
    pub(crate) sec: i32,
    pub(crate) nanosec: u32,
}

impl Time {
    /// Nanoseconds since 1970.
    pub(crate) fn ns(self) -> i128 {
        i128::from(self.sec) * 1_000_000_000 + i128::from(self.nanosec)
    }

    pub(crate) fn from_ns(ns: i128) -> Self {
        Self {
            sec: i32::try_from(ns.div_euclid(1_000_000_000)).unwrap_or(i32::MAX),
            nanosec: ns.rem_euclid(1_000_000_000) as u32,
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
