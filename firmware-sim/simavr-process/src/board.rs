//! Executes requests, and measures resource usage step by step.

use std::collections::{BTreeMap, VecDeque};

use singletrack_simavr::{
    BusFault, CYCLES_PER_US, Cost, Figures, Hang, Motion, Reply, Report, Request, ResetFlags, Run,
};

use crate::{
    elf::Image,
    machine::{Machine, Status},
};

const SRAM: usize = 0x100;
const TIMSK0: usize = 0x6E;
const TCCR1B: u16 = 0x81;
const ADC_COUNTS: u32 = 1_024;
const SUPPLY_MV: u32 = 5_000;
/// Voltage on a floating A0 without pull-up: anything is possible, also that of a
/// charged battery.
const FLOATING_MV: u32 = 3_900;
/// The divider's resistance at the pin, and that of the pull-up, in Ω.
const DIVIDER_OHM: u32 = 5_000;
const PULL_UP_OHM: u32 = 35_000;
/// Time for which the motor sensor stays high, unless the next edge is earlier.
const SENSOR_HIGH: u64 = CYCLES_PER_US * 50;
/// Critical sections within this time after the start do not count.
const SETTLING: u64 = 5_000 * CYCLES_PER_US;

/// Contents of SRAM that has not been written since power-on.
const PATTERN: u8 = 0xC5;
/// Number of consecutive pattern bytes that counts as unwritten.
const UNTOUCHED: usize = 16;

/// The board with an image in its flash, held in reset.
pub(crate) struct Board {
    machine: Machine,
    code_end: u32,
    static_end: usize,
    meter: Meter,
    /// Time since which the processor is held in reset.
    held: Option<u64>,
    hang: Option<Hang>,
    /// Reason of a crash of the processor.
    crash: Option<String>,
    sensor_falls: Option<u64>,
    watchdog_reset: Option<u64>,
    battery: Battery,
}

/// What is at the converter's inputs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Battery {
    battery_mv: u32,
    supply_mv: u32,
    divider_open: bool,
    pulled_up: bool,
}

impl Battery {
    /// The voltage on A0.
    const fn pin_mv(self) -> u32 {
        let without = match self.divider_open {
            true if self.pulled_up => return self.supply_mv,
            true => return FLOATING_MV,
            false => self.battery_mv / 2,
        };
        if !self.pulled_up {
            return without;
        }
        (without * PULL_UP_OHM + self.supply_mv * DIVIDER_OHM) / (PULL_UP_OHM + DIVIDER_OHM)
    }
}

/// Pending inputs of a run.
struct Inputs {
    received: VecDeque<(u64, u8)>,
    edges: VecDeque<u64>,
    motion: VecDeque<(u64, Motion)>,
}

impl Board {
    /// `None` if this simavr does not support the processor.
    pub(crate) fn new(image: &Image) -> Option<Self> {
        let mut machine = Machine::new(&image.flash)?;
        machine.set_cycle(0);
        Some(Self {
            machine,
            code_end: image.flash.len() as u32,
            static_end: usize::from(image.static_end),
            meter: Meter::default(),
            held: Some(0),
            hang: None,
            crash: None,
            sensor_falls: None,
            watchdog_reset: None,
            battery: Battery {
                supply_mv: SUPPLY_MV,
                ..Battery::default()
            },
        })
    }

    pub(crate) fn answer(&mut self, request: Request) -> Reply {
        match request {
            Request::Run(run) => return self.run(run),
            Request::Hold => self.hold(self.now()),
            Request::Start(flags) => self.start(flags),
            Request::Hang(hang) => self.hang(hang),
            Request::SetBus(fault) => self.set_bus(fault),
            Request::Measure => {
                let static_end = self.static_end;
                let sram = self.machine.data().get(static_end..).unwrap_or_default();
                return Reply::Figures(self.meter.figures(sram));
            }
        }
        Reply::Done
    }

    const fn now(&self) -> u64 {
        self.machine.status.cycle
    }

    fn hold(&mut self, now: u64) {
        self.machine.devices().reset(now);
        self.machine.reset();
        self.held.get_or_insert(now);
        self.hang = None;
        self.crash = None;
        self.meter.stop();
    }

    fn start(&mut self, flags: ResetFlags) {
        let now = self.now();
        self.hold(now);
        let held = self.held.take().unwrap_or(now);
        if flags == ResetFlags::POWER_ON {
            if let Some(sram) = self.machine.data().get_mut(SRAM..) {
                sram.fill(PATTERN);
            }
            // The IMU has the same supply.
            self.machine.devices().twi.power_on(held);
        }
        if let Some(r2) = self.machine.data().get_mut(2) {
            *r2 = flags.0;
        }
        self.meter.start(now);
    }

    fn hang(&mut self, hang: Hang) {
        self.meter.stop();
        match hang {
            Hang::MainLoop | Hang::Everything => {
                self.hang = Some(hang);
                self.machine.wake();
                if hang == Hang::Everything {
                    self.machine.disable_interrupts();
                }
            }
            Hang::Ticks => {
                if let Some(mask) = self.machine.data().get_mut(TIMSK0) {
                    *mask = 0;
                }
            }
            Hang::Pulses => {
                let now = self.now();
                self.machine.devices().write(now, TCCR1B, 0);
            }
        }
    }

    fn set_bus(&mut self, fault: BusFault) {
        let now = self.now();
        let devices = self.machine.devices();
        devices.twi.set_fault(now, fault);
        devices.changed = true;
    }

    fn run(&mut self, run: Run) -> Reply {
        if run.supply_mv != 0 {
            self.battery.supply_mv = run.supply_mv.into();
        }
        self.battery.battery_mv = run.battery_mv.into();
        self.battery.divider_open = run.divider_open;
        self.pass_voltages();
        if let Some(health) = run.imu_health {
            self.machine.devices().twi.imu.set_health(health);
        }
        self.machine.devices().stop_input_open = run.stop_input_open;
        let mut inputs = Inputs {
            received: run.received.into(),
            edges: run.motor_edges.into(),
            motion: run.motion.into(),
        };
        while self.now() < run.until {
            let next_input = self.take_inputs(&mut inputs);
            self.pass_time(run.until.min(next_input));
        }
        // Inputs exactly at the end.
        self.take_inputs(&mut inputs);
        let devices = self.machine.devices();
        let report = Report {
            transmitted: std::mem::take(&mut devices.uart.transmitted),
            pulses: std::mem::take(&mut devices.pulses),
            kill_output: std::mem::take(&mut devices.kill_changes),
            bytes_overrun: devices.uart.bytes_overrun,
            cycle: self.now(),
            watchdog_reset: self.watchdog_reset.take(),
        };
        let crash = self.crash.clone();
        crash.map_or(Reply::Ran(report), Reply::Failed)
    }

    fn pass_voltages(&mut self) {
        self.battery.pulled_up = self.machine.devices().battery_pull_up();
        let supply_mv = self.battery.supply_mv;
        let counts = (self.battery.pin_mv() * ADC_COUNTS / supply_mv).min(ADC_COUNTS - 1);
        self.machine.set_supply(supply_mv);
        // simavr multiplies by 1023; the converter has 1024 steps.
        self.machine
            .set_adc0((counts * supply_mv).div_ceil(ADC_COUNTS - 1));
    }

    /// Applies the inputs that are due; returns the time of the next one.
    fn take_inputs(&mut self, inputs: &mut Inputs) -> u64 {
        let now = self.now();
        while let Some((_, motion)) = inputs.motion.pop_front_if(|(at, _)| *at <= now) {
            self.machine.devices().twi.imu.measure(motion);
        }
        while let Some((at, byte)) = inputs.received.pop_front_if(|(at, _)| *at <= now) {
            if self.held.is_none() {
                let devices = self.machine.devices();
                devices.uart.receive(at, byte);
                devices.changed = true;
            }
        }
        if self.sensor_falls.take_if(|falls| *falls <= now).is_some() {
            self.machine.set_int0(false);
        }
        while let Some(at) = inputs.edges.pop_front_if(|at| *at <= now) {
            self.machine.set_int0(false);
            self.machine.set_int0(true);
            self.sensor_falls = Some(at + SENSOR_HIGH);
        }
        let motion = inputs.motion.front().map(|(at, _)| *at);
        let received = inputs.received.front().map(|(at, _)| *at);
        let edge = inputs.edges.front().copied();
        let next = [motion, received, edge, self.sensor_falls];
        next.into_iter().flatten().min().unwrap_or(u64::MAX)
    }

    /// Runs up to `until`, or one instruction longer.
    fn pass_time(&mut self, until: u64) {
        loop {
            if self.held.is_some() || self.crash.is_some() {
                self.machine.set_cycle(until.max(self.now()));
                return;
            }
            let now = self.now();
            let devices = self.machine.devices();
            if devices.changed || devices.next <= now {
                if devices.battery_pull_up() != self.battery.pulled_up {
                    self.pass_voltages();
                }
                let devices = self.machine.devices();
                devices.advance(now);
                devices.changed = false;
                if let Some(at) = devices.watchdog_reset {
                    // No device acts between the timeout and the end of the interrupted
                    // instruction.
                    self.hold(at);
                    self.watchdog_reset = Some(at);
                    continue;
                }
                self.machine.pass_requests();
            }
            if now >= until {
                return;
            }
            let until = until.min(self.machine.devices().next);
            self.proceed(until);
            self.check_for_crash();
        }
    }

    /// Runs at most up to `until`, or one instruction longer.
    fn proceed(&mut self, until: u64) {
        let before = self.machine.status;
        let hangs = match self.hang {
            Some(Hang::Everything) => true,
            // The program leaves a critical section before it hangs.
            Some(Hang::MainLoop) => before.depth == 0 && before.interrupts_enabled,
            Some(Hang::Ticks | Hang::Pulses) | None => false,
        };
        if hangs || before.asleep {
            self.machine.skip(until);
        } else {
            self.machine.run(until);
        }
        let status = self.machine.status;
        self.meter.pass(&before, &status, self.hang.is_some());
        let devices = self.machine.devices();
        if status.entered != 0 {
            devices.served(status.entered);
        }
        if let Some(mark) = devices.mark.take() {
            self.meter.mark(mark);
        }
        if self.hang.is_some() && status.asleep {
            self.machine.wake();
        }
    }

    fn check_for_crash(&mut self) {
        let status = self.machine.status;
        let code_end = self.code_end;
        let words = self.machine.devices().fatal.take();
        let reason = match words {
            Some(words) => words,
            None if status.crashed => "simavr has stopped".to_owned(),
            None if status.pc >= code_end => {
                format!("it has left the program, which ends at {code_end:#06x}")
            }
            None => return,
        };
        self.crash = Some(format!(
            "the processor crashed in cycle {} at {:#06x}: {reason}",
            status.cycle, status.pc
        ));
    }
}

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
struct Meter {
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

impl Meter {
    fn start(&mut self, now: u64) {
        self.started = now;
        self.stop();
    }

    /// Discards measurements in progress, after a reset or a hang.
    fn stop(&mut self) {
        self.serving.clear();
        self.disabled_since = None;
        self.open = None;
    }

    /// Counts a step of the processor, which went from `before` to `after`. A hang does not count as
    /// a critical section.
    fn pass(&mut self, before: &Status, after: &Status, has_hang: bool) {
        let cycles = after.cycle - before.cycle;
        let response = u64::from(after.response);
        self.cycles += cycles;
        if before.asleep {
            self.cycles_asleep += cycles - response.min(cycles);
        } else if self.serving.is_empty() {
            self.main += cycles - response.min(cycles);
        }
        if after.entered != 0 {
            self.serving.push((after.entered, after.cycle - response));
        }
        while self.serving.len() > usize::from(after.depth) {
            if let Some((vector, start)) = self.serving.pop() {
                self.interrupts.add(vector, after.cycle - start);
            }
        }
        if after.interrupts_enabled || has_hang || !self.serving.is_empty() {
            if let Some(since) = self.disabled_since.take() {
                let longest = &mut self.longest_critical_section;
                *longest = (*longest).max(after.cycle - response - since);
            }
        } else if after.cycle >= self.started + SETTLING {
            self.disabled_since.get_or_insert(after.cycle);
        }
    }

    /// The main program has written to GPIOR0.
    fn mark(&mut self, value: u8) {
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
    fn figures(&self, sram: &[u8]) -> Figures {
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
