//! The figures of the stability analysis: the paper's, over speed and dl, and those of
//! the loop as it is sampled. They show the results of the other modules.

mod command;
mod levels;
mod maps;
mod sampled;
mod scene;

pub(super) use command::{FiguresArgs, run};
pub use maps::cycles;
pub(super) use maps::{attraction, basin};
pub use maps::{eigenvalue, eigenvalues, region};
pub use sampled::sampled;
pub use scene::{Scene, around_meaningful, drawn_deviations};
