//! A host and the simulated car that it drives, in virtual time.

#![allow(dead_code, reason = "each test uses its part of it")]

use std::{
    net::{IpAddr, Ipv4Addr, SocketAddr},
    sync::{Arc, Mutex},
};

use singletrack_core::{
    Config, ControlRequest, Host, HostOptions, Refusal,
    cameras::{CameraReport, Channel, Sockets},
    grid::Slot,
    line::{Line, Port, PortRead, Sent},
    reconfigure::ChangeError,
};
use singletrack_pilot::{Mode, Output, RealTimeState};
use singletrack_protocol::BoardMode;
use singletrack_sim::{Destination, SimulationConfig, World};

pub(crate) const PERIOD_US: u64 = 10_000;
/// A lower bound of the simulated car's deceleration at neutral.
const BRAKING_M_S2: f64 = 0.9;
const STEP_US: u64 = 500;

/// The capacity of the simulated line, in bytes.
const LINE: usize = 4_096;

const HOST: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 40_000);
const SERVER: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 1_510);

/// The write half of the simulated port. It never allocates.
#[derive(Clone)]
pub(crate) struct WriteHalf(Arc<Mutex<Vec<u8>>>);

impl Line for WriteHalf {
    fn write_frame(&mut self, frame: &[u8]) -> Sent {
        let mut written = self.0.lock().unwrap();
        if written.len() + frame.len() > LINE {
            return Sent::Dropped;
        }
        written.extend_from_slice(frame);
        Sent::Whole
    }
}

/// The port of the simulated board, which is always plugged in.
struct SimulatedPort {
    received: Vec<u8>,
    line: WriteHalf,
}

impl Port for SimulatedPort {
    type Line = WriteHalf;

    fn open(&mut self) -> Option<WriteHalf> {
        Some(self.line.clone())
    }

    fn read(&mut self, buffer: &mut [u8]) -> PortRead {
        let count = buffer.len().min(self.received.len());
        for (to, from) in buffer.iter_mut().zip(self.received.drain(..count)) {
            *to = from;
        }
        match count {
            0 => PortRead::Nothing,
            count => PortRead::Bytes(count),
        }
    }

    fn close(&mut self) {}
}

/// The sockets to the simulated cameras, which send unicast.
struct SimulatedSockets<'a>(&'a mut World);

impl Sockets for SimulatedSockets<'_> {
    fn receive(&mut self, channel: Channel, buffer: &mut [u8]) -> Option<(usize, SocketAddr)> {
        if channel == Channel::Data {
            return None;
        }
        let datagram = self.0.poll_datagram()?;
        assert_eq!(datagram.to, Destination::Client(HOST));
        let length = datagram.bytes.len();
        buffer[..length].copy_from_slice(&datagram.bytes);
        Some((length, SERVER))
    }

    fn send(&mut self, _: SocketAddr, bytes: &[u8]) {
        self.0.handle_datagram(HOST, bytes);
    }
}

/// A host, its car, and the line between them.
pub(crate) struct SimulatedDrive {
    pub(crate) host: Host<WriteHalf>,
    pub(crate) world: World,
    port: SimulatedPort,
    /// The number of the newest frame that the control loop was given.
    pub(crate) last_frame: i32,
    /// All bytes from the board are lost.
    pub(crate) stuck: bool,
}

impl SimulatedDrive {
    /// The configuration of the example file on a larger carpet. The car arms as soon as the
    /// pilot is ready.
    pub(crate) fn new() -> Self {
        Self::with(Self::example(), SimulationConfig::default())
    }

    /// That configuration.
    pub(crate) fn example() -> Config {
        let mut config =
            Config::from_toml(include_str!("../../../daemon/singletrackd.example.toml")).unwrap();
        // These drives are not about the first metre of an unproved car.
        config.supervisor.prove_first_metre = false;
        config.fence.braking_m_s2 = BRAKING_M_S2;
        // From the default start the car turns round first.
        config.fence.corners_m = vec![[-3.0, -3.0], [3.0, -3.0], [3.0, 3.0], [-3.0, 3.0]];
        config
    }

    /// The configuration with the simulated cameras, and a simulated car. It arms as soon as
    /// the pilot is ready.
    pub(crate) fn with(mut config: Config, simulation: SimulationConfig) -> Self {
        config.motion_capture.server = Ipv4Addr::LOCALHOST;
        config
            .motion_capture
            .rigid_body
            .clone_from(&simulation.cameras.car.name);
        let options = HostOptions {
            nonce_seed: 7,
            arm_when_ready: true,
            ..HostOptions::default()
        };
        let mut host = Host::new(config, options).unwrap();
        host.control.real_time(RealTimeState {
            fifo: true,
            memory_locked: true,
        });
        Self {
            host,
            world: World::new(simulation).unwrap(),
            port: SimulatedPort {
                received: Vec::new(),
                line: WriteHalf(Arc::new(Mutex::new(Vec::with_capacity(LINE)))),
            },
            last_frame: 0,
            stuck: false,
        }
    }

    /// Lets time pass until the tick with this number is due.
    pub(crate) fn run_until_tick(&mut self, index: u64) {
        let tick_us = index * PERIOD_US;
        for step in (0..PERIOD_US / STEP_US).rev() {
            self.advance_to(tick_us - step * STEP_US);
        }
    }

    fn advance_to(&mut self, now_us: u64) {
        let clock = || now_us * 1_000;
        self.world.advance_to(now_us);
        self.world.host_read(&mut self.port.received);
        if self.stuck {
            self.port.received.clear();
        }
        self.host.reader.poll(&clock, &mut self.port);
        assert_eq!(self.host.reader.counters.bytes_dropped, 0);
        let mut sockets = SimulatedSockets(&mut self.world);
        self.host.receiver.poll(&clock, &mut sockets, &mut |_| {});
        assert_eq!(self.host.receiver.dropped, 0);
        while let Ok(report) = self.host.camera_reports.pop() {
            if let CameraReport::Observation(observation) = report {
                self.last_frame = observation.frame_number;
            }
        }
    }

    /// Runs the control loop for the tick with this number.
    pub(crate) fn tick(&mut self, index: u64) {
        let now_ns = index * PERIOD_US * 1_000;
        let slot = Slot {
            scheduled_ns: now_ns,
            deadline_ns: now_ns,
            start_ns: now_ns,
            skipped: 0,
        };
        self.host.control.tick(slot, &|| now_ns);
    }

    /// The bytes that the control loop has written since the last call.
    pub(crate) fn sent(&mut self) -> Vec<u8> {
        let mut written = self.port.line.0.lock().unwrap();
        let sent = written.clone();
        // Its capacity stays: a tick must not allocate.
        written.clear();
        sent
    }

    /// Passes the bytes of the tick to the board and drops its reports. Returns the mode
    /// that the tick ended in.
    pub(crate) fn after_tick(&mut self) -> Option<Mode> {
        self.output().map(|output| output.mode)
    }

    /// [`after_tick`](Self::after_tick) with the whole output of the tick.
    pub(crate) fn output(&mut self) -> Option<Output> {
        let sent = self.sent();
        self.world.host_write(&sent);
        while self.host.reports.pop().is_ok() {}
        self.host.ticks.pop().map(|tick| tick.output)
    }

    /// All of the above: returns the mode that the tick ended in.
    pub(crate) fn step(&mut self, index: u64) -> Option<Mode> {
        self.run_until_tick(index);
        self.tick(index);
        self.after_tick()
    }

    /// Runs until the car has driven for a second; the number of the next tick.
    pub(crate) fn start_driving(&mut self) -> u64 {
        let mut driving = 0;
        for index in 1..2_000 {
            driving += u64::from(self.step(index) == Some(Mode::Driving));
            if driving == 100 {
                return index + 1;
            }
        }
        panic!("the car never drove");
    }

    pub(crate) fn board_mode(&self) -> Option<BoardMode> {
        let code = self.world.board.code()?;
        Some(code.mode())
    }

    /// The configuration in force.
    pub(crate) fn config(&self) -> Config {
        self.host.configurations.in_force.clone()
    }

    pub(crate) fn request(&self, request: ControlRequest) {
        self.host.requests.push(request).unwrap();
    }

    /// Hands another configuration to the control loop.
    pub(crate) fn reconfigure(&mut self, config: Config, until_ns: u64) {
        self.host
            .configurations
            .begin(config, until_ns, &self.host.requests)
            .unwrap();
    }

    /// The outcome of the change.
    pub(crate) fn outcome(&mut self) -> Result<(), Refusal> {
        match self.host.configurations.settle().unwrap() {
            Ok(_) => Ok(()),
            Err(ChangeError::Refused(refusal)) => Err(refusal),
            Err(error) => panic!("{error}"),
        }
    }
}
