//! The unsafe interface to simavr.
#![allow(unsafe_code)]

use std::ffi::{CStr, c_char, c_int, c_void};

use crate::devices::{Devices, OWNED, READ, WATCHED};

#[repr(C)]
struct Callbacks {
    context: *mut c_void,
    read: extern "C" fn(*mut c_void, u64, u16) -> u8,
    write: extern "C" fn(*mut c_void, u64, u16, u8),
    restart_watchdog: extern "C" fn(*mut c_void, u64),
    log: extern "C" fn(*mut c_void, c_int, *const c_char),
    changed: *const bool,
}

/// State of the processor.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Status {
    pub(crate) cycle: u64,
    pub(crate) pc: u32,
    /// Vector entered by the step, zero for none, and the cycles of the entry.
    pub(crate) entered: u8,
    pub(crate) response: u8,
    /// Number of interrupts in service.
    pub(crate) depth: u8,
    pub(crate) interrupts_enabled: bool,
    pub(crate) asleep: bool,
    pub(crate) crashed: bool,
}

unsafe extern "C" {
    fn uno_new(callbacks: *const Callbacks, flash: *const u8, size: u32) -> *mut c_void;
    fn uno_own_read(uno: *mut c_void, address: u16);
    fn uno_own_write(uno: *mut c_void, address: u16);
    fn uno_watch_write(uno: *mut c_void, address: u16);
    fn uno_reset(uno: *mut c_void, status: *mut Status);
    fn uno_run(uno: *mut c_void, until: u64, status: *mut Status);
    fn uno_skip(uno: *mut c_void, until: u64, status: *mut Status);
    fn uno_set_cycle(uno: *mut c_void, cycle: u64);
    fn uno_wake(uno: *mut c_void);
    fn uno_disable_interrupts(uno: *mut c_void);
    fn uno_request(uno: *mut c_void, vector: u8, requested: c_int);
    fn uno_set_int0(uno: *mut c_void, level: c_int);
    fn uno_set_adc0(uno: *mut c_void, millivolts: u32);
    fn uno_set_supply(uno: *mut c_void, millivolts: u32);
    fn uno_data(uno: *mut c_void, size: *mut u32) -> *mut u8;
    fn uno_silence_stdout() -> c_int;
}

// The callbacks. simavr calls them only within the functions above, all of which
// take a `&mut Machine`: no other reference to the devices exists then.

/// # Safety
///
/// `context` is `Machine::devices`, and no other reference to it is alive.
unsafe fn devices<'a>(context: *mut c_void) -> &'a mut Devices {
    // SAFETY: the caller's promise.
    unsafe { &mut *context.cast() }
}

extern "C" fn read(context: *mut c_void, now: u64, address: u16) -> u8 {
    // SAFETY: see above.
    unsafe { devices(context) }.read(now, address)
}

extern "C" fn write(context: *mut c_void, now: u64, address: u16, value: u8) {
    // SAFETY: see above.
    unsafe { devices(context) }.write(now, address, value);
}

extern "C" fn restart_watchdog(context: *mut c_void, now: u64) {
    // SAFETY: see above.
    let devices = unsafe { devices(context) };
    devices.watchdog.restart(now);
    devices.changed = true;
}

extern "C" fn log(context: *mut c_void, fatal: c_int, text: *const c_char) {
    // SAFETY: the shim passes a terminated string that outlives the call.
    let text = unsafe { CStr::from_ptr(text) };
    // SAFETY: see above.
    unsafe { devices(context) }.log(fatal != 0, &text.to_string_lossy());
}

/// Redirects simavr's output to standard error.
pub(crate) fn silence_stdout() {
    // SAFETY: replaces a descriptor, touches no memory.
    unsafe { uno_silence_stdout() };
}

/// The processor and its devices.
///
/// A process has one, which lives as long as the process.
pub(crate) struct Machine {
    uno: *mut c_void,
    devices: *mut Devices,
    pub(crate) status: Status,
}

impl Machine {
    /// `None` if this simavr does not support the processor.
    pub(crate) fn new(flash: &[u8]) -> Option<Self> {
        let devices = Box::into_raw(Box::new(Devices::new()));
        let callbacks = Callbacks {
            context: devices.cast(),
            read,
            write,
            restart_watchdog,
            log,
            // SAFETY: takes an address, reads nothing.
            changed: unsafe { &raw const (*devices).changed },
        };
        // SAFETY: both are valid for the call, which copies them; the devices are
        // never freed.
        let uno = unsafe { uno_new(&raw const callbacks, flash.as_ptr(), flash.len() as u32) };
        if uno.is_null() {
            return None;
        }
        // SAFETY: `uno` is valid, the addresses are those of I/O registers.
        unsafe {
            for address in OWNED.iter().cloned().flatten() {
                uno_own_read(uno, address);
                uno_own_write(uno, address);
            }
            for &address in READ {
                uno_own_read(uno, address);
            }
            for &address in WATCHED {
                uno_watch_write(uno, address);
            }
        }
        let mut machine = Self {
            uno,
            devices,
            status: Status::default(),
        };
        machine.reset();
        Some(machine)
    }

    pub(crate) fn devices(&mut self) -> &mut Devices {
        // SAFETY: from a box that is never freed; the borrow of `self` keeps every
        // function that leads to a callback from being called meanwhile.
        unsafe { &mut *self.devices }
    }

    pub(crate) fn reset(&mut self) {
        // SAFETY: `uno` is valid, as in all that follows.
        unsafe { uno_reset(self.uno, &raw mut self.status) };
    }

    /// Runs instructions up to the given cycle, or fewer: see the shim.
    pub(crate) fn run(&mut self, until: u64) {
        // SAFETY: as above.
        unsafe { uno_run(self.uno, until, &raw mut self.status) };
    }

    /// Advances time without instructions up to the given cycle, or less.
    pub(crate) fn skip(&mut self, until: u64) {
        // SAFETY: as above.
        unsafe { uno_skip(self.uno, until, &raw mut self.status) };
    }

    pub(crate) fn set_cycle(&mut self, cycle: u64) {
        self.status.cycle = cycle;
        // SAFETY: as above.
        unsafe { uno_set_cycle(self.uno, cycle) };
    }

    /// Wakes the processor without an interrupt.
    pub(crate) fn wake(&mut self) {
        self.status.asleep = false;
        // SAFETY: as above.
        unsafe { uno_wake(self.uno) };
    }

    pub(crate) fn disable_interrupts(&mut self) {
        self.status.interrupts_enabled = false;
        // SAFETY: as above.
        unsafe { uno_disable_interrupts(self.uno) };
    }

    /// Passes the devices' interrupt requests to the processor.
    pub(crate) fn pass_requests(&mut self) {
        for (vector, requested) in self.devices().requests() {
            // SAFETY: as above.
            unsafe { uno_request(self.uno, vector, requested.into()) };
        }
    }

    pub(crate) fn set_int0(&mut self, level: bool) {
        self.devices().motor_level = level;
        // SAFETY: as above.
        unsafe { uno_set_int0(self.uno, level.into()) };
    }

    pub(crate) fn set_adc0(&mut self, millivolts: u32) {
        // SAFETY: as above.
        unsafe { uno_set_adc0(self.uno, millivolts) };
    }

    pub(crate) fn set_supply(&mut self, millivolts: u32) {
        // SAFETY: as above.
        unsafe { uno_set_supply(self.uno, millivolts) };
    }

    /// Registers, I/O and SRAM by address.
    pub(crate) fn data(&mut self) -> &mut [u8] {
        let mut size = 0;
        // SAFETY: as above.
        let data = unsafe { uno_data(self.uno, &raw mut size) };
        // SAFETY: this is the length of simavr's allocation, which neither moves
        // nor is accessed while `self` is borrowed.
        unsafe { std::slice::from_raw_parts_mut(data, size as usize) }
    }
}
