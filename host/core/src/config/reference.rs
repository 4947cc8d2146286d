//! `[reference]`: where P should be, and the files of waypoints or of points of a path as CSV.
//!
//! Errors quote nothing of a file of points: they also reach clients of the control socket, who may not
//! be allowed to read it.

use std::{
    borrow::Cow,
    fs::OpenOptions,
    io::{self, Read as _},
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize};
use singletrack_control::{
    Circle, External, FigureOfEight, Path as SmoothPath, PathSpeed, Position, Reference, Start,
    Velocity, VelocityStep, VelocitySteps, Waypoint, Waypoints, words,
};
use singletrack_settings::{Written, check_kind, seconds, section};

use super::ConfigError;

/// The reference of P.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", try_from = "ReferenceKeys")]
pub enum ReferenceSection {
    /// See [`Circle`].
    Circle {
        /// Radius, in m.
        radius_m: f64,
        /// Angular velocity, in rad/s.
        angular_velocity_rad_s: f64,
        /// Centre, in m.
        centre_m: [f64; 2],
        /// Where a drive begins on it.
        start: Start,
    },
    /// See [`VelocitySteps`].
    VelocitySteps {
        /// The steps, in order.
        steps: Vec<StepSection>,
    },
    /// See [`FigureOfEight`].
    FigureOfEight {
        /// Reach along x, in m.
        half_length_m: f64,
        /// Reach along y, in m.
        half_width_m: f64,
        /// 2π over the time for one figure, in rad/s.
        angular_velocity_rad_s: f64,
        /// Centre, in m.
        centre_m: [f64; 2],
        /// Where a drive begins on it.
        start: Start,
    },
    /// See [`Waypoints`](singletrack_control::Waypoints).
    Waypoints {
        /// CSV file with the columns `t_s,x_m,y_m`; relative to the file that
        /// names it.
        file: PathBuf,
    },
    /// Way-points that are written out: what a record holds.
    #[serde(rename = "waypoints")]
    WaypointList {
        /// In order of time.
        waypoints: Vec<WaypointSection>,
    },
    /// See [`Path`](singletrack_control::Path).
    Path {
        /// Where it leads.
        #[serde(flatten)]
        points: PathPoints,
        /// Whether the path leads from its last point back to the first.
        closed: bool,
        /// Where a drive begins on a closed one.
        start: Start,
        /// Highest speed, in m/s.
        speed_m_s: f64,
        /// Highest lateral acceleration, in m/s².
        lateral_acceleration_m_s2: f64,
        /// Highest acceleration and deceleration along the path, in m/s².
        acceleration_m_s2: f64,
    },
    /// See [`External`]: set-points from the control socket.
    External {
        /// The car stops when the last set-point is older.
        setpoint_timeout_ms: u32,
    },
}

/// The points of a path.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum PathPoints {
    /// CSV file with the columns `x_m,y_m`; relative to the file that names it.
    File(PathBuf),
    /// In m, in order: what a record holds.
    Points(Vec<[f64; 2]>),
}

/// One velocity step.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StepSection {
    /// How long it lasts, in s.
    pub duration_s: f64,
    /// Velocity of P along x, in m/s.
    pub v_x_m_s: f64,
    /// Velocity of P along y, in m/s.
    pub v_y_m_s: f64,
}

/// One waypoint.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WaypointSection {
    /// When P should be there, in s from the start of the drive.
    pub t_s: f64,
    /// Where, in m.
    pub x_m: f64,
    /// Where, in m.
    pub y_m: f64,
}

/// How long a set-point is in force by default.
const SETPOINT_TIMEOUT_MS: u32 = 200;

/// The limits of a path by default: half of what the paper's car may do at most.
const PATH_LATERAL_M_S2: f64 = 1.0;
const PATH_ACCELERATION_M_S2: f64 = 0.5;

section! {
    /// Where P should be, from the moment that the car drives. The section has the keys of its
    /// kind, and no others.
    "reference" => pub(super) ReferenceKeys;
    [];

    /// The kind of reference.
    kind: ReferenceKind, words ReferenceKind;
    /// Circle: radius.
    radius_m: Option<f64> = None, in -1_000.0..=1_000.0;
    /// Figure of eight: reach along x.
    half_length_m: Option<f64> = None, in -1_000.0..=1_000.0;
    /// Figure of eight: reach along y.
    half_width_m: Option<f64> = None, in -1_000.0..=1_000.0;
    /// Circle: angular velocity, negative for clockwise. Figure of eight: 2π over the time
    /// for one figure.
    angular_velocity_rad_s: Option<f64> = None, in -100.0..=100.0;
    /// Circle and figure of eight: centre.
    centre_m: Option<[f64; 2]> = None, in -1_000.0..=1_000.0, otherwise [0.0; 2];
    /// Circle, figure of eight and closed path: a drive begins at the place "nearest" to P on a
    /// branch that leads where the car looks, or at the "beginning". Others begin at their
    /// beginning.
    start: Option<Start> = None, words Start, otherwise Start::Nearest;
    /// Velocity steps, in order, each with `duration_s`, `v_x_m_s` and `v_y_m_s`.
    steps: Option<Vec<StepSection>> = None;
    /// Waypoints: CSV file with the columns `t_s,x_m,y_m`; its path is relative to the
    /// configuration file. `waypoints` may take its place. Path: the columns are `x_m,y_m`, and
    /// `points` may take its place.
    file: Option<PathBuf> = None;
    /// Waypoints in the place of a file, each with `t_s`, `x_m` and `y_m`, in order of time.
    waypoints: Option<Vec<WaypointSection>> = None;
    /// Path: points in the place of a file.
    points: Option<Vec<[f64; 2]>> = None, in -1_000.0..=1_000.0;
    /// Path: it leads from its last point back to the first, and goes on.
    closed: Option<bool> = None, otherwise false;
    /// Path: highest speed; at most `limits.max_speed_m_s`.
    speed_m_s: Option<f64> = None, in up_to(20.0);
    /// Path: highest lateral acceleration; at most `limits.max_lateral_acceleration_m_s2`.
    lateral_acceleration_m_s2: Option<f64> = None, in up_to(50.0), otherwise PATH_LATERAL_M_S2;
    /// Path: highest acceleration and deceleration; at most `limits.max_acceleration_m_s2`.
    acceleration_m_s2: Option<f64> = None, in up_to(50.0), otherwise PATH_ACCELERATION_M_S2;
    // A longer time-out is no deadman's switch.
    /// External set-points: the car stops when the last one is older.
    setpoint_timeout_ms: Option<u32> = None, in 20..=1_000, otherwise SETPOINT_TIMEOUT_MS;
}

words! {
    /// The kinds of reference.
    pub(super) enum ReferenceKind: serde {
        /// See [`Circle`].
        Circle = "circle",
        /// See [`VelocitySteps`].
        VelocitySteps = "velocity-steps",
        /// See [`FigureOfEight`].
        FigureOfEight = "figure-of-eight",
        /// See [`Waypoints`].
        Waypoints = "waypoints",
        /// See [`Path`](SmoothPath).
        Path = "path",
        /// See [`External`].
        External = "external",
    }
}

impl TryFrom<ReferenceKeys> for ReferenceSection {
    type Error = String;

    /// Takes the keys that the kind has, and refuses the others.
    fn try_from(keys: ReferenceKeys) -> Result<Self, String> {
        let written = Written::of(&keys)?;
        let angular_velocity_rad_s =
            || written.need("angular_velocity_rad_s", keys.angular_velocity_rad_s);
        let centre_m = keys.centre_m.unwrap_or_default();
        let start = keys.start.unwrap_or(Start::Nearest);
        let reference = match keys.kind {
            ReferenceKind::Circle => Self::Circle {
                radius_m: written.need("radius_m", keys.radius_m)?,
                angular_velocity_rad_s: angular_velocity_rad_s()?,
                centre_m,
                start,
            },
            ReferenceKind::VelocitySteps => Self::VelocitySteps {
                steps: written.need("steps", keys.steps)?,
            },
            ReferenceKind::FigureOfEight => Self::FigureOfEight {
                half_length_m: written.need("half_length_m", keys.half_length_m)?,
                half_width_m: written.need("half_width_m", keys.half_width_m)?,
                angular_velocity_rad_s: angular_velocity_rad_s()?,
                centre_m,
                start,
            },
            ReferenceKind::Waypoints => match keys.waypoints {
                Some(waypoints) => Self::WaypointList { waypoints },
                None => Self::Waypoints {
                    file: written.need("file", keys.file)?,
                },
            },
            ReferenceKind::Path => {
                let speed_m_s = written.need("speed_m_s", keys.speed_m_s)?;
                let closed = keys.closed.unwrap_or_default();
                if !closed && keys.start == Some(Start::Nearest) {
                    return Err("reference.start is nearest: an open path begins at its \
                                beginning; remove the key, or set closed = true"
                        .to_owned());
                }
                Self::Path {
                    points: match keys.points {
                        Some(points) => PathPoints::Points(points),
                        None => PathPoints::File(written.need("file", keys.file)?),
                    },
                    closed,
                    start: if closed { start } else { Start::Beginning },
                    speed_m_s,
                    lateral_acceleration_m_s2: keys
                        .lateral_acceleration_m_s2
                        .unwrap_or(PATH_LATERAL_M_S2),
                    acceleration_m_s2: keys.acceleration_m_s2.unwrap_or(PATH_ACCELERATION_M_S2),
                }
            }
            ReferenceKind::External => Self::External {
                setpoint_timeout_ms: keys.setpoint_timeout_ms.unwrap_or(SETPOINT_TIMEOUT_MS),
            },
        };
        written.only_of::<ReferenceKeys>(&reference)?;
        Ok(reference)
    }
}

impl ReferenceSection {
    /// Finds the file of waypoints or points from `folder` if its path is relative.
    pub fn resolve(&mut self, folder: &Path) {
        if let Self::Waypoints { file }
        | Self::Path {
            points: PathPoints::File(file),
            ..
        } = self
        {
            *file = folder.join(&*file);
        }
    }

    /// The file that the reference names.
    pub fn file(&self) -> Option<&Path> {
        match self {
            Self::Waypoints { file }
            | Self::Path {
                points: PathPoints::File(file),
                ..
            } => Some(file),
            _ => None,
        }
    }

    /// Where a drive begins on the reference.
    pub const fn start(&self) -> Start {
        match self {
            Self::Circle { start, .. }
            | Self::FigureOfEight { start, .. }
            | Self::Path { start, .. } => *start,
            _ => Start::Beginning,
        }
    }

    /// The reference with nothing left in other files: those may change.
    ///
    /// # Errors
    ///
    /// Waypoints that can't be read.
    pub fn with_points_inlined(&self) -> Result<Self, ConfigError> {
        let mut inlined = self.clone();
        match &mut inlined {
            Self::Waypoints { file } => {
                let waypoints = waypoints_of(file)?;
                let written_out = |waypoint: &Waypoint| WaypointSection {
                    t_s: waypoint.time,
                    x_m: waypoint.position.x,
                    y_m: waypoint.position.y,
                };
                inlined = Self::WaypointList {
                    waypoints: waypoints.points().iter().map(written_out).collect(),
                };
            }
            Self::Path { points, .. } => *points = PathPoints::Points(points.read()?.into_owned()),
            _ => {}
        }
        Ok(inlined)
    }

    /// The reference, with waypoints read from their file.
    ///
    /// # Errors
    ///
    /// An invalid reference, or waypoints that can't be read.
    pub fn reference(&self) -> Result<Reference, ConfigError> {
        // So that its points and velocities are finite.
        check_kind::<ReferenceKeys>(self)?;
        Ok(match self {
            Self::Circle {
                radius_m,
                angular_velocity_rad_s,
                centre_m,
                ..
            } => {
                let centre = Position::from(*centre_m);
                Reference::Circle(Circle::new(centre, *radius_m, *angular_velocity_rad_s)?)
            }
            Self::VelocitySteps { steps } => {
                let steps = steps.iter().map(|step| VelocityStep {
                    duration: step.duration_s,
                    velocity: Velocity::new(step.v_x_m_s, step.v_y_m_s),
                });
                Reference::VelocitySteps(VelocitySteps::new(&steps.collect::<Vec<_>>())?)
            }
            Self::FigureOfEight {
                half_length_m,
                half_width_m,
                angular_velocity_rad_s,
                centre_m,
                ..
            } => Reference::FigureOfEight(FigureOfEight::new(
                Position::from(*centre_m),
                *half_length_m,
                *half_width_m,
                *angular_velocity_rad_s,
            )?),
            Self::Waypoints { file } => Reference::Waypoints(waypoints_of(file)?),
            Self::WaypointList { waypoints } => {
                let waypoints = waypoints.iter().map(|waypoint| Waypoint {
                    time: waypoint.t_s,
                    position: Position::new(waypoint.x_m, waypoint.y_m),
                });
                Reference::Waypoints(Waypoints::new(&waypoints.collect::<Vec<_>>())?)
            }
            Self::Path {
                points,
                closed,
                speed_m_s,
                lateral_acceleration_m_s2,
                acceleration_m_s2,
                ..
            } => {
                let points = points.read()?;
                let points: Vec<_> = points.iter().copied().map(Position::from).collect();
                let limits = PathSpeed {
                    speed: *speed_m_s,
                    lateral_acceleration: *lateral_acceleration_m_s2,
                    acceleration: *acceleration_m_s2,
                };
                Reference::Path(SmoothPath::new(&points, *closed, limits)?)
            }
            Self::External {
                setpoint_timeout_ms,
            } => Reference::External(External::new(seconds(*setpoint_timeout_ms))?),
        })
    }
}

impl PathPoints {
    fn read(&self) -> Result<Cow<'_, [[f64; 2]]>, ConfigError> {
        match self {
            Self::Points(points) => Ok(points.into()),
            Self::File(file) => Ok(refused_in(file, read_points(file))?.into()),
        }
    }
}

fn waypoints_of(file: &Path) -> Result<Waypoints, ConfigError> {
    refused_in(file, read_waypoints(file))
}

/// What was read from a file of waypoints or points, or why it is refused.
fn refused_in<T>(file: &Path, read: Result<T, String>) -> Result<T, ConfigError> {
    read.map_err(|why| ConfigError::Text(format!("reference.file: {}: {why}", file.display())))
}

/// Longer than every valid configuration and every valid list of waypoints.
const LONGEST: u64 = 1 << 20;

/// The text of a file.
///
/// # Errors
///
/// The system's error; or the file is not a regular file, is too long, or is not UTF-8, each
/// with a fix.
pub(super) fn read_text(path: &Path) -> io::Result<String> {
    let mut options = OpenOptions::new();
    // Non-blocking: opening a pipe without a writer would wait for ever.
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::custom_flags(&mut options, libc::O_NONBLOCK);
    let file = options.read(true).open(path)?;
    let metadata = file.metadata()?;
    if !metadata.is_file() {
        let kind = if metadata.is_dir() {
            "a folder"
        } else {
            "a pipe, a socket or a device"
        };
        return Err(io::Error::other(format!("it is {kind}; name a file")));
    }
    let mut bytes = Vec::new();
    // A regular file may still have no end, as in /proc.
    file.take(LONGEST + 1).read_to_end(&mut bytes)?;
    let length = metadata.len().max(bytes.len() as u64);
    if length > LONGEST {
        return Err(io::Error::other(format!(
            "it is {length} bytes long; at most {LONGEST} are read, is it the right file?"
        )));
    }
    String::from_utf8(bytes).map_err(|error| {
        let good = error.utf8_error().valid_up_to();
        let before = error.as_bytes().get(..good).unwrap_or_default();
        let line = 1 + before.iter().filter(|&&byte| byte == b'\n').count();
        io::Error::other(format!("line {line} is not UTF-8; save the file as UTF-8"))
    })
}

/// The waypoints of a file, or why it is refused.
fn read_waypoints(path: &Path) -> Result<Waypoints, String> {
    let rows = read_rows(path, ["t_s", "x_m", "y_m"])?;
    for ((_, [before, ..]), (line, [time, ..])) in rows.iter().zip(rows.iter().skip(1)) {
        if time <= before {
            return Err(format!(
                "line {line}: t_s is {time}, not after {before} of the waypoint before; put the \
                 lines in order of time"
            ));
        }
    }
    let waypoints = rows.into_iter().map(|(_, [time, x, y])| Waypoint {
        time,
        position: Position::new(x, y),
    });
    Waypoints::new(&waypoints.collect::<Vec<_>>())
        .map_err(|error| format!("{error}; write one waypoint a line"))
}

/// The points of a file, in m, or why it is refused.
fn read_points(path: &Path) -> Result<Vec<[f64; 2]>, String> {
    let rows = read_rows(path, ["x_m", "y_m"])?;
    Ok(rows.into_iter().map(|(_, point)| point).collect())
}

/// The rows of a file with these columns, and no others, in any order: the line's number, and the
/// numbers in the order of `columns`.
fn read_rows<const COLUMNS: usize>(
    path: &Path,
    columns: [&'static str; COLUMNS],
) -> Result<Vec<(u64, [f64; COLUMNS])>, String> {
    let no_csv =
        |error: csv::Error| format!("{error}; write one number for each column, such as 1.5,-0.5");
    let text = read_text(path).map_err(|error| error.to_string())?;
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let header = reader.headers().map_err(no_csv)?;
    let places: Vec<usize> = columns
        .iter()
        .filter_map(|name| header.iter().position(|column| column.trim() == *name))
        .collect();
    if header.len() != COLUMNS || places.len() != COLUMNS {
        let columns = columns.join(",");
        return Err(format!(
            "line 1 must name the columns {columns}, and no others"
        ));
    }
    let mut rows = Vec::new();
    for record in reader.records() {
        let record = record.map_err(no_csv)?;
        let line = record.position().map_or(0, csv::Position::line);
        let mut row = [0.0; COLUMNS];
        for ((number, column), place) in row.iter_mut().zip(columns).zip(&places) {
            let value = record.get(*place).unwrap_or_default().trim();
            let finite = value.parse().ok().filter(|number: &f64| number.is_finite());
            *number = finite.ok_or_else(|| {
                format!("line {line}: {column} is no finite number; write one, as 0.5")
            })?;
        }
        rows.push((line, row));
    }
    Ok(rows)
}
