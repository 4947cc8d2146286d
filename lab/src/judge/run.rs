//! A pilot that watches a log, which is read tick by tick.

use std::{collections::VecDeque, path::Path};

use singletrack_commissioning::seen::{self, Kind, Motion, Seen, Track};
use singletrack_control::{CarPose, InertialSample, PoseVerdict, Time, wrap};
use singletrack_core::pose_event;
use singletrack_mocap::{Observation, PoseLimits, PoseState, planar::PoseGate};
use singletrack_pilot::{Commanded, Event, Imu, Mode, Pilot, PilotConfig};
use singletrack_record::{Entry, Reader, RecordError, TickRecord, Topic};

use super::Part;

/// The time after a stop until the next drive is watched, s.
const PAUSE: f64 = 1.0;
/// No drive begins without a pose this recent, s.
const FRESH: f64 = 0.05;
/// The poses of the car after which a person who was asked for it would say that it is the car.
const ASKED: u32 = 100;

/// Below this speed the cameras do not tell the sideslip, m/s.
pub(super) const SLOWEST: f64 = 0.5;

/// An estimate beside what the cameras say of the same moment.
#[derive(Clone, Copy, Debug)]
pub(super) struct Compared {
    pub(super) time: Time,
    pub(super) speed: f64,
    pub(super) yaw_rate: f64,
    pub(super) sideslip: f64,
    /// Stated standard deviation of the sideslip, rad.
    pub(super) deviation: f64,
    pub(super) truth: Motion,
}

impl Compared {
    /// Estimated minus true sideslip, rad.
    pub(super) fn sideslip_error(&self) -> f64 {
        wrap(self.sideslip - self.truth.sideslip())
    }

    pub(super) fn is_fast(&self) -> bool {
        self.truth.forward > SLOWEST
    }
}

/// A stop that a drive would have had.
#[derive(Clone, Copy, Debug, serde::Serialize)]
pub struct Stop {
    /// When, from the beginning of the record.
    pub t_s: f64,
    /// Why.
    pub reason: &'static str,
}

/// What became of a pose.
#[derive(Clone, Copy, Debug)]
pub(super) struct Judged {
    pub(super) seen: Seen,
    /// Refused by the gate of the cameras, before the estimator.
    pub(super) gated: bool,
    pub(super) verdict: Option<PoseVerdict>,
    /// Normalised innovation squared, before any weighting.
    pub(super) innovation: Option<f64>,
    /// Whether the estimate had settled.
    pub(super) settled: bool,
}

/// What a pilot has seen and said.
#[derive(Debug, Default)]
pub(super) struct Run {
    pub(super) stops: Vec<Stop>,
    pub(super) poses: Vec<Judged>,
    pub(super) track: Track,
    /// When the watches began, s: the first tick by which every source of the log has been heard and
    /// the estimate has settled, as before a drive of ours. None if that never was.
    pub(super) watched_from: Option<f64>,
    pub(super) compared: Vec<Compared>,
    /// The samples of the board, NaN where they have nothing of an IMU, and the motor's speed.
    pub(super) samples: Vec<(InertialSample, f64)>,
    /// When a person would have been asked whether the body is the car, s.
    pub(super) asked: Vec<f64>,
    /// The largest estimated speed, m/s.
    pub(super) speed_max: f64,
    /// The gyro's scale in the end; none without a gyro.
    pub(super) gyro_scale: Option<f64>,
}

/// The poses of the log as those of the car.
pub(super) fn seen(log: &Log, pilot: &Pilot) -> Track {
    let poses: Vec<(Time, CarPose)> = log
        .frames
        .iter()
        .filter_map(|frame| match pose_event(&frame.state) {
            Event::Pose(pose) => Some((pose.capture, pilot.estimator().centre_of_mass(&pose))),
            _ => None,
        })
        .collect();
    seen::tell(&poses)
}

/// The sample of a car without an IMU.
const fn unmeasured(time: Time) -> InertialSample {
    InertialSample {
        time,
        yaw_rate: f64::NAN,
        forward_acceleration: f64::NAN,
        left_acceleration: f64::NAN,
    }
}

/// Runs a pilot over the log. `progress` is told the number of the tick.
pub(super) fn run(
    log: &Log,
    config: PilotConfig,
    limits: PoseLimits,
    mut progress: impl FnMut(usize),
) -> Run {
    let settling = config.supervisor.settling_poses;
    let mut pilot = Pilot::new(config);
    let seen = seen(log, &pilot);
    let mut kinds = seen.seen.iter().copied();
    let share = log.cameras_hz.map_or(1.0, |hz| hz / seen.rate().max(hz));
    let is_given = |number: f64| (number * share).floor() != ((number - 1.0) * share).floor();
    let mut number = 0.0;
    let mut gate = PoseGate::new(limits);
    let mut run = Run::default();
    let mut waits_for_imu = log.imu != Imu::Missing;
    let mut frames: VecDeque<_> = log.frames.iter().collect();
    let mut paused: Option<Time> = None;
    let mut lost: u32 = 0;
    let mut accepted: Option<Time> = None;
    for (index, tick) in log.ticks.iter().enumerate() {
        progress(index);
        let mut events = tick.events.clone();
        let mut arrived: VecDeque<usize> = VecDeque::new();
        while let Some(frame) = frames.front()
            && frame.receive_time_ns <= tick.time.0
        {
            number += 1.0;
            if !is_given(number) {
                if matches!(frame.state, PoseState::Valid(_)) {
                    kinds.next();
                }
                frames.pop_front();
                continue;
            }
            let state = match frame.state {
                PoseState::Valid(pose) => {
                    let state = gate.judge(pose);
                    let gated = !matches!(state, PoseState::Valid(_));
                    if let Some(seen) = kinds.next() {
                        if !gated {
                            arrived.push_back(run.poses.len());
                        }
                        run.poses.push(Judged {
                            seen,
                            gated,
                            verdict: None,
                            innovation: None,
                            settled: false,
                        });
                    }
                    state
                }
                other => other,
            };
            events.push(pose_event(&state));
            frames.pop_front();
        }
        for event in &events {
            let Event::Board(board) = event else { continue };
            let inertial = match (board.inertial, log.imu) {
                (Some(inertial), _) => inertial,
                (None, Imu::Missing) => unmeasured(board.time),
                (None, _) => continue,
            };
            waits_for_imu = false;
            run.samples.push((inertial, board.motor_speed));
        }
        let mut commanded = Commanded {
            imu: log.imu,
            ..tick.commanded
        };
        let seen_now = accepted.is_some_and(|last| tick.time.seconds_since(last) <= FRESH);
        if paused.is_some_and(|since| tick.time.seconds_since(since) < PAUSE || !seen_now) {
            commanded.drives = false;
        } else {
            paused = None;
        }
        let settled = pilot.estimator().poses() >= settling;
        let time = tick.time.seconds_since(log.begin);
        if run.watched_from.is_none() {
            if settled && !waits_for_imu {
                run.watched_from = Some(time);
            } else {
                commanded.drives = false;
            }
        }
        let observed = pilot.observe(tick.time, &events, &commanded, |_, verdict, innovation| {
            if let Some(judged) = arrived.pop_front().and_then(|at| run.poses.get_mut(at)) {
                judged.verdict = Some(verdict);
                judged.settled = settled;
                judged.innovation = (verdict != PoseVerdict::Late).then_some(innovation);
                if verdict == PoseVerdict::Accepted {
                    accepted = Some(tick.time);
                }
                if judged.seen.kind == Kind::Car {
                    lost = if verdict == PoseVerdict::Implausible {
                        lost + 1
                    } else {
                        0
                    };
                }
            }
        });
        if let Some(reason) = observed.stop {
            run.stops.push(Stop {
                t_s: time,
                reason: reason.name(),
            });
            paused = Some(tick.time);
        }
        if lost >= ASKED {
            run.asked.push(time);
            pilot.carried();
            lost = 0;
        }
        if let Some(estimate) = observed.estimate.filter(|_| settled) {
            run.speed_max = run.speed_max.max(estimate.speed.abs());
        }
        if let Some(estimate) = observed.estimate
            && settled
            && let Some(truth) = seen.motion(tick.time)
        {
            run.compared.push(Compared {
                time: tick.time,
                speed: estimate.speed,
                yaw_rate: estimate.yaw_rate,
                sideslip: estimate.sideslip,
                deviation: pilot.estimator().sideslip_variance().sqrt(),
                truth,
            });
        }
    }
    run.gyro_scale = (log.imu != Imu::Missing).then(|| pilot.estimator().gyro_scale());
    run.track = seen;
    run
}

/// A record, as a pilot is fed from it.
#[derive(Debug, Default)]
pub(super) struct Log {
    pub(super) ticks: Vec<Tick>,
    /// What the cameras saw, in the order of its arrival.
    pub(super) frames: Vec<Observation>,
    /// The poses a second that the pilot is given; all without it.
    pub(super) cameras_hz: Option<f64>,
    /// The first tick of the record.
    pub(super) begin: Time,
    /// What the record has of an IMU.
    pub(super) imu: Imu,
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

impl Tick {
    pub(super) fn has_board(&self) -> bool {
        let is_board = |event: &Event| matches!(event, Event::Board(_));
        self.events.iter().any(is_board)
    }
}

impl Log {
    /// Reads a part of a record.
    pub(super) fn read(path: &Path, part: Part) -> Result<Self, RecordError> {
        let Part { from_s, to_s, .. } = part;
        let mut log = Self {
            imu: Imu::Missing,
            cameras_hz: part.cameras_hz,
            ..Self::default()
        };
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
            let last = log.ticks.iter().rposition(Tick::has_board);
            log.ticks.truncate(last.map_or(0, |last| last + 1));
        }
        log.begin = log.ticks.first().map_or(Time(0), |tick| tick.time);
        let lies = |time: Time| (from_s..=to_s).contains(&time.seconds_since(log.begin));
        log.ticks.retain(|tick| lies(tick.time));
        log.frames.retain(|frame| lies(Time(frame.receive_time_ns)));
        Ok(log)
    }

    fn tick(&mut self, tick: &TickRecord) {
        let output = &tick.output;
        let command = output.command;
        self.has_speed |= command.is_some();
        for event in &tick.events {
            self.has_health |= matches!(event, Event::Health(_));
            self.has_attitude |= matches!(event, Event::Attitude(_));
            if let Event::Board(board) = event
                && let Some(inertial) = board.inertial
            {
                if inertial.forward_acceleration.is_finite() {
                    self.imu = Imu::Whole;
                } else if self.imu == Imu::Missing {
                    self.imu = Imu::Gyro;
                }
            }
        }
        self.ticks.push(Tick {
            time: tick.pilot_time,
            events: tick.events.to_vec(),
            commanded: Commanded {
                steering: command.map_or(output.actuation.steering, |command| command.steering),
                speed: command.map(|command| command.rear_speed),
                drives: matches!(output.mode, Mode::Driving | Mode::Slowing),
                // Known when all of the record is read.
                imu: Imu::Missing,
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
