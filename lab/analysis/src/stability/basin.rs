//! The basin of the straight motion: from which yaw errors the car regains it.

use super::{
    closed_loop::{ClosedLoop, Law, StabilityError},
    motion::Motion,
    sampled::Servo,
    vector_field::{FrontPointField, ServoField, VectorField, VelocityPointField},
};

/// The yaw errors from which a car regains the straight motion; all other states are zero at
/// first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Basin {
    /// The car regains it from every smaller yaw error, in rad; pi if from every one.
    pub yaw: f64,
    /// Half the peak-to-peak steering angle in which the car ends just beyond, in rad. None if
    /// the law or the car becomes singular: P does not determine a car that moves forward.
    pub beyond: Option<f64>,
}

/// What becomes of a yaw error.
enum Outcome {
    Regained,
    Swings(f64),
    Singular,
}

/// The time after which a motion that has not decayed swings on, and after which its amplitude is
/// taken, in s.
const LONGEST: f64 = 30.0;
const SETTLED: f64 = 20.0;
/// A motion whose states are as small as this, in rad and rad/s, decays.
const SMALL: f64 = 1e-3;
/// Steps of the search over yaw, and halvings of the one that has the edge.
const STEPS: u32 = 180;
const HALVINGS: u32 = 12;

impl ClosedLoop {
    /// The basin of the straight motion over the yaw error, with wheels that follow at once or,
    /// under the front-point law, by a servo.
    ///
    /// # Errors
    ///
    /// A servo under the law of the appendix, or one without lag or dead time.
    pub fn basin(&self, servo: Option<Servo>) -> Result<Basin, StabilityError> {
        match (self.law, servo) {
            (Law::FrontPoint, None) => Ok(search(&FrontPointField(self))),
            (Law::VelocityPoint, None) => Ok(search(&VelocityPointField(self))),
            (Law::FrontPoint, Some(servo)) if servo.lag > 0.0 && servo.dead_time > 0.0 => {
                Ok(search(&ServoField(self, servo)))
            }
            (_, Some(_)) => Err(StabilityError::Servo),
        }
    }

    /// Whether the straight motion is regained from a yaw error, in rad, with the servo of [`basin`](Self::basin).
    pub fn regains(&self, servo: Option<Servo>, yaw: f64) -> bool {
        let outcome = match (self.law, servo) {
            (Law::VelocityPoint, _) => outcome(&VelocityPointField(self), yaw),
            (Law::FrontPoint, None) => outcome(&FrontPointField(self), yaw),
            (Law::FrontPoint, Some(servo)) => outcome(&ServoField(self, servo), yaw),
        };
        matches!(outcome, Outcome::Regained)
    }
}

fn search<const N: usize>(field: &impl VectorField<N>) -> Basin {
    let is_regained = |yaw: f64| matches!(outcome(field, yaw), Outcome::Regained);
    let step = core::f64::consts::PI / f64::from(STEPS);
    let Some(first) = (1..=STEPS).find(|steps| !is_regained(step * f64::from(*steps))) else {
        return Basin {
            yaw: core::f64::consts::PI,
            beyond: None,
        };
    };
    let [mut inside, mut outside] = [first - 1, first].map(|steps| step * f64::from(steps));
    for _ in 0..HALVINGS {
        let middle = 0.5 * (inside + outside);
        if is_regained(middle) {
            inside = middle;
        } else {
            outside = middle;
        }
    }
    Basin {
        yaw: inside,
        beyond: match outcome(field, outside) {
            Outcome::Swings(amplitude) => Some(amplitude),
            Outcome::Regained | Outcome::Singular => None,
        },
    }
}

fn outcome<const N: usize>(field: &impl VectorField<N>, yaw: f64) -> Outcome {
    let mut start = [0.0; N];
    start[0] = yaw;
    let mut motion = Motion::new(field, start, field.closed_loop().deviation);
    for end in [SETTLED, LONGEST] {
        motion.amplitude = 0.0;
        while motion.time < end {
            if motion.step(end).is_err() {
                return Outcome::Singular;
            }
            if motion.state.iter().all(|x| x.abs() < SMALL) {
                return Outcome::Regained;
            }
        }
    }
    Outcome::Swings(motion.amplitude)
}
