//! The UART, data sheet chapter 19: two bytes of buffer behind the receiver's
//! shift register, one before the transmitter's.

use std::collections::VecDeque;

const RXC: u8 = 0x80;
const TXC: u8 = 0x40;
const UDRE: u8 = 0x20;
const DOR: u8 = 0x08;
const U2X: u8 = 0x02;
const MPCM: u8 = 0x01;
const RXEN: u8 = 0x10;
const TXEN: u8 = 0x08;
const UCSZ2: u8 = 0x04;

/// Value of UCSR0C: eight data bits, no parity, one stop bit.
const FORMAT_8N1: u8 = 0x06;

#[derive(Debug)]
pub(crate) struct Uart {
    /// UCSR0A without its flags, UCSR0B, UCSR0C, UBRR0.
    control: [u8; 3],
    pub(crate) divider: [u8; 2],
    received: VecDeque<u8>,
    /// A byte waiting in the receiver's shift register, and the time at which that
    /// was last free.
    waiting: Option<u8>,
    free_since: u64,
    overrun: bool,
    sending: Option<(u64, u8)>,
    next: Option<u8>,
    sent: bool,
    pub(crate) transmitted: Vec<(u64, u8)>,
    pub(crate) bytes_overrun: u64,
}

impl Default for Uart {
    fn default() -> Self {
        Self {
            control: [0, 0, FORMAT_8N1],
            divider: [0; 2],
            received: VecDeque::new(),
            waiting: None,
            free_since: 0,
            overrun: false,
            sending: None,
            next: None,
            sent: false,
            transmitted: Vec::new(),
            bytes_overrun: 0,
        }
    }
}

impl Uart {
    pub(crate) fn reset(&mut self) {
        *self = Self {
            transmitted: std::mem::take(&mut self.transmitted),
            bytes_overrun: self.bytes_overrun,
            ..Self::default()
        };
    }

    fn cycles_per_bit(&self) -> u64 {
        let samples = if self.control[0] & U2X != 0 { 8 } else { 16 };
        samples * (u64::from(u16::from_le_bytes(self.divider)) + 1)
    }

    /// Start bit, data, parity and stop bits.
    fn bits_per_byte(&self) -> u64 {
        let [_, b, c] = self.control;
        let data = 5 + if b & UCSZ2 != 0 { 4 } else { (c >> 1) & 3 };
        u64::from(1 + data + u8::from(c & 0x20 != 0) + 1 + u8::from(c & 0x08 != 0))
    }

    pub(crate) fn flags(&self) -> u8 {
        let flag = |set, bit| if set { bit } else { 0 };
        flag(!self.received.is_empty(), RXC)
            | flag(self.sent, TXC)
            | flag(self.next.is_none(), UDRE)
            | flag(self.overrun, DOR)
    }

    /// Requests of interrupts 18 (received), 19 (buffer empty) and 20 (sent).
    pub(crate) fn requests(&self) -> [bool; 3] {
        let requested = self.flags() & self.control[1];
        [RXC, UDRE, TXC].map(|flag| requested & flag != 0)
    }

    /// Notes the service of the interrupt "sent", which clears its flag.
    pub(crate) fn served_sent(&mut self) {
        self.sent = false;
    }

    /// Time of the next event.
    pub(crate) fn next(&self) -> u64 {
        self.sending.map_or(u64::MAX, |(end, _)| end)
    }

    pub(crate) fn advance(&mut self, now: u64) {
        while let Some((end, byte)) = self.sending
            && end <= now
        {
            self.transmitted.push((end, byte));
            self.sending = None;
            match self.next.take() {
                Some(byte) => self.send(end, byte),
                None => self.sent = true,
            }
        }
    }

    fn send(&mut self, now: u64, byte: u8) {
        self.sending = Some((now + self.bits_per_byte() * self.cycles_per_bit(), byte));
    }

    /// Processes a byte whose stop bit reaches the receiver.
    pub(crate) fn receive(&mut self, now: u64, byte: u8) {
        if self.control[1] & RXEN == 0 {
            return;
        }
        // The shift register must be free at the start bit.
        let start = now.saturating_sub(self.cycles_per_bit() * 19 / 2);
        if self.waiting.is_some() || self.free_since > start {
            self.overrun = true;
            self.bytes_overrun += 1;
        } else if self.received.len() < 2 {
            self.received.push_back(byte);
        } else {
            self.waiting = Some(byte);
        }
    }

    pub(crate) fn read_data(&mut self, now: u64) -> u8 {
        let byte = self.received.pop_front().unwrap_or(0);
        self.overrun = false;
        if let Some(waiting) = self.waiting.take() {
            self.received.push_back(waiting);
            self.free_since = now;
        }
        byte
    }

    pub(crate) fn write_data(&mut self, now: u64, byte: u8) {
        if self.control[1] & TXEN == 0 {
            return;
        }
        if self.sending.is_none() {
            self.send(now, byte);
        } else if self.next.is_none() {
            self.next = Some(byte);
        }
    }

    pub(crate) fn control(&self, register: usize) -> u8 {
        let flags = if register == 0 { self.flags() } else { 0 };
        self.control[register] | flags
    }

    pub(crate) fn set_control(&mut self, register: usize, value: u8) {
        match register {
            0 => {
                self.control[0] = value & (U2X | MPCM);
                if value & TXC != 0 {
                    self.sent = false;
                }
            }
            1 => {
                self.control[1] = value & 0xFD;
                if value & RXEN == 0 {
                    self.received.clear();
                    self.waiting = None;
                    self.overrun = false;
                }
            }
            _ => self.control[2] = value,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BIT: u64 = 136;
    const BYTE: u64 = 10 * BIT;

    fn uart() -> Uart {
        let mut uart = Uart {
            divider: [16, 0],
            ..Uart::default()
        };
        uart.set_control(0, U2X);
        uart.set_control(1, RXEN | TXEN);
        uart
    }

    #[test]
    fn a_byte_needs_room_at_its_start_bit() {
        for (read_at, lost) in [(4 * BYTE - 10 * BIT, 0), (4 * BYTE - 9 * BIT, 1)] {
            let mut uart = uart();
            for n in 1..=3_u8 {
                uart.receive(u64::from(n) * BYTE, n);
            }
            assert_eq!(uart.read_data(read_at), 1);
            uart.receive(4 * BYTE, 4);
            assert_eq!(uart.bytes_overrun, lost);
            assert_eq!(uart.flags() & DOR != 0, lost > 0);
        }
    }

    #[test]
    fn a_disabled_receiver_neither_receives_nor_loses_bytes() {
        let mut uart = uart();
        uart.receive(BYTE, 1);
        uart.set_control(1, TXEN);
        uart.receive(2 * BYTE, 2);
        assert_eq!(uart.flags() & (RXC | DOR), 0);
        assert_eq!(uart.bytes_overrun, 0);
    }

    #[test]
    fn a_third_byte_for_the_transmitter_is_lost() {
        let mut uart = uart();
        for byte in 1..=3 {
            uart.write_data(100, byte);
        }
        assert_eq!(uart.flags() & UDRE, 0);
        uart.advance(100 + BYTE);
        assert_eq!(uart.flags() & (UDRE | TXC), UDRE);
        uart.advance(100 + 2 * BYTE);
        assert_eq!(uart.transmitted, [(100 + BYTE, 1), (100 + 2 * BYTE, 2)]);
        assert_eq!(uart.flags() & (UDRE | TXC), UDRE | TXC);
    }

    #[test]
    fn the_format_sets_the_length_of_a_byte() {
        let mut uart = uart();
        // Parity and two stop bits: twelve.
        uart.set_control(2, FORMAT_8N1 | 0x28);
        uart.write_data(0, 1);
        assert_eq!(uart.next(), 12 * BIT);
    }
    #[test]
    fn sent_stays_set_until_it_is_cleared_or_served() {
        let mut uart = uart();
        uart.write_data(0, 1);
        uart.advance(BYTE);
        uart.write_data(BYTE, 2);
        assert_eq!(uart.flags() & TXC, TXC);
        uart.set_control(0, U2X | TXC);
        assert_eq!(uart.flags() & TXC, 0);
        uart.advance(2 * BYTE);
        assert_eq!(uart.flags() & TXC, TXC);
        uart.served_sent();
        assert_eq!(uart.flags() & TXC, 0);
    }
}
