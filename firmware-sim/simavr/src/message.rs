//! What simulator and process say to each other: one [`Reply`] for every
//! [`Request`].

use serde::{Deserialize, Serialize};

use crate::Motion;

/// The UNO's oscillator.
pub const CYCLES_PER_US: u64 = 16;

/// What the simulator asks for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Request {
    /// Let time pass. Answered by [`Reply::Ran`].
    Run(Run),
    /// Hold the processor in reset from now on: pins float. [`Reply::Done`].
    Hold,
    /// Let go of the reset, as the bootloader leaves the processor: the reset
    /// flags in register r2, MCUSR cleared. After a power-on the SRAM holds a
    /// pattern instead of what was there, and the IMU has had its supply since the
    /// processor was held. [`Reply::Done`].
    Start(ResetFlags),
    /// Stops the main program where it is. [`Reply::Done`].
    Hang(Hang),
    /// Faults of the bus to the IMU, from now on. [`Reply::Done`].
    SetBus(BusFault),
    /// [`Reply::Figures`].
    Measure,
}

/// Why the processor starts, as the register MCUSR tells it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ResetFlags(pub u8);

impl ResetFlags {
    /// The supply came up.
    pub const POWER_ON: Self = Self(1);
    /// The reset pin.
    pub const EXTERNAL: Self = Self(2);
    /// The supply dipped.
    pub const BROWN_OUT: Self = Self(4);
    /// The watchdog bit.
    pub const WATCHDOG: Self = Self(8);
}

/// How the main program stops. Interrupts go on in the first case; only the
/// watchdog helps in the second. A reset ends both.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Hang {
    /// The main loop makes no more progress; interrupts are served.
    MainLoop,
    /// The same with interrupts disabled.
    Everything,
}

/// What is wrong with the bus to the IMU.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum BusFault {
    /// Nothing.
    #[default]
    None,
    /// No IMU: nobody acknowledges its address.
    Absent,
    /// The IMU has lost count and holds the data line low: no start condition
    /// succeeds, until nine clock pulses by hand have let it go.
    Jammed,
    /// The data line is low for good.
    ShortCircuit,
    /// The IMU has restarted: it is in its configuration mode again and gives zeros.
    Restarted,
}

/// A span of time and what happens in it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Run {
    /// Up to this cycle.
    pub until: u64,
    /// Bytes whose stop bit reaches the receiver, and when; in order.
    pub received: Vec<(u64, u8)>,
    /// Rising edges of the motor's sensor; in order.
    pub motor_edges: Vec<u64>,
    /// What the IMU measures from then on; in order.
    pub motion: Vec<(u64, Motion)>,
    /// Voltage at the battery's terminals, in mV, from the start of the span.
    pub battery_mv: u16,
    /// Whether the stop switch is open, from the start of the span.
    pub stop_input_open: bool,
}

/// What the process answers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Reply {
    /// To [`Request::Run`].
    Ran(Report),
    /// To a request with nothing to tell.
    Done,
    /// To [`Request::Measure`].
    Figures(Figures),
    /// The request can't be carried out, or the processor has crashed: when, where
    /// and why. It stands still until the next [`Request::Start`].
    Failed(String),
}

/// What the board did in a span of time.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// The cycle reached: the one asked for, or up to one instruction later.
    pub cycle: u64,
    /// Bytes whose stop bit the transmitter has sent, and when; in order.
    pub transmitted: Vec<(u64, u8)>,
    /// Pulses that ended, in the order of their ends.
    pub pulses: Vec<Pulse>,
    /// The watchdog has reset the processor, which is held in reset since.
    pub watchdog_reset: Option<u64>,
    /// Bytes that found the receiver full, since the process started.
    pub bytes_overrun: u64,
}

/// A pin with pulses on it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Pin {
    /// D9, OC1A.
    Servo,
    /// D10, OC1B.
    Esc,
}

/// A pulse on a pin.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Pulse {
    /// Where.
    pub pin: Pin,
    /// The rising edge.
    pub start: u64,
    /// From the rising edge to the falling one, in cycles.
    pub width: u64,
}

/// What the run has cost so far.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Figures {
    /// Cycles out of reset, and those of them that the processor slept through.
    pub cycles: u64,
    /// See `cycles`.
    pub cycles_asleep: u64,
    /// Bytes of SRAM below the top that have been written since power-on without a
    /// gap: the deepest stack.
    pub stack_bytes: u16,
    /// Longest stretch with interrupts disabled outside an interrupt, in cycles.
    pub longest_critical_section: u32,
    /// The interrupts that were served.
    pub interrupts: Vec<Interrupt>,
    /// Marked sections: the main program writes a number other than zero to
    /// GPIOR0 at the beginning and zero at the end. Cycles of interrupts in
    /// between do not count. Number, times run, fewest, most and all cycles.
    pub sections: Vec<(u8, u64, u32, u32, u64)>,
}

/// What an interrupt has cost.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Interrupt {
    /// Number of its vector; 1 is INT0.
    pub vector: u8,
    /// Times served.
    pub count: u64,
    /// The longest one, from the vector to the return, in cycles, with the
    /// processor's own response.
    pub most_cycles: u32,
    /// All of them together.
    pub all_cycles: u64,
}
