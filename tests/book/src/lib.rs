//! The shell commands of the documentation.
//!
//! `cargo verify book` runs them: each page in a folder of its own, its blocks in order. The word
//! after `sh` at the beginning of a block says how it runs, or why it does not: see [`Kind`].
//! The command lines of all blocks are also given to their programs with `--help`, which refuses
//! unknown commands, options and values.

mod blocks;
mod lines;

pub use blocks::{Block, BlockError, Kind, blocks};
pub use lines::{Line, lines, spans};
