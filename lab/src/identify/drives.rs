//! Several drives as one.

use std::path::PathBuf;

use singletrack_analysis::identification::{
    DriveData, Identification, IdentificationError, Score, ServoFrames, Span,
};
use singletrack_control::VehicleParameters;

use super::{Identified, IdentifyError, LogScore, RecordedDrive};

/// Drives on one clock, one after another.
#[derive(Clone, Debug)]
pub(super) struct Drives {
    /// The car of the first.
    pub(super) vehicle: VehicleParameters,
    pub(super) data: DriveData,
    /// The periods that begin a servo pulse, if they are known of every drive.
    pub(super) frames: Option<ServoFrames>,
    parts: Vec<Part>,
}

#[derive(Clone, Debug)]
struct Part {
    path: PathBuf,
    drive: usize,
    span: Span,
}

/// Between two drives, in s: longer than any gap that a fit bridges.
const BETWEEN: f64 = 10.0;

impl Drives {
    pub(super) fn of(first: RecordedDrive, others: Vec<RecordedDrive>) -> Self {
        let mut all = Self {
            vehicle: first.vehicle,
            data: DriveData::default(),
            frames: first.frames,
            parts: Vec::new(),
        };
        all.push(first);
        for other in others {
            all.push(other);
        }
        all
    }

    fn push(&mut self, mut drive: RecordedDrive) {
        let from = times(&drive.data).fold(f64::INFINITY, f64::min);
        let after = self.parts.last().map(|part| part.span.end_s + BETWEEN);
        // The first keeps its times.
        let shift = after.map_or(0.0, |after| after - from);
        let DriveData {
            poses,
            inertial,
            servo,
        } = &mut drive.data;
        poses.iter_mut().for_each(|pose| pose.time_s += shift);
        inertial
            .iter_mut()
            .for_each(|sample| sample.time_s += shift);
        servo.iter_mut().for_each(|target| target.time_s += shift);
        let end_s = times(&drive.data).fold(from + shift, f64::max);
        self.parts.push(Part {
            path: drive.path,
            drive: drive.number,
            span: Span {
                start_s: from + shift,
                end_s,
            },
        });
        self.data.poses.append(&mut drive.data.poses);
        self.data.inertial.append(&mut drive.data.inertial);
        self.data.servo.append(&mut drive.data.servo);
        self.frames = self.frames.filter(|frames| drive.frames == Some(*frames));
    }

    pub(super) fn failed(&self, source: IdentificationError) -> IdentifyError {
        let records = self.parts.iter();
        let records = records.map(|part| format!("{}, drive {}", part.path.display(), part.drive));
        IdentifyError::Identification {
            records: records.collect::<Vec<_>>().join(", "),
            source,
        }
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
