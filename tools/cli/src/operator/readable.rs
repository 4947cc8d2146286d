//! Waits for something to read.

use std::{io, os::fd::BorrowedFd, time::Duration};

use rustix::{
    event::{PollFd, PollFlags, Timespec, poll},
    io::Errno,
};

/// Waits until one of the inputs has something to read, or its end, for `patience` at most, which is
/// less than a second. Whether one has.
pub(crate) fn wait_to_read<const N: usize>(
    inputs: [BorrowedFd<'_>; N],
    patience: Duration,
) -> io::Result<bool> {
    let mut polled = inputs.map(|input| PollFd::from_borrowed_fd(input, PollFlags::IN));
    let patience = Timespec {
        tv_sec: 0,
        tv_nsec: patience.subsec_nanos().into(),
    };
    match poll(&mut polled, Some(&patience)) {
        Ok(ready) => Ok(ready > 0),
        Err(Errno::INTR) => Ok(false),
        Err(error) => Err(error.into()),
    }
}
