//! The daemon's controller and the simulator in one loop of virtual time.
//!
//! Everything is real but the clock and the two cables: link session, motion
//! capture session, pilot, board code, bytes paced at the baud rate, NatNet
//! packets. The same seed gives the same bits.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};

use singletrack_control::{Mode, Pilot, PilotConfig, RealTimeState, Reason, Request, Time};
use singletrack_link::{Event as LinkEvent, Session as LinkSession, SessionConfig};
use singletrack_mocap::SessionEvent;
use singletrack_mocap::planar::{
    Observation, PlanarConfig as MocapConfig, PlanarEvent, PlanarOutcome,
    PlanarSession as MocapSession,
};
use singletrack_record::{DriveWrite, Entry, TickRecord};
use singletrack_sim::{Destination, SimulationConfig, Truth, World};
use singletrackd::{
    controller::{Controller, Sent, Tick},
    link_entry, link_phase,
    serial_port::drive_number,
};

/// How often the host looks for bytes and packets, in µs: their receive times
/// are late by up to this.
const HOST_POLL_US: u64 = 250;

/// Where the host's datagrams come from, as the simulated server sees it.
const HOST_ADDRESS: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 40_000);

/// Longer than any handshake, in s: bootloader, ESC arming, estimator.
const READY_TIMEOUT: f64 = 15.0;

/// What a virtual drive is made of.
#[derive(Clone, Debug)]
pub struct VirtualDriveConfig {
    /// The world.
    pub simulation: SimulationConfig,
    /// The pilot.
    pub pilot: PilotConfig,
    /// The session with the board.
    pub link: SessionConfig,
    /// The session with the cameras.
    pub motion_capture: MocapConfig,
    /// The control period, in µs.
    pub period_us: u64,
}

/// Why a virtual drive could not be set up or did not get going.
#[derive(Debug, thiserror::Error)]
pub enum VirtualDriveError {
    /// The world can't be simulated.
    #[error("[simulation] {0}")]
    Simulation(#[from] singletrack_sim::ConfigError),
    /// The board would not take its configuration.
    #[error("[board] {0}")]
    Board(#[from] singletrack_protocol::ConfigurationError),
    /// The motion capture can't be configured so.
    #[error("[motion_capture] {0}")]
    MotionCapture(#[from] singletrack_mocap::planar::PlanarConfigError),
    /// The pilot never became ready, or did not start to drive.
    #[error("the car did not start: mode {mode} after {seconds} s, because of {}", reason.map_or("nothing", Reason::name))]
    NotStarted {
        /// The mode that it stayed in.
        mode: Mode,
        /// Why.
        reason: Option<Reason>,
        /// How long it was given.
        seconds: f64,
    },
}

/// A tick, with what was true just before it.
#[derive(Clone, Debug)]
pub struct VirtualTick {
    /// The tick's time.
    pub now: Time,
    /// What was really so, before the tick's command.
    pub truth: Truth,
    /// What the controller saw and did.
    pub tick: Tick,
}

/// A controller and a world.
#[derive(Debug)]
pub struct VirtualDrive {
    world: World,
    controller: Controller,
    motion_capture: MocapSession,
    period_us: u64,
    next_tick_us: u64,
    host_us: u64,
    bytes: Vec<u8>,
    record: Option<Entries>,
}

/// What a record of the drive would hold.
#[derive(Debug, Default)]
struct Entries {
    waiting: Vec<Entry>,
    ticks: u64,
}

impl Entries {
    fn tick(&mut self, now: Time, tick: &Tick, drive: Option<DriveWrite>, link: &LinkSession) {
        self.waiting.push(Entry::Tick(TickRecord {
            index: self.ticks,
            // Virtual ticks take no time.
            scheduled_ns: now.0,
            start_ns: now.0,
            finish_ns: now.0,
            skipped: 0,
            pilot_time: now,
            events: tick.events.clone(),
            events_dropped: tick.dropped_events,
            output: tick.output,
            drive,
            link: link_phase(&link.state()),
        }));
        self.ticks += 1;
    }
}

impl VirtualDrive {
    /// Powers everything on.
    ///
    /// # Errors
    ///
    /// A configuration that one of the parts refuses.
    pub fn new(config: VirtualDriveConfig) -> Result<Self, VirtualDriveError> {
        let mut controller =
            Controller::new(LinkSession::new(config.link)?, Pilot::new(config.pilot));
        // Virtual time is kept to the nanosecond.
        controller.real_time(RealTimeState {
            fifo: true,
            memory_locked: true,
        });
        controller.port_opened(Time(0));
        Ok(Self {
            world: World::new(config.simulation)?,
            controller,
            motion_capture: MocapSession::new(config.motion_capture)?,
            period_us: config.period_us,
            next_tick_us: config.period_us,
            host_us: 0,
            bytes: Vec::with_capacity(256),
            record: None,
        })
    }

    /// Keeps what a record holds of everything from now on, for
    /// [`VirtualDrive::entries`]. For a replay it must be from the first tick on.
    pub fn keep_entries(&mut self) {
        self.record = Some(Entries::default());
    }

    /// What was kept since the last time, in order.
    pub fn entries(&mut self) -> Vec<Entry> {
        let record = self.record.as_mut();
        record.map_or_else(Vec::new, |record| core::mem::take(&mut record.waiting))
    }

    /// The world.
    #[must_use]
    pub const fn world(&self) -> &World {
        &self.world
    }

    /// The world, to break something.
    pub const fn world_mut(&mut self) -> &mut World {
        &mut self.world
    }

    /// The controller.
    #[must_use]
    pub const fn controller(&self) -> &Controller {
        &self.controller
    }

    /// The controller, to ask something of it.
    pub const fn controller_mut(&mut self) -> &mut Controller {
        &mut self.controller
    }

    /// The session with the cameras.
    #[must_use]
    pub const fn motion_capture(&self) -> &MocapSession {
        &self.motion_capture
    }

    /// When the next tick is due, in µs of the simulation.
    #[must_use]
    pub const fn next_tick_us(&self) -> u64 {
        self.next_tick_us
    }

    /// Lets time pass until `until_us` of the simulation, at most until the
    /// next tick.
    pub fn advance_to(&mut self, until_us: u64, on_link: &mut impl FnMut(&LinkEvent)) {
        let until_us = until_us.min(self.next_tick_us);
        while self.host_us < until_us {
            self.host_us = (self.host_us + HOST_POLL_US).min(until_us);
            self.world.advance_to(self.host_us);
            self.exchange(on_link);
        }
    }

    /// Lets time pass until the next tick, and does it.
    pub fn step(&mut self, on_link: &mut impl FnMut(&LinkEvent)) -> VirtualTick {
        self.advance_to(self.next_tick_us, on_link);
        let now = time(self.next_tick_us);
        let truth = self.world.truth();
        let (world, record) = (&mut self.world, &mut self.record);
        let mut drive = None;
        let tick = self.controller.tick(
            now,
            &mut |frame| {
                world.host_write(frame);
                if record.is_some()
                    && let Some(number) = drive_number(frame)
                {
                    drive = Some(DriveWrite {
                        sequence: number.0,
                        written: true,
                        time_ns: now.0,
                    });
                }
                Sent::Whole
            },
            on_link,
        );
        if let Some(record) = record {
            record.tick(now, &tick, drive, self.controller.session());
        }
        self.next_tick_us += self.period_us;
        VirtualTick { now, truth, tick }
    }

    /// Waits until the car can drive, arms it, and goes on to the first driving
    /// tick, which it returns.
    ///
    /// # Errors
    ///
    /// When something keeps it from driving for 15 s.
    pub fn start(&mut self) -> Result<VirtualTick, VirtualDriveError> {
        let mut armed = false;
        while self.next_tick_us as f64 * 1e-6 < READY_TIMEOUT {
            if !armed && self.controller.pilot().mode() == Mode::Ready {
                self.controller.request(Request::Arm);
                armed = true;
            }
            let tick = self.step(&mut |_| {});
            if tick.tick.output.mode == Mode::Driving {
                return Ok(tick);
            }
        }
        Err(VirtualDriveError::NotStarted {
            mode: self.controller.pilot().mode(),
            reason: self.controller.pilot().reason(),
            seconds: READY_TIMEOUT,
        })
    }

    /// Bytes and packets both ways, at the host's time.
    fn exchange(&mut self, on_link: &mut impl FnMut(&LinkEvent)) {
        let now = time(self.host_us);
        self.bytes.clear();
        self.world.host_read(&mut self.bytes);
        if !self.bytes.is_empty() {
            let record = &mut self.record;
            self.controller.received(now, &self.bytes, &mut |event| {
                if let Some(record) = record {
                    record.waiting.extend(link_entry(now.0, event));
                }
                on_link(event);
            });
        }
        while let Some(datagram) = self.world.poll_datagram() {
            if let Destination::Client(address) = datagram.to
                && address != HOST_ADDRESS
            {
                continue;
            }
            let source = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 1510);
            if let PlanarOutcome::Frame(observation) =
                self.motion_capture
                    .handle_datagram(now.0, source, &datagram.bytes, &mut |_| {})
            {
                self.observed(&observation);
            }
        }
        let mut stale = false;
        self.motion_capture.handle_timeout(now.0, &mut |event| {
            stale |= event == PlanarEvent::Session(SessionEvent::Stale);
        });
        while let Some(datagram) = self.motion_capture.poll_transmit(now.0) {
            self.world.handle_datagram(HOST_ADDRESS, &datagram.bytes);
        }
        if stale {
            self.observed(&Observation {
                frame_number: 0,
                receive_time_ns: now.0,
                state: self.motion_capture.pose_state(now.0),
            });
        }
    }

    fn observed(&mut self, observation: &Observation) {
        if let Some(record) = &mut self.record {
            record.waiting.push(Entry::Pose(*observation));
        }
        self.controller.observed(observation);
    }
}

fn time(microseconds: u64) -> Time {
    Time(microseconds * 1000)
}
