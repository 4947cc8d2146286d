//! The host in virtual time: all its parts on one thread, `now` an argument.

use singletrack_mocap::planar::PlanarEvent;
use singletrack_pilot::{Learned, Mode, PilotRequest, RealTimeState, Tuning};
use singletrack_record::{Entry, TickRecord};

use crate::{
    cameras::{CameraReport, Sockets},
    config::{Config, ConfigError, TuningError},
    controller::Controller,
    grid::Grid,
    host::{Host, HostOptions},
    line::{Line, Port},
    reconfigure::ChangeError,
    run::requests::{ControlRequest, Stalled},
    serial::ReaderWait,
};

/// The largest number of polls of the camera receiver at one time: enough for all
/// datagrams that a socket holds.
const POLLS: u32 = 8;

/// A host that is polled in the place of its threads.
#[derive(Debug)]
pub struct VirtualHost<L> {
    host: Host<L>,
    grid: Grid,
    /// When the next tick is due, as far as is known.
    due_ns: u64,
    serial_wait: ReaderWait,
    cameras_due_ns: u64,
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
        let period_ns = host.configurations.in_force().control.period_ns();
        let grid = Grid::new(now_ns, period_ns);
        Ok(Self {
            host,
            grid,
            due_ns: grid.next_ns(),
            serial_wait: ReaderWait {
                readable: false,
                until_ns: now_ns,
            },
            cameras_due_ns: now_ns,
        })
    }

    /// The parts, read-only.
    #[must_use]
    pub const fn parts(&self) -> &Host<L> {
        &self.host
    }

    /// The controller.
    #[must_use]
    pub const fn controller(&self) -> &Controller {
        self.host.control.controller()
    }

    /// The pilot's mode after the last tick.
    #[must_use]
    pub const fn mode(&self) -> Mode {
        self.controller().pilot().mode()
    }

    /// When the next tick is due. A frame that [`poll_cameras`](Self::poll_cameras) receives
    /// may make it sooner.
    #[must_use]
    pub const fn next_tick_ns(&self) -> u64 {
        self.due_ns
    }

    /// Whether the serial reader has nothing to do before bytes arrive: its port is open, and
    /// does not hang up by itself.
    #[must_use]
    pub const fn awaits_bytes(&self) -> bool {
        self.serial_wait.readable
    }

    /// When the camera receiver is to be polled at the latest, even if no datagram arrives.
    #[must_use]
    pub const fn cameras_due_ns(&self) -> u64 {
        self.cameras_due_ns
    }

    /// Runs the serial reader at `now_ns`. Returns whether it read bytes.
    pub fn poll_serial(&mut self, now_ns: u64, port: &mut impl Port<Line = L>) -> bool {
        let before = self.host.reader.counters().bytes;
        self.serial_wait = self.host.reader.poll(&|| now_ns, port);
        self.host.reader.counters().bytes > before
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
            self.cameras_due_ns = self.host.receiver.poll(&|| now_ns, sockets, on_event);
            if self.cameras_due_ns > now_ns {
                break;
            }
        }
        self.due_ns = self.host.control.due_ns(&self.grid);
    }

    /// Runs a tick of the control loop that wakes up at `now_ns`.
    pub fn tick(&mut self, now_ns: u64) {
        self.host.control.wake_up(&mut self.grid, &|| now_ns);
        self.due_ns = self.host.control.due_ns(&self.grid);
    }

    /// Takes the record of the next tick, and drops all other reports. See
    /// [`entries`](Self::entries) to take everything.
    pub fn next_tick(&mut self) -> Option<TickRecord> {
        while self.host.reports.pop().is_ok() {}
        while self.host.camera_reports.pop().is_ok() {}
        self.host.ticks.pop()
    }

    /// Passes all entries for the record since the last call to `take`, in the order of
    /// the daemon's collector.
    pub fn entries(&mut self, take: &mut impl FnMut(Entry)) {
        while let Ok(report) = self.host.reports.pop() {
            report.entry().into_iter().for_each(&mut *take);
        }
        while let Ok(report) = self.host.camera_reports.pop() {
            if let CameraReport::Observation(observation) = report {
                take(Entry::Pose(observation));
            }
        }
        while let Some(tick) = self.host.ticks.pop() {
            take(Entry::Tick(tick));
        }
    }

    /// Sends a request to the pilot.
    ///
    /// # Errors
    ///
    /// [`Stalled`] if the control loop has not taken the earlier requests.
    pub fn request(&self, request: PilotRequest) -> Result<(), Stalled> {
        self.host.requests.push(ControlRequest::Pilot(request))
    }

    /// Arms the car, held, and lets its reference begin at `begin_ns`.
    ///
    /// # Errors
    ///
    /// As [`request`](Self::request).
    pub fn arm_at(&self, begin_ns: u64) -> Result<(), Stalled> {
        self.host.requests.push(ControlRequest::ArmAt(begin_ns))
    }

    /// Tells the pilot what is learned, with the next tick.
    ///
    /// # Errors
    ///
    /// As [`request`](Self::request).
    pub fn learned(&self, learned: Learned) -> Result<(), Stalled> {
        self.host.requests.push(ControlRequest::Learned(learned))
    }

    /// Tunes the pilot with the next tick.
    ///
    /// # Errors
    ///
    /// The configuration in force does not allow it.
    pub fn tune(&self, tuning: Tuning) -> Result<(), TuningError> {
        let tuned = self.controller().pilot().tuned();
        let rule = self.host.configurations.in_force().tuning_rule();
        rule.check(&tuning, tuned.as_ref())?;
        self.host.tunings.send(tuning);
        Ok(())
    }

    /// Hands another configuration to the control loop, which refuses it after
    /// `until_ns`.
    ///
    /// # Errors
    ///
    /// The reason why it can't be handed over.
    pub fn reconfigure(&mut self, config: Config, until_ns: u64) -> Result<(), ChangeError> {
        self.host
            .configurations
            .begin(config, until_ns, &self.host.requests)
    }

    /// The outcome of the change that is underway; `None` while there is none.
    pub fn settle(&mut self) -> Option<Result<u32, ChangeError>> {
        self.host.configurations.settle()
    }
}
