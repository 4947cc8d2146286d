//! The collector's thread: distributes the output of the real-time threads to the log,
//! the record, the figures and the watchers.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
        mpsc,
    },
    thread,
    time::Duration,
};

use rtrb::Consumer;
use singletrack_api::Cameras;
use singletrack_core::{
    ControlRequest, Report, Requests, cameras::CameraReport, state_stream::States,
};
use singletrack_link::Event as LinkEvent;
use singletrack_pilot::{Event, Mode, Reason};
use singletrack_protocol::BoardMode;
use singletrack_record::{Encoder, Entry, FeedInput, Level, TickOutput};

use crate::{
    clock::{WallWatch, describe_step, monotonic_ns, wall_ns},
    drive_findings::{DriveCalibration, DriveNoise},
    files::ProofChange,
    log::logged,
    reconfigure::Reconfigurer,
    shared_status::SharedStatus,
};

/// The longest sleep: the control thread wakes the collector after every tick.
const NAP: Duration = Duration::from_millis(20);

/// The collector and its inputs and outputs. It never waits for a disk.
pub(crate) struct Collector {
    pub(crate) ticks: TickOutput,
    pub(crate) reports: Consumer<Report>,
    pub(crate) cameras: Consumer<CameraReport>,
    /// Entries of other threads for the record. They are already logged.
    pub(crate) entries: mpsc::Receiver<Entry>,
    /// For what is learned.
    pub(crate) requests: Requests,
    /// Detects steps of the wall clock.
    pub(crate) wall: WallWatch,
    pub(crate) status: Arc<SharedStatus>,
    /// Knows what is configured.
    pub(crate) reconfigurer: Reconfigurer,
    pub(crate) record: Option<FeedInput>,
    /// Encodes for the clients of the control socket.
    pub(crate) messages: Encoder,
    /// The mode and reason that were logged last.
    pub(crate) logged_mode: Option<(Mode, Option<Reason>)>,
    /// The noise of the IMU in the drive under way.
    pub(crate) noise: DriveNoise,
    /// What the drives say about the calibration.
    pub(crate) calibration: DriveCalibration,
    /// Makes the state stream.
    pub(crate) states: States,
    /// To the thread that keeps proved configurations.
    pub(crate) proofs: mpsc::Sender<ProofChange>,
    /// Set when every other thread has ended.
    pub(crate) stop: Arc<AtomicBool>,
}

impl Collector {
    /// Runs until `stop` is set and every ring is empty.
    pub(crate) fn run(mut self) {
        loop {
            // Read before the rings: entries from before the stop are distributed.
            let stopping = self.stop.load(Ordering::Acquire);
            self.distribute();
            if stopping {
                return;
            }
            thread::park_timeout(NAP);
        }
    }

    fn distribute(&mut self) {
        let now_ns = monotonic_ns();
        if let Some(step_ns) = self.wall.update(now_ns, wall_ns()) {
            self.log(now_ns, Level::Info, describe_step(step_ns));
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
                CameraReport::Counters(counters) => self.status.tally().mocap(&counters),
                CameraReport::Diagnosis(diagnosis) => self.diagnosed(diagnosis),
                CameraReport::Neighbour(neighbour) => {
                    self.status.latest().cameras.neighbour = neighbour;
                }
            }
        }
        while let Some(tick) = self.ticks.pop() {
            if let Some(why) = tick.output.setpoint_refused {
                self.status.tally().figures.setpoints.refuse(why);
            }
            // First of all: a controller outside waits for it.
            self.states.tick(&tick);
            let state = self.states.state(&tick);
            self.status.tally().tick(&tick);
            self.status.publish(tick.without_events(), state, |latest| {
                for event in &tick.events {
                    if let Event::Proved(proved) = event {
                        latest.proved = Some(*proved);
                    }
                }
                if tick.output.proved {
                    latest.proved = Some(true);
                }
            });
            self.log_mode(tick.start_ns, tick.output.mode, tick.output.reason);
            if tick.output.mode.is_underway() {
                if let Some(learned) = self.calibration.tick(&tick) {
                    self.status.latest().learned = self.calibration.in_force;
                    // A stalled loop needs none.
                    let _ = self.requests.push(ControlRequest::Learned(learned));
                }
                if let Some(known) = self.calibration.news() {
                    self.status.latest().calibration = Some(known);
                }
            }
            if let Some(measured) = tick.output.braking_measured {
                let configured = self.reconfigurer.published().config.fence.braking_m_s2;
                let (level, text) = describe_braking(measured, configured);
                self.log(tick.start_ns, level, text);
            }
            self.entry(Entry::Tick(tick));
        }
    }

    fn report(&mut self, report: Report) {
        match report {
            Report::Telemetry(record) => {
                let telemetry = &record.telemetry;
                self.status.latest().board = Some((telemetry.mode, telemetry.stop_cause));
                if telemetry.mode == BoardMode::Driving {
                    let believed = self.reconfigurer.published().config.estimator;
                    self.noise.telemetry(&record, &believed);
                }
                self.entry(Entry::Telemetry(record));
            }
            Report::Status(record) => {
                self.status.latest().board_status = Some(record.status);
                self.entry(Entry::Status(record));
            }
            Report::Link { time_ns, event } => {
                let (level, text) = describe(&event);
                self.log(time_ns, level, text);
            }
            Report::Counters(counters) => self.status.tally().line(&counters),
            Report::Proved { time_ns, proof } => {
                let text = format!("the configuration is proved on car {}", proof.car_id);
                self.log(time_ns, Level::Info, text);
                self.keep(ProofChange::Proved(proof));
            }
            Report::Disproved { time_ns, proof } => {
                let text = format!(
                    "the configuration no longer counts as proved on car {}: its next drive begins \
                     slowly",
                    proof.car_id
                );
                self.log(time_ns, Level::Warning, text);
                self.keep(ProofChange::Disproved(proof));
            }
        }
    }

    fn keep(&self, change: ProofChange) {
        // An error means that its thread has ended, and with it soon the daemon.
        let _ = self.proofs.send(change);
    }

    /// Logs and publishes what is wrong with the cameras, or that nothing is any more.
    fn diagnosed(&mut self, diagnosis: Cameras) {
        let level = if diagnosis.is_trouble() {
            Level::Warning
        } else {
            Level::Info
        };
        self.log(monotonic_ns(), level, diagnosis.to_string());
        self.status.latest().cameras = diagnosis;
    }

    /// Logs a change of mode or reason.
    fn log_mode(&mut self, time_ns: u64, mode: Mode, reason: Option<Reason>) {
        if self.logged_mode == Some((mode, reason)) {
            return;
        }
        self.logged_mode = Some((mode, reason));
        let level = match (mode, reason) {
            // An expected end is no warning.
            (Mode::Stopping, Some(Reason::Requested | Reason::ReferenceFinished)) => Level::Info,
            (Mode::Fault, _) | (Mode::Stopping, Some(_)) => Level::Warning,
            _ => Level::Info,
        };
        let mut text = match reason {
            Some(reason) => format!("mode {mode}: {reason}"),
            None => format!("mode {mode}"),
        };
        if reason == Some(Reason::PoseImplausible)
            && let Some(neighbour) = &self.status.latest().cameras.neighbour
        {
            text += &format!("; {neighbour}");
        }
        self.log(time_ns, level, text);
        if mode.is_underway() {
            let published = self.reconfigurer.published();
            let number = published.view.number;
            self.calibration.begin(number, &published.config);
        } else if let Some(known) = self.calibration.end() {
            if let Some(advice) = known.1.line() {
                self.log(time_ns, Level::Warning, advice);
            }
            self.status.latest().calibration = Some(known);
        }
        self.status.latest().learned = self.calibration.in_force;
        if !mode.is_underway()
            && let Some(warning) = self.noise.end()
        {
            self.log(time_ns, Level::Warning, warning);
        }
    }

    fn log(&mut self, time_ns: u64, level: Level, text: String) {
        self.entry(logged(time_ns, level, text));
    }

    fn entry(&mut self, entry: Entry) {
        if self.status.watchers.receiver_count() > 0 {
            let mut line = String::new();
            entry.write_json(&mut line);
            // An error means that the last watcher has left.
            let _ = self.status.watchers.send((entry.topic(), Arc::from(line)));
        }
        self.status.messages.publish(&mut self.messages, &entry);
        if let Some(record) = &mut self.record
            && !record.push(entry)
        {
            let mut tally = self.status.tally();
            let dropped = &mut tally.figures.dropped.record_entries;
            *dropped += 1;
            // A record that has ended is reported elsewhere.
            if *dropped == 1 && self.status.latest().record_error.is_none() {
                tracing::warn!(
                    time_ns = monotonic_ns(),
                    "the record is incomplete: the disk does not keep up"
                );
            }
        }
    }
}

/// The level and the text of a measured deceleration for the log.
fn describe_braking(measured: f64, configured: f64) -> (Level, String) {
    let text = format!("the car slowed down with {measured:.2} m/s2");
    // A NaN is a warning.
    if measured >= configured {
        return (Level::Info, text);
    }
    let text = format!(
        "{text}, less than fence.braking_m_s2 = {configured}: lower the key to what the car \
         reaches; a much weaker stop, or a second one, refuses the next drive"
    );
    (Level::Warning, text)
}

/// The level and the text of a link event for the log.
fn describe(event: &LinkEvent) -> (Level, String) {
    use Level::{Debug, Error, Info, Warning};
    match event {
        LinkEvent::Connected {
            board_software_version: [major, minor, patch],
        } => {
            let text = format!("board connected, software {major}.{minor}.{patch}");
            (Info, text)
        }
        LinkEvent::Identified { car_id } => (Info, format!("board of car {car_id}")),
        LinkEvent::VersionMismatch(mismatch) => (Error, mismatch.to_string()),
        LinkEvent::ConfigurationAccepted { hash } => (
            Info,
            format!("board accepted its configuration, hash {hash:08x}"),
        ),
        LinkEvent::ConfigurationRefused { reason } => {
            (Error, format!("board refused its configuration: {reason}"))
        }
        LinkEvent::BoardRestarted { evidence } => (Warning, format!("board restarted: {evidence}")),
        LinkEvent::Acknowledged { request, .. } => (Info, format!("board acknowledged: {request}")),
        LinkEvent::Refused {
            request, reason, ..
        } => (Warning, format!("board refused: {request}: {reason}")),
        LinkEvent::Unanswered { request, .. } => {
            (Warning, format!("board did not answer: {request}"))
        }
        LinkEvent::StopConfirmed { request } => (Info, format!("board confirmed: {request}")),
        LinkEvent::Lost { cause } => (Warning, format!("board lost: {cause}")),
        LinkEvent::Telemetry(_) | LinkEvent::Status(_) => {
            (Debug, "message from the board".to_owned())
        }
    }
}

#[cfg(test)]
mod tests {
    use std::{fs, sync::mpsc::channel, time::Instant};

    use rtrb::RingBuffer;
    use rustix::fs::{CWD, FileType, Mode as FileMode, mknodat};
    use singletrack_control::Time;
    use singletrack_core::{Config, Host, HostOptions, Proof};
    use singletrack_pilot::Output;
    use singletrack_record::{ClockMapping, LinkPhase, TickRecord, tick_feed};

    use super::*;
    use crate::{files::Files, state_file::StateFile};

    fn tick(index: u64) -> TickRecord {
        TickRecord {
            index,
            scheduled_ns: 0,
            start_ns: 0,
            finish_ns: 0,
            skipped: 0,
            pilot_time: Time(0),
            events: Default::default(),
            events_dropped: 0,
            output: Output::neutral(Mode::Ready),
            drive: None,
            link: LinkPhase::Ready,
        }
    }

    #[test]
    fn a_disk_that_takes_a_proof_delays_no_state() {
        let folder = tempfile::tempdir().unwrap();
        // Who opens a pipe to write waits for a reader, as for a disk.
        let pipe = folder.path().join("proved.json.new");
        mknodat(CWD, &pipe, FileType::Fifo, FileMode::RWXU, 0).unwrap();
        let text = include_str!("../singletrackd.example.toml");
        let config = Config::from_toml(text).unwrap();
        let host =
            Host::<crate::serial_port::WriteHalf>::new(config, HostOptions::default()).unwrap();
        let clocks = ClockMapping {
            monotonic_ns: 0,
            wall_ns: 0,
        };
        let status = Arc::new(SharedStatus::new(clocks));
        let (mut ticks, ticks_out) = tick_feed(8);
        let (mut reports, reports_out) = RingBuffer::new(8);
        let (_cameras, cameras) = RingBuffer::new(8);
        let (entries_in, entries) = channel();
        let (proofs, changes) = channel();
        let files = Files {
            state: StateFile::load(folder.path()),
            space: None,
            status: Arc::clone(&status),
            entries: entries_in.clone(),
        };
        let files = thread::spawn(move || files.run(&changes));
        let stop = Arc::new(AtomicBool::new(false));
        let collector = Collector {
            ticks: ticks_out,
            reports: reports_out,
            cameras,
            entries,
            requests: host.requests.clone(),
            wall: WallWatch::default(),
            status: Arc::clone(&status),
            reconfigurer: Reconfigurer::new(host.configurations, host.requests, entries_in),
            record: None,
            messages: Encoder::new(clocks),
            logged_mode: None,
            noise: DriveNoise::default(),
            calibration: DriveCalibration::default(),
            states: States::default(),
            proofs,
            stop: Arc::clone(&stop),
        };
        let proof = Proof {
            configuration: 5,
            car_id: 7,
        };
        reports.push(Report::Proved { time_ns: 0, proof }).unwrap();
        ticks.push(&tick(1));
        let collector = thread::spawn(move || collector.run());
        let published = |index| {
            let begin = Instant::now();
            loop {
                let latest = status.latest().tick.as_ref().map(|tick| tick.index);
                if latest == Some(index) || begin.elapsed() > Duration::from_secs(20) {
                    return latest == Some(index);
                }
                thread::yield_now();
            }
        };
        let first = published(1);
        ticks.push(&tick(2));
        let second = published(2);
        assert!(!files.is_finished());
        // The disk takes it, and refuses the sync of a pipe.
        let written = fs::read_to_string(&pipe).unwrap();
        fs::remove_file(&pipe).unwrap();
        assert!(first && second, "the states wait for the disk");
        assert!(written.contains("0000000000000005"), "{written}");
        stop.store(true, Ordering::Release);
        collector.join().unwrap();
        files.join().unwrap();
    }

    #[test]
    fn a_deceleration_below_the_configured_one_is_a_warning_with_both() {
        assert_eq!(describe_braking(1.2, 1.2).0, Level::Info);
        let (level, text) = describe_braking(1.19, 1.2);
        assert_eq!(level, Level::Warning);
        assert!(
            text.contains("1.19 m/s2") && text.contains("fence.braking_m_s2 = 1.2"),
            "{text}"
        );
        assert_eq!(describe_braking(f64::NAN, 1.2).0, Level::Warning);
    }
}
