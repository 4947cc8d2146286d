//! The samples of the sensors in the rows of a log.

use singletrack_control::{direction, wrap};
use singletrack_mocap::{CaptureTimeSource, Observation, Pose, PoseState, RejectReason};

use super::{
    log::ImportError,
    map::{Conversion, EmptyRows, Messages, PoseSection, Quantity, nanoseconds},
    row::{Header, Place, Row},
    samples::{Interpolation, Sample, Series},
    times::FOLLOWED,
};

/// Tells the rows with a new value from those that repeat an old one.
pub(super) struct NewRows {
    place: Option<Place>,
    before: Option<String>,
}

impl NewRows {
    /// A row is new if the column at this place changes; every row is, without a place.
    pub(super) const fn new(place: Option<Place>) -> Self {
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
pub(super) struct Column {
    place: Place,
    conversion: Conversion,
    /// Whether its values are taken as flags: 1 or 0.
    is_flag: bool,
}

impl Column {
    /// The column of the quantity that is at `key` in the map.
    pub(super) fn find<D>(
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
    pub(super) const fn unmeasured(self) -> Self {
        Self {
            conversion: Conversion::UNMEASURED,
            ..self
        }
    }

    /// A column whose numbers are taken as they are.
    pub(super) const fn plain(place: Place) -> Self {
        Self {
            place,
            conversion: Conversion::NONE,
            is_flag: false,
        }
    }

    /// A column of what is so or not.
    pub(super) const fn flag(place: Place) -> Self {
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
pub(super) struct Sensor<const N: usize> {
    columns: [Column; N],
    new_rows: NewRows,
    delay_ns: u64,
    pub(super) series: Series<N>,
}

impl Sensor<1> {
    /// A column whose values are held.
    pub(super) const fn held(column: Column, delay_ns: u64) -> Self {
        Self::new([column], None, delay_ns, None)
    }
}

impl<const N: usize> Sensor<N> {
    /// With the column by whose changes new rows are known, if there is one.
    pub(super) const fn new(
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
    pub(super) fn take(&mut self, row: &impl Row, time_ns: u64) -> Result<(), ImportError> {
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
pub(super) struct Poses<'a> {
    section: &'a PoseSection,
    /// x, y and yaw.
    columns: [Column; 3],
    tracked: Option<Place>,
    new_rows: NewRows,
    delay_ns: u64,
    exposures: Option<Exposures>,
    pub(super) poses: Vec<Observation>,
}

impl<'a> Poses<'a> {
    pub(super) fn find(
        header: &mut impl Header,
        section: &'a PoseSection,
    ) -> Result<Self, ImportError> {
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
    pub(super) fn take(&mut self, row: &impl Row, time_ns: u64) -> Result<(), ImportError> {
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
