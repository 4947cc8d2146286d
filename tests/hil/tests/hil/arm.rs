//! `singletrack arm` with the shipped daemon: the operator's program is the dead-man switch.
//!
//! What the daemon did and why is read from its record, in ticks, so that a busy processor
//! changes no result. Only the measured times have limits.

use std::{
    process::{Child, Command, Output, Stdio},
    time::Duration,
};

use rustix::process::{Pid, Signal, kill_process};
use singletrack_hil::{Failure, Outcome, bench::Bench, ensure};
use singletrack_pilot::{Event, Mode, PilotRequest, Reason};
use singletrack_record::{Entry, Reader, TickRecord, Topic};
use singletrackd::monotonic_ns;

use crate::Scenario;

pub(crate) const SCENARIOS: &[Scenario] = &[
    Scenario::new("a_killed_operator_stops_the_car_at_once", killed),
    Scenario::new(
        "an_operator_that_hangs_stops_the_car_within_the_time_of_the_dead_man_switch",
        hangs,
    ),
    Scenario::new(
        "ctrl_c_disarms_waits_for_standstill_and_is_success",
        interrupted,
    ),
    Scenario::new(
        "a_timed_drive_ends_after_its_time_also_without_its_client",
        timed,
    ),
    Scenario::new(
        "an_unattended_drive_goes_on_without_its_client_which_says_so",
        unattended,
    ),
    Scenario::new("a_killed_hand_ends_jogging_at_once", killed_hand),
    Scenario::new(
        "a_hand_that_hangs_ends_jogging_after_a_quarter_of_a_second",
        hand_hangs,
    ),
    Scenario::new(
        "jogging_for_a_time_steers_and_ends_with_success",
        jogs_for_a_time,
    ),
    Scenario::new(
        "a_client_of_an_ended_drive_does_not_end_the_next_one",
        two_clients,
    ),
];

/// The longest time between two renewals.
pub(crate) const HOLD_TIMEOUT_MS: f64 = 500.0;

/// From the end of the operator's program to the first tick of the stop: less than without its
/// last renewal.
pub(crate) const KILLED_LIMIT_MS: f64 = HOLD_TIMEOUT_MS;

/// From when the operator's program hangs to the first tick of the stop: the time-out, and a
/// tick of 10 ms; the rest is for a busy machine.
pub(crate) const HANGS_LIMIT_MS: f64 = HOLD_TIMEOUT_MS + 100.0;

/// Limit for the time from a disarm to readiness.
const READY_AGAIN: Duration = Duration::from_secs(4);

/// The longest time between two pulses of a hand, and the limit from when its program hangs to
/// the first tick after jogging.
const JOG_TIMEOUT_MS: f64 = 250.0;
const HAND_LIMIT_MS: f64 = JOG_TIMEOUT_MS + 100.0;

/// A servo pulse to the left.
const JOG_SERVO: &str = "1420";

/// The time of the timed drive, and the most that may be driven: the daemon looks every 0.1 s;
/// the rest is for a busy machine.
const DRIVE_MS: f64 = 1_500.0;
const MOST_DRIVEN_MS: f64 = DRIVE_MS + 400.0;

/// `singletrack arm`. Dropping it kills the process.
struct Operator(Option<Child>);

impl Operator {
    fn arm(bench: &Bench, options: &[&str]) -> Outcome<Self> {
        Self::run(bench, "arm", options)
    }

    /// `singletrack jog`, with the wheels to the left and the motor slowly forward.
    fn jog(bench: &Bench, options: &[&str]) -> Outcome<Self> {
        let pulses = ["--servo", JOG_SERVO, "--esc", "1545"];
        Self::run(bench, "jog", &[&pulses, options].concat())
    }

    fn run(bench: &Bench, command: &str, options: &[&str]) -> Outcome<Self> {
        // Built next to the daemon.
        let tool = bench.program().with_file_name("singletrack");
        Command::new(&tool)
            .arg(command)
            .args(options)
            .arg("--socket")
            .arg(&bench.config().socket.path)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .map(|child| Self(Some(child)))
            .map_err(Failure::system(format!("can't run {}", tool.display())))
    }

    fn signal(&self, signal: Signal) -> Outcome {
        let Some(child) = &self.0 else {
            return Ok(());
        };
        kill_process(Pid::from_child(child), signal)
            .map_err(|error| Failure::system("can't signal the operator's program")(error.into()))
    }

    /// Kills it (SIGKILL), also if it has ended.
    fn kill(mut self) {
        self.end();
    }

    /// Waits for its end.
    fn output(mut self) -> Outcome<Output> {
        self.0
            .take()
            .ok_or_else(|| Failure::new("the operator's program has ended"))?
            .wait_with_output()
            .map_err(Failure::system("no output of the operator's program"))
    }

    fn end(&mut self) {
        if let Some(mut child) = self.0.take() {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

impl Drop for Operator {
    fn drop(&mut self) {
        self.end();
    }
}

/// Starts a daemon and an operator, and drives for a while.
fn start(bench: &mut Bench, options: &[&str]) -> Outcome<Operator> {
    bench.start_daemon()?;
    bench.wait_until_ready()?;
    let operator = Operator::arm(bench, options)?;
    bench.wait_for_mode("driving", READY_AGAIN)?;
    bench.keep_driving(Duration::from_millis(700))?;
    Ok(operator)
}

/// Waits for standstill, ends the daemon, and reads the ticks of its record.
pub(crate) fn ticks(bench: &mut Bench) -> Outcome<Vec<TickRecord>> {
    bench.wait_for_mode("ready", READY_AGAIN)?;
    ticks_so_far(bench)
}

/// Ends the daemon, and reads the ticks of its record.
pub(crate) fn ticks_so_far(bench: &mut Bench) -> Outcome<Vec<TickRecord>> {
    let (status, _) = bench.daemon()?.terminate(Duration::from_secs(3))?;
    ensure!(status.success(), "the daemon ended with {status}");
    let folder = &bench.config().record.directory;
    let records: Vec<_> = std::fs::read_dir(folder)
        .map_err(Failure::system("no records"))?
        .flatten()
        .map(|entry| entry.path())
        .collect();
    let [record] = &records[..] else {
        return Err(Failure::new(format!(
            "expected one record, found {records:?}"
        )));
    };
    let unreadable = |error| Failure::new(format!("{}: {error}", record.display()));
    Reader::open(record)
        .map_err(|error| unreadable(error.to_string()))?
        .only(&[Topic::Tick])
        .filter_map(|entry| match entry {
            Ok(Entry::Tick(tick)) => Some(Ok(tick)),
            Ok(_) => None,
            Err(error) => Some(Err(unreadable(error.to_string()))),
        })
        .collect()
}

/// The only drive of a record.
pub(crate) struct Drive<'a> {
    /// Every tick before the stop.
    pub(crate) before: &'a [TickRecord],
    /// The first tick that did not drive any more.
    pub(crate) stop: &'a TickRecord,
    /// The first tick at which the car stood again.
    stands: &'a TickRecord,
}

impl<'a> Drive<'a> {
    pub(crate) fn of(ticks: &'a [TickRecord]) -> Outcome<Self> {
        let is_driving = |tick: &TickRecord| tick.output.mode == Mode::Driving;
        let place = ticks
            .windows(2)
            .position(|pair| matches!(pair, [last, next] if is_driving(last) && !is_driving(next)));
        let found = place.and_then(|place| {
            let (before, after) = ticks.split_at_checked(place + 1)?;
            let stands = |tick: &&TickRecord| matches!(tick.output.mode, Mode::Idle | Mode::Ready);
            Some(Self {
                before,
                stop: after.first()?,
                stands: after.iter().find(stands)?,
            })
        });
        found.ok_or_else(|| Failure::new("the record has no drive with its end"))
    }

    /// Checks why it ended.
    pub(crate) fn ended(&self, reason: Reason) -> Outcome {
        let (mode, because) = (self.stop.output.mode, self.stop.output.reason);
        ensure!(
            mode == Mode::Stopping && because == Some(reason),
            "{mode} because of {because:?}, not {reason:?}"
        );
        Ok(())
    }

    /// The last tick until the stop with a request.
    pub(crate) fn last_with(&self, request: PilotRequest) -> Option<&'a TickRecord> {
        self.before
            .iter()
            .chain([self.stop])
            .rfind(|tick| has(tick, request))
    }

    /// The last tick that drove.
    pub(crate) fn last_driving(&self) -> Outcome<&'a TickRecord> {
        self.before
            .last()
            .ok_or_else(|| Failure::new("the drive is empty"))
    }
}

pub(crate) fn has(tick: &TickRecord, request: PilotRequest) -> bool {
    tick.events.contains(&Event::Request(request))
}

/// From one time of `CLOCK_MONOTONIC` to another, in ms; negative if it is earlier.
pub(crate) fn elapsed_ms(from_ns: u64, to_ns: u64) -> f64 {
    (to_ns as f64 - from_ns as f64) / 1e6
}

/// From one tick to another by the time that the pilot judges by, in ms: the thread wakes some
/// microseconds earlier or later.
pub(crate) fn judged_ms(from: &TickRecord, to: &TickRecord) -> f64 {
    elapsed_ms(from.pilot_time.0, to.pilot_time.0)
}

fn killed(bench: &mut Bench) -> Outcome {
    let operator = start(bench, &[])?;
    let killed_ns = monotonic_ns();
    operator.kill();
    let ticks = ticks(bench)?;
    let drive = Drive::of(&ticks)?;
    drive.ended(Reason::OperatorGone)?;
    // The end of the connection stopped it, and not the lack of renewals.
    ensure!(
        has(drive.stop, PilotRequest::OperatorGone),
        "no request came with the stop: {:?}",
        drive.stop.events
    );
    bench.at_most(
        "from the kill to the first tick of the stop",
        elapsed_ms(killed_ns, drive.stop.start_ns),
        KILLED_LIMIT_MS,
        "ms",
    )
}

fn hangs(bench: &mut Bench) -> Outcome {
    let operator = start(bench, &["--hold"])?;
    let hangs_ns = monotonic_ns();
    // As with Ctrl-Z, or a terminal that blocks the program's output.
    operator.signal(Signal::STOP)?;
    let ticks = ticks(bench)?;
    let drive = Drive::of(&ticks)?;
    drive.ended(Reason::OperatorGone)?;
    ensure!(
        drive.last_with(PilotRequest::OperatorGone).is_none(),
        "the connection had not ended"
    );
    // The first tick that is late enough stopped it, whenever the ticks came.
    let renewed = drive
        .last_with(PilotRequest::Hold)
        .ok_or_else(|| Failure::new("the drive was never renewed"))?;
    let since = |tick: &TickRecord| judged_ms(renewed, tick);
    let (last, stop) = (since(drive.last_driving()?), since(drive.stop));
    ensure!(
        last <= HOLD_TIMEOUT_MS && stop > HOLD_TIMEOUT_MS,
        "the car drove {last} ms after the last renewal, and stopped after {stop} ms"
    );
    bench.at_most(
        "from the last sign of the operator to the first tick of the stop",
        elapsed_ms(hangs_ns, drive.stop.start_ns),
        HANGS_LIMIT_MS,
        "ms",
    )
}

fn interrupted(bench: &mut Bench) -> Outcome {
    let operator = start(bench, &[])?;
    operator.signal(Signal::INT)?;
    let output = operator.output()?;
    let ended_ns = monotonic_ns();
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    ensure!(output.status.success(), "{output:?}");
    ensure!(
        text.contains("the drive has ended after") && text.contains("requested"),
        "{text}"
    );
    // Not a terminal: no progress.
    ensure!(output.stderr.is_empty(), "{output:?}");
    let ticks = ticks(bench)?;
    let drive = Drive::of(&ticks)?;
    drive.ended(Reason::Requested)?;
    ensure!(
        drive.stands.start_ns < ended_ns,
        "it did not wait for standstill"
    );
    Ok(())
}

fn timed(bench: &mut Bench) -> Outcome {
    let operator = start(bench, &["--for", "1500ms"])?;
    operator.kill();
    let ticks = ticks(bench)?;
    let drive = Drive::of(&ticks)?;
    drive.ended(Reason::TimeUp)?;
    let first = drive
        .before
        .iter()
        .find(|tick| tick.output.mode == Mode::Driving)
        .ok_or_else(|| Failure::new("the drive is empty"))?;
    let driven_ms = elapsed_ms(first.start_ns, drive.stop.start_ns);
    ensure!(driven_ms >= DRIVE_MS, "driven for {driven_ms} ms only");
    bench.at_most("a drive of 1500 ms", driven_ms, MOST_DRIVEN_MS, "ms")
}

fn unattended(bench: &mut Bench) -> Outcome {
    let operator = start(bench, &["--unattended"])?;
    let output = operator.output()?;
    ensure!(output.status.success(), "{output:?}");
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    ensure!(
        text.contains("driving unattended: the car drives on"),
        "{text}"
    );
    // Longer than a held drive would last.
    bench.keep_driving(Duration::from_millis(700))?;
    bench.client()?.disarm()?.accepted()?;
    let ticks = ticks(bench)?;
    let drive = Drive::of(&ticks)?;
    drive.ended(Reason::Requested)?;
    ensure!(
        drive.last_with(PilotRequest::Hold).is_none(),
        "nothing should renew it"
    );
    Ok(())
}

fn two_clients(bench: &mut Bench) -> Outcome {
    let first = start(bench, &["--for", "1000s"])?;
    // So that it is still there when the next drive begins.
    first.signal(Signal::STOP)?;
    bench.client()?.disarm()?.accepted()?;
    bench.wait_for_mode("ready", READY_AGAIN)?;
    let second = Operator::arm(bench, &[])?;
    bench.wait_for_mode("driving", READY_AGAIN)?;
    first.kill();
    bench.keep_driving(Duration::from_millis(700))?;
    second.kill();
    let status = bench.wait_for_mode("ready", READY_AGAIN)?;
    ensure!(
        status.reason() == "operator-gone",
        "the second drive's end: {}",
        status.text()
    );
    Ok(())
}

/// Starts a daemon and a hand that jogs, and waits until the motor has turned.
fn start_jogging(bench: &mut Bench, options: &[&str]) -> Outcome<Operator> {
    bench.start_daemon()?;
    bench.wait_until_ready()?;
    let hand = Operator::jog(bench, options)?;
    bench.wait_for_mode("jogging", READY_AGAIN)?;
    Ok(hand)
}

/// The last tick with jogging, and the first one after it.
fn end_of_jogging(ticks: &[TickRecord]) -> Outcome<(&TickRecord, &TickRecord)> {
    let jogs = |tick: &TickRecord| tick.output.mode == Mode::Jogging;
    let end = ticks.windows(2).find_map(|pair| match pair {
        [last, next] if jogs(last) && !jogs(next) => Some((last, next)),
        _ => None,
    });
    end.ok_or_else(|| Failure::new("the record has no jogging with its end"))
}

fn killed_hand(bench: &mut Bench) -> Outcome {
    let hand = start_jogging(bench, &[])?;
    std::thread::sleep(Duration::from_millis(500));
    let killed_ns = monotonic_ns();
    hand.kill();
    let ticks = ticks(bench)?;
    let (_, end) = end_of_jogging(&ticks)?;
    ensure!(
        end.output.mode == Mode::Idle && end.output.reason == Some(Reason::OperatorGone),
        "{} because of {:?}",
        end.output.mode,
        end.output.reason
    );
    bench.at_most(
        "from the kill to the first tick after jogging",
        elapsed_ms(killed_ns, end.start_ns),
        JOG_TIMEOUT_MS,
        "ms",
    )
}

fn hand_hangs(bench: &mut Bench) -> Outcome {
    let hand = start_jogging(bench, &[])?;
    std::thread::sleep(Duration::from_millis(500));
    let hangs_ns = monotonic_ns();
    hand.signal(Signal::STOP)?;
    let ticks = ticks(bench)?;
    let (last, end) = end_of_jogging(&ticks)?;
    ensure!(
        end.output.reason == Some(Reason::OperatorGone) && !has(end, PilotRequest::OperatorGone),
        "it ended because of {:?}",
        end.output.reason
    );
    let given = |tick: &&TickRecord| {
        tick.events
            .iter()
            .any(|event| matches!(event, Event::Jog(_)))
    };
    let pulses = ticks
        .iter()
        .rfind(given)
        .ok_or_else(|| Failure::new("no pulses were given"))?;
    let since = |tick: &TickRecord| judged_ms(pulses, tick);
    ensure!(
        since(last) <= JOG_TIMEOUT_MS && since(end) > JOG_TIMEOUT_MS,
        "it went on for {} ms after the last pulses, and ended after {} ms",
        since(last),
        since(end)
    );
    bench.at_most(
        "from the last sign of the hand to the first tick after jogging",
        elapsed_ms(hangs_ns, end.start_ns),
        HAND_LIMIT_MS,
        "ms",
    )
}

fn jogs_for_a_time(bench: &mut Bench) -> Outcome {
    let hand = start_jogging(bench, &["--for", "700ms"])?;
    let output = hand.output()?;
    ensure!(output.status.success(), "{output:?}");
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    ensure!(
        text.contains("jogging has ended after") && text.contains("requested"),
        "{text}"
    );
    let ticks = ticks(bench)?;
    let (last, _) = end_of_jogging(&ticks)?;
    let servo_us = last.output.jog.map(|jog| jog.servo_us.to_string());
    ensure!(servo_us.as_deref() == Some(JOG_SERVO), "{servo_us:?}");
    Ok(())
}
