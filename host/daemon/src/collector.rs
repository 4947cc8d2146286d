//! The thread that takes what the real-time threads tell, and passes it on: to
//! the log, the record, the figures and whoever watches.

use std::{
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
        mpsc,
    },
    thread,
    time::Duration,
};

use rtrb::Consumer;
use singletrack_core::{Report, cameras::CameraReport};
use singletrack_link::Event as LinkEvent;
use singletrack_pilot::{Mode, Reason};
use singletrack_protocol::{BoardMode, Status, StopCause};
use singletrack_record::{Entry, FeedInput, Level, Log, TickOutput, Topic};
use tokio::sync::broadcast;

use crate::{
    clock::{monotonic_ns, wall_ns},
    snapshot::TickView,
    summary::Tally,
    wall_watch::WallWatch,
};

/// How long the collector sleeps when nobody wakes it.
const NAP: Duration = Duration::from_millis(20);

/// Lines that a watcher may be behind before it misses some.
const WATCH_CAPACITY: usize = 1_024;

/// The latest of everything.
#[derive(Debug, Default)]
pub(crate) struct Latest {
    pub(crate) tick: Option<TickView>,
    pub(crate) board: Option<(BoardMode, StopCause)>,
    pub(crate) board_status: Option<Status>,
    pub(crate) tally: Tally,
    /// Why the record has ended before the daemon did.
    pub(crate) record_error: Option<String>,
}

/// What everybody but the control thread may look at.
#[derive(Debug)]
pub(crate) struct Board {
    latest: Mutex<Latest>,
    /// Records as JSON lines.
    pub(crate) watchers: broadcast::Sender<(Topic, Arc<str>)>,
}

impl Board {
    pub(crate) fn new() -> Self {
        Self {
            latest: Mutex::default(),
            watchers: broadcast::Sender::new(WATCH_CAPACITY),
        }
    }

    /// Not for the control thread.
    pub(crate) fn latest(&self) -> MutexGuard<'_, Latest> {
        // Whoever panicked with it left figures, not promises.
        self.latest.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Everything on the collector's thread.
pub(crate) struct Collector {
    pub(crate) ticks: TickOutput,
    pub(crate) reports: Consumer<Report>,
    pub(crate) cameras: Consumer<CameraReport>,
    /// For the record alone; what of it is to be logged has been.
    pub(crate) entries: mpsc::Receiver<Entry>,
    /// Whether somebody sets the clock on the wall.
    pub(crate) wall: WallWatch,
    pub(crate) board: Arc<Board>,
    pub(crate) record: Option<FeedInput>,
    /// What goes to it is also shown live.
    pub(crate) live: Option<FeedInput>,
    /// Entries that the record has no room for.
    pub(crate) record_dropped: u64,
    pub(crate) told: Option<(Mode, Option<Reason>)>,
    /// Everybody else has ended.
    pub(crate) stop: Arc<AtomicBool>,
}

impl Collector {
    /// Runs until it is told to stop and everything is passed on.
    pub(crate) fn run(mut self) {
        loop {
            // Asked first: what was told before the stop is passed on.
            let stopping = self.stop.load(Ordering::Acquire);
            self.pass_on();
            if stopping {
                return;
            }
            thread::park_timeout(NAP);
        }
    }

    fn pass_on(&mut self) {
        let now_ns = monotonic_ns();
        if let Some(step) = self.wall.look(now_ns, wall_ns()) {
            self.log(
                now_ns,
                Level::Info,
                format!("{step}; times in the record go on as before"),
            );
        }
        while let Ok(entry) = self.entries.try_recv() {
            self.entry(entry);
        }
        while let Ok(report) = self.reports.pop() {
            self.report(report);
        }
        while let Ok(report) = self.cameras.pop() {
            match report {
                CameraReport::Observation(observation) => self.entry(Entry::Pose(observation)),
                CameraReport::Counters(counters) => self.board.latest().tally.mocap(&counters),
            }
        }
        while let Some(tick) = self.ticks.pop() {
            self.mode(tick.start_ns, tick.output.mode, tick.output.reason);
            {
                let mut latest = self.board.latest();
                latest.tick = Some(TickView::from(&tick));
                latest.tally.tick(&tick);
            }
            self.entry(Entry::Tick(tick));
        }
    }

    fn report(&mut self, report: Report) {
        match report {
            Report::Telemetry(record) => {
                let telemetry = &record.telemetry;
                self.board.latest().board = Some((telemetry.mode, telemetry.stop_cause));
                self.entry(Entry::Telemetry(record));
            }
            Report::Status(record) => {
                self.board.latest().board_status = Some(record.status);
                self.entry(Entry::Status(record));
            }
            Report::Link { time_ns, event } => {
                let (level, text) = describe(&event);
                self.log(time_ns, level, text);
            }
            Report::Counters(counters) => self.board.latest().tally.line(&counters),
        }
    }

    /// Logs a change of mode, with the word that explains it.
    fn mode(&mut self, time_ns: u64, mode: Mode, reason: Option<Reason>) {
        if self.told == Some((mode, reason)) {
            return;
        }
        self.told = Some((mode, reason));
        let level = match (mode, reason) {
            // As it was meant to end.
            (Mode::Stopping, Some(Reason::Requested | Reason::ReferenceFinished)) => Level::Info,
            (Mode::Fault, _) | (Mode::Stopping, Some(_)) => Level::Warning,
            _ => Level::Info,
        };
        let text = match reason {
            Some(reason) => format!("mode {mode}: {reason}"),
            None => format!("mode {mode}"),
        };
        self.log(time_ns, level, text);
    }

    fn log(&mut self, time_ns: u64, level: Level, text: String) {
        match level {
            Level::Debug => tracing::debug!("{text}"),
            Level::Info => tracing::info!("{text}"),
            Level::Warning => tracing::warn!("{text}"),
            Level::Error => tracing::error!("{text}"),
        }
        self.entry(Entry::Log(Log {
            time_ns,
            level,
            text,
        }));
    }

    fn entry(&mut self, entry: Entry) {
        if self.board.watchers.receiver_count() > 0 {
            let mut line = String::new();
            entry.write_json(&mut line);
            // Without watchers nobody misses it.
            let _ = self.board.watchers.send((entry.topic(), Arc::from(line)));
        }
        if let Some(live) = &mut self.live {
            // What viewers miss, the record has.
            let _ = live.push(entry.clone());
        }
        if let Some(record) = &mut self.record
            && !record.push(entry)
        {
            // Of a record that has ended it is known why.
            if self.record_dropped == 0 && self.board.latest().record_error.is_none() {
                tracing::warn!(
                    time_ns = monotonic_ns(),
                    "the record is incomplete: the disk does not keep up"
                );
            }
            self.record_dropped += 1;
            self.board
                .latest()
                .tally
                .record_dropped(self.record_dropped);
        }
    }
}

/// An event of the link for the log.
fn describe(event: &LinkEvent) -> (Level, String) {
    let version = |[major, minor, patch]: [u8; 3]| format!("{major}.{minor}.{patch}");
    match event {
        LinkEvent::Connected {
            board_software_version,
        } => (
            Level::Info,
            format!(
                "board connected, software {}",
                version(*board_software_version)
            ),
        ),
        LinkEvent::VersionMismatch(mismatch) => (Level::Error, mismatch.to_string()),
        LinkEvent::ConfigurationAccepted { hash } => (
            Level::Info,
            format!("board took its configuration, {hash:08x}"),
        ),
        LinkEvent::ConfigurationRefused { reason } => (
            Level::Error,
            format!("board refused its configuration: {}", reason.name()),
        ),
        LinkEvent::BoardRestarted { evidence } => (
            Level::Warning,
            format!("board restarted: {}", evidence.name()),
        ),
        LinkEvent::Acknowledged { request, .. } => (
            Level::Info,
            format!("board did as asked: {}", request.name()),
        ),
        LinkEvent::Refused {
            request, reason, ..
        } => (
            Level::Warning,
            format!("board refused: {}: {}", request.name(), reason.name()),
        ),
        LinkEvent::Unanswered { request, .. } => (
            Level::Warning,
            format!("board did not answer: {}", request.name()),
        ),
        LinkEvent::StopConfirmed { request } => {
            (Level::Info, format!("board confirmed: {}", request.name()))
        }
        LinkEvent::Lost { cause } => (Level::Warning, format!("board lost: {}", cause.name())),
        LinkEvent::Telemetry(_) | LinkEvent::Status(_) => {
            (Level::Debug, "board reported".to_owned())
        }
    }
}
