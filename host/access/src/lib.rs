//! Who may connect to a server on TCP: tokens in files, and bounded places for connections.

mod linger;
mod token;
mod waiting;

pub use linger::linger;
pub use token::{Token, TokenFile};
pub use waiting::{Place, WaitingRoom};
