//! The events of a pad: from an event device of the kernel, or from a pipe that carries what
//! such a device gives (`cat /dev/input/event7`).

use std::{
    fs::{File, OpenOptions},
    io::{self, Read as _},
    os::{
        fd::{AsFd, BorrowedFd},
        unix::fs::{FileTypeExt as _, OpenOptionsExt as _},
    },
    path::Path,
};

use evdev::{EventType, InputEvent, raw_stream::RawDevice};
use rustix::fs::OFlags;

use super::pad::PadEvent;

/// Size of the kernel's `struct input_event`: two words of time, type, code and value.
const EVENT: usize = 2 * WORD + 8;
const WORD: usize = size_of::<usize>();

/// The range of a stick that does not state one.
const RANGE: (i32, i32) = (-32_768, 32_767);

/// Types and codes of `linux/input-event-codes.h`.
const SYN_DROPPED: u16 = 3;
/// Axes up to this code have a range.
const AXES: usize = 0x40;

/// A source of events.
pub(super) enum Source {
    Device(Box<Device>),
    Pipe(Pipe),
}

/// An event device of the kernel.
pub(super) struct Device {
    device: RawDevice,
    ranges: [(i32, i32); AXES],
}

/// A pipe with the bytes of one.
pub(super) struct Pipe {
    file: File,
    /// The beginning of an event.
    rest: Vec<u8>,
    /// Whether anything has come: a pipe that had no writer yet also reads as ended.
    is_begun: bool,
}

impl Source {
    /// Opens the device or the pipe. The first events are the present state of a device.
    pub(super) fn open(path: &Path) -> io::Result<(Self, Vec<PadEvent>)> {
        if !std::fs::metadata(path)?.file_type().is_char_device() {
            let file = OpenOptions::new()
                .read(true)
                .custom_flags(OFlags::NONBLOCK.bits() as i32)
                .open(path)?;
            let (rest, is_begun) = (Vec::new(), false);
            let pipe = Pipe {
                file,
                rest,
                is_begun,
            };
            return Ok((Self::Pipe(pipe), Vec::new()));
        }
        let device = RawDevice::open(path)?;
        rustix::fs::fcntl_setfl(&device, OFlags::NONBLOCK)?;
        let mut ranges = [RANGE; AXES];
        for (axis, info) in device.get_absinfo()? {
            if let Some(range) = ranges.get_mut(usize::from(axis.0)) {
                *range = (info.minimum(), info.maximum());
            }
        }
        let device = Box::new(Device { device, ranges });
        let state = device.state()?;
        Ok((Self::Device(device), state))
    }

    /// The name of the device.
    pub(super) fn name(&self) -> Option<&str> {
        match self {
            Self::Device(device) => device.device.name(),
            Self::Pipe(_) => None,
        }
    }

    /// Adds the events since the last call. A pad that can't be read is lost.
    pub(super) fn read(&mut self, events: &mut Vec<PadEvent>) {
        let result = match self {
            Self::Device(device) => device.read(events),
            Self::Pipe(pipe) => pipe.read(events),
        };
        let is_lost = result.is_err_and(|error| {
            let kind = error.kind();
            !matches!(kind, io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted)
        });
        if is_lost {
            events.push(PadEvent::Lost);
        }
    }
}

impl AsFd for Source {
    fn as_fd(&self) -> BorrowedFd<'_> {
        match self {
            Self::Device(device) => device.device.as_fd(),
            Self::Pipe(pipe) => pipe.file.as_fd(),
        }
    }
}

impl Device {
    fn read(&mut self, events: &mut Vec<PadEvent>) -> io::Result<()> {
        let mut is_dropped = false;
        for event in self.device.fetch_events()? {
            let event = pad_event(event, &self.ranges);
            is_dropped |= event == PadEvent::Dropped;
            events.push(event);
        }
        if is_dropped {
            events.extend(self.state()?);
        }
        Ok(())
    }

    /// The present buttons and sticks.
    fn state(&self) -> io::Result<Vec<PadEvent>> {
        let pressed = self.device.get_key_state()?;
        let keys = self.device.supported_keys().into_iter();
        let keys = keys.flat_map(|keys| keys.iter());
        let buttons = keys.map(|key| PadEvent::Button {
            code: key.0,
            pressed: pressed.contains(key),
        });
        let sticks = self
            .device
            .get_absinfo()?
            .map(|(axis, info)| PadEvent::Axis {
                code: axis.0,
                value: share(axis.0, info.value(), &self.ranges),
            });
        Ok(buttons.chain(sticks).collect())
    }
}

impl Pipe {
    fn read(&mut self, events: &mut Vec<PadEvent>) -> io::Result<()> {
        let mut buffer = [0; 64 * EVENT];
        loop {
            let count = self.file.read(&mut buffer)?;
            if count == 0 {
                if self.is_begun {
                    events.push(PadEvent::Lost);
                }
                return Ok(());
            }
            self.is_begun = true;
            self.rest.extend(buffer.iter().take(count));
            let whole = self.rest.len() - self.rest.len() % EVENT;
            let parsed: Vec<u8> = self.rest.drain(..whole).collect();
            let parsed = parsed.chunks_exact(EVENT);
            events.extend(parsed.filter_map(|bytes| parse(bytes.get(2 * WORD..)?)));
        }
    }
}

/// An event without its time.
fn parse(bytes: &[u8]) -> Option<PadEvent> {
    let [t0, t1, c0, c1, value @ ..] = bytes else {
        return None;
    };
    let [kind, code] = [[*t0, *t1], [*c0, *c1]].map(u16::from_ne_bytes);
    let value = i32::from_ne_bytes(value.try_into().ok()?);
    let event = InputEvent::new(kind, code, value);
    Some(pad_event(event, &[RANGE; AXES]))
}

fn pad_event(event: InputEvent, ranges: &[(i32, i32); AXES]) -> PadEvent {
    let code = event.code();
    match event.event_type() {
        // The value 2 repeats a key that is held.
        EventType::KEY => PadEvent::Button {
            code,
            pressed: event.value() != 0,
        },
        EventType::ABSOLUTE => PadEvent::Axis {
            code,
            value: share(code, event.value(), ranges),
        },
        EventType::SYNCHRONIZATION if code == SYN_DROPPED => PadEvent::Dropped,
        _ => PadEvent::Other,
    }
}

/// The position of a stick, -1 to 1.
fn share(axis: u16, value: i32, ranges: &[(i32, i32); AXES]) -> f64 {
    let range = ranges.get(usize::from(axis)).copied().unwrap_or(RANGE);
    let (low, high) = (f64::from(range.0), f64::from(range.1));
    if high > low {
        ((2.0 * f64::from(value) - low - high) / (high - low)).clamp(-1.0, 1.0)
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recording_of_an_event_device_is_read_and_its_end_is_the_loss_of_the_pad() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("recording");
        let mut bytes = Vec::new();
        // EV_KEY BTN_TR pressed, EV_ABS ABS_Y fully up, SYN_REPORT, SYN_DROPPED.
        for (kind, code, value) in [
            (1_u16, 0x137_u16, 1_i32),
            (3, 1, -32_768),
            (0, 0, 0),
            (0, 3, 0),
        ] {
            bytes.extend([7; 2 * WORD]);
            bytes.extend(kind.to_ne_bytes());
            bytes.extend(code.to_ne_bytes());
            bytes.extend(value.to_ne_bytes());
        }
        // The last event is cut short.
        bytes.extend([0; 5]);
        std::fs::write(&path, &bytes).unwrap();
        let (mut source, first) = Source::open(&path).unwrap();
        assert_eq!(first, []);
        let mut events = Vec::new();
        source.read(&mut events);
        assert_eq!(
            events,
            [
                PadEvent::Button {
                    code: 0x137,
                    pressed: true
                },
                PadEvent::Axis {
                    code: 1,
                    value: -1.0
                },
                PadEvent::Other,
                PadEvent::Dropped,
                PadEvent::Lost,
            ]
        );
    }

    #[test]
    fn a_pipe_without_a_writer_is_not_a_lost_pad() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pipe");
        rustix::fs::mkfifoat(rustix::fs::CWD, &path, 0o600.into()).unwrap();
        let (mut source, _) = Source::open(&path).unwrap();
        let mut events = Vec::new();
        source.read(&mut events);
        assert_eq!(events, []);
        let writer = OpenOptions::new().write(true).open(&path).unwrap();
        source.read(&mut events);
        assert_eq!(events, []);
        drop(writer);
        // The writer has closed the pipe without having written.
        source.read(&mut events);
        assert_eq!(events, []);
    }
}
