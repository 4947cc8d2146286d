//! The command `cargo faults`; the library's documentation describes it.

use std::{
    collections::BTreeMap,
    io::{self, Write},
    path::{Path, PathBuf},
    process::ExitCode,
};

use clap::Parser;
use singletrack_campaign::{CampaignArgs, Result, Shard};
use singletrack_faults::{
    Campaign, CampaignOutcome, Failure, FilterTicks, FleetBug, FleetCampaign, Recording,
    SeedOutcome, Untampered, Until, Violation, attempt, drive_fleet, drive_watched, planted,
    schedule::Schedule, shrink,
};
use singletrack_pilot::Reason;
use singletrack_sim::BoardKind;

/// Run random fault schedules against the complete control chain, in virtual time.
#[derive(Debug, Parser)]
#[command(name = "cargo faults", disable_version_flag = true)]
struct Options {
    /// First seed
    #[arg(long, value_name = "N", default_value_t = 1)]
    first_seed: u64,

    /// Number of consecutive seeds
    #[arg(long, value_name = "M", default_value_t = 100)]
    count: u64,

    /// Board to simulate: the board's code, or the UNO image on a simulated processor
    #[arg(long, value_name = "native|uno", default_value_t = BoardKind::Native)]
    board: BoardKind,

    #[command(flatten)]
    campaign: CampaignArgs,

    /// Run only this schedule: a file, or its text with ";" between the entries
    #[arg(long, value_name = "SCHEDULE", conflicts_with_all = ["shard", "json", "from"])]
    replay: Option<String>,

    /// Write the records of the daemons to this folder, as seed-N.mcap, for
    /// `singletrack replay` and `singletrack plot`; runs on one thread
    #[arg(long, value_name = "DIR", conflicts_with_all = ["shard", "json", "from"])]
    record: Option<PathBuf>,

    /// Simulate this many hours of one drive with a fault every quarter of a minute, and print the
    /// memory in use after each
    #[arg(long, value_name = "HOURS", value_parser = clap::value_parser!(u32).range(1..=1_000),
          conflicts_with_all = ["shard", "json", "from", "replay", "record", "planted", "print"])]
    soak: Option<u32>,

    /// Plant every known bug in each schedule, and count in how many it is found
    #[arg(long)]
    planted: bool,

    /// Print the schedules without running them
    #[arg(long, conflicts_with_all = ["shard", "json", "from"])]
    print: bool,

    /// Count in how many schedules each invariant is violated: drives go on after a
    /// violation
    #[arg(long)]
    by_invariant: bool,

    /// Several cars on one floor, 2 to 20, with faults of their own: no two may touch
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(2..=20),
          conflicts_with_all = ["board", "soak", "replay", "record", "print", "by_invariant"])]
    cars: Option<u8>,

    /// Do not shrink failing schedules
    #[arg(long)]
    no_shrink: bool,
}

/// Number of failures that are shrunk: shrinking is slow.
const MAX_SHRUNK: usize = 5;

fn main() -> ExitCode {
    match run(&Options::parse()) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run(options: &Options) -> Result<bool> {
    let out = &mut io::stdout().lock();
    if options.print {
        for number in 0..options.count {
            let seed = options.first_seed.wrapping_add(number);
            writeln!(out, "{}", Schedule::generate(seed, options.board))?;
        }
        return Ok(true);
    }
    // The report of a violation contains the panic message.
    std::panic::set_hook(Box::new(|_| {}));
    if let Some(cars) = options.cars {
        return fleet(options, cars.into(), out);
    }
    if options.planted {
        return count_planted(options, out);
    }
    if let Some(hours) = options.soak {
        return soak(options, hours, out);
    }
    let mut by_invariant = options.by_invariant;
    let outcomes = match &options.replay {
        Some(text) => vec![run_recorded(&read_schedule(text)?, options)?],
        None if options.record.is_some() => record_all(options)?,
        None => {
            let campaign = campaign(options)?;
            by_invariant = campaign.experiment.until == Until::End;
            let results = campaign.results.into_iter();
            results.map(|(_, outcome)| outcome).collect()
        }
    };
    let outcome = CampaignOutcome::of(&outcomes)?;
    if by_invariant {
        for (invariant, count) in &outcome.violated {
            writeln!(out, "{count:>6}  {invariant}")?;
        }
    }
    let failures = outcome.failures.iter().filter(|_| !by_invariant);
    for (index, failure) in failures.enumerate() {
        print_failure(out, failure)?;
        if index < MAX_SHRUNK && !options.no_shrink && options.replay.is_none() {
            let (schedule, violation) =
                shrink(&failure.schedule, &failure.violation, || Untampered)?;
            writeln!(out, "shrunk, it still violates {}:", violation.invariant)?;
            writeln!(out, "{schedule}")?;
            writeln!(
                out,
                "{} at {} ms: {}",
                violation.invariant,
                violation.time_us / 1_000,
                violation.details
            )?;
            writeln!(
                out,
                "    cargo faults --replay '{}'\n",
                schedule.in_one_line()
            )?;
        }
    }
    let reasons = outcome.reasons.iter();
    let reasons: Vec<_> = reasons
        .map(|(reason, count)| format!("{reason} {count}"))
        .collect();
    writeln!(out, "reasons not to drive: {}", reasons.join(", "))?;
    writeln!(
        out,
        "the car was driven for {:.0} s of {:.0} s",
        outcome.driven_s, outcome.simulated_s
    )?;
    for (name, (schedules, ticks)) in ["other", "hostile"].iter().zip(outcome.filter) {
        print_filter(out, name, schedules, ticks)?;
    }
    writeln!(
        out,
        "{} schedules, {} violations",
        outcome.count,
        outcome.failures.len()
    )?;
    Ok(outcome.failures.is_empty())
}

/// How often the safety filter intervened.
fn print_filter(
    out: &mut impl Write,
    loops: &str,
    schedules: u64,
    ticks: FilterTicks,
) -> io::Result<()> {
    if ticks.driving == 0 {
        return Ok(());
    }
    let percent = |part: u64| 100.0 * part as f64 / ticks.driving as f64;
    writeln!(
        out,
        "safety filter before {loops} outer loops: {schedules} schedules, {} ticks, limited {:.2} %, scaled {:.2} %, stopped {:.2} %; drives ended: {} by it, {} by the geofence",
        ticks.driving,
        percent(ticks.limited),
        percent(ticks.scaled),
        percent(ticks.stopped),
        ticks.cornered,
        ticks.fenced
    )
}

fn print_failure(out: &mut impl Write, failure: &Failure) -> io::Result<()> {
    let Failure {
        schedule,
        violation,
    } = failure;
    writeln!(
        out,
        "seed {} violates {} at {} ms: {}",
        schedule.seed,
        violation.invariant,
        violation.time_us / 1_000,
        violation.details
    )?;
    writeln!(out, "{schedule}")?;
    let board = schedule.situation.board;
    writeln!(
        out,
        "    cargo faults --first-seed {} --count 1 --board {board}\n",
        schedule.seed
    )
}

/// Runs the schedules of several cars, or plants bugs in all of them.
fn fleet(options: &Options, cars: usize, out: &mut impl Write) -> Result<bool> {
    let experiment = FleetCampaign {
        first_seed: options.first_seed,
        count: options.count,
        cars,
    };
    if options.planted {
        let mut missed = 0;
        for bug in FleetBug::ALL {
            let found = (0..options.count)
                .map(|unit| drive_fleet(experiment.first_seed.wrapping_add(unit), cars, Some(bug)))
                .filter(|outcome| outcome.as_ref().is_ok_and(|it| it.failure.is_some()))
                .count();
            missed += usize::from(found == 0);
            writeln!(out, "found in {found}: {bug:?}")?;
        }
        return Ok(missed == 0);
    }
    let results = singletrack_campaign::Campaign::obtain(experiment, &options.campaign)?.results;
    let (mut driven_ms, mut yielded_ms, mut violations) = (0, 0, 0);
    let (mut nearest_m, mut reasons) = (f64::INFINITY, BTreeMap::<_, u64>::new());
    for (_, outcome) in &results {
        (driven_ms, yielded_ms) = (
            driven_ms + outcome.driven_ms,
            yielded_ms + outcome.yielded_ms,
        );
        nearest_m = outcome.nearest_m.min(nearest_m);
        for reason in &outcome.reasons {
            *reasons.entry(reason).or_default() += 1;
        }
        if let Some(failure) = &outcome.failure {
            violations += 1;
            writeln!(out, "seed {}: {failure}", outcome.seed)?;
            let seed = outcome.seed;
            writeln!(
                out,
                "    cargo faults --cars {cars} --first-seed {seed} --count 1\n"
            )?;
        }
    }
    let reasons: Vec<_> = reasons
        .iter()
        .map(|(reason, count)| format!("{reason} {count}"))
        .collect();
    writeln!(out, "reasons not to drive: {}", reasons.join(", "))?;
    writeln!(
        out,
        "the cars drove for {} s, and yielded for {} s of it; least distance {nearest_m:.3} m",
        driven_ms / 1_000,
        yielded_ms / 1_000
    )?;
    writeln!(out, "{} schedules, {violations} violations", results.len())?;
    Ok(violations == 0)
}

/// Prints the planted bugs and in how many schedules each is found; false if one never is.
fn count_planted(options: &Options, out: &mut impl Write) -> Result<bool> {
    let experiment = planted::PlantedCampaign {
        first_seed: options.first_seed,
        count: options.count,
    };
    let campaign = singletrack_campaign::Campaign::obtain(experiment, &options.campaign)?;
    let found = planted::count(&campaign.results);
    writeln!(out, "| found in | invariant | planted in | bug |")?;
    writeln!(out, "|---|---|---|---|")?;
    for (bug, count) in &found {
        let (invariant, part, name) = (bug.invariant, bug.part.name(), bug.name);
        writeln!(out, "| {count} | `{invariant}` | {part} | {name} |")?;
    }
    let missed = found.iter().filter(|(_, count)| *count == 0).count();
    writeln!(
        out,
        "{} schedules, {} planted bugs, {missed} never found",
        campaign.results.len(),
        found.len()
    )?;
    // A part of a campaign may be too small to find each.
    Ok(missed == 0 || campaign.shard != Shard::WHOLE)
}

fn campaign(options: &Options) -> Result<singletrack_campaign::Campaign<Campaign>> {
    let experiment = Campaign {
        first_seed: options.first_seed,
        count: options.count,
        board: options.board,
        until: if options.by_invariant {
            Until::End
        } else {
            Until::Violation
        },
    };
    singletrack_campaign::Campaign::obtain(experiment, &options.campaign)
}

/// Parses a schedule from a file of that name, or else from the text itself.
fn read_schedule(text: &str) -> Result<Schedule> {
    let text = if Path::new(text).exists() {
        std::fs::read_to_string(text).map_err(|error| format!("{text}: {error}"))?
    } else {
        text.to_owned()
    };
    Ok(text.parse()?)
}

/// An hour of simulated time, in µs.
const HOUR_US: u64 = 3_600_000_000;

fn soak(options: &Options, hours: u32, out: &mut impl Write) -> Result<bool> {
    let end_ms = hours * 3_600_000;
    let schedule = Schedule::soak(options.first_seed, options.board, end_ms);
    let (faults, requests) = (schedule.faults.len(), schedule.requests.len());
    writeln!(out, "{hours} h, {faults} faults, {requests} requests")?;
    writeln!(
        out,
        "{:>6} {:>10} {:>13}",
        "hour", "driven s", "resident kB"
    )?;
    let mut written = Ok(());
    let outcome = drive_watched(
        &schedule,
        &mut Untampered,
        Until::Violation,
        HOUR_US,
        |now_us, driven_ms, reason| {
            let resident = resident_kb().map_or_else(|| "?".to_owned(), |kb| kb.to_string());
            let (hour, driven_s) = (now_us / HOUR_US, driven_ms / 1_000);
            let reason = reason.map_or("driving", Reason::name);
            let line = writeln!(out, "{hour:>6} {driven_s:>10} {resident:>13}  {reason}");
            if written.is_ok() {
                written = line;
            }
        },
    )?;
    written?;
    let reasons: Vec<_> = outcome.reasons.into_iter().collect();
    writeln!(out, "reasons not to drive: {}", reasons.join(", "))?;
    match &outcome.violation {
        None => writeln!(out, "no violation")?,
        Some(Violation {
            invariant,
            time_us,
            details,
        }) => writeln!(out, "{invariant} at {} ms: {details}", time_us / 1_000)?,
    }
    Ok(outcome.violation.is_none())
}

/// The memory of this process in use, in kB.
fn resident_kb() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("VmRSS:"))?;
    line.split_whitespace().next()?.parse().ok()
}

fn record_all(options: &Options) -> Result<Vec<SeedOutcome>> {
    let seeds = (0..options.count).map(|number| options.first_seed.wrapping_add(number));
    seeds
        .map(|seed| run_recorded(&Schedule::generate(seed, options.board), options))
        .collect()
}

fn run_recorded(schedule: &Schedule, options: &Options) -> Result<SeedOutcome> {
    let mut recording = Recording::default();
    let drive_outcome = attempt(schedule, &mut recording)?;
    if let Some(folder) = &options.record {
        for path in recording.write(folder, schedule)? {
            eprintln!("{}", path.display());
        }
    }
    Ok(SeedOutcome::new(schedule, drive_outcome))
}
