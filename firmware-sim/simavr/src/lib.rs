//! What the simulator and the process that runs the UNO image say to each other.
//!
//! `singletrack-simavr IMAGE.elf` runs the image instruction by instruction.
//! Requests on its standard input carry the inputs of the board: bytes on its line,
//! pulses of the motor, samples of the IMU. Replies on its standard output carry
//! the outputs. The simulator starts it and runs it in step with the car. Only that
//! program links libsimavr (under the GPL 3), and is a package of its own; this library
//! needs no C library.
//!
//! There is one [`Reply`] for every [`Request`]. Over the pipe, a message is four bytes of length,
//! little-endian, then postcard.
//!
//! simavr runs the instructions; the process models UART, two-wire interface,
//! timer 1 and watchdog after the ATmega328P's data sheet, to the cycle.
//!
//! # Time
//!
//! All times are cycles of the board's oscillator (16 MHz) since the start of the
//! process. They advance even while the processor is held in reset, as it is
//! initially.
//!
//! # The board
//!
//! | Pin       | Connection                                                      |
//! |-----------|-----------------------------------------------------------------|
//! | D0, D1    | Line to the host; bytes that arrive during a reset are lost     |
//! | D2, INT0  | Motor sensor, high for 50 us from each rising edge              |
//! | D4        | Stop switch to ground; if open, the pin follows its pull-up     |
//! | D9, OC1A  | Servo pulses; a resistor pulls the floating pin low             |
//! | D10, OC1B | ESC pulses, likewise                                            |
//! | D7        | The kill output; a pull-down holds the floating pin low         |
//! | A0        | Half of the battery's voltage, against AVcc; or open            |
//! | A4, A5    | SDA and SCL with pull-ups, and the [`Bno055`] at 0x28           |

mod bno055;

use std::io::{self, Read, Write};

use serde::{Deserialize, Serialize, de::DeserializeOwned};

pub use bno055::{Bno055, ImuRegisters};

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

/// Motion along the IMU's axes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Motion {
    /// Acceleration without gravity, in mm/s².
    pub linear_acceleration_mm_s2: [i16; 3],
    /// Angular velocity, in mrad/s.
    pub angular_velocity_mrad_s: [i16; 3],
    /// Attitude as a unit quaternion w, x, y, z, scaled by 2^14.
    pub attitude_q14: [i16; 4],
}

impl Motion {
    /// This motion with the axes remapped as by the registers `AXIS_MAP_CONFIG` and
    /// `AXIS_MAP_SIGN`. Values that name no rotation leave it as it is.
    pub fn remapped(&self, [map, signs]: [u8; 2]) -> Self {
        let axes = [0, 2, 4].map(|shift| usize::from(map >> shift & 3));
        let signs = [4, 2, 1].map(|bit| if signs & bit == 0 { 1_i16 } else { -1 });
        // The rows are the new axes, along the old ones.
        let mut rows = [[0.0; 3]; 3];
        for ((row, axis), sign) in rows.iter_mut().zip(axes).zip(signs) {
            let Some(slot) = row.get_mut(axis) else {
                return *self;
            };
            *slot = f64::from(sign);
        }
        let [[a, b, c], [d, e, f], [g, h, i]] = rows;
        let determinant = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g);
        if determinant != 1.0 {
            return *self;
        }
        let turned = |values: [i16; 3]| {
            std::array::from_fn(|axis| values[axes[axis]].saturating_mul(signs[axis]))
        };
        Self {
            linear_acceleration_mm_s2: turned(self.linear_acceleration_mm_s2),
            angular_velocity_mrad_s: turned(self.angular_velocity_mrad_s),
            attitude_q14: product(self.attitude_q14.map(f64::from), inverse_rotation(rows))
                .map(|value| value.round() as i16),
        }
    }
}

/// The quaternion w, x, y, z that turns vectors along the new axes to the old ones, by
/// the rotation's axis and angle.
fn inverse_rotation([[a, b, c], [d, e, f], [g, h, i]]: [[f64; 3]; 3]) -> [f64; 4] {
    // At least one of the four components is a half or more: their squares have the sum 1.
    let squares = [
        1.0 + a + e + i,
        1.0 + a - e - i,
        1.0 - a + e - i,
        1.0 - a - e + i,
    ];
    let roots = squares.map(|square| (square / 4.0).max(0.0).sqrt());
    let [w, x, y, z] = roots;
    // Transposed: the inverse.
    let [p, q, r] = [f - h, g - c, b - d];
    let [s, t, u] = [b + d, c + g, f + h];
    if w >= 0.5 {
        [w, p / (4.0 * w), q / (4.0 * w), r / (4.0 * w)]
    } else if x >= 0.5 {
        [p / (4.0 * x), x, s / (4.0 * x), t / (4.0 * x)]
    } else if y >= 0.5 {
        [q / (4.0 * y), s / (4.0 * y), y, u / (4.0 * y)]
    } else {
        [r / (4.0 * z), t / (4.0 * z), u / (4.0 * z), z]
    }
}

/// The product of two quaternions w, x, y, z.
pub fn product([a, b, c, d]: [f64; 4], [e, f, g, h]: [f64; 4]) -> [f64; 4] {
    [
        a * e - b * f - c * g - d * h,
        a * f + b * e + c * h - d * g,
        a * g - b * h + c * e + d * f,
        a * h + b * g - c * f + d * e,
    ]
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

    #[test]
    fn a_quarter_turn_of_the_axes_turns_all_values_together() {
        // A quarter turn to the left about z: placement P0.
        let quarter = Motion {
            linear_acceleration_mm_s2: [1_000, -2_000, 9_807],
            angular_velocity_mrad_s: [1_000, -500, 3_142],
            attitude_q14: [16_384, 0, 0, 0],
        }
        .remapped([0x21, 0x04]);
        assert_eq!(quarter.linear_acceleration_mm_s2, [2_000, 1_000, 9_807]);
        assert_eq!(quarter.angular_velocity_mrad_s, [500, 1_000, 3_142]);
        // The car's heading is the chip's, less the quarter turn.
        assert_eq!(quarter.attitude_q14, [11_585, 0, 0, -11_585]);
    }

    /// The matrix of a quaternion, rows the axes of the world.
    fn matrix(quaternion: [i16; 4]) -> [[f64; 3]; 3] {
        let [w, x, y, z] = quaternion.map(|value| f64::from(value) / 16_384.0);
        [
            [
                1.0 - 2.0 * (y * y + z * z),
                2.0 * (x * y - w * z),
                2.0 * (x * z + w * y),
            ],
            [
                2.0 * (x * y + w * z),
                1.0 - 2.0 * (x * x + z * z),
                2.0 * (y * z - w * x),
            ],
            [
                2.0 * (x * z - w * y),
                2.0 * (y * z + w * x),
                1.0 - 2.0 * (x * x + y * y),
            ],
        ]
    }

    /// A vector in the world, from one along the axes of the attitude.
    fn in_world(quaternion: [i16; 4], vector: [i16; 3]) -> [f64; 3] {
        matrix(quaternion).map(|row| {
            row.iter()
                .zip(vector)
                .map(|(share, value)| share * f64::from(value))
                .sum()
        })
    }

    #[test]
    fn every_mounting_measures_the_same_motion_in_the_world() {
        let motion = Motion {
            linear_acceleration_mm_s2: [1_000, -2_000, 500],
            angular_velocity_mrad_s: [1_000, -500, 3_142],
            // Not about an axis.
            attitude_q14: [14_190, 4_730, 4_730, 4_730],
        };
        let mut mountings = 0;
        for map in 0..64 {
            for signs in 0..8 {
                let turned = motion.remapped([map, signs]);
                mountings += u32::from(turned != motion);
                for (old, new) in [
                    (
                        motion.linear_acceleration_mm_s2,
                        turned.linear_acceleration_mm_s2,
                    ),
                    (
                        motion.angular_velocity_mrad_s,
                        turned.angular_velocity_mrad_s,
                    ),
                ] {
                    let old = in_world(motion.attitude_q14, old);
                    let new = in_world(turned.attitude_q14, new);
                    for (old, new) in old.iter().zip(new) {
                        assert!((old - new).abs() < 2.0, "{map:#x} {signs:#x}");
                    }
                }
            }
        }
        // All but the one as printed.
        assert_eq!(mountings, 23);
    }

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
