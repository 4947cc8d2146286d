//! The devices modelled in Rust, by register address, and the pins.

use singletrack_simavr::{Pin, Pulse};

use crate::{
    timers::{Timer1, Watchdog},
    twi::Twi,
    uart::Uart,
};

const PINB: u16 = 0x23;
const DDRB: u16 = 0x24;
const PORTB: u16 = 0x25;
const PINC: u16 = 0x26;
const DDRC: u16 = 0x27;
const PORTC: u16 = 0x28;
const PIND: u16 = 0x29;
const DDRD: u16 = 0x2A;
const PORTD: u16 = 0x2B;
const TIFR1: u16 = 0x36;
const GPIOR0: u16 = 0x3E;
const WDTCSR: u16 = 0x60;
const TIMSK1: u16 = 0x6F;
const TCCR1A: u16 = 0x80;
const OCR1BH: u16 = 0x8B;
const TWBR: u16 = 0xB8;
const TWSR: u16 = 0xB9;
const TWAR: u16 = 0xBA;
const TWDR: u16 = 0xBB;
const TWCR: u16 = 0xBC;
const TWAMR: u16 = 0xBD;
const UCSR0A: u16 = 0xC0;
const UCSR0C: u16 = 0xC2;
const UBRR0L: u16 = 0xC4;
const UBRR0H: u16 = 0xC5;
const UDR0: u16 = 0xC6;

/// Registers that are served only here.
pub(crate) const OWNED: &[std::ops::RangeInclusive<u16>] = &[
    TIFR1..=TIFR1,
    WDTCSR..=WDTCSR,
    TIMSK1..=TIMSK1,
    TCCR1A..=OCR1BH,
    TWBR..=TWAMR,
    UCSR0A..=UDR0,
];
/// Registers of which only the reads are served here.
pub(crate) const READ: &[u16] = &[PINB, PINC, PIND];
/// Registers of simavr whose writes are observed.
pub(crate) const WATCHED: &[u16] = &[DDRB, PORTB, DDRC, PORTC, DDRD, PORTD, GPIOR0];

/// A port's direction and output registers.
#[derive(Clone, Copy, Debug, Default)]
struct Port {
    direction: u8,
    output: u8,
}

impl Port {
    /// The levels of the pins, of which `driven` are driven externally to `levels`.
    const fn pins(self, driven: u8, levels: u8) -> u8 {
        let outside = driven & levels | !driven & self.output;
        self.direction & self.output | !self.direction & outside
    }
}

#[derive(Debug, Default)]
pub(crate) struct Devices {
    pub(crate) uart: Uart,
    pub(crate) twi: Twi,
    pub(crate) watchdog: Watchdog,
    pub(crate) timer1: Timer1,
    ports: [Port; 3],
    /// Times of the rising edges of D9 and D10 while high.
    high_since: [Option<u64>; 2],
    pub(crate) pulses: Vec<Pulse>,
    /// The level of D7, and its changes.
    kill_output: bool,
    pub(crate) kill_changes: Vec<(u64, bool)>,
    pub(crate) motor_level: bool,
    pub(crate) stop_input_open: bool,
    /// Last unprocessed write to GPIOR0.
    pub(crate) mark: Option<u8>,
    /// Last fatal message of simavr.
    pub(crate) fatal: Option<String>,
    warnings: Vec<String>,
    /// Interrupt requests and the next event may have changed.
    pub(crate) changed: bool,
    pub(crate) watchdog_reset: Option<u64>,
    /// Time of the next event of a device.
    pub(crate) next: u64,
}

impl Devices {
    pub(crate) fn new() -> Self {
        Self {
            changed: true,
            next: u64::MAX,
            ..Self::default()
        }
    }

    /// Applies a reset of the processor; the pins float.
    pub(crate) fn reset(&mut self, now: u64) {
        self.ports = [Port::default(); 3];
        self.timer1 = Timer1::default();
        self.update_pins(now);
        self.update_kill_output(now);
        self.uart.reset();
        self.twi.reset();
        self.watchdog = Watchdog::default();
        self.mark = None;
        self.fatal = None;
        self.watchdog_reset = None;
        self.changed = true;
    }

    /// Processes all events up to now.
    pub(crate) fn advance(&mut self, now: u64) {
        self.changed = true;
        self.uart.advance(now);
        self.twi.advance(now);
        self.advance_timer1(now);
        self.watchdog_reset = self.watchdog.advance(now).or(self.watchdog_reset);
        let bytes = self.uart.next().min(self.twi.next());
        self.next = bytes.min(self.timer1.next()).min(self.watchdog.next());
    }

    fn advance_timer1(&mut self, now: u64) {
        while self.timer1.next() <= now {
            let at = self.timer1.next();
            self.timer1.advance();
            self.update_pins(at);
        }
    }

    /// The interrupt vectors of these devices, and whether each is requested.
    pub(crate) fn requests(&self) -> [(u8, bool); 9] {
        let [capture, match_a, match_b, overflow] = self.timer1.requests();
        let [received, empty, sent] = self.uart.requests();
        [
            (6, self.watchdog.requests()),
            (10, capture),
            (11, match_a),
            (12, match_b),
            (13, overflow),
            (18, received),
            (19, empty),
            (20, sent),
            (24, self.twi.requests()),
        ]
    }

    /// The processor serves a vector.
    pub(crate) fn served(&mut self, vector: u8) {
        match vector {
            6 => self.watchdog.served(),
            10..=13 => self.timer1.served(vector),
            20 => self.uart.served_sent(),
            18 | 19 | 24 => {}
            _ => return,
        }
        self.changed = true;
    }

    /// Processes a message of simavr's logger.
    pub(crate) fn log(&mut self, fatal: bool, text: &str) {
        let text = text.trim();
        // Caused by a write to a compare register before its timer runs.
        if text.ends_with("mode 0 UNSUPPORTED") {
            return;
        }
        if fatal {
            self.changed = true;
            self.fatal.get_or_insert_with(|| text.to_owned());
        } else if self.warnings.len() < 20 && !self.warnings.iter().any(|old| old == text) {
            eprintln!("simavr: {text}");
            self.warnings.push(text.to_owned());
        }
    }

    fn update_pins(&mut self, now: u64) {
        let Port { direction, output } = self.ports[0];
        for (channel, bit, pin) in [(0, 0x02, Pin::Servo), (1, 0x04, Pin::Esc)] {
            // The resistor at the ESC pulls a floating pin low.
            let driven = self.timer1.output(channel);
            let high = direction & bit != 0 && driven.unwrap_or(output & bit != 0);
            let since = &mut self.high_since[channel];
            if high {
                since.get_or_insert(now);
            } else if let Some(start) = since.take()
                && now > start
            {
                let width = now - start;
                self.pulses.push(Pulse { pin, start, width });
            }
        }
    }

    fn update_kill_output(&mut self, now: u64) {
        const KILL: u8 = 1 << 7;
        let [.., Port { direction, output }] = self.ports;
        // A pull-down holds a floating pin.
        let high = direction & output & KILL != 0;
        if self.kill_output != high {
            self.kill_output = high;
            self.kill_changes.push((now, high));
        }
    }

    /// Whether the pull-up of A0 is on.
    pub(crate) const fn battery_pull_up(&self) -> bool {
        let [_, Port { direction, output }, _] = self.ports;
        output & !direction & 1 != 0
    }

    fn update_bus_pins(&mut self, now: u64) {
        let Port { direction, output } = self.ports[1];
        let pulled_low = direction & !output & 1 << 5 != 0;
        self.twi.drive_clock(now, !pulled_low);
    }

    fn pins(&self, port: u16) -> u8 {
        match port {
            PINB => {
                let [port, ..] = self.ports;
                let mut pins = port.pins(0, 0);
                for (channel, bit) in [(0, 1), (1, 2)] {
                    if self.high_since[channel].is_some() {
                        pins |= 1 << bit;
                    } else if port.direction & 1 << bit != 0 {
                        pins &= !(1 << bit);
                    }
                }
                pins
            }
            PINC => {
                let [_, port, _] = self.ports;
                // Both lines of the bus have external pull-ups.
                let held = if self.twi.data_held_low() { 0x10 } else { 0 };
                port.pins(0x30, 0x30) & !held
            }
            PIND => {
                let [.., port] = self.ports;
                // The line from the host idles high. With an open stop switch, the
                // pin follows its pull-up, if enabled.
                let switch = if self.stop_input_open { 0 } else { 0x10 };
                let motor = if self.motor_level { 0x04 } else { 0 };
                port.pins(0x05 | switch, 0x01 | motor)
            }
            _ => 0,
        }
    }

    pub(crate) fn read(&mut self, now: u64, address: u16) -> u8 {
        match address {
            PINB | PINC | PIND => self.pins(address),
            TIFR1 => self.timer1.flags,
            TIMSK1 => self.timer1.mask,
            TCCR1A..=OCR1BH => self.timer1.read(now, address - TCCR1A),
            WDTCSR => self.watchdog.read(now),
            TWBR => self.twi.bit_rate,
            TWSR => self.twi.status(),
            TWAR => self.twi.own_address[0],
            TWDR => self.twi.data,
            TWCR => self.twi.control,
            TWAMR => self.twi.own_address[1],
            UCSR0A..=UCSR0C => self.uart.control(usize::from(address - UCSR0A)),
            UBRR0L => self.uart.divider[0],
            UBRR0H => self.uart.divider[1],
            UDR0 => {
                self.changed = true;
                self.uart.read_data(now)
            }
            _ => 0,
        }
    }

    pub(crate) fn write(&mut self, now: u64, address: u16, value: u8) {
        // The write takes effect at the end of the instruction, a cycle later.
        let now = now + 1;
        // Events of the timer in that cycle precede the write.
        self.advance_timer1(now);
        match address {
            PORTB => self.ports[0].output = value,
            DDRB => self.ports[0].direction = value,
            PORTC => self.ports[1].output = value,
            DDRC => self.ports[1].direction = value,
            PORTD => self.ports[2].output = value,
            DDRD => self.ports[2].direction = value,
            GPIOR0 => {
                self.mark = Some(value);
                self.changed = true;
                return;
            }
            TIFR1 => self.timer1.flags &= !value,
            TIMSK1 => self.timer1.mask = value,
            TCCR1A..=OCR1BH => self.timer1.write(now, address - TCCR1A, value),
            WDTCSR => self.watchdog.write(now, value),
            TWBR => self.twi.bit_rate = value,
            TWSR => self.twi.prescaler = value & 3,
            TWAR => self.twi.own_address[0] = value,
            TWDR => self.twi.set_data(value),
            TWCR => self.twi.set_control(now, value),
            TWAMR => self.twi.own_address[1] = value,
            UCSR0A..=UCSR0C => self.uart.set_control(usize::from(address - UCSR0A), value),
            UBRR0L => self.uart.divider[0] = value,
            UBRR0H => self.uart.divider[1] = value & 0x0F,
            UDR0 => self.uart.write_data(now, value),
            _ => return,
        }
        match address {
            PORTB | DDRB | TCCR1A => self.update_pins(now),
            PORTC | DDRC => self.update_bus_pins(now),
            PORTD | DDRD => self.update_kill_output(now),
            _ => {}
        }
        if matches!(address, TCCR1A | 0x81) && self.timer1.counts_down() {
            self.log(false, "timer 1: modes that count down are not modelled");
        }
        self.changed = true;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TCCR1B: u16 = TCCR1A + 1;
    const ICR1H: u16 = TCCR1A + 7;
    const OCR1AH: u16 = TCCR1A + 9;

    /// Pulses of four counts of eight cycles each on D9, from cycle 1 on.
    fn pulsing() -> Devices {
        let mut devices = Devices::new();
        for (address, value) in [
            (DDRB, 2),
            (TCCR1A, 0x02),
            (TCCR1B, 0x18),
            (ICR1H, 0),
            (ICR1H - 1, 9),
            (OCR1AH, 0),
            (OCR1AH - 1, 3),
            (TCCR1A, 0x82),
            (TCCR1B, 0x1A),
        ] {
            devices.write(0, address, value);
        }
        devices
    }

    #[test]
    fn a_write_in_the_cycle_of_a_match_does_not_suppress_it() {
        let (rises, falls) = (1 + 80, 1 + 80 + 32);
        for at in falls - 2..=falls + 2 {
            let mut devices = pulsing();
            devices.advance(rises);
            // A write takes effect one cycle after its start.
            devices.write(at - 1, TCCR1A, 0x82);
            devices.advance(200);
            let [pulse, ..] = devices.pulses[..] else {
                panic!("no pulse after a write in cycle {at}");
            };
            assert_eq!((pulse.start, pulse.width), (rises, 32), "{at}");
        }
    }
}
