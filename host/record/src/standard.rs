//! The part of a record that general tools understand: odometry, transforms, poses,
//! commands and diagnostics, as messages of the standard packages of ROS 2.
//!
//! They follow from the entries and add nothing to them: a [`crate::Reader`] skips them. Names, order
//! and types of the fields are those of the packages.

use serde::Serialize;

use crate::message::Definition;

/// The frame of the motion capture: z up, origin and x axis as it was calibrated.
pub const MAP_FRAME: &str = "map";
/// The frame of the odometry, which is always that of the motion capture: the estimate does not drift.
pub const ODOM_FRAME: &str = "odom";
/// The frame of the car: origin in the centre of mass G, x forward, y left, z up.
pub const BASE_FRAME: &str = "base_link";

singletrack_control::words! {
    /// A topic with messages of a standard type, under the name that tools look for.
    ///
    /// The stamp of a message is the wall time of what it describes.
    #[derive(Hash)]
    pub enum StandardTopic {
        /// `nav_msgs/msg/Odometry` from the estimate of a tick: the pose of
        /// [`BASE_FRAME`] in [`ODOM_FRAME`]; the velocity of G in [`BASE_FRAME`]; covariances
        /// of the filter, and 1e6 for what a car on the floor does not do.
        Odometry = "/odom",
        /// `tf2_msgs/msg/TFMessage`: [`ODOM_FRAME`] in [`MAP_FRAME`], and [`BASE_FRAME`] in
        /// [`ODOM_FRAME`], with which viewers move the car.
        Transforms = "/tf",
        /// `geometry_msgs/msg/PoseStamped` from a valid pose of the rigid body: its
        /// pivot, and its yaw alone, in [`MAP_FRAME`], at mid-exposure.
        MocapPose = "/mocap/pose",
        /// `sensor_msgs/msg/Imu` from telemetry with a new sample whose time is
        /// known, in the axes of [`BASE_FRAME`]. Its acceleration is **without
        /// gravity**. The zero of its yaw is that of the sensor.
        Imu = "/imu",
        /// `ackermann_msgs/msg/AckermannDriveStamped` from the command of a tick.
        /// Speed is that of the rear axle.
        Command = "/cmd",
        /// `geometry_msgs/msg/PointStamped`: where P should be, if the reference has
        /// a position.
        Reference = "/reference",
        /// `geometry_msgs/msg/PointStamped`: where P is, as far as the law knows.
        PointP = "/point_p",
        /// `diagnostic_msgs/msg/DiagnosticArray`: states of pilot, board and record, at each
        /// status of the board and at each change of mode, reason, link or drops.
        Diagnostics = "/diagnostics",
        /// `rcl_interfaces/msg/Log` from a line of the log.
        Rosout = "/rosout",
    }
}

impl StandardTopic {
    /// Its channel in the file, named as ROS names topics.
    pub const fn channel(self) -> &'static str {
        self.name()
    }

    /// The name of its messages' type, such as `nav_msgs/msg/Odometry`.
    pub fn schema_name(self) -> String {
        let (name, _) = self.message();
        name.replace('/', "/msg/")
    }

    /// The definition of its messages' type, with all messages within it.
    pub fn schema_text(self) -> String {
        let mut definition = Definition::default();
        let (_, define) = self.message();
        define(&mut definition);
        definition.finish()
    }

    /// The name of its messages' type in other messages, and what declares its fields.
    fn message(self) -> (&'static str, fn(&mut Definition)) {
        fn of<M: StandardMessage>() -> (&'static str, fn(&mut Definition)) {
            (M::NAME, M::define)
        }
        match self {
            Self::Odometry => of::<Odometry>(),
            Self::Transforms => of::<TfMessage>(),
            Self::MocapPose => of::<PoseStamped>(),
            Self::Imu => of::<Imu>(),
            Self::Command => of::<AckermannDriveStamped>(),
            Self::Reference => of::<PointStamped>(),
            Self::PointP => of::<PointStamped>(),
            Self::Diagnostics => of::<DiagnosticArray>(),
            Self::Rosout => of::<Log>(),
        }
    }
}

/// A message of a standard package.
pub(crate) trait StandardMessage: Serialize {
    /// Its name in other messages, such as `geometry_msgs/Pose`.
    const NAME: &'static str;

    /// Declares its constants and fields.
    fn define(definition: &mut Definition);
}

/// The type of a field.
trait Field: Serialize {
    /// Adds it to the definition of the message that it is a field of.
    fn declare(name: &str, definition: &mut Definition);
}

macro_rules! plain {
    ($($type:ty as $kind:literal,)*) => {
        $(
            impl Field for $type {
                fn declare(name: &str, definition: &mut Definition) {
                    definition.plain($kind, name);
                }
            }
        )*
    };
}

plain! {
    u8 as "uint8",
    i32 as "int32",
    u32 as "uint32",
    f32 as "float32",
    f64 as "float64",
    // In the row order of ROS.
    [[f64; 3]; 3] as "float64[9]",
    [[f64; 6]; 6] as "float64[36]",
    &'static str as "string",
    String as "string",
}

/// A number of type `byte`, which ROS uses for levels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub(crate) struct Byte(pub(crate) u8);

impl Field for Byte {
    fn declare(name: &str, definition: &mut Definition) {
        definition.plain("byte", name);
    }
}

impl<M: StandardMessage> Field for M {
    fn declare(name: &str, definition: &mut Definition) {
        definition.message(M::NAME, M::define, name, "");
    }
}

impl<M: StandardMessage> Field for Vec<M> {
    fn declare(name: &str, definition: &mut Definition) {
        definition.message(M::NAME, M::define, name, "[]");
    }
}

/// Declares messages. Constants are before the fields, as in the files of ROS.
macro_rules! standard {
    ($(
        $(#[doc = $about:literal])*
        $type:ident as $name:literal
        $( with $constant_kind:ident { $( $constant:ident = $number:literal, )* } )?
        {
            $( $(#[doc = $comment:literal])* $field:ident : $kind:ty, )*
        }
    )*) => {
        $(
            $(#[doc = $about])*
            #[derive(Clone, Debug, PartialEq, Serialize)]
            pub(crate) struct $type {
                $( $(#[doc = $comment])* pub(crate) $field: $kind, )*
            }

            impl StandardMessage for $type {
                const NAME: &'static str = $name;

                fn define(definition: &mut Definition) {
                    $( definition.comment($about); )*
                    $($(
                        definition.plain(
                            stringify!($constant_kind),
                            concat!(stringify!($constant), "=", $number),
                        );
                    )*)?
                    $(
                        $( definition.comment($comment); )*
                        <$kind as Field>::declare(stringify!($field), definition);
                    )*
                }
            }
        )*
    };
}

standard! {
    /// A moment since 1970, by the wall clock.
    Time as "builtin_interfaces/Time" {
        sec: i32,
        nanosec: u32,
    }

    /// When, and in which frame.
    Header as "std_msgs/Header" {
        stamp: Time,
        frame_id: &'static str,
    }

    /// A position, in m.
    Point as "geometry_msgs/Point" {
        x: f64,
        y: f64,
        z: f64,
    }

    /// An orientation.
    Quaternion as "geometry_msgs/Quaternion" {
        x: f64,
        y: f64,
        z: f64,
        w: f64,
    }

    /// A vector, in the unit of what it is a part of.
    Vector3 as "geometry_msgs/Vector3" {
        x: f64,
        y: f64,
        z: f64,
    }

    /// Where something is and how it is turned.
    Pose as "geometry_msgs/Pose" {
        position: Point,
        orientation: Quaternion,
    }

    /// How something moves, in m/s, and turns, in rad/s.
    Twist as "geometry_msgs/Twist" {
        linear: Vector3,
        angular: Vector3,
    }

    /// The covariance is of x, y, z and the rotations about them; 1e6: unknown.
    PoseWithCovariance as "geometry_msgs/PoseWithCovariance" {
        pose: Pose,
        covariance: [[f64; 6]; 6],
    }

    /// The covariance is of x, y, z and the rotations about them; 1e6: unknown.
    TwistWithCovariance as "geometry_msgs/TwistWithCovariance" {
        twist: Twist,
        covariance: [[f64; 6]; 6],
    }

    /// The pose in the header's frame, the twist in the child's.
    Odometry as "nav_msgs/Odometry" {
        header: Header,
        child_frame_id: &'static str,
        pose: PoseWithCovariance,
        twist: TwistWithCovariance,
    }

    /// Where a frame is in another.
    Transform as "geometry_msgs/Transform" {
        translation: Vector3,
        rotation: Quaternion,
    }

    /// Where the child's frame is in the header's.
    TransformStamped as "geometry_msgs/TransformStamped" {
        header: Header,
        child_frame_id: &'static str,
        transform: Transform,
    }

    /// What a viewer moves the car by.
    TfMessage as "tf2_msgs/TFMessage" {
        transforms: Vec<TransformStamped>,
    }

    /// A pose in the header's frame.
    PoseStamped as "geometry_msgs/PoseStamped" {
        header: Header,
        pose: Pose,
    }

    /// A point in the header's frame.
    PointStamped as "geometry_msgs/PointStamped" {
        header: Header,
        point: Point,
    }

    /// A sample of an inertial measurement unit: orientation, rad/s, m/s^2.
    /// A covariance of zeros is unknown.
    Imu as "sensor_msgs/Imu" {
        header: Header,
        orientation: Quaternion,
        orientation_covariance: [[f64; 3]; 3],
        angular_velocity: Vector3,
        angular_velocity_covariance: [[f64; 3]; 3],
        linear_acceleration: Vector3,
        linear_acceleration_covariance: [[f64; 3]; 3],
    }

    /// What a car steered by its front wheels is to do: rad, rad/s, and of the
    /// rear axle m/s, m/s^2, m/s^3. A rate, acceleration or jerk of zero: as
    /// quickly as possible.
    AckermannDrive as "ackermann_msgs/AckermannDrive" {
        steering_angle: f32,
        steering_angle_velocity: f32,
        speed: f32,
        acceleration: f32,
        jerk: f32,
    }

    /// What the car is to do from this moment on.
    AckermannDriveStamped as "ackermann_msgs/AckermannDriveStamped" {
        header: Header,
        drive: AckermannDrive,
    }

    /// Something with a name, in words.
    KeyValue as "diagnostic_msgs/KeyValue" {
        key: &'static str,
        value: String,
    }

    /// How a part is doing.
    DiagnosticStatus as "diagnostic_msgs/DiagnosticStatus"
    with byte { OK = 0, WARN = 1, ERROR = 2, STALE = 3, }
    {
        level: Byte,
        name: &'static str,
        message: String,
        hardware_id: &'static str,
        values: Vec<KeyValue>,
    }

    /// How everything is doing.
    DiagnosticArray as "diagnostic_msgs/DiagnosticArray" {
        header: Header,
        status: Vec<DiagnosticStatus>,
    }

    /// A line of a log.
    Log as "rcl_interfaces/Log"
    with byte { DEBUG = 10, INFO = 20, WARN = 30, ERROR = 40, FATAL = 50, }
    {
        stamp: Time,
        level: u8,
        name: &'static str,
        msg: String,
        file: &'static str,
        function: &'static str,
        line: u32,
    }
}
