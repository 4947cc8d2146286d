//! One drive: world, network, port and daemon in step, checked by every invariant.

mod requests;
mod watch;

use std::collections::BTreeSet;

use singletrack_core::config::Config;
use singletrack_pilot::{Filtering, Learned, PilotRequest, Reason};
use singletrack_protocol::{Decoder, ResetCause, ToBoard};
use singletrack_record::TickRecord;
use singletrack_sim::{BoardKind, ReceivedMessage, World};

use crate::{
    SetupError,
    daemon::{Daemon, Port},
    invariant::{self, Invariant},
    network::{HostSockets, Network},
    observation::{Digest, ReceivedPose},
    pins::{Pins, Pulse},
    program::{self, Operator, Program},
    random::{Random, Stream},
    schedule::{Fault, FaultKind, Schedule},
    setting::{self, ConfigurationFile},
    spec::Spec,
    stop::Stops,
    tamper::{Tamper, TamperedPins},
};

pub use watch::{DriveOutcome, FilterTicks, Until, Violation};

/// Interval at which the host reads bytes and packets, in µs: that of USB.
const LOOK_US: u64 = 1_000;

/// Interval at which the learner tells the pilot something, in ticks.
const LEARNED_TICKS: u64 = 100;

/// Time from a hang to the watchdog's reset, in µs. A native board has no watchdog of its
/// own.
const WATCHDOG_US: u64 = 64_000;

/// Drives a schedule to its end, or to the first violation.
///
/// # Errors
///
/// The part that can't be set up.
pub fn drive(
    schedule: &Schedule,
    tamper: &mut dyn Tamper,
    until: Until,
) -> Result<DriveOutcome, SetupError> {
    drive_watched(schedule, tamper, until, u64::MAX, |_, _, _| {})
}

/// Drives as [`drive`] does, and calls `after` each `every_us` with the time of the simulation (µs),
/// how long the motor was driven until then (ms), and why it is not driven now.
///
/// # Errors
///
/// The part that can't be set up.
pub fn drive_watched(
    schedule: &Schedule,
    tamper: &mut dyn Tamper,
    until: Until,
    every_us: u64,
    mut after: impl FnMut(u64, u32, Option<Reason>),
) -> Result<DriveOutcome, SetupError> {
    let mut drive = Drive::new(schedule, tamper)?;
    let end_us = u64::from(schedule.end_ms) * 1_000;
    let mut next_us = every_us;
    while drive.now_us < end_us {
        drive.step(end_us, tamper)?;
        if drive.now_us >= next_us {
            next_us += every_us;
            after(drive.now_us, drive.driven_ms, drive.reason);
        }
        if drive.violation.is_some() && until == Until::Violation {
            break;
        }
    }
    Ok(drive.outcome())
}

struct Drive<'a> {
    schedule: &'a Schedule,
    /// The content of the daemon's configuration file.
    file: ConfigurationFile,
    /// The configuration that came into force at this step, with its number.
    changed: Option<(u32, Config)>,
    /// Sends set-points.
    program: Program,
    /// The drive time of the last tick, which the program reads from the daemon.
    drive_time_s: Option<f64>,
    newest_setpoint_ns: Option<u64>,
    /// The corrections in force after the last tick.
    learned: Option<Learned>,
    /// Attends drives and jogs.
    operator: Operator,
    /// The board was last given pulses of a jog.
    jogs: bool,
    spec: Spec,
    now_us: u64,
    world: Box<World>,
    network: Network,
    port: Port,
    daemon: Option<Daemon>,
    daemon_since_us: Option<u64>,
    daemons: u16,
    paused: bool,
    wall_ns: u64,
    random: Random,
    next_request: usize,
    /// Requests that were accepted and that no tick has handled yet.
    pending_requests: Vec<PilotRequest>,
    /// The active faults, in the order in which they began.
    faults: Vec<Fault>,
    new_faults: Vec<Fault>,
    /// All that somebody pushes the car.
    pushes: Vec<Fault>,
    /// When the serial reader starts: a little later than the control thread.
    reads_from_us: u64,
    bites_us: Option<u64>,
    tick_us: u64,
    /// At the next step, the tick comes before the daemon's reads.
    ticks_first: bool,
    newest_pose: Option<ReceivedPose>,
    invariants: Vec<Box<dyn Invariant>>,
    violation: Option<Violation>,
    violated: BTreeSet<&'static str>,
    digest: Digest,
    driven_ms: u32,
    reasons: BTreeSet<&'static str>,
    /// That of the last tick.
    reason: Option<Reason>,
    filter: FilterTicks,
    /// What the safety filter did in the last tick, if that drove.
    filtering: Option<Filtering>,
    board_since_us: Option<u64>,
    was_running: bool,
    resets: u64,
    pulses: u64,
    /// Whether the running daemon has proved its configuration, or need not.
    is_proved: bool,
    /// True way of the car when it was last armed, in m.
    armed_at_m: f64,
    /// The car has not stood since somebody pushed it.
    is_pushed: bool,
    /// The last tick followed the reference.
    was_driving: bool,
    /// The configuration in force, and those that have been proved.
    toml: String,
    proved: BTreeSet<String>,
    pins: Pins,
    stops: Stops,
    written: Decoder,
    buffers: Buffers,
}

#[derive(Default)]
struct Buffers {
    bytes: Vec<u8>,
    heard: Vec<ReceivedMessage>,
    pulses: Vec<Pulse>,
    written: Vec<ToBoard>,
}

impl<'a> Drive<'a> {
    fn new(schedule: &'a Schedule, tamper: &mut dyn Tamper) -> Result<Self, SetupError> {
        let config = setting::config(&schedule.situation, ConfigurationFile::default())?;
        let world =
            World::new(setting::simulation(schedule)).map_err(|error| SetupError::Other {
                part: "the simulation",
                reason: error.to_string(),
            })?;
        let mut drive = Self {
            spec: Spec::new(schedule, &world.config, &config).map_err(SetupError::Config)?,
            now_us: 0,
            world: Box::new(world),
            network: Network::new(schedule.seed),
            port: Port::new(setting::reported(&schedule.situation)),
            daemon: None,
            daemon_since_us: None,
            daemons: 0,
            paused: false,
            wall_ns: 1_700_000_000_000_000_000 ^ schedule.seed,
            random: Random::new(schedule.seed, Stream::Host),
            next_request: 0,
            pending_requests: Vec::new(),
            faults: Vec::new(),
            new_faults: Vec::new(),
            pushes: schedule
                .faults
                .iter()
                .filter(|fault| fault.kind == FaultKind::Push)
                .copied()
                .collect(),
            reads_from_us: 0,
            bites_us: None,
            tick_us: 0,
            ticks_first: false,
            newest_pose: None,
            invariants: invariant::all(config.pilot().map_err(SetupError::Config)?),
            file: ConfigurationFile::default(),
            changed: None,
            program: Program::new(schedule.seed),
            drive_time_s: None,
            newest_setpoint_ns: None,
            learned: None,
            operator: Operator::new(schedule.seed),
            jogs: false,
            violation: None,
            violated: BTreeSet::new(),
            digest: Digest::default(),
            driven_ms: 0,
            reasons: BTreeSet::new(),
            reason: None,
            filter: FilterTicks::default(),
            filtering: None,
            board_since_us: None,
            was_running: false,
            resets: 0,
            pulses: 0,
            is_proved: schedule.situation.proved,
            armed_at_m: 0.0,
            is_pushed: false,
            was_driving: false,
            toml: String::new(),
            proved: BTreeSet::new(),
            pins: Pins::default(),
            stops: Stops::default(),
            written: Decoder::new(),
            buffers: Buffers::default(),
            schedule,
        };
        drive.start_daemon(tamper)?;
        Ok(drive)
    }

    fn outcome(self) -> DriveOutcome {
        DriveOutcome {
            digest: self.digest.value(),
            violation: self.violation,
            violated: self.violated,
            driven_ms: self.driven_ms,
            reasons: self.reasons,
            filter: self.filter,
        }
    }

    /// Advances to the next time at which something is due, and does it.
    fn step(&mut self, end_us: u64, tamper: &mut dyn Tamper) -> Result<(), SetupError> {
        let mut next_us = (self.now_us / LOOK_US + 1) * LOOK_US;
        if self.is_awake() {
            next_us = next_us.min(self.tick_us.max(self.now_us + 1));
        }
        self.now_us = next_us.min(end_us);
        self.world
            .advance_filtered(self.now_us, &mut TamperedPins(tamper));
        self.change_faults(tamper)?;
        self.send_requests()?;
        let first = core::mem::take(&mut self.ticks_first).then(|| self.tick());
        let has_read = self.receive();
        let tick = first.unwrap_or_else(|| self.tick());
        self.watch(has_read, tick, tamper)?;
        Ok(())
    }

    fn is_awake(&self) -> bool {
        self.daemon.is_some() && !self.paused
    }

    fn is_active(&self, kind: FaultKind) -> bool {
        self.faults.iter().any(|fault| fault.kind == kind)
    }

    /// Ends and begins faults, with their effects.
    fn change_faults(&mut self, tamper: &mut dyn Tamper) -> Result<(), SetupError> {
        self.new_faults.clear();
        let now_us = self.now_us;
        let us = |ms: u32| u64::from(ms) * 1_000;
        let mut changed = false;
        let mut index = 0;
        while let Some(fault) = self.faults.get(index).copied() {
            if us(fault.end_ms()) > now_us || fault.kind.is_lasting() {
                index += 1;
                continue;
            }
            self.faults.remove(index);
            changed = true;
            setting::end(&mut self.world, &fault);
            self.network.note_change(fault.kind);
            if fault.kind == FaultKind::CameraServerRestart {
                self.network.restart_server(&self.world);
            }
        }
        for fault in &self.schedule.faults {
            // Every full millisecond is a step.
            if us(fault.at_ms) == now_us {
                changed = true;
                setting::begin(&mut self.world, fault);
                self.network.note_change(fault.kind);
                if fault.kind == FaultKind::BoardHang && self.world.board.is_running() {
                    self.bites_us.get_or_insert(now_us + WATCHDOG_US);
                }
                self.new_faults.push(*fault);
                if !fault.kind.is_momentary() && fault.for_ms > 0 {
                    self.faults.push(*fault);
                }
            }
        }
        if changed {
            setting::hold(&mut self.world, &self.schedule.situation, &self.faults);
            self.host_faults(tamper)?;
        }
        if self.schedule.situation.board == BoardKind::Native
            && self.bites_us.is_some_and(|us| us <= now_us)
        {
            self.bites_us = None;
            self.world.reset_board(ResetCause::Watchdog);
        }
        Ok(())
    }

    fn host_faults(&mut self, tamper: &mut dyn Tamper) -> Result<(), SetupError> {
        let unplugged = self.is_active(FaultKind::LineUnplugged);
        self.port.set_plugged(!unplugged);
        let killed = self.is_active(FaultKind::DaemonKilled);
        if killed && self.daemon.is_some() {
            self.daemon = None;
            self.daemon_since_us = None;
            self.newest_pose = None;
            self.pending_requests.clear();
            self.operator.leave();
        } else if !killed && self.daemon.is_none() {
            self.start_daemon(tamper)?;
        }
        let was_paused = self.paused;
        self.paused = self.is_active(FaultKind::DaemonPaused);
        if was_paused && !self.paused {
            self.wake();
        }
        Ok(())
    }

    fn start_daemon(&mut self, tamper: &mut dyn Tamper) -> Result<(), SetupError> {
        self.daemons += 1;
        let step_ns: u64 = self
            .faults
            .iter()
            .filter(|fault| fault.kind == FaultKind::WallClockStep)
            .map(|fault| u64::from(fault.severity) * 86_400_000_000_000)
            .sum();
        let wall_ns = self.wall_ns + self.now_us * 1_000 + step_ns;
        let process = u64::from(self.random.between(300, 32_767));
        let config = setting::config(&self.schedule.situation, self.file)?;
        let mut run = config.clone();
        tamper.host(&mut run);
        let daemon = Daemon::start(&run, wall_ns ^ process, self.daemons, self.now_us)?;
        self.program = Program::new(self.schedule.seed);
        self.drive_time_s = None;
        self.newest_setpoint_ns = None;
        self.changed = Some((1, config));
        self.tick_us = daemon.next_tick_us();
        self.daemon = Some(daemon);
        self.daemon_since_us = Some(self.now_us);
        self.newest_pose = None;
        self.reads_from_us = self.now_us + u64::from(self.random.between(0, 20)) * 1_000;
        Ok(())
    }

    /// Ends a pause: the control thread's deadline has passed, so it wakes at once, before
    /// the other threads or after them.
    fn wake(&mut self) {
        self.ticks_first = self.random.happens(500);
    }

    /// Delivers bytes and datagrams to the host, and to the daemon if it is awake.
    fn receive(&mut self) -> bool {
        let now_us = self.now_us;
        let client = self.daemon.as_ref().map(|daemon| daemon.address);
        self.network.take(&mut self.world, client, &self.faults);
        self.network.deliver(now_us, self.daemon.is_some());
        let bytes = &mut self.buffers.bytes;
        bytes.clear();
        self.world.host_read(bytes);
        self.port.receive(bytes);
        if self.paused {
            return false;
        }
        let Some(daemon) = &mut self.daemon else {
            return false;
        };
        let has_read = now_us >= self.reads_from_us && daemon.poll_serial(now_us, &mut self.port);
        if self.port.take_opened() && self.schedule.situation.reset_on_open {
            self.world.reset_board(ResetCause::External);
        }
        let restarts = |fault: &Fault| fault.kind == FaultKind::CameraServerRestart;
        let address = daemon.address;
        daemon.poll_cameras(
            now_us,
            &mut HostSockets {
                is_connected: !self.faults.iter().any(restarts),
                network: &mut self.network,
                world: &mut self.world,
                address,
            },
        );
        let is_late = self
            .faults
            .iter()
            .any(|fault| fault.kind == FaultKind::TicksLate);
        if !is_late {
            self.tick_us = self.tick_us.min(daemon.next_tick_us());
        }
        if let Some(exposure) = self.network.take_read() {
            let is_newer = self
                .newest_pose
                .is_none_or(|pose| exposure.exposed_us >= pose.exposure.exposed_us);
            if is_newer {
                self.newest_pose = Some(ReceivedPose {
                    exposure,
                    received_us: now_us,
                });
            }
        }
        has_read
    }

    fn tick(&mut self) -> Option<TickRecord> {
        if self.paused || self.now_us < self.tick_us {
            return None;
        }
        let daemon = self.daemon.as_mut()?;
        self.port.set_queued(self.world.wire.bytes_to_board());
        let record = daemon.tick(self.now_us);
        if let Some((number, config)) = daemon.settled() {
            self.changed = Some((number, config.clone()));
        }
        self.tick_us = daemon.next_tick_us();
        if let Some(record) = &record {
            self.drive_time_s = record.output.drive_time;
            self.learned = daemon.learned();
            // A learner sees a servo that is stuck: see `steering_change` of the calibration.
            let is_stuck = self
                .faults
                .iter()
                .any(|it| it.kind == FaultKind::ServoStuck);
            if self.learned.is_some()
                && record.index.is_multiple_of(LEARNED_TICKS)
                && !is_stuck
                && let Some(learned) =
                    program::learned(self.schedule.seed, record.index / LEARNED_TICKS)
            {
                daemon.tell(learned);
            }
        }
        for fault in &self.faults {
            if fault.kind == FaultKind::TicksLate {
                self.tick_us += u64::from(self.random.between(0, fault.severity * 50));
            }
        }
        record
    }
}
