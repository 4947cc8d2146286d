//! The ticks of a record, with the events that came since the tick before.

use singletrack_control::{Actuation, InertialSample, PoseSample, Position, Time};
use singletrack_mocap::{Observation, PoseState, RejectReason};
use singletrack_pilot::{
    BoardSample, BoardState, DriveCommand, Event, LinkState, Mode, Output, PoseMissing,
};
use singletrack_record::{LinkPhase, MAX_EVENTS, TickRecord};

use super::{
    FIRST_ROW_NS,
    log::{Log, Summary, Times},
};

/// The observations and the board samples of a log, tick by tick.
pub(super) struct Timeline<'a> {
    log: &'a Log,
    /// The samples of the board, in the order of time.
    board: Vec<BoardSample>,
    /// Inertial samples at times at which the speed of the motor is not known.
    without_motor_speed: u64,
    /// The number of ticks.
    pub(super) ticks: u64,
    index: u64,
    /// Observations and board samples before these are in ticks that were returned.
    next_observation: usize,
    next_sample: usize,
    /// The observations of the last tick begin here.
    arrived_from: usize,
    last_pose: Option<Time>,
}

impl<'a> Timeline<'a> {
    pub(super) fn new(log: &'a Log) -> Self {
        let (board, without_motor_speed) = board_samples(log);
        let span_ns = log.end_ns.saturating_sub(FIRST_ROW_NS + log.phase_ns);
        Self {
            log,
            board,
            without_motor_speed,
            // The last tick is not before the last row.
            ticks: span_ns.div_ceil(log.tick_ns) + 1,
            index: 0,
            next_observation: 0,
            next_sample: 0,
            arrived_from: 0,
            last_pose: None,
        }
    }

    /// The next tick; `None` after the last one. Fails if more events fall in it than it can hold.
    pub(super) fn next_tick(&mut self) -> Result<Option<TickRecord>, String> {
        if self.index == self.ticks {
            return Ok(None);
        }
        let time = Time(FIRST_ROW_NS + self.log.phase_ns + self.index * self.log.tick_ns);
        self.arrived_from = self.next_observation;
        let mut tick = TickRecord {
            index: self.index,
            scheduled_ns: time.0,
            start_ns: time.0,
            finish_ns: time.0,
            skipped: 0,
            pilot_time: time,
            events: Default::default(),
            events_dropped: 0,
            output: Output::neutral(Mode::Ready),
            drive: None,
            link: LinkPhase::Ready,
        };
        let full = |_| {
            let time_s = time.seconds_since(Time(FIRST_ROW_NS));
            format!(
                "more than {MAX_EVENTS} poses and samples fall in the tick {time_s:.3} s after the \
                 first row: make tick_ms in the map smaller, or interpolate the sensors at a lower \
                 rate"
            )
        };
        if self.index == 0 {
            tick.events
                .push(Event::Link(LinkState::Ready))
                .map_err(full)?;
        }
        let mut held = true;
        while let Some(event) = self.next_event(time) {
            held &= !matches!(event, Event::Pose(_));
            tick.events.push(event).map_err(full)?;
        }
        tick.output = Output {
            held,
            ..self.output(time)
        };
        self.index += 1;
        Ok(Some(tick))
    }

    /// The observations that arrived since the tick before the last one that was returned.
    pub(super) fn arrived(&self) -> &[Observation] {
        &self.log.poses[self.arrived_from..self.next_observation]
    }

    /// What is made of the log.
    pub(super) fn summary(&self) -> Summary {
        let Log { poses, .. } = self.log;
        let is_valid = |pose: &&Observation| matches!(pose.state, PoseState::Valid(_));
        let valid = poses.iter().filter(is_valid);
        let count = |state| poses.iter().filter(|pose| pose.state == state).count() as u64;
        let inertial = self.log.inertial.as_ref();
        let times = |times: &mut dyn Iterator<Item = u64>| Times::of(&times.collect::<Vec<_>>());
        Summary {
            duration_ns: self.log.end_ns - FIRST_ROW_NS,
            poses: Summary::arrivals(valid.clone().map(|pose| pose.receive_time_ns)),
            rejected: count(PoseState::Rejected(RejectReason::NotFinite)),
            untracked: count(PoseState::Untracked),
            inertial: inertial.map(|series| Summary::arrivals(series.times_ns())),
            motor: Summary::arrivals(self.log.motor_speed.times_ns()),
            board: Summary::arrivals(self.board.iter().map(|sample| sample.time.0)),
            without_motor_speed: self.without_motor_speed,
            sorted: self.log.sorted,
            times: [
                times(&mut valid.clone().map(|pose| pose.receive_time_ns)),
                inertial.and_then(|series| times(&mut series.times_ns())),
                times(&mut self.log.motor_speed.times_ns()),
            ],
            exposures_are_known: self.log.exposures_are_known,
            ticks: self.ticks,
        }
    }

    /// The next event that is not after `time`. Of one time, the board's comes first: a pose
    /// corrects what the inertial samples up to it have predicted.
    fn next_event(&mut self, time: Time) -> Option<Event> {
        let observation = self.log.poses.get(self.next_observation);
        let observation = observation.filter(|one| one.receive_time_ns <= time.0);
        let sample = self.board.get(self.next_sample);
        let is_first = |one: Time| observation.is_none_or(|other| one.0 <= other.receive_time_ns);
        if let Some(sample) = sample.filter(|one| one.time <= time && is_first(one.time)) {
            self.next_sample += 1;
            return Some(Event::Board(*sample));
        }
        let observation = observation?;
        self.next_observation += 1;
        Some(match observation.state {
            PoseState::Valid(pose) => {
                let capture = Time(pose.capture_time_ns);
                self.last_pose = Some(capture);
                Event::Pose(PoseSample {
                    capture,
                    receive: Time(pose.receive_time_ns),
                    frame: pose.frame_number,
                    position: Position::new(pose.x_m, pose.y_m),
                    yaw: pose.yaw_rad,
                })
            }
            PoseState::Untracked => Event::PoseMissing(PoseMissing::Untracked),
            _ => Event::PoseMissing(PoseMissing::Rejected),
        })
    }

    /// The commands of the log that are in force at `time`.
    fn output(&self, time: Time) -> Output {
        let is_driving = self.log.is_driving(time.0);
        let steering = Log::command(&self.log.steering, time.0);
        let speed_command = self.log.speed_command.as_ref();
        let speed = speed_command.map(|series| Log::command(series, time.0));
        let command = speed
            .zip(self.last_pose)
            .map(|(rear_speed, pose_time)| DriveCommand {
                rear_speed,
                steering,
                pose_time,
                brake: false,
            });
        let mode = if is_driving {
            Mode::Driving
        } else {
            Mode::Ready
        };
        Output {
            actuation: Actuation {
                speed: speed.unwrap_or_default(),
                steering,
                steering_rate: 0.0,
            },
            command: command.filter(|_| is_driving),
            ..Output::neutral(mode)
        }
    }
}

/// The samples of the board: one for each sample of the IMU, if the speed of the motor is known then, or
/// without an IMU for each one of the motor. With them, how many of the IMU are left out.
fn board_samples(log: &Log) -> (Vec<BoardSample>, u64) {
    let sample = |time_ns, inertial: Option<[f64; 3]>, [motor_speed]: [f64; 1]| {
        let time = Time(time_ns);
        BoardSample {
            time,
            inertial: inertial.map(|[forward, left, yaw_rate]| InertialSample {
                time,
                yaw_rate,
                forward_acceleration: forward,
                left_acceleration: left,
            }),
            motor_speed,
            state: match log.is_driving(time_ns) {
                true => BoardState::Driving,
                false => BoardState::Neutral,
            },
        }
    };
    let Some(inertial) = &log.inertial else {
        let motor = log.motor_speed.resampled().into_iter();
        let samples = motor.map(|it| sample(it.time_ns, None, it.values));
        return (samples.collect(), 0);
    };
    let all = inertial.resampled();
    let samples = all.iter().filter_map(|it| {
        let motor_speed = log.motor_speed.at(it.time_ns)?;
        Some(sample(it.time_ns, Some(it.values), motor_speed))
    });
    let samples: Vec<_> = samples.collect();
    let left_out = all.len() - samples.len();
    (samples, left_out as u64)
}
