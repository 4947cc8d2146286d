//! Two functional mock-up units for co-simulation by FMI 3.0, in one library: the simulated car
//! alone, and the whole simulated system. An importer selects one by its instantiation token.
//!
//! The library has the C interface of the standard; the program `singletrack-fmu` packs it.

mod instance;
mod interface;
mod variables;

pub use variables::{Unit, description};
