//! The report of the control thread on one tick, and the ring by which it reaches the other threads.
//!
//! A [`TickRecord`] has room for many events and mostly holds two or three. To push
//! the whole record costs the control thread more than a microsecond, because the memory
//! of the ring is in the cache of another processor. So the events have a ring of their
//! own, which takes only those that exist.

use rtrb::{Consumer, Producer, RingBuffer};
use singletrack_control::Time;
use singletrack_pilot::{Event, Output};

/// The largest number of events in a tick; the control thread drops and counts the
/// rest. Ten ticks at the highest rates of cameras and board give this number, and a stall of
/// 300 ms at 100 Hz.
pub const MAX_EVENTS: usize = 64;

/// Inputs, outputs and times of a control tick.
///
/// It owns no memory on the heap, so that the control thread can push it through a ring.
/// It has room for `EVENTS` events. All times are nanoseconds on the host's monotonic
/// clock.
#[derive(Clone, Debug, PartialEq)]
pub struct TickRecord<const EVENTS: usize = MAX_EVENTS> {
    /// Counts the ticks of the daemon, from 0.
    pub index: u64,
    /// The scheduled time: a point of the control grid.
    pub scheduled_ns: u64,
    /// When the thread woke up.
    pub start_ns: u64,
    /// When the command was decided and written to the line.
    pub finish_ns: u64,
    /// Points of the grid skipped just before this tick, because the tick before took
    /// too long.
    pub skipped: u32,
    /// The time passed to [`singletrack_pilot::Pilot::step`].
    pub pilot_time: Time,
    /// The events passed to it, in order.
    pub events: heapless::Vec<Event, EVENTS>,
    /// Events since the tick before that did not fit and were not passed to the pilot.
    pub events_dropped: u32,
    /// The output of the pilot.
    pub output: Output,
    /// How the command was written; none if there was no command.
    pub drive: Option<DriveWrite>,
    /// The session with the board.
    pub link: LinkPhase,
}

impl<const EVENTS: usize> TickRecord<EVENTS> {
    /// This tick without its events.
    pub const fn without_events(&self) -> TickRecord<0> {
        self.with_events(heapless::Vec::new())
    }

    /// This tick with these events instead of its own.
    const fn with_events<const OTHERS: usize>(
        &self,
        events: heapless::Vec<Event, OTHERS>,
    ) -> TickRecord<OTHERS> {
        TickRecord {
            index: self.index,
            scheduled_ns: self.scheduled_ns,
            start_ns: self.start_ns,
            finish_ns: self.finish_ns,
            skipped: self.skipped,
            pilot_time: self.pilot_time,
            events,
            events_dropped: self.events_dropped,
            output: self.output,
            drive: self.drive,
            link: self.link,
        }
    }
}

impl TickRecord {
    /// Delay from the scheduled time to the wake-up of the thread.
    pub const fn lateness_ns(&self) -> i64 {
        self.start_ns.wrapping_sub(self.scheduled_ns) as i64
    }

    /// Time from the mid-exposure of the newest accepted pose to the write of the
    /// command based on it; none if no command was written.
    ///
    /// In a held tick the pose is an old one: this is a latency only if
    /// [`Output::held`] is false.
    pub const fn capture_to_command_ns(&self) -> Option<i64> {
        match (&self.output.command, &self.drive) {
            (Some(command), Some(drive)) if drive.written => {
                Some(drive.time_ns.wrapping_sub(command.pose_time.0) as i64)
            }
            _ => None,
        }
    }
}

/// A drive command on its way to the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DriveWrite {
    /// The command's number on the wire.
    pub sequence: u8,
    /// Whether the whole frame was written. Otherwise the line was full or closed, and
    /// no byte of the frame was written.
    pub written: bool,
    /// When the result was known.
    pub time_ns: u64,
}

singletrack_control::words! {
    /// The phase of the session with the board.
    pub enum LinkPhase {
        /// The port is closed.
        Disconnected = 1 "disconnected",
        /// The host waits for the greeting of the board.
        Greeting = 2 "greeting",
        /// The board speaks another version of the protocol.
        VersionMismatch = 3 "version-mismatch",
        /// The host has sent the configuration and waits for the answer.
        Configuring = 4 "configuring",
        /// The board refused its configuration.
        ConfigurationRefused = 5 "configuration-refused",
        /// The board has its configuration.
        Ready = 6 "ready",
    }
}

/// The input of a ring of ticks. It neither waits nor allocates.
#[derive(Debug)]
pub struct TickInput {
    /// None only while [`tick_feed`] touches the memory.
    heads: Producer<Option<Head>>,
    events: Producer<Event>,
}

/// The output of a ring of ticks.
#[derive(Debug)]
pub struct TickOutput {
    heads: Consumer<Option<Head>>,
    events: Consumer<Event>,
}

/// A tick without its events, and their number.
#[derive(Clone, Debug)]
struct Head {
    tick: TickRecord<0>,
    events: usize,
}

/// A ring for `capacity` ticks, each with up to [`MAX_EVENTS`] events.
///
/// All its memory has been touched when this returns: a later push meets no page fault,
/// unless the system has swapped the memory out.
#[inline]
pub fn tick_feed(capacity: usize) -> (TickInput, TickOutput) {
    let (mut heads, mut heads_out) = RingBuffer::new(capacity);
    let (mut events, mut events_out) = RingBuffer::new(capacity.saturating_mul(MAX_EVENTS));
    while heads.push(None).is_ok() {}
    while heads_out.pop().is_ok() {}
    while events.push(Event::ArmRefused).is_ok() {}
    while events_out.pop().is_ok() {}
    (
        TickInput { heads, events },
        TickOutput {
            heads: heads_out,
            events: events_out,
        },
    )
}

impl TickInput {
    // Inlined, with its opposite: the Python package compiles this crate without optimisation.
    /// Pushes a tick; false if the ring is full.
    #[inline]
    pub fn push(&mut self, tick: &TickRecord) -> bool {
        // Where there is room for a tick, there is room for its events.
        if self.heads.is_full() {
            return false;
        }
        let Ok(room) = self.events.write_chunk_uninit(tick.events.len()) else {
            return false;
        };
        room.fill_from_iter(tick.events.iter().copied());
        // Pushed last: a reader that sees the head sees the events as well.
        let head = Head {
            tick: tick.without_events(),
            events: tick.events.len(),
        };
        self.heads.push(Some(head)).is_ok()
    }
}

impl TickOutput {
    /// The next tick; none if the ring is empty.
    #[inline]
    pub fn pop(&mut self) -> Option<TickRecord> {
        // The head is removed last: until then its place and that of its events stay
        // taken.
        let head = self.heads.peek().ok()?.as_ref()?;
        let mut events = heapless::Vec::new();
        if let Ok(chunk) = self.events.read_chunk(head.events) {
            // At most as many as a tick has.
            events.extend(chunk);
        }
        let tick = head.tick.with_events(events);
        let _ = self.heads.pop();
        Some(tick)
    }
}

#[cfg(test)]
pub(crate) mod tests {
    #![allow(clippy::unwrap_used, reason = "a test may fail")]

    use std::thread;

    use singletrack_control::{
        Actuation, Covariance, Estimate, InertialSample, PoseSample, Position, ReferencePoint,
        SlowedBy, Velocity,
    };
    use singletrack_pilot::{
        BoardSample, BoardState, DriveCommand, Filtering, LinkState, Mode, PilotRequest,
        PoseMissing, Reason,
    };

    use super::*;

    /// The first tick of a daemon without a board.
    pub(crate) fn empty() -> TickRecord {
        TickRecord {
            index: 0,
            scheduled_ns: 1_000_000_000,
            start_ns: 999_999_000,
            finish_ns: 1_000_020_000,
            skipped: 0,
            pilot_time: Time(1_000_000_000),
            events: heapless::Vec::new(),
            events_dropped: 0,
            output: Output {
                reason: Some(Reason::LinkDown),
                ..Output::neutral(Mode::Disconnected)
            },
            drive: None,
            link: LinkPhase::Greeting,
        }
    }

    /// A tick in the middle of a drive, with every kind of event.
    pub(crate) fn full() -> TickRecord {
        let pose_time = Time(40_000_000_000);
        TickRecord {
            index: 4_001,
            scheduled_ns: 40_010_000_000,
            start_ns: 40_010_060_000,
            finish_ns: 40_010_100_000,
            skipped: 2,
            pilot_time: Time(40_010_060_000),
            events: [
                Event::Pose(PoseSample {
                    capture: pose_time,
                    receive: Time(40_008_000_000),
                    frame: 17,
                    position: Position::new(0.1, -0.2),
                    yaw: -0.0,
                }),
                Event::PoseMissing(PoseMissing::Rejected),
                Event::Board(BoardSample {
                    time: Time(40_009_000_000),
                    inertial: Some(InertialSample {
                        time: Time(40_008_500_000),
                        yaw_rate: 0.5,
                        forward_acceleration: f64::MIN_POSITIVE,
                        left_acceleration: -1.25,
                    }),
                    motor_speed: 0.4,
                    state: BoardState::Driving,
                }),
                Event::Link(LinkState::Ready),
                Event::Request(PilotRequest::EmergencyStop),
                Event::ArmRefused,
            ]
            .into_iter()
            .collect(),
            events_dropped: 3,
            output: Output {
                mode: Mode::Driving,
                reason: None,
                estimate: Some(Estimate {
                    time: Time(40_010_060_000),
                    position: Position::new(1.0, 2.0),
                    yaw: 0.1 + 0.2,
                    yaw_rate: 0.5,
                    sideslip: 0.15,
                    speed: 0.4,
                    pose_time,
                }),
                covariance: Some(Covariance {
                    pose: [4e-8, 1e-9, 0.0, 4e-8, 0.0, 1e-6],
                    twist: [1e-4, 0.0, 2e-5, 4e-4, 3e-5, 9e-6],
                }),
                held: false,
                drive_time: Some(12.34),
                reference: Some(ReferencePoint {
                    position: Some(Position::new(0.9, 0.1)),
                    velocity: Velocity::new(0.0, 0.5),
                }),
                point: Some(Position::new(0.8, 0.2)),
                point_velocity: Some(Velocity::new(0.1, 0.4)),
                actuation: Actuation {
                    speed: 0.41,
                    steering: 0.32,
                    steering_rate: -0.01,
                },
                turning_round: false,
                looked_ahead: None,
                path: Some(11.5),
                slowed_by: Some(SlowedBy::SteeringRate),
                command: Some(DriveCommand {
                    rear_speed: 0.39,
                    steering: 0.32,
                    pose_time,
                    brake: false,
                }),
                request: None,
                proved: false,
                disproved: false,
                braking_measured: None,
                setpoint_refused: None,
                filtering: Filtering::None,
                filtered_ticks: 0,
                tuned: None,
                preflight: None,
                jog: None,
                setpoint: None,
            },
            drive: Some(DriveWrite {
                sequence: 255,
                written: true,
                time_ns: 40_010_095_000,
            }),
            link: LinkPhase::Ready,
        }
    }

    #[test]
    fn lateness_and_latency_follow_from_the_times() {
        assert_eq!(full().lateness_ns(), 60_000);
        assert_eq!(empty().lateness_ns(), -1_000);
        assert_eq!(full().capture_to_command_ns(), Some(10_095_000));
    }

    #[test]
    fn an_unwritten_command_has_no_latency() {
        let mut tick = full();
        tick.drive = tick.drive.map(|drive| DriveWrite {
            written: false,
            ..drive
        });
        assert_eq!(tick.capture_to_command_ns(), None);
        assert_eq!(empty().capture_to_command_ns(), None);
    }

    /// A tick with this number of events, the same ones repeated.
    fn with_events(index: u64, events: usize) -> TickRecord {
        let mut tick = full();
        tick.index = index;
        tick.events = full().events.into_iter().cycle().take(events).collect();
        tick
    }

    #[test]
    fn ticks_come_out_as_they_went_in() {
        let (mut input, mut output) = tick_feed(3);
        assert_eq!(output.pop(), None);
        let ticks = [empty(), full(), with_events(2, MAX_EVENTS)];
        for tick in &ticks {
            assert!(input.push(tick));
        }
        for tick in ticks {
            assert_eq!(output.pop(), Some(tick));
        }
        assert_eq!(output.pop(), None);
        assert!(!output.heads.is_abandoned());
        drop(input);
        assert!(output.heads.is_abandoned());
    }

    #[test]
    fn a_full_ring_takes_no_tick_and_loses_none() {
        let (mut input, mut output) = tick_feed(2);
        for round in 0..5 {
            let ticks = [0, 1].map(|index| with_events(2 * round + index, MAX_EVENTS));
            assert!(ticks.iter().all(|tick| input.push(tick)));
            assert!(!input.push(&full()));
            for tick in ticks {
                assert_eq!(output.pop(), Some(tick));
            }
        }
    }

    #[test]
    fn another_thread_gets_every_event_of_every_tick() {
        const TICKS: u64 = 20_000;
        let (mut input, mut output) = tick_feed(8);
        let emptying = thread::spawn(move || {
            for index in 0..TICKS {
                let tick = loop {
                    match output.pop() {
                        Some(tick) => break tick,
                        None => thread::yield_now(),
                    }
                };
                assert_eq!(tick.index, index);
                assert_eq!(tick.events.len() as u64, index % (MAX_EVENTS as u64 + 1));
            }
        });
        for index in 0..TICKS {
            let tick = with_events(index, (index % (MAX_EVENTS as u64 + 1)) as usize);
            while !input.push(&tick) {
                thread::yield_now();
            }
        }
        emptying.join().unwrap();
    }
}
