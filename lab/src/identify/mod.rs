//! `singletrack identify`: the car's parameters from its drives.

mod collect;
mod figures;
mod output;

use std::{
    fs,
    io::{self, Write as _},
    path::{Path, PathBuf},
    time::Duration,
};

use clap::{Parser, ValueEnum};
use indicatif::ProgressBar;
use singletrack_analysis::identification::{self, Parameter, Settings, Tyres};
use singletrack_control::SlipAngles;
use singletrack_core::Config;
use singletrack_figures::output::{WriteError, make_folder, write as write_file};

use crate::{Format, Result, print, vehicle_file};

pub use collect::Collector;
use collect::read;
pub use figures::figures;
pub use output::{Identified, LogScore, Report};

/// Options of `singletrack identify`.
#[derive(Clone, Debug, Parser)]
pub struct IdentifyArgs {
    /// The records of drives (*.mcap), a minute of weaving at 1.5 m/s or more; of several, one fit.
    #[arg(required = true)]
    pub record: Vec<PathBuf>,

    /// Another drive, to validate the identified parameters. May be given several times.
    #[arg(long, value_name = "RECORD")]
    pub validate: Vec<PathBuf>,

    /// The car's configuration [default: the one in each record].
    ///
    /// A record that was imported has none of its own car.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,

    /// The nominal car: mass, wheelbase, friction, and where the fit starts
    /// [default: the one in the configuration].
    #[arg(long, value_name = "FILE")]
    pub vehicle: Option<PathBuf>,

    /// Parameters to estimate: some of `c_f`, `c_r`, `i_z`, `l_f`, `friction` and `steering_gain`.
    ///
    /// Lag, delay and trim of the steering, and delay and bias of the IMU and the scale of its gyro are
    /// always estimated jointly.
    #[arg(
        long,
        value_name = "NAMES",
        value_delimiter = ',',
        default_value = "c_f,c_r,i_z"
    )]
    pub parameters: Vec<Parameter>,

    /// The tyres' force over their slip.
    #[arg(long, value_enum, default_value_t = TyreKind::Saturating)]
    pub tyres: TyreKind,

    /// The slip angles of the model: the paper's small ones, or exact ones, which a real car has.
    #[arg(long, value_enum, default_value_t = SlipAngleKind::Small)]
    pub slip_angles: SlipAngleKind,

    /// Which drive of each record, from 1 [default: the longest].
    #[arg(long, value_name = "N")]
    pub drive: Option<usize>,

    /// Leave out slower driving, in m/s: there the tyres hardly slip.
    #[arg(long, value_name = "SPEED", default_value_t = 0.5)]
    pub least_speed: f64,

    /// Folder for figures, identification.json and identified.toml, a vehicle file.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,

    /// How to print the result.
    #[arg(long, value_enum, default_value_t = Format::Table)]
    pub format: Format,

    /// Whether the nominal car is validated on the same drives.
    #[arg(skip)]
    pub validate_nominal: bool,
}

impl IdentifyArgs {
    /// The options of the command line with these records alone.
    pub(crate) fn of(record: Vec<PathBuf>, validate: Vec<PathBuf>) -> Self {
        Self {
            record,
            validate,
            ..Self::parse_from(["singletrack identify", "RECORD"])
        }
    }
}

/// The tyres' force over their slip.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum TyreKind {
    /// Linear for small slip, at most the friction's share of the load.
    Saturating,
    /// Linear throughout, as in the paper.
    Linear,
    /// Pacejka's magic formula with C = 1.3: beyond its peak the force falls.
    MagicFormula,
}

impl TyreKind {
    pub(crate) const fn tyres(self) -> Tyres {
        match self {
            Self::Saturating => Tyres::Saturating,
            Self::Linear => Tyres::Linear,
            Self::MagicFormula => Tyres::MagicFormula,
        }
    }
}

/// The slip angles of the model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum SlipAngleKind {
    /// sin x = x and cos x = 1, as in the paper.
    Small,
    /// Angles between the wheels and the velocities of the axles.
    Exact,
}

impl SlipAngleKind {
    pub(crate) const fn angles(self) -> SlipAngles {
        match self {
            Self::Small => SlipAngles::Small,
            Self::Exact => SlipAngles::Exact,
        }
    }
}

/// Identifies, prints and writes the result. Progress and warnings go to standard
/// error.
///
/// # Errors
///
/// When a record can't be used, or a file can't be written.
pub fn run(args: &IdentifyArgs) -> Result {
    if let Some(folder) = &args.out {
        prepare(folder)?;
    }
    let report = identify(args)?;
    for warning in &report.identified.identification.warnings {
        print_note(&format!("warning: {warning}"));
    }
    for validated in &report.validated {
        let logs = validated
            .logs
            .iter()
            .map(|log| log.path.display().to_string());
        let logs = logs.collect::<Vec<_>>().join(", ");
        for warning in &validated.identification.warnings {
            print_note(&format!("warning: validation on {logs}: {warning}"));
        }
    }
    for error in &report.not_validated {
        print_note(&format!("warning: not validated: {error}"));
    }
    let text = match args.format {
        Format::Table => output::table(&report),
        Format::Json => output::json(&report),
    };
    print(&text)?;
    if let Some(folder) = &args.out {
        for path in write(&report, folder)? {
            print_note(&format!("wrote {}", path.display()));
        }
    }
    Ok(())
}

/// Identifies without printing anything but progress.
///
/// # Errors
///
/// As [`run`].
pub fn identify(args: &IdentifyArgs) -> Result<Report> {
    if !(0.0..=100.0).contains(&args.least_speed) {
        let speed = args.least_speed;
        return Err(format!("--least-speed is {speed}: it must be between 0 and 100 m/s").into());
    }
    let given = args
        .vehicle
        .as_deref()
        .map(vehicle_file::read)
        .transpose()?;
    let config = args.config.as_deref().map(Config::read).transpose()?;
    let mut given_before = Vec::new();
    for path in args.record.iter().chain(&args.validate) {
        // The same file by another name is the same.
        let file = path.canonicalize().unwrap_or_else(|_| path.clone());
        if given_before.contains(&file) {
            let path = path.display();
            return Err(format!(
                "{path} is given twice: a drive that is counted twice makes the intervals too narrow, \
                 and one that is fitted does not validate"
            )
            .into());
        }
        given_before.push(file);
    }
    let read_all = |paths: &[PathBuf], number| {
        let drives = paths.iter();
        let note = |record: &Path, text: &str| print_note(&format!("{}: {text}", record.display()));
        let drives = drives.map(|path| read(path, number, config.as_ref(), note));
        drives.collect::<Result<Vec<_>>>()
    };
    let mut recorded = read_all(&args.record, args.drive)?.into_iter();
    let mut drives = recorded.next().ok_or("give the record of a drive")?;
    recorded.for_each(|other| drives.push(other));
    let vehicle = given.unwrap_or(drives.vehicle);
    let settings = Settings {
        tyres: args.tyres.tyres(),
        slip_angles: args.slip_angles.angles(),
        steering: drives.steering,
        least_speed: args.least_speed,
        frames: drives.frames,
        ..Settings::of(&args.parameters)
    };
    let validation = read_all(&args.validate, None)?;

    let names = args.record.iter().map(|path| path.display().to_string());
    let wait = wait(format!(
        "identifying from {}",
        names.collect::<Vec<_>>().join(", ")
    ));
    let identification = identification::identify(&drives.data, &vehicle, &settings)
        .map_err(|error| drives.failed(&error))?;
    wait.finish_and_clear();
    let nominal = args
        .validate_nominal
        .then(|| identification.with_vehicle(&vehicle));
    let (mut validated, mut not_validated) = (Vec::new(), Vec::new());
    let mut nominal_validated = Vec::new();
    for other in validation {
        let settings = Settings {
            frames: other.frames,
            ..settings.clone()
        };
        if let Some(nominal) = &nominal {
            match identification::validate(&other.data, nominal, &settings) {
                Ok(found) => nominal_validated.push(other.clone().identified(found)),
                Err(error) => not_validated.push(other.failed(&error)),
            }
        }
        match identification::validate(&other.data, &identification, &settings) {
            Ok(found) => validated.push(other.identified(found)),
            // What was identified stands.
            Err(error) => not_validated.push(other.failed(&error)),
        }
    }
    Ok(Report {
        vehicle,
        tyres: settings.tyres,
        identified: drives.identified(identification),
        validated,
        nominal_validated,
        not_validated,
    })
}

/// Checks, before anything is computed, that `folder` can be written to and has no
/// vehicle file of the user's that would be lost.
fn prepare(folder: &Path) -> Result {
    make_folder(folder)?;
    tempfile::tempfile_in(folder).map_err(WriteError::of(folder))?;
    let vehicle = folder.join(VEHICLE_FILE);
    match fs::read(&vehicle) {
        Ok(text) if !text.starts_with(output::VEHICLE_FILE_BEGINS.as_bytes()) => {
            let vehicle = vehicle.display();
            Err(format!(
                "{vehicle} is not of an earlier identification; choose another folder with --out, or \
                 rename it"
            )
            .into())
        }
        _ => Ok(()),
    }
}

/// The vehicle file that is written.
const VEHICLE_FILE: &str = "identified.toml";

/// Writes figures and files into `folder`, and returns their paths.
///
/// # Errors
///
/// When one can't be written.
pub fn write(report: &Report, folder: &Path) -> Result<Vec<PathBuf>> {
    make_folder(folder)?;
    // Figures of validations that this one does not have.
    if folder.join("identification.json").exists() {
        for entry in fs::read_dir(folder)
            .map_err(WriteError::of(folder))?
            .flatten()
        {
            let name = entry.file_name().to_string_lossy().into_owned();
            let ours = ["inputs.svg", "states.svg"]
                .iter()
                .any(|end| name.ends_with(end));
            if name.starts_with("validation-") && ours {
                fs::remove_file(entry.path()).map_err(WriteError::of(&entry.path()))?;
            }
        }
    }
    let mut files = vec![
        (VEHICLE_FILE.to_owned(), output::vehicle_file(report)?),
        ("identification.json".to_owned(), output::json(report)),
    ];
    files.extend(
        figures::figures(report)
            .into_iter()
            .map(|(name, figure)| (format!("{name}.svg"), figure.to_svg())),
    );
    let mut paths = Vec::new();
    for (name, text) in files {
        let path = folder.join(name);
        write_file(&path, &text)?;
        paths.push(path);
    }
    Ok(paths)
}

/// Prints a line on standard error, which may be closed.
fn print_note(what: &str) {
    let _ = writeln!(io::stderr().lock(), "singletrack: {what}");
}

/// Hidden when standard error is no terminal.
fn wait(what: String) -> ProgressBar {
    let bar = ProgressBar::new_spinner().with_message(what);
    bar.enable_steady_tick(Duration::from_millis(100));
    bar
}
