//! The doctor: checks and measurements of a car that does not drive.
//!
//! The car stays disarmed in [`STEPS`]. The operator moves what must be moved by hand, and the
//! doctor compares board and cameras. A measured value is put into the configuration at once, because the next
//! steps need it.
//!
//! A question with [`Answers::Begin`](crate::Answers::Begin) asks for an action that the operator
//! begins right after the answer, and that is then observed. The car is disarmed all the time.

mod board;
mod cameras;
mod gather;
mod geometry;
mod imu;

use crate::Step;

/// The steps, in their order.
pub const STEPS: [Step; 8] = [
    Step::new("board", "Board: image, line, reset", board::image),
    Step::new("power", "Power: battery, stop switch, 5 V", board::power).optional(),
    Step::new("imu-axes", "IMU: its axes, by hand", imu::axes),
    Step::new(
        "rest",
        "A minute at rest: IMU, bias, noise, pulses",
        imu::rest,
    )
    .optional(),
    Step::new(
        "cameras",
        "Cameras: stream, body, height, and a push",
        cameras::body,
    ),
    Step::new(
        "latency",
        "Latency: gyro against cameras, by a twist",
        cameras::latency,
    )
    .optional(),
    Step::new(
        "geometry",
        "Geometry: the body on the car, and the distance of a pulse",
        geometry::geometry,
    )
    .optional(),
    Step::new("drive", "Reference, geofence and real time", cameras::drive).optional(),
];

/// The steps of `doctor --stand`, in which the wheels turn on a stand. They use jogs and the
/// questions of the bring-up.
pub const STAND_STEPS: [Step; 1] = [Step::new(
    "imu-noise",
    "IMU: its noise with the wheels turning",
    crate::bring_up::find_imu_noise,
)
.expecting("The noise at every speed is at most 1.3 times what [estimator] believes.")];
