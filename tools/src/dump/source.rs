//! Where entries come from.

use std::{
    io::{BufRead, BufReader, Write},
    os::unix::net::UnixStream,
    path::{Path, PathBuf},
};

use singletrack_record::{NotAnEntry, Reader, RecordError, Shown, Topic, part_path};

use super::DumpError;

/// Opens a record; if it is still unfinished, the file that holds it until then.
pub(super) fn open(path: &Path, topic: Topic, follow: bool) -> Result<Reader, RecordError> {
    let part = part_path(path);
    let path = if !path.exists() && part.exists() {
        &part
    } else {
        path
    };
    let reader = Reader::open(path)?.only(&[topic]);
    Ok(if follow { reader.follow() } else { reader })
}

/// What the running daemon sees, as it sees it.
pub(super) struct Live {
    path: PathBuf,
    lines: BufReader<UnixStream>,
    line: String,
}

impl Live {
    /// Asks the daemon to tell.
    pub(super) fn connect(path: &Path) -> Result<Self, DumpError> {
        let unreachable = |source| DumpError::Unreachable {
            path: path.to_owned(),
            source,
        };
        let mut stream = UnixStream::connect(path).map_err(unreachable)?;
        stream
            .write_all(b"{\"version\":1,\"command\":\"watch\"}\n")
            .map_err(unreachable)?;
        Ok(Self {
            path: path.to_owned(),
            lines: BufReader::new(stream),
            line: String::new(),
        })
    }

    /// The next entry of the topic, as the daemon sent it and as it is printed;
    /// none once the daemon has gone.
    pub(super) fn next(&mut self, topic: Topic) -> Result<Option<(&str, Shown)>, DumpError> {
        loop {
            self.line.clear();
            let length =
                self.lines
                    .read_line(&mut self.line)
                    .map_err(|source| DumpError::Lost {
                        path: self.path.clone(),
                        source,
                    })?;
            if length == 0 {
                return Ok(None);
            }
            match Shown::from_json(self.line.trim_end()) {
                Ok(shown) if shown.topic == topic => {
                    return Ok(Some((self.line.trim_end(), shown)));
                }
                Ok(_) => {}
                // A newer daemon may have more topics than this program.
                Err(NotAnEntry::NoTopic { line }) if line.contains("\"topic\"") => {}
                Err(source) => {
                    return Err(DumpError::Answer {
                        path: self.path.clone(),
                        source,
                    });
                }
            }
        }
    }
}
