//! Measures resource usage, step by step.

use std::collections::BTreeMap;

use singletrack_simavr::{CYCLES_PER_US, Cost, Figures};

/// Critical sections within this time after the start do not count.
const SETTLING: u64 = 5_000 * CYCLES_PER_US;

/// Contents of SRAM that has not been written since power-on.
pub(crate) const PATTERN: u8 = 0xC5;
/// Number of consecutive pattern bytes that counts as unwritten.
const UNTOUCHED: usize = 16;

/// Costs by the number of what ran.
#[derive(Debug, Default)]
struct Costs(BTreeMap<u8, Cost>);

impl Costs {
    fn add(&mut self, number: u8, cycles: u64) {
        let cost = self.0.entry(number).or_default();
        cost.number = number;
        cost.count += 1;
        cost.most_cycles = cost.most_cycles.max(narrow(cycles));
        cost.all_cycles += cycles;
    }

    fn list(&self) -> Vec<Cost> {
        self.0.values().cloned().collect()
    }
}

#[derive(Debug, Default)]
pub(crate) struct Meter {
    cycles: u64,
    cycles_asleep: u64,
    started: u64,
    /// Cycles of the main program while awake.
    main: u64,
    /// Interrupts in service with their start times.
    serving: Vec<(u8, u64)>,
    interrupts: Costs,
    disabled_since: Option<u64>,
    longest_critical_section: u64,
    open: Option<(u8, u64)>,
    sections: Costs,
}

/// A step, in terms of the counters.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Span {
    pub(crate) from: u64,
    pub(crate) to: u64,
    pub(crate) was_asleep: bool,
    /// Vector entered at the end, with the cycles of the entry.
    pub(crate) entered: Option<(u8, u8)>,
    /// Interrupts in service after the step.
    pub(crate) depth: usize,
    pub(crate) interrupts_enabled: bool,
}

impl Meter {
    pub(crate) fn start(&mut self, now: u64) {
        self.started = now;
        self.stop();
    }

    /// Discards measurements in progress, after a reset or a hang.
    pub(crate) fn stop(&mut self) {
        self.serving.clear();
        self.disabled_since = None;
        self.open = None;
    }

    pub(crate) fn pass(&mut self, span: Span) {
        let cycles = span.to - span.from;
        let response = span.entered.map_or(0, |(_, cycles)| u64::from(cycles));
        self.cycles += cycles;
        if span.was_asleep {
            self.cycles_asleep += cycles - response.min(cycles);
        } else if self.serving.is_empty() {
            self.main += cycles - response.min(cycles);
        }
        if let Some((vector, _)) = span.entered {
            self.serving.push((vector, span.to - response));
        }
        while self.serving.len() > span.depth {
            if let Some((vector, start)) = self.serving.pop() {
                self.interrupts.add(vector, span.to - start);
            }
        }
        if span.interrupts_enabled || !self.serving.is_empty() {
            if let Some(since) = self.disabled_since.take() {
                let longest = &mut self.longest_critical_section;
                *longest = (*longest).max(span.to - response - since);
            }
        } else if span.to >= self.started + SETTLING {
            self.disabled_since.get_or_insert(span.to);
        }
    }

    /// The main program has written to GPIOR0.
    pub(crate) fn mark(&mut self, value: u8) {
        if !self.serving.is_empty() {
            return;
        }
        if let Some((number, since)) = self.open.take() {
            self.sections.add(number, self.main - since);
        }
        if value != 0 {
            self.open = Some((value, self.main));
        }
    }

    /// The figures; `sram` starts above the static data.
    pub(crate) fn figures(&self, sram: &[u8]) -> Figures {
        Figures {
            cycles: self.cycles,
            cycles_asleep: self.cycles_asleep,
            stack_bytes: stack_bytes(sram),
            longest_critical_section: narrow(self.longest_critical_section),
            interrupts: self.interrupts.list(),
            sections: self.sections.list(),
        }
    }
}

fn narrow(cycles: u64) -> u32 {
    u32::try_from(cycles).unwrap_or(u32::MAX)
}

/// Bytes above the first unwritten run; all, if there is none.
fn stack_bytes(sram: &[u8]) -> u16 {
    let untouched = sram
        .windows(UNTOUCHED)
        .position(|window| window.iter().all(|&byte| byte == PATTERN));
    let stack = untouched.map_or(sram, |start| {
        let run = sram.get(start..).unwrap_or_default();
        let length = run.iter().take_while(|&&byte| byte == PATTERN).count();
        run.get(length..).unwrap_or_default()
    });
    u16::try_from(stack.len()).unwrap_or(u16::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_stack_ends_at_the_untouched_bytes() {
        let mut sram = vec![PATTERN; 100];
        assert_eq!(stack_bytes(&sram), 0);
        sram[90..].fill(1);
        assert_eq!(stack_bytes(&sram), 10);
        // A stack buffer that was hardly written.
        sram[70] = 1;
        assert_eq!(stack_bytes(&sram), 30);
        // Data above the static data without symbols.
        sram[..8].fill(1);
        assert_eq!(stack_bytes(&sram), 30);
        for byte in sram.iter_mut().step_by(10) {
            *byte = 1;
        }
        assert_eq!(stack_bytes(&sram), 100);
    }
}
