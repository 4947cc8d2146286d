//! The world in real time: behind a pseudo-terminal and UDP, on its own thread.

use std::{
    collections::VecDeque,
    io,
    net::SocketAddrV4,
    path::{Path, PathBuf},
    sync::{
        Arc,
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
    car::Truth,
    parameters::{ConfigError, SimulationConfig},
    pty::{Pty, PtyError},
    udp::{NatNetSockets, UdpConfig, UdpError},
    world::World,
};

/// What the real-time simulator needs beyond the simulation itself.
#[derive(Clone, Debug, PartialEq)]
pub struct RealTimeConfig {
    /// The simulation.
    pub simulation: SimulationConfig,
    /// Where to link the pseudo-terminal, so that its path stays the same when
    /// it is unplugged and plugged in again.
    pub pty_link: Option<PathBuf>,
    /// Where the NatNet server listens.
    pub udp: UdpConfig,
    /// Time between two points of the recorded trajectory, in µs.
    pub trajectory_period_us: u64,
}

impl Default for RealTimeConfig {
    fn default() -> Self {
        Self {
            simulation: SimulationConfig::default(),
            pty_link: None,
            udp: UdpConfig::default(),
            trajectory_period_us: 5_000,
        }
    }
}

/// Why the simulator does not start, or has stopped.
#[derive(Debug, thiserror::Error)]
pub enum RealTimeError {
    /// A setting with which nothing can be simulated.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// No pseudo-terminal.
    #[error(transparent)]
    Pty(#[from] PtyError),
    /// No socket.
    #[error(transparent)]
    Udp(#[from] UdpError),
    /// No thread.
    #[error("cannot start the simulator's thread: {0}")]
    Thread(#[source] io::Error),
    /// The simulator's thread has ended.
    #[error("the simulator has stopped")]
    Stopped,
}

/// The truth at a moment of `CLOCK_MONOTONIC`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TimedTruth {
    /// `CLOCK_MONOTONIC`, in ns.
    pub monotonic_ns: u64,
    /// What was so.
    pub truth: Truth,
}

/// How the simulator's thread has fared.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RealTimeCounters {
    /// Rounds of the loop.
    pub rounds: u64,
    /// Rounds that began more than 5 ms late.
    pub late_rounds: u64,
    /// Latest begin of a round, in µs.
    pub max_lateness_us: u64,
    /// Bytes for which the pseudo-terminal had no room.
    pub bytes_lost: u64,
    /// Datagrams that could not be sent.
    pub datagrams_lost: u64,
}

/// What is left when the simulator has stopped.
#[derive(Debug)]
pub struct Finished {
    /// The world at its last moment.
    pub world: World,
    /// The recorded trajectory that nobody took, oldest first.
    pub trajectory: Vec<TimedTruth>,
    /// How the thread has fared.
    pub counters: RealTimeCounters,
    /// `CLOCK_MONOTONIC` at simulation time zero, in ns.
    pub started_ns: u64,
}

type Request = Box<dyn FnOnce(&mut Machine) + Send>;

/// A running simulator. Dropped, it stops.
#[derive(Debug)]
pub struct RealTimeSimulator {
    requests: mpsc::Sender<Request>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<Finished>>,
    pty_path: PathBuf,
    command_address: SocketAddrV4,
    data_address: SocketAddrV4,
    started_ns: u64,
}

impl RealTimeSimulator {
    /// Opens pseudo-terminal and sockets and starts the simulation.
    ///
    /// # Errors
    ///
    /// What stands in the way.
    pub fn start(config: RealTimeConfig) -> Result<Self, RealTimeError> {
        let mut world = World::new(config.simulation)?;
        let sockets = NatNetSockets::bind(&config.udp, world.natnet().parameters().group)?;
        world
            .natnet_mut()
            .set_data_port(sockets.data_address().port());
        let pty = Pty::open(config.pty_link.as_deref())?;
        let pty_path = pty.path().to_owned();
        let (command_address, data_address) = (sockets.command_address(), sockets.data_address());
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

    /// Where the board's serial port is: the link if one was asked for, else
    /// the device (which is another one after [`plug`](Self::plug)).
    #[must_use]
    pub fn pty_path(&self) -> &Path {
        &self.pty_path
    }

    /// Where the NatNet server takes commands.
    #[must_use]
    pub const fn command_address(&self) -> SocketAddrV4 {
        self.command_address
    }

    /// Where its frames come from; its port is also the multicast port.
    #[must_use]
    pub const fn data_address(&self) -> SocketAddrV4 {
        self.data_address
    }

    /// `CLOCK_MONOTONIC` at simulation time zero, in ns.
    #[must_use]
    pub const fn started_ns(&self) -> u64 {
        self.started_ns
    }

    /// Does something with the world on the simulator's thread, within its
    /// next millisecond, and returns the result.
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

    /// What is so now.
    ///
    /// # Errors
    ///
    /// [`RealTimeError::Stopped`].
    pub fn truth(&self) -> Result<TimedTruth, RealTimeError> {
        self.with_machine(|machine| machine.timed_truth())
    }

    /// How the thread has fared so far.
    ///
    /// # Errors
    ///
    /// [`RealTimeError::Stopped`].
    pub fn counters(&self) -> Result<RealTimeCounters, RealTimeError> {
        self.with_machine(|machine| machine.counters)
    }

    /// Takes the trajectory recorded since the last call, oldest first.
    ///
    /// # Errors
    ///
    /// [`RealTimeError::Stopped`].
    pub fn take_trajectory(&self) -> Result<Vec<TimedTruth>, RealTimeError> {
        self.with_machine(|machine| core::mem::take(&mut machine.trajectory).into())
    }

    /// Pulls the serial line out: the host sees a hang-up, the link is gone.
    ///
    /// # Errors
    ///
    /// [`RealTimeError::Stopped`].
    pub fn unplug(&self) -> Result<(), RealTimeError> {
        self.with_machine(|machine| {
            machine.pty = None;
            machine.world.set_wire_connected(false);
        })
    }

    /// Plugs the serial line in again, with a new pseudo-terminal under the
    /// same link. Returns where it is.
    ///
    /// # Errors
    ///
    /// When there is no pseudo-terminal to be had, or [`RealTimeError::Stopped`].
    pub fn plug(&self) -> Result<PathBuf, RealTimeError> {
        self.with_machine(|machine| -> Result<PathBuf, RealTimeError> {
            if let Some(pty) = &machine.pty {
                return Ok(pty.path().to_owned());
            }
            let pty = Pty::open(machine.link.as_deref())?;
            let path = pty.path().to_owned();
            machine.pty = Some(pty);
            machine.world.set_wire_connected(true);
            Ok(path)
        })?
    }

    /// Stops, and returns what is left.
    ///
    /// # Errors
    ///
    /// [`RealTimeError::Stopped`] when the thread has ended otherwise.
    pub fn stop(mut self) -> Result<Finished, RealTimeError> {
        self.stop.store(true, Ordering::Relaxed);
        self.thread
            .take()
            .and_then(|thread| thread.join().ok())
            .ok_or(RealTimeError::Stopped)
    }

    fn with_machine<R: Send + 'static>(
        &self,
        action: impl FnOnce(&mut Machine) -> R + Send + 'static,
    ) -> Result<R, RealTimeError> {
        let (sender, receiver) = mpsc::sync_channel(1);
        self.requests
            .send(Box::new(move |machine| {
                // Who asked may have gone.
                let _ = sender.send(action(machine));
            }))
            .map_err(|_| RealTimeError::Stopped)?;
        receiver.recv().map_err(|_| RealTimeError::Stopped)
    }
}

impl Drop for RealTimeSimulator {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // It has nothing to say any more.
            let _ = thread.join();
        }
    }
}

/// Everything on the simulator's thread.
#[derive(Debug)]
struct Machine {
    world: World,
    pty: Option<Pty>,
    link: Option<PathBuf>,
    sockets: NatNetSockets,
    started_ns: u64,
    trajectory: VecDeque<TimedTruth>,
    trajectory_period_us: u64,
    next_record_us: u64,
    counters: RealTimeCounters,
    bytes: Vec<u8>,
}

/// Time between two rounds, in ns.
const ROUND_NS: u64 = 1_000_000;
/// Points of the trajectory kept: over an hour at 5 ms.
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
            // No round is made up for: the world catches up in this one.
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

    /// Virtual time first: what has come since the last round came before now.
    fn round(&mut self, now_us: u64) {
        while self.next_record_us <= now_us {
            self.world.advance_to(self.next_record_us);
            if self.trajectory.len() >= TRAJECTORY_CAPACITY {
                self.trajectory.pop_front();
            }
            self.trajectory.push_back(self.timed_truth());
            self.next_record_us += self.trajectory_period_us;
        }
        self.world.advance_to(now_us);
        self.serve_serial();
        self.serve_network();
    }

    fn serve_serial(&mut self) {
        let Some(pty) = &self.pty else {
            return;
        };
        // Into a stuck line the host's writes pile up in its own driver.
        if !self.world.wire().faults().stuck {
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
        let mut buffer = [0; 2048];
        while let Some((length, from)) = self.sockets.receive(&mut buffer) {
            if let Some(datagram) = buffer.get(..length) {
                let now_us = (monotonic_ns() - self.started_ns) / 1_000;
                self.world
                    .handle_datagram_at(now_us.max(self.world.now_us()), from, datagram);
            }
        }
        while let Some(datagram) = self.world.poll_datagram() {
            if !self.sockets.send(&datagram) {
                self.counters.datagrams_lost += 1;
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
    // The clock starts at boot: it is never negative.
    now.tv_sec.unsigned_abs() * 1_000_000_000 + now.tv_nsec.unsigned_abs() as u64
}

fn sleep_until(deadline_ns: u64) {
    let deadline = Timespec {
        tv_sec: (deadline_ns / 1_000_000_000) as i64,
        tv_nsec: (deadline_ns % 1_000_000_000) as _,
    };
    // Interrupted, the round is early and finds little to do.
    let _ = clock_nanosleep_absolute(ClockId::Monotonic, &deadline);
}
