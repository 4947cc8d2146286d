//! Executes requests.

use std::collections::VecDeque;

use singletrack_simavr::{BusFault, Hang, Motion, Reply, Report, Request, ResetFlags, Run};

use crate::{
    elf::Image,
    figures::{Meter, PATTERN, Span},
    machine::Machine,
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
const SENSOR_HIGH: u64 = 16 * 50;

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
        self.meter.pass(Span {
            from: before.cycle,
            to: status.cycle,
            was_asleep: before.asleep,
            entered: (status.entered != 0).then_some((status.entered, status.response)),
            depth: usize::from(status.depth),
            // A hang does not count as a critical section.
            interrupts_enabled: status.interrupts_enabled || self.hang.is_some(),
        });
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
