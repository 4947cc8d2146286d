//! The simulated car at the other end of the control thread's rings, in virtual
//! time.

#![allow(dead_code, reason = "each test uses its part of it")]

use std::net::{IpAddr, Ipv4Addr, SocketAddr};

use rtrb::{Consumer, Producer, RingBuffer};
use singletrack_core::{
    Config, ControlRequest, Reconfiguration, Refusal, Report,
    control_loop::{ControlLoop, Rings},
    controller::Controller,
    grid::Slot,
    line::{Line, Sent},
    serial::{Chunk, SerialEvent},
    setpoint_slot::{SetpointSender, setpoint_slot},
};
use singletrack_link::Session as LinkSession;
use singletrack_mocap::planar::{Observation, PlanarOutcome, PlanarSession as MocapSession};
use singletrack_pilot::{Mode, Pilot, RealTimeState};
use singletrack_protocol::BoardMode;
use singletrack_record::{TickOutput, tick_feed};
use singletrack_sim::{Destination, SimulationConfig, World};

/// A line into a ring.
pub(crate) struct RingLine(Producer<u8>);

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
pub(crate) struct Outside {
    pub(crate) world: World,
    pub(crate) mocap: MocapSession,
    pub(crate) serial: Producer<SerialEvent<RingLine>>,
    pub(crate) observations: Producer<Observation>,
    line: Consumer<u8>,
    pub(crate) ticks: TickOutput,
    pub(crate) reports: Consumer<Report>,
    pub(crate) requests: Producer<ControlRequest>,
    pub(crate) setpoints: SetpointSender,
    pub(crate) reconfigured: Consumer<Box<Reconfiguration>>,
    /// With which it all began.
    pub(crate) config: Config,
    bytes: Vec<u8>,
    /// The number of the newest frame that was handed over.
    pub(crate) last_frame: i32,
    /// Nothing comes from the board.
    pub(crate) stuck: bool,
}

const HOST: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 40_000);

impl Outside {
    pub(crate) fn advance_to(&mut self, now_us: u64) {
        let now_ns = now_us * 1_000;
        self.world.advance_to(now_us);
        self.bytes.clear();
        self.world.host_read(&mut self.bytes);
        if !self.bytes.is_empty() && !self.stuck {
            let chunk = Chunk::new(now_ns, &self.bytes);
            assert_eq!(chunk.bytes(), self.bytes);
            self.serial.push(SerialEvent::Bytes(chunk)).unwrap();
        }
        self.mocap.handle_timeout(now_ns, &mut |_| {});
        while let Some(transmit) = self.mocap.poll_transmit(now_ns) {
            self.world.handle_datagram(HOST, &transmit.bytes);
        }
        while let Some(datagram) = self.world.poll_datagram() {
            assert_eq!(datagram.to, Destination::Client(HOST));
            let source = SocketAddr::new(HOST.ip(), 1_510);
            if let PlanarOutcome::Frame(observation) =
                self.mocap
                    .handle_datagram(now_ns, source, &datagram.bytes, &mut |_| {})
            {
                self.last_frame = observation.frame_number;
                self.observations.push(observation).unwrap();
            }
        }
    }

    pub(crate) fn board_mode(&self) -> Option<BoardMode> {
        let code = self.world.board().code()?;
        Some(code.mode())
    }

    pub(crate) fn run_until_tick(&mut self, index: u64) {
        let tick_us = index * PERIOD_US;
        for step in (0..PERIOD_US / STEP_US).rev() {
            self.advance_to(tick_us - step * STEP_US);
        }
    }

    /// Asks for another configuration.
    pub(crate) fn reconfigure(&mut self, config: &Config, until_ns: u64) {
        let change = Box::new(Reconfiguration {
            number: 2,
            pilot: config.pilot().unwrap(),
            board: config.board.configuration(),
            until_ns,
            outcome: None,
        });
        self.requests
            .push(ControlRequest::Reconfigure(change))
            .unwrap();
    }

    /// What became of it.
    pub(crate) fn outcome(&mut self) -> Result<(), Refusal> {
        self.reconfigured.pop().unwrap().outcome.unwrap()
    }

    /// What the tick sent.
    pub(crate) fn sent(&mut self) -> Vec<u8> {
        core::iter::from_fn(|| self.line.pop().ok()).collect()
    }

    /// Takes what the tick sent and told; the mode it ended in.
    pub(crate) fn after_tick(&mut self) -> Option<Mode> {
        let sent = self.sent();
        self.world.host_write(&sent);
        while self.reports.pop().is_ok() {}
        self.ticks.pop().map(|tick| tick.output.mode)
    }
}

pub(crate) fn set_up() -> (ControlLoop<RingLine>, Outside) {
    let mut config =
        Config::from_toml(include_str!("../../../daemon/singletrackd.example.toml")).unwrap();
    config.motion_capture.server = Ipv4Addr::LOCALHOST;
    // The circle of the example is as large as the example's carpet.
    config.fence.corners_m = vec![[-3.0, -3.0], [3.0, -3.0], [3.0, 3.0], [-3.0, 3.0]];
    let simulation = SimulationConfig::default();
    config
        .motion_capture
        .rigid_body
        .clone_from(&simulation.cameras.car.name);

    let (line_in, line) = RingBuffer::new(4_096);
    let (mut serial_in, serial) = RingBuffer::new(2_048);
    let (returned, _) = RingBuffer::new(2);
    let (observations_in, observations) = RingBuffer::new(64);
    let (requests_in, requests) = RingBuffer::new(4);
    let (setpoints_in, setpoints) = setpoint_slot();
    let (reconfigured, reconfigured_out) = RingBuffer::new(2);
    let (ticks_in, ticks) = tick_feed(4);
    let (reports_in, reports) = RingBuffer::new(64);
    serial_in
        .push(SerialEvent::Opened(RingLine(line_in)))
        .unwrap();
    let controller = Controller::new(
        LinkSession::new(config.link(7)).unwrap(),
        Pilot::new(config.pilot().unwrap()),
    );
    let mut control = ControlLoop::new(
        controller,
        Rings {
            serial,
            returned,
            observations,
            requests,
            setpoints,
            reconfigured,
            ticks: ticks_in,
            reports: reports_in,
        },
        true,
    );
    control.real_time(RealTimeState {
        fifo: true,
        memory_locked: true,
    });
    let outside = Outside {
        world: World::new(simulation).unwrap(),
        mocap: MocapSession::new(config.motion_capture.session().unwrap()).unwrap(),
        serial: serial_in,
        observations: observations_in,
        line,
        ticks,
        reports,
        requests: requests_in,
        setpoints: setpoints_in,
        reconfigured: reconfigured_out,
        config,
        bytes: Vec::new(),
        last_frame: 0,
        stuck: false,
    };
    (control, outside)
}

pub(crate) const PERIOD_US: u64 = 10_000;
pub(crate) const STEP_US: u64 = 500;

pub(crate) fn tick(control: &mut ControlLoop<RingLine>, index: u64) {
    let now_ns = index * PERIOD_US * 1_000;
    let slot = Slot {
        scheduled_ns: now_ns,
        start_ns: now_ns,
        skipped: 0,
    };
    control.tick(slot, &|| now_ns);
}

/// Runs until the car has driven for a second; the number of the next tick.
pub(crate) fn drive(control: &mut ControlLoop<RingLine>, outside: &mut Outside) -> u64 {
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
