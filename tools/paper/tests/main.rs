//! The studies.

mod compare;
mod limit_cycles;
mod other_structure;
