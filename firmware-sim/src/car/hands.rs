//! A person's hands on the car: what is done with it while it does not drive.

use core::f64::consts::PI;

use libm::{cos, sin};
use serde::{Deserialize, Serialize};

use super::StartPose;

/// What a person does with the car. Each begins and ends at rest.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum HandMotion {
    /// Lifts it until the wheels are so far above the floor, in m, or puts it onto a stand of
    /// this height: the wheels turn freely. It stays there.
    Lift {
        /// Height of the wheels above the floor, in m.
        height_m: f64,
    },
    /// Puts it down where it is.
    PutDown,
    /// Rolls it over the floor. It goes where its front wheels point.
    Roll {
        /// How far, in m; negative is backward.
        distance_m: f64,
        /// Highest speed, in m/s.
        speed_m_s: f64,
    },
    /// Turns it about a point.
    Turn {
        /// Angle of the turn, in rad; positive is to the left.
        angle_rad: f64,
        /// The point, from the centre of mass: forward, left, in m.
        about_m: [f64; 2],
        /// How far the point wanders meanwhile, in m: it is held by a hand.
        wander_m: f64,
        /// For how long, in s.
        for_s: f64,
    },
    /// Twists it to and fro about a point.
    Twist {
        /// Largest angle to either side, in rad.
        amplitude_rad: f64,
        /// The point, from the centre of mass: forward, left, in m.
        about_m: [f64; 2],
        /// Time of one period, in s.
        period_s: f64,
        /// For how long, in s.
        for_s: f64,
    },
    /// Tilts it, holds it, and tilts it back.
    Tilt {
        /// Roll, in rad; left side up is positive.
        roll_rad: f64,
        /// Pitch, in rad; nose down is positive.
        pitch_rad: f64,
        /// For how long, in s.
        for_s: f64,
    },
    /// Carries it to another place on the floor. The wheels do not touch the floor on the way.
    Carry {
        /// Where the centre of mass comes to.
        to: StartPose,
        /// For how long, in s.
        for_s: f64,
    },
    /// Holds it where it is.
    Hold {
        /// For how long, in s.
        for_s: f64,
    },
}

/// Time for which the speed of a roll changes, at its begin and at its end, in s.
const ROLL_RAMP_S: f64 = 0.6;
/// Time to lift the car, or to put it down, in s.
const LIFT_S: f64 = 1.0;
/// The most that a car is lifted when it is carried, in m.
const CARRIED_M: f64 = 0.15;
/// The share of a tilt's time in which it goes up, and in which it goes down.
const TILT_SHARE: f64 = 0.3;

/// Where a car is in hands.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct HandledPose {
    /// The centre of mass, in m.
    pub(crate) position: [f64; 2],
    pub(crate) yaw: f64,
    pub(crate) roll: f64,
    pub(crate) pitch: f64,
    /// Height of the wheels above the floor, in m.
    pub(crate) height: f64,
}

impl HandledPose {
    fn numbers(&self) -> [f64; 6] {
        let [x, y] = self.position;
        [x, y, self.yaw, self.roll, self.pitch, self.height]
    }
}

/// How a car moves in hands.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct HandledMotion {
    pub(crate) place: HandledPose,
    /// Velocity of the centre of mass: forward, left, in m/s.
    pub(crate) velocity: [f64; 2],
    /// Its acceleration: forward, left, in m/s².
    pub(crate) acceleration: [f64; 2],
    /// Rates of yaw, roll and pitch, in rad/s.
    pub(crate) rates: [f64; 3],
}

/// The hands on a car.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Hands {
    /// Height of the stand on which the car is, in m; zero on the floor.
    pub(crate) stand: f64,
    under_way: Option<UnderWay>,
}

/// A motion that is under way.
#[derive(Clone, Copy, Debug)]
struct UnderWay {
    motion: HandMotion,
    begin_us: u64,
    from: HandledPose,
}

impl Hands {
    /// Begins a motion of a car that stands at this position, with this yaw.
    pub(crate) fn begin(&mut self, motion: HandMotion, now_us: u64, position: [f64; 2], yaw: f64) {
        self.under_way = Some(UnderWay {
            motion,
            begin_us: now_us,
            from: HandledPose {
                position,
                yaw,
                height: self.stand,
                ..HandledPose::default()
            },
        });
    }

    /// Ends a motion whose time is over. Returns where it left the car.
    pub(crate) fn end(&mut self, now_us: u64) -> Option<HandledPose> {
        let under_way = self.under_way?;
        let since = under_way.since(now_us);
        if since < under_way.duration() {
            return None;
        }
        self.under_way = None;
        if under_way.roll(since).is_some() {
            return None;
        }
        let place = under_way.place(under_way.duration());
        self.stand = place.height;
        Some(place)
    }

    /// Whether a motion is under way.
    pub(crate) const fn is_busy(&self) -> bool {
        self.under_way.is_some()
    }

    /// Whether the car is in hands or on a stand.
    pub(crate) const fn holds(&self) -> bool {
        self.under_way.is_some() || self.stand > 0.0
    }

    /// Whether the wheels turn freely.
    pub(crate) fn wheels_are_up(&self, now_us: u64) -> bool {
        match self.motion(now_us) {
            Some(motion) => motion.place.height > 0.0,
            None => self.stand > 0.0 && !self.is_busy(),
        }
    }

    /// Speed and acceleration of the wheels of a car that is being rolled, in m/s and m/s².
    pub(crate) fn roll(&self, now_us: u64) -> Option<[f64; 2]> {
        let under_way = self.under_way?;
        under_way.roll(under_way.since(now_us))
    }

    /// How the car moves, if its pose is that of the hands. A rolled car has its own.
    pub(crate) fn motion(&self, now_us: u64) -> Option<HandledMotion> {
        let under_way = self.under_way?;
        let since = under_way.since(now_us);
        let is_rolled = under_way.roll(since).is_some();
        (!is_rolled).then(|| under_way.motion(since))
    }
}

impl UnderWay {
    fn since(&self, now_us: u64) -> f64 {
        now_us.saturating_sub(self.begin_us) as f64 * 1e-6
    }

    fn duration(&self) -> f64 {
        match self.motion {
            HandMotion::Lift { .. } | HandMotion::PutDown => LIFT_S,
            HandMotion::Roll {
                distance_m,
                speed_m_s,
            } => ROLL_RAMP_S + distance_m.abs() / speed_m_s.abs().max(0.01),
            HandMotion::Turn { for_s, .. }
            | HandMotion::Twist { for_s, .. }
            | HandMotion::Tilt { for_s, .. }
            | HandMotion::Carry { for_s, .. }
            | HandMotion::Hold { for_s } => for_s.max(0.01),
        }
    }

    fn roll(&self, since: f64) -> Option<[f64; 2]> {
        let HandMotion::Roll {
            distance_m,
            speed_m_s,
        } = self.motion
        else {
            return None;
        };
        let top = speed_m_s.abs().max(0.01).copysign(distance_m);
        // Both ramps have the mean of half the speed.
        let end = self.duration();
        let ramp = ROLL_RAMP_S.min(end / 2.0);
        let rising = since.min(end - since) / ramp;
        if rising >= 1.0 {
            return Some([top, 0.0]);
        }
        let rising = rising.max(0.0);
        let sign = if since < end / 2.0 { 1.0 } else { -1.0 };
        let speed = (1.0 - cos(PI * rising)) / 2.0;
        let slope = PI / 2.0 * sin(PI * rising) / ramp;
        Some([top * speed, top * slope * sign])
    }

    fn place(&self, since: f64) -> HandledPose {
        let mut place = self.from;
        let share = (since / self.duration()).clamp(0.0, 1.0);
        let done = smooth(share);
        match self.motion {
            HandMotion::Roll { .. } | HandMotion::Hold { .. } => {}
            HandMotion::Lift { height_m } => {
                place.height += (height_m.max(0.0) - place.height) * done;
            }
            HandMotion::PutDown => place.height *= 1.0 - done,
            HandMotion::Turn {
                angle_rad,
                about_m,
                wander_m,
                ..
            } => {
                let wander = [sin(2.0 * PI * share), sin(4.0 * PI * share)].map(|w| w * wander_m);
                place.turn(angle_rad * done, about_m, wander);
            }
            HandMotion::Twist {
                amplitude_rad,
                about_m,
                period_s,
                for_s,
            } => {
                // The first and the last quarter of a second grow and fade.
                let fade = smooth((since.min(for_s - since) / 0.25).clamp(0.0, 1.0));
                let angle = amplitude_rad * fade * sin(2.0 * PI * since / period_s.max(0.1));
                place.turn(angle, about_m, [0.0; 2]);
            }
            HandMotion::Tilt {
                roll_rad,
                pitch_rad,
                ..
            } => {
                let up = smooth((share.min(1.0 - share) / TILT_SHARE).clamp(0.0, 1.0));
                place.roll = roll_rad * up;
                place.pitch = pitch_rad * up;
            }
            HandMotion::Carry { to, .. } => {
                let [x, y] = &mut place.position;
                *x += (to.x_m - *x) * done;
                *y += (to.y_m - *y) * done;
                // The shorter way round.
                let turn = libm::remainder(to.yaw_rad - place.yaw, 2.0 * PI);
                place.yaw += turn * done;
                place.height *= 1.0 - done;
                place.height += CARRIED_M * smooth((share.min(1.0 - share) * 5.0).min(1.0));
            }
        }
        place
    }

    /// Velocities and accelerations by differences over 2 ms: the motions are smooth, and no sample
    /// of the IMU is finer.
    fn motion(&self, since: f64) -> HandledMotion {
        const STEP: f64 = 1e-3;
        let place = self.place(since);
        let [before, now, after] =
            [self.place(since - STEP), place, self.place(since + STEP)].map(|p| p.numbers());
        let rate = |i: usize| (after[i] - before[i]) / (2.0 * STEP);
        let acceleration = |i: usize| (after[i] - 2.0 * now[i] + before[i]) / (STEP * STEP);
        let (c, s) = (cos(place.yaw), sin(place.yaw));
        let along = |[x, y]: [f64; 2]| [c * x + s * y, c * y - s * x];
        HandledMotion {
            place,
            velocity: along([rate(0), rate(1)]),
            acceleration: along([acceleration(0), acceleration(1)]),
            rates: [rate(2), rate(3), rate(4)],
        }
    }
}

impl HandledPose {
    /// Turns it about a point of the car, from the centre of mass, that moves by `wander`.
    fn turn(&mut self, angle: f64, [forward, left]: [f64; 2], wander: [f64; 2]) {
        let point = |yaw: f64| {
            let (c, s) = (cos(yaw), sin(yaw));
            [c * forward - s * left, s * forward + c * left]
        };
        let before = point(self.yaw);
        self.yaw += angle;
        let after = point(self.yaw);
        for (axis, coordinate) in self.position.iter_mut().enumerate() {
            *coordinate += before[axis] - after[axis] + wander[axis];
        }
    }
}

/// From 0 to 1, with rates and accelerations of zero at both ends.
fn smooth(share: f64) -> f64 {
    share * share * share * (10.0 - share * (15.0 - 6.0 * share))
}
