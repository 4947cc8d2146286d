//! Assembles the pulses on the pins to servo frames, and the log of them.

use std::collections::VecDeque;

use singletrack_simavr::{CYCLES_PER_US, Pin, Pulse};

/// Time from one servo pulse to the next, on the board's clock, in µs.
pub const SERVO_FRAME_US: u64 = 20_000;

/// A servo frame: both pulses start at the same time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PulseRecord {
    /// Simulation time at which the pulses start, in µs.
    pub time_us: u64,
    /// Board time, in µs, wrapping.
    pub board_time_us: u32,
    /// Servo pulse in µs; zero for none.
    pub servo_us: u16,
    /// ESC pulse in µs; zero for none.
    pub esc_us: u16,
    /// A reset cut the pulses, which are therefore shorter than intended.
    pub cut: bool,
}

/// A change of the pulses between the board's pins and the car, to plant a bug.
pub trait PulseFilter {
    /// Changes a servo frame of a native board before car and log get it. The image's
    /// frames are not changed.
    fn frame(&mut self, frame: &mut PulseRecord);

    /// Changes the kill output of a native board.
    fn power(&mut self, on: &mut bool) {
        let _ = on;
    }
}

/// No change.
pub(crate) struct Unfiltered;

impl PulseFilter for Unfiltered {
    fn frame(&mut self, _: &mut PulseRecord) {}
}

/// Appends an item to a queue, which loses its oldest one if it is full.
pub(crate) fn push_bounded<T>(queue: &mut VecDeque<T>, item: T, capacity: usize) {
    if queue.len() >= capacity {
        queue.pop_front();
    }
    queue.push_back(item);
}

/// The most recent servo frames.
#[derive(Clone, Debug, Default)]
pub struct PulseLog {
    records: VecDeque<PulseRecord>,
    /// Number of frames since the start, including those no longer kept.
    pub total: u64,
}

impl PulseLog {
    /// Number of frames kept: twenty minutes at 50 Hz.
    pub const CAPACITY: usize = 60_000;

    pub(crate) fn push(&mut self, record: PulseRecord) {
        push_bounded(&mut self.records, record, Self::CAPACITY);
        self.total += 1;
    }

    /// The frames, oldest first.
    pub fn iter(&self) -> impl DoubleEndedIterator<Item = &PulseRecord> {
        self.records.iter()
    }

    /// The last frame.
    pub fn last(&self) -> Option<&PulseRecord> {
        self.records.back()
    }

    /// The first frame at or after `time_us` from which on all ESC pulses are
    /// absent or within `tolerance_us` of neutral. Pulses that a reset cut below
    /// neutral are ignored.
    pub fn neutral_from(
        &self,
        time_us: u64,
        neutral_us: u16,
        tolerance_us: u16,
    ) -> Option<PulseRecord> {
        self.records
            .iter()
            .rev()
            .take_while(|record| record.time_us >= time_us)
            .filter(|record| !record.cut || record.esc_us > neutral_us)
            .take_while(|record| {
                record.esc_us == 0 || record.esc_us.abs_diff(neutral_us) <= tolerance_us
            })
            .last()
            .copied()
    }
}

/// Time after which a frame is complete: a margin over the longest pulse.
const FRAME_TIMEOUT: u64 = 2_500 * CYCLES_PER_US;

/// A servo frame; a pulse that is absent or still to come is zero.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
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
    /// Largest deviation of a frame from one period after the previous one, in
    /// cycles.
    pub(super) jitter: u64,
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
            ..Frame::default()
        };
        width(&mut frame);
        self.open = Some(frame);
        complete
    }

    /// The frame that has ended by the given cycle.
    pub(super) fn over(&mut self, cycle: u64) -> Option<Frame> {
        let is_over = self.open?.start + FRAME_TIMEOUT < cycle;
        is_over.then(|| self.finish())?
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

    #[test]
    fn neutral_counts_from_the_first_frame_of_the_last_neutral_phase() {
        let mut log = PulseLog::default();
        for (i, esc_us) in [1500, 1560, 1500, 1560, 1502, 1500, 0]
            .into_iter()
            .enumerate()
        {
            log.push(PulseRecord {
                time_us: i as u64 * 20_000,
                board_time_us: 0,
                servo_us: 0,
                esc_us,
                cut: false,
            });
        }
        let at = |time_us| {
            log.neutral_from(time_us, 1500, 5)
                .map(|record| record.time_us)
        };
        assert_eq!(at(0), Some(80_000));
        assert_eq!(at(100_000), Some(100_000));
        assert_eq!(at(120_001), None);
    }
    #[test]
    fn a_pulse_cut_by_a_reset_neither_starts_nor_ends_neutral() {
        let from = |pulses: &[(u16, bool)]| {
            let mut log = PulseLog::default();
            for (i, &(esc_us, cut)) in pulses.iter().enumerate() {
                log.push(PulseRecord {
                    time_us: i as u64,
                    board_time_us: 0,
                    servo_us: 0,
                    esc_us,
                    cut,
                });
            }
            log.neutral_from(0, 1500, 5).map(|record| record.time_us)
        };
        let driven = (1560, false);
        let silent = (0, false);
        assert_eq!(from(&[driven, (1500, false), (900, true), silent]), Some(1));
        assert_eq!(from(&[driven, (900, true), silent]), Some(2));
        assert_eq!(from(&[driven, (900, false), silent]), Some(2));
        assert_eq!(
            from(&[driven, (1500, false), (1540, true), silent]),
            Some(3)
        );
    }

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
        assert_eq!(frames.jitter, 0);
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
        assert!(frames.jitter > 0);
    }

    #[test]
    fn a_late_frame_is_jitter_and_a_restart_is_not() {
        let mut frames = Frames::default();
        let late = [
            pulse(Pin::Esc, 0, 1_500),
            pulse(Pin::Esc, PERIOD + 5, 1_500),
        ];
        widths(&mut frames, &late);
        assert_eq!(frames.jitter, 5);
        assert_eq!(frames.cut_off(), None);
        widths(&mut frames, &[pulse(Pin::Esc, 9 * PERIOD, 1_500)]);
        assert_eq!(frames.jitter, 5);
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
        assert_eq!(frames.jitter, 0);
    }
}
