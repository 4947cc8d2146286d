//! Hardware-in-the-loop tests of the shipped daemon, in real time;
//! [`singletrack_hil`] describes how to run them.

#![allow(
    clippy::disallowed_methods,
    reason = "drives in real time repeat no bits"
)]

mod arm;
mod board;
mod browser;
mod drive;
mod foreign;
mod hostile;
mod image;
mod line;
mod markers;
mod newcomer;
mod pad;
mod port;
mod process;
mod proving;
mod stop;
mod tuning;
mod viewers;

use std::{
    path::PathBuf,
    process::ExitCode,
    sync::{Mutex, PoisonError, RwLock},
    time::Duration,
};

use clap::Parser;
use libtest_mimic::{Arguments, Completion, Failed, Trial};
use singletrack_hil::{
    Failure, Load, Measurements, Outcome, Shares,
    bench::{Bench, Equipment},
    daemon,
    rig::{ModestSession, Need},
};
use singletrack_sim::BoardKind;

/// Test the shipped daemon with a board, in real time.
#[derive(Debug, Parser)]
#[command(disable_version_flag = true)]
struct Options {
    /// Use a physical UNO instead of the simulator: servo and motor WILL MOVE, wheels off the ground!
    #[arg(long, value_name = "DEVICE")]
    port: Option<PathBuf>,

    /// Board to simulate: its code, compiled for this machine, or the UNO image on
    /// a simulated processor (built by `cargo uno`)
    #[arg(long, value_name = "native|uno", default_value_t = BoardKind::Native, conflicts_with = "port")]
    board: BoardKind,

    /// Test this singletrackd instead of building one
    #[arg(long, value_name = "PATH")]
    daemon: Option<PathBuf>,

    /// Number of times that the daemon is killed while driving, at different times
    #[arg(long, value_name = "N", default_value_t = 3)]
    kills: usize,

    /// Also take a car through every step of doctor, bring-up and calibration, which takes a
    /// quarter of an hour
    #[arg(long)]
    whole: bool,

    /// Also drive the car from Octave, with its package instrument-control
    #[arg(long)]
    octave: bool,

    /// Also look at the page in Chromium
    #[arg(long)]
    browser: bool,

    #[command(flatten)]
    libtest: Arguments,
}

/// A test with its requirements on the rig.
#[derive(Clone, Copy)]
struct Scenario {
    name: &'static str,
    needs: &'static [Need],
    /// Loads the machine, or measures under load.
    alone: bool,
    run: fn(&mut Bench) -> Outcome,
}

impl Scenario {
    const fn new(name: &'static str, run: fn(&mut Bench) -> Outcome) -> Self {
        Self {
            name,
            needs: &[],
            alone: false,
            run,
        }
    }

    const fn needing(self, needs: &'static [Need]) -> Self {
        Self { needs, ..self }
    }

    /// Runs without other tests in parallel.
    const fn alone(self) -> Self {
        Self {
            alone: true,
            ..self
        }
    }
}

/// Number of tests in parallel, unless set by an option: each mostly waits. A rig
/// that gets too little processor time reports it, and its test is repeated.
const PARALLEL_TESTS: usize = 4;

/// Held shared by every test, and exclusively by those that run alone.
static MACHINE: RwLock<()> = RwLock::new(());

/// Largest lateness of any rig.
static LATEST: Mutex<Duration> = Mutex::new(Duration::ZERO);

/// Tests without a valid result.
static NOT_VALID: Mutex<Vec<&str>> = Mutex::new(Vec::new());

/// The exit status if nothing has failed but some tests have no valid result: `EX_TEMPFAIL` of
/// `sysexits.h`.
const STATUS_NOT_VALID: u8 = 75;

/// Maximum number of runs of a test without a valid result.
const ATTEMPTS: u64 = 4;

/// Pause between two attempts.
const PAUSE: Duration = Duration::from_secs(3);

/// Lateness of the rig above which a failure is not valid: the time to live of a
/// command is 95 ms; the simulator must not use up half of that.
const TOLERATED_LATENESS: Duration = Duration::from_millis(40);

/// Share of the processors' time that was free, in any two seconds, below which a failure is not valid.
/// The rigs are not late then, which have priority, but the daemon, its clients and the tests are.
const LEAST_FREE: f64 = 0.1;

/// Share of the processors' time that other programs used, in any two seconds, above which a failure of a
/// test that loads the machine itself is not valid.
const MOST_OF_OTHERS: f64 = 0.25;

fn main() -> ExitCode {
    let options = Options::parse();
    let mut libtest = options.libtest.clone();
    // There is only one physical board.
    let processors = std::thread::available_parallelism().map_or(1, usize::from);
    let together = match options.port {
        Some(_) => 1,
        None => PARALLEL_TESTS.min(2 * processors),
    };
    libtest.test_threads.get_or_insert(together);
    let measurements = Measurements::default();
    let mut scenarios = [
        // The long ones first: the others run beside them.
        newcomer::SCENARIOS,
        drive::SCENARIOS,
        markers::SCENARIOS,
        line::SCENARIOS,
        process::SCENARIOS,
        board::SCENARIOS,
        image::SCENARIOS,
        arm::SCENARIOS,
        pad::SCENARIOS,
        port::SCENARIOS,
        tuning::SCENARIOS,
        proving::SCENARIOS,
        stop::SCENARIOS,
        hostile::SCENARIOS,
        foreign::SCENARIOS,
        viewers::SCENARIOS,
        browser::SCENARIOS,
    ]
    .concat();
    // Nothing has to wait for those that run alone if nothing follows them.
    scenarios.sort_by_key(|scenario| scenario.alone);
    let program = if libtest.list {
        PathBuf::new()
    } else {
        match options.daemon.map_or_else(daemon::build, Ok) {
            Ok(program) => program,
            Err(failure) => {
                eprintln!("error: {failure}");
                return ExitCode::FAILURE;
            }
        }
    };
    let equipment = Equipment {
        program,
        port: options.port,
        board: options.board,
        kills: options.kills,
        whole: options.whole,
        octave: options.octave,
        browser: options.browser,
        measurements: measurements.clone(),
    };
    let trials = scenarios
        .into_iter()
        .map(|scenario| {
            let equipment = equipment.clone();
            Trial::ignorable_test(scenario.name, move || run(&scenario, &equipment))
        })
        .collect();
    let modest = ModestSession::begin();
    let conclusion = libtest_mimic::run(&libtest, trials);
    drop(modest);
    let table = measurements.table();
    if !table.is_empty() {
        println!("measurements and limits:\n{table}");
    }
    if !libtest.list {
        let latest = *LATEST.lock().unwrap_or_else(PoisonError::into_inner);
        println!(
            "largest lateness of a rig: {latest:.1?}; tests are valid up to {TOLERATED_LATENESS:?}"
        );
    }
    let not_valid = NOT_VALID.lock().unwrap_or_else(PoisonError::into_inner);
    if not_valid.is_empty() || conclusion.num_failed > not_valid.len() as u64 {
        return conclusion.exit_code();
    }
    println!(
        "not valid on this machine now: {}\nnothing else has failed. Other programs took the time of \
         the processors: end them, and run these again (exit status {STATUS_NOT_VALID})",
        not_valid.join(", ")
    );
    STATUS_NOT_VALID.into()
}

/// Runs a scenario in parallel with others, or alone; repeatedly, and then alone, if its result is not
/// valid.
fn run(scenario: &Scenario, equipment: &Equipment) -> Result<Completion, Failed> {
    let needs = scenario.needs.iter();
    if let Some(lack) = needs.clone().find_map(|&need| equipment.lacks(need)) {
        return Ok(Completion::ignored_with(lack));
    }
    let mut attempt = 1;
    loop {
        let is_alone = scenario.alone || attempt > 1;
        let _alone = is_alone.then(|| MACHINE.write().unwrap_or_else(PoisonError::into_inner));
        let _beside = (!is_alone).then(|| MACHINE.read().unwrap_or_else(PoisonError::into_inner));
        let mut bench = Bench::new(scenario.name, equipment, attempt)?;
        if let Some(lack) = needs.clone().find_map(|&need| bench.lacks(need)) {
            return Ok(Completion::ignored_with(lack));
        }
        let load = Load::watch();
        let result = (scenario.run)(&mut bench);
        let shares = load.worst();
        let lateness = bench.rig().lateness().unwrap_or_default();
        {
            let mut latest = LATEST.lock().unwrap_or_else(PoisonError::into_inner);
            *latest = lateness.max(*latest);
        }
        let Err(failure) = result else {
            return Ok(Completion::Completed);
        };
        let mut load = format!("rig late by {lateness:.0?}");
        if let Some(Shares { free, others }) = shares {
            let [free, others] = [free, others].map(|share| 100.0 * share);
            load += &format!(
                ", at worst {free:.0} % of the processors free and {others:.0} % used by other programs"
            );
        }
        let busy = |shares: Shares| match scenario.alone {
            true => shares.others > MOST_OF_OTHERS,
            false => shares.free < LEAST_FREE,
        };
        let void = matches!(failure, Failure::Void(_))
            || lateness > TOLERATED_LATENESS
            || shares.is_some_and(busy);
        if !void || attempt == ATTEMPTS {
            if void {
                let mut not_valid = NOT_VALID.lock().unwrap_or_else(PoisonError::into_inner);
                not_valid.push(scenario.name);
            }
            let log = bench.last_log();
            let folder = bench.keep().display();
            let verdict = if void { "not valid: " } else { "" };
            return Err(format!(
                "{verdict}{failure}\n({load}; logs and records are kept in {folder})\n\
                 end of the daemon's log:\n{log}"
            )
            .into());
        }
        eprintln!("{}: repeated ({load}): {failure}", scenario.name);
        equipment.measurements.forget(scenario.name);
        // The load of the machine may end soon.
        std::thread::sleep(PAUSE);
        attempt += 1;
    }
}
