//! The car and its operator, as a procedure sees them.

use std::borrow::Cow;

use singletrack_control::{Position, Time, Velocity};
use singletrack_core::Config;
use singletrack_pilot::{Jog, Mode, Reason};
use singletrack_protocol::{BoardMode, StopCause};
use singletrack_record::StatusRecord;

use crate::Plot;

/// A car, its daemon and a person beside it.
pub trait Bench {
    /// Lets time pass until the next tick of the daemon, and appends what was observed since
    /// the last call, in the order of its arrival.
    ///
    /// # Errors
    ///
    /// The operator interrupts, or the daemon is gone.
    fn wait(&mut self, observed: &mut Vec<Observation>) -> Result<(), Interrupted>;

    /// Asks the operator a question and waits for the answer; observations of that time are
    /// lost. A question with [`Answers::Begin`](crate::Answers::Begin) is answered as soon as
    /// the operator is ready to act: the action is then observed with [`Bench::wait`].
    ///
    /// # Errors
    ///
    /// The operator interrupts, or the daemon is gone.
    fn ask(&mut self, question: &Question) -> Result<Answer, Interrupted>;

    /// Why the procedure can't go on, if that came up in a request that gives another reason: a
    /// step that failed then has found nothing.
    fn interrupted(&self) -> Option<Interrupted> {
        None
    }

    /// Shows the progress of a measurement: its present values on one line, and how much of it is
    /// done, 0 to 1. It is called in every tick.
    fn show(&mut self, text: &str, done: f64);

    /// Takes a plot for the page of the procedure. A bench that writes no page drops it.
    fn plot(&mut self, _: &Plot) {}

    /// Asks the daemon to arm, and waits for its answer. The drive is held: it ends with the
    /// procedure.
    ///
    /// # Errors
    ///
    /// The daemon's reason against it.
    fn arm(&mut self, attendance: Attendance) -> Result<(), Refused>;

    /// Gives the pulses of an armed jog; they must be renewed at least every 0.2 s.
    ///
    /// # Errors
    ///
    /// The daemon's reason against it.
    fn jog(&mut self, jog: Jog) -> Result<(), Refused>;

    /// Gives the wanted velocity of P in a drive, m/s, and its position, m, in the frame of the
    /// cameras; they must be renewed at least every 0.2 s.
    ///
    /// # Errors
    ///
    /// The daemon's reason against it.
    fn drive(&mut self, velocity: Velocity, position: Option<Position>) -> Result<(), Refused>;

    /// Slows down, stops and disarms; it does not wait for that.
    ///
    /// # Errors
    ///
    /// The daemon's reason against it.
    fn disarm(&mut self) -> Result<(), Refused>;

    /// Emergency stop.
    ///
    /// # Errors
    ///
    /// The daemon's reason against it.
    fn emergency_stop(&mut self) -> Result<(), Refused>;

    /// The configuration in force.
    fn configuration(&self) -> &Config;

    /// Puts other values of the configuration in force, each a key as `board.servo.centre_us`
    /// and a value as TOML, and waits until they are. The file is written before.
    ///
    /// # Errors
    ///
    /// The daemon's reason against it.
    fn change(&mut self, values: &[(&str, toml_edit::Value)]) -> Result<(), Refused>;
}

/// The purpose of a request to arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Attendance {
    /// To give pulses to servo and ESC, without poses: see [`Bench::jog`].
    Jog,
    /// To drive after [`Bench::drive`]; the configuration need not be calibrated.
    Drive,
}

/// Why a procedure cannot go on.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Interrupted {
    /// The operator interrupted it.
    #[error("interrupted by the operator")]
    ByOperator,
    /// The daemon has ended, or the connection to it.
    #[error("the daemon is gone: {0}")]
    DaemonGone(String),
    /// The findings could not be kept.
    #[error("the findings can't be written: {0}")]
    NotKept(String),
}

/// The daemon's reason for refusing a request.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct Refused(pub String);

impl Refused {
    /// With an error as the reason.
    pub fn because(error: impl core::fmt::Display) -> Self {
        Self(error.to_string())
    }
}

/// Something that was observed. Times are those of the host's monotonic clock.
#[derive(Clone, Debug, PartialEq)]
pub enum Observation {
    /// Telemetry of the board.
    Board(BoardReading),
    /// The board's own condition, every 0.2 s.
    Health(StatusRecord),
    /// A pose of the cameras.
    Pose(PoseReading),
    /// A frame without a pose.
    NoPose {
        /// When the frame arrived.
        receive: Time,
        /// The reason, as in the record's `state`, such as `untracked`.
        state: &'static str,
    },
    /// A tick of the pilot.
    Tick(TickReading),
    /// The line to the board went down (`false`) or is ready (`true`).
    Link(bool),
}

/// Telemetry of the board, in the axes of the car: forward, left, up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoardReading {
    /// When the board made it.
    pub time: Time,
    /// Its time on the board's own clock, µs, wrapping.
    pub board_us: u32,
    /// When it arrived.
    pub receive: Time,
    /// The sample of the IMU, if it is a new one.
    pub inertial: Option<Inertial>,
    /// Speed of the rear axle by the motor's pulses, m/s, with the believed distance of a pulse.
    pub motor_speed: f64,
    /// Pulse of the servo, µs; 0 while it is silent.
    pub servo_us: u16,
    /// Pulse of the ESC, µs; 0 while it is silent.
    pub esc_us: u16,
    /// State of the safety machine.
    pub mode: BoardMode,
    /// Why it last went to neutral.
    pub stop_cause: StopCause,
}

impl BoardReading {
    /// Whether the wheels turn.
    pub(crate) fn turns(&self) -> bool {
        self.motor_speed != 0.0
    }
}

/// A sample of the IMU.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inertial {
    /// When the board read it.
    pub time: Time,
    /// Its time on the board's own clock, µs, wrapping.
    pub board_us: u32,
    /// Acceleration without gravity, m/s².
    pub acceleration: [f64; 3],
    /// Angular velocity, rad/s.
    pub angular_velocity: [f64; 3],
    /// Roll, left side up positive, rad.
    pub roll: f64,
    /// Pitch, nose down positive, rad.
    pub pitch: f64,
}

/// A pose of the rigid body in the world frame, z up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseReading {
    /// Mid-exposure.
    pub capture: Time,
    /// When the frame arrived.
    pub receive: Time,
    /// Bound on the error of `capture`, s.
    pub uncertainty: f64,
    /// Position of the body's origin, m.
    pub position: [f64; 3],
    /// Yaw, -π to π, rad: of the body, not of the car.
    pub yaw: f64,
    /// Roll, left side up positive, rad.
    pub roll: f64,
    /// Pitch, nose down positive, rad.
    pub pitch: f64,
    /// Mean distance of the markers from the model, m.
    pub mean_error: f64,
}

/// What the pilot did in a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TickReading {
    /// The time of the tick.
    pub time: Time,
    /// The mode after it.
    pub mode: Mode,
    /// Why the car does not drive, or stopped.
    pub reason: Option<Reason>,
    /// Why an arm request would be refused now.
    pub preflight: Option<Reason>,
    /// The estimate: position of the centre of mass in m and yaw in rad.
    pub pose: Option<([f64; 2], f64)>,
    /// Position of P, m.
    pub point: Option<Position>,
}

/// A question to the operator.
#[derive(Clone, Debug, PartialEq)]
pub struct Question {
    /// Its name, for scripts, such as `push-forward`. It never changes.
    pub id: &'static str,
    /// The question or the request, in whole sentences.
    pub text: Cow<'static, str>,
    /// The answers that it takes.
    pub answers: Answers,
}

impl Question {
    /// With [`Answers::Begin`], and a text that never changes.
    pub const fn begin(id: &'static str, text: &'static str) -> Self {
        Self {
            id,
            text: Cow::Borrowed(text),
            answers: Answers::Begin,
        }
    }
}

/// The answers that a question takes. Every question can also be skipped.
#[derive(Clone, Debug, PartialEq)]
pub enum Answers {
    /// The operator is ready to begin with what `text` asks for.
    Begin,
    /// Yes or no.
    YesNo,
    /// One of these words.
    Choice(&'static [&'static str]),
    /// A number within the bounds, in the unit.
    Number {
        /// The unit, such as `deg`.
        unit: &'static str,
        /// The lowest and the highest.
        range: [f64; 2],
    },
}

/// The operator's answer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Answer {
    /// Ready.
    Begin,
    /// Yes or no.
    YesNo(bool),
    /// The index of the word.
    Choice(usize),
    /// The number.
    Number(f64),
    /// The operator can't or won't do it.
    Skip,
}
