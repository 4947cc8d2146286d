//! The rows of a log, and column by column the sensors and commands in them.

use singletrack_control::{direction, wrap};
use singletrack_mocap::{CaptureTimeSource, Observation, Pose, PoseState, RejectReason};

use super::{
    log::{FOLLOWED, ImportError, Interpolation, Log, Sample, Series},
    map::{
        Acceleration, Conversion, EmptyRows, ImuSection, Map, Messages, MotorSection, PoseSection,
        Quantity, interpolation, nanoseconds,
    },
};

/// The columns of a log, with what has been read of them.
pub(super) struct Columns<'a> {
    poses: Poses<'a>,
    imu: Option<Sensor<3>>,
    motor: Sensor<1>,
    driving: Option<Sensor<1>>,
    steering: Sensor<1>,
    speed_command: Option<Sensor<1>>,
}

impl<'a> Columns<'a> {
    /// Finds the columns that the map names.
    pub(super) fn find(header: &mut impl Header, map: &'a Map) -> Result<Self, ImportError> {
        let poses = Poses::find(header, &map.pose)?;
        let imu = map.imu.as_ref().map(|imu| inertial(header, imu));
        let (imu, motor) = (imu.transpose()?, motor(header, &map.motor)?);
        let driving = map.driving.as_ref().map(|section| {
            let place = header.find("driving.column", section.messages(), &section.column);
            place.map(|place| Sensor::held(Column::flag(place), 0))
        });
        let driving = driving.transpose()?;
        let (section, key) = (&map.steering, "steering.column");
        let place = header.find(key, section.messages(), &section.column)?;
        let steering = Sensor::held(Column::plain(place), nanoseconds(section.delay_s));
        let speed_command = map.speed_command.as_ref().map(|section| {
            let key = "speed_command.speed";
            let column = Column::find(header, key, section.messages(), &section.speed);
            column.map(|column| Sensor::held(column, nanoseconds(section.delay_s)))
        });
        Ok(Self {
            poses,
            imu,
            motor,
            driving,
            steering,
            speed_command: speed_command.transpose()?,
        })
    }

    /// Takes what a row has.
    pub(super) fn take(&mut self, row: &impl Row, time_ns: u64) -> Result<(), ImportError> {
        self.poses.take(row, time_ns)?;
        if let Some(imu) = &mut self.imu {
            imu.take(row, time_ns)?;
        }
        let others = [
            Some(&mut self.motor),
            self.driving.as_mut(),
            Some(&mut self.steering),
            self.speed_command.as_mut(),
        ];
        let mut others = others.into_iter().flatten();
        others.try_for_each(|sensor| sensor.take(row, time_ns))
    }

    /// What the rows say.
    pub(super) fn log(self, map: &Map, start_wall_ns: u64, end_ns: u64, sorted: u64) -> Log {
        let mut steering = self.steering.series;
        for sample in &mut steering.samples {
            sample.values = sample.values.map(|command| map.steering.angle(command));
        }
        Log {
            start_wall_ns,
            sorted,
            end_ns,
            exposures_are_known: map.pose.exposures_hz.is_some(),
            poses: self.poses.poses,
            inertial: self.imu.map(|sensor| sensor.series),
            motor_speed: self.motor.series,
            steering,
            speed_command: self.speed_command.map(|sensor| sensor.series),
            driving: self.driving.map(|sensor| sensor.series),
            tick_ns: u64::from(map.tick_ms) * 1_000_000,
            phase_ns: match map.pose.exposures_hz {
                None => 0,
                Some(_) => u64::from(map.tick_ms) * 200_000,
            },
        }
    }
}

fn inertial(header: &mut impl Header, section: &ImuSection) -> Result<Sensor<3>, ImportError> {
    let messages = section.messages();
    let yaw_rate = Column::find(header, "imu.yaw_rate", messages, &section.yaw_rate)?;
    let mut acceleration = |key, quantity: &Option<Quantity<Acceleration>>| match quantity {
        Some(quantity) => Column::find(header, key, messages, quantity),
        None => Ok(yaw_rate.unmeasured()),
    };
    let columns = [
        acceleration("imu.forward_acceleration", &section.forward_acceleration)?,
        acceleration("imu.left_acceleration", &section.left_acceleration)?,
        yaw_rate,
    ];
    let changes = header.find_if("imu.new_when_changes", messages, &section.new_when_changes)?;
    let interpolation = interpolation(section.interpolate_hz, section.longest_gap_s);
    let delay_ns = nanoseconds(section.delay_s);
    Ok(Sensor::new(columns, changes, delay_ns, interpolation))
}

fn motor(header: &mut impl Header, section: &MotorSection) -> Result<Sensor<1>, ImportError> {
    let messages = section.messages();
    let column = Column::find(header, "motor.speed", messages, &section.speed)?;
    let key = "motor.new_when_changes";
    let changes = header.find_if(key, messages, &section.new_when_changes)?;
    let interpolation = interpolation(section.interpolate_hz, section.longest_gap_s);
    let delay_ns = nanoseconds(section.delay_s);
    Ok(Sensor::new([column], changes, delay_ns, interpolation))
}

/// The place of a column in the rows of a log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Place {
    /// Which rows have the column: of a bag, those of one section of the map; of CSV files, those of one
    /// file.
    pub(super) source: usize,
    /// The column in these rows.
    pub(super) index: usize,
}

/// The columns of a log.
pub(super) trait Header {
    /// The place of the column, or the field of the section's messages, that `key` in the map names.
    fn find(
        &mut self,
        key: &'static str,
        messages: Messages<'_>,
        column: &str,
    ) -> Result<Place, ImportError>;

    /// [`find`](Self::find) for a key that may be left out.
    fn find_if(
        &mut self,
        key: &'static str,
        messages: Messages<'_>,
        column: &Option<String>,
    ) -> Result<Option<Place>, ImportError> {
        let column = column.as_ref();
        column
            .map(|column| self.find(key, messages, column))
            .transpose()
    }
}

/// A value in a row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Cell<'a> {
    Empty,
    Number(f64),
    /// A text as a file has it, which may be a number.
    Text(&'a str),
}

impl<'a> Cell<'a> {
    /// The cell with this text.
    pub(super) const fn of(text: &'a str) -> Self {
        if text.is_empty() {
            Self::Empty
        } else {
            Self::Text(text)
        }
    }

    /// The value as text, to compare it with that of another row.
    fn text(self) -> String {
        match self {
            Self::Empty => String::new(),
            Self::Number(number) => number.to_string(),
            Self::Text(text) => text.to_owned(),
        }
    }
}

/// A row of a log.
pub(super) trait Row {
    /// Whether the row has a column at this place.
    fn has(&self, place: Place) -> bool;

    /// The value at this place.
    fn cell(&self, place: Place) -> Cell<'_>;

    /// The error of a value that is not what is expected.
    fn wrong(&self, place: Place, expected: &str) -> ImportError;

    /// A number, which need not be finite; not a number where there is no value.
    fn number(&self, place: Place) -> Result<f64, ImportError> {
        match self.cell(place) {
            Cell::Empty => Ok(f64::NAN),
            Cell::Number(number) => Ok(number),
            Cell::Text(text) => text.parse().map_err(|_| self.wrong(place, "a number")),
        }
    }

    /// A finite number.
    fn finite(&self, place: Place) -> Result<f64, ImportError> {
        let number = self.number(place)?;
        match number.is_finite() {
            true => Ok(number),
            false => Err(self.wrong(place, "a finite number")),
        }
    }

    /// Whether a value is neither 0 nor `false`.
    fn flag(&self, place: Place) -> Result<bool, ImportError> {
        let number = match self.cell(place) {
            Cell::Text(text) if text.eq_ignore_ascii_case("true") => Ok(1.0),
            Cell::Text(text) if text.eq_ignore_ascii_case("false") => Ok(0.0),
            _ => self.number(place),
        };
        match number {
            Ok(number) if !number.is_nan() => Ok(number != 0.0),
            _ => Err(self.wrong(place, "a number, true or false")),
        }
    }

    /// Whether there is no value at any of these places.
    fn are_empty<const N: usize>(&self, places: [Place; N]) -> bool {
        let mut cells = places.iter().map(|place| self.cell(*place));
        cells.all(|cell| cell == Cell::Empty)
    }
}

/// Tells the rows with a new value from those that repeat an old one.
struct NewRows {
    place: Option<Place>,
    before: Option<String>,
}

impl NewRows {
    /// A row is new if the column at this place changes; every row is, without a place.
    const fn new(place: Option<Place>) -> Self {
        Self {
            place,
            before: None,
        }
    }

    /// Whether this row is new. The first one is not: its values may be old.
    fn is_new(&mut self, row: &impl Row) -> bool {
        let Some(place) = self.place else {
            return true;
        };
        let cell = row.cell(place).text();
        if self.before.as_ref() == Some(&cell) {
            return false;
        }
        self.before.replace(cell).is_some()
    }
}

/// A column with the conversion of its numbers.
#[derive(Clone, Copy)]
struct Column {
    place: Place,
    conversion: Conversion,
    /// Whether its values are taken as flags: 1 or 0.
    is_flag: bool,
}

impl Column {
    /// The column of the quantity that is at `key` in the map.
    fn find<D>(
        header: &mut impl Header,
        key: &'static str,
        messages: Messages<'_>,
        quantity: &Quantity<D>,
    ) -> Result<Self, ImportError> {
        Ok(Self {
            conversion: quantity.conversion,
            ..Self::plain(header.find(key, messages, &quantity.column)?)
        })
    }

    /// What is not measured where this column is: NaN.
    const fn unmeasured(self) -> Self {
        Self {
            conversion: Conversion::UNMEASURED,
            ..self
        }
    }

    /// A column whose numbers are taken as they are.
    const fn plain(place: Place) -> Self {
        Self {
            place,
            conversion: Conversion::NONE,
            is_flag: false,
        }
    }

    /// A column of what is so or not.
    const fn flag(place: Place) -> Self {
        Self {
            is_flag: true,
            ..Self::plain(place)
        }
    }

    /// The number in SI units, which need not be finite.
    fn number(&self, row: &impl Row) -> Result<f64, ImportError> {
        Ok(self.conversion.si(row.number(self.place)?))
    }

    /// The number in SI units, or the flag.
    fn finite(&self, row: &impl Row) -> Result<f64, ImportError> {
        match self.is_flag {
            true => Ok(f64::from(u8::from(row.flag(self.place)?))),
            false => Ok(self.conversion.si(row.finite(self.place)?)),
        }
    }
}

/// A sensor or a command with `N` columns.
struct Sensor<const N: usize> {
    columns: [Column; N],
    new_rows: NewRows,
    delay_ns: u64,
    series: Series<N>,
}

impl Sensor<1> {
    /// A column whose values are held.
    const fn held(column: Column, delay_ns: u64) -> Self {
        Self::new([column], None, delay_ns, None)
    }
}

impl<const N: usize> Sensor<N> {
    /// With the column by whose changes new rows are known, if there is one.
    const fn new(
        columns: [Column; N],
        changes: Option<Place>,
        delay_ns: u64,
        interpolation: Option<Interpolation>,
    ) -> Self {
        Self {
            columns,
            new_rows: NewRows::new(changes),
            delay_ns,
            series: Series::new(Vec::new(), interpolation),
        }
    }

    /// Takes the sample of a row, if there is one. A row whose cells are all empty has none.
    fn take(&mut self, row: &impl Row, time_ns: u64) -> Result<(), ImportError> {
        let places = self.columns.map(|column| column.place);
        if !places.iter().all(|place| row.has(*place))
            || !self.new_rows.is_new(row)
            || row.are_empty(places)
        {
            return Ok(());
        }
        let mut values = [0.0; N];
        for (value, column) in values.iter_mut().zip(&self.columns) {
            *value = column.finite(row)?;
        }
        self.series.samples.push(Sample {
            time_ns: time_ns - self.delay_ns,
            values,
        });
        Ok(())
    }
}

/// Regular exposures behind messages that come with a jitter.
struct Exposures {
    period_ns: f64,
    /// Time of the last row.
    last_ns: Option<f64>,
}

/// The largest jitter, in periods: a message that is farther off starts a new grid of exposures.
const LARGEST_JITTER: f64 = 0.4;

impl Exposures {
    /// The exposure of a message.
    fn of(&mut self, message_ns: u64) -> u64 {
        let message = message_ns as f64;
        let exposure = match self.last_ns {
            Some(last) => {
                let periods = ((message - last) / self.period_ns).round().max(1.0);
                let expected = last + periods * self.period_ns;
                let jitter = message - expected;
                if jitter.abs() > LARGEST_JITTER * self.period_ns {
                    // Exposures stay in their order.
                    message.max(last + 0.1 * self.period_ns)
                } else {
                    expected + FOLLOWED * jitter
                }
            }
            None => message,
        };
        self.last_ns = Some(exposure);
        exposure.round() as u64
    }
}

/// The poses of a log.
struct Poses<'a> {
    section: &'a PoseSection,
    /// x, y and yaw.
    columns: [Column; 3],
    tracked: Option<Place>,
    new_rows: NewRows,
    delay_ns: u64,
    exposures: Option<Exposures>,
    poses: Vec<Observation>,
}

impl<'a> Poses<'a> {
    fn find(header: &mut impl Header, section: &'a PoseSection) -> Result<Self, ImportError> {
        let messages = section.messages();
        let changes =
            header.find_if("pose.new_when_changes", messages, &section.new_when_changes)?;
        Ok(Self {
            section,
            columns: [
                Column::find(header, "pose.x", messages, &section.x)?,
                Column::find(header, "pose.y", messages, &section.y)?,
                Column::find(header, "pose.yaw", messages, &section.yaw)?,
            ],
            tracked: header.find_if("pose.tracked", messages, &section.tracked)?,
            new_rows: NewRows::new(changes),
            delay_ns: nanoseconds(section.delay_s),
            exposures: section.exposures_hz.map(|rate_hz| Exposures {
                period_ns: 1e9 / rate_hz,
                last_ns: None,
            }),
            poses: Vec::new(),
        })
    }

    /// Takes the pose of a row, if there is one.
    fn take(&mut self, row: &impl Row, time_ns: u64) -> Result<(), ImportError> {
        let places = self.columns.map(|column| column.place);
        if !places.iter().all(|place| row.has(*place)) {
            return Ok(());
        }
        let is_left_out = self.section.empty_rows == EmptyRows::NoSample && row.are_empty(places);
        if self.new_rows.is_new(row) && !is_left_out {
            let exposures = self.exposures.as_mut();
            let regular_ns = exposures.map_or(time_ns, |exposures| exposures.of(time_ns));
            let capture_ns = regular_ns - self.delay_ns;
            // No message is earlier than its exposure.
            let receive_ns = time_ns.max(capture_ns);
            let observation = self.observation(row, capture_ns, receive_ns)?;
            self.poses.push(observation);
        }
        Ok(())
    }

    /// What a row says of the body, which was measured and arrived at these times.
    fn observation(
        &self,
        row: &impl Row,
        capture_time_ns: u64,
        receive_time_ns: u64,
    ) -> Result<Observation, ImportError> {
        let frame_number = i32::try_from(self.poses.len()).unwrap_or(i32::MAX);
        let observed = |state| Observation {
            frame_number,
            receive_time_ns,
            state,
        };
        if let Some(place) = self.tracked
            && !row.flag(place)?
        {
            return Ok(observed(PoseState::Untracked));
        }
        let [x, y, yaw] = &self.columns;
        let (x, y) = (x.number(row)?, y.number(row)?);
        let yaw_rad = wrap(yaw.number(row)? - self.section.yaw_rad);
        let [forward, left] = self.section.point_m;
        let axis = direction(yaw_rad);
        let x_m = x - (axis.x * forward - axis.y * left);
        let y_m = y - (axis.y * forward + axis.x * left);
        if ![x_m, y_m, yaw_rad].into_iter().all(f64::is_finite) {
            return Ok(observed(PoseState::Rejected(RejectReason::NotFinite)));
        }
        Ok(observed(PoseState::Valid(Pose {
            x_m,
            y_m,
            z_m: 0.0,
            yaw_rad,
            tilt_rad: 0.0,
            roll_rad: 0.0,
            pitch_rad: 0.0,
            capture_time_ns,
            capture_uncertainty_ns: 0,
            capture_source: CaptureTimeSource::FrameTimestamp,
            receive_time_ns,
            frame_number,
            mean_error_m: 0.0,
            reacquired: false,
        })))
    }
}
