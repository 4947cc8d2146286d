//! A daemon that is killed, terminated, suspended or started twice.

use std::time::Duration;

use singletrack_hil::{
    Failure, Outcome, bench::Bench, client::Client, daemon::Daemon, ensure, settings, wait,
};

use singletrack_core::config::{FenceSection, OuterLoopSection, ReferenceSection, StepSection};

use crate::Scenario;

pub(crate) const SCENARIOS: &[Scenario] = &[
    Scenario::new("a_killed_daemon_stops_the_car", killed),
    Scenario::new(
        "termination_while_driving_stops_the_car_first",
        terminated_driving,
    ),
    Scenario::new("termination_at_rest_is_prompt", terminated_at_rest),
    Scenario::new(
        "a_suspended_daemon_sends_no_old_commands_and_requires_arming",
        paused,
    ),
    Scenario::new("a_second_daemon_on_the_same_socket_is_refused", same_socket),
    Scenario::new(
        "a_second_daemon_on_the_same_port_does_not_connect",
        same_port,
    ),
];

/// Driving time at which the daemon is killed, in ms: while accelerating, and at
/// different phases of ticks and servo frames.
const KILL_TIMES_MS: [u64; 3] = [53, 571, 1_238];

/// These times, followed by others up to one and a half seconds: multiples of the
/// golden ratio are evenly distributed and never repeat a phase of the tick.
fn kill_times(count: usize) -> impl Iterator<Item = Duration> {
    const GOLDEN: f64 = 0.618_033_988_749_895;
    let others = (1_u32..).map(|index| 1.5 * (GOLDEN * f64::from(index)).fract());
    KILL_TIMES_MS
        .into_iter()
        .map(Duration::from_millis)
        .chain(others.map(Duration::from_secs_f64))
        .take(count)
}

/// Width of a geofence that is not in the way, in m.
const HALL_M: f64 = 200.0;

/// Speed of the straight references, in m/s.
const SPEED_M_S: f64 = 0.4;

/// Sets a straight reference for the next daemon, from the present pose, turned by
/// at most this angle towards free space. With a circle, the car would wait for its
/// reference and start as slowly as it comes.
pub(crate) fn onward(bench: &mut Bench, most_rad: f64, speed_m_s: f64) -> Outcome {
    let truth = bench.rig().truth()?;
    let (sin, cos) = ((-truth.y).atan2(-truth.x) - truth.yaw).sin_cos();
    let turn_rad = sin.atan2(cos).clamp(-most_rad, most_rad);
    let (sin, cos) = (truth.yaw + turn_rad).sin_cos();
    let config = bench.config_mut();
    // Nothing is in the way of the whole reference: otherwise it could not be armed.
    config.fence = FenceSection::square(HALL_M, config.fence.braking_m_s2);
    config.outer_loop = OuterLoopSection::OpenLoop {};
    config.reference = ReferenceSection::VelocitySteps {
        steps: vec![StepSection {
            duration_s: 60.0,
            v_x_m_s: speed_m_s * cos,
            v_y_m_s: speed_m_s * sin,
        }],
    };
    Ok(())
}

fn killed(bench: &mut Bench) -> Outcome {
    // Limits the turn after every kill to a wide circle.
    const MOST_RAD: f64 = 0.6;
    onward(bench, MOST_RAD, SPEED_M_S)?;
    bench.start_driving()?;
    for after in kill_times(bench.kills()) {
        bench.keep_driving(after)?;
        bench.daemon()?.kill()?;
        bench.neutral_after_last_command()?;
        bench.wait_until_standing()?;

        // The next daemon takes over the board and the stale socket, and waits.
        let place = bench.rig().trace()?.len();
        onward(bench, MOST_RAD, SPEED_M_S)?;
        bench.start_daemon()?;
        bench.wait_until_ready()?;
        bench.stays_neutral(Duration::from_millis(500))?;
        bench.was_neutral_since(place)?;
        bench.arm_and_drive()?;
    }
    Ok(())
}

/// Number of commands in transit when the daemon is suspended, or sent when it
/// continues.
const OLD_COMMANDS: f64 = 2.0;

fn paused(bench: &mut Bench) -> Outcome {
    onward(bench, 0.0, SPEED_M_S)?;
    bench.start_driving()?;
    for pause in [Duration::from_millis(200), Duration::from_secs(2)] {
        bench.keep_driving(Duration::from_secs(1))?;
        let refused_before = bench.drives_refused()?;
        bench.daemon()?.pause()?;
        bench.neutral_after_last_command()?;
        std::thread::sleep(pause);
        let place = bench.rig().trace()?.len();
        bench.daemon()?.go_on()?;
        bench.wait_until_standing()?;
        bench.wait_for_mode("ready", Duration::from_secs(4))?;
        bench.stays_neutral(Duration::from_millis(500))?;
        bench.was_neutral_since(place)?;
        let refused = bench.drives_refused()? - refused_before;
        bench.at_most("commands that were too late", refused, OLD_COMMANDS, "")?;
        bench.arm_and_drive()?;
    }
    Ok(())
}

/// Limit for the time from the signal to the end of the process, with the car at
/// standstill: the ramp takes 0.2 s at this speed, standstill and disarming some
/// more.
const DRIVING_LIMIT: Duration = Duration::from_millis(2_500);

fn terminated_driving(bench: &mut Bench) -> Outcome {
    bench.start_driving()?;
    bench.keep_driving(Duration::from_secs(1))?;
    let (status, took) = bench.daemon()?.terminate(DRIVING_LIMIT)?;
    ensure!(status.success(), "it ended with {status}");
    bench.at_most(
        "from SIGTERM to the end, driving",
        took.as_secs_f64() * 1_000.0,
        2_000.0,
        "ms",
    )?;
    let truth = bench.rig().truth()?;
    ensure!(
        truth.wheel_speed < 0.1,
        "it ended while the car drove {} m/s",
        truth.wheel_speed
    );
    // Stopped by a command, not by a timeout.
    let cause = bench.rig().stop_cause()?;
    ensure!(
        cause == Some(singletrack_protocol::StopCause::Disarmed),
        "the board's stop cause: {cause:?}"
    );
    bench.stays_neutral(Duration::from_millis(300))?;
    assert_nothing_left(bench)
}

/// The target on the car's computer is 50 ms; here the processors are shared.
const REST_LIMIT_MS: f64 = 250.0;

fn terminated_at_rest(bench: &mut Bench) -> Outcome {
    bench.start_daemon()?;
    bench.wait_until_ready()?;
    let (status, took) = bench.daemon()?.terminate(DRIVING_LIMIT)?;
    ensure!(status.success(), "it ended with {status}");
    bench.at_most(
        "from SIGTERM to the end, at rest",
        took.as_secs_f64() * 1_000.0,
        REST_LIMIT_MS,
        "ms",
    )?;
    assert_nothing_left(bench)
}

/// Checks that no socket and no process with the test's configuration is left.
fn assert_nothing_left(bench: &Bench) -> Outcome {
    let socket = settings::socket(bench.folder());
    ensure!(!socket.exists(), "{} is left", socket.display());
    let config = bench.config_file();
    let config = config.to_string_lossy();
    let left = std::fs::read_dir("/proc")
        .into_iter()
        .flatten()
        .flatten()
        .find(|process| {
            std::fs::read(process.path().join("cmdline"))
                .is_ok_and(|line| String::from_utf8_lossy(&line).contains(&*config))
        });
    ensure!(left.is_none(), "a process is left: {left:?}");
    Ok(())
}

fn same_socket(bench: &mut Bench) -> Outcome {
    bench.start_driving()?;
    let log = bench.folder().join("second.log");
    let mut second = Daemon::start(bench.program(), &bench.config_file(), &log)?;
    let status = wait::until("the second daemon's end", Duration::from_secs(3), || {
        second.status()
    })?;
    ensure!(!status.success(), "the second daemon ended with success");
    let message = second.log();
    let socket = settings::socket(bench.folder());
    ensure!(
        message.contains(&*socket.to_string_lossy()),
        "the log does not name the conflict: {message}"
    );
    // The first daemon is not affected.
    bench.keep_driving(Duration::from_secs(1))
}

fn same_port(bench: &mut Bench) -> Outcome {
    bench.start_driving()?;
    let mut config = bench.config().clone();
    config.socket.path = bench.folder().join("second.sock");
    config.record.enabled = false;
    let file = bench.folder().join("second.toml");
    settings::write(&config, &file)?;
    let mut second = Daemon::start(bench.program(), &file, &bench.folder().join("second.log"))?;
    let message = wait::until("a message about the port", Duration::from_secs(3), || {
        if let Some(status) = second.status()? {
            return Err(Failure::new(format!(
                "it ended: {status}: {}",
                second.log()
            )));
        }
        let log = second.log();
        Ok(log.contains("in use by another program").then_some(log))
    })?;
    let port = bench.rig().port().to_string_lossy().into_owned();
    ensure!(
        message.contains(&port),
        "the log does not name the port: {message}"
    );
    // The first daemon is not affected, and the second has no board to arm.
    bench.keep_driving(Duration::from_secs(1))?;
    let mut client = Client::connect(&config.socket.path)?;
    let answer = client.arm()?;
    ensure!(answer.is_refused(), "it armed: {}", answer.text());
    let mode = client.status()?.mode().to_owned();
    ensure!(mode == "disconnected", "the second is {mode}");
    let (status, _) = second.terminate(DRIVING_LIMIT)?;
    ensure!(status.success(), "it ended with {status}");
    bench.keep_driving(Duration::from_millis(300))
}
