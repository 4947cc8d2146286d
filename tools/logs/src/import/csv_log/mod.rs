//! A log in a CSV file.

mod error;
mod row;
mod sensor;

use std::path::Path;

use csv::{ErrorKind, ReaderBuilder, StringRecord, Trim};

pub use error::{Cell, CsvError, TimeFault};

use super::{
    FIRST_ROW_NS, decimal,
    log::Log,
    map::{ImuSection, Map, MotorSection, SteeringMap, TimeSection, nanoseconds},
    samples::{Sample, Series},
};
use row::{Header, Place, Row};
use sensor::{Column, Poses, Sensor};

/// Reads the file `path` as `map` says.
pub(super) fn read(path: &Path, map: &Map) -> Result<Log, CsvError> {
    let failure = |error| failure(path, error);
    let mut reader = ReaderBuilder::new()
        .delimiter(u8::try_from(map.delimiter).unwrap_or(b','))
        .trim(Trim::All)
        .from_path(path)
        .map_err(failure)?;
    let names = reader.headers().map_err(failure)?.clone();
    if names.is_empty() {
        return Err(CsvError::Empty(path.to_owned()));
    }
    let header = Header::new(path, &names);
    let mut columns = Columns::find(&header, map)?;
    let mut clock = Clock::find(&header, &map.time)?;
    let mut cells = StringRecord::new();
    while reader.read_record(&mut cells).map_err(failure)? {
        let row = header.row(&cells);
        let time_ns = clock.time_ns(&row)?;
        columns.take(&row, time_ns)?;
    }
    match clock.ends() {
        Some((start_wall_ns, end_ns)) => Ok(columns.log(map, start_wall_ns, end_ns)),
        None => Err(CsvError::NoRows(path.to_owned())),
    }
}

/// An error of the CSV reader, with file, line and fix.
fn failure(path: &Path, error: csv::Error) -> CsvError {
    let line = |position: &Option<csv::Position>| row::line(path, position.as_ref());
    match error.kind() {
        ErrorKind::UnequalLengths {
            pos,
            expected_len,
            len,
        } => CsvError::Cells {
            path: path.to_owned(),
            line: line(pos),
            found: *len,
            expected: *expected_len,
        },
        ErrorKind::Utf8 { pos, .. } => CsvError::NotUtf8 {
            path: path.to_owned(),
            line: line(pos),
        },
        _ => CsvError::Read {
            path: path.to_owned(),
            source: error,
        },
    }
}

/// The time of the rows.
struct Clock<'a> {
    section: &'a TimeSection,
    place: Place,
    longest_gap_ns: u64,
    /// The first and the last time, in ns from the zero of the log.
    span: Option<(i64, i64)>,
}

impl<'a> Clock<'a> {
    fn find(header: &Header<'_>, section: &'a TimeSection) -> Result<Self, CsvError> {
        Ok(Self {
            section,
            place: header.find("time.column", &section.column)?,
            longest_gap_ns: nanoseconds(section.longest_gap_s),
            span: None,
        })
    }

    /// The time of a row on the clock of the record.
    fn time_ns(&mut self, row: &Row<'_>) -> Result<u64, CsvError> {
        let cell = row.cell(self.place);
        let time = decimal::scaled(cell, self.section.unit.exponent()).ok_or_else(|| {
            let fix = "correct the cell, remove the row, or name another time.column in the map";
            row.error(self.place, "a time as a decimal number", fix)
        })?;
        let (first, before) = self.span.unwrap_or((time, time));
        let since_ns = time.abs_diff(before);
        let since_s = since_ns as f64 * 1e-9;
        let fault = if self.section.unix && time < 0 {
            TimeFault::BeforeUnix
        } else if time < before {
            TimeFault::Backwards { back_s: since_s }
        } else if since_ns > self.longest_gap_ns {
            TimeFault::LongGap { gap_s: since_s }
        } else {
            self.span = Some((first, time));
            return Ok(FIRST_ROW_NS.saturating_add(time.abs_diff(first)));
        };
        Err(row.time_error(self.place, fault))
    }

    /// The wall time of the first row, and the time of the last one on the clock of the record;
    /// `None` without a row.
    fn ends(&self) -> Option<(u64, u64)> {
        let (first, last) = self.span?;
        let wall_ns = match self.section.unix {
            true => first.unsigned_abs(),
            false => 0,
        };
        Some((wall_ns, FIRST_ROW_NS.saturating_add(last.abs_diff(first))))
    }
}

/// The columns of a file, with what has been read of them.
struct Columns<'a> {
    poses: Poses<'a>,
    imu: Option<Sensor<3>>,
    motor: Sensor<1>,
    driving: Option<Driving>,
    steering: Steering,
    speed_command: Option<Sensor<1>>,
}

impl<'a> Columns<'a> {
    fn find(header: &Header<'_>, map: &'a Map) -> Result<Self, CsvError> {
        Ok(Self {
            poses: Poses::find(header, &map.pose)?,
            imu: map
                .imu
                .as_ref()
                .map(|imu| inertial(header, imu))
                .transpose()?,
            motor: motor(header, &map.motor)?,
            driving: match &map.driving {
                None => None,
                Some(section) => Some(Driving {
                    place: header.find("driving.column", &section.column)?,
                    changes: Vec::new(),
                }),
            },
            steering: Steering {
                place: header.find("steering.column", &map.steering.column)?,
                map: map.steering.map(),
                delay_ns: nanoseconds(map.steering.delay_s),
                samples: Vec::new(),
            },
            speed_command: match &map.speed_command {
                None => None,
                Some(section) => {
                    let column = Column::find(header, "speed_command.speed", &section.speed)?;
                    Some(Sensor::new([column], None, nanoseconds(section.delay_s)))
                }
            },
        })
    }

    fn take(&mut self, row: &Row<'_>, time_ns: u64) -> Result<(), CsvError> {
        self.poses.take(row, time_ns)?;
        if let Some(imu) = &mut self.imu {
            imu.take(row, time_ns)?;
        }
        self.motor.take(row, time_ns)?;
        if let Some(driving) = &mut self.driving {
            driving.take(row, time_ns)?;
        }
        self.steering.take(row, time_ns)?;
        match &mut self.speed_command {
            Some(command) => command.take(row, time_ns),
            None => Ok(()),
        }
    }

    fn log(self, map: &Map, start_wall_ns: u64, end_ns: u64) -> Log {
        let held = |sensor: Sensor<1>| Series::new(sensor.into_samples(), None);
        let inertial = self.imu.zip(map.imu.as_ref());
        Log {
            start_wall_ns,
            end_ns,
            poses: self.poses.into_poses(),
            inertial: inertial
                .map(|(sensor, imu)| Series::new(sensor.into_samples(), imu.interpolation())),
            motor_speed: Series::new(self.motor.into_samples(), map.motor.interpolation()),
            steering: Series::new(self.steering.samples, None),
            speed_command: self.speed_command.map(held),
            driving: self.driving.map(|driving| driving.changes),
            tick_ns: u64::from(map.tick_ms) * 1_000_000,
            phase_ns: map
                .pose
                .exposures_hz
                .map_or(0, |_| u64::from(map.tick_ms) * 200_000),
        }
    }
}

fn inertial(header: &Header<'_>, section: &ImuSection) -> Result<Sensor<3>, CsvError> {
    let forward = &section.forward_acceleration;
    let left = &section.left_acceleration;
    let columns = [
        Column::find(header, "imu.forward_acceleration", forward)?,
        Column::find(header, "imu.left_acceleration", left)?,
        Column::find(header, "imu.yaw_rate", &section.yaw_rate)?,
    ];
    let changes = header.find_if("imu.new_when_changes", &section.new_when_changes)?;
    Ok(Sensor::new(columns, changes, nanoseconds(section.delay_s)))
}

fn motor(header: &Header<'_>, section: &MotorSection) -> Result<Sensor<1>, CsvError> {
    let column = Column::find(header, "motor.speed", &section.speed)?;
    let changes = header.find_if("motor.new_when_changes", &section.new_when_changes)?;
    Ok(Sensor::new([column], changes, nanoseconds(section.delay_s)))
}

/// Whether the car is driven.
struct Driving {
    place: Place,
    changes: Vec<(u64, bool)>,
}

impl Driving {
    fn take(&mut self, row: &Row<'_>, time_ns: u64) -> Result<(), CsvError> {
        if row.are_empty([self.place]) {
            return Ok(());
        }
        let is_driving = row.flag(self.place)?;
        if self
            .changes
            .last()
            .is_none_or(|(_, last)| *last != is_driving)
        {
            self.changes.push((time_ns, is_driving));
        }
        Ok(())
    }
}

/// The steering command, as an angle.
struct Steering {
    place: Place,
    map: SteeringMap,
    delay_ns: u64,
    samples: Vec<Sample<1>>,
}

impl Steering {
    fn take(&mut self, row: &Row<'_>, time_ns: u64) -> Result<(), CsvError> {
        if row.are_empty([self.place]) {
            return Ok(());
        }
        self.samples.push(Sample {
            time_ns: time_ns - self.delay_ns,
            values: [self.map.angle(row.finite(self.place)?)],
        });
        Ok(())
    }
}
