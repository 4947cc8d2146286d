//! The doctor: checks and measurements of a car that does not drive.
//!
//! The car stays disarmed in [`STEPS`]. The operator moves what must be moved by hand, and the doctor compares
//! board and cameras. A measured value is put into the configuration at once, because the next
//! steps need it.
//!
//! A question with [`Answers::Begin`] asks for an action that the operator begins right after
//! the answer, and that is then observed. The car is disarmed all the time.

mod board;
mod cameras;
mod gather;
mod geometry;
mod imu;

use crate::{Answers, Question, Step};

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
pub const STAND_STEPS: [Step; 1] = [crate::bring_up::IMU_NOISE];

/// The operator presses the reset button of the board once, right after the answer.
pub(super) const PRESS_RESET: Question = Question::begin(
    "press-reset",
    "Press Enter, then press the reset button of the board once.",
);

/// The voltage of the battery by another instrument.
pub(super) const VOLTMETER: Question = Question::new(
    "voltmeter",
    "Measure the battery with a voltmeter. Its voltage?",
    Answers::Number {
        unit: "V",
        range: [0.0, 60.0],
    },
);

/// The operator unplugs the battery; the board stays on USB.
pub(super) const UNPLUG_BATTERY: Question = Question::begin(
    "unplug-battery",
    "Press Enter, then unplug the battery. The board stays on USB.",
);

/// The operator plugs the battery in again.
pub(super) const PLUG_BATTERY: Question = Question::begin(
    "plug-battery",
    "Press Enter, then plug the battery in again.",
);

/// The operator opens the stop switch.
pub(super) const OPEN_STOP_SWITCH: Question = Question::begin(
    "open-stop-switch",
    "Press Enter, then open the stop switch (press the red button).",
);

/// The operator closes the stop switch.
pub(super) const CLOSE_STOP_SWITCH: Question = Question::begin(
    "close-stop-switch",
    "Press Enter, then close the stop switch again.",
);

/// The operator turns the front wheels against the servo for five seconds.
pub(super) const PUSH_WHEELS: Question = Question::begin(
    "push-wheels",
    "Press Enter, then push the front wheels to the left and to the right by hand, against \
         the servo, for five seconds. Do not force them.",
);

/// The car stands on the floor, level, and is not touched for a minute.
pub(super) const STAND_STILL: Question = Question::begin(
    "stand-still",
    "Put the car on a level floor, where the cameras see it. Press Enter, and do not touch it \
         for a minute.",
);

/// The operator lifts the front of the car by about 45 degrees, holds it for a second, and puts
/// it down again.
pub(super) const NOSE_UP: Question = Question::begin(
    "nose-up",
    "Press Enter, then lift the front of the car until its nose points up by about 45 \
         degrees, hold it for a second, and put it down again.",
);

/// The operator lifts the left side of the car by about 45 degrees, and puts it down again.
pub(super) const LEFT_SIDE_UP: Question = Question::begin(
    "left-side-up",
    "Press Enter, then lift the left side of the car by about 45 degrees, hold it for a \
         second, and put it down again.",
);

/// The operator turns the car to the left by about 90 degrees, flat on the floor.
pub(super) const TURN_LEFT: Question = Question::begin(
    "turn-left",
    "Press Enter, then turn the car to the left (counter-clockwise from above) by about 90 \
         degrees, flat on the floor, and let go.",
);

/// The operator rolls the car straight forward by half a metre.
pub(super) const PUSH_FORWARD: Question = Question::begin(
    "push-forward",
    "Press Enter, then roll the car forward by half a metre, wheels on the floor.",
);

/// The operator twists the car to and fro, about 30 degrees to either side, about once a second,
/// for 12 seconds.
pub(super) const TWIST: Question = Question::begin(
    "twist",
    "Press Enter, then twist the car to and fro, 30 degrees to either side, about once a \
         second, flat on the floor, for 12 seconds.",
);

/// The operator turns the car by a whole turn (at least 270 degrees) to the left, about the
/// middle of its rear axle.
pub(super) const TURN_LEFT_ABOUT_REAR_AXLE: Question = Question::begin(
    "turn-left-about-rear-axle",
    "Mark a point on the floor and put the middle of the rear axle over it. Press Enter, then \
         turn the car to the left by a whole turn, in about ten seconds, and keep the middle of \
         the rear axle over the point.",
);

/// The operator turns the car to the right about the middle of its rear axle.
pub(super) const TURN_RIGHT_ABOUT_REAR_AXLE: Question = Question::begin(
    "turn-right-about-rear-axle",
    "Put the middle of the rear axle over the point again. Press Enter, then turn the car to \
         the right by a whole turn, in about ten seconds, and keep the middle of the rear axle \
         over the point.",
);

/// The operator rolls the car straight forward by two metres (1.5 m at least), at about 0.4 m/s,
/// on all wheels and without a push to the side, in stretches of half a metre with a pause of a
/// second after each: the board takes wheels that turn for longer for a motor that runs.
pub(super) const ROLL_FORWARD: Question = Question::begin(
    "roll-forward",
    "Put the car where the cameras see the next two metres in front of it, wheels straight. \
         Press Enter, then roll it forward by two metres, in stretches of half a metre that take a \
         second or two each, with a pause of a second between them: wheels that turn for longer \
         count as a motor that runs. Push from behind, not to the side.",
);
