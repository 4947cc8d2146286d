//! Fits: pure functions from readings to parameters with their 95 % intervals.
//!
//! The errors of successive readings are correlated: a person turns a car, a floor slopes, a
//! filter remembers. No fit therefore takes its interval from the scatter of single readings.
//! It comes from the scatter of *passes* (or of long blocks of one pass), each of which would
//! give the parameter by itself, with the quantile of Student's distribution, and what all
//! passes have in common is added as a stated systematic part.

mod body;
mod body_in_bends;
mod delay;
mod drive_train;
mod frames;
mod gauss_newton;
mod least_squares;
mod sample_times;
mod signal_noise;
pub(crate) mod speed_curve;
mod statistics;
pub(crate) mod steering;
mod track;
mod wheels;

pub(crate) use body::{FloorPose, Rolled, rolled, turned_about};
pub(crate) use body_in_bends::{Body, body};
pub(crate) use delay::stamp_delay;
pub(crate) use drive_train::{DriveTrain, deceleration, drive_train, roll_out};
pub(crate) use frames::Frames;
pub(crate) use gauss_newton::gauss_newton;
pub(crate) use least_squares::{LeastSquares, least_squares};
pub(crate) use sample_times::{Reading, sample_times};
pub(crate) use signal_noise::{SignalNoise, signal_noise};
pub(crate) use singletrack_control::student_quantile;
pub(crate) use statistics::{
    block_means, jackknife, mean, mean_interval, median, standard_deviation,
};
pub(crate) use track::{Motion, Signal, Track};
pub(crate) use wheels::{Wheels, wheel_angles, wheels, yaw_rates};
