//! Division, copying and filling from avr-gcc's own libraries, which are written
//! in assembly for this processor: a third of the cycles and a tenth of the
//! flash of what Rust brings along for any processor.
//!
//! The linker takes what it finds first, and these come before Rust's.
#![allow(unsafe_code)]

// SAFETY: nothing is declared.
#[link(name = "gcc")]
#[link(name = "c")]
unsafe extern "C" {}
