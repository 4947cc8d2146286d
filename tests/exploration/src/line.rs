//! The serial line: whole frames, in order, each of them lost, late or twice.

use singletrack_protocol::{Decoder, Frame, Packet, ToBoard, ToHost};

/// What happens to the frames of a tick.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Passage {
    /// They arrive, after those that are late.
    #[default]
    Whole,
    /// They are lost.
    Lost,
    /// They wait for the next tick, with those that are late.
    Late,
    /// Each arrives, and once more in the next tick.
    Twice,
}

/// A message of one direction.
pub(crate) trait Wire: Copy + core::fmt::Debug {
    fn decode(packet: Packet<'_>) -> Option<Self>;
    fn encode(&self) -> Frame;
}

impl Wire for ToBoard {
    fn decode(packet: Packet<'_>) -> Option<Self> {
        Self::decode(packet).ok()
    }

    fn encode(&self) -> Frame {
        self.encode()
    }
}

impl Wire for ToHost {
    fn decode(packet: Packet<'_>) -> Option<Self> {
        Self::decode(packet).ok()
    }

    fn encode(&self) -> Frame {
        self.encode()
    }
}

/// Frames under way, as messages, which can be compared.
#[derive(Clone, Debug)]
pub(crate) struct Line<M> {
    /// Nothing passes, until it is mended.
    pub(crate) is_cut: bool,
    waiting: Vec<M>,
}

impl<M: Wire> Line<M> {
    pub(crate) const fn new() -> Self {
        Self {
            is_cut: false,
            waiting: Vec::new(),
        }
    }

    /// The messages in these bytes: whole frames, as they were written.
    pub(crate) fn messages(bytes: &[u8]) -> Vec<M> {
        let mut decoder = Decoder::new();
        let mut messages = Vec::new();
        for &byte in bytes {
            if let Some(Ok(packet)) = decoder.push(byte) {
                messages.extend(M::decode(packet));
            }
        }
        messages
    }

    /// What arrives of the frames that were sent in this tick.
    pub(crate) fn pass(&mut self, sent: Vec<M>, passage: Passage) -> Vec<M> {
        let mut arrived = core::mem::take(&mut self.waiting);
        match passage {
            _ if self.is_cut => arrived.clear(),
            Passage::Whole => arrived.extend(sent),
            Passage::Lost => {}
            Passage::Late => {
                arrived.extend(sent);
                self.waiting = core::mem::take(&mut arrived);
            }
            Passage::Twice => {
                arrived.extend(&sent);
                self.waiting = sent;
            }
        }
        arrived
    }

    /// Nothing is under way any more.
    pub(crate) fn clear(&mut self) {
        self.waiting.clear();
    }
}

/// The bytes of messages.
pub(crate) fn bytes<M: Wire>(messages: &[M]) -> Vec<u8> {
    let mut bytes = Vec::new();
    for message in messages {
        bytes.extend_from_slice(message.encode().as_bytes());
    }
    bytes
}
