//! The bring-up of a car whose wheels are clear of the floor.

mod questions;
