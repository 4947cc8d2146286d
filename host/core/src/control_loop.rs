//! The body of the control thread: rings in, one tick, rings out.
//!
//! Nothing here waits, allocates or locks.

use rtrb::{Consumer, Producer, PushError};
use singletrack_control::Time;
use singletrack_link::{Event as LinkEvent, State};
use singletrack_mocap::Observation;
use singletrack_pilot::PilotRequest;
use singletrack_pilot::{Mode, RealTimeState};
use singletrack_protocol::BoardMode;
use singletrack_record::{DriveWrite, TickInput, TickRecord};

use crate::{
    alignment::Alignment,
    controller::{Controller, Sent},
    grid::Slot,
    line::{Line, drive_number},
    reconfigure::{Reconfiguration, Refusal},
    report::{LineCounters, Report, link_phase},
    serial::SerialEvent,
    setpoint_slot::SetpointReceiver,
};

/// What the control thread is asked.
#[derive(Clone, Debug, PartialEq)]
pub enum ControlRequest {
    /// Something for the pilot.
    Pilot(PilotRequest),
    /// Take over another configuration, if the car does not drive, and give the
    /// box back.
    Reconfigure(Box<Reconfiguration>),
    /// Bring the car to a stop and end.
    Finish,
    /// Disarm at once and end.
    Abort,
}

/// The rings that end at the control thread.
#[derive(Debug)]
pub struct Rings<L> {
    /// From the line.
    pub serial: Consumer<SerialEvent<L>>,
    /// Write halves on their way back to who opened them.
    pub returned: Producer<L>,
    /// From the cameras.
    pub observations: Consumer<Observation>,
    /// From people and programs.
    pub requests: Consumer<ControlRequest>,
    /// From a program that says where P should go.
    pub setpoints: SetpointReceiver,
    /// Configurations on their way back to who made them.
    pub reconfigured: Producer<Box<Reconfiguration>>,
    /// Every tick.
    pub ticks: TickInput,
    /// Everything else.
    pub reports: Producer<Report>,
}

/// So many commands may be under way to a board that says nothing: a line that
/// is stuck both ways shows in nothing else when it is a pseudo-terminal.
const COMMANDS_INTO_SILENCE: u32 = 2;

/// What a tick takes in of the cameras: of more, the newest.
const OBSERVATIONS: usize = 16;

/// What has waited for longer to be taken from the line waited for a stall.
const STALL_NS: u64 = 100_000_000;

/// How long the car may take to stop and the board to confirm it, at the end.
const FINISH_NS: u64 = 2_000_000_000;

/// How long the last disarm requests are repeated to a board that does not
/// confirm.
const ABORT_NS: u64 = 100_000_000;

/// The counters are told every so many ticks.
const COUNTERS_TICKS: u64 = 20;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Ending {
    /// Not yet.
    Running,
    /// The car is brought to a stop, until this time at most.
    Finishing { until_ns: u64 },
    /// The board is disarmed, until this time at most.
    Aborting { until_ns: u64 },
    /// There is nothing left to do.
    Done,
}

/// The controller between its rings.
#[derive(Debug)]
pub struct ControlLoop<L> {
    controller: Controller,
    rings: Rings<L>,
    line: Option<L>,
    index: u64,
    commands_since_heard: u32,
    arm_when_ready: bool,
    ending: Ending,
    alignment: Option<Alignment>,
    slide_ns: i64,
    counters: LineCounters,
}

impl<L: Line> ControlLoop<L> {
    /// A loop without a line. `arm_when_ready`: arms once, as soon as it can.
    #[must_use]
    pub fn new(controller: Controller, rings: Rings<L>, arm_when_ready: bool) -> Self {
        Self {
            controller,
            rings,
            line: None,
            index: 0,
            commands_since_heard: 0,
            arm_when_ready,
            ending: Ending::Running,
            alignment: None,
            slide_ns: 0,
            counters: LineCounters::default(),
        }
    }

    /// The same, sliding its ticks to where frames have just arrived.
    #[must_use]
    pub fn aligned_to_cameras(self, period_ns: u64) -> Self {
        Self {
            alignment: Some(Alignment::new(period_ns.max(1))),
            ..self
        }
    }

    /// The rings that it writes to, for a caller that prepares their memory.
    pub const fn rings_mut(&mut self) -> &mut Rings<L> {
        &mut self.rings
    }

    /// What the system granted the thread that is to run it, for the pilot.
    pub fn real_time(&mut self, state: RealTimeState) {
        self.controller.real_time(state);
    }

    /// The controller.
    #[must_use]
    pub const fn controller(&self) -> &Controller {
        &self.controller
    }

    /// How much later the next tick should begin than a period after the last
    /// one; negative for earlier.
    #[must_use]
    pub const fn slide_ns(&self) -> i64 {
        self.slide_ns
    }

    /// What was counted so far.
    #[must_use]
    pub fn counters(&self) -> LineCounters {
        LineCounters {
            link: self.controller.session().counters(),
            ..self.counters
        }
    }

    /// Whether it has done what it was asked to do before it ends.
    #[must_use]
    pub fn is_done(&self) -> bool {
        self.ending == Ending::Done
    }

    /// One tick: takes in what came since the last one, decides, commands, tells.
    pub fn tick(&mut self, slot: Slot, clock: &impl Fn() -> u64) {
        // After a stall there is more than a tick takes in: the newest poses are
        // to be among it.
        let passed_over = if self.has_stalled(slot.start_ns) {
            let passed_over = self.take_observations();
            self.take_serial(slot.start_ns);
            passed_over
        } else {
            self.take_serial(slot.start_ns);
            self.take_observations()
        };
        self.take_requests(slot.start_ns);
        if let Some(setpoint) = self.rings.setpoints.take() {
            self.controller.setpoint(setpoint);
        }
        let now = Time(clock());
        self.end_if_done(now.0);
        match self.controller.pilot().mode() {
            Mode::Ready if self.arm_when_ready => self.controller.request(PilotRequest::Arm),
            // Once: what stops the car after that is not overruled.
            Mode::Arming | Mode::Driving => self.arm_when_ready = false,
            _ => {}
        }

        let Self {
            controller,
            rings,
            line,
            commands_since_heard,
            counters,
            ..
        } = self;
        let mut drive = None;
        let mut write = |frame: &[u8]| {
            let number = drive_number(frame);
            let sent = match line {
                Some(_) if number.is_some() && *commands_since_heard >= COMMANDS_INTO_SILENCE => {
                    Sent::Dropped
                }
                Some(line) => line.write_frame(frame),
                None => Sent::Dropped,
            };
            if let Some(number) = number {
                let written = sent == Sent::Whole;
                if written {
                    *commands_since_heard += 1;
                    counters.drives_written += 1;
                } else {
                    counters.drives_withheld += 1;
                }
                drive = Some(DriveWrite {
                    sequence: number.0,
                    written,
                    time_ns: clock(),
                });
            }
            sent
        };
        let mut dropped = 0;
        let tick = controller.tick(now, &mut write, &mut |event| {
            dropped += tell(&mut rings.reports, now.0, event);
        });
        let record = TickRecord {
            index: self.index,
            scheduled_ns: slot.scheduled_ns,
            start_ns: slot.start_ns,
            finish_ns: clock(),
            skipped: slot.skipped,
            pilot_time: now,
            events: tick.events,
            events_dropped: tick.dropped_events.saturating_add(passed_over),
            output: tick.output,
            drive,
            link: link_phase(&controller.session().state()),
        };
        dropped += u64::from(!rings.ticks.push(&record));
        self.counters.reports_dropped += dropped;
        let is_driving = self.is_driving();
        self.slide_ns = self
            .alignment
            .as_mut()
            .map_or(0, |alignment| alignment.slide_ns(slot.start_ns, is_driving));
        self.index += 1;
        if self.index.is_multiple_of(COUNTERS_TICKS) {
            // They are told again soon.
            let _ = self.rings.reports.push(Report::Counters(self.counters()));
        }
    }

    fn has_stalled(&self, now_ns: u64) -> bool {
        match self.rings.serial.peek() {
            Ok(SerialEvent::Bytes(chunk)) => now_ns.saturating_sub(chunk.time_ns) > STALL_NS,
            _ => false,
        }
    }

    /// Takes the newest; returns how many older ones it passed over.
    fn take_observations(&mut self) -> u32 {
        let waiting = self.rings.observations.slots();
        let old = waiting.saturating_sub(OBSERVATIONS);
        for _ in 0..old {
            let _ = self.rings.observations.pop();
        }
        while let Ok(observation) = self.rings.observations.pop() {
            if let Some(alignment) = &mut self.alignment {
                alignment.arrived(observation.receive_time_ns);
            }
            self.controller.observed(&observation);
        }
        u32::try_from(old).unwrap_or(u32::MAX)
    }

    fn take_serial(&mut self, now_ns: u64) {
        while let Ok(event) = self.rings.serial.pop() {
            let mut dropped = 0;
            let reports = &mut self.rings.reports;
            match event {
                SerialEvent::Opened(line) => {
                    self.controller.port_opened(Time(now_ns));
                    if let Some(old) = self.line.replace(line) {
                        // Not closed here: see below.
                        let _ = self.rings.returned.push(old);
                    }
                    self.commands_since_heard = 0;
                }
                SerialEvent::Bytes(chunk) => {
                    self.commands_since_heard = 0;
                    let time_ns = chunk.time_ns;
                    self.controller
                        .received(Time(time_ns), chunk.bytes(), &mut |event| {
                            dropped += tell(reports, time_ns, event);
                        });
                }
                SerialEvent::Closed { time_ns } => {
                    self.controller.port_closed(Time(time_ns), &mut |event| {
                        dropped += tell(reports, time_ns, event);
                    });
                    if let Some(line) = self.line.take() {
                        // Without room it is closed here, which may take long;
                        // but there is room for every line that was opened.
                        let _ = self.rings.returned.push(line);
                    }
                }
            }
            self.counters.reports_dropped += dropped;
        }
    }

    fn take_requests(&mut self, now_ns: u64) {
        while let Ok(request) = self.rings.requests.pop() {
            match request {
                ControlRequest::Pilot(PilotRequest::Arm) if self.ending != Ending::Running => {}
                ControlRequest::Pilot(request) => {
                    // Who says stop before it was ready means that one too.
                    self.arm_when_ready &= request == PilotRequest::Arm;
                    self.controller.request(request);
                }
                ControlRequest::Finish => {
                    if self.ending == Ending::Running {
                        self.arm_when_ready = false;
                        self.ending = Ending::Finishing {
                            until_ns: now_ns.saturating_add(FINISH_NS),
                        };
                        // Also takes back an arm request of this very tick.
                        self.controller.request(PilotRequest::Disarm);
                    }
                }
                ControlRequest::Abort => self.abort(now_ns),
                ControlRequest::Reconfigure(change) => self.reconfigure(now_ns, change),
            }
        }
    }

    fn reconfigure(&mut self, now_ns: u64, mut change: Box<Reconfiguration>) {
        let outcome = if self.ending != Ending::Running {
            Err(Refusal::Ending)
        } else if now_ns > change.until_ns {
            Err(Refusal::Late)
        } else {
            let Reconfiguration {
                number,
                pilot,
                board,
                ..
            } = &*change;
            self.controller
                .reconfigure(Time(now_ns), *number, pilot, *board)
                .map_err(Refusal::from)
        };
        change.outcome = Some(outcome);
        if let Err(PushError::Full(change)) = self.rings.reconfigured.push(change) {
            // There is room for every one that can be under way. If ever there is
            // not, it is lost and not freed: that may take long.
            core::mem::forget(change);
        }
    }

    fn abort(&mut self, now_ns: u64) {
        if matches!(self.ending, Ending::Running | Ending::Finishing { .. }) {
            self.arm_when_ready = false;
            self.controller.request(PilotRequest::Disarm);
            self.controller.disarm_now(Time(now_ns));
            self.ending = Ending::Aborting {
                until_ns: now_ns.saturating_add(ABORT_NS),
            };
        }
    }

    /// Judges by the state that the last tick left.
    fn end_if_done(&mut self, now_ns: u64) {
        match self.ending {
            Ending::Running | Ending::Done => {}
            Ending::Finishing { until_ns } => {
                if !self.is_driving() && !self.is_board_armed() {
                    self.ending = Ending::Done;
                } else if now_ns >= until_ns {
                    self.abort(now_ns);
                }
            }
            Ending::Aborting { until_ns } => {
                if !self.is_board_armed() || now_ns >= until_ns {
                    self.ending = Ending::Done;
                }
            }
        }
    }

    fn is_driving(&self) -> bool {
        self.controller.pilot().mode().is_underway()
    }

    /// Whether the board is armed, or was asked to disarm and has not confirmed it.
    fn is_board_armed(&self) -> bool {
        let session = self.controller.session();
        match session.state() {
            State::Ready { mode } => {
                session.is_stop_pending()
                    || matches!(mode, Some(BoardMode::Armed | BoardMode::Driving))
            }
            // It stops by itself, and cannot be told anything.
            _ => false,
        }
    }
}

/// Returns how many reports found no room.
fn tell(reports: &mut Producer<Report>, time_ns: u64, event: &LinkEvent) -> u64 {
    u64::from(reports.push(Report::of(time_ns, event)).is_err())
}
