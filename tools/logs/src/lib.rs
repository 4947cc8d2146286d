//! Logs that other programs made of other cars.
//!
//! [`import()`](import::import) makes a record of one, which the tools for records read.

pub mod import;
