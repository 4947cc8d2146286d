//! The IMU as a device on its bus.
//!
//! Registers, times and units follow Bosch's data sheet BST-BNO055-DS000, chapters
//! 3 and 4, as far as a driver needs them to start the sensor, to detect its
//! restart and to read it. Raw sensors, Euler angles, gravity and the second page
//! read as zero.

use serde::{Deserialize, Serialize};

use crate::{CYCLES_PER_US, Motion};

/// The registers of the sensor's health while its fusion runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ImuRegisters {
    /// `CALIB_STAT`.
    pub calibration: u8,
    /// `ST_RESULT`.
    pub self_test: u8,
    /// `SYS_STATUS`.
    pub status: u8,
    /// `SYS_ERR`.
    pub error: u8,
}

impl Default for ImuRegisters {
    /// Calibrated, but for the magnetometer, which this mode does not use.
    fn default() -> Self {
        Self {
            calibration: 0xFC,
            self_test: 0x0F,
            status: 5,
            error: 0,
        }
    }
}

const MS: u64 = 1_000 * CYCLES_PER_US;
/// Time from power-on to the first acknowledgement.
const SILENT: u64 = 400 * MS;
/// Time from power-on to the configuration mode.
const STARTUP: u64 = 650 * MS;
const TO_CONFIGURATION: u64 = 19 * MS;
const FROM_CONFIGURATION: u64 = 7 * MS;

const CHIP_ID: u8 = 0x00;
const PAGE_ID: u8 = 0x07;
const GYROSCOPE: u8 = 0x14;
const QUATERNION: u8 = 0x20;
const LINEAR_ACCELERATION: u8 = 0x28;
const TEMPERATURE: u8 = 0x34;
const CALIB_STAT: u8 = 0x35;
const ST_RESULT: u8 = 0x36;
const SYS_STATUS: u8 = 0x39;
const SYS_ERR: u8 = 0x3A;
const UNIT_SEL: u8 = 0x3B;
const OPR_MODE: u8 = 0x3D;
const PWR_MODE: u8 = 0x3E;
const SYS_TRIGGER: u8 = 0x3F;
const TEMP_SOURCE: u8 = 0x40;
const AXIS_MAP_CONFIG: u8 = 0x41;
const AXIS_MAP_SIGN: u8 = 0x42;

const RESET: u8 = 0x20;
const MODE: u8 = 0x0F;
const CONFIGURATION: u8 = 0x00;

/// Chip, accelerometer, magnetometer, gyroscope, software, boot loader.
const IDENTITY: [u8; 7] = [0xA0, 0xFB, 0x32, 0x0F, 0x11, 0x03, 0x15];

/// A BNO055 with its registers and state.
///
/// Times are cycles of the board, see the crate. It is powered at cycle zero.
#[derive(Clone, Debug)]
pub struct Bno055 {
    newest: Motion,
    /// The register values. Data sheet, 3.7: in one transfer, low and high byte of
    /// a value are consistent.
    motion: Motion,
    /// Times of the first acknowledgement and the configuration mode after a restart.
    speaks: u64,
    ready: u64,
    mode: u8,
    /// The mode after the present change, and the end of the change.
    next_mode: Option<(u8, u64)>,
    page: u8,
    units: u8,
    power: u8,
    temperature_source: u8,
    axes: [u8; 2],
    health: ImuRegisters,
    pointer: u8,
    /// The next written byte is a register number.
    addressed: bool,
}

impl Default for Bno055 {
    fn default() -> Self {
        Self {
            newest: Motion::default(),
            motion: Motion::default(),
            speaks: SILENT,
            ready: STARTUP,
            mode: CONFIGURATION,
            next_mode: None,
            page: 0,
            units: 0x80,
            power: 0,
            temperature_source: 0,
            axes: [0x24, 0],
            health: ImuRegisters::default(),
            pointer: 0,
            addressed: false,
        }
    }
}

impl Bno055 {
    /// Its address on the bus, seven bits.
    pub const ADDRESS: u8 = 0x28;

    /// Sets the motion that it measures.
    pub const fn measure(&mut self, motion: Motion) {
        self.newest = motion;
    }

    /// Sets the registers of its health.
    pub const fn set_health(&mut self, health: ImuRegisters) {
        self.health = health;
    }

    /// Power-on, or a reset by the register `SYS_TRIGGER`: all settings are lost,
    /// and the start-up time begins.
    pub fn power_on(&mut self, now: u64) {
        self.restart();
        self.speaks = now + SILENT;
        self.ready = now + STARTUP;
    }

    /// Restarts without start-up time, in the configuration mode.
    pub fn restart(&mut self) {
        *self = Self {
            newest: self.newest,
            motion: self.motion,
            health: self.health,
            speaks: 0,
            ready: 0,
            ..Self::default()
        };
    }

    /// Whether it acknowledges its address. If so, a transfer starts.
    pub const fn select(&mut self, now: u64, to_write: bool) -> bool {
        self.addressed = to_write;
        now >= self.speaks
    }

    /// Processes a byte of the master: first the register number, then the values
    /// of that and the following registers.
    pub fn write(&mut self, now: u64, byte: u8) {
        if self.addressed {
            self.addressed = false;
            self.pointer = byte;
            return;
        }
        let register = self.pointer;
        self.pointer = self.pointer.wrapping_add(1);
        self.settle(now);
        // Ignored during the start-up and a change of mode.
        if now < self.ready || self.next_mode.is_some() {
            return;
        }
        if register == PAGE_ID {
            self.page = byte & 1;
            return;
        }
        if self.page != 0 {
            return;
        }
        match register {
            OPR_MODE => self.change_mode(now, byte & MODE),
            SYS_TRIGGER if byte & RESET != 0 => self.power_on(now),
            // Other registers are writable only in the configuration mode.
            _ if self.mode != CONFIGURATION => {}
            UNIT_SEL => self.units = byte & 0x97,
            PWR_MODE => self.power = byte & 3,
            TEMP_SOURCE => self.temperature_source = byte & 3,
            AXIS_MAP_CONFIG => self.axes[0] = byte & 0x3F,
            AXIS_MAP_SIGN => self.axes[1] = byte & 7,
            _ => {}
        }
    }

    /// A byte for the master, from the last selected register or the one after the
    /// last read.
    pub fn read(&mut self, now: u64) -> u8 {
        let register = self.pointer;
        self.pointer = self.pointer.wrapping_add(1);
        self.settle(now);
        if now < self.ready {
            return 0;
        }
        // The low bytes have even numbers.
        if register.is_multiple_of(2) {
            self.motion = self.newest.remapped(self.axes);
        }
        self.register(register)
    }

    fn register(&self, register: u8) -> u8 {
        if register == PAGE_ID {
            return self.page;
        }
        if self.page != 0 {
            return 0;
        }
        if let Some(identity) = IDENTITY.get(usize::from(register - CHIP_ID)) {
            return *identity;
        }
        match register {
            GYROSCOPE..0x1A => low_or_high(&self.angular_velocity(), register - GYROSCOPE),
            QUATERNION..LINEAR_ACCELERATION => low_or_high(&self.attitude(), register - QUATERNION),
            LINEAR_ACCELERATION..0x2E => {
                low_or_high(&self.linear_acceleration(), register - LINEAR_ACCELERATION)
            }
            TEMPERATURE => 25,
            CALIB_STAT if self.fuses() => self.health.calibration,
            ST_RESULT => self.health.self_test,
            SYS_ERR => self.health.error,
            SYS_STATUS => match (self.settled_mode(), self.fuses()) {
                (_, true) => self.health.status,
                (Some(CONFIGURATION) | None, _) => 0,
                _ => 6,
            },
            UNIT_SEL => self.units,
            OPR_MODE => self.mode,
            PWR_MODE => self.power,
            TEMP_SOURCE => self.temperature_source,
            AXIS_MAP_CONFIG => self.axes[0],
            AXIS_MAP_SIGN => self.axes[1],
            _ => 0,
        }
    }

    fn change_mode(&mut self, now: u64, mode: u8) {
        if mode == self.mode || mode > 0x0C {
            return;
        }
        let (into, out_of) = (TO_CONFIGURATION, FROM_CONFIGURATION);
        let time = if mode == CONFIGURATION { into } else { out_of };
        self.next_mode = Some((mode, now + time));
    }

    fn settle(&mut self, now: u64) {
        let is_over = |(_, since): &mut (u8, u64)| now >= *since;
        if let Some((mode, _)) = self.next_mode.take_if(is_over) {
            self.mode = mode;
        }
    }

    /// The mode; `None` during a change.
    fn settled_mode(&self) -> Option<u8> {
        self.next_mode.is_none().then_some(self.mode)
    }

    /// Whether the fusion computes attitude and linear acceleration.
    fn fuses(&self) -> bool {
        matches!(self.settled_mode(), Some(0x08..=0x0C))
    }

    fn angular_velocity(&self) -> [i16; 3] {
        // Modes with the gyroscope, the data sheet's table 3-5.
        if !matches!(self.settled_mode(), Some(0x03 | 0x05..=0x08 | 0x0B | 0x0C)) {
            return [0; 3];
        }
        let lsb_per_mrad_s = if self.units & 2 == 0 {
            16.0 * 180.0 / std::f64::consts::PI / 1_000.0
        } else {
            900.0 / 1_000.0
        };
        scaled(self.motion.angular_velocity_mrad_s, lsb_per_mrad_s)
    }

    fn linear_acceleration(&self) -> [i16; 3] {
        if !self.fuses() {
            return [0; 3];
        }
        let in_metres = self.units & 1 == 0;
        let lsb_per_mm_s2 = if in_metres { 0.1 } else { 1.0 / 9.806_65 };
        scaled(self.motion.linear_acceleration_mm_s2, lsb_per_mm_s2)
    }

    fn attitude(&self) -> [i16; 4] {
        let attitude = self.fuses().then_some(self.motion.attitude_q14);
        attitude.unwrap_or_default()
    }
}

fn scaled(values: [i16; 3], factor: f64) -> [i16; 3] {
    // Saturates, as a cast from a float does.
    values.map(|value| (f64::from(value) * factor).round() as i16)
}

fn low_or_high(values: &[i16], offset: u8) -> u8 {
    let value = values.get(usize::from(offset / 2)).copied().unwrap_or(0);
    value.to_le_bytes()[usize::from(offset % 2)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_that_changes_during_a_read_is_consistent() {
        let mut device = Bno055::default();
        write(&mut device, READY, OPR_MODE, IMU);
        let now = READY + FROM_CONFIGURATION;
        let gyroscope = |mrad_s| Motion {
            angular_velocity_mrad_s: [mrad_s; 3],
            ..Motion::default()
        };
        device.measure(gyroscope(-10));
        let mut bytes = [0; 4];
        device.select(now, true);
        device.write(now, GYROSCOPE);
        device.select(now, false);
        for (index, byte) in bytes.iter_mut().enumerate() {
            if index == 1 {
                device.measure(gyroscope(1_000));
            }
            *byte = device.read(now);
        }
        let [old, new] = [[bytes[0], bytes[1]], [bytes[2], bytes[3]]].map(i16::from_le_bytes);
        assert!(old < 0 && new > 0, "{old} {new}");
    }

    const READY: u64 = STARTUP;
    const IMU: u8 = 0x08;
    const MOTION: Motion = Motion {
        linear_acceleration_mm_s2: [1_000, -2_000, 9_807],
        angular_velocity_mrad_s: [1_000, -500, 3_142],
        attitude_q14: [16_384, -1, 2, -16_384],
    };

    fn write(device: &mut Bno055, now: u64, register: u8, value: u8) {
        assert!(device.select(now, true));
        device.write(now, register);
        device.write(now, value);
    }

    fn read<const N: usize>(device: &mut Bno055, now: u64, register: u8) -> [u8; N] {
        assert!(device.select(now, true));
        device.write(now, register);
        assert!(device.select(now, false));
        std::array::from_fn(|_| device.read(now))
    }

    fn words<const N: usize>(device: &mut Bno055, now: u64, register: u8) -> [i16; N] {
        assert!(device.select(now, true));
        device.write(now, register);
        std::array::from_fn(|_| i16::from_le_bytes([device.read(now), device.read(now)]))
    }

    fn fusing() -> (Bno055, u64) {
        let mut device = Bno055::default();
        device.measure(MOTION);
        write(&mut device, READY, OPR_MODE, IMU);
        (device, READY + FROM_CONFIGURATION)
    }

    #[test]
    fn after_power_on_it_is_silent_then_blank_then_ready() {
        let mut device = Bno055::default();
        assert!(!device.select(SILENT - 1, true));
        assert_eq!(read(&mut device, SILENT, CHIP_ID), [0]);
        assert_eq!(read(&mut device, READY, CHIP_ID), [0xA0, 0xFB, 0x32, 0x0F]);
        assert_eq!(read(&mut device, READY, OPR_MODE), [CONFIGURATION]);
    }

    #[test]
    fn a_change_of_mode_takes_time_and_gives_zeros() {
        let mut device = Bno055::default();
        device.measure(MOTION);
        assert_eq!(words(&mut device, READY, QUATERNION), [0; 4]);
        write(&mut device, READY, OPR_MODE, IMU);
        let early = READY + FROM_CONFIGURATION - 1;
        assert_eq!(read(&mut device, early, OPR_MODE), [CONFIGURATION]);
        assert_eq!(words(&mut device, early, QUATERNION), [0; 4]);
        assert_eq!(read(&mut device, early, SYS_STATUS), [0]);
        let now = early + 1;
        assert_eq!(read(&mut device, now, OPR_MODE), [IMU]);
        assert_eq!(read(&mut device, now, SYS_STATUS), [5]);
        assert_eq!(words(&mut device, now, QUATERNION), MOTION.attitude_q14);

        write(&mut device, now, OPR_MODE, CONFIGURATION);
        let early = now + TO_CONFIGURATION - 1;
        assert_eq!(read(&mut device, early, OPR_MODE), [IMU]);
        assert_eq!(words(&mut device, early, QUATERNION), [0; 4]);
        assert_eq!(read(&mut device, early + 1, OPR_MODE), [CONFIGURATION]);
    }

    #[test]
    fn units_are_those_selected_in_the_configuration_mode() {
        let (mut device, now) = fusing();
        // 16 per degree a second, 100 per m/s².
        assert_eq!(words(&mut device, now, GYROSCOPE), [917, -458, 2_880]);
        assert_eq!(
            words(&mut device, now, LINEAR_ACCELERATION),
            [100, -200, 981]
        );
        write(&mut device, now, UNIT_SEL, 0x03);
        assert_eq!(words(&mut device, now, GYROSCOPE), [917, -458, 2_880]);

        write(&mut device, now, OPR_MODE, CONFIGURATION);
        let now = now + TO_CONFIGURATION;
        write(&mut device, now, UNIT_SEL, 0x03);
        write(&mut device, now, OPR_MODE, IMU);
        let now = now + FROM_CONFIGURATION;
        // 900 per rad/s, 1 per mg.
        assert_eq!(words(&mut device, now, GYROSCOPE), [900, -450, 2_828]);
        assert_eq!(
            words(&mut device, now, LINEAR_ACCELERATION),
            [102, -204, 1_000]
        );
        assert_eq!(words(&mut device, now, QUATERNION), MOTION.attitude_q14);
    }

    #[test]
    fn the_registers_of_the_axis_map_turn_the_values() {
        let (mut device, now) = fusing();
        write(&mut device, now, OPR_MODE, CONFIGURATION);
        let now = now + TO_CONFIGURATION;
        write(&mut device, now, AXIS_MAP_CONFIG, 0x21);
        write(&mut device, now, AXIS_MAP_SIGN, 0x04);
        write(&mut device, now, OPR_MODE, IMU);
        let now = now + FROM_CONFIGURATION;
        assert_eq!(
            words(&mut device, now, LINEAR_ACCELERATION),
            [200, 100, 981]
        );
    }

    #[test]
    fn the_health_is_as_set_while_the_fusion_runs() {
        let (mut device, now) = fusing();
        assert_eq!(read(&mut device, now, CALIB_STAT), [0xFC, 0x0F, 0, 0, 5, 0]);
        device.set_health(ImuRegisters {
            calibration: 0x30,
            self_test: 0x0B,
            status: 1,
            error: 3,
        });
        assert_eq!(read(&mut device, now, CALIB_STAT), [0x30, 0x0B, 0, 0, 1, 3]);
    }

    #[test]
    fn a_burst_read_continues_through_the_registers_and_ends_in_zeros() {
        let (mut device, now) = fusing();
        let burst: [u8; 26] = read(&mut device, now, GYROSCOPE);
        assert_eq!(burst[..2], 917_i16.to_le_bytes());
        assert_eq!(burst[12..14], 16_384_i16.to_le_bytes());
        assert_eq!(burst[24..26], 981_i16.to_le_bytes());
        assert_eq!(read(&mut device, now, 0x70), [0; 40]);
        assert_eq!(read(&mut device, now, 0xFF), [0, 0xA0]);
    }

    #[test]
    fn the_second_page_hides_the_first() {
        let (mut device, now) = fusing();
        write(&mut device, now, PAGE_ID, 1);
        assert_eq!(read(&mut device, now, PAGE_ID), [1]);
        assert_eq!(words(&mut device, now, QUATERNION), [0; 4]);
        write(&mut device, now, PAGE_ID, 0);
        assert_eq!(words(&mut device, now, QUATERNION), MOTION.attitude_q14);
    }

    #[test]
    fn a_reset_by_register_restarts_it() {
        let (mut device, now) = fusing();
        write(&mut device, now, SYS_TRIGGER, RESET);
        assert!(!device.select(now + SILENT - 1, false));
        assert_eq!(read(&mut device, now + STARTUP, OPR_MODE), [CONFIGURATION]);
    }

    #[test]
    fn a_restart_shows_in_the_mode_and_in_zeros() {
        let (mut device, now) = fusing();
        device.restart();
        assert_eq!(read(&mut device, now, OPR_MODE), [CONFIGURATION]);
        assert_eq!(words(&mut device, now, QUATERNION), [0; 4]);
        assert_eq!(read(&mut device, now, CHIP_ID), [0xA0]);
    }

    #[test]
    fn writes_during_a_change_of_mode_are_lost() {
        let mut device = Bno055::default();
        write(&mut device, READY, OPR_MODE, IMU);
        write(&mut device, READY + 1, OPR_MODE, CONFIGURATION);
        let now = READY + FROM_CONFIGURATION;
        assert_eq!(read(&mut device, now, OPR_MODE), [IMU]);
    }
}
