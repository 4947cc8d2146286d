//! The reasons for which an identification fails.

use singletrack_control::VehicleParameters;

/// Why nothing is identified.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum IdentificationError {
    /// A list is as good as empty.
    #[error("there are {count} {what} in the drive: record one with motion capture and board")]
    TooFew {
        /// What there is too little of.
        what: &'static str,
        /// How many there are.
        count: usize,
    },
    /// A number that is none.
    #[error("number {index} of the {what} is not finite: the record is damaged there")]
    NotFinite {
        /// In which list.
        what: &'static str,
        /// Its index, from 0.
        index: usize,
    },
    /// Time goes back.
    #[error("number {index} of the {what}, at {time_s} s, is older than the one before it")]
    OutOfOrder {
        /// In which list.
        what: &'static str,
        /// Its index, from 0.
        index: usize,
        /// Its time, in s.
        time_s: f64,
    },
    /// The car hardly moved.
    #[error(
        "the car was never faster than {fastest:.2} m/s for long, and only what is faster than \
         {least:.2} m/s can be used: drive faster, 1.5 m/s or more"
    )]
    TooSlow {
        /// Its fastest, in m/s.
        fastest: f64,
        /// What counts, in m/s.
        least: f64,
    },
    /// Too little of the drive can be used.
    #[error(
        "only {seconds:.1} s of the drive are faster than {least_speed:.2} m/s with poses and \
         inertial samples throughout, {least:.0} s are needed: drive longer, a minute is good"
    )]
    TooShort {
        /// What can be used, in s.
        seconds: f64,
        /// What is needed, in s.
        least: f64,
        /// What counts, in m/s.
        least_speed: f64,
    },
    /// Nothing is asked for.
    #[error("no parameter is to be estimated: name some, such as c_f,c_r,i_z")]
    NoParameter,
    /// The fit went where no car is.
    #[error(
        "the fit does not converge; it was last at C_f {:.3} N/rad, C_r {:.3} N/rad, I_z {:.5} kg m²: \
         start from a vehicle that is closer (--vehicle), and check mass, wheelbase and the servo's \
         calibration",
        .vehicle.front_cornering_stiffness_n_rad,
        .vehicle.rear_cornering_stiffness_n_rad,
        .vehicle.yaw_inertia_kg_m2
    )]
    Diverged {
        /// Where it was.
        vehicle: VehicleParameters,
    },
}
