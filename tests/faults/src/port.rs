//! The daemon's serial port as the kernel implements it: it is plugged in or not, takes
//! whole frames, and keeps unread bytes.

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use singletrack_core::line::{Line, PortRead, Sent};
use singletrack_protocol::{Drive, Message, frame_length};

/// A device that reports its queue takes nothing while more bytes than this wait: the
/// daemon checks the queue, see `singletrackd::serial_port`.
const MOST_QUEUED: usize = frame_length(Drive::PAYLOAD_LENGTH);

/// The bytes that Linux keeps until they are read: 4095 in the line discipline and
/// 64 KiB in the buffers before it. Further bytes are lost.
const UNREAD: usize = 4_095 + 65_536;

#[derive(Debug, Default)]
struct State {
    plugged: bool,
    queue_shows: bool,
    /// Bytes in the output queue at the last query of the world.
    queued: usize,
    written: Vec<u8>,
}

/// The port.
#[derive(Debug)]
pub(crate) struct Port {
    state: Arc<Mutex<State>>,
    unread: VecDeque<u8>,
    opened: bool,
}

/// The half that the control thread writes.
#[derive(Debug)]
pub(crate) struct WriteHalf(Arc<Mutex<State>>);

fn lock(state: &Arc<Mutex<State>>) -> MutexGuard<'_, State> {
    // One thread has both ends.
    state.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Port {
    pub(crate) fn new(queue_shows: bool) -> Self {
        let state = State {
            plugged: true,
            queue_shows,
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
        lock(&self.state).queued = bytes;
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
        Some(WriteHalf(Arc::clone(&self.state)))
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
        let mut state = lock(&self.0);
        if !state.plugged || (state.queue_shows && state.queued > MOST_QUEUED) {
            return Sent::Dropped;
        }
        state.queued += frame.len();
        state.written.extend_from_slice(frame);
        Sent::Whole
    }
}
