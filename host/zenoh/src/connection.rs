//! A connection: a socket here, and two keys to its other end.

use std::{
    io::{self, Read as _, Write as _},
    net::Shutdown,
    os::unix::net::UnixStream,
    sync::{
        Arc,
        mpsc::{Receiver, SyncSender, sync_channel},
    },
    thread,
};

use zenoh::{
    Session, Wait as _,
    bytes::ZBytes,
    pubsub::{Publisher, Subscriber},
    qos::{CongestionControl, Priority},
    sample::Sample,
};

/// The longest piece that is sent at once, in bytes.
const PIECE: usize = 16_384;

/// Pieces that wait for a reader here; one that is slower is cut off, so that it holds up no other.
const WAITING: usize = 256;

/// Bytes of the number before each piece: a piece that is lost ends the connection.
const NUMBER: usize = size_of::<u64>();

/// One end of a connection.
pub(crate) struct Connection {
    stream: UnixStream,
    cut: Cut,
    publisher: Publisher<'static>,
    _subscriber: Subscriber<()>,
    pieces: Receiver<Vec<u8>>,
}

impl Connection {
    /// What comes by the key `receive` is for `stream`, and what `stream` sends goes by `send`.
    pub(crate) fn declare(
        session: &Session,
        stream: UnixStream,
        send: String,
        receive: String,
    ) -> zenoh::Result<Self> {
        let (sender, pieces) = sync_channel(WAITING);
        let cut = Cut {
            stream: stream.try_clone()?.into(),
            sender,
        };
        let mut hear = hear(cut.clone());
        let subscriber = session
            .declare_subscriber(receive)
            .callback_mut(move |sample: Sample| hear(&sample.payload().to_bytes()))
            .wait()?;
        let publisher = session
            .declare_publisher(send)
            .congestion_control(CongestionControl::Block)
            .priority(Priority::InteractiveHigh)
            .express(true)
            .wait()?;
        Ok(Self {
            stream,
            cut,
            publisher,
            _subscriber: subscriber,
            pieces,
        })
    }

    /// What ends it from elsewhere.
    pub(crate) fn cut(&self) -> Cut {
        self.cut.clone()
    }

    /// Carries both directions until both have ended, or it is cut off.
    pub(crate) fn carry(self) -> io::Result<()> {
        let Self {
            stream,
            cut,
            publisher,
            _subscriber,
            pieces,
        } = self;
        let source = stream.try_clone()?;
        let sender = thread::Builder::new().spawn(move || {
            if send(&source, &publisher).is_err() {
                // Nothing more comes through: the other direction ends with it.
                cut.off();
            }
        })?;
        let received = receive(&stream, &pieces);
        if received.is_err() {
            let _ = stream.shutdown(Shutdown::Both);
        }
        // A thread that has panicked sends no more.
        let _ = sender.join();
        received
    }
}

/// Ends a connection at once, whoever waits for what.
#[derive(Clone, Debug)]
pub(crate) struct Cut {
    stream: Arc<UnixStream>,
    sender: SyncSender<Vec<u8>>,
}

impl Cut {
    pub(crate) fn off(&self) {
        // It fails for one that has ended.
        let _ = self.stream.shutdown(Shutdown::Both);
        // Wakes the receiver that waits; if the queue is full, it does not wait.
        let _ = self.sender.try_send(Vec::new());
    }
}

/// Checks and keeps pieces, and cuts the connection off when one is missing or too many wait. An
/// empty piece is the end.
fn hear(cut: Cut) -> impl FnMut(&[u8]) {
    let mut expected = 0_u64;
    move |bytes| {
        let kept = bytes
            .split_first_chunk::<NUMBER>()
            .filter(|(number, _)| u64::from_le_bytes(**number) == expected)
            .is_some_and(|(_, piece)| cut.sender.try_send(piece.to_owned()).is_ok());
        expected = expected.saturating_add(1);
        if !kept {
            cut.off();
        }
    }
}

/// Sends what the socket says, and then its end.
fn send(mut source: &UnixStream, publisher: &Publisher<'_>) -> zenoh::Result<()> {
    let mut piece = vec![0; NUMBER + PIECE];
    let mut number = 0_u64;
    loop {
        let (head, body) = piece.split_at_mut(NUMBER);
        head.copy_from_slice(&number.to_le_bytes());
        let length = source.read(body)?;
        let bytes = piece.get(..NUMBER + length).unwrap_or_default();
        publisher.put(ZBytes::from(bytes)).wait()?;
        if length == 0 {
            return Ok(());
        }
        number += 1;
    }
}

/// Hands over what was heard until the end.
fn receive(mut sink: &UnixStream, pieces: &Receiver<Vec<u8>>) -> io::Result<()> {
    for piece in pieces {
        if piece.is_empty() {
            break;
        }
        sink.write_all(&piece)?;
    }
    sink.shutdown(Shutdown::Write)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may fail")]
mod tests {
    use std::sync::mpsc::TryRecvError;

    use super::*;

    fn piece(number: u64, text: &[u8]) -> Vec<u8> {
        [&number.to_le_bytes(), text].concat()
    }

    fn end(near: &UnixStream) -> (Cut, Receiver<Vec<u8>>) {
        let (sender, pieces) = sync_channel(WAITING);
        let stream = near.try_clone().unwrap().into();
        (Cut { stream, sender }, pieces)
    }

    fn is_cut(mut end: &UnixStream) -> bool {
        end.set_nonblocking(true).unwrap();
        end.read(&mut [0]).is_ok_and(|length| length == 0)
    }

    #[test]
    fn pieces_in_their_order_are_handed_over_until_one_is_missing() {
        let (near, far) = UnixStream::pair().unwrap();
        let (cut, pieces) = end(&near);
        let mut hear = hear(cut);
        hear(&piece(0, b"one"));
        hear(&piece(1, b"two"));
        assert_eq!(pieces.try_recv().unwrap(), b"one");
        assert_eq!(pieces.try_recv().unwrap(), b"two");
        assert!(!is_cut(&far));
        hear(&piece(3, b"four"));
        assert!(is_cut(&far));
        assert!(pieces.try_recv().unwrap().is_empty());
        assert_eq!(pieces.try_recv(), Err(TryRecvError::Empty));
    }

    #[test]
    fn who_does_not_read_is_cut_off_and_holds_up_nobody() {
        let (near, far) = UnixStream::pair().unwrap();
        let (cut, _pieces) = end(&near);
        let mut hear = hear(cut);
        for number in 0..256 {
            hear(&piece(number, b"state"));
        }
        assert!(!is_cut(&far));
        hear(&piece(256, b"state"));
        assert!(is_cut(&far));
    }

    #[test]
    fn who_waits_for_a_lost_other_end_is_woken() {
        let (near, far) = UnixStream::pair().unwrap();
        let (cut, pieces) = end(&near);
        let waits = thread::spawn(move || receive(&near, &pieces));
        cut.off();
        // It ends, with the error of a socket that is shut down or without.
        let _ = waits.join().unwrap();
        assert!(is_cut(&far));
    }

    #[test]
    fn the_end_of_one_direction_leaves_the_other() {
        let (near, mut far) = UnixStream::pair().unwrap();
        let (cut, pieces) = end(&near);
        let mut hear = hear(cut);
        hear(&piece(0, b"status\n"));
        hear(&piece(1, b""));
        receive(&near, &pieces).unwrap();
        let mut heard = String::new();
        far.read_to_string(&mut heard).unwrap();
        assert_eq!(heard, "status\n");
        far.write_all(b"answer").unwrap();
        let mut answer = [0; 6];
        (&near).read_exact(&mut answer).unwrap();
        assert_eq!(&answer, b"answer");
    }
}
