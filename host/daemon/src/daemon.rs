//! The daemon: starts and ends every thread.

use std::{
    fs::File,
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
        mpsc,
    },
    thread,
    time::{Duration, Instant},
};

use singletrack_core::{
    ControlRequest, Host, HostOptions, LineCounters, Stalled, config::Config,
    control_loop::ControlLoop, reconfigure::ChangeError, serial::ReaderCounters,
    state_stream::States,
};
use singletrack_mocap::planar::PlanarCounters as MocapCounters;
use singletrack_pilot::{Mode, PilotRequest, RealTimeState, Reason};
use singletrack_record::{ClockMapping, Encoder, RecordError};
use tracing::{error, info, warn};

use crate::{
    clock::{WallWatch, monotonic_ns, wall_ns},
    collector::Collector,
    commissioned_file::CommissionedFile,
    control_thread::{self, ControlThreadState, SetOnDrop},
    drive_findings::{DriveCalibration, DriveNoise},
    files::Files,
    files::FreeSpace,
    handle::{DaemonHandle, Snapshot},
    mocap_receiver::{self, MocapSockets},
    realtime::{self, RealTimeStatus},
    reconfigure::Reconfigurer,
    recording::{self, RunningRecord},
    serial_port,
    shared_status::SharedStatus,
    socket::{BoundSocket, Drives, SocketThread},
    state_file::StateFile,
    summary::Summary,
    threads::{NamedThread, StopFlag},
};

/// What a start needs besides the configuration.
#[derive(Clone, Debug, Default)]
pub struct StartOptions {
    /// Arm once, as soon as the pilot is ready.
    pub arm: bool,
    /// Lock the process's memory and, if the configuration asks for real-time scheduling,
    /// keep the processors from idling deeply. A refusal of the system is reported in
    /// [`RealTimeStatus::refusals`] and is not an error.
    pub lock_memory: bool,
    /// The file of the record, instead of a new one in the configured folder.
    pub record: Option<PathBuf>,
    /// The file of the configuration, for a client that asks to reload it.
    pub config_path: Option<PathBuf>,
    /// The seed of the simulation, for the metadata of the record.
    pub seed: Option<u64>,
}

/// Why the daemon did not end in order. The board puts the car to neutral by itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum StopError {
    /// Another thread than the control thread, of this name, ended before it was asked to.
    #[error("the {0} thread has ended by itself: the car was stopped and disarmed")]
    Thread(&'static str),
    /// The control thread panicked.
    #[error("the control thread has panicked; the board stops the car by itself")]
    Panicked,
    /// The control thread did not end in time.
    #[error("the control thread does not end; the board stops the car by itself")]
    Stuck,
}

/// A running daemon. If it is dropped, it disarms the board and ends.
#[derive(Debug)]
pub struct Daemon {
    pub(crate) handle: DaemonHandle,
    control: Option<NamedThread<LineCounters>>,
    stop: StopFlag,
    reader: Option<NamedThread<ReaderCounters>>,
    receiver: Option<NamedThread<(MocapCounters, u64)>>,
    collector_stop: Arc<AtomicBool>,
    collector: Option<NamedThread<()>>,
    files: Option<NamedThread<()>>,
    record: Option<RunningRecord>,
    /// Whether the recorder has panicked.
    recorder_panicked: bool,
    /// The path of a record whose recorder failed.
    broken_record: Option<PathBuf>,
    socket: Option<SocketThread>,
    /// Keeps the processors from idling deeply while it is open.
    _idle_bound: Option<File>,
}

/// The longest wait for the control thread to stop the car and end.
const END_TIMEOUT: Duration = Duration::from_secs(4);

impl Daemon {
    /// Starts all threads. The serial port is opened as soon as it exists.
    ///
    /// Block the signals that the caller handles before the call: threads inherit the
    /// mask.
    ///
    /// # Errors
    ///
    /// Why it does not start, and what to do about it. No thread runs then.
    pub fn start(config: Config, options: StartOptions) -> Result<Self, String> {
        let state = StateFile::load(&config.state.directory);
        let commissioned = CommissionedFile::load(&config.state.directory);
        let seed = wall_ns() ^ u64::from(std::process::id());
        let options_of_host = HostOptions {
            nonce_seed: seed,
            arm_when_ready: options.arm,
            proofs: state.proofs(),
            ..HostOptions::default()
        };
        let host = match Host::new(config, options_of_host) {
            Ok(host) => host,
            Err(error) => return Err(error.to_string()),
        };
        let config = host.configurations.in_force.clone();
        let mut refusals = Vec::new();
        let memory_locked = options.lock_memory
            && realtime::lock_memory()
                .map_err(|refusal| refusals.push(refusal))
                .is_ok();
        let wants_real_time = options.lock_memory && config.control.realtime_priority > 0;
        let idle_bound = wants_real_time
            .then(|| realtime::bound_idle().map_err(|refusal| refusals.push(refusal)))
            .and_then(Result::ok);
        let sockets = MocapSockets::open(&config.motion_capture)?;
        let listens = config.socket.enabled;
        let socket = listens.then(|| BoundSocket::open(&config.socket));
        let socket = socket.transpose()?;
        let stop = StopFlag::new().map_err(|error| format!("can't make an eventfd: {error}"))?;
        let begin = ClockMapping {
            monotonic_ns: monotonic_ns(),
            wall_ns: wall_ns(),
        };
        let started = recording::start(&config, options.record, options.seed, begin)?;
        let (running_record, record) = started.unzip();

        let status = Arc::new(SharedStatus::new(begin));
        let (entries_in, entries) = mpsc::channel();
        let (proofs, proof_changes) = mpsc::channel();
        let files = Files {
            state,
            space: running_record.as_ref().map(|record| FreeSpace {
                directory: record.path.parent().unwrap_or(&record.path).to_owned(),
                min_free_mb: config.record.min_free_mb,
            }),
            status: Arc::clone(&status),
            entries: entries_in.clone(),
        };
        let mut daemon = Self {
            handle: DaemonHandle {
                status: Arc::clone(&status),
                control: ControlThreadState::default(),
                reconfigurer: Reconfigurer::new(
                    host.configurations,
                    host.requests.clone(),
                    entries_in,
                ),
                requests: host.requests,
                setpoints: host.setpoints,
                newest_setpoint: Arc::default(),
                jogs: host.jogs,
                tunings: host.tunings,
                config_path: options
                    .config_path
                    .map(|path| std::path::absolute(&path).unwrap_or(path)),
                record: running_record.as_ref().map(|record| record.path.clone()),
                realtime: RealTimeStatus {
                    fifo_priority: None,
                    memory_locked,
                    idle_bounded: idle_bound.is_some(),
                    refusals,
                },
                commissioned,
                drives: Drives::default(),
            },
            control: None,
            stop: stop.clone(),
            reader: None,
            receiver: None,
            collector_stop: Arc::new(AtomicBool::new(false)),
            collector: None,
            files: None,
            record: running_record,
            recorder_panicked: false,
            broken_record: None,
            socket: None,
            _idle_bound: idle_bound,
        };

        let collector = Collector {
            ticks: host.ticks,
            reports: host.reports,
            cameras: host.camera_reports,
            entries,
            requests: daemon.handle.requests.clone(),
            wall: WallWatch::default(),
            status,
            reconfigurer: daemon.handle.reconfigurer.clone(),
            record,
            messages: Encoder::new(begin),
            logged_mode: None,
            noise: DriveNoise::default(),
            calibration: DriveCalibration::default(),
            states: States::default(),
            proofs,
            stop: Arc::clone(&daemon.collector_stop),
        };
        let collector = NamedThread::spawn("collector", move || collector.run())?;
        let collector_thread = collector.thread().clone();
        daemon.collector = Some(collector);
        daemon.files = Some(NamedThread::spawn("files", move || {
            files.run(&proof_changes);
        })?);

        let control = daemon.start_control(&config, host.control, collector_thread)?;
        let (serial, cameras) = (config.serial, config.motion_capture);
        let fifo_priority = daemon.handle.realtime.fifo_priority;
        let reader_stop = stop.clone();
        let reader = host.reader;
        let status = Arc::clone(&daemon.handle.status);
        daemon.reader = Some(NamedThread::spawn("serial", move || {
            realtime::make_prompt(fifo_priority);
            serial_port::run(reader, serial, status, &reader_stop)
        })?);
        let receiver = host.receiver;
        daemon.receiver = Some(NamedThread::spawn("mocap", move || {
            realtime::make_prompt(fifo_priority);
            mocap_receiver::run(receiver, sockets, &cameras, &stop, &control)
        })?);
        if let Some(socket) = socket {
            daemon.socket = Some(SocketThread::start(socket, daemon.handle.clone())?);
        }
        Ok(daemon)
    }

    /// Starts the control thread, and waits until it knows what the system grants it. Returns
    /// the handle that wakes it.
    fn start_control(
        &mut self,
        config: &Config,
        mut control: ControlLoop<serial_port::WriteHalf>,
        collector: thread::Thread,
    ) -> Result<thread::Thread, String> {
        let priority = config.control.realtime_priority;
        let period_ns = config.control.period_ns();
        let state = self.handle.control.clone();
        let memory_locked = self.handle.realtime.memory_locked;
        let (granted_in, granted) = mpsc::sync_channel(1);
        let thread = NamedThread::spawn("control", move || {
            let _ended = SetOnDrop(Arc::clone(&state.ended));
            realtime::touch_memory(&mut control.rings);
            let granted = realtime::make_punctual(priority);
            control.real_time(RealTimeState {
                fifo: matches!(granted, Ok(Some(_))),
                memory_locked,
            });
            // `start_control` waits for it.
            let _ = granted_in.send(granted);
            control_thread::run(control, period_ns, &state, &collector)
        })?;
        let handle = thread.thread().clone();
        self.control = Some(thread);
        let status = &mut self.handle.realtime;
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
            "control thread started"
        );
        Ok(handle)
    }

    /// The present status: the last tick, the board, and the figures so far.
    pub fn snapshot(&self) -> Snapshot {
        self.handle.snapshot()
    }

    /// Passes a request to the pilot. The effect shows in [`snapshot`](Self::snapshot)
    /// after the next tick.
    ///
    /// # Errors
    ///
    /// [`Stalled`] if the control thread takes no requests.
    pub fn request(&self, request: PilotRequest) -> Result<(), Stalled> {
        self.handle.requests.push(ControlRequest::Pilot(request))
    }

    /// Reloads the configuration and puts all of it in force, for controller and board.
    /// Returns its number.
    ///
    /// # Errors
    ///
    /// [`ChangeError`] if the new configuration is invalid or needs a restart, or if the
    /// car drives. The configuration in force stays then.
    pub fn reload(&self, path: &Path) -> Result<u32, ChangeError> {
        self.handle.reconfigurer.reload(path)
    }

    /// The number of the configuration in force, and the last attempt to change it.
    pub fn configuration(&self) -> singletrack_api::Configuration {
        self.handle.reconfigurer.published().view.clone()
    }

    /// Logs once if the recorder has failed. The drive goes on without a record.
    pub fn check_record(&mut self) {
        let has_ended = |record: &mut RunningRecord| !record.thread.is_writing();
        let Some(RunningRecord { thread, path }) = self.record.take_if(has_ended) else {
            return;
        };
        let reason = match thread.finish() {
            Ok(_) => "its thread has ended".to_owned(),
            Err(error) => {
                self.recorder_panicked = matches!(error, RecordError::Thread { .. });
                recording::with_causes(&error)
            }
        };
        error!("recording has ended: {reason}");
        self.handle.status.latest().record_error = Some(reason);
        self.broken_record = Some(path);
    }

    /// The number of ticks that the control thread has done.
    pub fn ticks(&self) -> u64 {
        self.handle.control.ticks.load(Ordering::Relaxed)
    }

    /// The pilot's mode and reason after the last tick; disconnected before the first.
    pub fn mode(&self) -> (Mode, Option<Reason>) {
        let latest = self.handle.status.latest();
        let output = latest.tick.as_ref().map(|tick| &tick.output);
        output.map_or((Mode::Disconnected, None), |output| {
            (output.mode, output.reason)
        })
    }

    /// The name of a thread that has ended: of the control thread on request or by a panic, of every
    /// other one by a fault. The daemon is to be [stopped](Self::stop) then: a drive must not go on
    /// without its reader, its cameras or its control socket. A record that can't be written ends
    /// only itself.
    pub fn ended_thread(&self) -> Option<&'static str> {
        if self.handle.control.ended.load(Ordering::Acquire) {
            return Some("control");
        }
        self.failed_thread()
    }

    /// The name of a thread other than the control thread that has ended by itself.
    fn failed_thread(&self) -> Option<&'static str> {
        let socket = self.socket.as_ref().map(|socket| &socket.thread);
        ended(&self.reader)
            .or_else(|| ended(&self.receiver))
            .or_else(|| socket.filter(|it| it.has_ended()).map(|thread| thread.name))
            .or_else(|| ended(&self.collector))
            .or_else(|| ended(&self.files))
            .or(self.recorder_panicked.then_some("recorder"))
    }

    /// Stops the car, ends all threads and returns the figures of the run.
    ///
    /// # Errors
    ///
    /// [`StopError`] if a thread had ended by itself, or the control thread did not end in time.
    pub fn stop(mut self) -> Result<Summary, StopError> {
        self.end(ControlRequest::Finish)
    }

    fn end(&mut self, how: ControlRequest) -> Result<Summary, StopError> {
        let mut failed = self.failed_thread();
        let control = self.end_control(how);
        // The other threads serve the control thread, so they end after it.
        self.stop.raise();
        if let Some(socket) = self.socket.take() {
            join(Some(socket.end()), &mut failed);
        }
        let reader = join(self.reader.take(), &mut failed);
        let receiver = join(self.receiver.take(), &mut failed);
        self.collector_stop.store(true, Ordering::Release);
        if let Some(collector) = &self.collector {
            collector.thread().unpark();
        }
        join(self.collector.take(), &mut failed);
        // The last of its senders was the collector.
        join(self.files.take(), &mut failed);
        let (record, record_error) = self.end_record();
        let counters = control.and_then(|counters| match failed {
            Some(name) => Err(StopError::Thread(name)),
            None => Ok(counters),
        });
        let counters = counters.inspect_err(|_| {
            // An error returns no summary that could report it.
            if let Some(error) = &record_error {
                warn!("the record is incomplete: {error}");
            }
        })?;
        let mut tally = self.handle.status.tally();
        tally.line(&counters);
        if let Some((counters, dropped)) = receiver {
            tally.mocap(&counters);
            tally.figures.dropped.observations = dropped;
        }
        let serial_bytes = reader.map_or(0, |counters| counters.bytes_dropped);
        tally.figures.dropped.serial_bytes = serial_bytes;
        Ok(Summary {
            figures: tally.figures(),
            realtime: self.handle.realtime.clone(),
            record,
            record_error,
        })
    }

    /// Closes the record. Returns its path, and the error if it is incomplete.
    fn end_record(&mut self) -> (Option<PathBuf>, Option<String>) {
        match self.record.take() {
            None => (
                self.broken_record.take(),
                self.handle.status.latest().record_error.clone(),
            ),
            Some(RunningRecord { thread, path }) => match thread.finish() {
                Ok(finished) => (Some(finished.path), None),
                Err(error) => (Some(path), Some(recording::with_causes(&error))),
            },
        }
    }

    /// Asks the control thread to end, and waits for it.
    fn end_control(&mut self, how: ControlRequest) -> Result<LineCounters, StopError> {
        let Some(control) = self.control.take() else {
            return Err(StopError::Panicked);
        };
        if !self.handle.control.ended.load(Ordering::Acquire)
            && self.handle.requests.push(how).is_err()
        {
            self.handle.control.abort.store(true, Ordering::Relaxed);
        }
        let begin = Instant::now();
        while !control.has_ended() {
            if begin.elapsed() > END_TIMEOUT {
                self.handle.control.abort.store(true, Ordering::Relaxed);
                return Err(StopError::Stuck);
            }
            thread::sleep(Duration::from_millis(1));
        }
        control.join().ok_or(StopError::Panicked)
    }
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

/// The name of a thread that has ended.
fn ended<T>(thread: &Option<NamedThread<T>>) -> Option<&'static str> {
    let thread = thread.as_ref().filter(|thread| thread.has_ended());
    thread.map(|thread| thread.name)
}

/// Waits for the end of a thread; one that has panicked is named in `failed`.
fn join<T>(thread: Option<NamedThread<T>>, failed: &mut Option<&'static str>) -> Option<T> {
    let thread = thread?;
    let name = thread.name;
    let result = thread.join();
    if result.is_none() {
        failed.get_or_insert(name);
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A daemon without board and cameras.
    fn daemon(folder: &Path) -> Daemon {
        let text = include_str!("../singletrackd.example.toml");
        let mut config = Config::from_toml(text).unwrap();
        config.serial.port = folder.join("tty");
        config.motion_capture.server = std::net::Ipv4Addr::LOCALHOST;
        config.motion_capture.command_port = Some(9);
        config.record.directory = folder.join("records");
        config.state.directory = folder.join("state");
        config.socket.path = folder.join("control.sock");
        config.control.realtime_priority = 0;
        Daemon::start(config, StartOptions::default()).unwrap()
    }

    /// Ends the thread, and puts one that panics in its place.
    fn plant<T: Send + 'static>(place: &mut Option<NamedThread<T>>) {
        let name = place.take().unwrap().name;
        *place = Some(NamedThread::spawn(name, || panic!("planted")).unwrap());
    }

    #[test]
    fn a_panic_of_any_thread_ends_the_daemon_with_the_name_of_the_thread() {
        type Plants = fn(&mut Daemon);
        let cases: [(&str, Plants); 5] = [
            ("serial", |daemon| plant(&mut daemon.reader)),
            ("mocap", |daemon| plant(&mut daemon.receiver)),
            ("collector", |daemon| plant(&mut daemon.collector)),
            ("files", |daemon| plant(&mut daemon.files)),
            ("socket", |daemon| {
                let socket = daemon.socket.as_mut().unwrap();
                socket.thread = NamedThread::spawn("socket", || panic!("planted")).unwrap();
            }),
        ];
        for (name, plant) in cases {
            let folder = tempfile::tempdir().unwrap();
            let mut daemon = daemon(folder.path());
            assert_eq!(daemon.ended_thread(), None);
            plant(&mut daemon);
            let begin = Instant::now();
            while daemon.ended_thread().is_none() && begin.elapsed() < Duration::from_secs(20) {
                thread::yield_now();
            }
            assert_eq!(daemon.ended_thread(), Some(name));
            assert_eq!(daemon.stop().unwrap_err(), StopError::Thread(name));
        }
    }

    #[test]
    fn a_daemon_whose_threads_live_ends_with_its_figures() {
        let folder = tempfile::tempdir().unwrap();
        daemon(folder.path()).stop().unwrap();
    }
}
