//! The end of a connection.

use std::time::Duration;

use tokio::{
    io::{AsyncRead, AsyncReadExt as _, copy, sink},
    time::timeout,
};

/// The longest time, and the most bytes, for which what still comes is read and discarded.
const LINGER: Duration = Duration::from_millis(200);
const LINGER_BYTES: u64 = 65_536;

/// Reads and discards what a client still sends after its answer: a connection that is closed with
/// something unread is reset, and the answer is lost.
pub async fn linger(read: impl AsyncRead + Unpin) {
    let mut rest = read.take(LINGER_BYTES);
    let _ = timeout(LINGER, copy(&mut rest, &mut sink())).await;
}
