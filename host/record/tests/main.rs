//! Records that are written, read and mended.

mod common;
mod cursor;
mod damage;
mod recover;
mod round_trip;
mod schemas;
