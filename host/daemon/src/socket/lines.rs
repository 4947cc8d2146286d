//! The lines of a connection.

use std::io;

use serde::Serialize;
use tokio::{
    io::{AsyncBufReadExt, AsyncWriteExt, BufReader},
    task::yield_now,
};

use super::stream::{ReadHalf, WriteHalf};

/// The longest line, in bytes: a trajectory of 100 points with all their digits.
pub(super) const LONGEST_LINE: u64 = 16_384;

/// Reads and discards up to the end of the line or of the stream.
pub(super) async fn skip_line(read: &mut BufReader<ReadHalf>) -> io::Result<()> {
    loop {
        let bytes = read.fill_buf().await?;
        let end = bytes.iter().position(|&byte| byte == b'\n');
        let count = end.map_or(bytes.len(), |end| end + 1);
        read.consume(count);
        if end.is_some() || count == 0 {
            return Ok(());
        }
        yield_now().await;
    }
}

pub(super) async fn send(write: &mut WriteHalf, answer: &impl Serialize) -> io::Result<()> {
    let mut line = serde_json::to_vec(answer)?;
    line.push(b'\n');
    write.write_all(&line).await
}
