//! Bags that the tests make, in MCAP and in sqlite files.

mod build;
mod errors;
mod layouts;
mod random;
