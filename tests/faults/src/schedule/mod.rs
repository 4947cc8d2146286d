//! Schedules: initial situation, operator requests and faults.

mod generate;
mod kind;
mod text;
mod truth;

use singletrack_sim::{BoardKind, EscKind};

pub use kind::{FaultKind, FaultTarget};
pub use text::ScheduleError;
pub use truth::{Deviation, TrueCar};

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
    #[must_use]
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
    #[must_use]
    pub const fn end_ms(&self) -> u32 {
        self.at_ms.saturating_add(self.for_ms)
    }
}
