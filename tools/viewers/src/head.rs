//! The head of a request: what a connection begins with.

use std::{io, time::Duration};

use tokio::{
    io::{AsyncRead, AsyncReadExt as _},
    time::timeout,
};

/// The longest head, in bytes.
pub(crate) const LONGEST_HEAD: usize = 8_192;

/// The longest wait for the whole head.
const HEAD_TIMEOUT: Duration = Duration::from_secs(5);

/// Reads until `parse` gives a result; it is also asked about a head of [`LONGEST_HEAD`]. `None` if
/// the client leaves or is silent before. Returns what was read, too.
pub(crate) async fn read_head<T>(
    mut stream: impl AsyncRead + Unpin,
    parse: impl Fn(&[u8]) -> Option<T>,
) -> io::Result<Option<(T, Vec<u8>)>> {
    let mut head = Vec::new();
    let read = async {
        loop {
            if let Some(parsed) = parse(&head) {
                return io::Result::Ok(Some(parsed));
            }
            let room = LONGEST_HEAD.saturating_sub(head.len());
            if (&mut stream).take(room as u64).read_buf(&mut head).await? == 0 {
                return Ok(None);
            }
        }
    };
    let parsed = timeout(HEAD_TIMEOUT, read).await.unwrap_or(Ok(None))?;
    Ok(parsed.map(|parsed| (parsed, head)))
}
