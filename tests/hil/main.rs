//! What the shipped daemon must do with a board, in real time; see
//! [`singletrack_hil`] for how to run it.

mod board;
mod drive;
mod hostile;
mod image;
mod line;
mod markers;
mod process;
mod stop;
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
    Failure, Measurements, Outcome,
    bench::{Bench, Equipment},
    program,
    rig::Need,
};
use singletrack_sim::BoardKind;

/// The shipped daemon against a board, in real time.
#[derive(Debug, Parser)]
#[command(disable_version_flag = true)]
struct Options {
    /// A physical UNO instead of the simulator: servo and motor WILL MOVE, wheels off the ground!
    #[arg(long, value_name = "DEVICE")]
    port: Option<PathBuf>,

    /// What runs on the simulated board: its code, compiled for this machine, or the
    /// Arduino's image on a simulated processor (`cargo uno` builds it)
    #[arg(long, value_name = "native|uno", default_value_t = BoardKind::Native, conflicts_with = "port")]
    board: BoardKind,

    /// A singletrackd that is already there, instead of building one
    #[arg(long, value_name = "PATH")]
    daemon: Option<PathBuf>,

    /// How often the daemon is killed in mid-drive, at different moments
    #[arg(long, value_name = "N", default_value_t = 3)]
    kills: usize,

    #[command(flatten)]
    libtest: Arguments,
}

/// What must happen, and what it takes to see it.
#[derive(Clone, Copy)]
struct Scenario {
    name: &'static str,
    needs: &'static [Need],
    /// Loads the machine itself, or measures how the load of others is borne.
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

    /// No other test runs at the same time.
    const fn alone(self) -> Self {
        Self {
            alone: true,
            ..self
        }
    }
}

/// Tests that run at the same time, unless told otherwise: each waits for most of its
/// time. A rig that gets too little of the machine reports it, and its test is repeated.
const TOGETHER: usize = 4;

/// Held by every test, alone by those that must be.
static MACHINE: RwLock<()> = RwLock::new(());

/// The latest that any rig was.
static LATEST: Mutex<Duration> = Mutex::new(Duration::ZERO);

/// So often a test is run that has shown nothing.
const ATTEMPTS: u64 = 4;

/// Between two attempts.
const PAUSE: Duration = Duration::from_secs(3);

/// When the rig itself was late by more, a failure shows nothing: a command
/// lives for 95 ms, of which the simulator must not use up half.
const TOLERATED_LATENESS: Duration = Duration::from_millis(40);

fn main() -> ExitCode {
    let options = Options::parse();
    let mut libtest = options.libtest.clone();
    // There is one physical board.
    let processors = std::thread::available_parallelism().map_or(1, usize::from);
    let together = match options.port {
        Some(_) => 1,
        None => TOGETHER.min(2 * processors),
    };
    libtest.test_threads.get_or_insert(together);
    let measurements = Measurements::default();
    let scenarios = [
        drive::SCENARIOS,
        markers::SCENARIOS,
        line::SCENARIOS,
        process::SCENARIOS,
        board::SCENARIOS,
        image::SCENARIOS,
        stop::SCENARIOS,
        hostile::SCENARIOS,
        viewers::SCENARIOS,
    ]
    .concat();
    let program = if libtest.list {
        PathBuf::new()
    } else {
        match options.daemon.map_or_else(program::build, Ok) {
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
        measurements: measurements.clone(),
    };
    let trials = scenarios
        .into_iter()
        .map(|scenario| {
            let equipment = equipment.clone();
            Trial::ignorable_test(scenario.name, move || run(&scenario, &equipment))
        })
        .collect();
    let conclusion = libtest_mimic::run(&libtest, trials);
    let table = measurements.table();
    if !table.is_empty() {
        println!("measured, and the limits:\n{table}");
    }
    if !libtest.list {
        let latest = *LATEST.lock().unwrap_or_else(PoisonError::into_inner);
        println!(
            "the rig was late by {latest:.1?} at most; a test counts up to {TOLERATED_LATENESS:?}"
        );
    }
    conclusion.exit_code()
}

/// Runs a scenario beside others, or alone.
fn run(scenario: &Scenario, equipment: &Equipment) -> Result<Completion, Failed> {
    if scenario.alone {
        let _alone = MACHINE.write().unwrap_or_else(PoisonError::into_inner);
        run_until_it_shows(scenario, equipment)
    } else {
        let _beside = MACHINE.read().unwrap_or_else(PoisonError::into_inner);
        run_until_it_shows(scenario, equipment)
    }
}

/// Runs a scenario, again if it has shown nothing.
fn run_until_it_shows(scenario: &Scenario, equipment: &Equipment) -> Result<Completion, Failed> {
    let needs = scenario.needs.iter();
    if let Some(lack) = needs.clone().find_map(|&need| equipment.lacks(need)) {
        return Ok(Completion::ignored_with(lack));
    }
    let mut attempt = 1;
    loop {
        let mut bench = Bench::new(scenario.name, equipment, attempt)?;
        if let Some(lack) = needs.clone().find_map(|&need| bench.lacks(need)) {
            return Ok(Completion::ignored_with(lack));
        }
        let result = (scenario.run)(&mut bench);
        let lateness = bench.rig().lateness().unwrap_or_default();
        {
            let mut latest = LATEST.lock().unwrap_or_else(PoisonError::into_inner);
            *latest = lateness.max(*latest);
        }
        let Err(failure) = result else {
            return Ok(Completion::Completed);
        };
        let void = matches!(failure, Failure::Void(_)) || lateness > TOLERATED_LATENESS;
        if !void || attempt == ATTEMPTS {
            let log = bench.last_log();
            let folder = bench.keep().display();
            return Err(format!(
                "{failure}\n(the rig was late by {lateness:.0?} at most; logs and records are kept in {folder})\n\
                 the daemon's last words:\n{log}"
            )
            .into());
        }
        eprintln!(
            "{}: again, because the rig was late by {lateness:.0?}: {failure}",
            scenario.name
        );
        equipment.measurements.forget(scenario.name);
        // What keeps the machine busy may be over soon.
        std::thread::sleep(PAUSE);
        attempt += 1;
    }
}
