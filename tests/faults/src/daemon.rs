//! The daemon's threads around the shipped control loop, in virtual time.
//!
//! The control loop with link session and pilot, the motion capture session and
//! the rings between them are the daemon's own. What its serial reader, its
//! receiver and its control thread do around them is retold here.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};

use rtrb::{Consumer, Producer, RingBuffer};
use singletrack_control::{Pilot, RealTimeState, Request};
use singletrack_link::Session as LinkSession;
use singletrack_mocap::planar::{
    Observation, PlanarOutcome, PlanarSession as MocapSession, PoseState,
};
use singletrack_record::{TickOutput, TickRecord, tick_feed};
use singletrackd::{
    Report,
    config::Config,
    control_loop::{ControlLoop, ControlRequest, Rings, Slot},
    controller::Controller,
    serial_reader::{CHUNK, Chunk, SerialEvent},
    setpoint_slot::setpoint_slot,
};

use crate::{
    Trouble,
    port::{Port, WriteHalf},
};

/// What the host's clock shows when everything is switched on, in ns.
const EPOCH_NS: u64 = 1_000_000_000_000;

/// As in the daemon.
const SERIAL_EVENTS: usize = 512;
const OBSERVATIONS: usize = 256;
const REQUESTS: usize = 12;
const RESERVED: usize = 4;

/// The host's clock at a simulation time.
pub(crate) const fn host_ns(now_us: u64) -> u64 {
    EPOCH_NS + now_us * 1_000
}

/// A daemon that runs.
#[derive(Debug)]
pub(crate) struct Daemon {
    control: ControlLoop<WriteHalf>,
    serial: Producer<SerialEvent<WriteHalf>>,
    returned: Consumer<WriteHalf>,
    observations: Producer<Observation>,
    requests: Producer<ControlRequest>,
    ticks: TickOutput,
    reports: Consumer<Report>,
    cameras: MocapSession,
    is_stale: bool,
    last_frame: i32,
    /// Where its datagrams come from.
    pub(crate) address: SocketAddr,
    period_ns: u64,
    next_tick_ns: u64,
    has_port: bool,
}

impl Daemon {
    /// The `number`-th daemon of a drive, started at `now_us`.
    pub(crate) fn start(
        config: &Config,
        nonce_seed: u64,
        number: u16,
        now_us: u64,
    ) -> Result<Self, Trouble> {
        let link = LinkSession::new(config.link(nonce_seed)).map_err(|error| Trouble::Setting {
            what: "the board's configuration",
            reason: error.to_string(),
        })?;
        let controller =
            Controller::new(link, Pilot::new(config.pilot().map_err(Trouble::Config)?));
        let cameras = config.motion_capture.session().map_err(Trouble::Config)?;
        let cameras = MocapSession::new(cameras).map_err(|error| Trouble::Setting {
            what: "the motion capture",
            reason: error.to_string(),
        })?;
        let (serial, serial_out) = RingBuffer::new(SERIAL_EVENTS);
        let (returned_in, returned) = RingBuffer::new(2);
        let (observations, observations_out) = RingBuffer::new(OBSERVATIONS);
        let (requests, requests_out) = RingBuffer::new(REQUESTS);
        let (_, setpoints) = setpoint_slot();
        let (reconfigured, _) = RingBuffer::new(1);
        // They are fetched after every tick.
        let (ticks_in, ticks) = tick_feed(2);
        let (reports_in, reports) = RingBuffer::new(256);
        let period_ns = u64::from(config.control.period_ms) * 1_000_000;
        let mut control = ControlLoop::new(
            controller,
            Rings {
                serial: serial_out,
                returned: returned_in,
                observations: observations_out,
                requests: requests_out,
                setpoints,
                reconfigured,
                ticks: ticks_in,
                reports: reports_in,
            },
            false,
        )
        .aligned_to_cameras(period_ns);
        control.real_time(RealTimeState {
            fifo: true,
            memory_locked: true,
        });
        Ok(Self {
            control,
            serial,
            returned,
            observations,
            requests,
            ticks,
            reports,
            cameras,
            is_stale: false,
            last_frame: 0,
            address: SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 40_000 + number),
            period_ns,
            next_tick_ns: host_ns(now_us) + period_ns,
            has_port: false,
        })
    }

    /// Simulation time of the next tick, in µs, rounded up.
    pub(crate) const fn next_tick_us(&self) -> u64 {
        (self.next_tick_ns - EPOCH_NS).div_ceil(1_000)
    }

    pub(crate) const fn has_port(&self) -> bool {
        self.has_port
    }

    /// The serial reader has opened the port.
    pub(crate) fn open_port(&mut self, port: &mut Port) {
        self.has_port = self.serial.push(SerialEvent::Opened(port.open())).is_ok();
    }

    /// The serial reader reads: the port has hung up, or there are bytes.
    /// Returns whether there were bytes.
    pub(crate) fn read_port(&mut self, now_us: u64, port: &mut Port, buffer: &mut Vec<u8>) -> bool {
        let time_ns = host_ns(now_us);
        let mut has_read = false;
        if !self.has_port {
            return has_read;
        }
        if !port.is_plugged() {
            // Handed over until there is room.
            self.has_port = self.serial.push(SerialEvent::Closed { time_ns }).is_err();
            return has_read;
        }
        loop {
            port.read(CHUNK, buffer);
            if buffer.is_empty() {
                return has_read;
            }
            has_read = true;
            // Without room they are dropped, as by the daemon.
            let _ = self
                .serial
                .push(SerialEvent::Bytes(Chunk::new(time_ns, buffer)));
        }
    }

    /// The receiver takes a datagram.
    pub(crate) fn receive(&mut self, now_us: u64, source: SocketAddr, datagram: &[u8]) {
        if let PlanarOutcome::Frame(observation) =
            self.cameras
                .handle_datagram(host_ns(now_us), source, datagram, &mut |_| {})
        {
            self.is_stale = false;
            self.last_frame = observation.frame_number;
            let _ = self.observations.push(observation);
        }
    }

    /// The receiver looks what there is to say to the server.
    pub(crate) fn talk(&mut self, now_us: u64, mut send: impl FnMut(SocketAddr, &[u8])) {
        let now_ns = host_ns(now_us);
        self.cameras.handle_timeout(now_ns, &mut |_| {});
        while let Some(datagram) = self.cameras.poll_transmit(now_ns) {
            send(self.address, &datagram.bytes);
        }
        let state = self.cameras.pose_state(now_ns);
        if matches!(state, PoseState::Stale { .. }) && !self.is_stale {
            self.is_stale = true;
            let _ = self.observations.push(Observation {
                frame_number: self.last_frame,
                receive_time_ns: now_ns,
                state,
            });
        }
    }

    /// The socket takes a request; false when there is no room for it.
    pub(crate) fn ask(&mut self, request: Request) -> bool {
        if request != Request::EmergencyStop && self.requests.slots() <= RESERVED {
            return false;
        }
        self.requests.push(ControlRequest::Pilot(request)).is_ok()
    }

    /// The control thread wakes up and does a tick.
    pub(crate) fn tick(&mut self, now_us: u64) -> Option<TickRecord> {
        let start_ns = host_ns(now_us);
        let skipped = start_ns.saturating_sub(self.next_tick_ns) / self.period_ns;
        let scheduled_ns = self.next_tick_ns + skipped * self.period_ns;
        let slot = Slot {
            scheduled_ns,
            start_ns,
            skipped: u32::try_from(skipped).unwrap_or(u32::MAX),
        };
        self.control.tick(slot, &|| start_ns);
        self.next_tick_ns =
            (scheduled_ns + self.period_ns).saturating_add_signed(self.control.slide_ns());
        while self.returned.pop().is_ok() {}
        while self.reports.pop().is_ok() {}
        self.ticks.pop()
    }
}
