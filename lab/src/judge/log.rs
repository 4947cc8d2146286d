//! What a judge reads of a record: poses, events and commands, tick by tick.

use std::path::Path;

use singletrack_control::Time;
use singletrack_mocap::Observation;
use singletrack_pilot::{Commanded, Event, Mode};
use singletrack_record::{Entry, Reader, RecordError, TickRecord, Topic};

/// A record, as a pilot is fed from it.
#[derive(Debug, Default)]
pub(super) struct Log {
    pub(super) ticks: Vec<Tick>,
    /// What the cameras saw, in the order of its arrival.
    pub(super) frames: Vec<Observation>,
    /// Whether a speed was commanded in any tick.
    pub(super) has_speed: bool,
    /// Whether the board ever told its status.
    pub(super) has_health: bool,
    /// Whether the attitude was ever measured.
    pub(super) has_attitude: bool,
}

/// A tick of a record.
#[derive(Debug)]
pub(super) struct Tick {
    pub(super) time: Time,
    /// The events without those of the cameras, unless the record has no frames.
    pub(super) events: Vec<Event>,
    pub(super) commanded: Commanded,
}

impl Log {
    pub(super) fn read(path: &Path) -> Result<Self, RecordError> {
        let mut log = Self::default();
        for entry in Reader::open(path)?.only(&[Topic::Tick, Topic::Pose]) {
            match entry? {
                Entry::Tick(tick) => log.tick(&tick),
                Entry::Pose(frame) => log.frames.push(frame),
                _ => {}
            }
        }
        log.frames.sort_by_key(|frame| frame.receive_time_ns);
        if !log.frames.is_empty() {
            let from_cameras =
                |event: &Event| matches!(event, Event::Pose(_) | Event::PoseMissing(_));
            for tick in &mut log.ticks {
                tick.events.retain(|event| !from_cameras(event));
            }
        }
        if !log.has_health {
            // An import takes the delays of the sensors away: its last samples are older than its end.
            let from_board = |tick: &Tick| {
                tick.events
                    .iter()
                    .any(|event| matches!(event, Event::Board(_)))
            };
            let last = log.ticks.iter().rposition(from_board);
            log.ticks.truncate(last.map_or(0, |last| last + 1));
        }
        Ok(log)
    }

    fn tick(&mut self, tick: &TickRecord) {
        let output = &tick.output;
        let command = output.command;
        self.has_speed |= command.is_some();
        for event in &tick.events {
            self.has_health |= matches!(event, Event::Health(_));
            self.has_attitude |= matches!(event, Event::Attitude(_));
        }
        self.ticks.push(Tick {
            time: tick.pilot_time,
            events: tick.events.to_vec(),
            commanded: Commanded {
                steering: command.map_or(output.actuation.steering, |command| command.steering),
                speed: command.map(|command| command.rear_speed),
                drives: matches!(output.mode, Mode::Driving | Mode::Slowing),
            },
        });
    }

    /// From the first tick to the last, in s.
    pub(super) fn duration(&self) -> f64 {
        match (self.ticks.first(), self.ticks.last()) {
            (Some(first), Some(last)) => last.time.seconds_since(first.time),
            _ => 0.0,
        }
    }
}
