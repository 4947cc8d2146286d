//! The doctor: checks and measurements of a car that does not drive.
//!
//! The car stays disarmed in [`STEPS`]. The operator moves what must be moved by hand, and the doctor compares
//! board and cameras. A measured value is put into the configuration at once, because the next
//! steps need it.

mod board;
mod cameras;
mod finding;
mod gather;
mod geometry;
mod imu;
mod questions;

use crate::Step;

/// The steps, in their order.
pub const STEPS: [Step; 8] = [
    Step {
        name: "board",
        title: "Board: image, line, reset",
        essential: true,
        run: board::image,
    },
    Step {
        name: "power",
        title: "Power: battery, stop switch, 5 V",
        essential: false,
        run: board::power,
    },
    Step {
        name: "imu-axes",
        title: "IMU: its axes, by hand",
        essential: true,
        run: imu::axes,
    },
    Step {
        name: "rest",
        title: "A minute at rest: IMU, bias, noise, pulses",
        essential: false,
        run: imu::rest,
    },
    Step {
        name: "cameras",
        title: "Cameras: stream, body, height, and a push",
        essential: true,
        run: cameras::body,
    },
    Step {
        name: "latency",
        title: "Latency: gyro against cameras, by a twist",
        essential: false,
        run: cameras::latency,
    },
    Step {
        name: "geometry",
        title: "Geometry: the body on the car, and the distance of a pulse",
        essential: false,
        run: geometry::geometry,
    },
    Step {
        name: "drive",
        title: "Reference, geofence and real time",
        essential: false,
        run: cameras::drive,
    },
];

/// The steps of `doctor --stand`, in which the wheels turn on a stand. They use jogs and the
/// questions of the bring-up.
pub const STAND_STEPS: [Step; 1] = [crate::bring_up::IMU_NOISE];

/// The ids of all questions of [`STEPS`], in the order in which they come. Some come several times.
pub const QUESTIONS: [&str; 16] = [
    "press-reset",
    "voltmeter",
    "unplug-battery",
    "plug-battery",
    "open-stop-switch",
    "close-stop-switch",
    "push-wheels",
    "left-side-up",
    "nose-up",
    "turn-left",
    "stand-still",
    "push-forward",
    "twist",
    "turn-left-about-rear-axle",
    "turn-right-about-rear-axle",
    "roll-forward",
];
