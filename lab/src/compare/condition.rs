//! What is different from a calibrated car with good cameras.

use clap::{ValueEnum, builder::PossibleValue};
use singletrack_control::{VehicleParameters, words};
use singletrack_sim::SimulationConfig;

words! {
    /// A condition of the comparison.
    pub enum Condition: serde {
        /// The car is as it is believed to be.
        Nominal = "nominal",
        /// The true tyres have half the cornering stiffness.
        SoftTyres = "tyres-50%",
        /// The true tyres have 1.5 times the cornering stiffness.
        StiffTyres = "tyres+50%",
        /// The front axle is believed to be at the centre of mass: dl = `-l_f`.
        AxleLeast = "axle-lf",
        /// The distance of the front axle from the centre of mass is believed to be 50 mm less.
        AxleLess = "axle-50mm",
        /// The distance of the front axle from the centre of mass is believed to be 50 mm more.
        AxleMore = "axle+50mm",
        /// The rear axle is believed to be at the centre of mass: dl = `l_r`.
        AxleMost = "axle+lr",
        /// The wheels turn 20 % less than commanded.
        WeakSteering = "gain-20%",
        /// The true trim of the steering is 3 degrees off.
        WrongTrim = "trim-3deg",
        /// The poses are 20 ms older than their stamps.
        LateStamps = "stamps-20ms",
        /// The cameras see nothing for 50 ms, a second after the counting begins.
        Loss50 = "loss-50ms",
        /// The cameras see nothing for 100 ms.
        Loss100 = "loss-100ms",
        /// The cameras see nothing for 200 ms.
        Loss200 = "loss-200ms",
        /// The cameras see nothing for 500 ms.
        Loss500 = "loss-500ms",
        /// The cameras see nothing for a second.
        Loss1000 = "loss-1000ms",
        /// The paper's equations in place of the simulated car: no lag, noise, limits or estimator.
        IdealPlant = "ideal-plant",
        /// The search for the least added delay that diverges, in a table of its own.
        AddedDelay = "added-delay",
    }
}

impl ValueEnum for Condition {
    fn value_variants<'a>() -> &'a [Self] {
        &Self::ALL
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        let help = self.documentation().trim().trim_end_matches('.');
        Some(PossibleValue::new(self.name()).help(help))
    }
}

impl Condition {
    /// Factor of the true cornering stiffnesses.
    pub(super) const fn stiffness(self) -> f64 {
        match self {
            Self::SoftTyres => 0.5,
            Self::StiffTyres => 1.5,
            _ => 1.0,
        }
    }

    /// Error of the believed distance of the front axle, in m: dl.
    pub(super) fn axle_error_m(self, vehicle: &VehicleParameters) -> f64 {
        match self {
            Self::AxleLeast => -vehicle.front_axle_distance_m,
            Self::AxleLess => -0.05,
            Self::AxleMore => 0.05,
            Self::AxleMost => vehicle.rear_axle_distance_m,
            _ => 0.0,
        }
    }

    /// Makes steering and cameras differ from what is believed of them.
    pub(super) fn falsify(self, simulation: &mut SimulationConfig) {
        let servo = &mut simulation.car.servo;
        match self {
            Self::WeakSteering => servo.gain_us_per_rad /= 0.8,
            Self::WrongTrim => servo.centre_us += 3_f64.to_radians() * servo.gain_us_per_rad.abs(),
            Self::LateStamps => simulation.cameras.stamp_bias_ms = 20.0,
            _ => {}
        }
    }

    /// How long the cameras see nothing, in µs.
    pub(super) const fn loss_us(self) -> u64 {
        match self {
            Self::Loss50 => 50_000,
            Self::Loss100 => 100_000,
            Self::Loss200 => 200_000,
            Self::Loss500 => 500_000,
            Self::Loss1000 => 1_000_000,
            _ => 0,
        }
    }
}

use Condition::{
    AxleLeast, AxleLess, AxleMore, AxleMost, LateStamps, Nominal, SoftTyres, StiffTyres,
    WeakSteering, WrongTrim,
};

/// Conditions of which the worst has a row of its own, with its name in the table: within 50 % of
/// the cornering stiffness, over the believed place of the front axle, dl from `-l_f` to `l_r`,
/// and over the wrong beliefs about steering and cameras.
pub(super) const WORST: [(&str, &[Condition]); 3] = [
    ("worst-tyres", &[Nominal, SoftTyres, StiffTyres]),
    (
        "worst-axle",
        &[Nominal, AxleLeast, AxleLess, AxleMore, AxleMost],
    ),
    (
        "worst-belief",
        &[Nominal, WeakSteering, WrongTrim, LateStamps],
    ),
];
