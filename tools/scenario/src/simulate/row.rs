//! A row of a simulation's result, and its CSV.

use std::io::{self, Write};

use crate::csv_text::csv_text;

/// Rows per second.
pub(crate) const ROWS_PER_SECOND: u64 = 20;

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
    #[must_use]
    pub fn distance_from_reference(&self) -> f64 {
        libm::hypot(self.x_p - self.x_ref, self.y_p - self.y_ref)
    }

    /// The values, in the order of [`HEADER`].
    #[must_use]
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
    if !(-5..12).contains(&exponent) {
        return format!("{}e{exponent}", trim_zeros(mantissa));
    }
    // The same digits, with the point elsewhere.
    let (whole, part) = mantissa.split_once('.').unwrap_or((mantissa, ""));
    let mut decimal = String::with_capacity(mantissa.len() + 6);
    match usize::try_from(exponent) {
        Ok(exponent) => {
            let (more, part) = part.split_at_checked(exponent).unwrap_or((part, ""));
            decimal.extend([whole, more, ".", part]);
        }
        Err(_) => {
            let (sign, digit) = whole.split_at(whole.len().saturating_sub(1));
            let zeros = usize::try_from(-1 - exponent).unwrap_or(0);
            decimal.extend([sign, "0.", "0000".get(..zeros).unwrap_or(""), digit, part]);
        }
    }
    trim_zeros(&decimal).to_owned()
}

/// A decimal number without needless zeros at its end.
#[must_use]
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
