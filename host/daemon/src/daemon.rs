//! The daemon: all threads together.

use std::{
    fs::File,
    io,
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
        mpsc,
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use singletrack_core::{
    Host, HostOptions, LineCounters, Requests, Stalled,
    config::{Config, ConfigError},
    control_loop::{ControlLoop, ControlRequest},
    reconfigure::ChangeError,
    serial::ReaderCounters,
    setpoint_slot::SetpointSender,
};
use singletrack_mocap::planar::PlanarCounters as MocapCounters;
use singletrack_pilot::{Mode, RealTimeState, Reason, Request};
use singletrack_record::{ClockMapping, RecorderThread};
use tracing::{error, info, warn};

use crate::{
    clock::{monotonic_ns, wall_ns},
    collector::{Board, Collector},
    control_thread::{self, Ended, Signs},
    live::{LiveError, LiveThread, LiveView},
    mocap_receiver,
    mocap_socket::{MocapSocketError, MocapSockets},
    realtime::{self, RealTimeStatus},
    reconfigure::{ConfigurationView, Reconfigurer},
    recording::{self, RecordingError},
    serial_reader,
    snapshot::Snapshot,
    socket::{BoundSocket, SocketError, SocketThread},
    summary::Summary,
    wake::StopFlag,
    wall_watch::WallWatch,
};

/// How the daemon is started, beside its configuration.
#[derive(Clone, Debug, Default)]
pub struct StartOptions {
    /// Arms once, as soon as the pilot is ready.
    pub arm: bool,
    /// Keeps the whole process in memory, and the processors from idling deeply if
    /// the configuration asks for real time; as far as the system allows it.
    pub lock_memory: bool,
    /// Where the record goes, instead of a new file in the configured folder.
    pub record: Option<PathBuf>,
    /// For the record: the seed of the simulation that is driven.
    pub seed: Option<u64>,
}

/// Why the daemon does not start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// The configuration makes no sense.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// No socket to the cameras.
    #[error(transparent)]
    MotionCapture(#[from] MocapSocketError),
    /// No record.
    #[error(transparent)]
    Record(#[from] RecordingError),
    /// No control socket.
    #[error(transparent)]
    Socket(#[from] SocketError),
    /// No live view.
    #[error(transparent)]
    Live(#[from] LiveError),
    /// No thread.
    #[error("can't start the {name} thread: {source}")]
    Thread {
        /// Which one.
        name: &'static str,
        /// What the system says.
        source: io::Error,
    },
}

/// Why the daemon did not end well. The board goes to neutral by itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum StopError {
    /// The control thread panicked.
    #[error("the control thread has panicked; the board stops the car by itself")]
    Panicked,
    /// The control thread does not end.
    #[error("the control thread does not end; the board stops the car by itself")]
    Stuck,
}

/// What may be known and asked from anywhere but the control thread.
#[derive(Clone, Debug)]
pub(crate) struct View {
    pub(crate) board: Arc<Board>,
    pub(crate) requests: Requests,
    pub(crate) setpoints: SetpointSender,
    pub(crate) reconfigurer: Reconfigurer,
    realtime: RealTimeStatus,
    live: Option<LiveView>,
}

impl View {
    pub(crate) fn snapshot(&self) -> Snapshot {
        let latest = self.board.latest();
        Snapshot {
            tick: latest.tick,
            board: latest.board,
            board_status: latest.board_status,
            figures: latest.tally.figures(),
            realtime: self.realtime.clone(),
            configuration: self.reconfigurer.view(),
            live: self.live.as_ref().map(LiveView::status),
            record_error: latest.record_error.clone(),
        }
    }
}

/// A running daemon. Dropped, it disarms and ends.
#[derive(Debug)]
pub struct Daemon {
    view: View,
    control: Option<JoinHandle<LineCounters>>,
    signs: Signs,
    stop: StopFlag,
    reader: Option<JoinHandle<ReaderCounters>>,
    receiver: Option<JoinHandle<(MocapCounters, u64)>>,
    collector_stop: Arc<AtomicBool>,
    collector: Option<JoinHandle<()>>,
    recorder: Option<Recording>,
    /// The path of a record that could not be written to the end.
    broken_record: Option<PathBuf>,
    socket: Option<SocketThread>,
    live: Option<LiveThread>,
    /// Open, it keeps the processors from idling deeply.
    _idle: Option<File>,
}

struct Recording {
    thread: RecorderThread,
    path: PathBuf,
}

impl core::fmt::Debug for Recording {
    fn fmt(&self, formatter: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        formatter
            .debug_struct("Recording")
            .field("path", &self.path)
            .finish_non_exhaustive()
    }
}

/// How long a control thread may take to end, beyond what it takes to stop the
/// car.
const END_PATIENCE: Duration = Duration::from_secs(4);

impl Daemon {
    /// Starts all threads. The port need not be there: it is opened when it is.
    ///
    /// Block the signals that are to be handled before: threads inherit that.
    ///
    /// # Errors
    ///
    /// What stands in the way, with the fix. Nothing runs then.
    pub fn start(config: Config, options: StartOptions) -> Result<Self, StartError> {
        let seed = wall_ns() ^ u64::from(std::process::id());
        let host = Host::new(
            config,
            HostOptions {
                nonce_seed: seed,
                arm_when_ready: options.arm,
            },
        )?;
        let config = host.configurations.in_force().clone();
        let mut refusals = Vec::new();
        let memory_locked = options.lock_memory
            && realtime::lock_memory()
                .map_err(|refusal| refusals.push(refusal))
                .is_ok();
        let asks = options.lock_memory && config.control.realtime_priority > 0;
        let idle = asks
            .then(|| realtime::bound_idle().map_err(|refusal| refusals.push(refusal)))
            .and_then(Result::ok);
        let sockets = MocapSockets::open(&config.motion_capture)?;
        let socket = match config.socket.enabled {
            true => Some(BoundSocket::bind(&config.socket.path)?),
            false => None,
        };
        let stop = StopFlag::new().map_err(|source| StartError::Thread {
            name: "control",
            source,
        })?;
        let begin = ClockMapping {
            monotonic_ns: monotonic_ns(),
            wall_ns: wall_ns(),
        };
        let (live_thread, live) = match config.live.enabled {
            true => {
                let (thread, input) = LiveThread::start(config.live, begin)?;
                (Some(thread), Some(input))
            }
            false => (None, None),
        };
        let started = recording::start(&config, options.record, options.seed, begin)?;
        let (recorder, record) = match started {
            Some((thread, input, path)) => (Some(Recording { thread, path }), Some(input)),
            None => (None, None),
        };

        let board = Arc::new(Board::new());
        let (entries_in, entries) = mpsc::channel();
        let mut daemon = Self {
            view: View {
                board: Arc::clone(&board),
                reconfigurer: Reconfigurer::new(
                    host.configurations,
                    host.requests.clone(),
                    entries_in,
                ),
                requests: host.requests,
                setpoints: host.setpoints,
                realtime: RealTimeStatus {
                    fifo_priority: None,
                    memory_locked,
                    idle_bounded: idle.is_some(),
                    refusals,
                },
                live: live_thread.as_ref().map(|thread| thread.view.clone()),
            },
            control: None,
            signs: Signs::default(),
            stop: stop.clone(),
            reader: None,
            receiver: None,
            collector_stop: Arc::new(AtomicBool::new(false)),
            collector: None,
            recorder,
            broken_record: None,
            socket: None,
            live: live_thread,
            _idle: idle,
        };

        let collector = Collector {
            ticks: host.ticks,
            reports: host.reports,
            cameras: host.camera_reports,
            entries,
            wall: WallWatch::default(),
            board,
            record,
            live,
            record_dropped: 0,
            told: None,
            stop: Arc::clone(&daemon.collector_stop),
        };
        let collector = spawn("collector", move || collector.run())?;
        let collector_thread = collector.thread().clone();
        daemon.collector = Some(collector);

        daemon.start_control(&config, host.control, collector_thread)?;
        let (serial, reader_stop) = (config.serial, stop.clone());
        let reader = host.reader;
        daemon.reader = Some(spawn("serial", move || {
            serial_reader::run(reader, serial, &reader_stop)
        })?);
        let receiver = host.receiver;
        daemon.receiver = Some(spawn("mocap", move || {
            mocap_receiver::run(receiver, sockets, &stop)
        })?);
        if let Some(socket) = socket {
            let started = SocketThread::start(socket, daemon.view.clone());
            daemon.socket = Some(started.map_err(|source| StartError::Thread {
                name: "socket",
                source,
            })?);
        }
        Ok(daemon)
    }

    /// Starts the control thread and waits for what the system grants it.
    fn start_control(
        &mut self,
        config: &Config,
        mut control: ControlLoop<crate::serial_port::WriteHalf>,
        collector: thread::Thread,
    ) -> Result<(), StartError> {
        let priority = config.control.realtime_priority;
        let period_ns = config.control.period_ns();
        let signs = self.signs.clone();
        let memory_locked = self.view.realtime.memory_locked;
        let (granted_in, granted) = mpsc::sync_channel(1);
        self.control = Some(spawn("control", move || {
            let _ended = Ended(Arc::clone(&signs.ended));
            realtime::touch_memory(control.rings_mut());
            let granted = realtime::make_punctual(priority);
            control.real_time(RealTimeState {
                fifo: matches!(granted, Ok(Some(_))),
                memory_locked,
            });
            // The starter waits for it.
            let _ = granted_in.send(granted);
            control_thread::run(control, period_ns, &signs, &collector)
        })?);
        let status = &mut self.view.realtime;
        match granted.recv() {
            Ok(Ok(priority)) => status.fifo_priority = priority,
            Ok(Err(refusal)) => status.refusals.push(refusal),
            Err(_) => status
                .refusals
                .push("the control thread has ended".to_owned()),
        }
        for refusal in &status.refusals {
            warn!("{refusal}");
        }
        info!(
            fifo_priority = status.fifo_priority,
            memory_locked = status.memory_locked,
            idle_bounded = status.idle_bounded,
            period_ms = config.control.period_ms,
            "control thread runs"
        );
        Ok(())
    }

    /// How the daemon is doing.
    #[must_use]
    pub fn snapshot(&self) -> Snapshot {
        self.view.snapshot()
    }

    /// Asks the pilot for something. What comes of it shows in
    /// [`snapshot`](Self::snapshot).
    ///
    /// # Errors
    ///
    /// When the control thread takes no requests.
    pub fn request(&self, request: Request) -> Result<(), Stalled> {
        self.view.requests.push(ControlRequest::Pilot(request))
    }

    /// Reads the configuration anew and has controller and board take it over,
    /// all of it or nothing. Returns its number.
    ///
    /// # Errors
    ///
    /// Why the configuration in force stays: the new one makes no sense or takes
    /// a restart, or the car drives.
    pub fn reload(&self, path: &Path) -> Result<u32, ChangeError> {
        self.view.reconfigurer.reload(path)
    }

    /// Which configuration is in force.
    #[must_use]
    pub fn configuration(&self) -> ConfigurationView {
        self.view.reconfigurer.view()
    }

    /// Begins to end: the car slows down and stops, the board is disarmed.
    ///
    /// # Errors
    ///
    /// When the control thread takes no requests.
    pub fn begin_stop(&self) -> Result<(), Stalled> {
        self.view.requests.push(ControlRequest::Finish)
    }

    /// Begins to end at once: the board is disarmed while the car drives.
    ///
    /// # Errors
    ///
    /// When the control thread takes no requests.
    pub fn begin_abort(&self) -> Result<(), Stalled> {
        self.view.requests.push(ControlRequest::Abort)
    }

    /// Looks whether the record is still written; logs it once when it is not,
    /// and the drive goes on without.
    pub fn look_after_record(&mut self) {
        let has_ended = |recording: &mut Recording| !recording.thread.is_writing();
        let Some(Recording { thread, path }) = self.recorder.take_if(has_ended) else {
            return;
        };
        let reason = match thread.finish() {
            Ok(_) => "its thread has ended".to_owned(),
            Err(error) => recording::with_causes(&error),
        };
        error!("nothing is recorded any more: {reason}");
        self.view.board.latest().record_error = Some(reason);
        self.broken_record = Some(path);
    }

    /// Why nothing is recorded any more; none while all is well.
    #[must_use]
    pub fn record_error(&self) -> Option<String> {
        self.view.board.latest().record_error.clone()
    }

    /// How many ticks the control thread has done.
    #[must_use]
    pub fn ticks(&self) -> u64 {
        self.signs.ticks.load(Ordering::Relaxed)
    }

    /// The pilot's mode and why the car does not drive, after the last tick that
    /// is known of.
    #[must_use]
    pub fn mode(&self) -> (Mode, Option<Reason>) {
        let tick = self.view.board.latest().tick;
        tick.map_or((Mode::Disconnected, None), |tick| (tick.mode, tick.reason))
    }

    /// Whether the control thread has ended: on request, or by a panic.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        self.signs.ended.load(Ordering::Acquire)
    }

    /// Stops the car, ends all threads and says what it came to.
    ///
    /// # Errors
    ///
    /// When the control thread did not end well.
    pub fn stop(mut self) -> Result<Summary, StopError> {
        self.end(ControlRequest::Finish)
    }

    fn end(&mut self, how: ControlRequest) -> Result<Summary, StopError> {
        let control = self.end_control(how);
        // The others serve the control thread: they end after it.
        self.stop.raise();
        if let Some(socket) = self.socket.take() {
            socket.stop();
        }
        let mut tally = TallyAtEnd::default();
        if let Some(Ok(counters)) = self.reader.take().map(JoinHandle::join) {
            tally.serial_bytes = counters.bytes_dropped;
        }
        if let Some(Ok((counters, dropped))) = self.receiver.take().map(JoinHandle::join) {
            tally.mocap = Some(counters);
            tally.observations = dropped;
        }
        self.collector_stop.store(true, Ordering::Release);
        if let Some(collector) = self.collector.take() {
            collector.thread().unpark();
            if collector.join().is_err() {
                warn!("the collector's thread has panicked");
            }
        }
        drop(self.live.take());
        let (record, record_error) = self.end_record();
        let counters = control.inspect_err(|_| {
            // There will be no summary to say so.
            if let Some(error) = &record_error {
                warn!("the record is incomplete: {error}");
            }
        })?;
        let mut latest = self.view.board.latest();
        latest.tally.line(&counters);
        if let Some(counters) = &tally.mocap {
            latest.tally.mocap(counters);
        }
        latest
            .tally
            .dropped_on_the_way(tally.observations, tally.serial_bytes);
        Ok(Summary {
            figures: latest.tally.figures(),
            realtime: self.view.realtime.clone(),
            record,
            record_error,
        })
    }

    /// The record's path, and what is wrong with it.
    fn end_record(&mut self) -> (Option<PathBuf>, Option<String>) {
        match self.recorder.take() {
            None => (
                self.broken_record.take(),
                self.view.board.latest().record_error.clone(),
            ),
            Some(Recording { thread, path }) => match thread.finish() {
                Ok(finished) => (Some(finished.path), None),
                Err(error) => (Some(path), Some(recording::with_causes(&error))),
            },
        }
    }

    /// Has the control thread stop the car, and waits for it.
    fn end_control(&mut self, how: ControlRequest) -> Result<LineCounters, StopError> {
        let Some(control) = self.control.take() else {
            return Err(StopError::Panicked);
        };
        if !self.has_ended() && self.view.requests.push(how).is_err() {
            self.signs.give_up.store(true, Ordering::Relaxed);
        }
        let begin = Instant::now();
        while !control.is_finished() {
            if begin.elapsed() > END_PATIENCE {
                self.signs.give_up.store(true, Ordering::Relaxed);
                return Err(StopError::Stuck);
            }
            thread::sleep(Duration::from_millis(1));
        }
        control.join().map_err(|_| StopError::Panicked)
    }
}

/// What the threads beside the control thread counted.
#[derive(Default)]
struct TallyAtEnd {
    serial_bytes: u64,
    observations: u64,
    mocap: Option<MocapCounters>,
}

impl Drop for Daemon {
    fn drop(&mut self) {
        if self.collector.is_none() {
            return;
        }
        match self.end(ControlRequest::Abort) {
            Err(error) => warn!("{error}"),
            Ok(summary) => {
                if let Some(error) = summary.record_error {
                    warn!("the record is incomplete: {error}");
                }
            }
        }
    }
}

fn spawn<T: Send + 'static>(
    name: &'static str,
    body: impl FnOnce() -> T + Send + 'static,
) -> Result<JoinHandle<T>, StartError> {
    thread::Builder::new()
        .name(name.to_owned())
        .spawn(body)
        .map_err(|source| StartError::Thread { name, source })
}
