//! Programs that drive the car over the control socket on TCP.

use std::{
    io::{BufRead, BufReader, Write},
    net::TcpStream,
    path::PathBuf,
    process::{Command, Stdio},
    time::{Duration, Instant},
};

use serde_json::{Value, json};
use singletrack_hil::{
    Failure, Outcome, bench::Bench, ensure, rig::Need, settings::RADIUS_M, wait,
};
use singletrack_pilot::{PilotRequest, Reason};
use singletrack_record::TickRecord;
use singletrackd::monotonic_ns;

use crate::{
    Scenario,
    arm::{
        Drive, HANGS_LIMIT_MS, HOLD_TIMEOUT_MS, KILLED_LIMIT_MS, elapsed_ms, has, judged_ms, ticks,
        ticks_so_far,
    },
};

pub(crate) const SCENARIOS: &[Scenario] = &[
    Scenario::new("a_hold_on_tcp_that_dies_stops_the_car_at_once", dies),
    Scenario::new(
        "a_hold_on_tcp_that_hangs_stops_the_car_within_the_time_of_the_dead_man_switch",
        hangs,
    ),
    Scenario::new(
        "the_example_for_matlab_drives_the_circle_in_octave_and_stops",
        octave,
    )
    .needing(&[Need::Octave]),
];

/// Time of a drive, and the interval of its renewals.
const DRIVE: Duration = Duration::from_millis(700);
const RENEWAL: Duration = Duration::from_millis(100);

/// Time of the drive from Octave, and of its beginning, in which P comes to the circle; in s.
const OCTAVE_S: u32 = 10;
const BEGINNING_S: f64 = 5.0;

/// Limit for the distance of P from the circle, as a root mean square: ten times what it is on a
/// machine that is not late.
const OCTAVE_LIMIT_MM: f64 = 20.0;

fn token_file(bench: &Bench) -> PathBuf {
    let mut path = bench.config().socket.path.clone().into_os_string();
    path.push(".token");
    path.into()
}

/// Starts a daemon with a port, and waits until the car can be armed.
fn start(bench: &mut Bench) -> Outcome {
    bench.config_mut().socket.tcp_port = Some(0);
    bench.start_daemon()?;
    bench.wait_until_ready()?;
    Ok(())
}

/// A client on TCP that holds a drive.
struct Holder(TcpStream);

impl Holder {
    /// Arms, and drives for a while.
    fn drive(bench: &mut Bench) -> Outcome<Self> {
        start(bench)?;
        let unreadable = |error: String| Failure::new(format!("the file of the token: {error}"));
        let key =
            std::fs::read(token_file(bench)).map_err(|error| unreadable(error.to_string()))?;
        let key: Value =
            serde_json::from_slice(&key).map_err(|error| unreadable(error.to_string()))?;
        let port = key["port"].as_u64().and_then(|port| port.try_into().ok());
        let port: u16 = port.ok_or_else(|| unreadable(key.to_string()))?;
        let stream =
            TcpStream::connect(("127.0.0.1", port)).map_err(Failure::system("no connection"))?;
        stream
            .set_read_timeout(Some(Duration::from_secs(4)))
            .map_err(Failure::system("no time limit"))?;
        let answers = stream.try_clone().map_err(Failure::system("no clone"))?;
        let mut answers = BufReader::new(answers).lines();
        let mut holder = Self(stream);
        for request in [
            json!({ "version": 3, "command": "token", "token": key["token"] }),
            json!({ "version": 3, "command": "arm", "attendance": "hold" }),
        ] {
            holder.send(&request)?;
            let answer = answers.next();
            let answer = answer.ok_or_else(|| Failure::new("the connection was closed"))?;
            let answer = answer.map_err(Failure::system("no answer"))?;
            ensure!(answer.contains("\"ok\":true"), "{request}: {answer}");
        }
        wait::throughout(DRIVE, || {
            std::thread::sleep(RENEWAL);
            holder.send(&json!({ "version": 3, "command": "hold" }))
        })?;
        ensure!(bench.status()?.mode() == "driving", "it does not drive");
        Ok(holder)
    }

    fn send(&mut self, request: &Value) -> Outcome {
        self.0
            .write_all(format!("{request}\n").as_bytes())
            .map_err(Failure::system("can't send"))
    }
}

fn dies(bench: &mut Bench) -> Outcome {
    let holder = Holder::drive(bench)?;
    let dies_ns = monotonic_ns();
    // The kernel closes it in the same way when its process is killed.
    drop(holder);
    let ticks = ticks(bench)?;
    let drive = Drive::of(&ticks)?;
    drive.ended(Reason::OperatorGone)?;
    ensure!(
        has(drive.stop, PilotRequest::OperatorGone),
        "no request came with the stop: {:?}",
        drive.stop.events
    );
    bench.at_most(
        "from the end of the connection to the first tick of the stop",
        elapsed_ms(dies_ns, drive.stop.start_ns),
        KILLED_LIMIT_MS,
        "ms",
    )
}

fn hangs(bench: &mut Bench) -> Outcome {
    let mut holder = Holder::drive(bench)?;
    holder.send(&json!({ "version": 3, "command": "hold" }))?;
    let hangs_ns = monotonic_ns();
    let ticks = ticks(bench)?;
    drop(holder);
    let drive = Drive::of(&ticks)?;
    drive.ended(Reason::OperatorGone)?;
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
        "from the last renewal to the first tick of the stop",
        elapsed_ms(hangs_ns, drive.stop.start_ns),
        HANGS_LIMIT_MS,
        "ms",
    )
}

fn octave(bench: &mut Bench) -> Outcome {
    start(bench)?;
    let examples = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/examples");
    let call = format!(
        "state = singletrack('{}', {RADIUS_M}, {OCTAVE_S}); disp(state.mode)",
        token_file(bench).display()
    );
    let begun = Instant::now();
    let output = Command::new("octave-cli")
        .args([
            "--quiet",
            "--no-history",
            "--no-init-file",
            "--path",
            examples,
        ])
        .args(["--eval", &call])
        .stdin(Stdio::null())
        .output()
        .map_err(Failure::system("can't run octave-cli"))?;
    let ran_s = begun.elapsed().as_secs_f64();
    let text = String::from_utf8_lossy(&output.stdout);
    ensure!(
        output.status.success() && text.trim() == "driving",
        "{output:?}"
    );
    // The car stands. Without set-points the mode does not become ready.
    let ticks = ticks_so_far(bench)?;
    let drive = Drive::of(&ticks)?;
    drive.ended(Reason::Requested)?;
    let points: Vec<f64> = drive
        .before
        .iter()
        .filter(|tick| tick.output.drive_time > Some(BEGINNING_S))
        .filter_map(|tick| Some(tick.output.point?.coords.norm() - RADIUS_M))
        .collect();
    ensure!(points.len() > 200, "{} ticks on the circle", points.len());
    let mean_square = points.iter().map(|error| error * error).sum::<f64>() / points.len() as f64;
    bench.at_most(
        "distance of P from the circle, from Octave",
        mean_square.sqrt() * 1e3,
        OCTAVE_LIMIT_MM,
        "mm",
    )?;
    bench.at_most(
        "from the start of Octave to its end",
        ran_s,
        f64::from(OCTAVE_S) + 6.0,
        "s",
    )?;
    bench.was_within_limits(&bench.rig().trace()?)
}
