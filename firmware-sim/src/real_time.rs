//! The world in real time, on its own thread, with a pseudo-terminal and UDP.

use std::{
    collections::VecDeque,
    io,
    net::SocketAddrV4,
    path::PathBuf,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
        mpsc,
    },
    thread::{self, JoinHandle},
};

use rustix::{
    thread::{ClockId, clock_nanosleep_absolute},
    time::{Timespec, clock_gettime},
};

use crate::{
    cameras::ServerKind,
    car::Truth,
    floor::Floor,
    parameters::{ConfigError, SimulationConfig},
    ports::{NatNetSockets, Pty, PtyError, UdpConfig, UdpError},
    pulses::push_bounded,
    stream_servers::StreamServers,
    world::World,
};

/// Configuration of the real-time simulator.
#[derive(Clone, Debug)]
pub struct RealTimeConfig {
    /// The simulation.
    pub simulation: SimulationConfig,
    /// Path of the link to the pseudo-terminal, which stays the same when the line
    /// is unplugged and plugged in.
    pub pty_link: Option<PathBuf>,
    /// What the cameras' server speaks.
    pub cameras: ServerKind,
    /// Sockets of that server.
    pub udp: UdpConfig,
    /// Period of the recorded trajectory, in µs.
    pub trajectory_period_us: u64,
    /// The floor that the car shares with others, and its place among them.
    pub floor: Option<SharedFloor>,
}

/// A floor of several simulators in real time, each with a car.
#[derive(Clone, Debug)]
pub struct SharedFloor {
    /// The cars.
    pub floor: Arc<Mutex<Floor>>,
    /// Which one this is.
    pub index: usize,
}

impl Default for RealTimeConfig {
    fn default() -> Self {
        Self {
            simulation: SimulationConfig::default(),
            pty_link: None,
            cameras: ServerKind::NatNet,
            udp: UdpConfig::default(),
            trajectory_period_us: 5_000,
            floor: None,
        }
    }
}

/// Errors of the real-time simulator.
#[derive(Debug, thiserror::Error)]
pub enum RealTimeError {
    /// Invalid configuration.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The pseudo-terminal can't be opened.
    #[error(transparent)]
    Pty(#[from] PtyError),
    /// A socket can't be opened.
    #[error(transparent)]
    Udp(#[from] UdpError),
    /// The thread can't be started.
    #[error("can't start the simulator's thread: {0}")]
    Thread(#[source] io::Error),
    /// The simulator's thread has ended.
    #[error("the simulator has stopped")]
    Stopped,
}

/// Ground truth with its time on `CLOCK_MONOTONIC`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TimedTruth {
    /// `CLOCK_MONOTONIC`, in ns.
    pub monotonic_ns: u64,
    /// Ground truth.
    pub truth: Truth,
}

/// Statistics of the simulator's thread.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RealTimeCounters {
    /// Rounds of the loop.
    pub rounds: u64,
    /// Rounds that started more than 5 ms late.
    pub late_rounds: u64,
    /// Largest delay of a round, in µs.
    pub max_lateness_us: u64,
    /// Bytes lost because the pseudo-terminal was full.
    pub bytes_lost: u64,
    /// Datagrams that could not be sent.
    pub datagrams_lost: u64,
}

/// Results of a stopped simulator.
#[derive(Debug)]
pub struct Finished {
    /// Final state of the world.
    pub world: World,
    /// The rest of the recorded trajectory, oldest first.
    pub trajectory: Vec<TimedTruth>,
    /// Statistics of the thread.
    pub counters: RealTimeCounters,
    /// `CLOCK_MONOTONIC` at simulation time zero, in ns.
    pub started_ns: u64,
}

type Request = Box<dyn FnOnce(&mut Machine) + Send>;

/// A running simulator. Dropping it stops the thread.
#[derive(Debug)]
pub struct RealTimeSimulator {
    requests: mpsc::Sender<Request>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<Finished>>,
    /// Path of the board's serial port: the link if configured, else the device
    /// (which changes with [`plug`](Self::plug)).
    pub pty_path: PathBuf,
    /// Command address of the NatNet server, or the address of another one on TCP.
    pub command_address: SocketAddrV4,
    /// Source address of the frames; its port is also the multicast port.
    pub data_address: SocketAddrV4,
    /// `CLOCK_MONOTONIC` at simulation time zero, in ns.
    pub started_ns: u64,
}

impl RealTimeSimulator {
    /// Opens the pseudo-terminal and the sockets and starts the simulation.
    ///
    /// # Errors
    ///
    /// Fails if a resource can't be opened or the configuration is invalid.
    pub fn start(config: RealTimeConfig) -> Result<Self, RealTimeError> {
        let mut world = World::new(config.simulation)?;
        let sockets = Sockets::bind(config.cameras, &config.udp, &mut world)?;
        let pty = Pty::open(config.pty_link.as_deref())?;
        let pty_path = pty.path().to_owned();
        let (command_address, data_address) = match &sockets {
            Sockets::NatNet(natnet) => (natnet.command_address, natnet.data_address),
            Sockets::Stream(servers) => (servers.address, servers.address),
        };
        let (requests, receiver) = mpsc::channel();
        let stop = Arc::new(AtomicBool::new(false));
        let started_ns = monotonic_ns();
        let machine = Machine {
            world,
            pty: Some(pty),
            link: config.pty_link,
            sockets,
            started_ns,
            trajectory: VecDeque::new(),
            trajectory_period_us: config.trajectory_period_us.max(1_000),
            next_record_us: 0,
            floor: config.floor,
            counters: RealTimeCounters::default(),
            bytes: Vec::with_capacity(4096),
        };
        let stopped = Arc::clone(&stop);
        let thread = thread::Builder::new()
            .name("simulator".to_owned())
            .spawn(move || machine.run(&receiver, &stopped))
            .map_err(RealTimeError::Thread)?;
        Ok(Self {
            requests,
            stop,
            thread: Some(thread),
            pty_path,
            command_address,
            data_address,
            started_ns,
        })
    }

    /// Calls a function with the world on the simulator's thread, within the next
    /// millisecond, and returns its result.
    ///
    /// # Errors
    ///
    /// [`RealTimeError::Stopped`].
    pub fn with_world<R: Send + 'static>(
        &self,
        action: impl FnOnce(&mut World) -> R + Send + 'static,
    ) -> Result<R, RealTimeError> {
        self.with_machine(|machine| action(&mut machine.world))
    }

    /// The present ground truth.
    ///
    /// # Errors
    ///
    /// [`RealTimeError::Stopped`].
    pub fn truth(&self) -> Result<TimedTruth, RealTimeError> {
        self.with_machine(|machine| machine.timed_truth())
    }

    /// Statistics of the thread so far.
    ///
    /// # Errors
    ///
    /// [`RealTimeError::Stopped`].
    pub fn counters(&self) -> Result<RealTimeCounters, RealTimeError> {
        self.with_machine(|machine| machine.counters)
    }

    /// Pulls the USB cable: the host sees a hang-up, the link is removed, and the board loses
    /// its power unless it has its own.
    ///
    /// # Errors
    ///
    /// [`RealTimeError::Stopped`].
    pub fn unplug(&self) -> Result<(), RealTimeError> {
        self.with_machine(|machine| {
            machine.pty = None;
            machine.world.set_cable(false);
        })
    }

    /// Cuts the serial line alone: unlike after [`unplug`](Self::unplug), the board keeps its power.
    ///
    /// # Errors
    ///
    /// [`RealTimeError::Stopped`].
    pub fn interrupt(&self) -> Result<(), RealTimeError> {
        self.with_machine(|machine| {
            machine.pty = None;
            machine.world.set_wire_connected(false);
        })
    }

    /// Plugs the serial line in with a new pseudo-terminal under the same link.
    /// Returns its path.
    ///
    /// # Errors
    ///
    /// Fails if no pseudo-terminal can be opened, or with [`RealTimeError::Stopped`].
    pub fn plug(&self) -> Result<PathBuf, RealTimeError> {
        self.with_machine(|machine| -> Result<PathBuf, RealTimeError> {
            if let Some(pty) = &machine.pty {
                return Ok(pty.path().to_owned());
            }
            let pty = Pty::open(machine.link.as_deref())?;
            let path = pty.path().to_owned();
            machine.pty = Some(pty);
            machine.world.set_cable(true);
            Ok(path)
        })?
    }

    /// Stops the simulator and returns its results.
    ///
    /// # Errors
    ///
    /// [`RealTimeError::Stopped`] if the thread has already ended.
    pub fn stop(mut self) -> Result<Finished, RealTimeError> {
        self.stop.store(true, Ordering::Relaxed);
        let thread = self.thread.take().ok_or(RealTimeError::Stopped)?;
        thread.join().map_err(|_| RealTimeError::Stopped)
    }

    fn with_machine<R: Send + 'static>(
        &self,
        action: impl FnOnce(&mut Machine) -> R + Send + 'static,
    ) -> Result<R, RealTimeError> {
        let (sender, receiver) = mpsc::sync_channel(1);
        let request: Request = Box::new(move |machine| {
            // The caller may have gone.
            let _ = sender.send(action(machine));
        });
        let sent = self.requests.send(request);
        sent.map_err(|_| RealTimeError::Stopped)?;
        receiver.recv().map_err(|_| RealTimeError::Stopped)
    }
}

impl Drop for RealTimeSimulator {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // The result is no longer needed.
            let _ = thread.join();
        }
    }
}

/// State of the simulator's thread.
#[derive(Debug)]
struct Machine {
    world: World,
    pty: Option<Pty>,
    link: Option<PathBuf>,
    sockets: Sockets,
    started_ns: u64,
    trajectory: VecDeque<TimedTruth>,
    trajectory_period_us: u64,
    next_record_us: u64,
    floor: Option<SharedFloor>,
    counters: RealTimeCounters,
    bytes: Vec<u8>,
}

/// The sockets of the cameras' server.
#[derive(Debug)]
enum Sockets {
    NatNet(NatNetSockets),
    Stream(Box<StreamServers>),
}

impl Sockets {
    fn bind(kind: ServerKind, config: &UdpConfig, world: &mut World) -> Result<Self, UdpError> {
        let (interface, port) = (config.interface, config.command_port);
        Ok(match kind {
            ServerKind::NatNet => {
                let natnet = world.natnet.parameters;
                let sockets = NatNetSockets::bind(config, natnet.group, natnet.sends_from)?;
                world.natnet.data_port = sockets.data_address.port();
                Self::NatNet(sockets)
            }
            ServerKind::Vrpn => Self::Stream(Box::new(StreamServers::vrpn(interface, port)?)),
            ServerKind::Qualisys => Self::Stream(Box::new(StreamServers::qtm(interface, port)?)),
        })
    }
}

/// Time between two rounds, in ns.
const ROUND_NS: u64 = 1_000_000;
/// Number of points of the trajectory kept: over an hour at 5 ms.
const TRAJECTORY_CAPACITY: usize = 1 << 20;

impl Machine {
    fn run(mut self, requests: &mpsc::Receiver<Request>, stop: &AtomicBool) -> Finished {
        let mut deadline_ns = self.started_ns;
        while !stop.load(Ordering::Relaxed) {
            deadline_ns += ROUND_NS;
            sleep_until(deadline_ns);
            let now_ns = monotonic_ns();
            let lateness_us = now_ns.saturating_sub(deadline_ns) / 1_000;
            self.counters.rounds += 1;
            self.counters.late_rounds += u64::from(lateness_us > 5_000);
            self.counters.max_lateness_us = self.counters.max_lateness_us.max(lateness_us);
            // Missed rounds are not repeated: this round catches up.
            deadline_ns += lateness_us * 1_000 / ROUND_NS * ROUND_NS;
            self.round((now_ns - self.started_ns) / 1_000);
            while let Ok(request) = requests.try_recv() {
                request(&mut self);
            }
        }
        Finished {
            world: self.world,
            trajectory: self.trajectory.into(),
            counters: self.counters,
            started_ns: self.started_ns,
        }
    }

    /// Advances virtual time first: inputs since the last round arrived before now.
    fn round(&mut self, now_us: u64) {
        while self.next_record_us <= now_us {
            self.world.advance_to(self.next_record_us);
            let truth = self.timed_truth();
            push_bounded(&mut self.trajectory, truth, TRAJECTORY_CAPACITY);
            self.next_record_us += self.trajectory_period_us;
        }
        self.world.advance_to(now_us);
        self.share_floor();
        self.serve_serial();
        self.serve_network();
    }

    /// Tells the other cars' cameras where this one is, and its own where they are. It stops if it
    /// drives into one.
    fn share_floor(&mut self) {
        if let Some(SharedFloor { floor, index }) = &self.floor {
            let started_us = (self.started_ns / 1_000) as i64;
            let truth = self.world.truth();
            let mut floor = floor.lock().unwrap_or_else(PoisonError::into_inner);
            if floor.place(*index, started_us, truth) {
                self.world.car.collide();
            }
            let decoys = floor.decoys(*index, started_us);
            self.world.cameras.move_decoys(decoys);
        }
    }

    fn serve_serial(&mut self) {
        let Some(pty) = &self.pty else {
            return;
        };
        // While the line is stuck, the host's writes stay in its driver.
        if !self.world.wire.faults.stuck {
            let mut buffer = [0; 1024];
            while let Ok(count @ 1..) = pty.read(&mut buffer) {
                if let Some(bytes) = buffer.get(..count) {
                    self.world.host_write(bytes);
                }
            }
        }
        self.bytes.clear();
        self.world.host_read(&mut self.bytes);
        if !self.bytes.is_empty() {
            let written = pty.write(&self.bytes).unwrap_or(0);
            self.counters.bytes_lost += (self.bytes.len() - written) as u64;
        }
        if self.counters.rounds.is_multiple_of(100) {
            pty.clear_exclusive();
        }
    }

    fn serve_network(&mut self) {
        let started_ns = self.started_ns;
        let now_us = move || (monotonic_ns() - started_ns) / 1_000;
        match &mut self.sockets {
            Sockets::NatNet(sockets) => {
                let mut buffer = [0; 2048];
                while let Some((length, from)) = sockets.receive(&mut buffer) {
                    if let Some(datagram) = buffer.get(..length) {
                        let now_us = now_us().max(self.world.now_us);
                        self.world.handle_datagram_at(now_us, from, datagram);
                    }
                }
                while let Some(datagram) = self.world.poll_datagram() {
                    if !sockets.send(&datagram) {
                        self.counters.datagrams_lost += 1;
                    }
                }
            }
            Sockets::Stream(servers) => {
                let cameras = &self.world.cameras;
                let behind_us = self.world.now_us;
                let clock = || cameras.clock.at(now_us().max(behind_us));
                servers.serve(&clock, &cameras.parameters);
                while let Some(frame) = self.world.poll_camera_frame() {
                    let cameras = &self.world.cameras.parameters;
                    self.counters.datagrams_lost += servers.frame(cameras, &frame);
                }
            }
        }
    }

    fn timed_truth(&self) -> TimedTruth {
        let truth = self.world.truth();
        TimedTruth {
            monotonic_ns: self.started_ns + truth.time_us * 1_000,
            truth,
        }
    }
}

/// `CLOCK_MONOTONIC`, in ns.
fn monotonic_ns() -> u64 {
    let now = clock_gettime(rustix::time::ClockId::Monotonic);
    // The clock starts at boot and is never negative.
    now.tv_sec.unsigned_abs() * 1_000_000_000 + now.tv_nsec.unsigned_abs() as u64
}

fn sleep_until(deadline_ns: u64) {
    let deadline = Timespec {
        tv_sec: (deadline_ns / 1_000_000_000) as i64,
        tv_nsec: (deadline_ns % 1_000_000_000) as _,
    };
    // If interrupted, the round starts early, which is harmless.
    let _ = clock_nanosleep_absolute(ClockId::Monotonic, &deadline);
}
