//! The daemon that drives the car, as a library: its threads, and the
//! controller that they and the simulations share.

pub mod controller;
