//! What the control thread must not do while it ticks: ask the allocator for
//! something, touch memory that is not there.

#![expect(unsafe_code, reason = "an allocator is unsafe to write")]
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "the helpers of tests may fail as tests do"
)]

#[path = "common/outside.rs"]
mod outside;

use std::{
    alloc::{GlobalAlloc, Layout, System},
    cell::Cell,
};

use outside::{set_up, tick};
use singletrack_control::Mode;

struct Counting;

thread_local! {
    static COUNTS: Cell<bool> = const { Cell::new(false) };
    static COUNT: Cell<u64> = const { Cell::new(0) };
}

fn count() {
    COUNTS.with(|counts| {
        if counts.get() {
            COUNT.with(|count| count.set(count.get() + 1));
        }
    });
}

// SAFETY: everything is the system allocator's; counting does not allocate.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: as the caller promises.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        count();
        // SAFETY: as the caller promises.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count();
        // SAFETY: as the caller promises.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// How often `action` asks the allocator for something.
fn allocations(action: impl FnOnce()) -> u64 {
    let before = COUNT.with(Cell::get);
    COUNTS.with(|counts| counts.set(true));
    action();
    COUNTS.with(|counts| counts.set(false));
    COUNT.with(Cell::get) - before
}

#[test]
fn ten_thousand_ticks_allocate_nothing() {
    const TICKS: u64 = 10_000;
    let (mut control, mut outside) = set_up();
    let mut driving = 0;
    let mut total = 0;
    for index in 1..=TICKS {
        outside.run_until_tick(index);
        total += allocations(|| tick(&mut control, index));
        driving += u64::from(outside.after_tick() == Some(Mode::Driving));
    }
    assert_eq!(total, 0, "allocations");
    assert!(driving > TICKS * 8 / 10, "only {driving} driving ticks");
    assert_eq!(control.counters().reports_dropped, 0);
    assert_eq!(control.counters().drives_withheld, 0);
}

#[test]
fn the_allocator_counts() {
    assert!(allocations(|| drop(Vec::<u8>::with_capacity(10))) >= 2);
}
