//! The greeting, whose layout never changes.

use crate::codec::structure;

/// The nonce of the [`Hello`] that the board sends at its start, unsolicited.
pub const UNSOLICITED: u32 = 0;

structure! {
    /// Who is speaking, in a layout that never changes.
    ///
    /// The host sends it with a non-zero nonce; the board answers with its own
    /// versions and the same nonce. The board also sends one with the nonce
    /// [`UNSOLICITED`] when it starts, from which the host learns that all state on the
    /// board is lost.
    pub struct Hello {
        /// The speaker's [`crate::VERSION`].
        pub protocol_version: u16,
        /// The speaker's software version: major, minor, patch.
        pub software_version: [u8; 3],
        /// Chosen by the host, repeated by the board; [`UNSOLICITED`] at start-up.
        pub nonce: u32,
    }
}

/// The number of a board that has been given none.
pub const UNNAMED: u16 = 0;

structure! {
    /// Which car the board is built into: sent right after every [`Hello`] of the
    /// board, whose own layout never changes.
    pub struct Identity {
        /// The number that the image was built with; [`UNNAMED`] for none.
        pub car_id: u16,
    }
}
