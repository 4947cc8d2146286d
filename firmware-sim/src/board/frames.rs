//! Assembles the pulses on the pins to servo frames.

use singletrack_simavr::{CYCLES_PER_US, Pin, Pulse};

use super::SERVO_FRAME_US;

/// Time after which a frame is complete: a margin over the longest pulse.
const FRAME_TIMEOUT: u64 = 2_500 * CYCLES_PER_US;

/// A servo frame; a pulse that is absent or still to come is zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Frame {
    /// The first rising edge, in cycles.
    pub(super) start: u64,
    pub(super) servo_us: u16,
    pub(super) esc_us: u16,
    /// A reset cut one of the pulses.
    pub(super) cut: bool,
}

/// The frame in progress, and the regularity of the frames.
#[derive(Debug, Default)]
pub(super) struct Frames {
    open: Option<Frame>,
    /// Start of the previous frame.
    last: Option<u64>,
    jitter: u64,
}

impl Frames {
    /// Adds a pulse; returns the frame that it completes.
    ///
    /// A second pulse on a pin starts a frame of its own, so that none is hidden.
    pub(super) fn take(&mut self, pulse: &Pulse, cut: bool) -> Option<Frame> {
        let width = |frame: &mut Frame| {
            frame.cut |= cut;
            match pulse.pin {
                Pin::Servo => core::mem::replace(&mut frame.servo_us, width_us(pulse)),
                Pin::Esc => core::mem::replace(&mut frame.esc_us, width_us(pulse)),
            }
        };
        if let Some(frame) = &mut self.open
            && pulse.start <= frame.start + FRAME_TIMEOUT
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

    /// The frame that has ended by the given cycle.
    pub(super) fn over(&mut self, cycle: u64) -> Option<Frame> {
        self.open
            .is_some_and(|frame| cycle > frame.start + FRAME_TIMEOUT)
            .then(|| self.finish())
            .flatten()
    }

    /// Largest deviation of a frame from one period after the previous one, in
    /// cycles.
    pub(super) const fn jitter(&self) -> u64 {
        self.jitter
    }

    /// The processor is held in reset: the frame in progress ends, and the grid
    /// restarts.
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

/// Rounded to the nearest µs, at least 1: zero means no pulse.
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
    fn a_surplus_pulse_is_not_hidden_by_the_next_one() {
        let mut frames = Frames::default();
        let pulses = [
            pulse(Pin::Esc, 100, 1_500),
            // One pulse split in two.
            pulse(Pin::Esc, 100 + PERIOD, 300),
            pulse(Pin::Esc, 100 + PERIOD + 400 * CYCLES_PER_US, 1_100),
            // Rounds to zero microseconds.
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
    fn a_frame_cut_by_a_reset_is_kept_and_adds_no_jitter() {
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
        // The next grid is independent.
        widths(&mut frames, &[pulse(Pin::Esc, 9 * PERIOD + 77, 1_500)]);
        assert_eq!(frames.jitter(), 0);
    }
}
