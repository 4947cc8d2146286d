//! Controllers outside the daemon that are broken or hostile: the car stops with the reason, or is
//! limited, and stays inside the geofence.

use std::{
    process::{Child, Command, Stdio},
    sync::atomic::{AtomicBool, Ordering},
    thread,
    time::{Duration, Instant},
};

use serde_json::{Value, json};
use singletrack_core::config::ReferenceSection;
use singletrack_hil::{
    Failure, Outcome,
    bench::Bench,
    client::Client,
    controller::{Holder, State, States},
    ensure,
    rig::Need,
    settings,
};
use singletrackd::monotonic_ns;

use crate::Scenario;

pub(crate) const SCENARIOS: &[Scenario] = &[
    Scenario::new(
        "a_program_that_hangs_dies_or_sends_nonsense_stops_the_car_with_the_reason",
        broken,
    )
    .needing(&[Need::Fast]),
    Scenario::new(
        "full_speed_and_full_steering_by_actuation_end_inside_the_fence",
        reckless,
    )
    .needing(&[Need::Fast]),
    Scenario::new(
        "a_program_that_sends_as_fast_as_it_can_delays_neither_ticks_nor_a_disarm",
        flood,
    )
    .needing(&[Need::Fast])
    .alone(),
];

/// How long a set-point is valid.
const TIMEOUT_MS: u32 = 200;

/// Interval of a program's set-points.
const PERIOD: Duration = Duration::from_millis(20);

/// Limit for the time until the car can be armed, with its last stop.
const READY: Duration = Duration::from_secs(10);

/// Limit for the time until the car moves, and until a stop has begun.
const MOVING: Duration = Duration::from_secs(5);

/// Limit from the last valid set-point to the first tick of the stop: the time-out, and a tick; the
/// rest is for a busy machine.
const STOP_LIMIT_MS: f64 = 300.0;

/// Limit from the last valid set-point to standstill, from 0.5 m/s.
const STAND_LIMIT_MS: f64 = 2_000.0;

/// A bend to the left, in which the car stays away from the geofence.
const STEERING_RAD: f64 = 0.25;
const SPEED_M_S: f64 = 0.5;

fn gentle() -> Value {
    json!({ "steering_rad": STEERING_RAD, "speed_m_s": SPEED_M_S })
}

/// All that a program can demand.
fn full_lock() -> Value {
    json!({ "steering_rad": 1.5, "speed_m_s": 100.0 })
}

/// Starts a daemon that takes set-points.
fn start(bench: &mut Bench) -> Outcome<States> {
    bench.config_mut().reference = ReferenceSection::External {
        setpoint_timeout_ms: TIMEOUT_MS,
    };
    bench.start_daemon()?;
    States::of(bench.client()?)
}

/// Calls `act` every 20 ms until a state is as wanted.
fn act_until(
    states: &States,
    what: &str,
    limit: Duration,
    mut act: impl FnMut() -> Outcome,
    is_reached: impl Fn(&State) -> bool,
) -> Outcome<State> {
    let begun = Instant::now();
    loop {
        act()?;
        thread::sleep(PERIOD);
        if let Ok(state) = states.newest()
            && is_reached(&state)
        {
            return Ok(state);
        }
        if begun.elapsed() > limit {
            let last = states.newest();
            return Err(Failure::new(format!(
                "{what}: not within {limit:?}: {last:?}"
            )));
        }
    }
}

/// Arms, and drives for a while by a program that is called every 20 ms.
fn drive(
    bench: &mut Bench,
    states: &States,
    mut program: impl FnMut() -> Outcome,
) -> Outcome<Holder> {
    act_until(states, "readiness", READY, &mut program, |state| {
        state.mode == "ready"
    })?;
    let holder = Holder::arm(bench.client()?)?;
    act_until(states, "a moving car", MOVING, &mut program, |state| {
        state.mode == "driving" && state.speed_m_s > 0.3
    })?;
    let until = Instant::now() + Duration::from_millis(300);
    while Instant::now() < until {
        program()?;
        thread::sleep(PERIOD);
    }
    Ok(holder)
}

/// The end of the newest drive.
struct End {
    /// The last tick that drove.
    last: State,
    /// The first one that did not.
    stop: State,
    /// The first one at which the car stood.
    stands: State,
}

impl End {
    /// Waits for it, while a program acts, and checks that it is inside the geofence.
    fn of(bench: &Bench, states: &States, act: impl FnMut() -> Outcome) -> Outcome<Self> {
        act_until(states, "the end of the drive", MOVING, act, |state| {
            matches!(state.mode.as_str(), "idle" | "ready" | "fault")
        })?;
        let all = states.so_far();
        let is_driving = |state: &State| state.mode == "driving";
        let last = all.iter().rposition(is_driving);
        let found = last.and_then(|last| {
            let mut after = all.iter().skip(last);
            Some(Self {
                last: after.next()?.clone(),
                stop: after.next()?.clone(),
                stands: after
                    .find(|state| matches!(state.mode.as_str(), "idle" | "ready"))?
                    .clone(),
            })
        });
        let end = found.ok_or_else(|| Failure::new("the states have no drive with its end"))?;
        is_inside(bench)?;
        Ok(end)
    }

    fn is_because_of(&self, reason: &str) -> Outcome {
        let State {
            mode,
            reason: because,
            ..
        } = &self.stop;
        ensure!(
            mode == "stopping" && because == reason,
            "{mode} because of {because}, not {reason}"
        );
        Ok(())
    }

    /// Checks that the first tick that had no valid set-point any more stopped the car.
    fn is_stale(&self, bench: &Bench, program: &str) -> Outcome {
        self.is_because_of("setpoint-stale")?;
        let age_ms = |state: &State| state.setpoint_age_s.map_or(f64::NAN, |age| age * 1e3);
        let (last, stop) = (age_ms(&self.last), age_ms(&self.stop));
        let timeout = f64::from(TIMEOUT_MS);
        ensure!(
            last <= timeout && stop > timeout,
            "the car drove on a set-point {last} ms old, and stopped on one of {stop} ms"
        );
        let what = format!("from the last set-point of a program that {program} to the stop");
        bench.at_most(&what, stop, STOP_LIMIT_MS, "ms")?;
        let way_ms = (self.stands.time_ns - self.stop.time_ns) as f64 * 1e-6;
        let what = format!("from the last set-point of a program that {program} to standstill");
        bench.at_most(&what, stop + way_ms, STAND_LIMIT_MS, "ms")
    }
}

/// Checks that the true car is inside the geofence.
fn is_inside(bench: &Bench) -> Outcome {
    let truth = bench.rig().truth()?;
    let most = 0.5 * settings::FENCE_WIDTH_M;
    ensure!(
        truth.x.abs() < most && truth.y.abs() < most,
        "the car is outside the geofence, at ({}, {})",
        truth.x,
        truth.y
    );
    Ok(())
}

/// The number of set-points that were rejected with a word.
fn rejected(bench: &mut Bench, word: &str) -> Outcome<f64> {
    let figure = format!("/setpoints/rejected/{word}");
    Ok(bench.status()?.figure(&figure).unwrap_or(0.0))
}

fn broken(bench: &mut Bench) -> Outcome {
    let states = start(bench)?;
    two_programs(bench, &states)?;
    type Lines = fn() -> String;
    let programs: [(&str, &str, Lines); 3] = [
        ("sends NaN", "not-finite", nan),
        ("is late", "old", old),
        ("is early", "future", future),
    ];
    for (program, word, nonsense) in programs {
        let mut client = bench.client()?;
        let holder = drive(bench, &states, || client.setpoint(&gentle()))?;
        let before = rejected(bench, word)?;
        let end = End::of(bench, &states, || client.send_lines(&nonsense()))?;
        end.is_stale(bench, program)?;
        let count = rejected(bench, word)? - before;
        ensure!(count > 5.0, "{count} were rejected as {word}");
        drop(holder);
    }
    killed(bench, &states)?;
    ends(bench, &states)
}

fn nan() -> String {
    r#"{"version":3,"command":"setpoint","steering_rad":NaN,"speed_m_s":NaN}"#.to_owned() + "\n"
}

/// A valid set-point in all but its time.
fn stamped(time_ns: u64) -> String {
    format!(
        r#"{{"version":3,"command":"setpoint","steering_rad":0.2,"speed_m_s":0.5,"time_ns":{time_ns}}}"#
    ) + "\n"
}

fn old() -> String {
    stamped(monotonic_ns() - 250_000_000)
}

fn future() -> String {
    stamped(monotonic_ns() + 1_000_000_000)
}

/// One program steers, and another one demands all that it can; then the first one hangs.
fn two_programs(bench: &mut Bench, states: &States) -> Outcome {
    let (mut one, mut other) = (bench.client()?, bench.client()?);
    let holder = drive(bench, states, || one.setpoint(&gentle()))?;
    let from = states.so_far().len();
    for _ in 0..25 {
        one.setpoint(&gentle())?;
        other.setpoint(&full_lock())?;
        thread::sleep(PERIOD);
    }
    let count = rejected(bench, "other-source")?;
    ensure!(
        count == 25.0,
        "{count} of 25 set-points of the other program were rejected"
    );
    let ticks = states.so_far();
    for state in ticks.iter().skip(from) {
        ensure!(
            state.mode == "driving"
                && (state.steering_rad - STEERING_RAD).abs() < 1e-9
                && state.commanded_speed_m_s <= SPEED_M_S + 1e-9,
            "the other program changed the drive: {state:?}"
        );
    }
    End::of(bench, states, || Ok(()))?.is_stale(bench, "hangs")?;
    drop(holder);
    Ok(())
}

/// `singletrack setpoint`, which is killed when it is dropped.
struct Program(Child);

impl Program {
    fn start(bench: &Bench) -> Outcome<Self> {
        // Built next to the daemon.
        let tool = bench.program().with_file_name("singletrack");
        Command::new(&tool)
            .args([
                "setpoint",
                "--steering",
                "0.25",
                "--speed",
                "0.5",
                "--socket",
            ])
            .arg(&bench.config().socket.path)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .spawn()
            .map(Self)
            .map_err(Failure::system(format!("can't run {}", tool.display())))
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        // SIGKILL.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn killed(bench: &mut Bench, states: &States) -> Outcome {
    let program = Program::start(bench)?;
    let holder = drive(bench, states, || Ok(()))?;
    drop(program);
    End::of(bench, states, || Ok(()))?.is_stale(bench, "is killed")?;
    drop(holder);
    Ok(())
}

/// The program that steers also holds the drive, and both of its connections end.
fn ends(bench: &mut Bench, states: &States) -> Outcome {
    let mut client = bench.client()?;
    let holder = drive(bench, states, || client.setpoint(&gentle()))?;
    let ended_ns = monotonic_ns();
    drop((holder, client));
    let end = End::of(bench, states, || Ok(()))?;
    end.is_because_of("operator-gone")?;
    let ms = (end.stop.time_ns as f64 - ended_ns as f64) * 1e-6;
    bench.at_most(
        "from the end of a program that holds its drive to the stop",
        ms,
        STOP_LIMIT_MS,
        "ms",
    )
}

/// The top speed at which there is room in the geofence to reach it.
const TOP_SPEED_M_S: f64 = 1.2;

/// Full lock at full speed, and then straight on out of the geofence.
fn reckless(bench: &mut Bench) -> Outcome {
    bench.config_mut().limits.max_speed_m_s = TOP_SPEED_M_S;
    let states = start(bench)?;
    let mut client = bench.client()?;
    let straight = json!({ "steering_rad": 0.0, "speed_m_s": 100.0 });
    let holder = drive(bench, &states, || client.setpoint(&gentle()))?;
    let limits = bench.config().limits;
    let from = states.so_far().len();
    let begun = Instant::now();
    act_until(
        &states,
        "three seconds",
        MOVING,
        || client.setpoint(&full_lock()),
        |_| begun.elapsed() > Duration::from_secs(3),
    )?;
    let locked = states.so_far();
    let stopped = locked
        .iter()
        .skip(from)
        .find(|state| state.mode != "driving");
    ensure!(stopped.is_none(), "full lock ended the drive: {stopped:?}");
    let steering = locked
        .iter()
        .map(|state| state.steering_rad)
        .fold(0.0, f64::max);
    ensure!(
        (steering - limits.max_steering_rad).abs() < 1e-9,
        "the steering reached {steering} rad, and its limit is {}",
        limits.max_steering_rad
    );
    // Straight on, and from lock to lock where the geofence is close: the car does not turn away.
    let mut fastest: f64 = 0.0;
    let mut count = 0_u32;
    let end = End::of(bench, &states, || {
        let state = states.newest()?;
        fastest = fastest.max(state.speed_m_s);
        is_inside(bench)?;
        let [x, y] = state.position_m;
        let is_close = x.abs().max(y.abs()) > 0.5 * settings::FENCE_WIDTH_M - 1.5;
        count += 1;
        let side = if count % 10 < 5 { 1.5 } else { -1.5 };
        if is_close {
            client.setpoint(&json!({ "steering_rad": side, "speed_m_s": 100.0 }))
        } else {
            client.setpoint(&straight)
        }
    })?;
    end.is_because_of("outside-fence")?;
    drop(holder);
    let all = states.so_far();
    let commanded = all
        .iter()
        .map(|state| state.commanded_speed_m_s)
        .fold(0.0, f64::max);
    bench.at_most("commanded speed", commanded, limits.max_speed_m_s, "m/s")?;
    ensure!(
        fastest > 0.8 * limits.max_speed_m_s,
        "only {fastest} m/s were reached"
    );
    let [x, y] = end.stands.position_m;
    let fence = &bench.config().fence;
    bench.at_most(
        "distance of G from the middle of the geofence",
        x.abs().max(y.abs()),
        0.5 * settings::FENCE_WIDTH_M - fence.margin_m(&bench.config().vehicle),
        "m",
    )
}

/// Time of the flood, and limits under it for another client; the processors are shared.
const FLOOD: Duration = Duration::from_secs(2);
const ANSWER_LIMIT_MS: f64 = 500.0;
const LATENESS_LIMIT_US: f64 = 5_000.0;

fn flood(bench: &mut Bench) -> Outcome {
    let states = start(bench)?;
    let mut flooder = bench.client()?;
    let holder = drive(bench, &states, || flooder.setpoint(&gentle()))?;
    let mut other = bench.client()?;
    let before = other.status()?.figure("/setpoints/accepted")?;
    let over = AtomicBool::new(false);
    let mut slowest = Duration::ZERO;
    let disarmed_ns = thread::scope(|scope| {
        let flooding = scope.spawn(|| keep_sending(&mut flooder, &over));
        let until = Instant::now() + FLOOD;
        let mut asked = || -> Outcome<u64> {
            while Instant::now() < until {
                let asked = Instant::now();
                let status = other.status()?;
                slowest = slowest.max(asked.elapsed());
                ensure!(
                    status.mode() == "driving",
                    "the car stopped: {}",
                    status.text()
                );
                thread::sleep(PERIOD);
            }
            let now_ns = monotonic_ns();
            other.disarm()?.accepted()?;
            Ok(now_ns)
        };
        let disarmed = asked();
        thread::sleep(Duration::from_millis(100));
        over.store(true, Ordering::Relaxed);
        let flooded = flooding
            .join()
            .map_err(|_| Failure::new("the flood has panicked"))?;
        flooded.and(disarmed)
    })?;
    let end = End::of(bench, &states, || Ok(()))?;
    end.is_because_of("requested")?;
    drop(holder);
    let status = bench.status()?;
    let count = status.figure("/setpoints/accepted")? - before;
    ensure!(count > 20_000.0, "{count} set-points are no flood");
    bench.at_most(
        "from a disarm in the flood to the stop",
        (end.stop.time_ns as f64 - disarmed_ns as f64) * 1e-6,
        ANSWER_LIMIT_MS,
        "ms",
    )?;
    bench.at_most(
        "slowest answer to another client",
        slowest.as_secs_f64() * 1e3,
        ANSWER_LIMIT_MS,
        "ms",
    )?;
    bench.at_most(
        "99th percentile of the ticks' lateness",
        status.figure("/lateness_us/p99")?,
        LATENESS_LIMIT_US,
        "us",
    )
}

/// Sends set-points without a pause.
fn keep_sending(client: &mut Client, over: &AtomicBool) -> Outcome {
    let line = json!({
        "version": 3, "command": "setpoint",
        "steering_rad": STEERING_RAD, "speed_m_s": SPEED_M_S,
    });
    let lines = format!("{line}\n").repeat(200);
    while !over.load(Ordering::Relaxed) {
        client.send_lines(&lines)?;
    }
    Ok(())
}
