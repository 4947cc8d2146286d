//! An attended drive: the connection that armed it, or a time limit, holds it.
//!
//! The control loop wants a renewal at least every 0.5 s. For `hold` every renewal comes from
//! the client; for `timed` a task of this thread renews until the time is over. If this thread
//! dies, the renewals end too, and the car stops. A connection that ends, also because its
//! process was killed, ends a held drive at once.

use std::{
    io,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use serde_json::{Value, json};
use singletrack_core::ControlRequest;
use singletrack_pilot::{Mode, PilotRequest, Reason};
use tokio::{
    io::{AsyncBufReadExt, AsyncReadExt, BufReader},
    net::unix::{OwnedReadHalf, OwnedWriteHalf},
    sync::Mutex,
    task::{coop::consume_budget, spawn_blocking},
    time::{Instant, MissedTickBehavior, interval, sleep},
};

use super::{
    command::{Arm, Attendance, Command, SOCKET_VERSION},
    serve::{
        LONGEST_LINE, answer, arm_outcome, cannot_arm, failure, no_command, not_ready, send,
        skip_line,
    },
    setpoint::SetpointStream,
};
use crate::{
    clock::monotonic_ns,
    handle::DaemonHandle,
    judgement,
    snapshot::{Snapshot, TickView},
};

/// Interval of the renewals of a timed drive, and what a client of a held one should use.
const RENEWAL: Duration = Duration::from_millis(100);

/// The most frequent renewals that are passed on: a flood must not fill the ring of requests.
const LEAST_RENEWAL: Duration = Duration::from_millis(20);

/// Interval at which the outcome of an arm request, and the end of a drive, are looked for.
const POLL: Duration = Duration::from_millis(5);

/// The longest wait for the outcome of an arm request: the supervisor's time-out, and the time
/// in which a board switches on the ESC's supply.
const ARM_TIMEOUT: Duration = Duration::from_secs(12);

/// Interval of the reports about a drive to the client that attends it.
const REPORT: Duration = Duration::from_millis(200);

/// Numbers the drives, so that a client or task of an earlier one does not end a later one, and
/// orders the requests to arm.
#[derive(Clone, Debug, Default)]
pub(crate) struct Drives(Arc<Orders>);

#[derive(Debug, Default)]
struct Orders {
    /// The number of the latest drive.
    number: AtomicU64,
    /// When it was asked for.
    asked_ns: AtomicU64,
    /// Counts the requests to disarm and to stop.
    stops: AtomicU64,
    /// Held while a request to arm is judged: one at a time.
    judging: Arc<Mutex<()>>,
}

/// The right to renew and to end one drive.
#[derive(Clone, Debug)]
struct Ticket {
    drives: Drives,
    number: u64,
}

impl Drives {
    fn next(&self) -> Ticket {
        self.0.asked_ns.store(monotonic_ns(), Ordering::Release);
        Ticket {
            drives: self.clone(),
            number: self.0.number.fetch_add(1, Ordering::AcqRel) + 1,
        }
    }

    /// A client asks for a disarm or a stop: a request to arm that is being judged is void.
    pub(super) fn stop(&self) {
        self.0.stops.fetch_add(1, Ordering::AcqRel);
    }

    fn stops(&self) -> u64 {
        self.0.stops.load(Ordering::Acquire)
    }

    /// Whether the last request to arm may not have reached the pilot at this tick.
    fn is_open(&self, snapshot: &Snapshot) -> bool {
        let asked_ns = self.0.asked_ns.load(Ordering::Acquire);
        snapshot.tick.is_none_or(|tick| tick.start_ns <= asked_ns)
    }
}

impl Ticket {
    fn is_latest(&self) -> bool {
        self.drives.0.number.load(Ordering::Acquire) == self.number
    }

    /// Passes a request on if the drive is still the latest one.
    fn push(&self, daemon: &DaemonHandle, request: PilotRequest) -> Result<(), String> {
        if !self.is_latest() {
            return Ok(());
        }
        let pushed = daemon.requests.push(ControlRequest::Pilot(request));
        pushed.map_err(|error| error.to_string())
    }
}

/// How an attended drive went on.
enum Progress {
    /// It is still being armed, or drives.
    Underway,
    /// It did not begin.
    Refused(String),
    /// It has ended, and the car stands or is out of control.
    Ended(Mode, Option<Reason>),
}

/// Watches one drive by the status.
struct DriveWatch {
    asked_ns: u64,
    asked: Instant,
    has_driven: bool,
}

impl DriveWatch {
    fn new() -> Self {
        Self {
            asked_ns: monotonic_ns(),
            asked: Instant::now(),
            has_driven: false,
        }
    }

    fn progress(&mut self, snapshot: &Snapshot) -> Progress {
        let Some(tick) = snapshot.tick else {
            return Progress::Underway;
        };
        if self.has_driven {
            return match tick.mode {
                Mode::Idle | Mode::Ready | Mode::Disconnected | Mode::Fault => {
                    Progress::Ended(tick.mode, tick.reason)
                }
                _ => Progress::Underway,
            };
        }
        match arm_outcome(self.asked_ns, tick.start_ns, tick.mode, tick.reason) {
            Some(Ok(())) => self.has_driven = true,
            Some(Err(error)) => return Progress::Refused(error),
            None if self.asked.elapsed() > ARM_TIMEOUT => {
                return Progress::Refused("can't arm: the control thread does not answer".into());
            }
            None => {}
        }
        Progress::Underway
    }
}

/// Requests to arm an unattended or timed drive, and waits for the outcome.
pub(super) async fn arm(daemon: &DaemonHandle, request: Arm) -> Result<(), String> {
    let (ticket, mut watch) = begin(daemon, request).await?;
    if let Attendance::Timed(time) = request.attendance {
        // Renews also while the board arms.
        tokio::spawn(renew(ticket, daemon.clone(), time));
    }
    loop {
        sleep(POLL).await;
        match watch.progress(&daemon.snapshot()) {
            Progress::Underway if watch.has_driven => return Ok(()),
            Progress::Underway => {}
            Progress::Refused(error) => return Err(error),
            Progress::Ended(mode, reason) => return Err(cannot_arm(mode, reason)),
        }
    }
}

/// Passes a request to arm on, if the car can drive its reference from where it stands.
///
/// The judgement takes up to 0.3 s. Meanwhile other clients are served and the car stands:
/// nothing has been asked of the pilot. A disarm, a stop, another mode or another configuration
/// that comes in this time ends the request.
async fn begin(daemon: &DaemonHandle, request: Arm) -> Result<(Ticket, DriveWatch), String> {
    let Arm {
        attendance,
        uncalibrated,
    } = request;
    ready(daemon)?;
    let judging = Arc::clone(&daemon.drives.0.judging)
        .try_lock_owned()
        .map_err(|_| "can't arm: the request of another client is being judged")?;
    let stops = daemon.drives.stops();
    let judged = daemon.clone();
    let longest = match attendance {
        Attendance::Timed(time) => Some(time),
        Attendance::Hold | Attendance::Unattended => None,
    };
    let judgement = spawn_blocking(move || {
        // Also held if the client hangs up.
        let _judging = judging;
        let (number, config) = judged.reconfigurer.in_force();
        let stand = judgement::stand(&judged.snapshot());
        let refusal = (!uncalibrated)
            .then(|| judged.commissioned.refusal(&config))
            .flatten();
        let refusal = refusal.or_else(|| judgement::refusal(&config, stand, longest));
        (number, refusal)
    });
    let (number, refusal) = judgement.await.map_err(|error| error.to_string())?;
    if let Some(refusal) = refusal {
        return Err(format!("can't arm: {refusal}"));
    }
    // From here to the request nothing is waited for: no other client comes between.
    if daemon.drives.stops() != stops {
        return Err("can't arm: a disarm or a stop has come meanwhile".to_owned());
    }
    if daemon.reconfigurer.view().number != number {
        return Err("can't arm: the configuration has changed meanwhile; arm again".to_owned());
    }
    ready(daemon)?;
    let ticket = daemon.drives.next();
    let request = match attendance {
        Attendance::Unattended => PilotRequest::Arm,
        Attendance::Hold | Attendance::Timed(_) => PilotRequest::ArmHeld,
    };
    ticket.push(daemon, request)?;
    Ok((ticket, DriveWatch::new()))
}

/// Checks that the pilot can be armed now, and that no other client has just asked for it.
fn ready(daemon: &DaemonHandle) -> Result<(), String> {
    let snapshot = daemon.snapshot();
    if snapshot.mode() != Mode::Ready {
        return Err(not_ready(&snapshot));
    }
    if daemon.drives.is_open(&snapshot) {
        return Err("can't arm: another client has just armed".to_owned());
    }
    Ok(())
}

/// Passes a request to jog on. There is nothing to judge: poses, geofence and reference do not
/// matter.
fn begin_jogging(daemon: &DaemonHandle) -> Result<(Ticket, DriveWatch), String> {
    let snapshot = daemon.snapshot();
    if !matches!(snapshot.mode(), Mode::Idle | Mode::Ready) {
        return Err(cannot_arm(snapshot.mode(), snapshot.reason()));
    }
    if daemon.drives.is_open(&snapshot) {
        return Err("can't arm: another client has just armed".to_owned());
    }
    let ticket = daemon.drives.next();
    ticket.push(daemon, PilotRequest::ArmJog)?;
    Ok((ticket, DriveWatch::new()))
}

/// Renews a drive until `time` after it began to drive, then ends it.
async fn renew(ticket: Ticket, daemon: DaemonHandle, time: Duration) {
    let mut watch = DriveWatch::new();
    let mut driving_since = None;
    let mut renewals = interval(RENEWAL);
    renewals.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        renewals.tick().await;
        match watch.progress(&daemon.snapshot()) {
            Progress::Underway => {}
            Progress::Refused(_) | Progress::Ended(..) => return,
        }
        if watch.has_driven {
            let since = *driving_since.get_or_insert_with(Instant::now);
            if since.elapsed() >= time {
                // A stalled control thread stops the car by itself.
                let _ = ticket.push(&daemon, PilotRequest::TimeUp);
                return;
            }
        }
        if ticket.push(&daemon, PilotRequest::Hold).is_err() {
            return;
        }
    }
}

/// Arms a drive and holds it for as long as the client renews it. Returns whether the
/// connection is still open.
pub(super) async fn hold(
    read: &mut BufReader<OwnedReadHalf>,
    write: &mut OwnedWriteHalf,
    daemon: &DaemonHandle,
    setpoints: &mut SetpointStream,
    request: Arm,
) -> io::Result<bool> {
    let begun = tokio::select! {
        begun = begin(daemon, request) => begun,
        () = hung_up(read) => return Ok(false),
    };
    let (ticket, watch) = match begun {
        Ok(begun) => begun,
        Err(error) => {
            send(write, &failure(error)).await?;
            return Ok(true);
        }
    };
    let drive = Attended {
        ticket,
        jogs: false,
    };
    attend(read, write, daemon, setpoints, &drive, watch).await
}

/// Arms to jog, and passes pulses on for as long as the client gives them. Returns whether the
/// connection is still open.
pub(super) async fn jog(
    read: &mut BufReader<OwnedReadHalf>,
    write: &mut OwnedWriteHalf,
    daemon: &DaemonHandle,
    setpoints: &mut SetpointStream,
) -> io::Result<bool> {
    let (ticket, watch) = match begin_jogging(daemon) {
        Ok(begun) => begun,
        Err(error) => {
            send(write, &failure(error)).await?;
            return Ok(true);
        }
    };
    let drive = Attended { ticket, jogs: true };
    attend(read, write, daemon, setpoints, &drive, watch).await
}

/// A drive that a connection holds.
struct Attended {
    ticket: Ticket,
    /// The client gives pulses.
    jogs: bool,
}

/// Returns when the client hangs up without having sent more; reads nothing.
async fn hung_up(read: &mut BufReader<OwnedReadHalf>) {
    match read.fill_buf().await {
        Ok([]) | Err(_) => {}
        // Its end is found once this has been read.
        Ok(_) => std::future::pending().await,
    }
}

/// Serves the client of a held drive until the drive has ended: true. False if the connection
/// ended before.
async fn attend(
    read: &mut BufReader<OwnedReadHalf>,
    write: &mut OwnedWriteHalf,
    daemon: &DaemonHandle,
    setpoints: &mut SetpointStream,
    drive: &Attended,
    watch: DriveWatch,
) -> io::Result<bool> {
    let result = serve_drive(read, write, daemon, setpoints, drive, watch).await;
    if !matches!(result, Ok(true)) {
        // The client is gone, and the drive is not over.
        let _ = drive.ticket.push(daemon, PilotRequest::OperatorGone);
    }
    result
}

async fn serve_drive(
    read: &mut BufReader<OwnedReadHalf>,
    write: &mut OwnedWriteHalf,
    daemon: &DaemonHandle,
    setpoints: &mut SetpointStream,
    drive: &Attended,
    mut watch: DriveWatch,
) -> io::Result<bool> {
    let mut line = Vec::new();
    let mut polls = interval(POLL);
    polls.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut was_driving = false;
    let mut reported = Instant::now();
    let mut renewed: Option<Instant> = None;
    loop {
        let room = LONGEST_LINE.saturating_sub(line.len() as u64);
        let mut rest = (&mut *read).take(room);
        // What was read of a line stays in `line` if the other branch is first.
        let count = tokio::select! {
            count = rest.read_until(b'\n', &mut line) => count?,
            _ = polls.tick() => {
                let snapshot = daemon.snapshot();
                match watch.progress(&snapshot) {
                    Progress::Underway => {}
                    Progress::Refused(error) => {
                        send(write, &failure(error)).await?;
                        return Ok(true);
                    }
                    Progress::Ended(mode, reason) => {
                        send(write, &ended(mode, reason)).await?;
                        return Ok(true);
                    }
                }
                if watch.has_driven && !was_driving {
                    was_driving = true;
                    send(write, &json!({ "version": SOCKET_VERSION, "ok": true })).await?;
                }
                if was_driving && reported.elapsed() >= REPORT {
                    reported = Instant::now();
                    if let Some(tick) = snapshot.tick {
                        send(write, &report(&tick)).await?;
                    }
                }
                continue;
            }
        };
        if count == 0 {
            return Ok(false);
        }
        if !line.ends_with(b"\n") {
            if line.len() as u64 >= LONGEST_LINE {
                skip_line(read).await?;
                let error = format!("a line is at most {LONGEST_LINE} bytes long");
                send(write, &failure(error)).await?;
                line.clear();
            }
            continue;
        }
        match Command::parse(&line, monotonic_ns()) {
            Ok(Command::Hold) => {
                if renewed.is_none_or(|renewed| renewed.elapsed() >= LEAST_RENEWAL) {
                    renewed = Some(Instant::now());
                    if let Err(error) = drive.ticket.push(daemon, PilotRequest::Hold) {
                        send(write, &failure(error)).await?;
                    }
                }
            }
            Ok(Command::Jog(pulses)) if drive.jogs => {
                if drive.ticket.is_latest() {
                    daemon.jogs.send(pulses);
                }
            }
            Ok(Command::Ask(question)) => {
                send(write, &answer(question, daemon).await).await?;
            }
            Ok(Command::Setpoint(setpoint)) if !drive.jogs => {
                if let Some(answer) = setpoints.pass(daemon, &setpoint) {
                    send(write, &answer).await?;
                }
            }
            Ok(_) => {
                let error = if drive.jogs {
                    "this connection jogs: it takes jog, hold, status, disarm and stop"
                } else {
                    "this connection holds a drive: it takes hold, status, disarm, stop and \
                     setpoint"
                };
                send(write, &failure(error)).await?;
            }
            Err(error) => send(write, &no_command(daemon, &error)).await?,
        }
        line.clear();
        consume_budget().await;
    }
}

/// A drive as it goes on.
fn report(tick: &TickView) -> Value {
    json!({
        "version": SOCKET_VERSION,
        "drive": {
            "mode": tick.mode.name(),
            "reason": tick.reason.map(Reason::name),
            "drive_time_s": tick.drive_time_s,
            "speed_m_s": tick.estimate.map(|estimate| estimate.speed),
        },
    })
}

/// How a drive ended.
fn ended(mode: Mode, reason: Option<Reason>) -> Value {
    json!({
        "version": SOCKET_VERSION,
        "ended": { "mode": mode.name(), "reason": reason.map(Reason::name) },
    })
}

#[cfg(test)]
mod tests {
    use core::{
        pin::pin,
        task::{Context, Poll, Waker},
    };
    use std::sync::mpsc;

    use rtrb::{Consumer, RingBuffer};
    use singletrack_core::{Config, Host, HostOptions, Requests};
    use singletrack_record::LinkPhase;
    use tokio::{
        io::AsyncWriteExt,
        net::UnixStream,
        runtime::{Builder, Runtime},
    };

    use super::*;
    use crate::{
        commissioned_file::CommissionedFile,
        realtime::RealTimeStatus,
        reconfigure::Reconfigurer,
        shared_status::SharedStatus,
        socket::{command::Question, serve::serve},
    };

    const UNATTENDED: Arm = Arm {
        attendance: Attendance::Unattended,
        uncalibrated: true,
    };

    const HELD: Arm = Arm {
        attendance: Attendance::Hold,
        uncalibrated: true,
    };

    /// A daemon without threads: the test sets the mode, and requests stay in their ring.
    struct Bench {
        daemon: DaemonHandle,
        requests: Consumer<ControlRequest>,
        runtime: Runtime,
    }

    impl Bench {
        /// With the example's circle, which can be driven.
        fn ready() -> Self {
            let text = include_str!("../../singletrackd.example.toml");
            let mut config = Config::from_toml(text).unwrap();
            config.state.directory = "/nonexistent".into();
            let commissioned = CommissionedFile::load(&config.state.directory);
            let host =
                Host::<crate::serial_port::WriteHalf>::new(config, HostOptions::default()).unwrap();
            let (ring, requests) = RingBuffer::new(16);
            let ring = Requests::new(ring);
            let (entries, _) = mpsc::channel();
            let daemon = DaemonHandle {
                status: Arc::new(SharedStatus::new()),
                reconfigurer: Reconfigurer::new(host.configurations, ring.clone(), entries),
                requests: ring,
                setpoints: host.setpoints,
                jogs: host.jogs,
                config_path: None,
                realtime: RealTimeStatus {
                    fifo_priority: None,
                    memory_locked: false,
                    idle_bounded: false,
                    refusals: Vec::new(),
                },
                commissioned,
                drives: Drives::default(),
                live: None,
            };
            let bench = Self {
                daemon,
                requests,
                runtime: Builder::new_current_thread().enable_all().build().unwrap(),
            };
            bench.tick(Mode::Ready);
            bench
        }

        /// The pilot has this mode after a tick.
        fn tick(&self, mode: Mode) {
            self.daemon.status.latest().tick = Some(TickView {
                index: 0,
                start_ns: monotonic_ns(),
                mode,
                reason: None,
                preflight: None,
                link: LinkPhase::Ready,
                held: false,
                drive_time_s: None,
                estimate: None,
                point: None,
                reference: None,
                steering_rad: 0.0,
                speed_m_s: 0.0,
            });
        }

        /// The outcome of an `arm` during whose judgement something happens.
        fn arm_while(&self, happens: impl FnOnce(&Self)) -> Result<(), String> {
            let _context = self.runtime.enter();
            let judging = self.daemon.reconfigurer.pause();
            let mut begun = pin!(begin(&self.daemon, UNATTENDED));
            // It runs up to the judgement, which waits for the configuration.
            let polled = begun.as_mut().poll(&mut Context::from_waker(Waker::noop()));
            assert!(polled.is_pending());
            happens(self);
            drop(judging);
            self.runtime.block_on(begun).map(drop)
        }

        /// The refusal of an `arm`, without waiting for anything.
        fn refusal_now(&self) -> String {
            let begun = pin!(begin(&self.daemon, UNATTENDED));
            match begun.poll(&mut Context::from_waker(Waker::noop())) {
                Poll::Ready(Err(error)) => error,
                Poll::Ready(Ok(_)) => "armed".to_owned(),
                Poll::Pending => "judged".to_owned(),
            }
        }

        fn ask(&self, question: Question) {
            let answered = self.runtime.block_on(answer(question, &self.daemon));
            assert_eq!(answered["ok"], true);
        }

        /// The requests that have reached the pilot.
        fn requests(&mut self) -> Vec<ControlRequest> {
            core::iter::from_fn(|| self.requests.pop().ok()).collect()
        }
    }

    #[test]
    fn a_second_arm_is_refused_while_the_first_is_judged_and_until_it_has_reached_the_pilot() {
        let mut bench = Bench::ready();
        let result = bench.arm_while(|bench| {
            let error = bench.refusal_now();
            assert!(error.contains("another client is being judged"), "{error}");
        });
        assert_eq!(result, Ok(()));
        let error = bench.refusal_now();
        assert!(error.contains("another client has just armed"), "{error}");
        assert_eq!(bench.requests(), [ControlRequest::Pilot(PilotRequest::Arm)]);
    }

    #[test]
    fn what_comes_while_an_arm_is_judged_ends_it() {
        type Happens = fn(&Bench);
        let cases: [(Happens, &str, Option<PilotRequest>); 4] = [
            (
                |bench| bench.ask(Question::Disarm),
                "a disarm or a stop has come meanwhile",
                Some(PilotRequest::Disarm),
            ),
            (
                |bench| bench.ask(Question::Stop),
                "a disarm or a stop has come meanwhile",
                Some(PilotRequest::EmergencyStop),
            ),
            (
                |bench| bench.daemon.reconfigurer.renumber(),
                "the configuration has changed meanwhile",
                None,
            ),
            (|bench| bench.tick(Mode::Idle), "mode idle", None),
        ];
        for (happens, refusal, request) in cases {
            let mut bench = Bench::ready();
            let error = bench.arm_while(happens).unwrap_err();
            assert!(error.contains(refusal), "{refusal}: {error}");
            let passed: Vec<_> = request.into_iter().map(ControlRequest::Pilot).collect();
            assert_eq!(bench.requests(), passed, "{refusal}");
            if request.is_some() {
                // It voids no later one.
                assert_eq!(bench.arm_while(|_| {}), Ok(()), "{refusal}");
            }
        }
    }

    #[test]
    fn a_car_that_has_passed_no_procedure_is_not_armed_unless_the_client_says_so() {
        let mut bench = Bench::ready();
        let calibrated = Arm {
            uncalibrated: false,
            ..UNATTENDED
        };
        let error = bench
            .runtime
            .block_on(begin(&bench.daemon, calibrated))
            .map(drop)
            .unwrap_err();
        assert!(error.contains("Run `singletrack doctor`"), "{error}");
        assert_eq!(bench.requests(), []);
        assert_eq!(bench.arm_while(|_| {}), Ok(()));
    }

    #[test]
    fn a_client_that_hangs_up_while_its_arm_is_judged_arms_nothing() {
        let mut bench = Bench::ready();
        {
            let _context = bench.runtime.enter();
            let judging = bench.daemon.reconfigurer.pause();
            let mut begun = Box::pin(begin(&bench.daemon, HELD));
            let polled = begun.as_mut().poll(&mut Context::from_waker(Waker::noop()));
            assert!(polled.is_pending());
            drop(begun);
            // The judgement goes on for its own sake, one at a time.
            let error = bench.refusal_now();
            assert!(error.contains("another client is being judged"), "{error}");
            drop(judging);
        }
        let judging = Arc::clone(&bench.daemon.drives.0.judging);
        drop(bench.runtime.block_on(judging.lock()));
        assert_eq!(bench.requests(), []);
        assert_eq!(bench.arm_while(|_| {}), Ok(()));
    }

    #[test]
    fn a_set_point_that_has_no_effect_is_answered_so_on_a_connection_that_holds_a_drive_too() {
        let mut bench = Bench::ready();
        let answers = bench.runtime.block_on(async {
            let (client, server) = UnixStream::pair().unwrap();
            let client = async move {
                let (read, mut write) = client.into_split();
                let lines = concat!(
                    r#"{"version":2,"command":"arm","attendance":"hold","uncalibrated":true}"#,
                    "\n",
                    r#"{"version":2,"command":"setpoint","velocity_m_s":[0.3,0.0]}"#,
                    "\n",
                    r#"{"version":2,"command":"watch"}"#,
                    "\n",
                );
                write.write_all(lines.as_bytes()).await.unwrap();
                let mut read = BufReader::new(read).lines();
                [
                    read.next_line().await.unwrap().unwrap(),
                    read.next_line().await.unwrap().unwrap(),
                ]
            };
            let (served, answers) = tokio::join!(serve(server, &bench.daemon), client);
            served.unwrap();
            answers
        });
        assert!(
            answers[0].contains("set-points are not in use"),
            "{answers:?}"
        );
        assert!(answers[1].contains("it takes hold, status"), "{answers:?}");
        let requests = [PilotRequest::ArmHeld, PilotRequest::OperatorGone];
        assert_eq!(bench.requests(), requests.map(ControlRequest::Pilot));
    }

    #[test]
    fn a_ticket_of_an_earlier_drive_is_void() {
        let drives = Drives::default();
        let (first, second) = (drives.next(), drives.next());
        let is_latest =
            |ticket: &Ticket| ticket.drives.0.number.load(Ordering::Acquire) == ticket.number;
        assert!(!is_latest(&first) && is_latest(&second));
    }
}
