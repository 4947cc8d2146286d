//! The studies.

mod compare;
mod lab;
mod limit_cycles;
mod other_structure;
