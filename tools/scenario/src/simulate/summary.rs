//! A row of a simulation's result and its CSV, and what a drive came to, for a person or a script
//! that wants no trajectory.

use core::fmt;
use std::io::{self, Write};

use serde::Serialize;
use singletrack_control::{CalibrationEstimate, CalibrationParameter, Position};
use singletrack_pilot::{Fence, FenceError, Mode, Reason};
use singletrack_sim::Truth;

use crate::{csv_text::csv_text, tracking::TrackingError, virtual_drive::VirtualTick};

/// What a drive came to. Ways, speeds and clearance are the car's true ones.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Summary {
    /// Whether the car drove at all.
    pub armed: bool,
    /// The pilot's mode at the end of the run.
    pub mode: &'static str,
    /// Why the drive ended, or why there was none; a fault at the end of the run counts
    /// more.
    pub reason: Option<&'static str>,
    /// When the drive ended, in s; none if it went on to the end of the run, or there was
    /// none.
    pub ended_s: Option<f64>,
    /// Way of the centre of mass during the drive, in m.
    pub way_m: f64,
    /// Way after it, in m; without a drive since the start of the run.
    pub way_after_m: f64,
    /// Highest speed, in m/s.
    pub speed_max_m_s: f64,
    /// Lowest speed, in m/s; negative is backward.
    pub speed_min_m_s: f64,
    /// Speed at the end of the run, in m/s.
    pub speed_end_m_s: f64,
    /// Least distance of the centre of mass from the sides of the geofence, without its
    /// margin, in m; negative outside.
    pub clearance_min_m: f64,
    /// How far P was from its reference while the car followed it; none without a drive.
    pub tracking_error: Option<TrackingError>,
    /// Root mean square of that distance in the second half of the drive, in m.
    pub tracking_rms_m: Option<f64>,
    /// What the drive says about the calibration; empty if `online_calibration.mode` is "off".
    pub calibration: Vec<CalibrationLine>,
}

/// An estimate of what differs from the configuration.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CalibrationLine {
    /// What is estimated.
    pub parameter: &'static str,
    /// The unit of the numbers; "1" for a fraction.
    pub unit: &'static str,
    /// The true value less the configured one; none if nothing is known.
    pub estimate: Option<f64>,
    /// The lower end of its interval of 95 %.
    pub low: Option<f64>,
    /// The upper end.
    pub high: Option<f64>,
    /// Whether the motion made it observable.
    pub observable: bool,
    /// Whether the configured value is wrong by what matters.
    pub off: bool,
}

impl From<&CalibrationEstimate> for CalibrationLine {
    fn from(estimate: &CalibrationEstimate) -> Self {
        let (unit, scale) = match estimate.parameter {
            CalibrationParameter::SteeringGain
            | CalibrationParameter::GyroScale
            | CalibrationParameter::PulseDistance => ("1", 1.0),
            CalibrationParameter::SteeringTrim | CalibrationParameter::BodyYaw => ("rad", 1.0),
            CalibrationParameter::StampOffset => ("ms", 1e3),
            CalibrationParameter::PivotForward | CalibrationParameter::PivotLeft => ("m", 1.0),
        };
        let known = estimate.half_width.is_finite();
        let at = |half: f64| known.then_some(scale * (estimate.value + half * estimate.half_width));
        Self {
            parameter: estimate.parameter.name(),
            unit,
            estimate: at(0.0),
            low: at(-1.0),
            high: at(1.0),
            observable: estimate.observable,
            off: estimate.is_off(),
        }
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mode = self.mode;
        let reason = self.reason.unwrap_or("no reason");
        match self.ended_s {
            _ if !self.armed => {
                return write!(formatter, "the car was not armed: {mode}, {reason}");
            }
            Some(ended_s) => write!(
                formatter,
                "the drive ended at {ended_s:.2} s: {reason}; {mode}"
            ),
            None => write!(formatter, "the car drove to the end of the run"),
        }?;
        if let Some(error) = self.tracking_error {
            write!(formatter, "\n{error}")?;
        }
        if let Some(rms) = self.tracking_rms_m {
            write!(formatter, "; {:.2} mm (rms) in the second half", 1e3 * rms)?;
        }
        write!(
            formatter,
            "\ntravelled {:.2} m, speed {:.2} to {:.2} m/s, least distance from the geofence {:.2} m",
            self.way_m, self.speed_min_m_s, self.speed_max_m_s, self.clearance_min_m
        )
    }
}

/// Whether the car follows its reference in this mode.
pub(super) const fn drives(mode: Mode) -> bool {
    matches!(mode, Mode::Driving | Mode::Slowing)
}

/// A summary in the making.
#[derive(Debug)]
pub(super) struct Tally {
    fence: Fence,
    /// The way at the last tick, and whether the car drove then.
    last: Option<(f64, bool)>,
    reason_of_end: Option<Reason>,
    /// Its reason is that of the last tick.
    summary: Summary,
}

impl Tally {
    pub(super) fn new(fence: &Fence) -> Result<Self, FenceError> {
        Ok(Self {
            fence: Fence::new(fence.corners(), 0.0)?,
            last: None,
            reason_of_end: None,
            summary: Summary {
                mode: Mode::Disconnected.name(),
                clearance_min_m: f64::INFINITY,
                ..Summary::default()
            },
        })
    }

    /// When the drive ended, in s of the run.
    pub(super) const fn ended_s(&self) -> Option<f64> {
        self.summary.ended_s
    }

    /// Adds a tick at a time of the run, in s.
    pub(super) fn add(&mut self, time: f64, tick: &VirtualTick) {
        let output = &tick.tick.output;
        self.add_truth(&tick.truth);
        let summary = &mut self.summary;
        let now_drives = drives(output.mode);
        let drove = self.last.is_some_and(|(_, drove)| drove);
        if now_drives {
            summary.armed = true;
            summary.ended_s = None;
        } else if drove {
            summary.ended_s = Some(time);
            self.reason_of_end = output.reason;
        }
        summary.mode = output.mode.name();
        summary.reason = output.reason.map(Reason::name);
        self.last = Some((tick.truth.way, now_drives));
    }

    fn add_truth(&mut self, truth: &Truth) {
        let summary = &mut self.summary;
        match self.last {
            None => {}
            Some((way, true)) => summary.way_m += truth.way - way,
            Some((way, false)) => summary.way_after_m += truth.way - way,
        }
        summary.speed_min_m_s = summary.speed_min_m_s.min(truth.speed);
        summary.speed_max_m_s = summary.speed_max_m_s.max(truth.speed);
        summary.speed_end_m_s = truth.speed;
        let clearance = self.fence.clearance(&Position::new(truth.x, truth.y));
        summary.clearance_min_m = summary.clearance_min_m.min(clearance);
    }

    pub(super) fn summary(&self, tracking_error: Option<TrackingError>) -> Summary {
        let summary = self.summary.clone();
        // Without a drive there is no reason of its end.
        let of_end = self.reason_of_end.map(Reason::name);
        let is_fault = summary.mode == Mode::Fault.name();
        Summary {
            reason: of_end.filter(|_| !is_fault).or(summary.reason),
            tracking_error,
            ..summary
        }
    }
}

/// Rows per second.
pub(crate) const ROWS_PER_SECOND: u64 = 20;

/// Time of a row, in s.
pub(super) const fn row_time(index: u64) -> f64 {
    index as f64 / ROWS_PER_SECOND as f64
}

/// The state before a tick's command, and the command that acts from then on.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Row {
    /// Time, in s.
    pub t: f64,
    /// Yaw, in rad, not wrapped.
    pub yaw: f64,
    /// Yaw rate, in rad/s.
    pub yaw_rate: f64,
    /// Sideslip, in rad.
    pub sideslip: f64,
    /// Steering angle, in rad.
    pub steering: f64,
    /// Position of G, in m.
    pub x_g: f64,
    /// Position of G, in m.
    pub y_g: f64,
    /// Speed of G, in m/s.
    pub speed: f64,
    /// Steering rate, in rad/s; 0 for continuous control by a law that commands
    /// angles.
    pub steering_rate: f64,
    /// Position of P by the true `l_f`, in m.
    pub x_p: f64,
    /// Position of P by the true `l_f`, in m.
    pub y_p: f64,
    /// The reference, in m; an ideal integrator where it is a velocity.
    pub x_ref: f64,
    /// The reference, in m; an ideal integrator where it is a velocity.
    pub y_ref: f64,
    /// Commanded velocity of P, in m/s.
    pub v_px: f64,
    /// Commanded velocity of P, in m/s.
    pub v_py: f64,
    /// The path parameter of the reference, in s: the time, unless a governor has slowed the
    /// reference down.
    pub path_s: f64,
}

/// The names of the columns, in order.
pub const HEADER: &str = "t,yaw,yaw_rate,sideslip,steering,x_g,y_g,speed,steering_rate,x_p,y_p,x_ref,y_ref,v_px,v_py,path_s";

impl Row {
    /// From P to its reference, in m.
    pub fn distance_from_reference(&self) -> f64 {
        libm::hypot(self.x_p - self.x_ref, self.y_p - self.y_ref)
    }

    /// The values, in the order of [`HEADER`].
    pub fn values(&self) -> [f64; 16] {
        [
            self.t,
            self.yaw,
            self.yaw_rate,
            self.sideslip,
            self.steering,
            self.x_g,
            self.y_g,
            self.speed,
            self.steering_rate,
            self.x_p,
            self.y_p,
            self.x_ref,
            self.y_ref,
            self.v_px,
            self.v_py,
            self.path_s,
        ]
    }
}

/// Writes rows as CSV, with 12 significant digits.
///
/// # Errors
///
/// The errors of the writer.
pub fn write_csv(rows: &[Row], out: &mut impl Write) -> io::Result<()> {
    let header = HEADER.split(',').map(ToOwned::to_owned).collect();
    let rows = rows
        .iter()
        .map(|row| row.values().map(significant).to_vec());
    out.write_all(csv_text([header].into_iter().chain(rows)).as_bytes())?;
    out.flush()
}

/// A number with 12 significant digits, without trailing zeros.
fn significant(value: f64) -> String {
    let scientific = format!("{value:.11e}");
    let Some((mantissa, exponent)) = scientific.split_once('e') else {
        return scientific; // not a number, or infinite
    };
    let exponent: i32 = exponent.parse().unwrap_or(0);
    match usize::try_from(11 - exponent) {
        Ok(decimals) if exponent >= -5 => trim_zeros(&format!("{value:.decimals$}")).to_owned(),
        _ => format!("{}e{exponent}", trim_zeros(mantissa)),
    }
}

/// A decimal number without needless zeros at its end.
pub fn trim_zeros(number: &str) -> &str {
    if number.contains('.') {
        let trimmed = number.trim_end_matches('0').trim_end_matches('.');
        if trimmed == "-0" { "0" } else { trimmed }
    } else {
        number
    }
}

#[cfg(test)]
mod tests {
    use super::significant;

    #[test]
    fn numbers_keep_twelve_significant_digits_and_no_padding() {
        for (value, text) in [
            (0.0, "0"),
            (-0.0, "0"),
            (1.5, "1.5"),
            (-0.707_106_781_186_547_5, "-0.707106781187"),
            (40.0, "40"),
            (2.356_194_490_192_345, "2.35619449019"),
            (1.688_409_023_703_49e-7, "1.6884090237e-7"),
            (123_456_789_012_345.0, "1.23456789012e14"),
            (0.000_123_456_789_012_345, "0.000123456789012"),
            (9.999_999_999_999_9, "10"),
        ] {
            assert_eq!(significant(value), text);
        }
    }

    #[test]
    fn what_is_not_finite_is_written_as_such() {
        assert_eq!(significant(f64::NAN), "NaN");
        assert_eq!(significant(f64::INFINITY), "inf");
    }
}
