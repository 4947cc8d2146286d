//! `[reference]`: where P should be.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Deserializer, Serialize, de};
use singletrack_control::{
    Circle, External, FigureOfEight, Position, Reference, Velocity, VelocityStep, VelocitySteps,
    Waypoint, Waypoints,
};

use super::{ConfigError, check, kind::Keys, waypoint_file::read_waypoints};

/// The reference of P.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum ReferenceSection {
    /// See [`Circle`].
    Circle {
        /// Radius, in m.
        radius_m: f64,
        /// Angular velocity, in rad/s.
        angular_velocity_rad_s: f64,
        /// Centre, in m.
        centre_m: [f64; 2],
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
    },
    /// See [`Waypoints`](singletrack_control::Waypoints).
    Waypoints {
        /// CSV file with the columns `t_s,x_m,y_m`; relative to the file that
        /// names it.
        file: PathBuf,
    },
    /// The same, written out: what a record holds.
    #[serde(rename = "waypoints")]
    WaypointList {
        /// In order of time.
        waypoints: Vec<WaypointSection>,
    },
    /// See [`External`]: set-points from the control socket.
    External {
        /// The car stops when the last set-point is older.
        setpoint_timeout_ms: u32,
    },
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

/// How long a set-point is in force unless told otherwise.
const SETPOINT_TIMEOUT_MS: u32 = 200;

/// The largest coordinate and the fastest turn of a curve.
const FARTHEST_M: f64 = 1_000.0;
const FASTEST_RAD_S: f64 = 100.0;

/// The keys of all kinds.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Section {
    kind: Kind,
    radius_m: Option<f64>,
    half_length_m: Option<f64>,
    half_width_m: Option<f64>,
    angular_velocity_rad_s: Option<f64>,
    centre_m: Option<[f64; 2]>,
    steps: Option<Vec<StepSection>>,
    file: Option<PathBuf>,
    waypoints: Option<Vec<WaypointSection>>,
    setpoint_timeout_ms: Option<u32>,
}

#[derive(Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Kind {
    Circle,
    VelocitySteps,
    FigureOfEight,
    Waypoints,
    External,
}

impl<'de> Deserialize<'de> for ReferenceSection {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Section::deserialize(deserializer)?
            .try_into()
            .map_err(de::Error::custom)
    }
}

impl TryFrom<Section> for ReferenceSection {
    type Error = String;

    /// Takes the keys that the kind has; what remains it has not.
    fn try_from(mut section: Section) -> Result<Self, String> {
        let keys = Keys {
            section: "reference",
            kind: match section.kind {
                Kind::Circle => "circle",
                Kind::VelocitySteps => "velocity-steps",
                Kind::FigureOfEight => "figure-of-eight",
                Kind::Waypoints => "waypoints",
                Kind::External => "external",
            },
        };
        let reference = match section.kind {
            Kind::Circle => Self::Circle {
                radius_m: keys.need("radius_m", section.radius_m.take())?,
                angular_velocity_rad_s: keys.need(
                    "angular_velocity_rad_s",
                    section.angular_velocity_rad_s.take(),
                )?,
                centre_m: section.centre_m.take().unwrap_or_default(),
            },
            Kind::VelocitySteps => Self::VelocitySteps {
                steps: keys.need("steps", section.steps.take())?,
            },
            Kind::FigureOfEight => Self::FigureOfEight {
                half_length_m: keys.need("half_length_m", section.half_length_m.take())?,
                half_width_m: keys.need("half_width_m", section.half_width_m.take())?,
                angular_velocity_rad_s: keys.need(
                    "angular_velocity_rad_s",
                    section.angular_velocity_rad_s.take(),
                )?,
                centre_m: section.centre_m.take().unwrap_or_default(),
            },
            Kind::Waypoints => match section.waypoints.take() {
                Some(waypoints) => Self::WaypointList { waypoints },
                None => Self::Waypoints {
                    file: keys.need("file", section.file.take())?,
                },
            },
            Kind::External => Self::External {
                setpoint_timeout_ms: section
                    .setpoint_timeout_ms
                    .take()
                    .unwrap_or(SETPOINT_TIMEOUT_MS),
            },
        };
        keys.refuse("radius_m", section.radius_m.as_ref())?;
        keys.refuse("half_length_m", section.half_length_m.as_ref())?;
        keys.refuse("half_width_m", section.half_width_m.as_ref())?;
        keys.refuse(
            "angular_velocity_rad_s",
            section.angular_velocity_rad_s.as_ref(),
        )?;
        keys.refuse("centre_m", section.centre_m.as_ref())?;
        keys.refuse("steps", section.steps.as_ref())?;
        keys.refuse("file", section.file.as_ref())?;
        keys.refuse("waypoints", section.waypoints.as_ref())?;
        keys.refuse("setpoint_timeout_ms", section.setpoint_timeout_ms.as_ref())?;
        Ok(reference)
    }
}

impl ReferenceSection {
    /// Finds the waypoint file from `folder` if its path is relative.
    pub fn resolve(&mut self, folder: &Path) {
        if let Self::Waypoints { file } = self {
            *file = folder.join(&*file);
        }
    }

    /// The same reference, with nothing left in other files: those may change.
    ///
    /// # Errors
    ///
    /// Waypoints that can't be read.
    pub fn written_out(&self) -> Result<Self, ConfigError> {
        let Self::Waypoints { file } = self else {
            return Ok(self.clone());
        };
        let waypoints = waypoints_of(file)?;
        let written_out = |waypoint: &Waypoint| WaypointSection {
            t_s: waypoint.time,
            x_m: waypoint.position.x,
            y_m: waypoint.position.y,
        };
        Ok(Self::WaypointList {
            waypoints: waypoints.points().iter().map(written_out).collect(),
        })
    }

    /// Refuses what no hall holds and no car follows: the reference's points and
    /// velocities are then finite, too.
    fn check_sizes(&self) -> Result<(), ConfigError> {
        let length = |key, value: f64| check::within(key, value, -FARTHEST_M..=FARTHEST_M);
        let rate = |value: f64| {
            check::within(
                "reference.angular_velocity_rad_s",
                value,
                -FASTEST_RAD_S..=FASTEST_RAD_S,
            )
        };
        match self {
            Self::Circle {
                radius_m,
                angular_velocity_rad_s,
                centre_m,
            } => {
                length("reference.radius_m", *radius_m)?;
                rate(*angular_velocity_rad_s)?;
                centre_m
                    .iter()
                    .try_for_each(|centre| length("reference.centre_m", *centre))
            }
            Self::FigureOfEight {
                half_length_m,
                half_width_m,
                angular_velocity_rad_s,
                centre_m,
            } => {
                length("reference.half_length_m", *half_length_m)?;
                length("reference.half_width_m", *half_width_m)?;
                rate(*angular_velocity_rad_s)?;
                centre_m
                    .iter()
                    .try_for_each(|centre| length("reference.centre_m", *centre))
            }
            Self::VelocitySteps { .. }
            | Self::Waypoints { .. }
            | Self::WaypointList { .. }
            | Self::External { .. } => Ok(()),
        }
    }

    /// The reference, with waypoints read from their file.
    ///
    /// # Errors
    ///
    /// A reference that makes no sense, or waypoints that can't be read.
    pub fn reference(&self) -> Result<Reference, ConfigError> {
        self.check_sizes()?;
        Ok(match self {
            Self::Circle {
                radius_m,
                angular_velocity_rad_s,
                centre_m: [x, y],
            } => Reference::Circle(Circle::new(
                Position::new(*x, *y),
                *radius_m,
                *angular_velocity_rad_s,
            )?),
            Self::VelocitySteps { steps } => {
                let steps: Vec<_> = steps
                    .iter()
                    .map(|step| VelocityStep {
                        duration: step.duration_s,
                        velocity: Velocity::new(step.v_x_m_s, step.v_y_m_s),
                    })
                    .collect();
                Reference::VelocitySteps(VelocitySteps::new(&steps)?)
            }
            Self::FigureOfEight {
                half_length_m,
                half_width_m,
                angular_velocity_rad_s,
                centre_m: [x, y],
            } => Reference::FigureOfEight(FigureOfEight::new(
                Position::new(*x, *y),
                *half_length_m,
                *half_width_m,
                *angular_velocity_rad_s,
            )?),
            Self::Waypoints { file } => Reference::Waypoints(waypoints_of(file)?),
            Self::WaypointList { waypoints } => {
                let waypoints: Vec<_> = waypoints
                    .iter()
                    .map(|waypoint| Waypoint {
                        time: waypoint.t_s,
                        position: Position::new(waypoint.x_m, waypoint.y_m),
                    })
                    .collect();
                Reference::Waypoints(Waypoints::new(&waypoints)?)
            }
            Self::External {
                setpoint_timeout_ms,
            } => {
                // Longer, and nobody would call it a deadman's switch.
                check::within(
                    "reference.setpoint_timeout_ms",
                    *setpoint_timeout_ms,
                    20..=1_000,
                )?;
                Reference::External(External::new(check::seconds(*setpoint_timeout_ms))?)
            }
        })
    }
}

fn waypoints_of(file: &Path) -> Result<Waypoints, ConfigError> {
    read_waypoints(file).map_err(|source| ConfigError::Waypoints {
        path: file.to_owned(),
        source,
    })
}
