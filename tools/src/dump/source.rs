//! Where entries come from.

use std::{
    io::{self, BufRead, BufReader, Write},
    os::unix::net::UnixStream,
    path::{Path, PathBuf},
};

use serde_json::{Value, json};
use singletrack_record::{NotAnEntry, Reader, RecordError, Shown, Topic, part_path};
use singletrackd::SOCKET_VERSION;

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
    topic: Topic,
}

impl Live {
    /// Asks the daemon to tell of a topic, and waits until it agrees.
    pub(super) fn connect(path: &Path, topic: Topic) -> Result<Self, DumpError> {
        let unreachable = |source| DumpError::Unreachable {
            path: path.to_owned(),
            source,
        };
        let mut stream = UnixStream::connect(path).map_err(unreachable)?;
        let request = json!({
            "version": SOCKET_VERSION,
            "command": "watch",
            "topics": [topic.name()],
        });
        stream
            .write_all(format!("{request}\n").as_bytes())
            .map_err(unreachable)?;
        let mut live = Self {
            path: path.to_owned(),
            lines: BufReader::new(stream),
            line: String::new(),
            topic,
        };
        live.expect_agreement()?;
        Ok(live)
    }

    /// The daemon's first line says whether it will tell anything.
    fn expect_agreement(&mut self) -> Result<(), DumpError> {
        if !self.read_line()? {
            return Err(DumpError::Lost {
                path: self.path.clone(),
                source: io::ErrorKind::UnexpectedEof.into(),
            });
        }
        let answer = serde_json::from_str::<Value>(&self.line).map_err(|error| {
            self.makes_no_sense(NotAnEntry::NotJson {
                line: self.line.trim_end().to_owned(),
                reason: error.to_string(),
            })
        })?;
        if answer["ok"] == true {
            return Ok(());
        }
        Err(match answer["error"].as_str() {
            Some(error) => DumpError::Refused {
                path: self.path.clone(),
                error: error.to_owned(),
            },
            None => self.makes_no_sense(NotAnEntry::NoTopic {
                line: self.line.trim_end().to_owned(),
            }),
        })
    }

    /// The next entry of the topic, as the daemon sent it and as it is printed;
    /// none once the daemon has gone. What was missed is noted on stderr.
    pub(super) fn next(&mut self) -> Result<Option<(&str, Shown)>, DumpError> {
        loop {
            if !self.read_line()? {
                return Ok(None);
            }
            match Shown::from_json(self.line.trim_end()) {
                Ok(shown) if shown.topic == self.topic => {
                    return Ok(Some((self.line.trim_end(), shown)));
                }
                Ok(_) => {}
                // A newer daemon may have more topics than this program.
                Err(NotAnEntry::NoTopic { line }) if line.contains("\"topic\"") => {}
                Err(source) => match missed(&self.line) {
                    Some(count) => eprintln!(
                        "singletrack: {}: {count} entries of all topics missed: \
                         what is printed is not taken as fast as they come",
                        self.path.display()
                    ),
                    None => return Err(self.makes_no_sense(source)),
                },
            }
        }
    }

    /// Whether there is another line.
    fn read_line(&mut self) -> Result<bool, DumpError> {
        self.line.clear();
        match self.lines.read_line(&mut self.line) {
            Ok(length) => Ok(length > 0),
            Err(source) => Err(DumpError::Lost {
                path: self.path.clone(),
                source,
            }),
        }
    }

    fn makes_no_sense(&self, source: NotAnEntry) -> DumpError {
        DumpError::Answer {
            path: self.path.clone(),
            source,
        }
    }
}

/// How many entries the daemon says it could not send.
fn missed(line: &str) -> Option<u64> {
    serde_json::from_str::<Value>(line).ok()?["missed"].as_u64()
}
