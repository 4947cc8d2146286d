//! `[law]`, `[compensation]` and `[outer_loop]`: from the position that P should have to commands;
//! the loops with a model have their weights, and what they believe of the car and of its
//! reference; the loops of other crates, which a program links, and of which one is named.

use core::fmt::{Debug, Display};
use std::sync::OnceLock;

use libm::{sqrt, tan};
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use singletrack_control::{
    ActuatorModel, BoxedLoop, ConvexArea, DelayedMpc, FrontPointLaw, LawError, Limits, LqiAxis,
    LqiConfig, LqiError, LqiLoop, MpcConfig, MpcError, OpenLoop, OuterLoop, ProportionalLoop,
    Reference, TrackingLoop, VehicleParameters, Velocity, VelocityPointLaw, angle_between, words,
};
use singletrack_pilot::{Compensation, Fence};
use singletrack_settings::{Declared, ValueError, Written, check_kind, explain_table, section};
use toml::Table;

use super::{ActuatorsSection, ConfigError, refuse_if};

section! {
    /// The linearising law.
    "law" => pub LawSection: Copy;
    [];

    /// The law: "front-point" is the paper's proposal; "velocity-point" exists in
    /// simulations only.
    kind: LawKind, words LawKind, example LawKind::FrontPoint;
    /// Distance p of the point P, which follows the reference, beyond the front axle. The servo
    /// bounds it from below, the more the faster the car: see `singletrack stability least-p`.
    point_distance_m: f64, text "above 0", example 0.35;
    /// Distance `l_f` of the front axle from the centre of mass, as measured; law and
    /// transform of P use it. Only its distance d from the rigid body's pivot matters: measure d,
    /// and set `front_axle_distance_m` - `marker_offset_m[0]` = d.
    front_axle_distance_m: f64, text "above 0, below the wheelbase", example 0.1368;
}

words! {
    /// The two laws of the paper.
    pub enum LawKind: serde {
        /// The proposed law.
        FrontPoint = "front-point",
        /// The law of the appendix.
        VelocityPoint = "velocity-point",
    }
}

impl LawSection {
    /// The proposed law with these values.
    ///
    /// # Errors
    ///
    /// Values that are invalid for the vehicle.
    pub fn front_point_law(&self, vehicle: &VehicleParameters) -> Result<FrontPointLaw, LawError> {
        FrontPointLaw::new(
            self.front_axle_distance_m,
            self.point_distance_m,
            vehicle.wheelbase_m(),
        )
    }

    /// The law of the appendix with these values.
    ///
    /// # Errors
    ///
    /// Values that are invalid for the vehicle.
    pub fn velocity_point_law(
        &self,
        vehicle: &VehicleParameters,
    ) -> Result<VelocityPointLaw, LawError> {
        VelocityPointLaw::new(
            vehicle.with_centre_of_mass_at(self.front_axle_distance_m),
            self.point_distance_m,
        )
    }

    /// Refuses values that are invalid for the vehicle.
    ///
    /// # Errors
    ///
    /// The first invalid value.
    pub fn validate(&self, vehicle: &VehicleParameters) -> Result<(), LawError> {
        match self.kind {
            LawKind::FrontPoint => self.front_point_law(vehicle).map(drop),
            LawKind::VelocityPoint => self.velocity_point_law(vehicle).map(drop),
        }
    }
}

section! {
    /// What the controller corrects of the board's clock and of the actuators, with the
    /// values of `[actuators]`. Nothing that stops the car rests on it.
    "compensation" => pub CompensationSection: Copy;
    [default];

    /// Commands speeds in the time of the board's clock, whose rate the link measures.
    clock: bool = true;
    /// Predicts the car to the moment at which a command acts, and leads speed and steering
    /// by the lags of motor and servo.
    actuation: bool = true;
}

impl CompensationSection {
    /// For the controller of this vehicle with these actuators.
    pub(super) fn config(
        &self,
        actuators: &ActuatorsSection,
        vehicle: &VehicleParameters,
    ) -> Compensation {
        Compensation {
            clock: self.clock,
            actuation: self.actuation.then(|| actuators.model()),
            vehicle: *vehicle,
        }
    }
}

/// The position loop.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", try_from = "OuterLoopKeys")]
pub enum OuterLoopSection {
    /// Proportional, per axis.
    Proportional {
        /// Gains along x and y, per second.
        gain_per_s: [f64; 2],
        /// Whether the reference's velocity is added.
        feed_forward: bool,
    },
    /// See [`LqiLoop`](singletrack_control::LqiLoop).
    Lqi(LqiWeights),
    /// See [`MpcLoop`](singletrack_control::MpcLoop).
    Mpc(MpcWeights),
    /// None: the reference's velocity goes to the law.
    OpenLoop {},
    /// See [`OwnLoop`].
    Own(OwnLoopSection),
}

section! {
    /// From the position that P should have to the velocity that it should have.
    /// `docs/outer-loops.md` compares the kinds.
    "outer_loop" => pub(super) OuterLoopKeys;
    [];

    /// The loop: "proportional"; "lqi", linear-quadratic with an integral; "mpc", predictive,
    /// for references that are known ahead; "open-loop" for references that are velocities; "own",
    /// of another crate that this program was built with.
    kind: OuterLoopKind, words OuterLoopKind, example OuterLoopKind::Proportional;
    /// Proportional: gains along x and y.
    gain_per_s: Option<[f64; 2]> = None, text "0 or above", example [1.0, 1.0];
    /// Proportional: adds the reference's velocity, so that P follows without lag. With
    /// `compensation.actuation` it is the velocity at the moment at which the command acts, and
    /// the reference's acceleration leads the speed by the motor's lag. The other loops always
    /// do that.
    feed_forward: Option<bool> = None, otherwise false;
    /// LQI: weight of the error's integral, in (m s)⁻².
    integral_weight: Option<f64> = None, in up_to(1e6),
        otherwise LqiWeights::default().integral_weight;
    /// LQI, MPC: weight of the error, in m⁻². Only the ratios of the weights matter.
    error_weight: Option<f64> = None, in up_to(1e6), otherwise ERROR_WEIGHT;
    /// LQI: weight of the correcting velocity, in (m/s)⁻². MPC: weight of the velocity's error.
    velocity_weight: Option<f64> = None, in up_to(1e6), otherwise VELOCITY_WEIGHT;
    /// LQI: the largest velocity that the integral adds along and across the path.
    integral_limit_m_s: Option<f64> = None, in 0.0..=5.0,
        otherwise LqiWeights::default().integral_limit_m_s;
    /// MPC: weight of the acceleration beyond the reference's, in (m/s²)⁻².
    acceleration_weight: Option<f64> = None, in up_to(1e6),
        otherwise MpcWeights::default().acceleration_weight;
    /// MPC: the share of an unexplained velocity of P that is believed at once. With 0 a drift
    /// stays as an error.
    disturbance_gain: Option<f64> = None, in 0.0..=1.0,
        otherwise MpcWeights::default().disturbance_gain;
    /// MPC: iterations of the solver in every tick; about 13,000 instructions each, four times
    /// that with `compensation.actuation`.
    iterations: Option<u32> = None, in 1..=200, otherwise MpcWeights::default().iterations;
    /// Own: the name of the loop.
    name: Option<String> = None, example "my-loop";
    /// Own: its version. A record has it, and no other one repeats the drive; without it, the one
    /// that this program was built with.
    version: Option<String> = None, example "0.1.0";
    /// Own: the keys of the loop, which its crate declares.
    own: Option<Table> = None, example Table::new();
}

words! {
    /// The kinds of loop.
    pub(super) enum OuterLoopKind: serde {
        /// See [`OuterLoopSection::Proportional`].
        Proportional = "proportional",
        /// See [`OuterLoopSection::Lqi`].
        Lqi = "lqi",
        /// See [`OuterLoopSection::Mpc`].
        Mpc = "mpc",
        /// See [`OuterLoopSection::OpenLoop`].
        OpenLoop = "open-loop",
        /// See [`OuterLoopSection::Own`].
        Own = "own",
    }
}

impl TryFrom<OuterLoopKeys> for OuterLoopSection {
    type Error = String;

    fn try_from(keys: OuterLoopKeys) -> Result<Self, String> {
        let written = Written::of(&keys)?;
        Ok(match keys.kind {
            // Keys of the other kinds may stay here, as with an open loop.
            OuterLoopKind::Proportional => Self::Proportional {
                gain_per_s: written.need("gain_per_s", keys.gain_per_s)?,
                feed_forward: keys.feed_forward.unwrap_or_default(),
            },
            OuterLoopKind::Lqi => Self::Lqi(written.settings::<OuterLoopKeys, _>()?),
            OuterLoopKind::Mpc => Self::Mpc(written.settings::<OuterLoopKeys, _>()?),
            // The gains may stay in a file whose loop is opened for a while.
            OuterLoopKind::OpenLoop => Self::OpenLoop {},
            OuterLoopKind::Own => {
                let name = written.need("name", keys.name)?;
                let own = OwnLoopSection::new(name, keys.version, keys.own);
                written.only_of::<OuterLoopKeys>(&own)?;
                Self::Own(own)
            }
        })
    }
}

impl OuterLoopSection {
    pub(super) const fn kind(&self) -> &'static str {
        match self {
            Self::Proportional { .. } => "proportional",
            Self::Lqi(_) => "lqi",
            Self::Mpc(_) => "mpc",
            Self::OpenLoop {} => "open-loop",
            Self::Own(_) => "own",
        }
    }

    /// The loop with these values, around the rest of the controller.
    ///
    /// # Errors
    ///
    /// Weights, lags and turns with which a loop does not settle, a geofence over which it can't
    /// plan, or a loop of another crate that this program does not have.
    pub fn tracking_loop(&self, model: &LoopModel<'_>) -> Result<TrackingLoop, ConfigError> {
        Ok(match self {
            Self::Proportional {
                gain_per_s: [x, y],
                feed_forward,
            } => TrackingLoop::Proportional(ProportionalLoop {
                gain: Velocity::new(*x, *y),
                feed_forward: *feed_forward,
            }),
            Self::Lqi(weights) => TrackingLoop::Lqi(model.lqi(weights)?),
            Self::Mpc(weights) => TrackingLoop::Mpc(model.mpc(weights)?),
            Self::OpenLoop {} => TrackingLoop::OpenLoop(OpenLoop),
            Self::Own(own) => TrackingLoop::Own(own.make(model)?),
        })
    }

    /// Refuses values outside their ranges.
    ///
    /// # Errors
    ///
    /// The first such value.
    pub fn validate(&self) -> Result<(), ConfigError> {
        if let Self::Proportional { gain_per_s, .. } = self {
            for gain in *gain_per_s {
                let is_wrong = !(gain.is_finite() && gain >= 0.0);
                let fix = "each gain must be finite and not negative";
                refuse_if(is_wrong, "outer_loop.gain_per_s", gain, fix)?;
            }
        }
        Ok(check_kind::<OuterLoopKeys>(self)?)
    }

    /// Refuses a loop for a reference without what it needs.
    ///
    /// # Errors
    ///
    /// The loop does not suit the reference.
    pub fn validate_for(&self, reference: &Reference) -> Result<(), ConfigError> {
        let refused = |fix| Err(ConfigError::value("outer_loop.kind", self.kind(), fix));
        match (self, reference) {
            (Self::OpenLoop {} | Self::Own(_), _) => Ok(()),
            (Self::Mpc(_), Reference::External(_)) => refused(
                "it plans over the reference to come, and a set-point from outside has none; use \
                 \"lqi\" or \"proportional\"",
            ),
            // A set-point from outside may have a position; one that has none passes through.
            (_, Reference::External(_)) => Ok(()),
            _ if reference.at(0.0).position.is_none() => refused(
                "a reference of velocity steps has no position to follow; use \"open-loop\"",
            ),
            _ => Ok(()),
        }
    }
}

section! {
    /// The settings of the linear-quadratic loop.
    "outer_loop" => pub LqiWeights: Copy;
    [default];

    /// Weight of the error's integral, (m s)⁻².
    integral_weight: f64 = 3.0;
    /// Weight of the error, m⁻².
    error_weight: f64 = ERROR_WEIGHT;
    /// Weight of the correcting velocity, (m/s)⁻².
    velocity_weight: f64 = VELOCITY_WEIGHT;
    /// The largest velocity that the integral adds on either axis, m/s.
    integral_limit_m_s: f64 = 0.3;
}

section! {
    /// The settings of the predictive loop.
    "outer_loop" => pub MpcWeights: Copy;
    [default];

    /// Weight of the error, m⁻².
    error_weight: f64 = ERROR_WEIGHT;
    /// Weight of the velocity's error, (m/s)⁻².
    velocity_weight: f64 = VELOCITY_WEIGHT;
    /// Weight of the acceleration beyond the reference's, (m/s²)⁻².
    acceleration_weight: f64 = 0.0003;
    /// The share of an unexplained velocity that is believed at once.
    disturbance_gain: f64 = 0.05;
    /// Iterations of the solver in every tick.
    iterations: u32 = 20;
}

const ERROR_WEIGHT: f64 = 1.0;
const VELOCITY_WEIGHT: f64 = 0.03;

/// The length of a stage of the predictive loop's plan, where no dead time sets it, in s.
const STAGE_S: f64 = 0.03;

/// For how long a reference without an end is looked at, and at which steps, in s.
const LOOKED_AT_S: f64 = 120.0;
const LOOK_S: f64 = 0.01;
/// Below this speed (m/s) a reference has no direction.
const STANDS_M_S: f64 = 0.02;

/// What the outer loops with a model believe.
#[derive(Clone, Copy, Debug)]
pub struct LoopModel<'a> {
    /// Lags and dead times; none where they are compensated, or where there are none.
    pub actuators: Option<ActuatorModel>,
    /// What the car may do.
    pub limits: &'a Limits,
    /// Where it may be, if that is bounded.
    pub fence: Option<&'a Fence>,
    /// Where P should be.
    pub reference: &'a Reference,
    /// The control period, s.
    pub period: f64,
}

impl LoopModel<'_> {
    fn lqi(&self, weights: &LqiWeights) -> Result<LqiLoop, ConfigError> {
        let axis = |lag| LqiAxis {
            lag,
            integral_weight: weights.integral_weight,
            error_weight: weights.error_weight,
            velocity_weight: weights.velocity_weight,
        };
        let lag = |of: fn(&ActuatorModel) -> f64| self.actuators.as_ref().map_or(0.0, of);
        LqiLoop::new(LqiConfig {
            along: axis(lag(|model| model.speed_dead_time + model.speed_lag)),
            across: axis(lag(|model| model.steering_dead_time + model.steering_lag)),
            integral_limit: weights.integral_limit_m_s,
            turn_rate: self.turn_rate(),
            period: self.period,
        })
        .map_err(|error| match error {
            LqiError::Turns(rate) => ConfigError::value(
                "outer_loop.velocity_weight",
                weights.velocity_weight,
                format!(
                    "the loop does not settle while the reference turns by {rate:.2} rad/s with \
                     the lags of [actuators]; lower it, set compensation.actuation = true, or \
                     drive slower"
                ),
            ),
            error => far_apart(error, weights.error_weight),
        })
    }

    fn mpc(&self, weights: &MpcWeights) -> Result<DelayedMpc, ConfigError> {
        let area = match self.fence {
            None => None,
            Some(fence) => Some(area(fence)?),
        };
        let mean = |of: fn(&ActuatorModel) -> [f64; 2]| {
            self.actuators.as_ref().map_or(0.0, |model| {
                let [steering, speed] = of(model);
                0.5 * (steering + speed)
            })
        };
        let dead_time = mean(|model| [model.steering_dead_time, model.speed_dead_time]);
        let config = MpcConfig {
            lag: mean(|model| [model.steering_lag, model.speed_lag]),
            period: self.period,
            ticks_per_stage: (STAGE_S / self.period).round().max(1.0) as usize,
            position_weight: weights.error_weight,
            velocity_weight: weights.velocity_weight,
            acceleration_weight: weights.acceleration_weight,
            max_speed: self.limits.max_speed,
            // The car speeds up and turns at the same time.
            max_acceleration: libm::hypot(
                self.limits.max_acceleration,
                self.limits.max_lateral_acceleration,
            ),
            max_deceleration: self.limits.max_acceleration,
            area,
            iterations: weights.iterations as usize,
            disturbance_gain: weights.disturbance_gain,
        };
        DelayedMpc::new(config, dead_time).map_err(|error| match error {
            MpcError::Delay(_) => ConfigError::value(
                "actuators.speed_dead_time_ms",
                self.actuators
                    .map_or(0.0, |model| 1_000.0 * model.speed_dead_time),
                "the predictive loop does not look over so long a dead time; set \
                 compensation.actuation = true, or choose outer_loop.kind = \"proportional\"",
            ),
            error => far_apart(error, weights.error_weight),
        })
    }

    /// The fastest turn that the reference's frame has to stand, rad/s: that of the reference,
    /// and not more than the car's.
    fn turn_rate(&self) -> f64 {
        let limits = self.limits;
        // Slower, the steering angle limits the turn, and faster, the lateral acceleration.
        let curvature = tan(limits.max_steering) / limits.wheelbase;
        let fastest = sqrt(limits.max_lateral_acceleration / curvature).min(limits.max_speed);
        (curvature * fastest).min(turn_rate(self.reference))
    }
}

/// The fastest turn of the reference, rad/s; infinite where it jumps, or is not known.
fn turn_rate(reference: &Reference) -> f64 {
    if matches!(
        reference,
        Reference::External(_) | Reference::Waypoints(_) | Reference::VelocitySteps(_)
    ) {
        return f64::INFINITY;
    }
    let duration = reference.duration().unwrap_or(LOOKED_AT_S).min(LOOKED_AT_S);
    let steps = (duration / LOOK_S) as u32;
    let velocity = |step: u32| reference.at(f64::from(step) * LOOK_S).velocity;
    (0..steps)
        .map(|step| (velocity(step), velocity(step + 1)))
        .filter(|(before, after)| before.norm().min(after.norm()) >= STANDS_M_S)
        .map(|(before, after)| angle_between(&before, &after).abs() / LOOK_S)
        .fold(0.0, f64::max)
}

/// Weights with which no loop is found.
fn far_apart(error: impl Display, error_weight: f64) -> ConfigError {
    let fix = format!("{error}; bring the weights closer to their defaults");
    ConfigError::value("outer_loop.error_weight", error_weight, fix)
}

/// Where P may be: the geofence within its margin.
fn area(fence: &Fence) -> Result<ConvexArea, ConfigError> {
    ConvexArea::new(fence.corners())
        .and_then(|area| area.shrunk(fence.margin()))
        .map_err(|error| {
            let fix = format!(
                "it plans inside the geofence, but of fence.corners_m {error}; give a convex \
                 fence that is wider than its margin, or use \"lqi\""
            );
            ConfigError::value("outer_loop.kind", "mpc", fix)
        })
}

/// An outer loop of another crate, which `[outer_loop]` of kind "own" names.
pub trait OwnLoop: OuterLoop + Clone + Debug + PartialEq + Send + Sync + 'static {
    /// Its name, in configurations and comparisons.
    const NAME: &'static str;

    /// Its version, which is in every record: no other one repeats the drive. As a rule
    /// `env!("CARGO_PKG_VERSION")`.
    const VERSION: &'static str;

    /// The keys of `[outer_loop.own]`, declared with [`section!`](singletrack_settings::section).
    /// In comparisons each has its default.
    type Settings: Declared + DeserializeOwned;

    /// The loop with these settings, whose ranges have been checked, around the rest of the
    /// controller.
    ///
    /// # Errors
    ///
    /// A value with which it can't drive.
    fn new(settings: Self::Settings, model: &LoopModel<'_>) -> Result<Self, ValueError>;
}

/// The type of an [`OwnLoop`], as a value.
#[derive(Clone, Copy, Debug)]
pub struct OwnLoopKind {
    /// See [`OwnLoop::NAME`].
    pub name: &'static str,
    /// See [`OwnLoop::VERSION`].
    pub version: &'static str,
    make: fn(&Table, &LoopModel<'_>) -> Result<BoxedLoop, ConfigError>,
}

impl OwnLoopKind {
    /// The kind of this loop.
    pub const fn of<L: OwnLoop>() -> Self {
        Self {
            name: L::NAME,
            version: L::VERSION,
            make: make::<L>,
        }
    }
}

fn make<L: OwnLoop>(keys: &Table, model: &LoopModel<'_>) -> Result<BoxedLoop, ConfigError> {
    let settings: Result<L::Settings, _> = keys.clone().try_into();
    let settings = settings
        .map_err(|error| ConfigError::Text(format!("outer_loop.own.{}", explain_table(&error))))?;
    settings.check()?;
    Ok(BoxedLoop::new(L::new(settings, model)?))
}

/// What this process has linked. A configuration is read in many places, from the start of the daemon to
/// the drives of a campaign, and means the same in all of them.
static LINKED: OnceLock<Vec<OwnLoopKind>> = OnceLock::new();

/// Makes loops of other crates known to every configuration that this process reads. Only the first
/// call has an effect: it is the first thing that `main` does.
pub fn link_own_loops(kinds: impl Into<Vec<OwnLoopKind>>) {
    LINKED.get_or_init(|| kinds.into());
}

/// The loops of other crates that this process has linked.
pub fn own_loops() -> &'static [OwnLoopKind] {
    LINKED.get().map_or(&[], Vec::as_slice)
}

/// A loop of another crate, as `[outer_loop]` names it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OwnLoopSection {
    /// Its name.
    pub name: String,
    /// Its version; empty if this program does not have it.
    pub version: String,
    /// Its settings, as far as they are given.
    pub own: Table,
}

impl OwnLoopSection {
    /// The loop of this name in this program, with these settings. Without a version it is the
    /// program's.
    pub fn new(name: String, version: Option<String>, own: Option<Table>) -> Self {
        let known = || own_loops().iter().find(|kind| kind.name == name);
        let version = version.or_else(|| Some(known()?.version.to_owned()));
        Self {
            version: version.unwrap_or_default(),
            own: own.unwrap_or_default(),
            name,
        }
    }

    fn make(&self, model: &LoopModel<'_>) -> Result<BoxedLoop, ConfigError> {
        let Self { name, version, own } = self;
        let wanted = format!("{name} {version}");
        let wanted = wanted.trim_end();
        let Some(kind) = own_loops().iter().find(|kind| kind.name == name) else {
            let known: Vec<_> = own_loops().iter().map(|kind| kind.name).collect();
            let known = match known.as_slice() {
                [] => "no loop of another crate".to_owned(),
                known => format!("only {}", known.join(", ")),
            };
            let fix = format!("this program has {known}; use the one that was built with {wanted}");
            return Err(ConfigError::value("outer_loop.name", name, fix));
        };
        if kind.version != version {
            let fix = format!(
                "this program has {name} {}; use the one that was built with {wanted}, or leave \
                 the key out of a file to drive with this one",
                kind.version
            );
            return Err(ConfigError::value("outer_loop.version", version, fix));
        }
        (kind.make)(own, model)
    }
}
