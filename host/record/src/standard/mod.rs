//! The part of a record that general tools understand: odometry, transforms, poses,
//! commands and diagnostics, as messages of the standard packages of ROS 2.
//!
//! They follow from the entries and add nothing to them: a [`crate::Reader`] skips them.

mod message;

use std::fmt;

pub(crate) use message::{
    AckermannDrive, AckermannDriveStamped, Byte, DiagnosticArray, DiagnosticStatus, Header, Imu,
    KeyValue, Log, Odometry, Point, PointStamped, Pose, PoseStamped, PoseWithCovariance,
    Quaternion, TfMessage, Time, Transform, TransformStamped, Twist, TwistWithCovariance, Vector3,
};
use message::{schema_name, schema_text};

/// The frame of the motion capture: z up, origin and x axis as it was calibrated.
pub const WORLD_FRAME: &str = "world";
/// The frame of the car: origin in the centre of mass G, x forward, y left, z up.
pub const BASE_FRAME: &str = "base_link";

/// Declares the topics: each with the type of its messages and its channel.
macro_rules! standard_topics {
    (
        $(#[$about:meta])*
        pub enum StandardTopic {
            $( $(#[$topic_about:meta])* $topic:ident: $message:ty = $channel:literal, )*
        }
    ) => {
        $(#[$about])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum StandardTopic {
            $( $(#[$topic_about])* $topic, )*
        }

        impl StandardTopic {
            /// All topics.
            pub const ALL: [Self; [$($channel),*].len()] = [$(Self::$topic,)*];

            /// Its channel in the file, named as ROS names topics.
            #[must_use]
            pub const fn channel(self) -> &'static str {
                match self {
                    $(Self::$topic => $channel,)*
                }
            }

            /// The name of its messages' type, such as `nav_msgs/msg/Odometry`.
            #[must_use]
            pub fn schema_name(self) -> String {
                match self {
                    $(Self::$topic => schema_name::<$message>(),)*
                }
            }

            /// The definition of its messages' type, with all messages within it.
            #[must_use]
            pub fn schema_text(self) -> String {
                match self {
                    $(Self::$topic => schema_text::<$message>(),)*
                }
            }
        }
    };
}

standard_topics! {
    /// A topic with messages of a standard type, under the name that tools look for.
    ///
    /// The stamp of a message is the wall time of what it describes.
    pub enum StandardTopic {
        /// `nav_msgs/msg/Odometry` from the estimate of a tick: the pose of
        /// [`BASE_FRAME`] in [`WORLD_FRAME`]; the velocity of G in [`BASE_FRAME`].
        Odometry: Odometry = "/odom",
        /// `tf2_msgs/msg/TFMessage`: the same pose, with which viewers move the car.
        Transforms: TfMessage = "/tf",
        /// `geometry_msgs/msg/PoseStamped` from a valid pose of the rigid body: its
        /// pivot, and its yaw alone, in [`WORLD_FRAME`], at mid-exposure.
        MocapPose: PoseStamped = "/mocap/pose",
        /// `sensor_msgs/msg/Imu` from telemetry with a new sample whose time is
        /// known, in the axes of [`BASE_FRAME`]. Its acceleration is **without
        /// gravity**. The zero of its yaw is that of the sensor.
        Imu: Imu = "/imu",
        /// `ackermann_msgs/msg/AckermannDriveStamped` from the command of a tick.
        /// Speed is that of the rear axle.
        Command: AckermannDriveStamped = "/cmd",
        /// `geometry_msgs/msg/PointStamped`: where P should be, if the reference has
        /// a position.
        Reference: PointStamped = "/reference",
        /// `geometry_msgs/msg/PointStamped`: where P is, as far as the law knows.
        PointP: PointStamped = "/point_p",
        /// `diagnostic_msgs/msg/DiagnosticArray`: states of pilot, board and record, at each
        /// status of the board and at each change of mode, reason, link or drops.
        Diagnostics: DiagnosticArray = "/diagnostics",
        /// `rcl_interfaces/msg/Log` from a line of the log.
        Rosout: Log = "/rosout",
    }
}

impl fmt::Display for StandardTopic {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.channel())
    }
}
