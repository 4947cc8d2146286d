//! A program that sends the daemon set-points along a circle.

use singletrack_control::{Position, Setpoint, Time, Velocity};

use crate::{daemon::host_ns, schedule::Situation, setting::radius};

/// Interval between two set-points, in µs.
const INTERVAL_US: u64 = 20_000;

/// The program. It follows the daemon's drive time.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Program {
    next_us: u64,
}

impl Program {
    /// The set-point that is due at `now_us`; `drive_time_s` is the time since the drive
    /// began, `None` while the car does not drive.
    pub(crate) fn poll(
        &mut self,
        now_us: u64,
        situation: &Situation,
        drive_time_s: Option<f64>,
    ) -> Option<Setpoint> {
        if now_us < self.next_us {
            return None;
        }
        self.next_us = now_us + INTERVAL_US;
        let speed = f64::from(situation.speed_mm_s) * 1e-3;
        let radius = radius(speed);
        let angle = drive_time_s.unwrap_or(0.0) * speed / radius;
        let (sin, cos) = (libm::sin(angle), libm::cos(angle));
        Some(Setpoint::point(
            Time(host_ns(now_us)),
            Some(Position::new(radius * cos, radius * sin)),
            Velocity::new(-speed * sin, speed * cos),
        ))
    }
}
