//! The analyses against independent numbers.

mod ages;
mod circle;
mod cycles;
mod eigenvalues;
mod hopf;
mod identification;
mod measured_point;
mod sampled;
mod servo;
mod synthetic;
