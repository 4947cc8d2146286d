//! What an import made.

use std::fmt;

use singletrack_record::seconds_since;
use singletrack_statistics::Arrivals;

use super::FIRST_ROW_NS;

/// What a record has that was made of a log.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Summary {
    /// From the first row to the last.
    pub duration_ns: u64,
    /// Poses that can be used, by the times of their arrival.
    pub poses: Arrivals,
    /// Poses with a number that is missing or not finite.
    pub rejected: u64,
    /// Poses that the log marks as not tracked.
    pub untracked: u64,
    /// Samples of the IMU in the log, before any interpolation; `None` if it has no IMU.
    pub inertial: Option<Arrivals>,
    /// Samples of the speed of the motor in the log, before any interpolation.
    pub motor: Arrivals,
    /// Samples of the board in the record.
    pub board: Arrivals,
    /// Inertial samples that are left out, because the speed of the motor is not known at their
    /// time.
    pub without_motor_speed: u64,
    /// Ticks.
    pub ticks: u64,
}

impl Summary {
    /// Of samples at these times, which are in order.
    pub(super) fn arrivals(times_ns: impl Iterator<Item = u64>) -> Arrivals {
        let mut arrivals = Arrivals::default();
        for time_ns in times_ns {
            arrivals.add(Some(time_ns.cast_signed()));
        }
        arrivals
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let duration_s = self.duration_ns as f64 * 1e-9;
        write!(formatter, "{duration_s:.2} s, {} poses", self.poses.count())?;
        for (count, what) in [
            (self.rejected, "not finite"),
            (self.untracked, "not tracked"),
        ] {
            if count > 0 {
                write!(formatter, " and {count} {what}")?;
            }
        }
        write!(formatter, ", {} board samples of ", self.board.count())?;
        if let Some(inertial) = &self.inertial {
            write!(formatter, "{} of the IMU and ", inertial.count())?;
        }
        write!(formatter, "{} of the motor", self.motor.count())?;
        if self.without_motor_speed > 0 {
            let count = self.without_motor_speed;
            write!(
                formatter,
                " ({count} of the IMU left out: no speed of the motor)"
            )?;
        }
        write!(formatter, ", {} ticks; largest gaps: ", self.ticks)?;
        write_gap(formatter, "poses", &self.poses)?;
        if let Some(inertial) = &self.inertial {
            write_gap(formatter, ", IMU", inertial)?;
        }
        write_gap(formatter, ", motor", &self.motor)?;
        write_gap(formatter, ", board samples", &self.board)
    }
}

fn write_gap(formatter: &mut fmt::Formatter<'_>, what: &str, of: &Arrivals) -> fmt::Result {
    match of.longest_gap() {
        None => write!(formatter, "{what} none"),
        Some(gap) => {
            let start_s = seconds_since(FIRST_ROW_NS, gap.begin_ns.cast_unsigned());
            let length_s = gap.longest_ns as f64 * 1e-9;
            write!(formatter, "{what} {length_s:.3} s at {start_s:.3} s")
        }
    }
}
