//! Collects the data of the identification from the entries of a record: only data that
//! a real car has too, never the simulator's truth.

use std::path::{Path, PathBuf};

use singletrack_analysis::identification::{
    DriveData, Identification, IdentificationError, Inertial, Pose, Score, ServoFrames,
    ServoTarget, Span,
};
use singletrack_control::{InertialSample, SteeringMap, Time, VehicleParameters, direction};
use singletrack_core::{
    Config, ConfigError,
    config::{ActuatorsSection, WatchSection},
};
use singletrack_figures::plot;
use singletrack_pilot::{BoardSample, Event};
use singletrack_record::{Entry, Reader, TelemetryRecord, TickRecord, Topic, seconds_since};

use super::{Identified, LogScore};
use crate::Result;

/// Drives on one clock, one after another.
#[derive(Clone, Debug)]
pub(super) struct Drives {
    /// The car of the configuration that the first was driven with.
    pub(super) vehicle: VehicleParameters,
    /// Dead time and lag of the steering, in s, of a configuration that says them.
    pub(super) steering: Option<[f64; 2]>,
    /// What was measured, in s since the first drive began.
    pub(super) data: DriveData,
    /// The periods that begin a servo pulse, if they are known of every drive.
    pub(super) frames: Option<ServoFrames>,
    parts: Vec<Part>,
}

/// A drive of a record.
#[derive(Clone, Debug)]
struct Part {
    path: PathBuf,
    /// Its number in the record, from 1.
    drive: usize,
    span: Span,
}

/// Servo pulses and samples are used from this time before the drive on, in ns.
const LEAD_NS: u64 = 1_000_000_000;

/// Reads the drive with this number, from 1, or the longest. `config` replaces the configuration that it
/// was driven with. `note` is told the record, and what a reader of the result has to know.
///
/// # Errors
///
/// When there is none, or the record can't be read.
pub(super) fn read(
    path: &Path,
    number: Option<usize>,
    config: Option<&Config>,
    note: impl Fn(&Path, &str),
) -> Result<Drives> {
    let record = plot::Record::read(path)?;
    let (number, drive) = record.choose(number)?;
    let name = path.display();
    let unusable = |error: ConfigError| {
        format!(
            "the configuration in {name}, which has the servo's calibration, is not one that this \
             version of singletrack takes: {error}"
        )
    };
    let config = match config {
        Some(config) => config.clone(),
        None => {
            let toml = record.configuration(drive);
            let toml = toml.ok_or_else(|| {
                format!(
                    "{name} does not hold the configuration that drive {number} was driven with: \
                     choose another with --drive"
                )
            })?;
            let empty = |line: &str| line.trim().is_empty() || line.starts_with('#');
            if toml.lines().all(empty) {
                return Err(format!(
                    "{name} was imported and holds no configuration of a car: give it with --config \
                     CAR.toml"
                )
                .into());
            }
            Config::from_toml(toml).map_err(unusable)?
        }
    };
    let end_ns = drive.start_ns + (drive.duration() * 1e9) as u64;
    let mut collector = Collector::new(&config, drive.start_ns).map_err(unusable)?;
    let mut reader = Reader::open(&record.path)?.only(&[Topic::Tick, Topic::Telemetry]);
    // The notes already report the damage.
    reader.take_undamaged(|entry| collector.take(entry))?;
    let note = |text: &str| note(&record.path, text);
    record.notes.iter().for_each(|text| note(text));
    let count = record.recording.drives.len();
    if count > 1 {
        note(&format!(
            "drive {number} of {count}, {:.1} s; choose another with --drive",
            drive.duration()
        ));
    }
    if !collector.has_accelerometer() {
        note(
            "it has no accelerometer: the forward acceleration is that of the cameras, and nothing is compared \
             with an acceleration to the left",
        );
    }
    let frames = collector.frames();
    if frames.is_some() {
        note("it has no telemetry of a board: the commands stand for the servo's pulses");
    }
    let data = collector.until(end_ns);
    let model = config.actuators.model();
    let is_said = config.actuators != ActuatorsSection::default();
    let start_s = times(&data).fold(f64::INFINITY, f64::min);
    Ok(Drives {
        vehicle: config.vehicle,
        steering: is_said.then_some([model.steering_dead_time, model.steering_lag]),
        frames,
        parts: vec![Part {
            path: record.path.clone(),
            drive: number,
            span: Span {
                start_s,
                end_s: times(&data).fold(start_s, f64::max),
            },
        }],
        data,
    })
}

/// Collects the data of the identification from the entries of a record, in order.
#[derive(Clone, Debug)]
pub struct Collector {
    /// Zero of the times, in ns of the host's monotonic clock.
    start_ns: u64,
    steering: SteeringMap,
    /// From G to the rigid body's origin, forward and left, in m.
    marker_offset: [f64; 2],
    marker_yaw: f64,
    watch: WatchSection,
    data: DriveData,
    /// Inertial samples and steering of the ticks, for a record without telemetry: a log of another
    /// program.
    of_ticks: DriveData,
    /// Board time that has passed since the first record, in µs, and the newest.
    board: Option<(u64, u32)>,
}

/// The board's control period, and that of its records, in µs.
const BOARD_PERIOD_US: u64 = 10_000;

impl Collector {
    /// For a drive with this configuration that began at `start_ns` of the host's
    /// monotonic clock.
    ///
    /// # Errors
    ///
    /// When the configuration is invalid.
    pub fn new(config: &Config, start_ns: u64) -> Result<Self, ConfigError> {
        let estimator = config.pilot()?.estimator;
        Ok(Self {
            start_ns,
            steering: config.steering_map()?,
            marker_offset: estimator.marker_offset,
            marker_yaw: estimator.marker_yaw,
            watch: config.watch,
            data: DriveData::default(),
            of_ticks: DriveData::default(),
            board: None,
        })
    }

    /// Takes in the next entry.
    pub fn take(&mut self, entry: &Entry) {
        match entry {
            Entry::Tick(tick) => self.take_tick(tick),
            Entry::Telemetry(record) => self.take_telemetry(record),
            _ => {}
        }
    }

    fn take_tick(&mut self, tick: &TickRecord) {
        for event in &tick.events {
            match event {
                Event::Pose(pose) if pose.capture.0 + LEAD_NS >= self.start_ns => {
                    let yaw = pose.yaw - self.marker_yaw;
                    let along = direction(yaw);
                    let [forward, left] = self.marker_offset;
                    let pose = Pose {
                        time_s: self.seconds(pose.capture.0),
                        x_m: pose.position.x - (along.x * forward - along.y * left),
                        y_m: pose.position.y - (along.y * forward + along.x * left),
                        yaw_rad: yaw,
                    };
                    push_later(&mut self.data.poses, pose, |pose| pose.time_s);
                }
                Event::Board(BoardSample {
                    inertial: Some(sample),
                    ..
                }) => self.take_inertial(sample, true),
                _ => {}
            }
        }
        let output = &tick.output;
        if tick.pilot_time.0 + LEAD_NS >= self.start_ns {
            self.of_ticks.servo.push(ServoTarget {
                time_s: self.seconds(tick.pilot_time.0),
                period: tick.index,
                angle_rad: output
                    .command
                    .map_or(output.actuation.steering, |command| command.steering),
            });
        }
    }

    fn take_telemetry(&mut self, record: &TelemetryRecord) {
        let telemetry = &record.telemetry;
        let now_us = telemetry.board_time_us;
        // The board's clock wraps after 71 minutes, in the middle of a period.
        let passed = match self.board {
            None => u64::from(now_us),
            Some((passed, last)) => passed + u64::from(now_us.wrapping_sub(last)),
        };
        self.board = Some((passed, now_us));
        if record.board_time_host_ns + LEAD_NS < self.start_ns {
            return;
        }
        if telemetry.servo_us != 0 {
            let target = ServoTarget {
                time_s: self.seconds(record.board_time_host_ns),
                period: (passed + BOARD_PERIOD_US / 2) / BOARD_PERIOD_US,
                angle_rad: self.steering.angle(telemetry.servo_us.into()),
            };
            push_later(&mut self.data.servo, target, |target| target.time_s);
        }
        if let Some(time_ns) = record.new_imu_time_ns() {
            let [forward_acceleration, left_acceleration, _] = record.linear_acceleration_m_s2();
            let [_, _, yaw_rate] = record.angular_velocity_rad_s();
            let sample = InertialSample {
                time: Time(time_ns),
                yaw_rate,
                forward_acceleration,
                left_acceleration,
            };
            self.take_inertial(&sample, false);
        }
    }

    /// Takes a sample that the car can have made.
    fn take_inertial(&mut self, sample: &InertialSample, of_tick: bool) {
        // A car of another program's log may have a gyro alone.
        let mut judged = *sample;
        if sample.forward_acceleration.is_nan() && of_tick {
            judged.forward_acceleration = 0.0;
            judged.left_acceleration = 0.0;
        }
        if sample.time.0 + LEAD_NS < self.start_ns || !self.watch.is_possible(&judged) {
            return;
        }
        let time_s = self.seconds(sample.time.0);
        let data = if of_tick {
            &mut self.of_ticks
        } else {
            &mut self.data
        };
        let sample = Inertial {
            time_s,
            yaw_rate_rad_s: sample.yaw_rate,
            forward_m_s2: sample.forward_acceleration,
            left_m_s2: sample.left_acceleration,
        };
        push_later(&mut data.inertial, sample, |sample| sample.time_s);
    }

    fn seconds(&self, time_ns: u64) -> f64 {
        seconds_since(self.start_ns, time_ns)
    }

    /// The periods that begin a servo pulse, if no board has recorded its own.
    pub fn frames(&self) -> Option<ServoFrames> {
        self.board.is_none().then_some(ServoFrames::Every)
    }

    /// Whether the record has samples of an accelerometer.
    pub fn has_accelerometer(&self) -> bool {
        let mut samples = self.data.inertial.iter().chain(&self.of_ticks.inertial);
        samples.any(|sample| !sample.forward_m_s2.is_nan())
    }

    /// The data collected until `end_ns` of the host's monotonic clock.
    #[must_use]
    pub fn until(mut self, end_ns: u64) -> DriveData {
        let end_s = self.seconds(end_ns);
        let has_accelerometer = self.has_accelerometer();
        if self.board.is_none() {
            self.data.inertial = self.of_ticks.inertial;
            self.data.servo = self.of_ticks.servo;
        }
        self.data.poses.retain(|pose| pose.time_s <= end_s);
        self.data.inertial.retain(|sample| sample.time_s <= end_s);
        self.data.servo.retain(|target| target.time_s <= end_s);
        if !has_accelerometer {
            self.data.take_acceleration_of_poses();
        }
        self.data
    }
}

/// Adds a sample, but not one that is late.
fn push_later<T>(samples: &mut Vec<T>, sample: T, time_s: fn(&T) -> f64) {
    if samples
        .last()
        .is_none_or(|last| time_s(&sample) > time_s(last))
    {
        samples.push(sample);
    }
}

/// Between two drives, in s: longer than any gap that a fit bridges.
const BETWEEN: f64 = 10.0;

impl Drives {
    /// Adds a drive, a while after the last one.
    pub(super) fn push(&mut self, mut other: Self) {
        let Some(last) = self.parts.last() else {
            return;
        };
        let from = times(&other.data).fold(f64::INFINITY, f64::min);
        let shift = last.span.end_s + BETWEEN - from;
        let DriveData {
            poses,
            inertial,
            servo,
        } = &mut other.data;
        poses.iter_mut().for_each(|pose| pose.time_s += shift);
        inertial
            .iter_mut()
            .for_each(|sample| sample.time_s += shift);
        servo.iter_mut().for_each(|target| target.time_s += shift);
        self.data.poses.append(poses);
        self.data.inertial.append(inertial);
        self.data.servo.append(servo);
        self.parts.extend(other.parts.into_iter().map(|mut part| {
            part.span.start_s += shift;
            part.span.end_s += shift;
            part
        }));
        self.frames = self.frames.filter(|frames| other.frames == Some(*frames));
    }

    pub(super) fn failed(&self, error: &IdentificationError) -> String {
        let records = self.parts.iter();
        let records = records.map(|part| format!("{}, drive {}", part.path.display(), part.drive));
        format!("{}: {error}", records.collect::<Vec<_>>().join(", "))
    }

    pub(super) fn identified(self, identification: Identification) -> Identified {
        let logs = self.parts.into_iter().map(|part| LogScore {
            score: Score::within(&identification.simulation, part.span),
            path: part.path,
            drive: part.drive,
        });
        Identified {
            logs: logs.collect(),
            identification,
        }
    }
}

/// The times of all samples, in s.
fn times(data: &DriveData) -> impl Iterator<Item = f64> {
    let poses = data.poses.iter().map(|pose| pose.time_s);
    let inertial = data.inertial.iter().map(|sample| sample.time_s);
    let servo = data.servo.iter().map(|target| target.time_s);
    poses.chain(inertial).chain(servo)
}
