//! The hands of `singletrack-sim`: a Unix socket that takes commands as lines.

use std::{io, path::Path, time::Duration};

use singletrack_sim::{HandCommand, RealTimeSimulator, Seen};
use tokio::{
    io::{AsyncBufReadExt, AsyncWriteExt, BufReader},
    net::{UnixListener, UnixStream},
};

/// How often it is looked whether a motion has ended.
const LOOK: Duration = Duration::from_millis(20);
/// A line is at most this long, in bytes.
const LONGEST: usize = 256;

/// Serves one person after the other; it ends only with an error.
pub(crate) async fn serve(simulator: &RealTimeSimulator, path: &Path) -> io::Error {
    // The link of a simulator that was killed.
    let _ = std::fs::remove_file(path);
    let listener = match UnixListener::bind(path) {
        Ok(listener) => listener,
        Err(error) => return error,
    };
    loop {
        match listener.accept().await {
            // A person who leaves is no failure.
            Ok((stream, _)) => drop(attend(simulator, stream).await),
            Err(error) => return error,
        }
    }
}

/// Does what the lines say, each after the one before it has ended.
async fn attend(simulator: &RealTimeSimulator, mut stream: UnixStream) -> io::Result<()> {
    let (reader, mut writer) = stream.split();
    let mut lines = BufReader::new(reader).lines();
    while let Some(line) = lines.next_line().await? {
        let command = line
            .get(..LONGEST.min(line.len()))
            .map(str::parse::<HandCommand>);
        let answer = match command {
            Some(Ok(command)) => {
                let gone = |error| io::Error::other(format!("{error}"));
                simulator
                    .with_world(move |world| command.apply(world))
                    .map_err(gone)?;
                loop {
                    let (busy, text) = simulator
                        .with_world(|world| (world.car().is_in_motion_by_hand(), Seen::of(world)))
                        .map_err(gone)?;
                    if !busy {
                        break format!("ok {text}\n");
                    }
                    tokio::time::sleep(LOOK).await;
                }
            }
            Some(Err(error)) => format!("error: {error}\n"),
            None => "error: not a line of text\n".to_owned(),
        };
        writer.write_all(answer.as_bytes()).await?;
    }
    Ok(())
}
