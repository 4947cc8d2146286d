//! The reasons for which an identification fails.

use singletrack_control::VehicleParameters;

use super::parameter::Parameter;

/// The result of a step of an identification.
pub(super) type Result<T> = core::result::Result<T, IdentificationError>;

/// The reason for which an identification fails.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum IdentificationError {
    /// Samples of this kind are fewer than two: this number.
    #[error("there are {1} {0} in the drive: record one with motion capture and board")]
    TooFew(&'static str, usize),
    /// A sample of this kind and with this index, from 0, is not finite.
    #[error("number {1} of the {0} is not finite: the record is damaged there")]
    NotFinite(&'static str, usize),
    /// A sample of this kind, index, from 0, and time, in s, is older than its predecessor.
    #[error("number {1} of the {0}, at {2} s, is older than the one before it")]
    OutOfOrder(&'static str, usize, f64),
    /// The car was too slow.
    #[error(
        "the car was never faster than {fastest:.2} m/s for long, and only driving above \
         {least:.2} m/s is used: drive faster, 1.5 m/s or more"
    )]
    TooSlow {
        /// The largest speed, in m/s.
        fastest: f64,
        /// The smallest speed that is used, in m/s.
        least: f64,
    },
    /// The usable part of the drive is too short.
    #[error(
        "only {seconds:.1} s of the drive are faster than {least_speed:.2} m/s without gaps in \
         poses and inertial samples, at least {least:.0} s are needed: drive longer, about a minute"
    )]
    TooShort {
        /// The usable duration, in s.
        seconds: f64,
        /// The smallest duration, in s.
        least: f64,
        /// The smallest speed that is used, in m/s.
        least_speed: f64,
    },
    /// The fit ended where it began.
    #[error(
        "the fit ended at its start values: this drive moves none of them; weave for a minute at 1.5 m/s or \
         more, with steps of the steering to both sides (docs/identification.md), and check that the record \
         has the steering that was driven"
    )]
    NotMoved,
    /// The drive says less of these parameters than their start values do.
    #[error(
        "this drive does not determine {}: weave for a minute at 1.5 m/s or more, with steps of the \
         steering to both sides and up to nine tenths of the friction (docs/identification.md), or name \
         only the others (--parameters)", names(.0)
    )]
    NotDetermined(Vec<Parameter>),
    /// Parameters ended at the bounds of their ranges.
    #[error(
        "{} reached the bound of its range, from {start} to {value}: start closer to the car (--vehicle), \
         check mass, wheelbase, the servo's calibration and the delays of the sensors, or weave faster",
        .parameter.name()
    )]
    AtBound {
        /// The first of them.
        parameter: Parameter,
        /// Its start value.
        start: f64,
        /// The bound.
        value: f64,
    },
    /// The fit did not converge: its last step, in standard deviations.
    #[error(
        "the fit has not settled: its last round moved a parameter by {0:.2} standard deviations; start \
         closer to the car (--vehicle), estimate fewer parameters, or weave for longer and to both sides"
    )]
    NotSettled(f64),
    /// The positions have a wrong unit: their median speed is this, in m/s.
    #[error("the poses move at {0:.0} m/s: check the unit of the positions")]
    TooFast(f64),
    /// This channel of the IMU always has this value.
    #[error(
        "the {0} of the IMU is {1} in every sample: it is not measured, or its column or sensor is dead"
    )]
    Dead(&'static str, f64),
    /// The yaw is not that of the car: the mean course less yaw, in rad.
    #[error(
        "the yaw of the poses is {:.0} degrees off the direction of travel on average, or all around it: check \
         its sign and the yaw of the rigid body on the car", .0.to_degrees()
    )]
    YawDiffers(f64),
    /// The gyro and the cameras measure different yaw rates: the gyro's over that of the cameras.
    #[error(
        "the gyro measures {0:.2} times the yaw rate of the cameras: check its sign, its unit, its mounting and \
         its rate"
    )]
    GyroDiffers(f64),
    /// The car turns against its steering: the correlation of steering angle and curvature.
    #[error(
        "the car turns against its steering (correlation {0:.2}): check the sign of the steering, left is \
         positive; a car that slides is not identified"
    )]
    SteeringOpposes(f64),
    /// The settings name no parameter.
    #[error("no parameter is selected: name some, such as c_f,c_r,i_z")]
    NoParameter,
    /// The fit left the range in which the model is defined, with these last values.
    #[error(
        "the fit does not converge; its last values were C_f {:.3} N/rad, C_r {:.3} N/rad, I_z {:.5} kg m²: \
         start from a vehicle that is closer (--vehicle), and check mass, wheelbase and the servo's \
         calibration",
        .0.front_cornering_stiffness_n_rad,
        .0.rear_cornering_stiffness_n_rad,
        .0.yaw_inertia_kg_m2
    )]
    Diverged(VehicleParameters),
}

fn names(parameters: &[Parameter]) -> String {
    let names: Vec<&str> = parameters.iter().map(|one| one.name()).collect();
    names.join(", ")
}
