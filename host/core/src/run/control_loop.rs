//! The body of the control thread: reads its rings, runs one tick, fills its rings.
//!
//! It never waits or allocates; a lock it only tries, see [`slot`](crate::slot).

use rtrb::{Consumer, Producer, PushError};
use singletrack_control::{NeighbourSample, Time};
use singletrack_link::{Event as LinkEvent, State};
use singletrack_mocap::{Observation, PoseState};
use singletrack_pilot::{Arming, Event, Jog, Mode, PilotRequest, RealTimeState, Tuning};
use singletrack_protocol::BoardMode;
use singletrack_record::{DriveWrite, TickInput, TickRecord};

use crate::{
    controller::Controller,
    grid::{Alignment, Grid, Slot},
    line::{Line, Sent, drive_number},
    run::messages::{ControlRequest, LineCounters, Reconfiguration, Refusal, Report, link_phase},
    run::proof::Proof,
    serial::SerialEvent,
    slot::{SetpointReceiver, SlotReceiver},
};

/// The rings of the control thread.
#[derive(Debug)]
pub struct Rings<L> {
    /// Bytes of the serial line, and its opening and closing.
    pub serial: Consumer<SerialEvent<L>>,
    /// Write halves, returned to be closed by their opener.
    pub returned: Producer<L>,
    /// Observations of the cameras.
    pub observations: Consumer<Observation>,
    /// Other bodies that the cameras list.
    pub neighbours: Consumer<NeighbourSample>,
    /// Requests of people and programs.
    pub requests: Consumer<ControlRequest>,
    /// Set-points from outside.
    pub setpoints: SetpointReceiver,
    /// Pulses of the operator who jogs.
    pub jogs: SlotReceiver<Jog>,
    /// Values to tune.
    pub tunings: SlotReceiver<Tuning>,
    /// Configurations with their outcome, returned to be freed by their maker.
    pub reconfigured: Producer<Box<Reconfiguration>>,
    /// The record of every tick.
    pub ticks: TickInput,
    /// All other reports.
    pub reports: Producer<Report>,
}

/// The number of commands that are written while the board is silent. The output queue of a
/// pseudo-terminal does not show that the line is stuck.
const COMMANDS_INTO_SILENCE: u32 = 2;

/// The number of observations that a tick handles. Of more, the newest are handled.
const OBSERVATIONS: usize = 16;

/// The number of points of a trajectory that a tick handles: the longest one reaches the pilot
/// in five ticks, and leaves room for the other events.
const TRAJECTORY_PIECES: usize = 20;

/// The control thread has stalled if bytes of the line have waited for longer than this, ns.
const STALL_NS: u64 = 100_000_000;

/// The longest time until the car has stopped and the board has confirmed it, at the end, ns.
const FINISH_NS: u64 = 2_000_000_000;

/// The longest time that the last disarm request is repeated to a board that does not
/// confirm it, ns.
const ABORT_NS: u64 = 100_000_000;

/// Interval of the reports of the counters, in ticks.
const COUNTERS_TICKS: u64 = 20;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Ending {
    /// The loop runs.
    Running,
    /// The car stops, until this time at most.
    Finishing { until_ns: u64 },
    /// The board is disarmed, until this time at most.
    Aborting { until_ns: u64 },
    /// The loop may end.
    Done,
}

/// The controller and its rings.
#[derive(Debug)]
pub struct ControlLoop<L> {
    /// The controller.
    pub controller: Controller,
    /// The rings.
    pub rings: Rings<L>,
    line: Option<L>,
    index: u64,
    commands_since_heard: u32,
    arm_when_ready: bool,
    /// When the reference of a car that is armed and waits begins, in ns.
    begin_ns: Option<u64>,
    ending: Ending,
    alignment: Option<Alignment>,
    /// The delay of the next tick beyond a period after the last one, in ns; negative to
    /// advance it.
    pub slide_ns: i64,
    last_start_ns: u64,
    counters: LineCounters,
    /// A proof that is void, and whose report has found no room.
    unreported: Option<Proof>,
}

impl<L: Line> ControlLoop<L> {
    /// A loop with a closed line. With `arm_when_ready` it arms once, as soon as the pilot is
    /// ready. With a period in `aligned_ns`, in ns, it aligns the ticks with the camera frames,
    /// see [`slide_ns`](Self#structfield.slide_ns), and begins each when its frame arrives, see
    /// [`due_ns`](Self::due_ns).
    pub fn new(
        controller: Controller,
        rings: Rings<L>,
        arm_when_ready: bool,
        aligned_ns: Option<u64>,
    ) -> Self {
        Self {
            controller,
            rings,
            line: None,
            index: 0,
            commands_since_heard: 0,
            arm_when_ready,
            begin_ns: None,
            ending: Ending::Running,
            alignment: aligned_ns.map(|period_ns| Alignment::new(period_ns.max(1))),
            slide_ns: 0,
            last_start_ns: 0,
            counters: LineCounters::default(),
            unreported: None,
        }
    }

    /// What the system granted the thread that runs the loop, for the pilot.
    pub fn real_time(&mut self, state: RealTimeState) {
        self.controller.push(Event::RealTime(state));
    }

    /// The counters so far.
    pub fn counters(&self) -> LineCounters {
        LineCounters {
            link: self.controller.session.counters(),
            ..self.counters
        }
    }

    /// Whether the loop has finished or aborted as requested, and may end.
    pub fn is_done(&self) -> bool {
        self.ending == Ending::Done
    }

    /// When the next tick may begin at the earliest, ns: a window before its deadline if the ticks
    /// are aligned with the cameras, and the deadline itself otherwise. Not much sooner than a
    /// period after a tick that was late.
    pub fn opens_ns(&self, grid: &Grid) -> u64 {
        let deadline_ns = grid.next_ns;
        let Some(alignment) = &self.alignment else {
            return deadline_ns;
        };
        let window_ns = alignment.window_ns;
        let apart_ns = alignment.period_ns - window_ns;
        let apart_from_ns = self.last_start_ns.saturating_add(apart_ns);
        deadline_ns
            .saturating_sub(window_ns)
            .max(apart_from_ns)
            .min(deadline_ns)
    }

    /// When the next tick is due, ns: when its frame arrives, but not before
    /// [`opens_ns`](Self::opens_ns), and at the deadline without one. To be asked again after
    /// each frame.
    #[must_use]
    pub fn due_ns(&mut self, grid: &Grid) -> u64 {
        let deadline_ns = grid.next_ns;
        let Some(alignment) = &self.alignment else {
            return deadline_ns;
        };
        let since_ns = deadline_ns.saturating_sub(alignment.period_ns / 2);
        let opens_ns = self.opens_ns(grid);
        let observations = &mut self.rings.observations;
        let waiting = observations.read_chunk(observations.slots());
        let frame_ns = waiting.ok().and_then(|waiting| {
            let (front, back) = waiting.as_slices();
            let is_its_frame = |observation: &&Observation| {
                is_of_frame(observation) && observation.receive_time_ns >= since_ns
            };
            let frame = front.iter().chain(back).find(is_its_frame);
            frame.map(|frame| frame.receive_time_ns)
        });
        frame_ns.map_or(deadline_ns, |frame_ns| {
            frame_ns.max(opens_ns).min(deadline_ns)
        })
    }

    /// One pass of the control thread after it woke up: the tick of the point that it belongs
    /// to, the slide of the grid, and the points that the tick ran over.
    pub fn wake_up(&mut self, grid: &mut Grid, clock: &impl Fn() -> u64) {
        let due_ns = self.due_ns(grid);
        self.tick(grid.enter(clock(), due_ns), clock);
        grid.slide(self.slide_ns);
        grid.leave(clock());
    }

    /// One tick: handles the inputs since the last one, sends the command and reports.
    pub fn tick(&mut self, slot: Slot, clock: &impl Fn() -> u64) {
        // After a stall there are more events than fit into a tick. Poses go first then, so
        // that the newest are among them.
        let passed_over = if self.has_stalled(slot.start_ns) {
            let passed_over = self.take_observations();
            self.take_serial(slot.start_ns);
            passed_over
        } else {
            self.take_serial(slot.start_ns);
            self.take_observations()
        };
        while let Ok(neighbour) = self.rings.neighbours.pop() {
            self.controller.saw_neighbour(neighbour);
        }
        self.take_requests(slot.start_ns);
        self.take_setpoints();
        if let Some(jog) = self.rings.jogs.take() {
            self.controller.push(Event::Jog(jog));
        }
        if let Some(tuning) = self.rings.tunings.take() {
            self.controller.push(Event::Tuning(tuning));
        }
        let now = Time(clock());
        if let Some(begin_ns) = self.begin_ns.take_if(|begin_ns| *begin_ns <= now.0) {
            self.controller.push(Event::Begin(Time(begin_ns)));
        }
        self.end_if_done(now.0);
        match self.controller.pilot.mode() {
            Mode::Ready if self.arm_when_ready => {
                self.request(PilotRequest::Arm(Arming::Unattended));
            }
            // Once only: a later stop is not overruled.
            Mode::Arming | Mode::Driving => self.arm_when_ready = false,
            _ => {}
        }

        let mut drive = None;
        let mut write = |frame: &[u8]| {
            let number = drive_number(frame);
            let is_heard = self.commands_since_heard < COMMANDS_INTO_SILENCE;
            let sent = match &mut self.line {
                Some(_) if number.is_some() && !is_heard => Sent::Dropped,
                Some(line) => line.write_frame(frame),
                None => Sent::Dropped,
            };
            if let Some(number) = number {
                let written = sent == Sent::Whole;
                if written {
                    self.commands_since_heard += 1;
                    self.counters.drives_written += 1;
                } else {
                    self.counters.drives_withheld += 1;
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
        let reports = &mut self.rings.reports;
        let tick = self.controller.tick(now, &mut write, &mut |event| {
            dropped += tell(reports, now.0, event);
        });
        let time_ns = now.0;
        if let Some(proof) = tick.proved {
            let report = Report::Proved { time_ns, proof };
            dropped += u64::from(reports.push(report).is_err());
        }
        // A proof that is void must not outlive the daemon in its file: it waits for room.
        let unreported = self.unreported.take();
        for proof in [unreported, tick.disproved].into_iter().flatten() {
            let report = Report::Disproved { time_ns, proof };
            if reports.push(report).is_err() {
                self.unreported = Some(proof);
            }
        }
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
            link: link_phase(&self.controller.session.state()),
        };
        dropped += u64::from(!self.rings.ticks.push(&record));
        self.counters.reports_dropped += dropped;
        self.begin_ns = self.begin_ns.filter(|_| self.is_driving());
        let is_driving = self.is_driving();
        self.slide_ns = self.alignment.as_mut().map_or(0, |alignment| {
            alignment.slide_ns(slot.deadline_ns, is_driving)
        });
        self.last_start_ns = slot.start_ns;
        self.index += 1;
        if self.index.is_multiple_of(COUNTERS_TICKS) {
            // A lost report is superseded by the next one.
            let _ = self.rings.reports.push(Report::Counters(self.counters()));
        }
    }

    fn has_stalled(&self, now_ns: u64) -> bool {
        match self.rings.serial.peek() {
            Ok(SerialEvent::Bytes(chunk)) => now_ns.saturating_sub(chunk.time_ns) > STALL_NS,
            _ => false,
        }
    }

    /// Handles the newest observations; returns the number of older ones skipped.
    fn take_observations(&mut self) -> u32 {
        let waiting = self.rings.observations.slots();
        let old = waiting.saturating_sub(OBSERVATIONS);
        for _ in 0..old {
            let _ = self.rings.observations.pop();
        }
        while let Ok(observation) = self.rings.observations.pop() {
            if let Some(alignment) = &mut self.alignment
                && is_of_frame(&observation)
            {
                alignment.arrived(observation.receive_time_ns);
            }
            self.controller.observed(&observation);
        }
        u32::try_from(old).unwrap_or(u32::MAX)
    }

    /// Handles the newest set-point, or the next points of a trajectory.
    fn take_setpoints(&mut self) {
        for _ in 0..TRAJECTORY_PIECES {
            let Some(event) = self.rings.setpoints.take() else {
                return;
            };
            self.controller.push(event);
        }
    }

    fn take_serial(&mut self, now_ns: u64) {
        while let Ok(event) = self.rings.serial.pop() {
            let mut dropped = 0;
            let reports = &mut self.rings.reports;
            match event {
                SerialEvent::Opened(line) => {
                    self.controller.port_opened(Time(now_ns));
                    if let Some(old) = self.line.replace(line) {
                        // It is closed by its opener: see below.
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
                        // The ring has room for every line that was opened. Without room
                        // the line would be closed here, which may take long.
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
                ControlRequest::Pilot(PilotRequest::Arm(_)) if self.ending != Ending::Running => {}
                ControlRequest::Pilot(request) => {
                    // A stop before the first arming cancels that as well.
                    self.arm_when_ready &= matches!(
                        request,
                        PilotRequest::Arm(Arming::Unattended | Arming::Held) | PilotRequest::Hold
                    );
                    self.request(request);
                }
                ControlRequest::ArmAt(begin_ns) => {
                    if self.ending == Ending::Running {
                        self.begin_ns = Some(begin_ns);
                        self.request(PilotRequest::Arm(Arming::Waiting));
                    }
                }
                ControlRequest::Learned(learned) => {
                    self.controller.push(Event::Learned(learned));
                }
                ControlRequest::Finish => {
                    if self.ending == Ending::Running {
                        self.arm_when_ready = false;
                        self.ending = Ending::Finishing {
                            until_ns: now_ns.saturating_add(FINISH_NS),
                        };
                        // It also revokes an arm request of the same tick.
                        self.request(PilotRequest::Disarm);
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
            self.controller.reconfigure(Time(now_ns), &change)
        };
        change.outcome = Some(outcome);
        if let Err(PushError::Full(change)) = self.rings.reconfigured.push(change) {
            // The ring has room for every change that can be under way. Without room the
            // box is leaked: to free it may take long.
            core::mem::forget(change);
        }
    }

    fn request(&mut self, request: PilotRequest) {
        self.controller.push(Event::Request(request));
    }

    fn abort(&mut self, now_ns: u64) {
        if matches!(self.ending, Ending::Running | Ending::Finishing { .. }) {
            self.arm_when_ready = false;
            self.request(PilotRequest::Disarm);
            // Without slowing down first: the next tick writes it.
            self.controller.session.disarm(now_ns);
            self.ending = Ending::Aborting {
                until_ns: now_ns.saturating_add(ABORT_NS),
            };
        }
    }

    /// Advances the end of the loop, by the state after the last tick.
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
        self.controller.pilot.mode().is_underway()
    }

    /// Whether the board is armed, or has not yet confirmed a disarm.
    fn is_board_armed(&self) -> bool {
        let session = &self.controller.session;
        match session.state() {
            State::Ready { mode } => {
                session.is_stop_pending() || mode.is_some_and(BoardMode::is_armed)
            }
            // Without a link the board stops by itself and gets no requests.
            _ => false,
        }
    }
}

/// Whether a frame has arrived: not one that is missing.
const fn is_of_frame(observation: &Observation) -> bool {
    !matches!(
        observation.state,
        PoseState::Stale { .. } | PoseState::NoFrames
    )
}

/// Reports a link event. Returns the number of reports that found no room: 0 or 1.
fn tell(reports: &mut Producer<Report>, time_ns: u64, event: &LinkEvent) -> u64 {
    u64::from(reports.push(Report::of(time_ns, event)).is_err())
}
