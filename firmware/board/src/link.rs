//! The board's end of the serial line.

use singletrack_protocol::{
    Decoder, Frame, Hello, Identity, Message, ToBoard, ToHost, UNSOLICITED, VERSION,
};

/// Receiver, counters, and pending greetings.
#[derive(Clone, Debug)]
pub(crate) struct Link {
    decoder: Decoder,
    software_version: [u8; 3],
    car_id: u16,
    session: Option<Session>,
    /// Nonces of pending greetings: the announcement of the start, and an answer.
    announcement: Option<u32>,
    greeting: Option<u32>,
    /// A greeting was sent without the identity that follows it.
    identity_due: bool,
    pub(crate) frames_received: u16,
    pub(crate) frames_damaged: u16,
    pub(crate) frames_dropped: u16,
}

/// The last greeting of the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Session {
    nonce: u32,
    version: u16,
}

impl Link {
    pub(crate) const fn new(software_version: [u8; 3], car_id: u16) -> Self {
        Self {
            decoder: Decoder::new(),
            software_version,
            car_id,
            session: None,
            announcement: Some(UNSOLICITED),
            greeting: None,
            identity_due: false,
            frames_received: 0,
            frames_damaged: 0,
            frames_dropped: 0,
        }
    }

    pub(crate) const fn car_id(&self) -> u16 {
        self.car_id
    }

    /// Processes a byte; returns the message that it completes.
    #[inline(always)]
    pub(crate) fn receive(&mut self, byte: u8) -> Option<ToBoard> {
        // Fast path of a few cycles for nearly all bytes.
        if !self.decoder.push_data(byte) {
            return self.end_of_frame();
        }
        None
    }

    #[inline(never)]
    fn end_of_frame(&mut self) -> Option<ToBoard> {
        let outcome = self.decoder.push(0)?;
        match outcome.ok().and_then(|packet| ToBoard::decode(packet).ok()) {
            Some(message) => {
                self.frames_received = self.frames_received.wrapping_add(1);
                Some(message)
            }
            None => {
                self.frames_damaged = self.frames_damaged.wrapping_add(1);
                None
            }
        }
    }

    /// Notes a greeting, to be answered. Returns whether it starts another session.
    pub(crate) fn greeted(&mut self, hello: &Hello) -> bool {
        if hello.nonce == UNSOLICITED {
            // The board's own announcement, echoed by the line; no host sends this nonce.
            return false;
        }
        let session = Some(Session {
            nonce: hello.nonce,
            version: hello.protocol_version,
        });
        let another = self.session != session;
        self.session = session;
        self.greeting = Some(hello.nonce);
        another
    }

    /// Whether the host has greeted with another protocol version.
    pub(crate) fn version_differs(&self) -> bool {
        self.session
            .is_some_and(|session| session.version != VERSION)
    }

    /// Sends pending greetings; one that does not fit stays pending.
    pub(crate) fn greet(&mut self, transmit: &mut impl FnMut(&[u8]) -> bool) {
        if self.announcement.is_some() || self.greeting.is_some() || self.identity_due {
            self.greet_now(transmit);
        }
    }

    #[inline(never)]
    fn greet_now(&mut self, transmit: &mut impl FnMut(&[u8]) -> bool) {
        // The zero ends a frame that a reset cut off. Otherwise the host would
        // decode that frame and the announcement as one corrupted frame.
        if self.announcement.is_some() && !transmit(&[0]) {
            return;
        }
        for due in [&mut self.announcement, &mut self.greeting] {
            let Some(nonce) = *due else { continue };
            if !send_hello(self.software_version, nonce, transmit) {
                return;
            }
            *due = None;
            self.identity_due = true;
        }
        if self.identity_due {
            let identity = Identity {
                car_id: self.car_id,
            };
            let mut frame = Frame::new();
            identity.encode_into(&mut frame);
            self.identity_due = !transmit(frame.as_bytes());
        }
    }

    /// Sends a message, or drops and counts it if the line is full: the host
    /// repeats its requests, and records are periodic.
    pub(crate) fn send<M: Message + Into<ToHost>>(
        &mut self,
        message: &M,
        transmit: &mut impl FnMut(&[u8]) -> bool,
    ) -> bool {
        let mut frame = Frame::new();
        message.encode_into(&mut frame);
        let sent = transmit(frame.as_bytes());
        if !sent {
            self.frames_dropped = self.frames_dropped.wrapping_add(1);
        }
        sent
    }
}

#[inline(never)]
fn send_hello(
    software_version: [u8; 3],
    nonce: u32,
    transmit: &mut impl FnMut(&[u8]) -> bool,
) -> bool {
    let hello = Hello {
        protocol_version: VERSION,
        software_version,
        nonce,
    };
    let mut frame = Frame::new();
    hello.encode_into(&mut frame);
    transmit(frame.as_bytes())
}
