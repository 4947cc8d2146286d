//! `singletrack judge`: what the pilot would have said of a drive, ours or another car's.
//!
//! The pilot of the daemon is fed from a record, and commands nothing: estimator, gates, watches and
//! supervisor see what they would have seen. Its estimate is held against the cameras, smoothed
//! with what came after.

mod figure;
mod run;
mod score;

use std::{
    fmt::Write as _,
    path::{Path, PathBuf},
};

use clap::Args;
use singletrack::progress::progress_bar;
use singletrack_core::Config;
use singletrack_figures::figure::Figure;
use singletrack_record::Reader;

use crate::{Format, Result, print};

pub use run::Stop;
pub use score::{Bends, Noise, Verdict};

use run::Log;

/// What of a record [`judge`] gives the pilot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Part {
    /// From this time on, in s from the first tick.
    pub from_s: f64,
    /// Up to this time, in s from the first tick.
    pub to_s: f64,
    /// So many poses a second; all poses without it.
    pub cameras_hz: Option<f64>,
}

/// All of a record.
pub const WHOLE: Part = Part {
    from_s: 0.0,
    to_s: f64::INFINITY,
    cameras_hz: None,
};

/// Options of `singletrack judge`.
#[derive(Clone, Debug, Args)]
pub struct JudgeArgs {
    /// A record of a drive, ours or imported.
    pub record: PathBuf,

    /// The car's configuration, as the daemon takes it [default: that of the record; an imported one
    /// has none].
    #[arg(long, value_name = "CAR.toml")]
    pub config: Option<PathBuf>,

    /// Judges from this time on, in s from the first tick.
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0)]
    pub from: f64,

    /// Judges up to this time, in s from the first tick [default: to the end].
    #[arg(long, value_name = "SECONDS")]
    pub to: Option<f64>,

    /// Gives the pilot so many poses a second, as slower cameras would; its errors are still those
    /// against all poses.
    #[arg(long, value_name = "HZ")]
    pub cameras_hz: Option<f64>,

    /// How to print the verdict.
    #[arg(long, value_enum, default_value_t = Format::Table)]
    pub format: Format,

    /// Where the page of figures goes [default: RECORD.judge.svg].
    #[arg(long, value_name = "FILE.svg")]
    pub figure: Option<PathBuf>,
}

/// Judges a part of a record with the configuration of a car. `progress` is told the tick, and how many
/// there are.
///
/// # Errors
///
/// What can't be read, and a record without poses, ticks or samples of the board.
pub fn judge(
    record: &Path,
    config: &Config,
    part: Part,
    mut progress: impl FnMut(usize, usize),
) -> Result<(Verdict, Figure)> {
    let log = Log::read(record, part)?;
    let name = record.display();
    let empty = |what| {
        format!(
            "{name}: the record has no {what}, and without them nothing can be judged; \
             `singletrack dump --stats` counts what it has"
        )
    };
    if log.ticks.is_empty() {
        let is_cut = [part.from_s, part.to_s] != [WHOLE.from_s, WHOLE.to_s];
        let what = match is_cut {
            true => "ticks between --from and --to",
            false => "ticks",
        };
        return Err(empty(what).into());
    }
    if log.ticks.iter().all(|tick| !tick.has_board()) {
        return Err(empty("samples of the board").into());
    }
    if log.frames.is_empty() {
        return Err(empty("frames of the cameras").into());
    }
    let pilot = config.pilot()?;
    let estimator = pilot.estimator;
    let limits = config.motion_capture.session()?.limits;
    let ticks = log.ticks.len();
    let run = run::run(&log, pilot, limits, |tick| progress(tick, ticks));
    let bends = Bends::of(&log, &run, config);
    Ok((Verdict::of(&log, &run, &estimator, bends), figure::of(&run)))
}

/// Judges a record, prints the verdict, and writes the figures.
///
/// # Errors
///
/// Those of [`judge`], and what can't be written.
pub fn run(args: &JudgeArgs) -> Result {
    let config = match &args.config {
        Some(path) => Config::read(path)?,
        None => recorded(&args.record)?,
    };
    let part = Part {
        from_s: args.from,
        to_s: args.to.unwrap_or(f64::INFINITY),
        cameras_hz: args.cameras_hz,
    };
    let bar = progress_bar(0, "{bar:30} {percent:>3} %  {pos} ticks judged");
    let result = judge(&args.record, &config, part, |tick, ticks| {
        if tick.is_multiple_of(500) {
            bar.set_length(ticks as u64);
            bar.set_position(tick as u64);
        }
    });
    bar.finish_and_clear();
    let (verdict, figure) = result?;
    let beside = || args.record.with_extension("judge.svg");
    let path = args.figure.clone().unwrap_or_else(beside);
    std::fs::write(&path, figure.to_svg()).map_err(|error| {
        let path = path.display();
        format!("can't write {path}: {error}; choose another --figure")
    })?;
    let told = match args.format {
        Format::Table => text(&verdict, &args.record, &path),
        Format::Json => serde_json::to_string(&verdict)? + "\n",
    };
    print(&told)
}

/// The configuration in a record.
fn recorded(record: &Path) -> Result<Config> {
    let toml = Reader::open(record)?.meta.configuration.clone();
    Config::from_toml(&toml).map_err(|error| {
        let name = record.display();
        format!(
            "{name}: its configuration is none of this version's ({error}); give one with --config"
        )
        .into()
    })
}

/// A value as its text says it, or a dash.
fn or_dash(value: Option<f64>, text: impl Fn(f64) -> String) -> String {
    value.map_or_else(|| "-".to_owned(), text)
}

/// The verdict for a person.
fn text(verdict: &Verdict, record: &Path, figure: &Path) -> String {
    let mut text = String::new();
    let number = |value| or_dash(value, |value| format!("{value:.4}"));
    // Writing to a string does not fail.
    let _ = writeln!(
        text,
        "{}: {:.1} s, {} poses, {} of the car refused",
        record.display(),
        verdict.duration_s,
        verdict.poses,
        verdict.rejected
    );
    for [from, to] in &verdict.ghosts_s {
        let _ = writeln!(text, "another body from {from:.2} s to {to:.2} s");
    }
    for time in &verdict.flips_s {
        let _ = writeln!(text, "flipped at {time:.2} s");
    }
    for time in &verdict.asked_s {
        let _ = writeln!(
            text,
            "at {time:.2} s the car is where it can't have come to: a person would be asked \
             (`singletrack disarm --carried` says that it is the car)"
        );
    }
    match verdict.watched_from_s {
        Some(from) if from > 0.05 => {
            let _ = writeln!(
                text,
                "watched from {from:.2} s on: before, not every sensor had been heard, or the estimate \
                 had not settled"
            );
        }
        Some(_) => {}
        None => {
            let _ = writeln!(
                text,
                "never watched: the estimate did not settle; `singletrack dump --stats` counts the poses"
            );
        }
    }
    if verdict.stops.is_empty() && verdict.watched_from_s.is_some() {
        let _ = writeln!(text, "nothing would have stopped the drive");
    }
    for stop in &verdict.stops {
        let _ = writeln!(text, "stop at {:.2} s: {}", stop.t_s, stop.reason);
    }
    let _ = writeln!(
        text,
        "innovations: NIS mean {} (3 is right; 2 to 6 is good)\n\
         against the smoothed cameras, above 0.5 m/s (root mean square):\n  \
         speed    {} m/s\n  yaw rate {} rad/s\n  sideslip {} rad (of {} rad), {} inside the stated 95 %\n\
         largest speed {:.2} m/s, gyro scale {}\n\
         noise                         measured  configured",
        number(verdict.nis_mean),
        number(verdict.speed_rms_m_s),
        number(verdict.yaw_rate_rms_rad_s),
        number(verdict.sideslip_rms_rad),
        number(verdict.true_sideslip_rms_rad),
        or_dash(verdict.sideslip_within_95, |share| format!(
            "{:.1} %",
            100.0 * share
        )),
        verdict.speed_max_m_s,
        or_dash(verdict.gyro_scale, |scale| format!("{scale:.3}")),
    );
    for noise in &verdict.noise {
        let _ = writeln!(
            text,
            "  {:<23} {:>12} {:>11.6} {}",
            noise.sensor,
            or_dash(noise.measured, |value| format!("{value:.6}")),
            noise.configured,
            noise.unit
        );
    }
    let _ = writeln!(
        text,
        "beside the cameras              slope  lag (ms)  correlation"
    );
    for sensor in &verdict.sensors {
        let _ = writeln!(
            text,
            "  {:<22} {:>12.3} {:>9.0} {:>12.3}",
            sensor.sensor,
            sensor.slope,
            1e3 * sensor.lag_s,
            sensor.correlation
        );
    }
    if let Some(bends) = &verdict.bends {
        let _ = writeln!(
            text,
            "bends otherwise than steered by {:.2} 1/m up to 2.45 m/s2 aside, and by {} 1/m more with each m/s2 \
             beyond (up to {:.1} m/s2):\n  safety_filter.curvature_error_per_m and \
             curvature_error_per_m_per_m_s2 have to be at least that",
            bends.curvature_error_per_m,
            or_dash(bends.curvature_error_per_m_per_m_s2, |growth| format!(
                "{growth:.2}"
            )),
            bends.lateral_m_s2
        );
    }
    for finding in &verdict.findings {
        let _ = writeln!(text, "{finding}");
    }
    let _ = writeln!(text, "not judged: {}", verdict.not_judged.join(", "));
    let _ = writeln!(text, "figures: {}", figure.display());
    text
}
