//! From entries to messages on channels, for the file and for live viewers: their own, and the standard
//! messages that follow from them, among them the states of pilot, board and record for diagnostics tools.

#[cfg(test)]
mod tests;

use core::{array::from_fn, ops::Range};

use serde::Serialize;
use singletrack_control::{Covariance, Estimate, Position};
use singletrack_mocap::{Pose as BodyPose, PoseState};
use singletrack_pilot::{Mode, Reason};
use singletrack_protocol::{BoardMode, Status, StopCause};

use crate::{
    BASE_FRAME, Channel, ClockMapping, Entry, LinkPhase, MAP_FRAME, ODOM_FRAME, StandardTopic,
    TelemetryRecord, TickRecord,
    message::{self, Coded},
    standard::{
        AckermannDrive, AckermannDriveStamped, Byte, DiagnosticArray, DiagnosticStatus, Header,
        Imu, KeyValue, Log, Odometry, Point, PointStamped, Pose, PoseStamped, PoseWithCovariance,
        Quaternion, TfMessage, Time, Transform, TransformStamped, Twist, TwistWithCovariance,
        Vector3,
    },
};

/// Encodes entries as the messages of the channels.
///
/// An entry gives one complete message on its own topic, then the messages on the
/// [`crate::StandardTopic`]s that follow from it. The same entries in the same order
/// give the same bytes. An encoder allocates: use it on the thread that writes or sends.
#[derive(Debug)]
pub struct Encoder {
    diagnostics: Diagnostics,
    batch: Batch,
}

impl Encoder {
    /// An encoder for a record that begins at `start`.
    pub fn new(start: ClockMapping) -> Self {
        Self {
            diagnostics: Diagnostics::default(),
            batch: Batch {
                start,
                // Enough for a tick and all messages that follow from it.
                bytes: Vec::with_capacity(8 << 10),
                messages: Vec::with_capacity(Channel::COUNT),
            },
        }
    }

    /// The messages of `entry`, its own first.
    ///
    /// # Errors
    ///
    /// When one of them can't be encoded. Then none is returned.
    pub fn encode(
        &mut self,
        entry: &Entry,
    ) -> Result<impl Iterator<Item = Publication<'_>>, String> {
        let batch = &mut self.batch;
        batch.bytes.clear();
        batch.messages.clear();
        let own = Channel::Entry(entry.topic());
        batch.add_encoded(own, entry.sample_time_ns(), |bytes| entry.encode(bytes))?;
        derive(entry, batch)?;
        self.diagnostics.take(entry, batch)?;
        let batch = &self.batch;
        let log_time_ns = batch.start.wall_ns_at(entry.time_ns());
        let messages = batch.messages.iter();
        Ok(
            messages.map(move |(channel, publish_time_ns, range)| Publication {
                channel: *channel,
                log_time_ns,
                publish_time_ns: *publish_time_ns,
                bytes: batch.bytes.get(range.clone()).unwrap_or_default(),
            }),
        )
    }
}

/// A message on a channel. Times are on the wall clock, in ns since 1970, by the mapping
/// taken when the record began.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Publication<'a> {
    /// Its channel.
    pub channel: Channel,
    /// When its entry reached the host.
    pub log_time_ns: u64,
    /// When the described event happened.
    pub publish_time_ns: u64,
    /// The message as ROS 2 encodes it: CDR with its header.
    pub bytes: &'a [u8],
}

/// The messages of one entry, end to end.
#[derive(Debug)]
struct Batch {
    start: ClockMapping,
    bytes: Vec<u8>,
    /// Channels, times on the wall clock, and where the bytes are.
    messages: Vec<(Channel, u64, Range<usize>)>,
}

impl Batch {
    /// Adds a message about `time_ns`, on the monotonic clock.
    fn add(
        &mut self,
        topic: StandardTopic,
        time_ns: u64,
        message: &impl Serialize,
    ) -> Result<(), String> {
        self.add_encoded(Channel::Standard(topic), time_ns, |bytes| {
            message::encode(message, bytes)
        })
    }

    /// Adds a message that `encode` appends to the bytes.
    fn add_encoded(
        &mut self,
        channel: Channel,
        time_ns: u64,
        encode: impl FnOnce(&mut Vec<u8>) -> Result<(), cdr_encoding::Error>,
    ) -> Result<(), String> {
        let start = self.bytes.len();
        // Only a text that is longer than 4 GB can't be.
        encode(&mut self.bytes)
            .map_err(|error| format!("can't encode a message of {}: {error}", channel.topic()))?;
        let range = start..self.bytes.len();
        let message = (channel, self.start.wall_ns_at(time_ns), range);
        self.messages.push(message);
        Ok(())
    }

    /// A header for a time of the monotonic clock.
    fn header(&self, time_ns: u64, frame_id: &'static str) -> Header {
        Header {
            stamp: self.stamp(time_ns),
            frame_id,
        }
    }

    fn stamp(&self, time_ns: u64) -> Time {
        const SECOND: u64 = 1_000_000_000;
        let wall_ns = self.start.wall_ns_at(time_ns);
        Time {
            // The seconds of ROS end in 2038.
            sec: i32::try_from(wall_ns / SECOND).unwrap_or(i32::MAX),
            nanosec: (wall_ns % SECOND) as u32,
        }
    }
}

/// The covariance of an unknown quantity of [`Imu`].
const UNKNOWN: [[f64; 3]; 3] = [[0.0; 3]; 3];

/// The variance of what the estimate does not have: height, roll and pitch, and their changes; and
/// of everything where its covariance is not known.
const LARGE: f64 = 1e6;

/// Unit of a component of a quaternion in telemetry.
const Q14: f64 = 1.0 / 16_384.0;

/// The name of the source in lines of the log.
const NODE: &str = "singletrack";

/// Adds the messages that follow from `entry` alone.
fn derive(entry: &Entry, batch: &mut Batch) -> Result<(), String> {
    match entry {
        Entry::Tick(tick) => from_tick(tick, batch),
        Entry::Telemetry(record) => from_telemetry(record, batch),
        Entry::Pose(observation) => match observation.state {
            PoseState::Valid(pose) => from_pose(&pose, batch),
            _ => Ok(()),
        },
        Entry::Log(log) => {
            let message = Log {
                stamp: batch.stamp(log.time_ns),
                level: log.level.code(),
                name: NODE,
                msg: log.text.clone(),
                file: "",
                function: "",
                line: 0,
            };
            batch.add(StandardTopic::Rosout, log.time_ns, &message)
        }
        Entry::Status(_) | Entry::Configuration(_) | Entry::Drops(_) => Ok(()),
    }
}

fn from_tick(tick: &TickRecord, batch: &mut Batch) -> Result<(), String> {
    let output = &tick.output;
    let time_ns = tick.pilot_time.0;
    if let Some(estimate) = &output.estimate {
        from_estimate(estimate, output.covariance.as_ref(), batch)?;
    }
    if let Some(command) = output.command {
        let message = AckermannDriveStamped {
            header: batch.header(time_ns, BASE_FRAME),
            drive: AckermannDrive {
                steering_angle: command.steering as f32,
                steering_angle_velocity: output.actuation.steering_rate as f32,
                speed: command.rear_speed as f32,
                acceleration: 0.0,
                jerk: 0.0,
            },
        };
        batch.add(StandardTopic::Command, time_ns, &message)?;
    }
    let reference = output.reference.and_then(|reference| reference.position);
    for (topic, position) in [
        (StandardTopic::Reference, reference),
        (StandardTopic::PointP, output.point),
    ] {
        if let Some(position) = position {
            let message = PointStamped {
                header: batch.header(time_ns, MAP_FRAME),
                point: on_the_floor(position),
            };
            batch.add(topic, time_ns, &message)?;
        }
    }
    Ok(())
}

fn from_estimate(
    estimate: &Estimate,
    covariance: Option<&Covariance>,
    batch: &mut Batch,
) -> Result<(), String> {
    let time_ns = estimate.time.0;
    let odometry = Odometry {
        header: batch.header(time_ns, ODOM_FRAME),
        child_frame_id: BASE_FRAME,
        pose: PoseWithCovariance {
            pose: Pose {
                position: on_the_floor(estimate.position),
                orientation: about_z(estimate.yaw),
            },
            covariance: planar(covariance.map(|of| of.pose)),
        },
        twist: TwistWithCovariance {
            twist: Twist {
                linear: vector([
                    estimate.speed * libm::cos(estimate.sideslip),
                    estimate.speed * libm::sin(estimate.sideslip),
                    0.0,
                ]),
                angular: vector([0.0, 0.0, estimate.yaw_rate]),
            },
            covariance: planar(covariance.map(|of| of.twist)),
        },
    };
    batch.add(StandardTopic::Odometry, time_ns, &odometry)?;
    let transform = |frame_id, child_frame_id, position: Position, yaw| TransformStamped {
        header: batch.header(time_ns, frame_id),
        child_frame_id,
        transform: Transform {
            translation: vector([position.x, position.y, 0.0]),
            rotation: about_z(yaw),
        },
    };
    // The estimate does not drift: odometry and map are the same.
    let transforms = TfMessage {
        transforms: vec![
            transform(MAP_FRAME, ODOM_FRAME, Position::origin(), 0.0),
            transform(ODOM_FRAME, BASE_FRAME, estimate.position, estimate.yaw),
        ],
    };
    batch.add(StandardTopic::Transforms, time_ns, &transforms)
}

fn from_telemetry(record: &TelemetryRecord, batch: &mut Batch) -> Result<(), String> {
    let Some(time_ns) = record.new_imu_time_ns() else {
        return Ok(());
    };
    let attitude = record.telemetry.attitude_q14;
    let [w, x, y, z] = attitude.map(|part| f64::from(part) * Q14);
    let message = Imu {
        header: batch.header(time_ns, BASE_FRAME),
        orientation: Quaternion { x, y, z, w },
        orientation_covariance: UNKNOWN,
        angular_velocity: vector(record.angular_velocity_rad_s()),
        angular_velocity_covariance: UNKNOWN,
        linear_acceleration: vector(record.linear_acceleration_m_s2()),
        linear_acceleration_covariance: UNKNOWN,
    };
    batch.add(StandardTopic::Imu, time_ns, &message)
}

fn from_pose(pose: &BodyPose, batch: &mut Batch) -> Result<(), String> {
    let time_ns = pose.capture_time_ns;
    let message = PoseStamped {
        header: batch.header(time_ns, MAP_FRAME),
        pose: Pose {
            position: Point {
                x: pose.x_m,
                y: pose.y_m,
                z: pose.z_m,
            },
            orientation: about_z(pose.yaw_rad),
        },
    };
    batch.add(StandardTopic::MocapPose, time_ns, &message)
}

/// The covariance of x, y, z and the rotations about them, with that of x, y and yaw.
fn planar(known: Option<[f64; 6]>) -> [[f64; 6]; 6] {
    let mut all = from_fn(|row| from_fn(|column| if row == column { LARGE } else { 0.0 }));
    if let Some([x_x, x_y, x_yaw, y_y, y_yaw, yaw_yaw]) = known {
        [all[0][0], all[0][1], all[0][5]] = [x_x, x_y, x_yaw];
        [all[1][0], all[1][1], all[1][5]] = [x_y, y_y, y_yaw];
        [all[5][0], all[5][1], all[5][5]] = [x_yaw, y_yaw, yaw_yaw];
    }
    all
}

fn on_the_floor(position: Position) -> Point {
    Point {
        x: position.x,
        y: position.y,
        z: 0.0,
    }
}

fn about_z(yaw: f64) -> Quaternion {
    Quaternion {
        x: 0.0,
        y: 0.0,
        z: libm::sin(yaw / 2.0),
        w: libm::cos(yaw / 2.0),
    }
}

const fn vector([x, y, z]: [f64; 3]) -> Vector3 {
    Vector3 { x, y, z }
}

const OK: Byte = Byte(0);
const WARN: Byte = Byte(1);
const ERROR: Byte = Byte(2);
const STALE: Byte = Byte(3);

/// The `hardware_id` of every status.
const HARDWARE: &str = "singletrack";

/// The latest states.
#[derive(Debug, Default)]
struct Diagnostics {
    pilot: Option<Pilot>,
    board: Option<(BoardMode, StopCause)>,
    status: Option<Status>,
    /// Whether an error counter rose with the last status.
    trouble: bool,
    dropped: u64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Pilot {
    mode: Mode,
    reason: Option<Reason>,
    link: LinkPhase,
}

impl Diagnostics {
    /// Takes an entry, and adds a message if a state has changed or the board has sent its
    /// status.
    fn take(&mut self, entry: &Entry, batch: &mut Batch) -> Result<(), String> {
        match entry {
            Entry::Tick(tick) => {
                let pilot = Some(Pilot {
                    mode: tick.output.mode,
                    reason: tick.output.reason,
                    link: tick.link,
                });
                if pilot == self.pilot {
                    return Ok(());
                }
                self.pilot = pilot;
            }
            Entry::Status(record) => {
                self.trouble = self
                    .status
                    .is_some_and(|before| troubles(&before) != troubles(&record.status));
                self.status = Some(record.status);
            }
            Entry::Drops(drops) => self.dropped = drops.entries,
            Entry::Telemetry(record) => {
                self.board = Some((record.telemetry.mode, record.telemetry.stop_cause));
                return Ok(());
            }
            Entry::Pose(_) | Entry::Log(_) | Entry::Configuration(_) => return Ok(()),
        }
        let known = [self.pilot(), self.board(), Some(self.record())];
        let message = DiagnosticArray {
            header: batch.header(entry.time_ns(), ""),
            status: known.into_iter().flatten().collect(),
        };
        batch.add(StandardTopic::Diagnostics, entry.time_ns(), &message)
    }

    fn pilot(&self) -> Option<DiagnosticStatus> {
        let Pilot { mode, reason, link } = self.pilot?;
        let level = match (mode, reason) {
            (Mode::Fault, _) => ERROR,
            (Mode::Ready | Mode::Arming | Mode::Driving, _)
            | (_, None | Some(Reason::Requested | Reason::ReferenceFinished)) => OK,
            (_, Some(_)) => WARN,
        };
        let reason = reason.map_or("none", Reason::name);
        Some(DiagnosticStatus {
            level,
            name: "singletrack: pilot",
            message: match reason {
                "none" => mode.name().to_owned(),
                reason => format!("{mode}: {reason}"),
            },
            hardware_id: HARDWARE,
            values: vec![
                pair("mode", mode.name()),
                pair("reason", reason),
                pair("link", link.name()),
            ],
        })
    }

    fn board(&self) -> Option<DiagnosticStatus> {
        let report = self.status?;
        let pilot = self.pilot.as_ref();
        let lost = pilot.is_some_and(|pilot| pilot.link != LinkPhase::Ready);
        let mode = self.board.map(|(mode, _)| mode);
        let level = match mode {
            _ if lost => STALE,
            Some(BoardMode::Failsafe | BoardMode::EmergencyStopped) => ERROR,
            Some(BoardMode::Boot) => WARN,
            _ if report.stop_input_open || self.trouble => WARN,
            _ => OK,
        };
        let message = match mode {
            _ if lost => "no word from the board",
            Some(mode) => mode.name(),
            None => "no telemetry yet",
        };
        let mut values = Vec::new();
        if let Some((mode, cause)) = self.board {
            values.extend([pair("mode", mode.name()), pair("stop_cause", cause.name())]);
        }
        values.extend([
            pair("battery_V", &(f64::from(report.battery_mv) / 1_000.0)),
            pair("stop_input_open", &report.stop_input_open),
            pair("reset_cause", report.reset_cause.name()),
            pair(
                "configuration_hash",
                &format_args!("{:08x}", report.configuration_hash),
            ),
            pair("frames_received", &report.frames_received),
            pair("frames_damaged", &report.frames_damaged),
            pair("frames_dropped", &report.frames_dropped),
            pair("drives_refused", &report.drives_refused),
            pair("last_refusal", report.last_refusal.name()),
            pair("bytes_overrun", &report.bytes_overrun),
            pair("imu_errors", &report.imu_errors),
        ]);
        Some(DiagnosticStatus {
            level,
            name: "singletrack: board",
            message: message.to_owned(),
            hardware_id: HARDWARE,
            values,
        })
    }

    fn record(&self) -> DiagnosticStatus {
        let (level, message) = match self.dropped {
            0 => (OK, "complete".to_owned()),
            dropped => (WARN, format!("{dropped} entries are missing")),
        };
        DiagnosticStatus {
            level,
            name: "singletrack: record",
            message,
            hardware_id: HARDWARE,
            values: vec![pair("entries_dropped", &self.dropped)],
        }
    }
}

/// The counters of errors.
const fn troubles(status: &Status) -> [u16; 5] {
    [
        status.frames_damaged,
        status.frames_dropped,
        status.drives_refused,
        status.bytes_overrun,
        status.imu_errors,
    ]
}

fn pair(key: &'static str, value: &(impl ToString + ?Sized)) -> KeyValue {
    KeyValue {
        key,
        value: value.to_string(),
    }
}
