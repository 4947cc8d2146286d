//! Laws, outer loops and models.

#![allow(
    clippy::disallowed_methods,
    reason = "what a test expects is compared within a tolerance"
)]

mod estimator;
mod example;
mod governor;
mod laws;
mod lqi;
mod mpc;
mod references;
mod safety_answers;
mod safety_filter;
mod safety_stops;
mod vehicle_models;
mod words;
