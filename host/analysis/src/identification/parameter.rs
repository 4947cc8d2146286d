//! What can be estimated, and what is known of it beforehand.

use core::{fmt, str::FromStr};

use singletrack_control::VehicleParameters;

/// Something that a drive can tell of the car or of its sensors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Parameter {
    /// Cornering stiffness `C_f` of the front axle, in N/rad.
    FrontStiffness,
    /// Cornering stiffness `C_r` of the rear axle, in N/rad.
    RearStiffness,
    /// Yaw moment of inertia `I_z`, in kg m².
    YawInertia,
    /// Distance `l_f` from G to the front axle with the wheelbase fixed, in m.
    FrontAxleDistance,
    /// Friction coefficient μ.
    Friction,
    /// Steering angle that the car takes for one that it is told.
    SteeringGain,
    /// Time constant of the servo, in s.
    ServoLag,
    /// Time from a servo pulse in the board's record until the servo moves, in s.
    SteeringDelay,
    /// Steering angle at the pulse that should steer straight on, in rad.
    SteeringTrim,
    /// How much later than it was measured an inertial sample is dated, in s.
    InertialDelay,
    /// Bias of the acceleration to the left, in m/s².
    LateralBias,
}

/// How many there are.
pub(super) const COUNT: usize = 11;

impl Parameter {
    /// All of them, in the order of the discriminants.
    pub const ALL: [Self; COUNT] = [
        Self::FrontStiffness,
        Self::RearStiffness,
        Self::YawInertia,
        Self::FrontAxleDistance,
        Self::Friction,
        Self::SteeringGain,
        Self::ServoLag,
        Self::SteeringDelay,
        Self::SteeringTrim,
        Self::InertialDelay,
        Self::LateralBias,
    ];

    /// What the paper identifies.
    pub const VEHICLE: [Self; 3] = [Self::FrontStiffness, Self::RearStiffness, Self::YawInertia];

    /// What must be estimated along, because nothing else tells it.
    pub const NUISANCE: [Self; 5] = [
        Self::ServoLag,
        Self::SteeringDelay,
        Self::SteeringTrim,
        Self::InertialDelay,
        Self::LateralBias,
    ];

    /// What may be another from one drive to the next.
    pub const OF_A_DRIVE: [Self; 2] = [Self::InertialDelay, Self::LateralBias];

    /// Its short name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::FrontStiffness => "c_f",
            Self::RearStiffness => "c_r",
            Self::YawInertia => "i_z",
            Self::FrontAxleDistance => "l_f",
            Self::Friction => "friction",
            Self::SteeringGain => "steering_gain",
            Self::ServoLag => "servo_lag",
            Self::SteeringDelay => "delay",
            Self::SteeringTrim => "trim",
            Self::InertialDelay => "imu_delay",
            Self::LateralBias => "lateral_bias",
        }
    }

    /// Its unit; empty for a ratio.
    #[must_use]
    pub const fn unit(self) -> &'static str {
        match self {
            Self::FrontStiffness | Self::RearStiffness => "N/rad",
            Self::YawInertia => "kg m²",
            Self::FrontAxleDistance => "m",
            Self::Friction | Self::SteeringGain => "",
            Self::ServoLag | Self::SteeringDelay | Self::InertialDelay => "s",
            Self::SteeringTrim => "rad",
            Self::LateralBias => "m/s²",
        }
    }

    /// How the optimiser sees it.
    pub(super) const fn prior(self) -> Prior {
        match self {
            // Two thirds of all cars have a quarter to four times of what is said.
            Self::FrontStiffness | Self::RearStiffness | Self::YawInertia => Prior::factor(1.4),
            Self::FrontAxleDistance | Self::Friction => Prior::factor(0.5),
            Self::SteeringGain => Prior::factor(0.2),
            Self::ServoLag => Prior::factor(1.0),
            Self::SteeringDelay => Prior::shift(0.02),
            Self::SteeringTrim => Prior::shift(0.1),
            Self::InertialDelay => Prior::shift(0.01),
            Self::LateralBias => Prior::shift(0.3),
        }
    }

    const fn index(self) -> usize {
        self as usize
    }
}

impl fmt::Display for Parameter {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.pad(self.name())
    }
}

/// A name that no parameter has.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("there is no parameter {name:?}: choose from {known}")]
pub struct UnknownParameter {
    /// The name.
    pub name: String,
    /// Those that there are.
    pub known: String,
}

impl FromStr for Parameter {
    type Err = UnknownParameter;

    fn from_str(text: &str) -> Result<Self, UnknownParameter> {
        let mut all = Self::ALL.into_iter();
        all.find(|parameter| parameter.name() == text)
            .ok_or_else(|| UnknownParameter {
                name: text.to_owned(),
                known: Self::ALL.map(Self::name).join(", "),
            })
    }
}

/// A parameter as a number `u` around zero of about one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Prior {
    /// Whether u scales the start or is added to it.
    relative: bool,
    /// Standard deviation of what is known beforehand: of the logarithm, or in the
    /// parameter's unit.
    pub(super) deviation: f64,
}

/// So many standard deviations from the start is a bound; [`Prior::squash`] turns
/// flat there.
const BOUND: f64 = 2.5;

impl Prior {
    const fn factor(deviation: f64) -> Self {
        Self {
            relative: true,
            deviation,
        }
    }

    const fn shift(deviation: f64) -> Self {
        Self {
            relative: false,
            deviation,
        }
    }

    /// The value that `u` stands for.
    pub(super) fn value<D>(&self, start: f64, u: D) -> D
    where
        D: num_dual::DualNum<Primitive = f64> + Copy,
    {
        let shift = (u / BOUND).tanh() * (BOUND * self.deviation);
        if self.relative {
            shift.exp() * start
        } else {
            shift + start
        }
    }

    /// How a value changes with u, at u.
    pub(super) fn slope(&self, start: f64, u: f64) -> f64 {
        let tanh = (u / BOUND).tanh();
        let shift = self.deviation * (1.0 - tanh * tanh);
        if self.relative {
            shift * self.value(start, u)
        } else {
            shift
        }
    }

    /// Whether u is as good as at a bound.
    pub(super) fn is_at_bound(u: f64) -> bool {
        u.abs() > 0.9 * BOUND
    }
}

/// A value for every parameter, with what is not estimated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Values {
    /// What the car is believed to be: where the fit starts.
    vehicle: VehicleParameters,
    values: [f64; COUNT],
}

impl Values {
    /// A vehicle with a hobby servo of 40 ms, 5 ms late, and everything else as it
    /// should be.
    #[must_use]
    pub const fn of(vehicle: &VehicleParameters) -> Self {
        let mut values = [0.0; COUNT];
        values[Parameter::FrontStiffness.index()] = vehicle.front_cornering_stiffness_n_rad;
        values[Parameter::RearStiffness.index()] = vehicle.rear_cornering_stiffness_n_rad;
        values[Parameter::YawInertia.index()] = vehicle.yaw_inertia_kg_m2;
        values[Parameter::FrontAxleDistance.index()] = vehicle.front_axle_distance_m;
        values[Parameter::Friction.index()] = vehicle.friction;
        values[Parameter::SteeringGain.index()] = 1.0;
        values[Parameter::ServoLag.index()] = 0.05;
        values[Parameter::SteeringDelay.index()] = 0.005;
        Self {
            vehicle: *vehicle,
            values,
        }
    }

    /// The value of a parameter, in its unit.
    #[must_use]
    pub const fn get(&self, parameter: Parameter) -> f64 {
        self.values[parameter.index()]
    }

    /// The same with another value of a parameter.
    #[must_use]
    pub const fn with(mut self, parameter: Parameter, value: f64) -> Self {
        self.values[parameter.index()] = value;
        self
    }

    pub(super) const fn all(&self) -> &[f64; COUNT] {
        &self.values
    }

    /// Mass, in kg, and wheelbase, in m: always known.
    pub(super) const fn known(&self) -> (f64, f64) {
        (self.vehicle.mass_kg, self.vehicle.wheelbase_m())
    }

    /// The vehicle with these values.
    #[must_use]
    pub const fn vehicle(&self) -> VehicleParameters {
        let moved = self
            .vehicle
            .with_centre_of_mass_at(self.get(Parameter::FrontAxleDistance));
        VehicleParameters {
            front_cornering_stiffness_n_rad: self.get(Parameter::FrontStiffness),
            rear_cornering_stiffness_n_rad: self.get(Parameter::RearStiffness),
            yaw_inertia_kg_m2: self.get(Parameter::YawInertia),
            friction: self.get(Parameter::Friction),
            ..moved
        }
    }
}
