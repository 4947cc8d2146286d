//! A scenario file: what is simulated.

use std::path::{Path, PathBuf};

use serde::Deserialize;
use singletrack_control::{
    Circle, FigureOfEight, FrontPointLaw, LawError, OpenLoop, Position, ProportionalLoop,
    Reference, ReferenceError, TrackingLoop, VehicleParameters, Velocity, VelocityPointLaw,
    VelocityStep, VelocitySteps, Waypoint, Waypoints,
};

/// Everything that a simulation needs to know; unknown keys are refused.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scenario {
    /// The linearising law.
    pub law: LawSection,
    /// The position loop around it.
    pub outer_loop: OuterLoopSection,
    /// Where P should be.
    pub reference: ReferenceSection,
    /// Where the car starts.
    pub start: StartSection,
    /// How the controller runs.
    pub control: ControlSection,
    /// What is controlled.
    pub plant: PlantSection,
    /// How long, and from which seed.
    pub run: RunSection,
    /// When the cameras lose the markers.
    #[serde(default)]
    pub marker_loss: Vec<MarkerLoss>,
    /// The car; the paper's if left out.
    #[serde(default)]
    pub vehicle: VehicleParameters,
}

/// Which law, and what it believes.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LawSection {
    /// Which law.
    pub kind: LawKind,
    /// Distance p of the point P, in m.
    pub point_distance_m: f64,
    /// The estimate of `l_f` that law and point-P transform use, in m.
    pub front_axle_distance_m: f64,
}

/// The two laws of the paper.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LawKind {
    /// The proposed law.
    FrontPoint,
    /// The appendix's law.
    VelocityPoint,
}

/// The position loop.
#[derive(Clone, Debug, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum OuterLoopSection {
    /// Proportional, per axis.
    Proportional {
        /// Gains along x and y, per second.
        gain_per_s: [f64; 2],
        /// Whether the reference's velocity is added.
        #[serde(default)]
        feed_forward: bool,
    },
    /// None: the reference's velocity goes to the law.
    OpenLoop {},
}

/// The reference of P.
#[derive(Clone, Debug, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum ReferenceSection {
    /// See [`Circle`].
    Circle {
        /// Radius, in m.
        radius_m: f64,
        /// Angular velocity, in rad/s.
        angular_velocity_rad_s: f64,
        /// Centre, in m.
        #[serde(default)]
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
        #[serde(default)]
        centre_m: [f64; 2],
    },
    /// See [`Waypoints`].
    Waypoints {
        /// CSV file with the columns `t_s,x_m,y_m`; relative to the scenario.
        file: PathBuf,
    },
}

/// One velocity step.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StepSection {
    duration_s: f64,
    v_x_m_s: f64,
    v_y_m_s: f64,
}

/// Where the car starts: yaw rate, sideslip and steering are zero.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StartSection {
    /// Position of P, placed with the true `l_f`, in m.
    pub point_p_m: [f64; 2],
    /// Yaw, in degrees.
    pub yaw_deg: f64,
}

/// How the controller runs.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ControlSection {
    /// Period of the controller, in ms; 0 for continuous control.
    pub period_ms: u32,
    /// Ticks from measurement to actuation.
    #[serde(default)]
    pub delay_ticks: u32,
    /// How a steering rate becomes steering.
    #[serde(default)]
    pub steering: SteeringHold,
}

/// How a commanded steering rate acts over a period.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SteeringHold {
    /// The rate acts through the period.
    #[default]
    Ramp,
    /// Steering jumps by period x rate at the start of the period.
    Step,
}

/// What is controlled.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlantSection {
    /// Which plant.
    pub kind: PlantKind,
}

/// The paper's model, or everything that the simulator knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PlantKind {
    /// Outer loop and law alone on the paper's equations.
    Ideal,
    /// The whole pilot on the simulated car, board and cameras.
    Car,
}

/// How long, and from which seed.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunSection {
    /// Simulated time, in s.
    pub duration_s: f64,
    /// Seed of everything random.
    #[serde(default = "default_seed")]
    pub seed: u64,
}

fn default_seed() -> u64 {
    1
}

/// Ticks in which the cameras give no pose.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MarkerLoss {
    /// The first tick without a pose; not the very first, which has nothing to hold.
    pub first_tick: u64,
    /// How many ticks.
    pub ticks: u64,
}

/// A scenario that can't be simulated.
#[derive(Debug, thiserror::Error)]
pub enum ScenarioError {
    /// The file can't be read.
    #[error("can't read {}: {source}", .path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The file is no scenario.
    #[error("{}: {message}", .path.display())]
    Parse {
        /// The file.
        path: PathBuf,
        /// Where and why.
        message: String,
    },
    /// The waypoints can't be read.
    #[error("{}: {source}", .path.display())]
    Csv {
        /// The file.
        path: PathBuf,
        /// Where and why.
        source: csv::Error,
    },
    /// The reference makes no sense.
    #[error("[reference] {0}")]
    Reference(#[from] ReferenceError),
    /// The law makes no sense.
    #[error("[law] {0}")]
    Law(#[from] LawError),
    /// The vehicle makes no sense.
    #[error("[vehicle] {0}")]
    Vehicle(#[from] singletrack_control::VehicleParameterError),
    /// A value outside its range.
    #[error("{key} is {value}: {fix}")]
    Value {
        /// The key.
        key: &'static str,
        /// Its value.
        value: String,
        /// What it may be.
        fix: &'static str,
    },
}

impl ScenarioError {
    fn value(key: &'static str, value: impl ToString, fix: &'static str) -> Self {
        Self::Value {
            key,
            value: value.to_string(),
            fix,
        }
    }
}

impl Scenario {
    /// Reads and checks a scenario file.
    ///
    /// # Errors
    ///
    /// What is wrong with it, by key.
    pub fn read(path: &Path) -> Result<Self, ScenarioError> {
        let text = std::fs::read_to_string(path).map_err(|source| ScenarioError::Read {
            path: path.to_owned(),
            source,
        })?;
        let mut scenario: Self = toml::from_str(&text).map_err(|error| ScenarioError::Parse {
            path: path.to_owned(),
            message: error.to_string(),
        })?;
        if let ReferenceSection::Waypoints { file } = &mut scenario.reference
            && let Some(folder) = path.parent()
        {
            *file = folder.join(&*file);
        }
        scenario.validate()?;
        Ok(scenario)
    }

    /// Refuses what no simulation can do.
    fn validate(&self) -> Result<(), ScenarioError> {
        self.vehicle.validate()?;
        match self.law.kind {
            LawKind::FrontPoint => drop(self.front_point_law()?),
            LawKind::VelocityPoint => drop(self.velocity_point_law()?),
        }
        self.reference()?;
        if let OuterLoopSection::Proportional { gain_per_s, .. } = self.outer_loop {
            for gain in gain_per_s {
                if !(gain.is_finite() && gain >= 0.0) {
                    return Err(ScenarioError::value(
                        "outer_loop.gain_per_s",
                        gain,
                        "each gain must be finite and not negative",
                    ));
                }
            }
            if self.reference()?.at(0.0).position.is_none() {
                return Err(ScenarioError::value(
                    "outer_loop.kind",
                    "proportional",
                    "a reference of velocity steps has no position to follow; use \"open-loop\"",
                ));
            }
        }
        let [x, y] = self.start.point_p_m;
        if !(x.is_finite() && y.is_finite() && self.start.yaw_deg.is_finite()) {
            return Err(ScenarioError::value(
                "start",
                format!("{x}, {y}, {}", self.start.yaw_deg),
                "position and yaw must be finite",
            ));
        }
        if !(self.run.duration_s.is_finite() && (0.0..=86_400.0).contains(&self.run.duration_s)) {
            return Err(ScenarioError::value(
                "run.duration_s",
                self.run.duration_s,
                "it must lie between 0 and 86400",
            ));
        }
        if self.control.period_ms > 1_000 {
            return Err(ScenarioError::value(
                "control.period_ms",
                self.control.period_ms,
                "it must be at most 1000",
            ));
        }
        if self.control.delay_ticks > 1_000 {
            return Err(ScenarioError::value(
                "control.delay_ticks",
                self.control.delay_ticks,
                "it must be at most 1000",
            ));
        }
        if self.control.period_ms == 0 {
            if self.control.delay_ticks > 0 {
                return Err(ScenarioError::value(
                    "control.delay_ticks",
                    self.control.delay_ticks,
                    "continuous control (period_ms = 0) has no ticks to delay; use 0, or a period",
                ));
            }
            if !self.marker_loss.is_empty() {
                return Err(ScenarioError::value(
                    "marker_loss",
                    format!("{} windows", self.marker_loss.len()),
                    "continuous control (period_ms = 0) has no ticks to lose; remove them, or set a period",
                ));
            }
        }
        for loss in &self.marker_loss {
            if loss.first_tick == 0 {
                return Err(ScenarioError::value(
                    "marker_loss.first_tick",
                    0,
                    "it must be 1 or later: at tick 0 there is no pose yet to hold",
                ));
            }
        }
        Ok(())
    }

    /// The car as the law believes it to be.
    fn believed_vehicle(&self) -> VehicleParameters {
        self.vehicle
            .with_centre_of_mass_at(self.law.front_axle_distance_m)
    }

    pub(crate) fn front_point_law(&self) -> Result<FrontPointLaw, LawError> {
        FrontPointLaw::new(
            self.law.front_axle_distance_m,
            self.law.point_distance_m,
            self.vehicle.wheelbase_m(),
        )
    }

    pub(crate) fn velocity_point_law(&self) -> Result<VelocityPointLaw, LawError> {
        VelocityPointLaw::new(self.believed_vehicle(), self.law.point_distance_m)
    }

    pub(crate) fn tracking_loop(&self) -> TrackingLoop {
        match self.outer_loop {
            OuterLoopSection::Proportional {
                gain_per_s: [x, y],
                feed_forward,
            } => TrackingLoop::Proportional(ProportionalLoop {
                gain: Velocity::new(x, y),
                feed_forward,
            }),
            OuterLoopSection::OpenLoop {} => TrackingLoop::OpenLoop(OpenLoop),
        }
    }

    /// The reference, with waypoints read from their file.
    ///
    /// # Errors
    ///
    /// A reference that makes no sense, or waypoints that can't be read.
    pub fn reference(&self) -> Result<Reference, ScenarioError> {
        Ok(match &self.reference {
            ReferenceSection::Circle {
                radius_m,
                angular_velocity_rad_s,
                centre_m: [x, y],
            } => Reference::Circle(Circle::new(
                Position::new(*x, *y),
                *radius_m,
                *angular_velocity_rad_s,
            )?),
            ReferenceSection::VelocitySteps { steps } => {
                let steps: Vec<_> = steps
                    .iter()
                    .map(|step| VelocityStep {
                        duration: step.duration_s,
                        velocity: Velocity::new(step.v_x_m_s, step.v_y_m_s),
                    })
                    .collect();
                Reference::VelocitySteps(VelocitySteps::new(&steps)?)
            }
            ReferenceSection::FigureOfEight {
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
            ReferenceSection::Waypoints { file } => {
                Reference::Waypoints(Waypoints::new(&read_waypoints(file)?)?)
            }
        })
    }

    pub(crate) fn is_lost(&self, tick: u64) -> bool {
        self.marker_loss
            .iter()
            .any(|loss| tick >= loss.first_tick && tick - loss.first_tick < loss.ticks)
    }
}

/// A row of a waypoint file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct WaypointRow {
    t_s: f64,
    x_m: f64,
    y_m: f64,
}

fn read_waypoints(path: &Path) -> Result<Vec<Waypoint>, ScenarioError> {
    let error = |source| ScenarioError::Csv {
        path: path.to_owned(),
        source,
    };
    csv::Reader::from_path(path)
        .map_err(error)?
        .deserialize()
        .map(|row| {
            let row: WaypointRow = row.map_err(error)?;
            Ok(Waypoint {
                time: row.t_s,
                position: Position::new(row.x_m, row.y_m),
            })
        })
        .collect()
}
