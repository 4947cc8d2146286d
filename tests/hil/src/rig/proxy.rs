//! Parts of a line with the harness in the middle.

use singletrack_protocol::{Decoder, ImuState, Telemetry, ToHost};
use singletrack_sim::Truth;
use singletrack_statistics::Random;

/// Splits the bytes from the board into frames, and passes undecodable bytes
/// unchanged.
#[derive(Debug, Default)]
pub(super) struct Frames {
    decoder: Decoder,
    frame: Vec<u8>,
}

impl Frames {
    /// Processes bytes from the board and appends to `out` the bytes for the host:
    /// the same, except for telemetry, which `replace` may change.
    pub(super) fn pass(
        &mut self,
        bytes: &[u8],
        out: &mut Vec<u8>,
        mut replace: impl FnMut(&mut Telemetry),
    ) {
        for &byte in bytes {
            self.frame.push(byte);
            let message = match self.decoder.push(byte) {
                Some(Ok(packet)) => ToHost::decode(packet).ok(),
                Some(Err(_)) | None => None,
            };
            if let Some(ToHost::Telemetry(mut telemetry)) = message {
                replace(&mut telemetry);
                out.extend_from_slice(ToHost::Telemetry(telemetry).encode().as_bytes());
                self.frame.clear();
            } else if byte == 0 {
                out.append(&mut self.frame);
            }
        }
    }
}

/// Replaces the measured motion by the simulated car's: the car on the stand does
/// not move.
pub(super) fn replace_motion(telemetry: &mut Telemetry, truth: &Truth) {
    let milli = |value: f64| (value * 1_000.0).round() as i16;
    telemetry.imu = ImuState::Fresh;
    telemetry.imu_age_100us = 0;
    telemetry.linear_acceleration_mm_s2 = [
        milli(truth.longitudinal_acceleration),
        milli(truth.lateral_acceleration),
        0,
    ];
    telemetry.angular_velocity_mrad_s = [0, 0, milli(truth.yaw_rate)];
    let (sine, cosine) = (0.5 * truth.yaw).sin_cos();
    let q14 = |value: f64| (value * 16_384.0).round() as i16;
    telemetry.attitude_q14 = [q14(cosine), 0, 0, q14(sine)];
}

/// Flips bits, reproducibly.
#[derive(Debug)]
pub(super) struct Damage(Random);

impl Damage {
    pub(super) const fn new(seed: u64) -> Self {
        Self(Random::new(seed))
    }

    /// Flips one bit of each byte with this probability.
    pub(super) fn apply(&mut self, bytes: &mut [u8], probability: f64) {
        for byte in bytes {
            if self.0.happens(probability) {
                *byte ^= 1 << self.0.below(8);
            }
        }
    }
}
