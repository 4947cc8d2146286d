//! Messages between simulator and process: one [`Reply`] for every [`Request`].
//!
//! Over the pipe, a message is four bytes of length, little-endian, then postcard.

use std::io::{self, Read, Write};

use serde::{Deserialize, Serialize, de::DeserializeOwned};

use crate::{ImuRegisters, Motion};

/// Cycles of the UNO's oscillator per µs.
pub const CYCLES_PER_US: u64 = 16;

/// Requests of the simulator.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Request {
    /// Run for a time. Answered by [`Reply::Ran`].
    Run(Run),
    /// Hold the processor in reset; the pins float. [`Reply::Done`].
    Hold,
    /// Release the reset, in the state that the bootloader leaves: the reset flags
    /// in register r2, MCUSR cleared. After a power-on the SRAM is filled with a
    /// pattern, and the IMU has been powered since the processor was held.
    /// [`Reply::Done`].
    Start(ResetFlags),
    /// Stop a part of the program. [`Reply::Done`].
    Hang(Hang),
    /// Set the fault of the IMU's bus. [`Reply::Done`].
    SetBus(BusFault),
    /// Return the cost so far. [`Reply::Figures`].
    Measure,
}

/// Cause of the processor's start, in the format of the register MCUSR.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ResetFlags(pub u8);

impl ResetFlags {
    /// Power-on.
    pub const POWER_ON: Self = Self(1);
    /// The reset pin.
    pub const EXTERNAL: Self = Self(2);
    /// Supply voltage too low.
    pub const BROWN_OUT: Self = Self(4);
    /// Watchdog timeout.
    pub const WATCHDOG: Self = Self(8);
}

/// Ways in which the program stops working. A reset ends each.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Hang {
    /// The main loop stops; interrupts are served.
    MainLoop,
    /// The main loop stops with interrupts disabled.
    Everything,
    /// The interrupt of timer 0 is masked: no ticks. The main loop and all other interrupts
    /// go on, and timer 1 repeats its last pulses.
    Ticks,
    /// Timer 1, which makes the pulses, has no clock: the pins stay as they are.
    Pulses,
}

/// Faults of the bus to the IMU.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum BusFault {
    /// No fault.
    #[default]
    None,
    /// No IMU: its address is not acknowledged.
    Absent,
    /// The IMU has lost count of bits and holds the data line low: no start
    /// condition succeeds until nine clock pulses have released it.
    Jammed,
    /// The data line is permanently low.
    ShortCircuit,
    /// The IMU has restarted: it is in its configuration mode and gives zeros.
    Restarted,
}

/// A time span with its inputs.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Run {
    /// End of the span, in cycles.
    pub until: u64,
    /// Received bytes with the times of their stop bits, in order.
    pub received: Vec<(u64, u8)>,
    /// Rising edges of the motor sensor, in order.
    pub motor_edges: Vec<u64>,
    /// Changes of the IMU's motion with their times, in order.
    pub motion: Vec<(u64, Motion)>,
    /// Voltage at the battery's terminals, in mV, from the start of the span.
    pub battery_mv: u16,
    /// The board's 5 V, in mV, from the start of the span; zero leaves it.
    pub supply_mv: u16,
    /// The battery's divider is not connected: the input floats.
    pub divider_open: bool,
    /// The registers of the IMU's health while it works, from the start of the span;
    /// none leaves them.
    pub imu_health: Option<ImuRegisters>,
    /// Whether the stop switch is open, from the start of the span.
    pub stop_input_open: bool,
}

/// Replies of the process.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Reply {
    /// To [`Request::Run`].
    Ran(Report),
    /// To a request without a result.
    Done,
    /// To [`Request::Measure`].
    Figures(Figures),
    /// The request can't be executed, or the processor has crashed: time, address
    /// and reason. It stands still until the next [`Request::Start`].
    Failed(String),
}

/// Outputs of the board in a time span.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// The cycle reached: the requested one, or up to one instruction later.
    pub cycle: u64,
    /// Sent bytes with the times of their stop bits, in order.
    pub transmitted: Vec<(u64, u8)>,
    /// Pulses that ended, in order of their ends.
    pub pulses: Vec<Pulse>,
    /// Time of a watchdog reset; the processor is held in reset since.
    pub watchdog_reset: Option<u64>,
    /// Bytes lost by receiver overrun since the process started.
    pub bytes_overrun: u64,
    /// Changes of the kill output (D7) with their times, in order: whether it is
    /// high.
    pub kill_output: Vec<(u64, bool)>,
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
    /// The pin.
    pub pin: Pin,
    /// The rising edge.
    pub start: u64,
    /// Width, in cycles.
    pub width: u64,
}

/// Resource usage so far.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Figures {
    /// Cycles out of reset, and those of them spent sleeping.
    pub cycles: u64,
    /// See `cycles`.
    pub cycles_asleep: u64,
    /// Deepest stack: contiguous bytes below the top of the SRAM that have been
    /// written since power-on.
    pub stack_bytes: u16,
    /// Longest stretch with interrupts disabled outside an interrupt, in cycles.
    pub longest_critical_section: u32,
    /// The interrupts that were served, by their vectors: 1 is INT0. From the vector to the
    /// return, including the processor's response.
    pub interrupts: Vec<Cost>,
    /// Marked sections: the main program writes a number other than zero to GPIOR0
    /// at the start and zero at the end. Cycles of interrupts in between do not
    /// count.
    pub sections: Vec<Cost>,
}

/// Cost of a part of the program.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Cost {
    /// Its number.
    pub number: u8,
    /// How often it ran.
    pub count: u64,
    /// Cycles of its longest run.
    pub most_cycles: u32,
    /// Cycles of all runs.
    pub all_cycles: u64,
}

/// Largest length of a message.
const MAX_LENGTH: u32 = 1 << 24;

/// Errors of sending and receiving.
#[derive(Debug, thiserror::Error)]
pub enum PipeError {
    /// Error of the pipe, for example after the other side has ended.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// The length exceeds the limit.
    #[error("message too long: {0} bytes")]
    Length(u32),
    /// The bytes do not decode.
    #[error("invalid message: {0}")]
    Codec(#[from] postcard::Error),
}

/// Sends a message and flushes the pipe.
///
/// # Errors
///
/// Fails if the pipe does not accept it.
pub fn send(pipe: &mut impl Write, message: &impl Serialize) -> Result<(), PipeError> {
    let mut bytes = vec![0; 4];
    bytes = postcard::to_extend(message, bytes)?;
    let length = u32::try_from(bytes.len() - 4).unwrap_or(u32::MAX);
    if length > MAX_LENGTH {
        return Err(PipeError::Length(length));
    }
    if let Some(prefix) = bytes.get_mut(..4) {
        prefix.copy_from_slice(&length.to_le_bytes());
    }
    pipe.write_all(&bytes)?;
    Ok(pipe.flush()?)
}

/// Receives a message; `None` if the other side has closed the pipe.
///
/// # Errors
///
/// Fails if the message is truncated, too long or invalid.
pub fn receive<T: DeserializeOwned>(pipe: &mut impl Read) -> Result<Option<T>, PipeError> {
    let mut prefix = Vec::new();
    if pipe.by_ref().take(4).read_to_end(&mut prefix)? == 0 {
        return Ok(None);
    }
    let truncated = |_| io::Error::from(io::ErrorKind::UnexpectedEof);
    let length = u32::from_le_bytes(prefix.try_into().map_err(truncated)?);
    if length > MAX_LENGTH {
        return Err(PipeError::Length(length));
    }
    let mut bytes = vec![0; length as usize];
    pipe.read_exact(&mut bytes)?;
    Ok(Some(postcard::from_bytes(&bytes)?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Request, ResetFlags, Run};

    #[test]
    fn messages_pass_in_order_until_the_end() {
        let messages = [
            Request::Start(ResetFlags::POWER_ON),
            Request::Run(Run {
                until: u64::MAX,
                received: vec![(7, 255)],
                ..Run::default()
            }),
            Request::Measure,
        ];
        let mut pipe = Vec::new();
        for message in &messages {
            send(&mut pipe, message).unwrap();
        }
        let mut pipe = pipe.as_slice();
        for message in messages {
            assert_eq!(receive(&mut pipe).unwrap(), Some(message));
        }
        assert_eq!(receive::<Request>(&mut pipe).unwrap(), None);
    }

    #[test]
    fn a_truncated_overlong_or_invalid_message_is_an_error() {
        let mut whole = Vec::new();
        send(&mut whole, &Request::Start(ResetFlags::EXTERNAL)).unwrap();
        for length in 1..whole.len() {
            assert!(receive::<Request>(&mut &whole[..length]).is_err());
        }
        let too_long = u32::MAX.to_le_bytes();
        assert!(matches!(
            receive::<Request>(&mut too_long.as_slice()),
            Err(PipeError::Length(_))
        ));
        assert!(matches!(
            receive::<Request>(&mut [1, 0, 0, 0, 99].as_slice()),
            Err(PipeError::Codec(_))
        ));
    }
}
