//! NatNet codec and client session, without I/O.
#![no_std]
pub mod codec;
pub mod encode;
