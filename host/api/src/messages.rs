//! The stream of messages as ROS 2 encodes them.

use std::{
    io::{self, BufRead as _, BufReader, Read as _, Write as _},
    os::unix::net::UnixStream,
    path::{Path, PathBuf},
    time::Duration,
};

use serde::Deserialize;

use crate::{Answer, ClientError, Clocks, Request, connect};

/// The largest message that is received, in bytes.
const LARGEST: usize = 1 << 20;

/// A message of the stream. It belongs to the stream's buffers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Message<'a> {
    /// Its topic, such as `/odom`.
    pub topic: &'a str,
    /// The message as ROS 2 encodes it: CDR with its header of four bytes.
    pub bytes: &'a [u8],
}

/// What came next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Received<'a> {
    /// A message.
    Message(Message<'a>),
    /// This number of entries was lost, because this client was too slow.
    Missed(u64),
}

#[derive(Deserialize)]
struct Head {
    topic: Option<String>,
    bytes: Option<usize>,
    missed: Option<u64>,
}

/// A subscription to the messages of some topics.
#[derive(Debug)]
pub struct MessageStream {
    path: PathBuf,
    wait: Duration,
    read: BufReader<UnixStream>,
    /// The daemon's clocks when its record began.
    pub clocks: Clocks,
    line: Vec<u8>,
    topic: String,
    bytes: Vec<u8>,
}

impl MessageStream {
    /// Subscribes to `topics`; none: to all. `wait` is the longest time between two messages.
    ///
    /// # Errors
    ///
    /// The daemon can't be reached, does not answer, or does not know a topic.
    pub fn open(path: &Path, topics: &[&str], wait: Duration) -> Result<Self, ClientError> {
        let mut stream = connect(path)?;
        stream.set_read_timeout(Some(wait))?;
        let request = Request::Messages {
            topics: topics.iter().map(ToString::to_string).collect(),
        };
        stream.write_all(request.to_line()?.as_bytes())?;
        let mut read = BufReader::with_capacity(1 << 16, stream);
        let mut answer = String::new();
        let in_time = |error| ClientError::of_read(error, path, wait);
        if read.read_line(&mut answer).map_err(in_time)? == 0 {
            return Err(ClientError::Ended);
        }
        let begun = serde_json::from_str::<Answer>(&answer)?.agreed()?;
        let clocks = begun.clocks.ok_or(ClientError::NoAnswer(answer))?;
        Ok(Self {
            path: path.to_owned(),
            wait,
            read,
            clocks,
            line: Vec::new(),
            topic: String::new(),
            bytes: Vec::new(),
        })
    }

    /// From now on, messages may be any time apart.
    ///
    /// # Errors
    ///
    /// The system refuses it.
    pub fn wait_for_ever(&self) -> Result<(), ClientError> {
        Ok(self.read.get_ref().set_read_timeout(None)?)
    }

    /// Waits for what comes next.
    ///
    /// # Errors
    ///
    /// The connection is lost, nothing came within the time to wait, or what came is not a
    /// message.
    pub fn receive(&mut self) -> Result<Received<'_>, ClientError> {
        self.line.clear();
        let in_time = |error| ClientError::of_read(error, &self.path, self.wait);
        let read = self.read.read_until(b'\n', &mut self.line);
        if read.map_err(in_time)? == 0 {
            return Err(ClientError::Ended);
        }
        let head: Head = serde_json::from_slice(&self.line)?;
        if let Some(missed) = head.missed {
            return Ok(Received::Missed(missed));
        }
        let (Some(topic), Some(length)) = (head.topic, head.bytes.filter(|&n| n <= LARGEST)) else {
            let line = String::from_utf8_lossy(&self.line);
            let error = format!("a message without topic or length: {}", line.trim_end());
            return Err(io::Error::new(io::ErrorKind::InvalidData, error).into());
        };
        self.topic = topic;
        self.bytes.resize(length, 0);
        self.read.read_exact(&mut self.bytes).map_err(in_time)?;
        Ok(Received::Message(Message {
            topic: &self.topic,
            bytes: &self.bytes,
        }))
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may fail")]
mod tests {
    use std::{os::unix::net::UnixListener, thread};

    use super::*;

    /// A stream whose daemon answers with `bytes`, and the line that opened it.
    fn stream(bytes: &'static [u8]) -> (Result<MessageStream, ClientError>, String) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("socket");
        let listener = UnixListener::bind(&path).unwrap();
        let daemon = thread::spawn(move || {
            let (stream, _) = listener.accept().unwrap();
            let mut line = String::new();
            BufReader::new(&stream).read_line(&mut line).unwrap();
            (&stream).write_all(bytes).unwrap();
            line
        });
        let opened = MessageStream::open(&path, &["/odom"], Duration::from_secs(5));
        (opened, daemon.join().unwrap())
    }

    #[test]
    fn messages_are_received_with_every_byte() {
        let (opened, line) = stream(
            b"{\"version\":3,\"ok\":true,\"clocks\":{\"monotonic_ns\":1,\"wall_ns\":2}}\n\
              {\"topic\":\"/odom\",\"bytes\":4}\n\x00\n\x01\x02{\"version\":3,\"missed\":7}\n\
              {\"topic\":\"/tf\",\"bytes\":0}\n",
        );
        assert_eq!(
            line,
            "{\"version\":3,\"command\":\"messages\",\"topics\":[\"/odom\"]}\n"
        );
        let mut stream = opened.unwrap();
        let clocks = Clocks {
            monotonic_ns: 1,
            wall_ns: 2,
        };
        assert_eq!(stream.clocks, clocks);
        let message = |topic, bytes| Received::Message(Message { topic, bytes });
        assert_eq!(
            stream.receive().unwrap(),
            message("/odom", b"\x00\n\x01\x02")
        );
        assert_eq!(stream.receive().unwrap(), Received::Missed(7));
        assert_eq!(stream.receive().unwrap(), message("/tf", b""));
        let end = stream.receive().unwrap_err();
        assert!(matches!(end, ClientError::Ended), "{end}");
    }

    #[test]
    fn a_length_beyond_every_message_is_refused_before_memory_is_taken() {
        let (opened, _) = stream(
            b"{\"version\":3,\"ok\":true,\"clocks\":{\"monotonic_ns\":1,\"wall_ns\":2}}\n\
              {\"topic\":\"/odom\",\"bytes\":99999999999}\n",
        );
        let error = opened.unwrap().receive().unwrap_err().to_string();
        assert!(error.contains("99999999999"), "{error}");
    }

    #[test]
    fn a_topic_that_the_daemon_does_not_know_is_refused_with_its_words() {
        let (opened, _) = stream(b"{\"version\":3,\"ok\":false,\"error\":\"no such topic\"}\n");
        assert_eq!(opened.unwrap_err().to_string(), "no such topic");
    }
}
