//! The analyses against independent numbers.

#![allow(
    clippy::disallowed_methods,
    reason = "what a test expects is compared within a tolerance"
)]

mod ages;
mod circle;
mod cycles;
mod eigenvalues;
mod hopf;
mod identification;
mod losses;
mod measured_point;
mod sampled;
mod servo;
mod synthetic;
