//! The UNO image's use of its processor.

use serde::Serialize;
use singletrack_sim::{ImageSize, Installation, SimulatedBoard};

use super::error::DemoError;

/// The UNO image's use of its processor, from power-on to the end.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct BoardFigures {
    /// Of 32,256 B beside the bootloader.
    pub(super) flash_bytes: u64,
    /// Variables and the deepest stack, of 2,048 B.
    pub(super) sram_bytes: u64,
    /// Time not asleep.
    pub(super) cpu_percent: f64,
    /// The longest interrupt, in cycles of 62.5 ns.
    pub(super) isr_max_cycles: u32,
    /// The largest deviation of a pulse from 20 ms after the one before.
    pub(super) pulse_jitter_us: f64,
}

impl BoardFigures {
    /// None for a board that is not a UNO.
    pub(super) fn of(board: &mut SimulatedBoard) -> Result<Option<Self>, DemoError> {
        if let Some(failure) = board.failure() {
            return Err(DemoError::Board(failure.to_owned()));
        }
        let (Some(figures), Some(pulse_jitter_us)) = (board.figures(), board.pulse_jitter_us())
        else {
            return Ok(None);
        };
        let size = Installation::find()
            .and_then(|installation| ImageSize::read(&installation.image))
            .map_err(|error| DemoError::Board(error.to_string()))?;
        let asleep = figures.cycles_asleep as f64 / figures.cycles.max(1) as f64;
        let longest = figures.interrupts.iter().map(|one| one.most_cycles).max();
        Ok(Some(Self {
            flash_bytes: size.flash_bytes,
            sram_bytes: size.static_bytes + u64::from(figures.stack_bytes),
            cpu_percent: 100.0 * (1.0 - asleep),
            isr_max_cycles: longest.unwrap_or(0),
            pulse_jitter_us,
        }))
    }
}
