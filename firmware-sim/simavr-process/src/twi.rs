//! The two-wire interface as a master, data sheet chapter 21, with the IMU on its
//! bus and the two lines as the pins see them.

use singletrack_simavr::{Bno055, BusFault};

const TWINT: u8 = 0x80;
const TWEA: u8 = 0x40;
const TWSTA: u8 = 0x20;
const TWSTO: u8 = 0x10;
const TWEN: u8 = 0x04;
const TWIE: u8 = 0x01;

const STARTED: u8 = 0x08;
const STARTED_AGAIN: u8 = 0x10;
const WRITE_ACKNOWLEDGED: u8 = 0x18;
const WRITE_REFUSED: u8 = 0x20;
const SENT_ACKNOWLEDGED: u8 = 0x28;
const SENT_REFUSED: u8 = 0x30;
const ARBITRATION_LOST: u8 = 0x38;
const READ_ACKNOWLEDGED: u8 = 0x40;
const READ_REFUSED: u8 = 0x48;
const RECEIVED: u8 = 0x50;
const RECEIVED_LAST: u8 = 0x58;
const NOTHING: u8 = 0xF8;

/// Clock pulses after which a slave that has lost count releases the bus.
const PULSES_TO_FREE: u8 = 9;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Action {
    Start,
    Address,
    Send,
    Receive,
    Stop,
}

#[derive(Debug)]
pub(crate) struct Twi {
    pub(crate) imu: Bno055,
    fault: BusFault,
    /// Pulses that a jammed slave still needs; zero with any other fault.
    pulses_to_free: u8,
    clock_high: bool,
    pub(crate) bit_rate: u8,
    pub(crate) prescaler: u8,
    pub(crate) control: u8,
    status: u8,
    pub(crate) data: u8,
    /// Own address and its mask.
    pub(crate) own_address: [u8; 2],
    /// Between a start and a stop condition of this master.
    owns_bus: bool,
    /// The action in progress and its end. `u64::MAX`: it waits for the data line.
    action: Option<(Action, u64)>,
}

impl Default for Twi {
    fn default() -> Self {
        Self {
            imu: Bno055::default(),
            fault: BusFault::None,
            pulses_to_free: 0,
            clock_high: true,
            bit_rate: 0,
            prescaler: 0,
            control: 0,
            status: NOTHING,
            data: 0xFF,
            own_address: [0xFE, 0],
            owns_bus: false,
            action: None,
        }
    }
}

impl Twi {
    /// Resets the interface, but not the bus and the IMU.
    pub(crate) fn reset(&mut self) {
        *self = Self {
            imu: std::mem::take(&mut self.imu),
            fault: self.fault,
            pulses_to_free: self.pulses_to_free,
            ..Self::default()
        };
    }

    /// Powers the IMU at that cycle; it releases the bus.
    pub(crate) fn power_on(&mut self, at: u64) {
        self.imu.power_on(at);
        self.pulses_to_free = 0;
        self.line_changed(at);
    }

    pub(crate) fn set_fault(&mut self, now: u64, fault: BusFault) {
        self.fault = fault;
        self.pulses_to_free = 0;
        if fault == BusFault::Jammed {
            self.pulses_to_free = PULSES_TO_FREE;
        } else if fault == BusFault::Restarted {
            self.imu.restart();
            self.fault = BusFault::None;
        }
        self.line_changed(now);
    }

    /// Whether another device holds the data line low.
    pub(crate) fn data_held_low(&self) -> bool {
        self.pulses_to_free > 0 || self.fault == BusFault::ShortCircuit
    }

    /// Sets the level of the clock line from the port, while the interface is off.
    pub(crate) fn drive_clock(&mut self, now: u64, high: bool) {
        let rises = high && !self.clock_high;
        self.clock_high = high;
        if rises && self.control & TWEN == 0 {
            self.pulses_to_free = self.pulses_to_free.saturating_sub(1);
            self.line_changed(now);
        }
    }

    fn line_changed(&mut self, now: u64) {
        if !self.data_held_low()
            && let Some((action, u64::MAX)) = self.action
        {
            self.begin(now, action);
        }
    }

    fn cycles_per_bit(&self) -> u64 {
        16 + ((2 * u64::from(self.bit_rate)) << (2 * self.prescaler))
    }

    fn begin(&mut self, now: u64, action: Action) {
        let is_condition = matches!(action, Action::Start | Action::Stop);
        let bits = if is_condition { 1 } else { 9 };
        // Neither condition is possible while the data line can't rise.
        let stuck = is_condition && self.data_held_low();
        let due = now + bits * self.cycles_per_bit();
        let end = if stuck { u64::MAX } else { due };
        self.action = Some((action, end));
    }

    pub(crate) fn next(&self) -> u64 {
        self.action.map_or(u64::MAX, |(_, end)| end)
    }

    pub(crate) fn advance(&mut self, now: u64) {
        while let Some((action, end)) = self.action
            && end <= now
        {
            self.action = None;
            match action {
                Action::Start | Action::Stop if self.data_held_low() => self.begin(end, action),
                Action::Start => {
                    let again = std::mem::replace(&mut self.owns_bus, true);
                    self.finish(if again { STARTED_AGAIN } else { STARTED });
                }
                Action::Stop => {
                    self.owns_bus = false;
                    self.control &= !TWSTO;
                    self.status = NOTHING;
                    if self.control & TWSTA != 0 {
                        self.begin(end, Action::Start);
                    }
                }
                Action::Address | Action::Send if self.data_held_low() && self.data != 0 => {
                    self.owns_bus = false;
                    self.finish(ARBITRATION_LOST);
                }
                Action::Address => {
                    let to_write = self.data & 1 == 0;
                    let acknowledged = self.data_held_low()
                        || self.fault != BusFault::Absent
                            && self.data >> 1 == Bno055::ADDRESS
                            && self.imu.select(end, to_write);
                    self.finish(match (to_write, acknowledged) {
                        (true, true) => WRITE_ACKNOWLEDGED,
                        (true, false) => WRITE_REFUSED,
                        (false, true) => READ_ACKNOWLEDGED,
                        (false, false) => READ_REFUSED,
                    });
                }
                Action::Send => {
                    let present = self.fault != BusFault::Absent;
                    if present && !self.data_held_low() {
                        self.imu.write(end, self.data);
                    }
                    self.finish(if present {
                        SENT_ACKNOWLEDGED
                    } else {
                        SENT_REFUSED
                    });
                }
                Action::Receive => {
                    self.data = if self.data_held_low() {
                        0
                    } else if self.fault == BusFault::Absent {
                        0xFF
                    } else {
                        self.imu.read(end)
                    };
                    let more = self.control & TWEA != 0;
                    self.finish(if more { RECEIVED } else { RECEIVED_LAST });
                }
            }
        }
    }

    fn finish(&mut self, status: u8) {
        self.status = status;
        self.control |= TWINT;
    }

    pub(crate) fn requests(&self) -> bool {
        self.control & TWINT != 0 && self.control & TWIE != 0
    }

    pub(crate) fn set_control(&mut self, now: u64, value: u8) {
        let held = self.control & TWINT & !value;
        let kept = self.control & TWSTO;
        self.control = held | value & (TWEA | TWSTA | TWSTO | TWEN | TWIE) | kept;
        if value & TWEN == 0 {
            self.control &= !TWSTO;
            self.action = None;
            self.owns_bus = false;
            self.status = NOTHING;
            return;
        }
        if held != 0 || self.action.is_some() {
            return;
        }
        if value & TWSTO != 0 {
            self.begin(now, Action::Stop);
        } else if value & TWSTA != 0 {
            self.begin(now, Action::Start);
        } else if self.owns_bus && value & TWINT != 0 {
            match self.status {
                STARTED | STARTED_AGAIN => self.begin(now, Action::Address),
                WRITE_ACKNOWLEDGED | WRITE_REFUSED | SENT_ACKNOWLEDGED | SENT_REFUSED => {
                    self.begin(now, Action::Send);
                }
                READ_ACKNOWLEDGED | RECEIVED => self.begin(now, Action::Receive),
                _ => {}
            }
        }
    }

    pub(crate) fn status(&self) -> u8 {
        self.status | self.prescaler
    }

    /// Ignored while a byte is in progress (TWWC).
    pub(crate) fn set_data(&mut self, value: u8) {
        if self.control & TWINT != 0 {
            self.data = value;
        }
    }
}
