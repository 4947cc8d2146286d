//! The parameters that can be estimated, and their prior distributions.

use core::str::FromStr;

use singletrack_control::{VehicleParameters, words};

use crate::dual::Dual;

words! {
    /// A parameter of the car or of its sensors.
    #[derive(PartialOrd, Ord, Hash)]
    pub enum Parameter {
        /// Cornering stiffness `C_f` of the front axle, in N/rad.
        FrontStiffness = "c_f",
        /// Cornering stiffness `C_r` of the rear axle, in N/rad.
        RearStiffness = "c_r",
        /// Yaw moment of inertia `I_z`, in kg m².
        YawInertia = "i_z",
        /// Distance `l_f` from G to the front axle with the wheelbase fixed, in m.
        FrontAxleDistance = "l_f",
        /// Friction coefficient μ.
        Friction = "friction",
        /// Ratio of the true steering angle to the target.
        SteeringGain = "steering_gain",
        /// Time constant of the servo, in s.
        ServoLag = "servo_lag",
        /// Delay from a servo pulse in the board's record to the motion of the servo, in s.
        SteeringDelay = "delay",
        /// Steering angle at the pulse for straight on, in rad.
        SteeringTrim = "trim",
        /// Delay from the measurement of an inertial sample to its time stamp, in s.
        InertialDelay = "imu_delay",
        /// Bias of the acceleration to the left, in m/s².
        LateralBias = "lateral_bias",
        /// Ratio of the gyro's yaw rate, without its bias, to the true one.
        GyroScale = "gyro_scale",
    }
}

/// Number of parameters.
pub(super) const COUNT: usize = Parameter::ALL.len();

/// Units, empty for a ratio, and prior distributions, in the order of the discriminants.
const TABLE: [(&str, Prior); COUNT] = [
    // Two thirds of all cars are within a factor of four of the start value.
    ("N/rad", Prior::factor(1.4)),
    ("N/rad", Prior::factor(1.4)),
    ("kg m²", Prior::factor(1.4)),
    ("m", Prior::factor(0.5)),
    ("", Prior::factor(0.5)),
    ("", Prior::factor(0.2)),
    ("s", Prior::factor(1.0)),
    // A slow servo, or one whose command goes a long way: up to a fifth of a second.
    ("s", Prior::shift(0.085)),
    ("rad", Prior::shift(0.1)),
    ("s", Prior::shift(0.03)),
    ("m/s²", Prior::shift(0.3)),
    ("", Prior::factor(0.05)),
];

impl Parameter {
    /// The parameters that the paper identifies.
    pub const VEHICLE: [Self; 3] = [Self::FrontStiffness, Self::RearStiffness, Self::YawInertia];

    /// The parameters that must be estimated jointly, because no other source gives them.
    pub const NUISANCE: [Self; 6] = [
        Self::ServoLag,
        Self::SteeringDelay,
        Self::SteeringTrim,
        Self::InertialDelay,
        Self::LateralBias,
        Self::GyroScale,
    ];

    /// The parameters that differ between drives. The trim does on a real car, by tens of milliradians:
    /// the linkage has play.
    pub const OF_A_DRIVE: [Self; 3] = [Self::InertialDelay, Self::LateralBias, Self::SteeringTrim];

    /// The unit; empty for a ratio.
    pub const fn unit(self) -> &'static str {
        TABLE[self.index()].0
    }

    /// The prior distribution, in the coordinate of the optimiser.
    pub(super) const fn prior(self) -> Prior {
        TABLE[self.index()].1
    }

    const fn index(self) -> usize {
        self as usize
    }
}

impl FromStr for Parameter {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        Self::named(text).ok_or_else(|| {
            let known = Self::ALL.map(Self::name).join(", ");
            format!("there is no parameter {text:?}: choose from {known}")
        })
    }
}

/// A parameter as a coordinate `u` with the mean 0 and the standard deviation 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Prior {
    /// Whether u scales the start value or adds to it.
    relative: bool,
    /// Standard deviation of the prior: of the logarithm, or in the parameter's unit.
    pub(super) deviation: f64,
}

/// The bound of a parameter, in standard deviations from its start value:
/// [`Prior::value`] saturates there.
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

    /// The value of the parameter at `u`.
    pub(super) fn value<D: Dual>(&self, start: f64, u: D) -> D {
        let shift = (u / BOUND).tanh() * (BOUND * self.deviation);
        if self.relative {
            shift.exp() * start
        } else {
            shift + start
        }
    }

    /// The derivative of the value at `u`.
    pub(super) fn slope(&self, start: f64, u: f64) -> f64 {
        let tanh = (u / BOUND).tanh();
        let shift = self.deviation * (1.0 - tanh * tanh);
        if self.relative {
            shift * self.value(start, u)
        } else {
            shift
        }
    }

    /// The coordinate at which a relative parameter is `factor` of its start value; 0 of another.
    pub(super) fn coordinate_of_factor(&self, factor: f64) -> f64 {
        if !self.relative {
            return 0.0;
        }
        let share = factor.ln() / (BOUND * self.deviation);
        BOUND * share.clamp(-0.99, 0.99).atanh()
    }

    /// Whether `u` is near a bound.
    pub(super) fn is_at_bound(u: f64) -> bool {
        u.abs() > 0.9 * BOUND
    }
}

/// A value for every parameter, and the vehicle parameters that are never estimated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Values {
    /// The vehicle at the start of the fit.
    vehicle: VehicleParameters,
    values: [f64; COUNT],
}

impl Values {
    /// The values of `vehicle`, a servo with a lag of 50 ms and a delay of 5 ms, and no other
    /// errors.
    pub const fn of(vehicle: &VehicleParameters) -> Self {
        let mut values = [0.0; COUNT];
        values[Parameter::FrontStiffness.index()] = vehicle.front_cornering_stiffness_n_rad;
        values[Parameter::RearStiffness.index()] = vehicle.rear_cornering_stiffness_n_rad;
        values[Parameter::YawInertia.index()] = vehicle.yaw_inertia_kg_m2;
        values[Parameter::FrontAxleDistance.index()] = vehicle.front_axle_distance_m;
        values[Parameter::Friction.index()] = vehicle.friction;
        values[Parameter::SteeringGain.index()] = 1.0;
        values[Parameter::GyroScale.index()] = 1.0;
        values[Parameter::ServoLag.index()] = 0.05;
        values[Parameter::SteeringDelay.index()] = 0.005;
        Self {
            vehicle: *vehicle,
            values,
        }
    }

    /// The value of a parameter, in its unit.
    pub const fn get(&self, parameter: Parameter) -> f64 {
        self.values[parameter.index()]
    }

    /// These values with another one of one parameter.
    #[must_use]
    pub const fn with(mut self, parameter: Parameter, value: f64) -> Self {
        self.values[parameter.index()] = value;
        self
    }

    /// All values, of which the `active` ones are at `u` in the coordinates of the optimiser.
    pub(super) fn moved<D: Dual>(&self, active: &[Parameter], u: &[D]) -> [D; COUNT] {
        let mut values = self.values.map(D::from);
        for (parameter, u) in active.iter().zip(u) {
            values[parameter.index()] = parameter.prior().value(self.get(*parameter), *u);
        }
        values
    }

    pub(super) const fn all(&self) -> &[f64; COUNT] {
        &self.values
    }

    /// Mass, in kg, and wheelbase, in m, which are never estimated.
    pub(super) const fn known(&self) -> (f64, f64) {
        (self.vehicle.mass_kg, self.vehicle.wheelbase_m())
    }

    /// The vehicle with these values.
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
