//! Logs of foreign cars become records.

pub mod import;
