//! The daemon's serial port as the kernel implements it: it is plugged in or not, takes
//! whole frames, and keeps unread bytes.

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use singletrack_core::line::{Line, OutputQueue, PortRead, Sent};

/// A transfer of a genuine UNO as its driver counts it, however short it is, in bytes, and the
/// bytes that the UNO's serial chip takes before a transfer waits.
const TRANSFER: usize = 1_280;
const CHIP: usize = 128;

/// What a driver reports of its output queue.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Reported {
    /// Nothing, as a pseudo-terminal.
    #[default]
    Nothing,
    /// The bytes.
    Bytes,
    /// Whole transfers.
    Transfers,
}

/// The bytes that Linux keeps until they are read: 4095 in the line discipline and
/// 64 KiB in the buffers before it. Further bytes are lost.
const UNREAD: usize = 4_095 + 65_536;

#[derive(Debug, Default)]
struct State {
    plugged: bool,
    reported: Reported,
    /// Bytes in the output queue at the last query of the world, and those written since.
    queued: usize,
    /// Writes since then.
    writes: usize,
    written: Vec<u8>,
}

/// The port.
#[derive(Debug)]
pub(crate) struct Port {
    state: Arc<Mutex<State>>,
    unread: VecDeque<u8>,
    opened: bool,
}

/// The half that the control thread writes. It checks the queue as that of the daemon does, see
/// `singletrackd::serial_port`.
#[derive(Debug)]
pub(crate) struct WriteHalf {
    state: Arc<Mutex<State>>,
    queue: OutputQueue,
}

fn lock(state: &Arc<Mutex<State>>) -> MutexGuard<'_, State> {
    // One thread has both ends.
    state.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Port {
    pub(crate) fn new(reported: Reported) -> Self {
        let state = State {
            plugged: true,
            reported,
            ..State::default()
        };
        Self {
            state: Arc::new(Mutex::new(state)),
            unread: VecDeque::new(),
            opened: false,
        }
    }

    pub(crate) fn set_plugged(&mut self, plugged: bool) {
        lock(&self.state).plugged = plugged;
        if !plugged {
            self.unread.clear();
        }
    }

    pub(crate) fn is_plugged(&self) -> bool {
        lock(&self.state).plugged
    }

    pub(crate) fn set_queued(&self, bytes: usize) {
        let mut state = lock(&self.state);
        (state.queued, state.writes) = (bytes, 0);
    }

    /// Takes the bytes that the daemon has written since the last call.
    pub(crate) fn take_written(&self, into: &mut Vec<u8>) {
        into.append(&mut lock(&self.state).written);
    }

    /// Bytes have come from the board.
    pub(crate) fn receive(&mut self, bytes: &[u8]) {
        let room = UNREAD.saturating_sub(self.unread.len());
        self.unread.extend(bytes.iter().take(room));
    }

    /// Whether the port was opened since the last call.
    pub(crate) const fn take_opened(&mut self) -> bool {
        core::mem::replace(&mut self.opened, false)
    }
}

impl singletrack_core::line::Port for Port {
    type Line = WriteHalf;

    /// Drops unread bytes: they belong to an earlier connection.
    fn open(&mut self) -> Option<WriteHalf> {
        if !self.is_plugged() {
            return None;
        }
        self.unread.clear();
        self.opened = true;
        Some(WriteHalf {
            state: Arc::clone(&self.state),
            queue: OutputQueue::default(),
        })
    }

    fn read(&mut self, buffer: &mut [u8]) -> PortRead {
        if !self.is_plugged() {
            return PortRead::HungUp;
        }
        let count = buffer.len().min(self.unread.len());
        for (to, from) in buffer.iter_mut().zip(self.unread.drain(..count)) {
            *to = from;
        }
        match count {
            0 => PortRead::Nothing,
            count => PortRead::Bytes(count),
        }
    }

    fn close(&mut self) {}
}

impl Line for WriteHalf {
    fn write_frame(&mut self, frame: &[u8]) -> Sent {
        let mut state = lock(&self.state);
        let queued = match state.reported {
            Reported::Nothing => 0,
            Reported::Bytes => state.queued,
            Reported::Transfers => {
                let waiting = state.queued.saturating_sub(CHIP).div_ceil(frame.len());
                (waiting + state.writes) * TRANSFER
            }
        };
        if !state.plugged || !self.queue.has_room(queued) {
            return Sent::Dropped;
        }
        self.queue.wrote(frame.len());
        state.queued += frame.len();
        state.writes += 1;
        state.written.extend_from_slice(frame);
        Sent::Whole
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test fails by panicking")]
mod tests {
    use singletrack_core::line::{Line, Port as _, Sent};
    use singletrack_protocol::{Drive, Message, frame_length};

    use super::{Port, Reported};

    const DRIVE: [u8; frame_length(Drive::PAYLOAD_LENGTH)] =
        [1; frame_length(Drive::PAYLOAD_LENGTH)];

    #[test]
    fn every_port_takes_a_second_frame_in_a_tick_and_no_third_unless_it_hides_its_queue() {
        for reported in [Reported::Nothing, Reported::Bytes, Reported::Transfers] {
            let mut port = Port::new(reported);
            let mut line = port.open().unwrap();
            for _ in 0..3 {
                port.set_queued(0);
                let sent = [(); 3].map(|()| line.write_frame(&DRIVE));
                let third = if reported == Reported::Nothing {
                    Sent::Whole
                } else {
                    Sent::Dropped
                };
                assert_eq!(sent, [Sent::Whole, Sent::Whole, third], "{reported:?}");
            }
        }
    }
}
