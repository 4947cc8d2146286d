//! Timer 1, data sheet chapter 15, in its modes that count up: normal, CTC and fast PWM; and the
//! watchdog, chapter 10.8, a counter at 128 kHz.

/// A channel, A or B.
#[derive(Clone, Copy, Debug, Default)]
struct Channel {
    /// The compare value in use, and the one from BOTTOM on.
    compare: u16,
    buffer: u16,
    /// Time at which the next match takes effect.
    next_match: Option<u64>,
    output: bool,
}

#[derive(Debug, Default)]
pub(crate) struct Timer1 {
    control: [u8; 3],
    pub(crate) mask: u8,
    pub(crate) flags: u8,
    temp: u8,
    capture: u16,
    channels: [Channel; 2],
    /// The count while the clock is off; else the cycle of count zero, which may lie
    /// before the process started.
    count: u16,
    zero: i64,
    next_top: Option<u64>,
}

const TOV: u8 = 0x01;
const ICF: u8 = 0x20;
/// The vectors of capture, matches and overflow, with their flags.
const INTERRUPTS: [(u8, u8); 4] = [(10, ICF), (11, 2), (12, 4), (13, TOV)];
const PRESCALERS: [Option<i64>; 8] = [
    None,
    Some(1),
    Some(8),
    Some(64),
    Some(256),
    Some(1_024),
    // External clocks, which are not connected.
    None,
    None,
];

impl Timer1 {
    fn mode(&self) -> u8 {
        self.control[0] & 3 | (self.control[1] >> 1) & 0x0C
    }

    /// Whether it runs in a mode that also counts down, which is not modelled.
    pub(crate) fn counts_down(&self) -> bool {
        self.prescaler().is_some() && matches!(self.mode(), 1..=3 | 8..=11)
    }

    fn is_fast_pwm(&self) -> bool {
        matches!(self.mode(), 5..=7 | 14 | 15)
    }

    fn prescaler(&self) -> Option<i64> {
        PRESCALERS[usize::from(self.control[1] & 7)]
    }

    fn top(&self) -> u16 {
        match self.mode() {
            4 | 15 => self.channels[0].compare,
            5 => 0xFF,
            6 => 0x1FF,
            7 => 0x3FF,
            12 | 14 => self.capture,
            _ => 0xFFFF,
        }
    }

    fn output_mode(&self, channel: usize) -> u8 {
        let shift = if channel == 0 { 6 } else { 4 };
        let mode = (self.control[0] >> shift) & 3;
        // In fast PWM, only channel A can toggle, in modes 14 and 15.
        let can_toggle = !self.is_fast_pwm() || channel == 0 && self.mode() >= 14;
        if mode == 1 && !can_toggle { 0 } else { mode }
    }

    /// Level of a channel's pin, if the timer controls it.
    pub(crate) fn output(&self, channel: usize) -> Option<bool> {
        let driven = self.output_mode(channel) != 0;
        driven.then(|| self.channels[channel].output)
    }

    fn count(&self, now: u64) -> u16 {
        match self.prescaler() {
            Some(prescaler) => ((now as i64 - self.zero) / prescaler) as u16,
            None => self.count,
        }
    }

    /// Computes the times of the next events, all after `now`.
    fn schedule(&mut self, now: u64) {
        let Some(prescaler) = self.prescaler() else {
            self.next_top = None;
            for channel in &mut self.channels {
                channel.next_match = None;
            }
            return;
        };
        let zero = self.zero;
        let end_of = |count: u16| (zero + (i64::from(count) + 1) * prescaler) as u64;
        let top = self.top();
        // Beyond the top it counts to the end of the range.
        let top = if end_of(top) > now { top } else { 0xFFFF };
        let next_top = end_of(top);
        self.next_top = Some(next_top);
        for channel in &mut self.channels {
            let at = end_of(channel.compare);
            channel.next_match = (at > now && at <= next_top).then_some(at);
        }
    }

    pub(crate) fn next(&self) -> u64 {
        let [a, b] = &self.channels;
        let next = [self.next_top, a.next_match, b.next_match];
        next.into_iter().flatten().min().unwrap_or(u64::MAX)
    }

    /// Processes the next event.
    pub(crate) fn advance(&mut self) {
        let at = self.next();
        for index in 0..2 {
            let mode = self.output_mode(index);
            let channel = &mut self.channels[index];
            if channel.next_match.take_if(|next| *next == at).is_some() {
                self.flags |= 2 << index;
                channel.output = match mode {
                    1 => !channel.output,
                    2 => false,
                    3 => true,
                    _ => channel.output,
                };
            }
        }
        if self.next_top != Some(at) {
            return;
        }
        self.zero = at as i64;
        // In CTC the overflow is at the end of the range, which is not reached.
        if !matches!(self.mode(), 4 | 12) {
            self.flags |= TOV;
        }
        if matches!(self.mode(), 12 | 14) {
            self.flags |= ICF;
        }
        if self.is_fast_pwm() {
            for index in 0..2 {
                let mode = self.output_mode(index);
                let channel = &mut self.channels[index];
                channel.compare = channel.buffer;
                if matches!(mode, 2 | 3) {
                    channel.output = mode == 2;
                }
            }
        }
        self.schedule(at);
    }

    /// Requests of interrupts 10 (capture), 11, 12 (matches) and 13 (overflow).
    pub(crate) fn requests(&self) -> [bool; 4] {
        INTERRUPTS.map(|(_, flag)| self.flags & self.mask & flag != 0)
    }

    /// Notes the service of an interrupt, which clears its flag.
    pub(crate) fn served(&mut self, vector: u8) {
        for (_, flag) in INTERRUPTS.iter().filter(|(other, _)| *other == vector) {
            self.flags &= !flag;
        }
    }

    /// Reads a register by its offset from TCCR1A.
    pub(crate) fn read(&mut self, now: u64, register: u16) -> u8 {
        let count = self.count(now);
        match register {
            0..=2 => self.control[usize::from(register)],
            4 => self.latch(count),
            6 => self.latch(self.capture),
            5 | 7 => self.temp,
            // Without TEMP.
            8..=11 => {
                let channel = &self.channels[usize::from((register - 8) / 2)];
                channel.buffer.to_le_bytes()[usize::from(register % 2)]
            }
            _ => 0,
        }
    }

    fn latch(&mut self, value: u16) -> u8 {
        let [low, high] = value.to_le_bytes();
        self.temp = high;
        low
    }

    pub(crate) fn write(&mut self, now: u64, register: u16, value: u8) {
        let whole = u16::from_le_bytes([value, self.temp]);
        match register {
            0 | 1 => {
                let count = self.count(now);
                let old = self.prescaler();
                let phase = old.map_or(0, |old| (now as i64 - self.zero) % old);
                self.control[usize::from(register)] = value;
                self.count = count;
                match self.prescaler() {
                    Some(prescaler) if old != Some(prescaler) => self.set_count(now, count),
                    Some(prescaler) => {
                        self.zero = now as i64 - phase - i64::from(count) * prescaler;
                    }
                    None => {}
                }
                if !self.is_fast_pwm() {
                    for channel in &mut self.channels {
                        channel.compare = channel.buffer;
                    }
                }
            }
            5 | 7 | 9 | 11 => {
                self.temp = value;
                return;
            }
            4 => self.set_count(now, whole),
            // Section "Input Capture Unit": writable only in modes with ICR1 as top.
            6 if matches!(self.mode(), 8 | 10 | 12 | 14) => self.capture = whole,
            8 | 10 => {
                let buffered = self.is_fast_pwm();
                let channel = &mut self.channels[usize::from((register - 8) / 2)];
                channel.buffer = whole;
                if buffered {
                    return;
                }
                channel.compare = whole;
            }
            _ => return,
        }
        self.schedule(now);
    }

    fn set_count(&mut self, now: u64, count: u16) {
        self.count = count;
        if let Some(prescaler) = self.prescaler() {
            self.zero = now as i64 - i64::from(count) * prescaler;
        }
    }
}

const WDIF: u8 = 0x80;
const WDIE: u8 = 0x40;
const WDP3: u8 = 0x20;
const WDCE: u8 = 0x10;
const WDE: u8 = 0x08;

/// Cycles of 16 MHz per count of 128 kHz.
const CYCLES_PER_COUNT: u64 = 125;
/// Number of cycles in which a change is allowed.
const CHANGE: u64 = 4;

#[derive(Debug, Default)]
pub(crate) struct Watchdog {
    control: u8,
    counts_since: u64,
    /// End of the time in which prescaler and enable may be written.
    open_until: Option<u64>,
}

impl Watchdog {
    pub(crate) fn read(&self, now: u64) -> u8 {
        let open = self.open_until.is_some_and(|until| now <= until);
        self.control | if open { WDCE } else { 0 }
    }

    pub(crate) fn write(&mut self, now: u64, value: u8) {
        let ran = self.runs();
        let open = self.open_until.take().is_some_and(|until| now <= until);
        let flag = self.control & WDIF & !value;
        if value & WDCE != 0 && value & WDE != 0 {
            self.open_until = Some(now + CHANGE);
        }
        let kept = self.control | value & WDE;
        let chosen = if open { value } else { kept };
        let settings = chosen & (WDE | WDP3 | 7);
        self.control = flag | value & WDIE | settings;
        if !ran {
            self.counts_since = now;
        }
    }

    /// The instruction WDR.
    pub(crate) fn restart(&mut self, now: u64) {
        self.counts_since = now;
    }

    fn runs(&self) -> bool {
        self.control & (WDE | WDIE) != 0
    }

    pub(crate) fn next(&self) -> u64 {
        if !self.runs() {
            return u64::MAX;
        }
        let prescaler = (self.control & 7) | (self.control & WDP3) >> 2;
        self.counts_since + ((2_048 * CYCLES_PER_COUNT) << prescaler.min(9))
    }

    /// Time of a reset, if it occurs by now.
    pub(crate) fn advance(&mut self, now: u64) -> Option<u64> {
        let due = self.next();
        if due > now {
            return None;
        }
        // An interrupt that is not served by the next timeout does not prevent the reset.
        let unserved = self.control & WDIF != 0 && self.control & WDE != 0;
        if self.control & WDIE != 0 && !unserved {
            self.control |= WDIF;
            self.counts_since = due;
            return None;
        }
        Some(due)
    }

    pub(crate) fn requests(&self) -> bool {
        self.control & WDIF != 0 && self.control & WDIE != 0
    }

    /// Notes the service of its interrupt; the next timeout resets.
    pub(crate) fn served(&mut self) {
        self.control &= !WDIF;
        if self.control & WDE != 0 {
            self.control &= !WDIE;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TCCR1A: u16 = 0;
    const TCCR1B: u16 = 1;
    const TCNT1: u16 = 4;
    const ICR1: u16 = 6;
    const OCR1A: u16 = 8;
    const OCR1B: u16 = 10;

    fn write16(timer: &mut Timer1, now: u64, low: u16, value: u16) {
        let [low_byte, high_byte] = value.to_le_bytes();
        timer.write(now, low + 1, high_byte);
        timer.write(now, low, low_byte);
    }

    /// Fast PWM up to ICR1 = 9 with a compare value of 3, prescaler 8, from cycle 0.
    fn pwm() -> Timer1 {
        let mut timer = Timer1::default();
        write16(&mut timer, 0, OCR1A, 3);
        timer.write(0, TCCR1A, 0x82);
        timer.write(0, TCCR1B, 0x18);
        write16(&mut timer, 0, ICR1, 9);
        timer.write(0, TCCR1B, 0x1A);
        timer
    }

    /// Times at which the output of channel A changes, up to cycle `until`.
    fn changes(timer: &mut Timer1, until: u64) -> Vec<u64> {
        let mut changes = Vec::new();
        let mut level = timer.output(0);
        while timer.next() <= until {
            let at = timer.next();
            timer.advance();
            if timer.output(0) != level {
                level = timer.output(0);
                changes.push(at);
            }
        }
        changes
    }

    #[test]
    fn a_pulse_lasts_one_count_more_than_the_compare_value() {
        let mut timer = pwm();
        assert_eq!(changes(&mut timer, 250), [80, 112, 160, 192, 240]);
    }

    #[test]
    fn a_compare_value_at_the_top_is_a_constant_level_and_zero_one_count() {
        let mut timer = pwm();
        write16(&mut timer, 1, OCR1A, 9);
        assert_eq!(changes(&mut timer, 300), [80]);
        write16(&mut timer, 300, OCR1A, 0);
        assert_eq!(changes(&mut timer, 420), [328, 400, 408]);
    }

    #[test]
    fn writing_half_a_register_has_no_effect() {
        let mut timer = pwm();
        timer.write(1, OCR1A + 1, 2);
        assert_eq!(changes(&mut timer, 120), [80, 112]);
        timer.write(120, OCR1A, 5);
        // 0x205 is above the top: never cleared.
        assert_eq!(changes(&mut timer, 400), [160]);
    }

    #[test]
    fn the_count_is_read_as_a_whole() {
        let mut timer = Timer1::default();
        timer.write(0, TCCR1B, 1);
        assert_eq!(timer.read(0x12FF, TCNT1), 0xFF);
        assert_eq!(timer.read(0x1301, TCNT1 + 1), 0x12);
        write16(&mut timer, 0x1400, TCNT1, 0xFFFE);
        assert_eq!(timer.next(), 0x1402);
        timer.advance();
        assert_eq!(timer.flags, TOV);
        timer.flags &= !TOV;
        assert_eq!(timer.flags, 0);
    }

    #[test]
    fn clear_on_match_repeats_every_compare_value_plus_one() {
        let mut timer = Timer1::default();
        write16(&mut timer, 0, OCR1A, 249);
        // Never reached.
        write16(&mut timer, 0, OCR1B, 250);
        timer.write(0, TCCR1B, 0x0B);
        timer.mask = 2;
        for period in 1..5 {
            assert_eq!(timer.next(), period * 16_000);
            timer.advance();
            assert!(timer.requests()[1]);
            timer.served(11);
            assert_eq!(timer.requests(), [false; 4]);
        }
    }
    #[test]
    fn the_top_is_writable_only_in_modes_that_use_it() {
        let mut timer = Timer1::default();
        write16(&mut timer, 0, ICR1, 9);
        assert_eq!(timer.read(0, ICR1), 0);
        timer.write(0, TCCR1A, 0x02);
        timer.write(0, TCCR1B, 0x18);
        write16(&mut timer, 0, ICR1, 9);
        assert_eq!(timer.read(0, ICR1), 9);
    }

    const MS: u64 = 16_000;

    /// Enabled for 64 ms, as the data sheet has it.
    fn enabled() -> Watchdog {
        let mut watchdog = Watchdog::default();
        watchdog.write(10, WDCE | WDE);
        watchdog.write(12, WDE | 2);
        watchdog
    }

    #[test]
    fn it_counts_from_the_last_restart() {
        let mut watchdog = enabled();
        assert_eq!(watchdog.next(), 10 + 64 * MS);
        watchdog.restart(50 * MS);
        assert_eq!(watchdog.next(), 114 * MS);
        assert_eq!(watchdog.advance(114 * MS - 1), None);
        assert_eq!(watchdog.advance(114 * MS + 2), Some(114 * MS));
    }

    #[test]
    fn it_changes_only_within_four_cycles_of_the_key() {
        let mut watchdog = enabled();
        watchdog.write(100, WDCE | WDE);
        watchdog.write(105, 0);
        assert_eq!(watchdog.next(), 10 + 64 * MS);
        watchdog.write(200, 0);
        assert_eq!(watchdog.next(), 10 + 64 * MS);
        watchdog.write(300, WDCE | WDE);
        watchdog.write(304, 0);
        assert_eq!(watchdog.next(), u64::MAX);
    }

    #[test]
    fn with_its_interrupt_enabled_it_interrupts_before_it_resets() {
        let mut watchdog = enabled();
        watchdog.write(100, WDIE);
        let due = watchdog.next();
        assert_eq!(watchdog.advance(due), None);
        assert!(watchdog.requests());
        watchdog.served();
        assert!(!watchdog.requests());
        assert_eq!(watchdog.advance(due + 64 * MS), Some(due + 64 * MS));
    }
    #[test]
    fn an_unserved_interrupt_is_followed_by_a_reset() {
        let mut watchdog = enabled();
        watchdog.write(100, WDIE);
        let due = watchdog.next();
        assert_eq!(watchdog.advance(due), None);
        assert_eq!(watchdog.advance(due + 64 * MS), Some(due + 64 * MS));
    }
}
