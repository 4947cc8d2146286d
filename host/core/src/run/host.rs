//! The host: all parts that run the car, connected by their rings; and the host in virtual time, on
//! one thread, with `now` as an argument.
//!
//! ```text
//! serial reader ----ring---\                      /--ring--> ticks
//! camera receiver --ring----> control loop ------<---ring--> reports
//! requests ---------ring---/   |                  \--> the port's write half
//! set-points, jog --slot--/
//! ```
//!
//! The daemon gives each part a thread of its own. Simulations and tests poll them in
//! virtual time, see [`VirtualHost`].

use std::sync::{Arc, atomic::AtomicI64};

use rtrb::{Consumer, RingBuffer};
use singletrack_link::Session as LinkSession;
use singletrack_mocap::planar::{PlanarEvent, PlanarSession};
use singletrack_pilot::{Jog, Pilot, RealTimeState, Tuning};
use singletrack_record::{Entry, TickOutput, TickRecord, tick_feed};

use crate::{
    cameras::{CameraReceiver, CameraReport, NeighbourFeed, Sockets},
    config::{Config, ConfigError, TuningError},
    control_loop::{ControlLoop, Rings},
    controller::Controller,
    grid::Grid,
    line::{Line, Port},
    reconfigure::Configurations,
    run::{
        messages::{Report, Requests},
        proof::{Proofs, configuration_hash},
    },
    serial::{ReaderWait, SerialReader},
    slot::{SetpointSender, SlotSender, setpoint_slot, slot},
};

/// Capacities of the rings. A stall of the control loop loses nothing up to half a second,
/// a stall of the record up to two seconds.
const SERIAL_EVENTS: usize = 512;
const OBSERVATIONS: usize = 256;
const NEIGHBOURS: usize = 1_024;
const TICKS: usize = 256;
const REPORTS: usize = 512;
/// Write halves: the one in use and its successor.
const LINES: usize = 2;
/// One is underway at a time.
const RECONFIGURATIONS: usize = 2;
/// A tick has room for all of them among its events, see `controller::RESERVED`.
const REQUESTS: usize = 12;

/// Options of a host that are not in its configuration.
#[derive(Clone, Debug, Default)]
pub struct HostOptions {
    /// It must differ from one start to the next: by it the board detects a restarted host.
    pub nonce_seed: u64,
    /// Arms once, as soon as the pilot is ready.
    pub arm_when_ready: bool,
    /// Takes a configuration that the daemon refuses: only for studies of what its checks
    /// prevent. The board checks its part in any case.
    pub skip_validation: bool,
    /// The configurations that have been proved. A newly proved one is reported
    /// ([`Report::Proved`]).
    pub proofs: Proofs,
}

/// The parts of a host.
#[derive(Debug)]
pub struct Host<L> {
    /// The control loop.
    pub control: ControlLoop<L>,
    /// Reads the board's port.
    pub reader: SerialReader<L>,
    /// The session with the cameras.
    pub receiver: CameraReceiver,
    /// Sends requests to the control loop.
    pub requests: Requests,
    /// Sends set-points to the control loop.
    pub setpoints: SetpointSender,
    /// Sends the pulses of the operator who jogs to the control loop.
    pub jogs: SlotSender<Jog>,
    /// Sends values to tune to the control loop.
    pub tunings: SlotSender<Tuning>,
    /// The configuration in force.
    pub configurations: Configurations,
    /// The record of every tick.
    pub ticks: TickOutput,
    /// All other reports of the control loop.
    pub reports: Consumer<Report>,
    /// Reports of the camera receiver.
    pub camera_reports: Consumer<CameraReport>,
}

impl<L: Line> Host<L> {
    /// Checks the configuration, reads the files that it names, and connects the parts.
    ///
    /// # Errors
    ///
    /// The configuration is invalid; the error names the key.
    pub fn new(mut config: Config, options: HostOptions) -> Result<Self, ConfigError> {
        if !options.skip_validation {
            config.validate()?;
        }
        // Read once, so that pilot and record have the same waypoints.
        config.reference = config.reference.with_points_inlined()?;
        let controller = Controller::new(
            LinkSession::new(config.link(options.nonce_seed))?,
            config.steering_map()?,
            Pilot::new(config.pilot()?),
            configuration_hash(&config)?,
            options.proofs,
        );
        let mut session = config.motion_capture.session()?;
        session.tells_others = config.neighbours.enabled;
        let session = PlanarSession::new(session)
            .map_err(|error| ConfigError::value("motion_capture", "refused", error.to_string()))?;
        let stamp_offset_ns = Arc::new(AtomicI64::new(
            session.config().session.timing.stamp_offset_ns,
        ));
        let aligns = config.control.align_to_cameras;
        let aligned_ns = aligns.then(|| config.control.period_ns());

        let (serial_in, serial) = RingBuffer::new(SERIAL_EVENTS);
        let (returned, returned_out) = RingBuffer::new(LINES);
        let (observations_in, observations) = RingBuffer::new(OBSERVATIONS);
        let (neighbours_in, neighbours) = RingBuffer::new(NEIGHBOURS);
        let others = &config.neighbours;
        let feed = others
            .enabled
            .then(|| NeighbourFeed::new(others, neighbours_in));
        let (requests_in, requests) = RingBuffer::new(REQUESTS);
        let (setpoints_in, setpoints) = setpoint_slot();
        let (jogs_in, jogs) = slot();
        let (tunings_in, tunings) = slot();
        let (reconfigured, reconfigured_out) = RingBuffer::new(RECONFIGURATIONS);
        let (ticks, ticks_out) = tick_feed(TICKS);
        let (reports, reports_out) = RingBuffer::new(REPORTS);
        let (camera_reports, camera_reports_out) = RingBuffer::new(REPORTS);
        let control = ControlLoop::new(
            controller,
            Rings {
                serial,
                returned,
                observations,
                neighbours,
                requests,
                setpoints,
                jogs,
                tunings,
                reconfigured,
                ticks,
                reports,
            },
            options.arm_when_ready,
            aligned_ns,
        );
        Ok(Self {
            control,
            reader: SerialReader::new(serial_in, returned_out),
            receiver: CameraReceiver::new(
                session,
                Arc::clone(&stamp_offset_ns),
                observations_in,
                camera_reports,
                feed,
                f64::from(config.supervisor.fresh_ms) * 1e-3,
            ),
            requests: Requests::new(requests_in),
            setpoints: setpoints_in,
            jogs: jogs_in,
            tunings: tunings_in,
            configurations: Configurations::new(config, reconfigured_out, stamp_offset_ns),
            ticks: ticks_out,
            reports: reports_out,
            camera_reports: camera_reports_out,
        })
    }
}

/// The largest number of polls of the camera receiver at one time: enough for all
/// datagrams that a socket holds.
const POLLS: u32 = 8;

/// A host that is polled in the place of its threads.
#[derive(Debug)]
pub struct VirtualHost<L> {
    /// The parts.
    pub parts: Host<L>,
    grid: Grid,
    /// When the next tick is due, as far as is known. A frame that
    /// [`poll_cameras`](Self::poll_cameras) receives may make it sooner.
    pub due_ns: u64,
    /// What the serial reader waits for.
    pub serial_wait: ReaderWait,
    /// When the camera receiver is to be polled at the latest, even if no datagram arrives.
    pub cameras_due_ns: u64,
}

impl<L: Line> VirtualHost<L> {
    /// A host that starts at `now_ns`; its first tick is due a period later. The pilot is
    /// given real-time scheduling, because virtual time is exact.
    ///
    /// # Errors
    ///
    /// The configuration is invalid; the error names the key.
    pub fn new(config: Config, options: HostOptions, now_ns: u64) -> Result<Self, ConfigError> {
        let mut host = Host::new(config, options)?;
        host.control.real_time(RealTimeState {
            fifo: true,
            memory_locked: true,
        });
        let period_ns = host.configurations.in_force.control.period_ns();
        let grid = Grid::new(now_ns, period_ns);
        Ok(Self {
            parts: host,
            grid,
            due_ns: grid.next_ns,
            serial_wait: ReaderWait {
                readable: false,
                until_ns: now_ns,
            },
            cameras_due_ns: now_ns,
        })
    }

    /// Runs the serial reader at `now_ns`. Returns whether it read bytes.
    pub fn poll_serial(&mut self, now_ns: u64, port: &mut impl Port<Line = L>) -> bool {
        let before = self.parts.reader.counters.bytes;
        self.serial_wait = self.parts.reader.poll(&|| now_ns, port);
        self.parts.reader.counters.bytes > before
    }

    /// Runs the camera receiver at `now_ns`.
    pub fn poll_cameras(
        &mut self,
        now_ns: u64,
        sockets: &mut impl Sockets,
        on_event: &mut impl FnMut(&PlanarEvent),
    ) {
        // A thread polls again at once while datagrams wait.
        for _ in 0..POLLS {
            self.cameras_due_ns = self.parts.receiver.poll(&|| now_ns, sockets, on_event);
            if self.cameras_due_ns > now_ns {
                break;
            }
        }
        self.due_ns = self.parts.control.due_ns(&self.grid);
    }

    /// Runs a tick of the control loop that wakes up at `now_ns`.
    pub fn tick(&mut self, now_ns: u64) {
        self.parts.control.wake_up(&mut self.grid, &|| now_ns);
        self.due_ns = self.parts.control.due_ns(&self.grid);
    }

    /// Takes the record of the next tick, and drops all other reports. See
    /// [`entries`](Self::entries) to take everything.
    pub fn next_tick(&mut self) -> Option<TickRecord> {
        while self.parts.reports.pop().is_ok() {}
        while self.parts.camera_reports.pop().is_ok() {}
        self.parts.ticks.pop()
    }

    /// Passes all entries for the record since the last call to `take`, in the order of
    /// the daemon's collector.
    pub fn entries(&mut self, take: &mut impl FnMut(Entry)) {
        while let Ok(report) = self.parts.reports.pop() {
            report.entry().into_iter().for_each(&mut *take);
        }
        while let Ok(report) = self.parts.camera_reports.pop() {
            if let CameraReport::Observation(observation) = report {
                take(Entry::Pose(observation));
            }
        }
        while let Some(tick) = self.parts.ticks.pop() {
            take(Entry::Tick(tick));
        }
    }

    /// Tunes the pilot with the next tick.
    ///
    /// # Errors
    ///
    /// The configuration in force does not allow it.
    pub fn tune(&self, tuning: Tuning) -> Result<(), TuningError> {
        let tuned = self.parts.control.controller.pilot.tuned();
        let rule = self.parts.configurations.in_force.tuning_rule();
        rule.check(&tuning, tuned.as_ref())?;
        self.parts.tunings.send(tuning);
        Ok(())
    }
}
