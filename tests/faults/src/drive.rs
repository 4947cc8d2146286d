//! One drive: world, network, port and daemon in step, checked by every invariant.

use core::ops::AddAssign;
use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};
use singletrack_control::{Position, Time};
use singletrack_core::config::Config;
use singletrack_pilot::{Arming, Filtering, Learned, Mode, Output, PilotRequest, Reason};
use singletrack_protocol::{BoardMode, Decoder, ResetCause, ToBoard};
use singletrack_record::TickRecord;
use singletrack_sim::{BoardKind, HandMotion, ReceivedMessage, World};

use crate::{
    SetupError,
    daemon::{Daemon, Port, host_ns},
    invariant::{self, Invariant},
    network::{HostSockets, Network},
    observation::{Digest, Observation, ReceivedPose},
    pins::{Pins, Pulse},
    program::{self, Attends, Operator, Program, Renewal, Sight},
    random::{Random, Stream},
    schedule::{Fault, FaultKind, OperatorRequest, ReferenceKind, Schedule},
    setting::{self, ConfigurationFile},
    spec::Spec,
    stop::{STANDING, Step, Stops},
    tamper::{Tamper, TamperedPins},
};

/// Interval at which the host reads bytes and packets, in µs: that of USB.
const LOOK_US: u64 = 1_000;

/// From a request to arm to the start that it gives.
const WAIT_US: u64 = 1_200_000;

/// Height of the wheels of a car on its stand, in m.
const STAND_M: f64 = 0.1;

/// Interval at which the learner tells the pilot something, in ticks.
const LEARNED_TICKS: u64 = 100;

/// Time from a hang to the watchdog's reset, in µs. A native board has no watchdog of its
/// own.
const WATCHDOG_US: u64 = 64_000;

/// The result of a drive.
#[derive(Clone, Debug, PartialEq)]
pub struct DriveOutcome {
    /// A hash of all events of the drive: the same for the same schedule.
    pub digest: u64,
    /// The first violation, if there was one.
    pub violation: Option<Violation>,
    /// The violated invariants: more than one only if the drive went on.
    pub violated: BTreeSet<&'static str>,
    /// How long the motor was driven, in ms.
    pub driven_ms: u32,
    /// The names of the reasons for which the host did not drive.
    pub reasons: BTreeSet<&'static str>,
    /// What the safety filter did.
    pub filter: FilterTicks,
}

/// Numbers of ticks that followed an outer loop with the safety filter on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FilterTicks {
    /// All of them.
    pub driving: u64,
    /// Those in which it limited the velocity of P.
    pub limited: u64,
    /// Those in which it scaled what was wanted.
    pub scaled: u64,
    /// Those in which it slowed the car down.
    pub stopped: u64,
    /// Drives that ended because the car came to stand by it.
    pub cornered: u64,
    /// Drives that the supervisor's geofence ended.
    pub fenced: u64,
}

impl FilterTicks {
    /// Counts a tick; `last` is what the filter did in the tick before, if that drove.
    fn count(&mut self, output: &Output, last: Option<Filtering>) {
        if output.mode == Mode::Driving {
            self.driving += 1;
            match output.filtering {
                Filtering::None => {}
                Filtering::Limited => self.limited += 1,
                Filtering::Scaled => self.scaled += 1,
                Filtering::Stopped | Filtering::Yielded => self.stopped += 1,
            }
        } else if output.mode == Mode::Stopping && output.reason == Some(Reason::OutsideFence) {
            match last {
                None => {}
                Some(Filtering::Stopped) => self.cornered += 1,
                Some(_) => self.fenced += 1,
            }
        }
    }
}

impl AddAssign for FilterTicks {
    fn add_assign(&mut self, other: Self) {
        self.driving += other.driving;
        self.limited += other.limited;
        self.scaled += other.scaled;
        self.stopped += other.stopped;
        self.cornered += other.cornered;
        self.fenced += other.fenced;
    }
}

/// A violation of an invariant.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Violation {
    /// The invariant's name.
    pub invariant: &'static str,
    /// When, in µs of the simulation.
    pub time_us: u64,
    /// What the invariant found.
    pub details: String,
}

/// Where a drive ends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Until {
    /// At the first violation.
    #[default]
    Violation,
    /// At the end of its schedule; an invariant is no longer checked once it is violated.
    End,
}

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

    /// Sends the operator's requests and the program's set-points. A daemon that does not
    /// run misses them; a paused one gets the requests later.
    fn send_requests(&mut self) -> Result<(), SetupError> {
        if self.paused {
            return Ok(());
        }
        self.flood();
        self.attend();
        while let Some(ask) = self.schedule.requests.get(self.next_request)
            && u64::from(ask.at_ms) * 1_000 <= self.now_us
        {
            self.next_request += 1;
            let situation = &self.schedule.situation;
            let attends = match ask.request {
                OperatorRequest::Arm if situation.waits || situation.attended => {
                    Some(Attends::Drive)
                }
                OperatorRequest::Jog => Some(Attends::Taps),
                OperatorRequest::JogOn => Some(Attends::Throttle),
                _ => None,
            };
            let request = match ask.request {
                OperatorRequest::Arm if situation.waits => {
                    if let Some(daemon) = &self.daemon {
                        daemon.arm_at(host_ns(self.now_us + WAIT_US));
                        self.operator.attend(self.now_us, Attends::Drive);
                    }
                    continue;
                }
                OperatorRequest::Arm if situation.attended => PilotRequest::Arm(Arming::Held),
                OperatorRequest::Arm => PilotRequest::Arm(Arming::Unattended),
                OperatorRequest::Jog | OperatorRequest::JogOn => PilotRequest::Arm(Arming::Jog),
                OperatorRequest::Disarm => PilotRequest::Disarm,
                OperatorRequest::Stop => PilotRequest::EmergencyStop,
                OperatorRequest::Gone => PilotRequest::OperatorGone,
                OperatorRequest::TimeUp => PilotRequest::TimeUp,
                OperatorRequest::Halt => PilotRequest::Halt,
                OperatorRequest::Lift | OperatorRequest::PutDown => {
                    self.lift(ask.request == OperatorRequest::Lift);
                    continue;
                }
                OperatorRequest::Reload => {
                    self.reload()?;
                    continue;
                }
                OperatorRequest::Carry => {
                    let truth = self.world.truth();
                    let held = self.is_held();
                    if self.was_driving || held || truth.speed.abs() >= STANDING {
                        continue;
                    }
                    let car = &mut self.world.car;
                    let (start, battery) = (car.parameters.start, car.parameters.battery);
                    car.place(start);
                    car.drain_battery((truth.battery_v - battery.start_v) / battery.fall_v_per_ah);
                    PilotRequest::Carried
                }
            };
            if let Some(daemon) = &mut self.daemon {
                let is_taken = daemon.request(request);
                let arms = matches!(request, PilotRequest::Arm(_));
                // A stop may not be refused.
                if is_taken || !arms {
                    self.pending_requests.push(request);
                }
                match attends {
                    Some(attends) if is_taken => self.operator.attend(self.now_us, attends),
                    Some(_) => {}
                    None => self.operator.leave(),
                }
            }
        }
        if let Some(daemon) = &self.daemon
            && self.schedule.situation.reference == ReferenceKind::External
        {
            let truth = self.world.truth();
            let sight = Sight {
                position: Position::new(truth.x, truth.y),
                yaw: truth.yaw,
                drive_time_s: self.drive_time_s,
            };
            let mut faults = self.faults.iter().copied();
            let fault = faults.find(|fault| fault.kind.changes_setpoints());
            let situation = &self.schedule.situation;
            let now = Time(host_ns(self.now_us));
            for sent in self.program.poll(self.now_us, situation, sight, fault) {
                daemon.send(&sent);
                if sent.check(now, f64::INFINITY).is_ok() {
                    let decided = Some(sent.stamp().time.0);
                    self.newest_setpoint_ns = self.newest_setpoint_ns.max(decided);
                }
            }
        }
        Ok(())
    }

    /// Renews what the operator attends.
    fn attend(&mut self) {
        let Some(daemon) = &self.daemon else { return };
        let (faults, board) = (&self.faults, &self.spec.board);
        match self.operator.poll(self.now_us, faults, board) {
            None => {}
            Some(Renewal::Hold) => {
                daemon.request(PilotRequest::Hold);
            }
            Some(Renewal::Jog(jog)) => daemon.jog(jog),
        }
    }

    /// Whether the car is in somebody's hands, or on a stand.
    fn is_held(&self) -> bool {
        let car = &self.world.car;
        car.is_in_motion_by_hand() || car.wheels_are_up()
    }

    /// Puts a car that stands onto a stand, or down again.
    fn lift(&mut self, up: bool) {
        let stands = self.world.truth().speed.abs() < STANDING;
        if up && !self.is_held() && !self.was_driving && stands {
            let motion = HandMotion::Lift { height_m: STAND_M };
            self.world.car.begin_by_hand(motion);
        } else if !up && self.is_held() {
            self.world.car.begin_by_hand(HandMotion::PutDown);
        }
    }

    /// Sends what other clients send.
    fn flood(&mut self) {
        let mut faults = self.faults.iter();
        let flood = faults.find(|fault| fault.kind == FaultKind::RequestFlood);
        let (Some(flood), Some(daemon)) = (flood, &self.daemon) else {
            return;
        };
        let [least, most] = setting::TUNED_GAIN;
        for index in 0..=flood.severity / 10 {
            let share = f64::from(index % 11) / 10.0;
            daemon.tune(least + share * (most - least));
            // Most find no room.
            daemon.request(PilotRequest::Hold);
        }
        self.operator.was_renewed(self.now_us);
    }

    /// The operator edits the daemon's configuration file and reloads it.
    fn reload(&mut self) -> Result<(), SetupError> {
        self.file = self.file.other();
        let config = setting::config(&self.schedule.situation, self.file)?;
        if let Some(daemon) = &mut self.daemon {
            daemon.reload(self.now_us, &config);
        }
        Ok(())
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

    /// Checks every invariant.
    fn watch(
        &mut self,
        has_read: bool,
        mut tick: Option<TickRecord>,
        tamper: &mut dyn Tamper,
    ) -> Result<(), SetupError> {
        let now_us = self.now_us;
        let mut configuration = None;
        if let Some((number, mut config)) = self.changed.take() {
            tamper.configuration(number, &mut config);
            let world = &self.world.config;
            self.spec = Spec::new(self.schedule, world, &config).map_err(SetupError::Config)?;
            let toml = config.to_toml().map_err(|error| SetupError::Other {
                part: "the daemon's configuration",
                reason: error.to_string(),
            })?;
            self.is_proved = self.schedule.situation.proved || self.proved.contains(&toml);
            self.toml = toml;
            let pilot = config.pilot().map_err(SetupError::Config)?;
            configuration = Some((number, pilot));
        }
        self.write(tamper);
        let Buffers {
            heard,
            pulses,
            written,
            ..
        } = &mut self.buffers;
        let board = &mut self.world.board;
        heard.clear();
        heard.extend(core::iter::from_fn(|| board.next_received()));
        let is_running = board.is_running();
        if board.resets != self.resets || is_running != self.was_running {
            self.resets = board.resets;
            self.was_running = is_running;
            self.board_since_us = is_running.then_some(now_us);
            self.jogs = false;
            self.bites_us = self.bites_us.filter(|_| is_running);
        }
        for received in &*heard {
            match received.message {
                ToBoard::Jog(_) => self.jogs = true,
                ToBoard::Arm(_) | ToBoard::Drive(_) => self.jogs = false,
                _ => {}
            }
        }
        let log = &board.pulses;
        let new = log.total - self.pulses;
        self.pulses = log.total;
        pulses.clear();
        // Oldest first.
        let newest = || log.iter().rev().take(new as usize);
        for index in (0..newest().count()).rev() {
            let record = newest().nth(index);
            pulses.extend(record.map(|record| self.pins.observe(&self.spec, *record, self.jogs)));
        }
        if let Some(tick) = &mut tick {
            tamper.tick(tick);
            if let Some(learned) = &mut self.learned {
                tamper.learned(tick.index, learned);
            }
        }
        let truth = self.world.truth();
        let telemetry = self.world.board.telemetry();
        let board_mode = telemetry.map(|record| record.mode);
        let board_cause = telemetry.map(|record| record.stop_cause);
        let board_is_armed = is_running
            && matches!(
                board_mode,
                Some(
                    BoardMode::PoweringUp
                        | BoardMode::Armed
                        | BoardMode::Driving
                        | BoardMode::Jogging
                )
            );
        let is_held = {
            let car = &self.world.car;
            car.is_in_motion_by_hand() || car.wheels_are_up()
        };
        let is_pushed = self.pushes.iter().any(|fault| {
            let [from, to] = [fault.at_ms, fault.end_ms()].map(|ms| u64::from(ms) * 1_000);
            let rolls_us = (2e6 / self.spec.braking) as u64;
            if !(from..to + rolls_us + 500_000).contains(&now_us) {
                return false;
            }
            // A blow acts within the step.
            self.is_pushed |= now_us <= to + LOOK_US;
            self.is_pushed &= now_us <= to + LOOK_US || truth.speed.abs() >= STANDING;
            self.is_pushed
        });
        let moved_by_hand = is_held || is_pushed;
        let tick_mode = tick.as_ref().map(|tick| tick.output.mode);
        if tick_mode == Some(Mode::Arming) {
            self.armed_at_m = truth.way;
        }
        let way_since_arm = truth.way - self.armed_at_m;
        self.stops.step(&Step {
            now_us,
            spec: &self.spec,
            speed: truth.speed,
            position: [truth.x, truth.y],
            pulses,
            board_is_armed,
            jogs: self.jogs,
            moved_by_hand,
            mode: tick_mode,
            commanded: tick
                .as_ref()
                .map_or(0.0, |tick| tick.output.actuation.speed.abs()),
        });
        let observation = Observation {
            now_us,
            spec: &self.spec,
            truth,
            pulses,
            stop: self.stops.stop(),
            board_received: heard,
            board_since_us: self.board_since_us,
            board_mode,
            board_cause,
            board_is_armed,
            is_proved: self.is_proved,
            jogs: self.jogs,
            renewed: self.operator.renewed(),
            way_since_arm,
            esc_has_power: self.world.car.esc_has_power(),
            moved_by_hand,
            tick: tick.as_ref(),
            is_replayed: tamper.is_replayed(),
            written,
            has_read,
            daemon_since_us: self.daemon_since_us,
            newest_pose: self.newest_pose,
            faults: &self.faults,
            new_faults: &self.new_faults,
            pending_requests: &self.pending_requests,
            configuration: configuration.as_ref(),
            newest_setpoint_ns: self.newest_setpoint_ns,
            learned: self.learned,
        };
        let has_ticked = observation.tick.is_some();
        if let Some(tick) = observation.tick {
            self.reason = tick.output.reason;
            self.reasons.extend(self.reason.map(Reason::name));
        }
        if let Some(tick) = observation.tick
            && self.schedule.situation.safety_filter
        {
            let output = &tick.output;
            let drives = output.mode == Mode::Driving;
            let last = drives.then_some(output.filtering);
            let last = core::mem::replace(&mut self.filtering, last);
            self.filter.count(output, last);
        }
        self.digest.add(&observation);
        for pulse in observation.pulses {
            self.driven_ms += 20 * u32::from(pulse.drives());
        }
        let (first, violated) = (&mut self.violation, &mut self.violated);
        self.invariants
            .retain_mut(|invariant| match invariant.check(&observation) {
                Ok(()) => true,
                Err(details) => {
                    violated.insert(invariant.name());
                    first.get_or_insert(Violation {
                        invariant: invariant.name(),
                        time_us: now_us,
                        details,
                    });
                    false
                }
            });
        if let Some(tick) = &tick {
            self.note_proof(tick, way_since_arm);
        }
        if has_ticked {
            self.pending_requests.clear();
        }
        Ok(())
    }

    /// A proof counts from the next tick on, if the car has driven far enough for it (see
    /// `false-proof`). A contradiction revokes it.
    fn note_proof(&mut self, tick: &TickRecord, way_since_arm: f64) {
        let output = &tick.output;
        if output.proved && way_since_arm >= invariant::METRE {
            self.is_proved = true;
            self.proved.insert(self.toml.clone());
        }
        let drives = matches!(output.mode, Mode::Driving | Mode::Slowing);
        let ends = core::mem::replace(&mut self.was_driving, drives) && !drives;
        let contradicts = ends && output.reason.is_some_and(invariant::is_contradiction);
        if contradicts || output.disproved {
            self.proved.remove(&self.toml);
            self.is_proved = self.schedule.situation.proved;
        }
    }

    /// Passes the bytes that the daemon wrote to the line.
    fn write(&mut self, tamper: &mut dyn Tamper) {
        let Buffers { bytes, written, .. } = &mut self.buffers;
        bytes.clear();
        written.clear();
        self.port.take_written(bytes);
        tamper.written(self.now_us, bytes);
        for &byte in &*bytes {
            if let Some(Ok(packet)) = self.written.push(byte)
                && let Ok(message) = ToBoard::decode(packet)
            {
                written.push(message);
            }
        }
        tamper.to_board(self.now_us, bytes);
        if !bytes.is_empty() {
            self.world.host_write(bytes);
        }
    }
}
