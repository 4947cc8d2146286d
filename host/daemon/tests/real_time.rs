//! A tick of the control thread allocates nothing and causes no page fault.

#![expect(unsafe_code, reason = "an allocator is unsafe to write")]
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "the helpers of tests may fail as tests do"
)]

#[path = "../../core/tests/common/simulated_drive.rs"]
mod simulated_drive;

use std::{
    alloc::{GlobalAlloc, Layout, System},
    cell::Cell,
    hint::black_box,
};

use singletrack_control::{OuterLoop, Setpoint, Time, TrackingInput, Velocity};
use singletrack_core::{
    ControlRequest,
    config::{
        LoopModel, MpcWeights, OnlineCalibrationMode, OuterLoopSection, OwnLoop, OwnLoopKind,
        OwnLoopSection, ReferenceSection, Start, TuningSection, link_own_loops,
    },
};
use singletrack_pilot::{Filtering, Learned, Mode, Tuning};
use singletrack_settings::{ValueError, section};
use singletrack_sim::SimulationConfig;
use singletrackd::realtime;

use simulated_drive::SimulatedDrive;

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

// SAFETY: every call goes to the system allocator; counting does not allocate.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: the caller's contract is passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        count();
        // SAFETY: the caller's contract is passed on.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count();
        // SAFETY: the caller's contract is passed on.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// The number of calls of the allocator during `action`.
fn allocations(action: impl FnOnce()) -> u64 {
    let before = COUNT.with(Cell::get);
    COUNTS.with(|counts| counts.set(true));
    action();
    COUNTS.with(|counts| counts.set(false));
    COUNT.with(Cell::get) - before
}

/// The number of page faults of this thread so far, minor and major.
fn page_faults() -> libc::c_long {
    let mut usage = core::mem::MaybeUninit::<libc::rusage>::zeroed();
    // SAFETY: the kernel fills in the value, and zeros are a valid one.
    let usage = unsafe {
        libc::getrusage(libc::RUSAGE_THREAD, usage.as_mut_ptr());
        usage.assume_init()
    };
    usage.ru_minflt + usage.ru_majflt
}

const TICKS: u64 = 10_000;

#[test]
fn ten_thousand_ticks_allocate_nothing_and_cause_no_page_fault() {
    let governed = drive(SimulatedDrive::new(), TICKS);
    assert_eq!(governed, 0);
}

#[test]
fn a_predictive_loop_allocates_nothing_and_causes_no_page_fault() {
    for actuation in [true, false] {
        let mut config = SimulatedDrive::example();
        config.outer_loop = OuterLoopSection::Mpc(MpcWeights::default());
        config.compensation.actuation = actuation;
        drive(
            SimulatedDrive::with(config, SimulationConfig::default()),
            TICKS / 2,
        );
    }
}

section! {
    /// The settings of [`Integral`].
    "outer_loop.own" => Gains: Copy;
    [default];

    /// Gain of the error, 1/s.
    gain_per_s: f64 = 2.0;
}

/// A loop of another crate, with a state.
#[derive(Clone, Debug, PartialEq)]
struct Integral(Gains, Velocity);

impl OuterLoop for Integral {
    fn step(&mut self, input: &TrackingInput<'_>) -> Velocity {
        let reference = (input.reference)(0.0);
        let wanted = reference.position.unwrap_or(input.point);
        let error = wanted - input.point;
        self.1 += error * input.period;
        reference.velocity + self.0.gain_per_s * (error + self.1)
    }

    fn reset(&mut self) {
        self.1 = Velocity::zeros();
    }
}

impl OwnLoop for Integral {
    const NAME: &'static str = "integral";
    const VERSION: &'static str = "0.1.0";
    type Settings = Gains;

    fn new(gains: Gains, _: &LoopModel<'_>) -> Result<Self, ValueError> {
        Ok(Self(gains, Velocity::zeros()))
    }
}

#[test]
fn a_loop_of_another_crate_allocates_nothing_and_causes_no_page_fault() {
    link_own_loops([OwnLoopKind::of::<Integral>()]);
    for actuation in [true, false] {
        let mut config = SimulatedDrive::example();
        let own = OwnLoopSection::new("integral".to_owned(), None, None);
        config.outer_loop = OuterLoopSection::Own(own);
        config.compensation.actuation = actuation;
        drive(
            SimulatedDrive::with(config, SimulationConfig::default()),
            TICKS / 2,
        );
    }
}

/// Drives for this many ticks, of which none may allocate or fault; in how many the governor
/// slowed the reference down.
fn drive(mut drive: SimulatedDrive, ticks: u64) -> u64 {
    // As the daemon prepares its thread. If memory can't be locked, the pages of the code
    // are loaded when it first runs: during ticks that are not counted.
    let uncounted = match realtime::lock_memory() {
        Ok(()) => 0,
        Err(_) => 2_000,
    };
    realtime::touch_memory(&mut drive.host.control.rings);
    let (mut driving, mut governed, mut allocated, mut faults) = (0, 0, 0, 0);
    for index in 1..=uncounted + ticks {
        drive.run_until_tick(index);
        let before = page_faults();
        allocated += allocations(|| drive.tick(index));
        if index > uncounted {
            faults += page_faults() - before;
        }
        let output = drive.output();
        governed += u64::from(
            output
                .as_ref()
                .is_some_and(|output| output.slowed_by.is_some()),
        );
        driving += u64::from(output.is_some_and(|output| output.mode == Mode::Driving));
    }
    assert_eq!((allocated, faults), (0, 0), "allocations, page faults");
    assert!(
        driving > ticks * 8 / 10 - 500,
        "only {driving} driving ticks"
    );
    assert_eq!(drive.host.control.counters().reports_dropped, 0);
    assert_eq!(drive.host.control.counters().drives_withheld, 0);
    governed
}

#[test]
fn reconfigurations_and_set_points_allocate_and_free_nothing_in_a_tick() {
    let mut drive = SimulatedDrive::new();
    let config = drive.config();
    let mut total = 0;
    for index in 1..=300 {
        drive.run_until_tick(index);
        if index.is_multiple_of(10) {
            drive.reconfigure(config.clone(), u64::MAX);
            let setpoint = Setpoint::point(Time(index), None, Velocity::zeros());
            drive.host.setpoints.send(&setpoint);
        }
        total += allocations(|| drive.tick(index));
        if index.is_multiple_of(10) {
            // Freed here, on the other side of the ring.
            let _ = drive.outcome();
        }
        drive.after_tick();
    }
    assert_eq!(total, 0, "allocations");
}

#[test]
fn tuning_allocates_nothing_in_a_tick() {
    let mut config = SimulatedDrive::example();
    config.tuning = TuningSection {
        enabled: true,
        gain_per_s: Some([0.5, 4.0]),
        point_distance_m: Some([0.3, 0.4]),
    };
    let mut drive = SimulatedDrive::with(config, SimulationConfig::default());
    let (mut total, mut driven) = (0, 0);
    for index in 1..=2_000 {
        drive.run_until_tick(index);
        // Two in a tick become one event.
        for number in 0..2 {
            let (gain, p) = if (index / 40 + number) % 2 == 0 {
                (2.0, 0.4)
            } else {
                (1.0, 0.3)
            };
            let tuning = Tuning {
                gain: Some(Velocity::new(gain, gain)),
                point_distance: (number == 0).then_some(p),
            };
            drive.host.tunings.send(tuning);
        }
        total += allocations(|| drive.tick(index));
        let tuned = drive.output().filter(|output| output.mode == Mode::Driving);
        driven += u64::from(tuned.is_some_and(|output| output.tuned.is_some()));
    }
    assert_eq!(total, 0, "allocations");
    assert!(driven > 1_000, "only {driven} driving ticks");
}

#[test]
fn a_tick_that_learns_allocates_nothing() {
    let mut config = SimulatedDrive::example();
    config.online_calibration.mode = OnlineCalibrationMode::Live;
    let mut drive = SimulatedDrive::with(config, SimulationConfig::default());
    let mut total = 0;
    for index in 1..=3_000 {
        drive.run_until_tick(index);
        if index % 100 == 0 {
            drive.request(ControlRequest::Learned(Learned {
                body_yaw: 0.01,
                ..Learned::default()
            }));
        }
        total += allocations(|| drive.tick(index));
        drive.after_tick();
    }
    assert_eq!(total, 0, "allocations");
    let learned = drive.host.control.controller.pilot.learned();
    assert_eq!(learned.unwrap().body_yaw, 0.01);
}

#[test]
fn a_tick_of_the_safety_filter_allocates_nothing() {
    let mut config = SimulatedDrive::new().config();
    config.safety_filter.enabled = true;
    // P is to leave the geofence on every round.
    for [x, _] in &mut config.fence.corners_m {
        *x = x.min(0.6);
    }
    let mut drive = SimulatedDrive::with(config, SimulationConfig::default());
    let (mut total, mut filtered) = (0, 0);
    for index in 1..=3_000 {
        drive.run_until_tick(index);
        total += allocations(|| drive.tick(index));
        let output = drive.output().unwrap();
        filtered += u64::from(output.filtering != Filtering::None);
    }
    assert_eq!(total, 0, "allocations");
    assert!(filtered > 50, "only {filtered} interventions");
}

#[test]
fn a_tick_of_the_governor_allocates_nothing_and_causes_no_page_fault() {
    // Its leader leaves a circle that is too tight.
    let mut config = SimulatedDrive::example();
    config.governor.enabled = true;
    config.reference = ReferenceSection::Circle {
        centre_m: [0.0, 0.0],
        radius_m: 0.5,
        angular_velocity_rad_s: 1.0,
        start: Start::Beginning,
    };
    let governed = drive(
        SimulatedDrive::with(config, SimulationConfig::default()),
        TICKS / 2,
    );
    assert!(governed > TICKS / 4, "only {governed} ticks");
}

#[test]
fn allocations_and_page_faults_are_counted() {
    assert!(allocations(|| drop(black_box(Vec::<u8>::with_capacity(10)))) >= 2);
    let before = page_faults();
    let pages = black_box(vec![1_u8; 64 << 20]);
    assert!(page_faults() > before);
    drop(pages);
}
