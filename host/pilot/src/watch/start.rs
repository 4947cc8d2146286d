//! The accelerometer against the speed of the cameras, while a car starts off.

use libm::hypot;

use super::steps::Step;

/// The change of speed by which the accelerometer is judged, m/s, and its tolerance, in m/s
/// and as a share.
const ACCELERATED: f64 = 0.18;
const TOLERANCE: (f64, f64) = (0.05, 0.5);
/// The change must come within this time, s, or it says nothing: a bias counts for more, and
/// the linear acceleration of some sensors leaks away.
const WITHIN: f64 = 0.5;

/// Compares both at the start of every drive.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct StartWatch {
    time: f64,
    forward: f64,
    left: f64,
    judged: bool,
    differs: bool,
}

impl StartWatch {
    /// A step of the drive.
    pub(crate) fn step(&mut self, step: &Step) {
        if self.judged {
            return;
        }
        let speed = step.rear.norm() / step.time;
        // Over a step the speed is that of its middle; the integral is that of its end.
        let forward = self.forward + 0.5 * step.forward;
        let left = self.left + 0.5 * step.left;
        self.time += step.time;
        self.forward += step.forward;
        self.left += step.left;
        let fast = speed >= ACCELERATED;
        self.judged = fast || self.time > WITHIN;
        if fast {
            let (margin, share) = TOLERANCE;
            // A NaN differs.
            let fits = hypot(forward - speed, left) <= margin + share * speed;
            self.differs = !fits;
        }
    }

    /// Whether the start is over.
    pub(crate) const fn is_judged(&self) -> bool {
        self.judged
    }

    /// Whether the accelerometer contradicted the speed.
    pub(crate) const fn differs(&self) -> bool {
        self.differs
    }

    /// The next drive begins.
    pub(crate) fn reset(&mut self) {
        *self = Self::default();
    }
}
