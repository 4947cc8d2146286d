//! The host in virtual time: all its parts on one thread, `now` an argument.

use singletrack_mocap::planar::PlanarEvent;
use singletrack_pilot::{Mode, PilotRequest, RealTimeState};
use singletrack_record::{Entry, TickRecord};

use crate::{
    cameras::{CameraReport, Sockets},
    config::{Config, ConfigError},
    controller::Controller,
    grid::Grid,
    host::{Host, HostOptions},
    line::{Line, Port},
    reconfigure::ChangeError,
    requests::{ControlRequest, Stalled},
};

/// Polls of the camera receiver without time passing: for more datagrams than any
/// socket holds.
const POLLS: u32 = 8;

/// A host whose threads are polled.
#[derive(Debug)]
pub struct VirtualHost<L> {
    host: Host<L>,
    grid: Grid,
}

impl<L: Line> VirtualHost<L> {
    /// A host that starts at `now_ns`; its first tick is due a period later. Virtual time
    /// is kept to the nanosecond, so the pilot takes it for real time.
    ///
    /// # Errors
    ///
    /// An invalid configuration, by key.
    pub fn new(config: Config, options: HostOptions, now_ns: u64) -> Result<Self, ConfigError> {
        let mut host = Host::new(config, options)?;
        host.control.real_time(RealTimeState {
            fifo: true,
            memory_locked: true,
        });
        let period_ns = host.configurations.in_force().control.period_ns();
        Ok(Self {
            host,
            grid: Grid::new(now_ns, period_ns),
        })
    }

    /// The parts, to look at.
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

    /// When the next tick is due.
    #[must_use]
    pub const fn next_tick_ns(&self) -> u64 {
        self.grid.next_ns()
    }

    /// What the serial reader's thread does at `now_ns`. Returns whether bytes were read.
    pub fn poll_serial(&mut self, now_ns: u64, port: &mut impl Port<Line = L>) -> bool {
        let before = self.host.reader.counters().bytes;
        self.host.reader.poll(&|| now_ns, port);
        self.host.reader.counters().bytes > before
    }

    /// What the camera receiver's thread does at `now_ns`.
    pub fn poll_cameras(
        &mut self,
        now_ns: u64,
        sockets: &mut impl Sockets,
        on_event: &mut impl FnMut(&PlanarEvent),
    ) {
        // A thread polls again at once while datagrams are left.
        for _ in 0..POLLS {
            if self.host.receiver.poll(&|| now_ns, sockets, on_event) > now_ns {
                break;
            }
        }
    }

    /// What the control thread does when it wakes up at `now_ns`.
    pub fn tick(&mut self, now_ns: u64) {
        let slot = self.grid.enter(now_ns);
        self.host.control.tick(slot, &|| now_ns);
        self.grid.slide(self.host.control.slide_ns());
    }

    /// The next tick that was not taken yet. What else was reported until then is
    /// dropped: see [`entries`](Self::entries) for all of it.
    pub fn next_tick(&mut self) -> Option<TickRecord> {
        while self.host.reports.pop().is_ok() {}
        while self.host.camera_reports.pop().is_ok() {}
        self.host.ticks.pop()
    }

    /// Hands out what a record holds of everything since the last time, in the order of
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

    /// Requests something of the pilot.
    ///
    /// # Errors
    ///
    /// When the control loop has not taken the requests before.
    pub fn request(&self, request: PilotRequest) -> Result<(), Stalled> {
        self.host.requests.push(ControlRequest::Pilot(request))
    }

    /// Hands another configuration to the control loop, to be taken over until
    /// `until_ns`.
    ///
    /// # Errors
    ///
    /// Why it can't be handed over.
    pub fn reconfigure(&mut self, config: Config, until_ns: u64) -> Result<(), ChangeError> {
        self.host
            .configurations
            .begin(config, until_ns, &self.host.requests)
    }

    /// The outcome of the change under way; none while there is none.
    pub fn settle(&mut self) -> Option<Result<u32, ChangeError>> {
        self.host.configurations.settle()
    }
}
