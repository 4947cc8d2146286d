//! What general tools understand of a record: odometry, transforms, poses,
//! commands, diagnostics, as messages of ROS 2's own packages.
//!
//! They follow from the entries and say nothing that the entries do not say: a
//! [`crate::Reader`] passes over them.

mod derive;
mod diagnostics;
mod message;

use std::fmt;

pub(crate) use derive::derive;
pub(crate) use diagnostics::Diagnostics;
use message::{
    AckermannDriveStamped, DiagnosticArray, Imu, Log, Odometry, PointStamped, PoseStamped,
    TfMessage, schema_name, schema_text,
};

/// The frame of the motion capture: z up, origin and x axis as it was calibrated.
pub const WORLD_FRAME: &str = "world";
/// The frame of the car: origin in the centre of mass G, x forward, y left, z up.
pub const BASE_FRAME: &str = "base_link";

/// A topic with messages of a standard type, under the name that tools look for.
///
/// The stamp of a message is the moment it tells of, on the wall.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum StandardTopic {
    /// `nav_msgs/msg/Odometry` from the estimate of a tick: the pose of
    /// [`BASE_FRAME`] in [`WORLD_FRAME`]; the velocity of G in [`BASE_FRAME`].
    Odometry,
    /// `tf2_msgs/msg/TFMessage`: the same pose, for viewers to move the car by.
    Transforms,
    /// `geometry_msgs/msg/PoseStamped` from a valid pose of the rigid body: its
    /// pivot, and its yaw alone, in [`WORLD_FRAME`], at mid-exposure.
    MocapPose,
    /// `sensor_msgs/msg/Imu` from telemetry with a new sample whose time is
    /// known, in the axes of [`BASE_FRAME`]. Its acceleration is **without
    /// gravity**. The zero of its yaw is the sensor's own.
    Imu,
    /// `ackermann_msgs/msg/AckermannDriveStamped` from the command of a tick.
    /// Speed is that of the rear axle.
    Command,
    /// `geometry_msgs/msg/PointStamped`: where P should be, if the reference has
    /// a position.
    Reference,
    /// `geometry_msgs/msg/PointStamped`: where P is, as far as the law knows.
    PointP,
    /// `diagnostic_msgs/msg/DiagnosticArray`: pilot, board and record, whenever
    /// the board sends its status and whenever mode, reason or drops change.
    Diagnostics,
    /// `rcl_interfaces/msg/Log` from a line of the log.
    Rosout,
}

/// Evaluates an expression with `$message` as the topic's message type.
macro_rules! with_message {
    ($topic:expr, $message:ident => $result:expr) => {
        with_message!(@match $topic, $message => $result;
            Odometry: Odometry,
            Transforms: TfMessage,
            MocapPose: PoseStamped,
            Imu: Imu,
            Command: AckermannDriveStamped,
            Reference: PointStamped,
            PointP: PointStamped,
            Diagnostics: DiagnosticArray,
            Rosout: Log,
        )
    };
    (@match $topic:expr, $message:ident => $result:expr; $($name:ident: $type:ty,)*) => {
        match $topic {
            $(StandardTopic::$name => {
                type $message = $type;
                $result
            })*
        }
    };
}

impl StandardTopic {
    /// All of them.
    pub const ALL: [Self; 9] = [
        Self::Odometry,
        Self::Transforms,
        Self::MocapPose,
        Self::Imu,
        Self::Command,
        Self::Reference,
        Self::PointP,
        Self::Diagnostics,
        Self::Rosout,
    ];

    /// Its channel in the file, named as ROS names topics.
    #[must_use]
    pub const fn channel(self) -> &'static str {
        match self {
            Self::Odometry => "/odom",
            Self::Transforms => "/tf",
            Self::MocapPose => "/mocap/pose",
            Self::Imu => "/imu",
            Self::Command => "/cmd",
            Self::Reference => "/reference",
            Self::PointP => "/point_p",
            Self::Diagnostics => "/diagnostics",
            Self::Rosout => "/rosout",
        }
    }

    /// The name of its messages' type, such as `nav_msgs/msg/Odometry`.
    #[must_use]
    pub fn schema_name(self) -> String {
        with_message!(self, M => schema_name::<M>())
    }

    /// The definition of its messages' type, with all messages within it.
    #[must_use]
    pub fn schema_text(self) -> String {
        with_message!(self, M => schema_text::<M>())
    }
}

impl fmt::Display for StandardTopic {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.channel())
    }
}

#[cfg(test)]
mod tests;
