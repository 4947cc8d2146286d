//! Pulses on the pins, put together to servo frames.

use singletrack_simavr::{CYCLES_PER_US, Pin, Pulse};

use super::SERVO_FRAME_US;

/// The longest pulse of a servo, and a little more: after that both are known.
const FRAME_ENDS: u64 = 2_500 * CYCLES_PER_US;

/// A servo frame whose pulses are still to come, or have come; zero is none.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Frame {
    /// The first rising edge, in cycles.
    pub(super) start: u64,
    pub(super) servo_us: u16,
    pub(super) esc_us: u16,
    /// A reset ended one of them.
    pub(super) cut: bool,
}

/// The frame that is going on, and how regularly they come.
#[derive(Debug, Default)]
pub(super) struct Frames {
    open: Option<Frame>,
    /// The start of the frame before.
    last: Option<u64>,
    jitter: u64,
}

impl Frames {
    /// Takes a pulse; returns the frame that is complete with it.
    ///
    /// A second pulse on a pin belongs to a frame of its own: it hides none.
    pub(super) fn take(&mut self, pulse: &Pulse, cut: bool) -> Option<Frame> {
        let width = |frame: &mut Frame| {
            frame.cut |= cut;
            match pulse.pin {
                Pin::Servo => core::mem::replace(&mut frame.servo_us, width_us(pulse)),
                Pin::Esc => core::mem::replace(&mut frame.esc_us, width_us(pulse)),
            }
        };
        if let Some(frame) = &mut self.open
            && pulse.start <= frame.start + FRAME_ENDS
        {
            let complete = *frame;
            if width(frame) == 0 {
                return None;
            }
            self.open = Some(complete);
        }
        let complete = self.finish();
        let mut frame = Frame {
            start: pulse.start,
            servo_us: 0,
            esc_us: 0,
            cut: false,
        };
        width(&mut frame);
        self.open = Some(frame);
        complete
    }

    /// The frame that has ended by a cycle.
    pub(super) fn over(&mut self, cycle: u64) -> Option<Frame> {
        self.open
            .is_some_and(|frame| cycle > frame.start + FRAME_ENDS)
            .then(|| self.finish())
            .flatten()
    }

    /// The largest deviation so far of a frame from its place, a period after
    /// the one before, in cycles.
    pub(super) const fn jitter(&self) -> u64 {
        self.jitter
    }

    /// The processor is held: what is open ends here, and the grid begins anew.
    pub(super) fn cut_off(&mut self) -> Option<Frame> {
        let frame = self.finish();
        self.last = None;
        frame
    }

    fn finish(&mut self) -> Option<Frame> {
        let frame = self.open.take()?;
        if let Some(last) = self.last.replace(frame.start) {
            let period = frame.start.saturating_sub(last);
            let deviation = period.abs_diff(SERVO_FRAME_US * CYCLES_PER_US);
            self.jitter = self.jitter.max(deviation);
        }
        Some(frame)
    }
}

/// To the nearest µs, but never zero: that is no pulse.
pub(super) fn width_us(pulse: &Pulse) -> u16 {
    u16::try_from((pulse.width + CYCLES_PER_US / 2) / CYCLES_PER_US)
        .unwrap_or(u16::MAX)
        .max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: u64 = SERVO_FRAME_US * CYCLES_PER_US;

    fn pulse(pin: Pin, start: u64, us: u64) -> Pulse {
        Pulse {
            pin,
            start,
            width: us * CYCLES_PER_US,
        }
    }

    fn widths(frames: &mut Frames, pulses: &[Pulse]) -> Vec<(u16, u16)> {
        let mut complete: Vec<Frame> = pulses
            .iter()
            .filter_map(|pulse| frames.take(pulse, false))
            .collect();
        complete.extend(frames.over(u64::MAX));
        complete
            .iter()
            .map(|frame| (frame.servo_us, frame.esc_us))
            .collect()
    }

    #[test]
    fn both_pins_of_a_period_are_one_frame() {
        let mut frames = Frames::default();
        let pulses = [
            pulse(Pin::Servo, 100, 1_400),
            pulse(Pin::Esc, 100, 1_500),
            pulse(Pin::Esc, 100 + PERIOD, 1_500),
            pulse(Pin::Servo, 100 + PERIOD, 1_600),
        ];
        assert_eq!(
            widths(&mut frames, &pulses),
            [(1_400, 1_500), (1_600, 1_500)]
        );
        assert_eq!(frames.jitter(), 0);
    }

    #[test]
    fn a_pulse_too_many_is_not_hidden_by_the_one_after_it() {
        let mut frames = Frames::default();
        let pulses = [
            pulse(Pin::Esc, 100, 1_500),
            // Cut in two.
            pulse(Pin::Esc, 100 + PERIOD, 300),
            pulse(Pin::Esc, 100 + PERIOD + 400 * CYCLES_PER_US, 1_100),
            // Shorter than anything that rounds to a microsecond.
            Pulse {
                width: 3,
                ..pulse(Pin::Esc, 100 + 2 * PERIOD, 0)
            },
        ];
        assert_eq!(
            widths(&mut frames, &pulses),
            [(0, 1_500), (0, 300), (0, 1_100), (0, 1)]
        );
        assert!(frames.jitter() > 0);
    }

    #[test]
    fn a_late_frame_is_jitter_and_a_restart_is_not() {
        let mut frames = Frames::default();
        let late = [
            pulse(Pin::Esc, 0, 1_500),
            pulse(Pin::Esc, PERIOD + 5, 1_500),
        ];
        widths(&mut frames, &late);
        assert_eq!(frames.jitter(), 5);
        assert_eq!(frames.cut_off(), None);
        widths(&mut frames, &[pulse(Pin::Esc, 9 * PERIOD, 1_500)]);
        assert_eq!(frames.jitter(), 5);
    }
    #[test]
    fn a_frame_that_a_reset_cuts_is_whole_as_it_was_and_no_jitter() {
        let mut frames = Frames::default();
        widths(&mut frames, &[pulse(Pin::Esc, 0, 1_500)]);
        let servo = pulse(Pin::Servo, PERIOD, 1_400);
        let esc = pulse(Pin::Esc, PERIOD, 1_450);
        assert_eq!(frames.take(&servo, false), None);
        assert_eq!(frames.take(&esc, true), None);
        let cut = Frame {
            start: PERIOD,
            servo_us: 1_400,
            esc_us: 1_450,
            cut: true,
        };
        assert_eq!(frames.cut_off(), Some(cut));
        // The next grid is another.
        widths(&mut frames, &[pulse(Pin::Esc, 9 * PERIOD + 77, 1_500)]);
        assert_eq!(frames.jitter(), 0);
    }
}
