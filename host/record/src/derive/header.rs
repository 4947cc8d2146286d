//! Headers and stamps of messages.

use crate::{
    batch::Batch,
    standard::{Header, Time},
};

/// A header for a time of the monotonic clock.
pub(super) fn header(time_ns: u64, frame_id: &'static str, batch: &Batch) -> Header {
    Header {
        stamp: stamp(time_ns, batch),
        frame_id,
    }
}

/// A time of the monotonic clock as a stamp of the wall clock.
pub(super) fn stamp(time_ns: u64, batch: &Batch) -> Time {
    const SECOND: u64 = 1_000_000_000;
    let wall_ns = batch.wall_ns_at(time_ns);
    Time {
        // The seconds of ROS end in 2038.
        sec: i32::try_from(wall_ns / SECOND).unwrap_or(i32::MAX),
        nanosec: (wall_ns % SECOND) as u32,
    }
}
