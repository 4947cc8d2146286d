//! The controllers of the comparison, with their parameters.

use std::{fmt, sync::OnceLock};

use clap::{ValueEnum, builder::PossibleValue};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error as _};
use singletrack_control::words;
use singletrack_core::config::{
    LqiWeights, MpcWeights, OuterLoopSection, OwnLoopSection, own_loops,
};

use super::{counted::OwnPoint, foreign::Law};

words! {
    /// A controller of this repository.
    #[derive(ValueEnum)]
    pub enum ControllerName: serde {
        /// The paper's: proportional with unit gain.
        P = "p",
        /// With the reference's velocity fed forward.
        PFf = "p-ff",
        /// Proportional with a tuned gain, and the reference's velocity fed forward.
        PTuned = "p-tuned",
        /// Proportional with the compensation of clock and actuators, and a gain tuned for it.
        PCompensated = "p-compensated",
        /// Linear-quadratic with an integral, tuned.
        Lqi = "lqi",
        /// Linear-quadratic with an integral, and with the compensation.
        LqiCompensated = "lqi-compensated",
        /// Predictive, tuned.
        Mpc = "mpc",
        /// Predictive with the compensation.
        MpcCompensated = "mpc-compensated",
        /// Pure pursuit, tuned.
        PurePursuit = "pure-pursuit",
        /// Pure pursuit with the compensation of clock and actuators, tuned for it.
        PurePursuitCompensated = "pure-pursuit-compensated",
        /// Stanley, tuned.
        Stanley = "stanley",
        /// Stanley with the compensation.
        StanleyCompensated = "stanley-compensated",
        /// Model predictive control of the single-track model within the limits of the actuators,
        /// tuned.
        MpcSingleTrack = "mpc-single-track",
        /// The law of the paper's appendix with a tuned gain and the compensation.
        Appendix = "appendix",
        /// A program's own; see [`Comparison::drive_yours`](super::Comparison::drive_yours).
        #[value(skip)]
        Yours = "yours",
    }
}

/// A controller of the comparison.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Controller {
    /// A controller of this repository.
    Known(ControllerName),
    /// Another crate's [outer loop](singletrack_core::config::OwnLoop) of this name, with the defaults
    /// of its settings and the compensation of clock and actuators.
    Own(&'static str),
}

impl Controller {
    /// Its name in the table.
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Known(controller) => controller.name(),
            Self::Own(name) => name,
        }
    }

    /// With the parameters of the table.
    pub(super) fn drives(self) -> Drives {
        match self {
            Self::Known(controller) => controller.with(controller.parameters()),
            Self::Own(name) => Drives::Point {
                outer_loop: OuterLoopSection::Own(OwnLoopSection::new(name.into(), None, None)),
                compensated: true,
            },
        }
    }
}

impl From<ControllerName> for Controller {
    fn from(controller: ControllerName) -> Self {
        Self::Known(controller)
    }
}

impl fmt::Display for Controller {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.name())
    }
}

impl Serialize for Controller {
    fn serialize<S: Serializer>(&self, sink: S) -> Result<S::Ok, S::Error> {
        self.name().serialize(sink)
    }
}

impl<'de> Deserialize<'de> for Controller {
    fn deserialize<D: Deserializer<'de>>(source: D) -> Result<Self, D::Error> {
        let name = String::deserialize(source)?;
        let of_program = Self::Known(ControllerName::Yours);
        let mut all = Self::value_variants().iter().chain([&of_program]);
        all.find(|one| one.name() == name).copied().ok_or_else(|| {
            let known: Vec<&str> = Self::value_variants()
                .iter()
                .map(|one| one.name())
                .collect();
            D::Error::custom(format!(
                "a controller is {name:?}: use {}",
                known.join(" or ")
            ))
        })
    }
}

impl ValueEnum for Controller {
    fn value_variants<'a>() -> &'a [Self] {
        static ALL: OnceLock<Vec<Controller>> = OnceLock::new();
        ALL.get_or_init(|| {
            let known = ControllerName::value_variants().iter();
            let own = own_loops().iter().map(|kind| Self::Own(kind.name));
            known.copied().map(Self::Known).chain(own).collect()
        })
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        match *self {
            Self::Known(controller) => controller.to_possible_value(),
            Self::Own(name) => Some(PossibleValue::new(name).help("Another crate's outer loop")),
        }
    }
}

/// The weight of the acceleration of both predictive controllers: a tenth of the default. With less
/// hardly anything changes.
const MPC_ACCELERATION_WEIGHT: f64 = 3e-5;

/// How a controller drives.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Drives {
    /// Velocities of P, by which the law in the pilot steers.
    Point {
        outer_loop: OuterLoopSection,
        compensated: bool,
    },
    /// Steering and speed from outside.
    Actuators {
        law: Law,
        catch_up: f64,
        compensated: bool,
    },
    /// Steering and speed of a plan with the single-track model, with these weights of the squared
    /// steering rate, in (rad/s)⁻², and acceleration, in (m/s²)⁻².
    Predictive([f64; 2]),
    /// Set-points of a program.
    Yours(OwnPoint),
}

impl Drives {
    /// The point whose errors are its own.
    pub(super) const fn own_point(&self) -> OwnPoint {
        match self {
            Self::Point { .. } => OwnPoint::P,
            Self::Actuators { law, .. } => match law {
                Law::PurePursuit { .. } => OwnPoint::RearAxle,
                Law::Stanley { .. } => OwnPoint::FrontAxle,
                Law::Appendix { .. } => OwnPoint::VelocityPoint,
            },
            Self::Predictive(_) => OwnPoint::FrontAxle,
            Self::Yours(own) => *own,
        }
    }

    /// Whether clock and actuators are compensated.
    pub(super) const fn is_compensated(&self) -> bool {
        match self {
            Self::Point { compensated, .. } | Self::Actuators { compensated, .. } => *compensated,
            Self::Predictive(_) | Self::Yours(_) => true,
        }
    }

    /// Whether its outer loop has a model, with which it may be refused.
    pub(super) const fn has_model(&self) -> bool {
        matches!(
            self,
            Self::Point {
                outer_loop: OuterLoopSection::Lqi(_)
                    | OuterLoopSection::Mpc(_)
                    | OuterLoopSection::Own(_),
                ..
            }
        )
    }
}

impl ControllerName {
    /// The parameters of the table: what `tune` found with [`BUDGET`](super::plan::BUDGET) drives
    /// each. Of the linear-quadratic loop the weights of the error's integral and of the correcting
    /// velocity, that of the error being 1; of the predictive one the weight of the velocity's
    /// error, and the share of an unexplained velocity that is believed at once. Of the one with the
    /// model of the car the weights of steering rate and acceleration.
    pub(super) const fn parameters(self) -> [f64; 2] {
        match self {
            Self::P | Self::PFf => [1.0, 0.0],
            Self::PTuned => [10.0, 0.0],
            Self::PCompensated => [12.0, 0.0],
            Self::Appendix => [5.5, 0.0],
            Self::Lqi => [100.0, 0.03],
            Self::LqiCompensated => [300.0, 0.1],
            Self::Mpc => [0.1, 0.15],
            Self::MpcCompensated => [0.1, 0.25],
            Self::PurePursuit => [0.2, 12.0],
            Self::PurePursuitCompensated => [0.15, 8.0],
            Self::Stanley => [16.0, 12.0],
            Self::StanleyCompensated => [16.0, 8.0],
            Self::MpcSingleTrack => [0.01, 0.3],
            Self::Yours => [0.0; 2],
        }
    }

    /// With other parameters: the gain, or those of law and speed, or of the loop.
    pub(super) fn with(self, [first, second]: [f64; 2]) -> Drives {
        match self {
            Self::P | Self::PFf | Self::PTuned | Self::PCompensated => Drives::Point {
                outer_loop: OuterLoopSection::Proportional {
                    gain_per_s: [first; 2],
                    feed_forward: !matches!(self, Self::P),
                },
                compensated: matches!(self, Self::PCompensated),
            },
            Self::Lqi | Self::LqiCompensated => Drives::Point {
                outer_loop: OuterLoopSection::Lqi(LqiWeights {
                    integral_weight: first,
                    velocity_weight: second,
                    ..LqiWeights::default()
                }),
                compensated: self == Self::LqiCompensated,
            },
            Self::Mpc | Self::MpcCompensated => Drives::Point {
                outer_loop: OuterLoopSection::Mpc(MpcWeights {
                    velocity_weight: first,
                    acceleration_weight: MPC_ACCELERATION_WEIGHT,
                    disturbance_gain: second,
                    ..MpcWeights::default()
                }),
                compensated: self == Self::MpcCompensated,
            },
            Self::PurePursuit | Self::PurePursuitCompensated => Drives::Actuators {
                law: Law::PurePursuit { time: first },
                catch_up: second,
                compensated: self == Self::PurePursuitCompensated,
            },
            Self::Stanley | Self::StanleyCompensated => Drives::Actuators {
                law: Law::Stanley { gain: first },
                catch_up: second,
                compensated: self == Self::StanleyCompensated,
            },
            Self::MpcSingleTrack => Drives::Predictive([first, second]),
            Self::Yours => Drives::Yours(OwnPoint::P),
            Self::Appendix => Drives::Actuators {
                law: Law::Appendix { gain: first },
                catch_up: 0.0,
                compensated: true,
            },
        }
    }

    /// The values that are tried for each parameter; none for what is given.
    pub(super) const fn tried(self) -> Option<[&'static [f64]; 2]> {
        match self {
            Self::P | Self::PFf | Self::Yours => None,
            Self::PTuned | Self::PCompensated | Self::Appendix => Some([
                &[
                    0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.2, 1.4, 1.6, 1.8, 2.0, 2.3, 2.6, 3.0, 3.4, 3.8,
                    4.3, 4.9, 5.5, 6.2, 7.0, 8.0, 9.0, 10.0, 12.0,
                ],
                &[0.0],
            ]),
            Self::Lqi | Self::LqiCompensated => Some([
                &[3.0, 10.0, 30.0, 100.0, 300.0],
                &[0.003, 0.01, 0.03, 0.1, 0.3],
            ]),
            Self::Mpc | Self::MpcCompensated => {
                Some([&[0.01, 0.03, 0.1, 0.3, 1.0], &[0.02, 0.05, 0.1, 0.15, 0.25]])
            }
            Self::PurePursuit | Self::PurePursuitCompensated => {
                Some([&[0.1, 0.15, 0.2, 0.3, 0.5], &[2.0, 4.0, 8.0, 12.0, 16.0]])
            }
            Self::Stanley | Self::StanleyCompensated => {
                Some([&[4.0, 8.0, 16.0, 32.0, 64.0], &[2.0, 4.0, 8.0, 12.0, 16.0]])
            }
            Self::MpcSingleTrack => {
                Some([&[0.003, 0.01, 0.03, 0.1, 0.3], &[0.01, 0.03, 0.1, 0.3, 1.0]])
            }
        }
    }
}
