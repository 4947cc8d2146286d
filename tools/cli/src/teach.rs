//! `singletrack teach`: records the path that the car is pushed along as a reference.

use std::{
    error::Error,
    fs::{self, File},
    io::{self, IsTerminal as _, Write as _},
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::Duration,
};

use clap::Args;
use singletrack_api::{Connection, Reply, State};
use singletrack_commissioning::{Place, TeachOptions, taught_path};
use singletrack_control::{Path as SmoothPath, PathSpeed, Position};
use singletrack_core::Config;

use crate::{
    control::{self, ControlArgs, ControlError},
    interrupt::Interrupt,
};

/// What to record, and where to.
#[derive(Clone, Debug, Args)]
#[command(after_help = "\
Push the car forward along the path, with your hands beside its markers, and press Enter (or \
Ctrl-C) at its end. FILE.csv and FILE.toml are written: `singletrack set-reference FILE.toml` \
and `singletrack arm` drive the path. When the car is pushed for more than a metre, the board \
assumes that it drives by itself and latches: press its reset button before you arm.")]
pub struct TeachArgs {
    /// Where the points go: a new file FILE.csv; the reference goes to FILE.toml beside it
    #[arg(value_name = "FILE.csv")]
    file: PathBuf,
    /// The daemon's configuration: where P is on the car
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    /// The path leads back to its start and goes round and round
    #[arg(long)]
    closed: bool,
    /// Highest speed on the path, in m/s
    #[arg(long, value_name = "M_S", default_value_t = 0.4)]
    speed: f64,
    /// Distance between the points, in m
    #[arg(long, value_name = "M", default_value_t = 0.1)]
    spacing: f64,
    #[command(flatten)]
    control: ControlArgs,
}

/// A file that can't be written, or would be replaced.
fn not_written(path: &Path, source: &io::Error) -> String {
    format!("can't write {}: {source}", path.display())
}

/// Interval at which Ctrl-C is looked for.
const POLL: Duration = Duration::from_millis(50);

/// Records the path until Enter or Ctrl-C is pressed, and writes it.
///
/// # Errors
///
/// When there is no path, or it can't be written.
pub fn run(args: &TeachArgs) -> Result<(), Box<dyn Error>> {
    let table = reference_file(&args.file)?;
    let (speed, spacing) = (args.speed, args.spacing);
    let (is_speed, is_spacing) = (
        speed > 0.0 && speed <= 20.0,
        (0.02..=1.0).contains(&spacing),
    );
    for (name, value, range, is_good) in [
        ("speed", speed, "above 0, to 20", is_speed),
        ("spacing", spacing, "0.02 to 1", is_spacing),
    ] {
        if !is_good {
            return Err(format!("--{name} is {value}: give {range}").into());
        }
    }
    for path in [&args.file, &table] {
        if path.exists() {
            return Err(not_written(path, &io::ErrorKind::AlreadyExists.into()).into());
        }
    }
    let config = Config::read(&args.config)?;
    let options = TeachOptions {
        front_axle_distance_m: config.vehicle.front_axle_distance_m,
        point_distance_m: config.law.point_distance_m,
        is_closed: args.closed,
        spacing_m: spacing,
    };
    let taught = taught_path(&watch(args)?, &options)?;
    let limits = PathSpeed {
        speed: args.speed,
        lateral_acceleration: LATERAL_M_S2,
        acceleration: ACCELERATION_M_S2,
    };
    let path = SmoothPath::new(&taught.points, args.closed, limits)
        .map_err(|error| format!("the path can't be driven: {error}"))?;
    write_new(&args.file, &points_csv(&taught.points))?;
    write_new(&table, &reference_toml(&args.file, args))?;
    let gap = if args.closed {
        format!(", its ends {:.0} mm apart", 1_000.0 * taught.gap_m)
    } else {
        String::new()
    };
    Ok(control::print(&format!(
        "{} points along {:.2} m{gap}, smoothed by {:.1} mm: {:.1} s at up to {} m/s\n\
         drive it: singletrack set-reference {} && singletrack arm",
        taught.points.len(),
        taught.length_m,
        1_000.0 * taught.roughness_m,
        path.lap_time(),
        args.speed,
        table.display(),
    ))?)
}

/// As the configuration has by default.
const LATERAL_M_S2: f64 = 1.0;
const ACCELERATION_M_S2: f64 = 0.5;

/// The file for the table `[reference]`, beside that of the points.
fn reference_file(points: &Path) -> Result<PathBuf, String> {
    let is_csv = points.extension().is_some_and(|end| end == "csv");
    if is_csv && points.file_stem().is_some() {
        Ok(points.with_extension("toml"))
    } else {
        let name = points.display();
        Err(format!("{name}: give a name that ends in .csv"))
    }
}

/// The places of the car until the operator ends it.
fn watch(args: &TeachArgs) -> Result<Vec<Place>, ControlError> {
    let interrupt = Interrupt::listen()?;
    let mut states = Connection::watch_states(&args.control.socket, POLL)?;
    let is_at_end = Arc::new(AtomicBool::new(false));
    let enter = Arc::clone(&is_at_end);
    // It is not waited for: it ends with the process.
    thread::spawn(move || {
        let mut line = String::new();
        if matches!(io::stdin().read_line(&mut line), Ok(count) if count > 0) {
            enter.store(true, Ordering::Relaxed);
        }
    });
    let is_terminal = io::stderr().is_terminal();
    if is_terminal {
        eprintln!("push the car along the path; press Enter at its end");
    }
    let mut places: Vec<Place> = Vec::new();
    let mut shown = 0_usize;
    while !interrupt.is_raised() && !is_at_end.load(Ordering::Relaxed) {
        match states.receive_within(POLL)? {
            Some(Reply::State(state)) => places.extend(place(&state)),
            Some(Reply::Answer(answer)) => drop(answer.agreed()?),
            _ => {}
        }
        if is_terminal && places.len() >= shown + 20 {
            shown = places.len();
            if let Some(last) = places.last() {
                let _ = write!(
                    io::stderr(),
                    "\r\x1b[K({:.2}, {:.2}) m",
                    last.position.x,
                    last.position.y
                );
            }
        }
    }
    if is_terminal {
        let _ = write!(io::stderr(), "\r\x1b[K");
    }
    Ok(places)
}

/// The place of a tick whose estimate has a new pose.
fn place(state: &State) -> Option<Place> {
    if state.held {
        return None;
    }
    Some(Place {
        position: Position::new(state.x?, state.y?),
        yaw: state.yaw?,
    })
}

/// The points as a file for `reference.kind = "path"`.
#[must_use]
pub fn points_csv(points: &[Position]) -> String {
    let rows = points
        .iter()
        .map(|point| format!("{:.4},{:.4}\n", point.x, point.y));
    "x_m,y_m\n".to_owned() + &rows.collect::<String>()
}

fn reference_toml(points: &Path, args: &TeachArgs) -> String {
    let name = points.file_name().unwrap_or_default().to_string_lossy();
    format!(
        "# Taught by pushing the car.\n[reference]\nkind = \"path\"\nfile = {}\nclosed = {}\n\
         speed_m_s = {}\nlateral_acceleration_m_s2 = {LATERAL_M_S2:?}\n\
         acceleration_m_s2 = {ACCELERATION_M_S2:?}\n",
        toml::Value::String(name.into_owned()),
        args.closed,
        toml::Value::Float(args.speed),
    )
}

/// Writes a file that is not there yet, whole or not at all.
fn write_new(path: &Path, text: &str) -> Result<(), String> {
    let write = || {
        let mut file = File::create_new(path)?;
        let written = file
            .write_all(text.as_bytes())
            .and_then(|()| file.sync_all());
        if written.is_err() {
            let _ = fs::remove_file(path);
        }
        written
    };
    write().map_err(|source| not_written(path, &source))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_is_that_of_an_estimate_with_a_new_pose() {
        let mut state: State = serde_json::from_str(
            r#"{"topic":"state","tick":1,"t":0.01,"time_ns":1,"mode":"idle","x":0.25,"y":-0.5,
                "yaw":0.3,"held":false,"steering":0,"commanded_speed":0,"filtering":"none"}"#,
        )
        .unwrap();
        let seen = Place {
            position: Position::new(0.25, -0.5),
            yaw: 0.3,
        };
        assert_eq!(place(&state), Some(seen));
        state.held = true;
        assert_eq!(place(&state), None);
        state.held = false;
        state.x = None;
        assert_eq!(place(&state), None);
    }
}
