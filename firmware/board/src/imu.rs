//! The newest IMU sample, and whether it has been sent.

use singletrack_protocol::{ImuAxes, ImuState};

use crate::{
    clock::{Stopwatch, age_us},
    io::ImuSample,
};

/// Time without a sample after which the IMU counts as silent.
pub(crate) const SILENCE_US: u32 = 50_000;

/// The registers `AXIS_MAP_CONFIG` and `AXIS_MAP_SIGN` of a BNO055 that is mounted like
/// this: they turn all of its values to the car's axes.
#[must_use]
pub const fn axis_map(axes: ImuAxes) -> [u8; 2] {
    let ImuAxes { forward, left, up } = axes;
    [
        forward.index() | left.index() << 2 | up.index() << 4,
        (forward.is_negative() as u8) << 2
            | (left.is_negative() as u8) << 1
            | up.is_negative() as u8,
    ]
}

#[derive(Clone, Debug)]
pub(crate) struct Imu {
    /// The newest sample; zeros before the first.
    sample: ImuSample,
    has_sample: bool,
    since_sample: Stopwatch,
    /// The sample has not been sent yet.
    unsent: bool,
}

impl Imu {
    pub(crate) const fn new() -> Self {
        Self {
            sample: ImuSample {
                time_us: 0,
                linear_acceleration_mm_s2: [0; 3],
                angular_velocity_mrad_s: [0; 3],
                attitude_q14: [0; 4],
            },
            has_sample: false,
            since_sample: Stopwatch::started_ago(u32::MAX),
            unsent: false,
        }
    }

    pub(crate) fn observe(&mut self, now_us: u32, elapsed_us: u32, newest: Option<&ImuSample>) {
        self.since_sample.advance(elapsed_us);
        let Some(newest) = newest else { return };
        if !self.has_sample || self.sample.time_us != newest.time_us {
            self.sample = *newest;
            self.has_sample = true;
            self.unsent = true;
            let age = age_us(now_us, newest.time_us).unwrap_or(0);
            self.since_sample = Stopwatch::started_ago(age);
        }
    }

    /// The newest sample; zeros before the first.
    pub(crate) const fn sample(&self) -> &ImuSample {
        &self.sample
    }

    pub(crate) const fn state(&self) -> ImuState {
        if self.since_sample.elapsed_us() >= SILENCE_US {
            ImuState::Silent
        } else if self.unsent {
            ImuState::Fresh
        } else {
            ImuState::Repeated
        }
    }

    /// Age of the sample in units of 100 µs, saturating.
    pub(crate) fn age_100us(&self) -> u8 {
        let limit_us = u16::from(u8::MAX) * 100;
        let age_us = u16::try_from(self.since_sample.elapsed_us()).unwrap_or(u16::MAX);
        (age_us.min(limit_us) / 100) as u8
    }

    /// Notes that the newest sample has been sent.
    pub(crate) const fn sent(&mut self) {
        self.unsent = false;
    }
}

#[cfg(test)]
mod tests {
    use singletrack_protocol::{ImuAxes, ImuAxis};

    use super::axis_map;

    #[test]
    fn mountings_have_the_data_sheets_registers() {
        // BST-BNO055-DS000, 3.4: placements P0 to P7. P1 is as printed.
        let [x, y, z] = [ImuAxis::PlusX, ImuAxis::PlusY, ImuAxis::PlusZ];
        let [minus_x, minus_y, minus_z] = [ImuAxis::MinusX, ImuAxis::MinusY, ImuAxis::MinusZ];
        for (forward, left, up, registers) in [
            (minus_y, x, z, [0x21, 0x04]),
            (x, y, z, [0x24, 0x00]),
            (minus_x, minus_y, z, [0x24, 0x06]),
            (y, minus_x, z, [0x21, 0x02]),
            (x, minus_y, minus_z, [0x24, 0x03]),
            (y, x, minus_z, [0x21, 0x01]),
            (minus_y, minus_x, minus_z, [0x21, 0x07]),
            (minus_x, y, minus_z, [0x24, 0x05]),
        ] {
            let axes = ImuAxes { forward, left, up };
            assert!(axes.is_mounting());
            assert_eq!(axis_map(axes), registers, "{axes:?}");
        }
    }
}
