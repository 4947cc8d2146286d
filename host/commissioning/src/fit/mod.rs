//! Fits: pure functions from readings to parameters with their 95 % intervals.
//!
//! The errors of successive readings are correlated: a person turns a car, a floor slopes, a
//! filter remembers. No fit therefore takes its interval from the scatter of single readings.
//! It comes from the scatter of *passes* (or of long blocks of one pass), each of which would
//! give the parameter by itself, with the quantile of Student's distribution, and what all
//! passes have in common is added as a stated systematic part.

mod body;
mod delay;
pub(crate) mod drive_train;
mod statistics;
mod track;
pub(crate) mod wheels;

pub(crate) use body::{Body, Rolled, body, rolled, turned_about};
pub(crate) use delay::{sample_times, stamp_delay};
pub(crate) use drive_train::{DriveTrain, deceleration, drive_train, roll_out};
pub(crate) use statistics::{
    LeastSquares, block_means, gauss_newton, jackknife, least_squares, left_out_deviation, mean,
    mean_interval, median, standard_deviation,
};
pub(crate) use track::{Frames, Motion, Signal};
pub(crate) use wheels::{Driven, Wheels};
