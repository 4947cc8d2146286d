//! The figures of the stability analysis: the paper's, over speed and dl, and those of
//! the loop as it is sampled. They show the results of the other modules.

mod command;
mod levels;
mod maps;
mod sampled;
mod scene;

pub(super) use command::{FiguresArgs, run};
pub(super) use maps::basin;
pub use maps::{cycles, eigenvalues, region};
pub use sampled::sampled;
pub use scene::{Scene, around_meaningful, drawn_deviations};
