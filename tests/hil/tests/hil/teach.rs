//! `singletrack teach` with the shipped daemon: a car that is pushed by hand teaches a path.

use std::{
    fs,
    io::Write as _,
    path::Path,
    process::{Command, Stdio},
    thread::sleep,
    time::Duration,
};

use singletrack_core::Config;
use singletrack_hil::{Failure, Outcome, bench::Bench, ensure, newcomer::Newcomer, rig::Need};
use singletrack_onboard::OnboardCar;
use singletrack_sim::{HandCommand, HandMotion};

use crate::Scenario;

pub(crate) const SCENARIOS: &[Scenario] = &[Scenario::new(
    "a_path_is_taught_by_pushing_and_becomes_a_reference",
    pushed,
)
.needing(&[Need::Newcomer])];

const SEED: u64 = 3;

/// How far the car is pushed, m, and how much of that may be missing or too much: the car is not
/// measured yet.
const WAY_M: f64 = 0.9;
const OFF_M: f64 = 0.1;

fn pushed(bench: &mut Bench) -> Outcome {
    let programs = bench.program().parent().unwrap_or(Path::new("."));
    let mut newcomer = Newcomer::start(
        OnboardCar::random(SEED),
        &bench.folder().join("newcomer"),
        programs,
    )?;
    let config =
        Config::read(&newcomer.config()).map_err(|error| Failure::new(error.to_string()))?;
    let tool = |name: &str, file: &Path| {
        let mut command = Command::new(programs.join("singletrack"));
        command
            .arg(name)
            .arg(file)
            .arg("--socket")
            .arg(&config.socket.path);
        command
    };
    let file = bench.folder().join("way.csv");
    let system = || Failure::system("singletrack teach");
    let mut teach = tool("teach", &file)
        .arg("--config")
        .arg(newcomer.config())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .map_err(system())?;
    // It does not say when it watches.
    sleep(Duration::from_millis(500));
    newcomer.do_by_hand(HandCommand::Move(HandMotion::Roll {
        distance_m: WAY_M,
        speed_m_s: 0.5,
    }))?;
    if let Some(mut keys) = teach.stdin.take() {
        keys.write_all(b"\n").map_err(system())?;
    }
    let taught = teach.wait_with_output().map_err(system())?;
    ensure!(
        taught.status.success(),
        "singletrack teach: {}",
        String::from_utf8_lossy(&taught.stderr)
    );
    let points = fs::read_to_string(&file).map_err(system())?;
    let points: Vec<[f64; 2]> = points
        .lines()
        .skip(1)
        .filter_map(|line| {
            let (x, y) = line.split_once(',')?;
            Some([x.parse().ok()?, y.parse().ok()?])
        })
        .collect();
    let way: f64 = points
        .windows(2)
        .map(|ends| (ends[1][0] - ends[0][0]).hypot(ends[1][1] - ends[0][1]))
        .sum();
    ensure!((way - WAY_M).abs() < OFF_M, "a path of {way} m: {points:?}");
    let set = tool("set-reference", &file.with_extension("toml"))
        .output()
        .map_err(system())?;
    ensure!(
        set.status.success(),
        "set-reference: {}",
        String::from_utf8_lossy(&set.stderr)
    );
    Ok(())
}
