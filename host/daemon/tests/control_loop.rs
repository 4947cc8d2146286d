//! The body of the control thread in virtual time, with the simulated car at
//! the other end of its rings: it allocates nothing, and queues nothing.
#![expect(unsafe_code, reason = "an allocator is unsafe to write")]
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "the helpers of tests may fail as tests do"
)]

use std::{
    alloc::{GlobalAlloc, Layout, System},
    cell::Cell,
    net::{IpAddr, Ipv4Addr, SocketAddr},
};

use rtrb::{Consumer, Producer, RingBuffer};
use singletrack_control::{Event, Mode, Pilot, Request, Time};
use singletrack_link::Session as LinkSession;
use singletrack_mocap::{Observation, Outcome, PoseState, Session as MocapSession};
use singletrack_protocol::{BoardMode, Decoder, ToBoard};
use singletrack_record::TickRecord;
use singletrack_sim::{Destination, SimulationConfig, World};
use singletrackd::{
    Config, Report,
    control_loop::{ControlLoop, ControlRequest, Rings, Slot},
    controller::{Controller, Sent},
    serial_port::Line,
    serial_reader::{Chunk, SerialEvent},
};

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

/// A line into a ring.
struct RingLine(Producer<u8>);

impl Line for RingLine {
    fn write_frame(&mut self, frame: &[u8]) -> Sent {
        if self.0.slots() < frame.len() {
            return Sent::Dropped;
        }
        for &byte in frame {
            self.0.push(byte).unwrap();
        }
        Sent::Whole
    }
}

/// The outside of the control thread's rings.
struct Outside {
    world: World,
    mocap: MocapSession,
    serial: Producer<SerialEvent<RingLine>>,
    observations: Producer<Observation>,
    line: Consumer<u8>,
    ticks: Consumer<TickRecord>,
    reports: Consumer<Report>,
    requests: Producer<ControlRequest>,
    bytes: Vec<u8>,
    /// Nothing comes from the board.
    stuck: bool,
}

const HOST: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 40_000);

impl Outside {
    fn advance_to(&mut self, now_us: u64) {
        let now_ns = now_us * 1_000;
        self.world.advance_to(now_us);
        self.bytes.clear();
        self.world.host_read(&mut self.bytes);
        if !self.bytes.is_empty() && !self.stuck {
            let chunk = Chunk::new(now_ns, &self.bytes);
            assert_eq!(chunk.bytes(), self.bytes);
            self.serial.push(SerialEvent::Bytes(chunk)).unwrap();
        }
        while let Some(transmit) = self.mocap.poll_transmit(now_ns) {
            self.world.handle_datagram(HOST, &transmit.bytes);
        }
        while let Some(datagram) = self.world.poll_datagram() {
            assert_eq!(datagram.to, Destination::Client(HOST));
            let source = SocketAddr::new(HOST.ip(), 1_510);
            if let Outcome::Frame(observation) =
                self.mocap.handle_datagram(now_ns, source, &datagram.bytes)
            {
                self.observations.push(observation).unwrap();
            }
        }
        while self.mocap.poll_event().is_some() {}
    }

    fn board_mode(&self) -> Option<BoardMode> {
        let code = self.world.board().code()?;
        Some(code.mode())
    }

    fn run_until_tick(&mut self, index: u64) {
        let tick_us = index * PERIOD_US;
        for step in (0..PERIOD_US / STEP_US).rev() {
            self.advance_to(tick_us - step * STEP_US);
        }
    }

    /// What the tick sent.
    fn sent(&mut self) -> Vec<u8> {
        core::iter::from_fn(|| self.line.pop().ok()).collect()
    }

    /// Takes what the tick sent and told; the mode it ended in.
    fn after_tick(&mut self) -> Option<Mode> {
        let sent = self.sent();
        self.world.host_write(&sent);
        while self.reports.pop().is_ok() {}
        self.ticks.pop().ok().map(|tick| tick.output.mode)
    }
}

fn set_up() -> (ControlLoop<RingLine>, Outside) {
    let mut config = Config::from_toml(include_str!("../singletrackd.example.toml")).unwrap();
    config.motion_capture.server = Ipv4Addr::LOCALHOST;
    let simulation = SimulationConfig::default();
    config
        .motion_capture
        .rigid_body
        .clone_from(&simulation.cameras.car.name);

    let (line_in, line) = RingBuffer::new(4_096);
    let (mut serial_in, serial) = RingBuffer::new(256);
    let (returned, _) = RingBuffer::new(2);
    let (observations_in, observations) = RingBuffer::new(64);
    let (requests_in, requests) = RingBuffer::new(4);
    let (ticks_in, ticks) = RingBuffer::new(4);
    let (reports_in, reports) = RingBuffer::new(64);
    serial_in
        .push(SerialEvent::Opened(RingLine(line_in)))
        .unwrap();
    let controller = Controller::new(
        LinkSession::new(config.link(7)).unwrap(),
        Pilot::new(config.pilot().unwrap()),
    );
    let control = ControlLoop::new(
        controller,
        Rings {
            serial,
            returned,
            observations,
            requests,
            ticks: ticks_in,
            reports: reports_in,
        },
        true,
    );
    let outside = Outside {
        world: World::new(simulation).unwrap(),
        mocap: MocapSession::new(config.motion_capture.session().unwrap()).unwrap(),
        serial: serial_in,
        observations: observations_in,
        line,
        ticks,
        reports,
        requests: requests_in,
        bytes: Vec::new(),
        stuck: false,
    };
    (control, outside)
}

const PERIOD_US: u64 = 10_000;
const STEP_US: u64 = 500;

fn tick(control: &mut ControlLoop<RingLine>, index: u64) {
    let now_ns = index * PERIOD_US * 1_000;
    let slot = Slot {
        scheduled_ns: now_ns,
        start_ns: now_ns,
        skipped: 0,
    };
    control.tick(slot, &|| now_ns);
}

/// Runs until the car has driven for a second; the number of the next tick.
fn drive(control: &mut ControlLoop<RingLine>, outside: &mut Outside) -> u64 {
    let mut driving = 0;
    for index in 1..2_000 {
        outside.run_until_tick(index);
        tick(control, index);
        driving += u64::from(outside.after_tick() == Some(Mode::Driving));
        if driving == 100 {
            return index + 1;
        }
    }
    panic!("the car never drove");
}

/// The drive commands in `bytes`.
fn drives(bytes: &[u8]) -> usize {
    let mut decoder = Decoder::new();
    bytes
        .iter()
        .filter(|&&byte| {
            decoder.push(byte).is_some_and(|packet| {
                matches!(ToBoard::decode(packet.unwrap()), Ok(ToBoard::Drive(_)))
            })
        })
        .count()
}

#[test]
fn a_line_that_is_stuck_both_ways_holds_two_commands_at_most() {
    let (mut control, mut outside) = set_up();
    let start = drive(&mut control, &mut outside);
    let mut queued = Vec::new();
    for index in start..start + 50 {
        outside.stuck = true;
        outside.run_until_tick(index);
        tick(&mut control, index);
        queued.extend(outside.sent());
        while outside.reports.pop().is_ok() {}
        while outside.ticks.pop().is_ok() {}
    }
    assert!(
        (1..=2).contains(&drives(&queued)),
        "{} commands",
        drives(&queued)
    );
    assert!(control.counters().drives_withheld > 0);
}

#[test]
fn asked_to_finish_it_stops_the_car_and_disarms_the_board_first() {
    let (mut control, mut outside) = set_up();
    let start = drive(&mut control, &mut outside);
    outside.requests.push(ControlRequest::Finish).unwrap();
    let mut ticks = 0;
    let mut modes = Vec::new();
    while !control.is_done() {
        let index = start + ticks;
        outside.run_until_tick(index);
        tick(&mut control, index);
        modes.extend(outside.after_tick());
        ticks += 1;
        assert!(ticks < 200, "never done");
    }
    modes.dedup();
    assert!(
        modes.starts_with(&[Mode::Stopping, Mode::Idle]),
        "{modes:?}"
    );
    assert!(outside.world.truth().speed.abs() < 0.05);
    assert_eq!(outside.board_mode(), Some(BoardMode::Neutral));
}

#[test]
fn asked_to_abort_it_disarms_the_board_at_full_speed() {
    let (mut control, mut outside) = set_up();
    let start = drive(&mut control, &mut outside);
    outside.requests.push(ControlRequest::Abort).unwrap();
    let mut ticks = 0;
    while !control.is_done() {
        let index = start + ticks;
        outside.run_until_tick(index);
        tick(&mut control, index);
        outside.after_tick();
        ticks += 1;
        assert!(ticks < 10, "not at once");
    }
    assert_eq!(outside.board_mode(), Some(BoardMode::Neutral));
}

#[test]
fn standing_it_is_done_at_the_next_tick() {
    let (mut control, mut outside) = set_up();
    for index in 1..100 {
        outside.run_until_tick(index);
        tick(&mut control, index);
        outside.after_tick();
    }
    outside.requests.push(ControlRequest::Finish).unwrap();
    tick(&mut control, 100);
    assert!(control.is_done());
}

#[test]
fn whoever_says_stop_before_it_was_ready_takes_back_that_it_arms_by_itself() {
    let (mut control, mut outside) = set_up();
    outside
        .requests
        .push(ControlRequest::Pilot(Request::Disarm))
        .unwrap();
    let mut modes = Vec::new();
    for index in 1..600 {
        outside.run_until_tick(index);
        tick(&mut control, index);
        modes.extend(outside.after_tick());
    }
    modes.dedup();
    assert_eq!(modes, [Mode::Disconnected, Mode::Idle, Mode::Ready]);

    // And to end in the tick in which somebody arms leaves nothing armed.
    outside
        .requests
        .push(ControlRequest::Pilot(Request::Arm))
        .unwrap();
    outside.requests.push(ControlRequest::Finish).unwrap();
    for index in 600..640 {
        outside.run_until_tick(index);
        tick(&mut control, index);
        outside.after_tick();
        assert_eq!(outside.board_mode(), Some(BoardMode::Neutral));
    }
    assert!(control.is_done());
}

#[test]
fn a_flood_of_samples_leaves_room_for_a_stop() {
    let config = Config::from_toml(include_str!("../singletrackd.example.toml")).unwrap();
    let mut controller = Controller::new(
        LinkSession::new(config.link(7)).unwrap(),
        Pilot::new(config.pilot().unwrap()),
    );
    for frame_number in 0..1_000 {
        controller.observed(&Observation {
            frame_number,
            receive_time_ns: 1,
            state: PoseState::Absent,
        });
    }
    controller.request(Request::EmergencyStop);
    let tick = controller.tick(Time(1), &mut |_| Sent::Whole, &mut |_| {});
    assert!(tick.dropped_events > 0);
    assert_eq!(
        tick.events.last(),
        Some(&Event::Request(Request::EmergencyStop))
    );
    assert_eq!(tick.output.mode, Mode::Fault);
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
