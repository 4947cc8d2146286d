//! The daemon's host loop and the simulator, in virtual time.
//!
//! Only the clock, the serial line and the network are replaced. The host with its rings,
//! the board's code, bytes paced at the baud rate and NatNet packets are real. The same
//! seed gives the same bits.

use std::{
    net::{IpAddr, Ipv4Addr, SocketAddr},
    sync::{Arc, Mutex, PoisonError},
};

use singletrack_control::{Estimate, Position, Setpoint, Time, Velocity};
use singletrack_core::{
    ConfigError, ControlRequest, HostOptions, Stalled, VirtualHost,
    cameras::{Channel, Sockets},
    config::{Config, ReferenceSection},
    controller::Controller,
    line::{Line, Port, PortRead, Sent},
    reconfigure::ChangeError,
};
use singletrack_pilot::{Arming, Learned, Mode, PilotRequest, Reason};
use singletrack_record::{ConfigurationRecord, Entry, TickRecord};
use singletrack_sim::{Destination, SimulationConfig, Truth, World};

/// Interval at which the host polls its port and its sockets, in µs: receive times
/// are late by up to this.
const HOST_POLL_US: u64 = 250;

/// The source address of the host's datagrams.
const HOST_ADDRESS: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 40_000);

/// The port from which the server's datagrams come.
const SERVER_PORT: u16 = 1_510;

/// The time-out until the car drives, in s: longer than bootloader, ESC arming and
/// estimator take.
pub(crate) const READY_TIMEOUT: f64 = 15.0;

/// Why a virtual drive could not be set up or started.
#[derive(Debug, thiserror::Error)]
pub enum VirtualDriveError {
    /// The world can't be simulated.
    #[error("[simulation] {0}")]
    Simulation(#[from] singletrack_sim::ConfigError),
    /// The host refuses its configuration.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The pilot never became ready, or did not start to drive.
    #[error("the car did not start: mode {mode} after {seconds} s, because of {}", reason.map_or("nothing", Reason::name))]
    NotStarted {
        /// The mode at the time-out.
        mode: Mode,
        /// The reason for this mode.
        reason: Option<Reason>,
        /// The time-out, in s.
        seconds: f64,
    },
}

/// A tick, with the ground truth just before it.
#[derive(Clone, Debug)]
pub struct VirtualTick {
    /// The tick's time.
    pub now: Time,
    /// The ground truth before the tick's command.
    pub truth: Truth,
    /// The record of the tick.
    pub tick: TickRecord,
}

/// A host and a world.
#[derive(Debug)]
pub struct VirtualDrive {
    // Both are large; a drive is moved from function to function.
    /// The world.
    pub world: Box<World>,
    host: Box<VirtualHost<WriteHalf>>,
    port: SimulatedPort,
    host_us: u64,
    /// The entries for a record of the drive; `None` if they are not kept.
    entries: Option<Vec<Entry>>,
    knows_the_truth: bool,
}

/// The write half of the simulated port: frames wait until the world takes them.
#[derive(Clone, Debug, Default)]
struct WriteHalf(Arc<Mutex<Vec<u8>>>);

impl Line for WriteHalf {
    fn write_frame(&mut self, frame: &[u8]) -> Sent {
        let mut written = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        written.extend_from_slice(frame);
        Sent::Whole
    }
}

/// The port of the simulated board, which is always plugged in.
#[derive(Debug, Default)]
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

/// The sockets to the simulated cameras.
struct SimulatedSockets<'a>(&'a mut World);

impl Sockets for SimulatedSockets<'_> {
    fn receive(&mut self, channel: Channel, buffer: &mut [u8]) -> Option<(usize, SocketAddr)> {
        if channel == Channel::Data {
            return None;
        }
        loop {
            let datagram = self.0.poll_datagram()?;
            if let Destination::Client(address) = datagram.to
                && address != HOST_ADDRESS
            {
                continue;
            }
            let bytes = &datagram.bytes;
            if let Some(room) = buffer.get_mut(..bytes.len()) {
                room.copy_from_slice(bytes);
                let address = datagram.from.unwrap_or(Ipv4Addr::LOCALHOST);
                return Some((bytes.len(), (address, SERVER_PORT).into()));
            }
        }
    }

    fn send(&mut self, _: SocketAddr, bytes: &[u8]) {
        self.0.handle_datagram(HOST_ADDRESS, bytes);
    }
}

/// The truth as an estimate of a tick, with a pose of that moment.
const fn perfect_estimate(truth: &Truth, now_ns: u64) -> Estimate {
    let now = Time(now_ns);
    Estimate {
        time: now,
        position: Position::new(truth.x, truth.y),
        yaw: truth.yaw,
        yaw_rate: truth.yaw_rate,
        sideslip: truth.sideslip,
        speed: truth.speed,
        pose_time: now,
    }
}

impl VirtualDrive {
    /// Powers everything on. `seed` is that of the host's session with the board.
    ///
    /// # Errors
    ///
    /// One of the parts refuses its configuration.
    pub fn new(
        config: Config,
        seed: u64,
        simulation: SimulationConfig,
    ) -> Result<Self, VirtualDriveError> {
        let options = HostOptions {
            nonce_seed: seed,
            ..HostOptions::default()
        };
        Self::with_options(config, simulation, options)
    }

    /// [`new`](Self::new) with the options of the host.
    ///
    /// # Errors
    ///
    /// One of the parts refuses its configuration.
    pub fn with_options(
        config: Config,
        simulation: SimulationConfig,
        options: HostOptions,
    ) -> Result<Self, VirtualDriveError> {
        let mut drive = Self {
            world: Box::new(World::new(simulation)?),
            host: Box::new(VirtualHost::new(config, options, 0)?),
            port: SimulatedPort::default(),
            host_us: 0,
            entries: None,
            knows_the_truth: false,
        };
        drive.exchange();
        Ok(drive)
    }

    /// From now on law and outer loop get the truth for the estimate: what is off then, no better
    /// estimate can mend.
    pub const fn know_the_truth(&mut self) {
        self.knows_the_truth = true;
    }

    /// Keeps all entries for a record from now on, see [`VirtualDrive::entries`]. A record
    /// for a replay needs them from the first tick on.
    pub fn keep_entries(&mut self) {
        self.entries = Some(Vec::new());
    }

    /// The entries kept since the last call, in order.
    pub fn entries(&mut self) -> Vec<Entry> {
        self.entries.as_mut().map_or_else(Vec::new, core::mem::take)
    }

    /// The daemon's host: its requests, set-points and state.
    pub const fn host(&self) -> &VirtualHost<impl Line + use<>> {
        &self.host
    }

    /// The controller.
    pub const fn controller(&self) -> &Controller {
        &self.host.parts.control.controller
    }

    /// The pilot's mode after the last tick.
    pub const fn mode(&self) -> Mode {
        self.controller().pilot.mode()
    }

    /// Sends a request to the pilot, for the next tick.
    ///
    /// # Errors
    ///
    /// [`Stalled`] if the control loop has not taken the earlier requests.
    pub fn request(&self, request: PilotRequest) -> Result<(), Stalled> {
        let request = ControlRequest::Pilot(request);
        self.host.parts.requests.push(request)
    }

    /// Tells the pilot what is learned, with the next tick.
    ///
    /// # Errors
    ///
    /// As [`request`](Self::request).
    pub fn learned(&self, learned: Learned) -> Result<(), Stalled> {
        let request = ControlRequest::Learned(learned);
        self.host.parts.requests.push(request)
    }

    /// Gives an external reference its newest set-point.
    pub fn send_setpoint(&self, setpoint: &Setpoint) {
        self.host.parts.setpoints.send(setpoint);
    }

    /// Changes the configuration at the next tick. Returns its number.
    ///
    /// # Errors
    ///
    /// The reason why the configuration in force stays.
    pub fn reconfigure(&mut self, config: Config) -> Result<u32, ChangeError> {
        let host = &mut self.host.parts;
        host.configurations
            .begin(config, u64::MAX, &host.requests)?;
        loop {
            self.step();
            if let Some(outcome) = self.host.parts.configurations.settle() {
                let number = outcome?;
                self.keep_configuration(number);
                return Ok(number);
            }
        }
    }

    /// When the next tick is due, in µs of the simulation, rounded up. A frame may make it sooner.
    pub const fn next_tick_us(&self) -> u64 {
        self.host.due_ns.div_ceil(1_000)
    }

    /// The present time of the simulation, in µs.
    pub const fn now_us(&self) -> u64 {
        self.host_us
    }

    /// Advances to `until_us` of the simulation, at most to the next tick. Returns false if that
    /// is due: a frame may begin it sooner than was foreseen.
    pub fn advance_to(&mut self, until_us: u64) -> bool {
        loop {
            let next_us = self.next_tick_us();
            if self.host_us >= next_us {
                return false;
            }
            let until_us = until_us.min(next_us);
            if self.host_us >= until_us {
                return true;
            }
            let next_us = (self.host_us / HOST_POLL_US + 1) * HOST_POLL_US;
            self.host_us = next_us.min(until_us);
            self.world.advance_to(self.host_us);
            self.exchange();
        }
    }

    /// Advances to the next tick and runs it.
    pub fn step(&mut self) -> VirtualTick {
        loop {
            self.advance_to(u64::MAX);
            let now_ns = self.host_us * 1_000;
            let truth = self.world.truth();
            if self.knows_the_truth {
                let pilot = &mut self.host.parts.control.controller.pilot;
                pilot.assume(perfect_estimate(&truth, now_ns));
            }
            self.host.tick(now_ns);
            self.write();
            if let Some(tick) = self.take_tick() {
                let now = tick.pilot_time;
                return VirtualTick { now, truth, tick };
            }
        }
    }

    /// Waits until the car can drive, arms it, and goes on to the first driving
    /// tick, which it returns. An external reference gets standstill as its set-point.
    ///
    /// # Errors
    ///
    /// The car does not drive within 15 s.
    pub fn start(&mut self) -> Result<VirtualTick, VirtualDriveError> {
        self.start_with(&mut |_| {})
    }

    /// [`start`](Self::start) that passes on every tick.
    ///
    /// # Errors
    ///
    /// As [`start`](Self::start).
    pub fn start_with(
        &mut self,
        on_tick: &mut impl FnMut(&VirtualTick),
    ) -> Result<VirtualTick, VirtualDriveError> {
        let reference = &self.host.parts.configurations.in_force.reference;
        let is_external = matches!(reference, ReferenceSection::External { .. });
        let mut armed = false;
        while self.next_tick_us() < (READY_TIMEOUT * 1e6) as u64 {
            if !armed && self.mode() == Mode::Ready {
                // The ring is empty: every tick takes all requests.
                armed = self.request(PilotRequest::Arm(Arming::Unattended)).is_ok();
            }
            let tick = self.step();
            on_tick(&tick);
            if tick.tick.output.mode == Mode::Driving {
                return Ok(tick);
            }
            if is_external {
                // Without a set-point the car is not armed.
                self.send_setpoint(&Setpoint::point(tick.now, None, Velocity::zeros()));
            }
        }
        Err(self.not_started())
    }

    /// Why it has not started.
    pub(crate) fn not_started(&self) -> VirtualDriveError {
        VirtualDriveError::NotStarted {
            mode: self.mode(),
            reason: self.controller().pilot.reason(),
            seconds: READY_TIMEOUT,
        }
    }

    /// Exchanges bytes and datagrams in both directions, at the host's time.
    fn exchange(&mut self) {
        let now_ns = self.host_us * 1_000;
        self.world.host_read(&mut self.port.received);
        if !self.port.received.is_empty() || !self.host.serial_wait.readable {
            self.host.poll_serial(now_ns, &mut self.port);
        }
        if self.world.has_datagrams() || self.host.cameras_due_ns <= now_ns {
            self.host
                .poll_cameras(now_ns, &mut SimulatedSockets(&mut self.world), &mut |_| {});
        }
    }

    /// Passes the bytes that the tick wrote to the line.
    fn write(&mut self) {
        let written = self.port.line.0.lock();
        let mut written = written.unwrap_or_else(PoisonError::into_inner);
        self.world.host_write(&written);
        written.clear();
    }

    /// Takes the record of the tick that just ended.
    fn take_tick(&mut self) -> Option<TickRecord> {
        let Some(kept) = &mut self.entries else {
            return self.host.next_tick();
        };
        let mut last = None;
        self.host.entries(&mut |entry| {
            if let Entry::Tick(tick) = &entry {
                last = Some(tick.clone());
            }
            kept.push(entry);
        });
        last
    }

    fn keep_configuration(&mut self, number: u32) {
        let in_force = &self.host.parts.configurations.in_force;
        if let Some(kept) = &mut self.entries
            && let Ok(toml) = in_force.to_toml()
        {
            kept.push(Entry::Configuration(ConfigurationRecord {
                time_ns: self.host_us * 1_000,
                number,
                toml,
            }));
        }
    }
}
