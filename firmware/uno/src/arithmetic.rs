//! Division, copying and filling from avr-gcc's libraries. They are written in
//! assembly for this processor and take a third of the cycles and a tenth of the
//! flash of Rust's portable versions.
//!
//! These libraries precede Rust's, so the linker uses them.
#![allow(unsafe_code)]

// SAFETY: declares no items.
#[link(name = "gcc")]
#[link(name = "c")]
unsafe extern "C" {}
