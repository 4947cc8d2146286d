//! The protocol, as its users see it.

mod configuration;
mod damage;
mod golden_v1;
mod golden_v2;
mod golden_v3;
mod samples;
