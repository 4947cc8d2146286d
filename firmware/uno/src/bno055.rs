//! The IMU: a BNO055 in its fusion mode without magnetometer (IMUPLUS).
//!
//! The sensor produces a sample every 10 ms of its own clock. It is polled every 10
//! ms, in the round before a telemetry record; a second time in the next round if
//! there was no new sample; and occasionally once more. A sample counts as new if
//! any of its bytes has changed. No sample is therefore missed or repeated, and a
//! stuck sensor looks silent.
//!
//! A sensor that does not answer, or has restarted, is configured again. The search
//! for it has no time limit.

use singletrack_board::{ImuHealth, ImuSample, axis_map};
use singletrack_protocol::{ImuAxes, TELEMETRY_PERIOD_US};

use crate::{
    ROUND_MS,
    twi::{self, Progress},
};

const ADDRESS: u8 = 0x28;

// Registers of page 0
const CHIP_ID: u8 = 0x00;
const PAGE_ID: u8 = 0x07;
const GYRO_DATA: u8 = 0x14;
/// The first of the registers of its health, up to the operation mode.
const CALIBRATION: u8 = 0x35;
const SELF_TEST: u8 = 0x36;
const SYSTEM_STATUS: u8 = 0x39;
const SYSTEM_ERROR: u8 = 0x3A;
const UNIT_SELECTION: u8 = 0x3B;
const OPERATION_MODE: u8 = 0x3D;
const POWER_MODE: u8 = 0x3E;
const AXIS_MAP: u8 = 0x41;

const BNO055: u8 = 0xA0;
const CONFIGURATION_MODE: u8 = 0x00;
const IMUPLUS_MODE: u8 = 0x08;
const MODE_BITS: u8 = 0x0F;
const NORMAL_POWER: u8 = 0x00;
/// m/s² (bit 0 clear) and rad/s (bit 1 set).
const UNITS: u8 = 0b10;

/// One sample: gyro, Euler angles, quaternion and linear acceleration.
const SAMPLE_LENGTH: usize = 26;
const _: () = assert!(SAMPLE_LENGTH <= twi::MAX_READ);
// Offsets in a sample, in words; the gyro's words come first.
const QUATERNION: usize = 6;
const LINEAR_ACCELERATION: usize = 10;

/// Bytes from the first register of its health to its mode.
const HEALTH_LENGTH: u8 = OPERATION_MODE + 1 - CALIBRATION;

/// Number of rounds of the main loop in `ms`, rounded up.
const fn rounds(ms: u8) -> u8 {
    ms.div_ceil(ROUND_MS)
}

/// A transfer of a sample takes less than 1 ms without clock stretching.
const TRANSFER_TIME_OUT: u8 = rounds(5);
const SAMPLE_PERIOD: u8 = rounds(10);
/// Number of samples between two checks of the mode, 100 ms apart.
const SAMPLES_PER_CHECK: u8 = 10;
/// After this sample the next poll follows in the next round. Without it, a sensor
/// with a fast clock would drift ahead until a sample is missed.
const EARLY_SAMPLE: u8 = 5;
const RETRY_AFTER: u8 = rounds(100);
/// Times to change the mode from the data sheet (19 ms to enter the configuration
/// mode, 7 ms to leave it), with a margin.
const ENTER_CONFIGURATION: u8 = rounds(25);
const LEAVE_CONFIGURATION: u8 = rounds(20);
const SETTLE: u8 = rounds(2);

/// Number of consecutive failures after which the sensor is set up again.
const MAX_FAILURES: u8 = 3;

/// The next transfer, or the one in progress.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Stage {
    Identify,
    EnterConfiguration,
    SelectPage,
    SetPower,
    SetUnits,
    SetAxes,
    LeaveConfiguration,
    Sample,
    CheckMode,
}

/// The sensor's driver.
pub(crate) struct Bno055 {
    stage: Stage,
    in_transfer: bool,
    /// Rounds between the last transfer and the next one.
    wait: u8,
    /// Rounds since the start of the last transfer.
    waited: u8,
    transfer_time_us: u32,
    samples_since_check: u8,
    failures: u8,
    errors: u16,
    health: ImuHealth,
    /// Axes and signs, as written to the sensor or about to be.
    axes: [u8; 2],
    newest: [u8; SAMPLE_LENGTH],
}

impl Bno055 {
    pub(crate) const fn new() -> Self {
        Self {
            stage: Stage::Identify,
            in_transfer: false,
            wait: 0,
            waited: 0,
            transfer_time_us: 0,
            samples_since_check: 0,
            failures: 0,
            errors: 0,
            health: ImuHealth {
                calibration: 0,
                self_test: 0,
                status: 0,
                error: 0,
            },
            axes: axis_map(ImuAxes::AS_PRINTED),
            newest: [0; SAMPLE_LENGTH],
        }
    }

    /// Errors so far, wrapping.
    pub(crate) const fn errors(&self) -> u16 {
        self.errors
    }

    /// Its own opinion of itself, ten times a second.
    pub(crate) const fn health(&self) -> ImuHealth {
        self.health
    }

    /// Sets the mounting; the sensor is set up again if it has changed.
    pub(crate) fn mount(&mut self, axes: ImuAxes) {
        let axes = axis_map(axes);
        if self.axes != axes && !self.in_transfer {
            self.axes = axes;
            self.next(Stage::Identify, 0);
        }
    }

    /// Call in every round; keeps `sample` at the newest one.
    pub(crate) fn poll(&mut self, now_us: u32, sample: &mut Option<ImuSample>) {
        // Every wait is shorter than the range of this counter.
        self.waited = self.waited.wrapping_add(1);
        if self.in_transfer {
            match twi::progress() {
                Progress::Busy if self.waited < TRANSFER_TIME_OUT => return,
                Progress::Busy => {
                    twi::free();
                    self.failed();
                }
                Progress::Failed => self.failed(),
                Progress::Done => self.answered(now_us, sample),
            }
            self.in_transfer = false;
        }
        if self.waited >= self.wait {
            self.start_transfer();
            self.in_transfer = true;
            self.waited = 0;
            self.transfer_time_us = now_us;
        }
    }

    #[inline(never)]
    fn start_transfer(&mut self) {
        let write = |bytes: &[u8]| twi::begin(ADDRESS, bytes, 0);
        let read = |register, length| twi::begin(ADDRESS, &[register], length);
        match self.stage {
            Stage::Identify => read(CHIP_ID, 1),
            Stage::EnterConfiguration => write(&[OPERATION_MODE, CONFIGURATION_MODE]),
            Stage::SelectPage => write(&[PAGE_ID, 0]),
            Stage::SetPower => write(&[POWER_MODE, NORMAL_POWER]),
            Stage::SetUnits => write(&[UNIT_SELECTION, UNITS]),
            Stage::SetAxes => write(&[AXIS_MAP, self.axes[0], self.axes[1]]),
            Stage::LeaveConfiguration => write(&[OPERATION_MODE, IMUPLUS_MODE]),
            Stage::Sample => read(GYRO_DATA, SAMPLE_LENGTH as u8),
            Stage::CheckMode => read(CALIBRATION, HEALTH_LENGTH),
        }
    }

    #[inline(never)]
    fn answered(&mut self, now_us: u32, sample: &mut Option<ImuSample>) {
        self.failures = 0;
        match self.stage {
            Stage::Identify if twi::first_byte() == BNO055 => {
                self.next(Stage::EnterConfiguration, 0);
            }
            // It acknowledges before it is ready.
            Stage::Identify => self.wait = RETRY_AFTER,
            Stage::EnterConfiguration => self.next(Stage::SelectPage, ENTER_CONFIGURATION),
            Stage::SelectPage => self.next(Stage::SetPower, SETTLE),
            Stage::SetPower => self.next(Stage::SetUnits, SETTLE),
            Stage::SetUnits => self.next(Stage::SetAxes, SETTLE),
            Stage::SetAxes => self.next(Stage::LeaveConfiguration, SETTLE),
            Stage::LeaveConfiguration => {
                let wait = LEAVE_CONFIGURATION + self.wait_for_slot(now_us);
                self.next(Stage::Sample, wait);
            }
            Stage::Sample => {
                let new = self.sampled(sample);
                self.samples_since_check += 1;
                if self.samples_since_check >= SAMPLES_PER_CHECK {
                    self.samples_since_check = 0;
                    self.next(Stage::CheckMode, 0);
                } else if new && self.samples_since_check != EARLY_SAMPLE {
                    self.wait = SAMPLE_PERIOD;
                } else {
                    self.wait = 0;
                }
            }
            Stage::CheckMode => {
                if self.checked() {
                    // Synchronises again if rounds were missed.
                    let wait = self.wait_for_slot(now_us);
                    self.next(Stage::Sample, wait);
                } else {
                    // It has restarted.
                    self.errors = self.errors.wrapping_add(1);
                    self.next(Stage::Identify, 0);
                }
            }
        }
    }

    /// Rounds from the last transfer to the round before a telemetry record. The
    /// first round has a record.
    fn wait_for_slot(&self, now_us: u32) -> u8 {
        let reports_now = now_us % TELEMETRY_PERIOD_US >= TELEMETRY_PERIOD_US / 2;
        self.waited + u8::from(reports_now)
    }

    fn next(&mut self, stage: Stage, wait: u8) {
        self.stage = stage;
        self.wait = wait;
    }

    fn failed(&mut self) {
        self.errors = self.errors.wrapping_add(1);
        self.failures = self.failures.saturating_add(1);
        let measures = matches!(self.stage, Stage::Sample | Stage::CheckMode);
        if !measures || self.failures >= MAX_FAILURES {
            self.next(Stage::Identify, RETRY_AFTER);
        }
    }

    /// Stores the health that was read; returns whether the mode is right.
    fn checked(&mut self) -> bool {
        self.health = ImuHealth {
            calibration: twi::first_byte(),
            self_test: twi::byte::<{ (SELF_TEST - CALIBRATION) as usize }>(),
            status: twi::byte::<{ (SYSTEM_STATUS - CALIBRATION) as usize }>(),
            error: twi::byte::<{ (SYSTEM_ERROR - CALIBRATION) as usize }>(),
        };
        let mode = twi::byte::<{ (OPERATION_MODE - CALIBRATION) as usize }>();
        mode & MODE_BITS == IMUPLUS_MODE
    }

    /// Stores the sample that was read; returns false if it is not new.
    #[inline(never)]
    fn sampled(&mut self, sample: &mut Option<ImuSample>) -> bool {
        let changed = twi::take(&mut self.newest);
        let (words, _) = self.newest.as_chunks();
        let attitude = words.get(QUATERNION..).unwrap_or_default();
        // A quaternion of length zero means that the sensor has restarted.
        if !changed || attitude.iter().take(4).all(|&word| word == [0; 2]) {
            return false;
        }
        let sample = sample.get_or_insert_default();
        sample.time_us = self.transfer_time_us;
        for (value, &word) in sample.angular_velocity_mrad_s.iter_mut().zip(words) {
            *value = angular_velocity_mrad_s(i16::from_le_bytes(word));
        }
        for (value, &word) in sample.attitude_q14.iter_mut().zip(attitude) {
            *value = i16::from_le_bytes(word);
        }
        let acceleration = words.get(LINEAR_ACCELERATION..).unwrap_or_default();
        for (value, &word) in sample
            .linear_acceleration_mm_s2
            .iter_mut()
            .zip(acceleration)
        {
            *value = linear_acceleration_mm_s2(i16::from_le_bytes(word));
        }
        true
    }
}

/// Converts from units of 0.01 m/s², saturating.
fn linear_acceleration_mm_s2(raw: i16) -> i16 {
    const LARGEST: i16 = i16::MAX / 10;
    raw.clamp(-LARGEST, LARGEST) * 10
}

/// Converts from units of 1/900 rad/s, rounded to nearest, saturating. The factor
/// 10/9 is 1 + 1/9, and 1/9 is approximated by 29127 / 2^18, which is exact enough
/// for all 16-bit numbers.
fn angular_velocity_mrad_s(raw: i16) -> i16 {
    let ninth = (i32::from(raw) * 29_127 + (1 << 17)) >> 18;
    raw.saturating_add(ninth as i16)
}
