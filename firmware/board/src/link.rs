//! The board's end of the serial line, and the newest IMU sample with whether it has been sent.

use singletrack_protocol::{
    Decoder, Frame, Hello, Identity, ImuAxes, ImuState, Message, ToBoard, ToHost, UNSOLICITED,
    VERSION,
};

use crate::{
    ImuSample,
    clock::{Stopwatch, age_us},
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

/// Time without a sample after which the IMU counts as silent.
const SILENCE_US: u32 = 50_000;

/// The registers `AXIS_MAP_CONFIG` and `AXIS_MAP_SIGN` of a BNO055 that is mounted like
/// this: they turn all of its values to the car's axes.
pub const fn axis_map(axes: ImuAxes) -> [u8; 2] {
    let ImuAxes { forward, left, up } = axes;
    [
        forward.index() | left.index() << 2 | up.index() << 4,
        (forward.is_negative() as u8) << 2
            | (left.is_negative() as u8) << 1
            | up.is_negative() as u8,
    ]
}

#[derive(Clone, Debug)]
pub(crate) struct Imu {
    /// The newest sample; zeros before the first.
    sample: ImuSample,
    has_sample: bool,
    since_sample: Stopwatch,
    /// The sample has not been sent yet.
    unsent: bool,
}

impl Imu {
    pub(crate) const fn new() -> Self {
        Self {
            sample: ImuSample {
                time_us: 0,
                linear_acceleration_mm_s2: [0; 3],
                angular_velocity_mrad_s: [0; 3],
                attitude_q14: [0; 4],
            },
            has_sample: false,
            since_sample: Stopwatch::started_ago(u32::MAX),
            unsent: false,
        }
    }

    pub(crate) fn observe(&mut self, now_us: u32, elapsed_us: u32, newest: Option<&ImuSample>) {
        self.since_sample.advance(elapsed_us);
        let Some(newest) = newest else { return };
        if !self.has_sample || self.sample.time_us != newest.time_us {
            self.sample = *newest;
            self.has_sample = true;
            self.unsent = true;
            let age = age_us(now_us, newest.time_us).unwrap_or(0);
            self.since_sample = Stopwatch::started_ago(age);
        }
    }

    /// The newest sample; zeros before the first.
    pub(crate) const fn sample(&self) -> &ImuSample {
        &self.sample
    }

    pub(crate) const fn state(&self) -> ImuState {
        if self.since_sample.elapsed_us() >= SILENCE_US {
            ImuState::Silent
        } else if self.unsent {
            ImuState::Fresh
        } else {
            ImuState::Repeated
        }
    }

    /// Age of the sample in units of 100 µs, saturating.
    pub(crate) fn age_100us(&self) -> u8 {
        let limit_us = u16::from(u8::MAX) * 100;
        let age_us = u16::try_from(self.since_sample.elapsed_us()).unwrap_or(u16::MAX);
        (age_us.min(limit_us) / 100) as u8
    }

    /// Notes that the newest sample has been sent.
    pub(crate) const fn sent(&mut self) {
        self.unsent = false;
    }
}

#[cfg(test)]
mod tests {
    use singletrack_protocol::{ImuAxes, ImuAxis};

    use super::axis_map;

    #[test]
    fn mountings_have_the_data_sheets_registers() {
        // BST-BNO055-DS000, 3.4: placements P0 to P7. P1 is as printed.
        let [x, y, z] = [ImuAxis::PlusX, ImuAxis::PlusY, ImuAxis::PlusZ];
        let [minus_x, minus_y, minus_z] = [ImuAxis::MinusX, ImuAxis::MinusY, ImuAxis::MinusZ];
        for (forward, left, up, registers) in [
            (minus_y, x, z, [0x21, 0x04]),
            (x, y, z, [0x24, 0x00]),
            (minus_x, minus_y, z, [0x24, 0x06]),
            (y, minus_x, z, [0x21, 0x02]),
            (x, minus_y, minus_z, [0x24, 0x03]),
            (y, x, minus_z, [0x21, 0x01]),
            (minus_y, minus_x, minus_z, [0x21, 0x07]),
            (minus_x, y, minus_z, [0x24, 0x05]),
        ] {
            let axes = ImuAxes { forward, left, up };
            assert!(axes.is_mounting());
            assert_eq!(axis_map(axes), registers, "{axes:?}");
        }
    }
}
