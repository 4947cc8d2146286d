//! The studies.

mod compare;
mod cycles;
mod limit_cycles;
mod other_structure;
mod plan;
