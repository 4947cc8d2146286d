//! Schedules: initial situation, operator requests and faults.

mod generate;
mod kind;
mod text;

use core::ops::RangeInclusive;
use std::collections::BTreeMap;

use singletrack_sim::{BoardKind, EscKind};

pub use kind::{FaultKind, FaultTarget};
pub use text::ScheduleError;

/// Complete input of a drive: the same schedule gives the same bits. Times are
/// milliseconds since power-on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Schedule {
    /// Seed of all noise, of the world and of the faults.
    pub seed: u64,
    /// Initial conditions and wiring.
    pub situation: Situation,
    /// The true car, where it differs from the configured one.
    pub truth: TrueCar,
    /// Duration.
    pub end_ms: u32,
    /// Operator requests, in order of time.
    pub requests: Vec<ScheduledRequest>,
    /// Faults.
    pub faults: Vec<Fault>,
}

/// Initial conditions, wiring and reference of a drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Situation {
    /// Implementation of the board.
    pub board: BoardKind,
    /// The reference of P.
    pub reference: ReferenceKind,
    /// Reference speed of P, in mm/s.
    pub speed_mm_s: u32,
    /// Whether the estimator dead-reckons on the IMU while the markers are lost;
    /// otherwise it holds the last pose.
    pub coast: bool,
    /// Whether the board's failsafe brakes, if the ESC has a brake and its supply stays on.
    pub brake: bool,
    /// Whether a stop switch is wired.
    pub stop_input: bool,
    /// Whether opening the port resets the board, as DTR does on an UNO.
    pub reset_on_open: bool,
    /// Whether the board has a supply of its own, besides the USB cable.
    pub own_supply: bool,
    /// Whether the length of the port's queue can be read, which reveals a stuck
    /// line; a pseudo-terminal's can't.
    pub queue_shows: bool,
    /// Whether the board switches the ESC's supply.
    pub kill_output: bool,
    /// Whether the configuration has been proved: its first metre is not driven slowly.
    pub proved: bool,
    /// `board.esc.kind` of the configuration.
    pub esc_kind: EscKind,
    /// `board.esc.neutral_us` of the configuration; its deadband reaches to 1500 µs.
    pub neutral_us: u16,
    /// Distance of the geofence from the reference, in mm; negative if the reference leaves
    /// it.
    pub fence_mm: i32,
    /// `fence.braking_m_s2` of the configuration, in mm/s².
    pub braking_mm_s2: u32,
    /// `board.speed.pulse_distance_um` of the configuration; the true distance deviates
    /// from it by [`Deviation::PulseDistance`].
    pub pulse_distance_um: u32,
    /// Whether the safety filter is on.
    pub safety_filter: bool,
    /// Whether the steering is crooked, with `actuators.steering_table` in the configuration; the
    /// true one deviates from it as from a straight line.
    pub steering_table: bool,
    /// Whether the outer loop's gain may be tuned during a drive.
    pub tuning: bool,
    /// Whether the pilot learns live. The learner may send any values. Never with the safety filter.
    pub live: bool,
    /// Whether the program that arms also holds the drive, by renewals.
    pub attended: bool,
    /// Whether an armed car waits for a start that was given with the request to arm.
    pub waits: bool,
    /// Time from mid-exposure to the packet on the network, in ms.
    pub camera_latency_ms: u32,
    /// Delay of every byte beyond its transmission time, in µs.
    pub serial_delay_us: u32,
    /// Rate error of the board's clock, in ppm; positive is fast.
    pub board_skew_ppm: i32,
    /// Reading of the board's clock at its start, in ms.
    pub board_clock_ms: u32,
}

/// The reference of P.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReferenceKind {
    /// A circle.
    Circle,
    /// A figure of eight.
    Eight,
    /// A finite sequence of constant velocities, open loop.
    Steps,
    /// Where a program says, by set-points: round a circle.
    External,
}

/// A request of the operator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OperatorRequest {
    /// Arm and start driving.
    Arm,
    /// Stop and disarm.
    Disarm,
    /// Stop at once and latch.
    Stop,
    /// Reload the configuration file, which now holds the other of two.
    Reload,
    /// If the car stands: carry it back to its start with a full battery, and say so.
    Carry,
    /// The program that holds the drive is gone: slow down, stop and disarm.
    Gone,
    /// The time of the drive is over: slow down, stop and disarm.
    TimeUp,
    /// The dead-man switch is lost: disarm at once.
    Halt,
    /// Arm to jog, with throttle and steering by turns, until one of the requests to stop.
    Jog,
    /// Arm to jog, with the throttle held.
    JogOn,
    /// If the car stands: put it onto a stand, so that its wheels turn freely.
    Lift,
    /// Put the car down.
    PutDown,
}

/// An operator request with its time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ScheduledRequest {
    /// The request.
    pub request: OperatorRequest,
    /// Time of the request.
    pub at_ms: u32,
}

/// A fault with onset, duration and severity.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fault {
    /// Kind of fault.
    pub kind: FaultKind,
    /// Onset.
    pub at_ms: u32,
    /// Duration; ignored for instantaneous faults.
    pub for_ms: u32,
    /// Severity, 1 to 1000; see [`FaultKind`] for the meaning.
    pub severity: u32,
}

impl Schedule {
    /// Whether the car is calibrated well enough that it must drive.
    pub fn is_tolerable(&self) -> bool {
        let braking = i64::from(self.situation.braking_mm_s2);
        self.truth.is_tolerable()
            && self.situation.neutral_us.abs_diff(1_500) <= 10
            && braking * 10 <= i64::from(self.truth.deceleration_mm_s2()) * 9
    }
}

impl Fault {
    /// Largest severity.
    pub const WORST: u32 = 1_000;

    /// End of the fault.
    pub const fn end_ms(&self) -> u32 {
        self.at_ms.saturating_add(self.for_ms)
    }
}

macro_rules! deviations {
    ($($(#[$meaning:meta])* $kind:ident = $name:literal, $tolerable:expr, of $possible:expr;)*) => {
        /// A property of the true car; v is its value.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum Deviation {
            $($(#[$meaning])* $kind,)*
        }

        impl Deviation {
            /// All properties.
            pub const ALL: &[Self] = &[$(Self::$kind,)*];

            /// The name in a schedule.
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$kind => $name,)*
                }
            }

            /// The values that a calibrated car may have, and must be able to drive with.
            pub const fn tolerable(self) -> RangeInclusive<i32> {
                match self {
                    $(Self::$kind => $tolerable,)*
                }
            }

            /// The values that a schedule may state.
            pub const fn possible(self) -> RangeInclusive<i32> {
                match self {
                    $(Self::$kind => $possible,)*
                }
            }
        }
    };
}

deviations! {
    /// The pulse for straight wheels is v µs longer.
    ServoTrim = "servo-trim-us", -20..=20, of -200..=200;
    /// The servo's gain is v/1000 higher; -2000 reverses it.
    ServoGain = "servo-gain-permille", -80..=80, of -3_000..=1_000;
    /// The servo turns at most v mrad/s.
    ServoRate = "servo-rate-mrad-s", 5_000..=12_000, of 200..=20_000;
    /// The distance per motor pulse is v/1000 larger.
    PulseDistance = "pulse-distance-permille", -40..=40, of -500..=1_000;
    /// The wheels settle at a speed v/1000 higher.
    MotorGain = "motor-gain-permille", -200..=200, of -500..=1_000;
    /// Constant deceleration of the rolling car, in mm/s².
    Rolling = "rolling-mm-s2", 300..=1_500, of 0..=5_000;
    /// Deceleration of the rolling car per speed, in 1/1000 s.
    Viscous = "viscous-permille", 0..=1_000, of 0..=5_000;
    /// The pulse at which the ESC is neutral is v µs longer.
    EscNeutral = "esc-neutral-us", -10..=10, of -200..=200;
    /// The half width of the ESC's deadband is v µs larger.
    EscDeadband = "esc-deadband-us", -8..=8, of -26..=100;
    /// Time from a pulse to the motor's response, in ms.
    EscDeadTime = "esc-dead-time-ms", 10..=60, of 0..=500;
    /// Time constant of the motor's lag, in ms.
    MotorLag = "motor-lag-ms", 50..=100, of 20..=1_000;
    /// Time without pulses after which the ESC releases the motor, in ms.
    SignalLoss = "esc-signal-loss-ms", 100..=1_000, of 20..=3_000;
    /// The axes of the rigid body are turned by v mrad.
    BodyYaw = "body-yaw-mrad", -20..=20, of -3_142..=3_142;
    /// The pivot of the rigid body is v mm farther forward.
    PivotForward = "pivot-forward-mm", -10..=10, of -500..=500;
    /// The pivot of the rigid body is v mm farther to the left.
    PivotLeft = "pivot-left-mm", -10..=10, of -500..=500;
    /// The servo has v µs of play.
    ServoBacklash = "servo-backlash-us", 0..=10, of 0..=200;
    /// The floor rises by v/100 degrees.
    Slope = "slope-cdeg", 0..=50, of 0..=1_000;
    /// It rises in the direction of v degrees from the world's x axis.
    SlopeHeading = "slope-heading-deg", 0..=359, of 0..=359;
    /// The IMU is turned by v/10 degrees about the car's up axis.
    ImuYaw = "imu-yaw-ddeg", -20..=20, of -1_800..=1_800;
    /// The IMU is turned by v/10 degrees about its left axis.
    ImuPitch = "imu-pitch-ddeg", -20..=20, of -1_800..=1_800;
    /// The IMU is turned by v/10 degrees about its forward axis.
    ImuRoll = "imu-roll-ddeg", -20..=20, of -1_800..=1_800;
    /// The gyroscope measures v/1000 more; -2000 reverses it.
    GyroScale = "gyro-scale-permille", -15..=15, of -2_500..=900;
    /// The accelerometer measures v/1000 more.
    AccelerationScale = "acceleration-scale-permille", -20..=20, of -900..=900;
    /// A lasting acceleration leaks away with a time constant of v ms.
    ImuLeak = "imu-leak-ms", 2_000..=60_000, of 100..=1_000_000;
    /// The IMU's acceleration vibrates by v mm/s² while the wheels turn, and more by their speed.
    Vibration = "vibration-mm-s2", 0..=1_000, of 0..=20_000;
    /// The mid-exposure stamps are v µs late.
    StampBias = "stamp-bias-us", -2_000..=2_000, of -200_000..=200_000;
    /// That error grows by v ppm.
    StampDrift = "stamp-drift-ppm", -20..=20, of -20_000..=20_000;
    /// The pivot of the rigid body is v mm above the floor.
    BodyHeight = "body-height-mm", 80..=180, of 0..=2_000;
    /// The board's supply is v mV.
    Supply = "supply-mv", 4_600..=5_200, of 4_000..=5_500;
    /// Edges by interference while the ESC drives, per second.
    EmiDriven = "emi-driven-hz", 0..=0, of 0..=10_000;
    /// Edges by interference while it does not, per second.
    EmiStanding = "emi-standing-hz", 0..=0, of 0..=10_000;
    /// Further edges after each true one.
    Ringing = "ringing-edges", 0..=0, of 0..=20;
    /// The battery has given v mAh.
    Drained = "drained-mah", 0..=800, of 0..=3_000;
    /// v in 1000 IMU samples are torn: their low bytes are those of the sample before.
    ImuTorn = "imu-torn-permille", 0..=0, of 0..=1_000;
    /// The IMU's calibration of its parts, 0 (none) to 3 (full).
    ImuCalibration = "imu-calibration", 3..=3, of 0..=3;
    /// The IMU's register `SYS_STATUS`; 5 while its fusion runs.
    ImuStatus = "imu-status", 5..=5, of 0..=255;
    /// The IMU's register `SYS_ERR`.
    ImuError = "imu-error", 0..=0, of 0..=255;
    /// The IMU's register `ST_RESULT`; 15 if all self-tests passed.
    ImuSelfTest = "imu-self-test", 15..=15, of 0..=15;
    /// The wheels turn v/1000 farther to the left, and as much less far to the right.
    ServoAsymmetry = "servo-asymmetry-permille", -50..=50, of -800..=800;
    /// The servo has a dead band of v µs around straight wheels.
    ServoDeadBand = "servo-dead-band-us", 0..=6, of 0..=200;
    /// 1: the battery is not connected to the board.
    DividerOpen = "divider-open", 0..=0, of 0..=1;
}

impl Deviation {
    /// The property with this name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.iter().copied().find(|kind| kind.name() == name)
    }
}

/// [`Deviation::Rolling`] of the default car, and what its viscous friction adds at the
/// lowest speed that is of interest.
const ROLLING_MM_S2: i32 = 800 + 800;

/// The true car. What is not stated is as the simulated car's default.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TrueCar {
    /// The stated properties.
    pub deviations: BTreeMap<Deviation, i32>,
    /// The kind of the ESC, if it is not the configured one.
    pub esc: Option<EscKind>,
}

impl TrueCar {
    /// The stated value.
    pub fn get(&self, deviation: Deviation) -> Option<i32> {
        self.deviations.get(&deviation).copied()
    }

    /// The least deceleration of the car at neutral, rolling downhill, in mm/s².
    pub fn deceleration_mm_s2(&self) -> u32 {
        // A slope of v/100 degrees: 9.81 m/s² over 57.3 degrees.
        let downhill = self.get(Deviation::Slope).unwrap_or(0) * 171 / 100;
        let rolling = self.get(Deviation::Rolling).unwrap_or(ROLLING_MM_S2);
        u32::try_from(rolling - downhill).unwrap_or(0)
    }

    /// Whether a calibrated car may be so, which must drive.
    pub fn is_tolerable(&self) -> bool {
        let within = |(kind, value): (&Deviation, &i32)| kind.tolerable().contains(value);
        // Its neutral is learned while the board gives neutral.
        let esc = matches!(self.esc, None | Some(EscKind::LearnsNeutral));
        esc && self.deviations.iter().all(within)
    }
}
