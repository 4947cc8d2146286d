//! What the simulator and the process that runs the UNO image say to each other.
//!
//! `singletrack-simavr IMAGE.elf` runs the image instruction by instruction.
//! Requests on its standard input carry the inputs of the board: bytes on its line,
//! pulses of the motor, samples of the IMU. Replies on its standard output carry
//! the outputs. The simulator starts it and runs it in step with the car. Only that
//! program links libsimavr (under the GPL 3), and is a package of its own; this library
//! needs no C library.
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
mod message;

use serde::{Deserialize, Serialize};

pub use bno055::{Bno055, ImuRegisters};
pub use message::{
    BusFault, CYCLES_PER_US, Cost, Figures, Hang, Pin, PipeError, Pulse, Reply, Report, Request,
    ResetFlags, Run, receive, send,
};

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

#[cfg(test)]
mod tests {
    use super::Motion;

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
}
