//! What the cameras saw in a drive, told apart: the car, ghosts and flips; and the smoothed motion of
//! the car, without which no sensor is compared with them.

use nalgebra::{Matrix3, Vector3};
use singletrack_control::{CarPose, Time, direction, wrap};

/// Half of the time over which the motion is smoothed, s: 110 ms, 11 poses at 100 Hz; of slower cameras
/// [`PERIODS`], so that five poses are in it.
const HALF: f64 = 0.055;
const PERIODS: f64 = 2.6;
/// The share of the poses in that time that may be missing.
const MISSING: f64 = 0.36;
/// The fewest poses of a parabola that smooths.
const FEWEST: usize = 4;
/// Slower cameras do not show how a car moves, Hz.
pub const SLOWEST_CAMERAS: f64 = 18.0;
/// The poses of which the median is taken.
const MEDIAN: usize = 9;
/// A pose farther than this from the median is none of a moving car, m and rad.
const OFF: f64 = 0.02;
const TURNED: f64 = 0.15;
/// A pose turned by more than this from the median is a flip, rad.
const FLIP: f64 = 0.3;
/// No car is faster, m/s; and what its pose may err, m.
const FASTEST: f64 = 6.0;
const ERROR: f64 = 0.1;

/// What a pose is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// The car.
    Car,
    /// The car, but off its way for a moment: not in the smoothed motion.
    Jump,
    /// The car, turned for a moment.
    Flip,
    /// Another body.
    Ghost,
}

/// A pose of the car.
#[derive(Clone, Copy, Debug)]
pub struct Seen {
    /// Mid-exposure.
    pub time: Time,
    /// The pose of the centre of mass.
    pub pose: CarPose,
    /// What it is the pose of.
    pub kind: Kind,
}

/// The smoothed motion at a time.
#[derive(Clone, Copy, Debug)]
pub struct Motion {
    /// Velocity of G in the car's axes, m/s.
    pub forward: f64,
    /// The part to the left, m/s.
    pub left: f64,
    /// Yaw rate, rad/s.
    pub yaw_rate: f64,
    /// Acceleration of G in the car's axes, m/s².
    pub acceleration: [f64; 2],
}

impl Motion {
    /// Speed of G, negative in reverse, m/s.
    pub fn speed(&self) -> f64 {
        libm::hypot(self.forward, self.left).copysign(self.forward)
    }

    /// Sideslip at G, rad: course less yaw, in reverse as well.
    pub fn sideslip(&self) -> f64 {
        let sign = 1.0_f64.copysign(self.forward);
        libm::atan2(sign * self.left, sign * self.forward)
    }
}

/// What the cameras saw, in the order of time.
#[derive(Clone, Debug, Default)]
pub struct Track {
    /// All poses.
    pub seen: Vec<Seen>,
    /// Median of the times between two poses, s.
    pub period: f64,
    /// Half of the time over which the motion is smoothed, s.
    pub half: f64,
    /// The fewest poses in that time.
    fewest: usize,
}

/// Tells the poses of a drive apart, which are in the order of time.
pub fn tell(poses: &[(Time, CarPose)]) -> Track {
    let kind = Kind::Car;
    let seen = poses.iter().map(|&(time, pose)| Seen { time, pose, kind });
    let mut seen: Vec<Seen> = seen.collect();
    ghosts(&mut seen);
    moments(&mut seen);
    Track::of(seen)
}

/// A stretch of poses that begins where the car can't have come to is of another body, to its end;
/// so is one that goes on where another body was last.
fn ghosts(seen: &mut [Seen]) {
    let reaches = |from: &Seen, to: &Seen, most: f64| {
        let elapsed = to.time.seconds_since(from.time).min(most);
        (to.pose.position - from.pose.position).norm() <= ERROR + FASTEST * elapsed
    };
    let [mut last, mut car, mut ghost] = [None::<Seen>; 3];
    for now in seen {
        now.kind = match last {
            Some(last) if reaches(&last, now, 0.2) => last.kind,
            _ if car.is_some_and(|car| !reaches(&car, now, f64::INFINITY)) => Kind::Ghost,
            _ if ghost.is_some_and(|ghost| reaches(&ghost, now, 0.2)) => Kind::Ghost,
            _ => Kind::Car,
        };
        match now.kind {
            Kind::Ghost => ghost = Some(*now),
            _ => car = Some(*now),
        }
        last = Some(*now);
    }
}

/// Poses that differ from the median of those around them.
fn moments(seen: &mut [Seen]) {
    let of_car = seen.iter_mut().filter(|seen| seen.kind == Kind::Car);
    let of_car: Vec<&mut Seen> = of_car.collect();
    let car: Vec<CarPose> = of_car.iter().map(|seen| seen.pose).collect();
    for (place, seen) in of_car.into_iter().enumerate() {
        let first = place.saturating_sub(MEDIAN / 2);
        let around = &car[first..(first + MEDIAN).min(car.len())];
        let now = seen.pose;
        let median =
            |value: &dyn Fn(&CarPose) -> f64| middle(around.iter().map(value)).unwrap_or(0.0);
        let x = median(&|pose| pose.position.x - now.position.x);
        let y = median(&|pose| pose.position.y - now.position.y);
        let yaw = median(&|pose| wrap(pose.yaw - now.yaw));
        seen.kind = match () {
            () if yaw.abs() > FLIP => Kind::Flip,
            () if libm::hypot(x, y) > OFF || yaw.abs() > TURNED => Kind::Jump,
            () => Kind::Car,
        };
    }
}

/// The median, the upper one of two.
fn middle(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

/// Parabolas through poses, over the time from `origin`: x and y relative to the first pose, and yaw
/// relative to its yaw. With the weight that a pose at `origin` has in the parabola's value there.
fn parabolas(poses: &[Seen], origin: Time) -> Option<([Vector3<f64>; 3], f64)> {
    let first = poses.first()?;
    let mut normal = Matrix3::zeros();
    let mut right = [Vector3::zeros(); 3];
    for seen in poses {
        let t = seen.time.seconds_since(origin);
        let row = Vector3::new(1.0, t, t * t);
        normal += row * row.transpose();
        let offset = seen.pose.position - first.pose.position;
        let yaw = wrap(seen.pose.yaw - first.pose.yaw);
        for (right, value) in right.iter_mut().zip([offset.x, offset.y, yaw]) {
            *right += row * value;
        }
    }
    let inverse = normal.try_inverse()?;
    Some((right.map(|right| inverse * right), inverse.m11))
}

impl Track {
    fn of(seen: Vec<Seen>) -> Self {
        let times = seen
            .windows(2)
            .map(|pair| pair[1].time.seconds_since(pair[0].time));
        let period = middle(times).unwrap_or(0.01);
        let half = HALF.max(PERIODS * period);
        let whole = 2.0 * half / period.max(1e-4);
        Self {
            seen,
            period,
            half,
            fewest: FEWEST.max(((1.0 - MISSING) * whole) as usize),
        }
    }

    /// Poses per second; zero without poses.
    pub fn rate(&self) -> f64 {
        if self.seen.len() < 2 {
            0.0
        } else {
            1.0 / self.period.max(1e-4)
        }
    }

    /// The poses that smooth the motion at `time`; none where too few are on either side, or one of
    /// them is off.
    fn around(&self, time: Time) -> Option<&[Seen]> {
        let (seen, half) = (&self.seen, self.half);
        let begin = seen.partition_point(|seen| seen.time < time.before(half));
        let end = seen.partition_point(|seen| seen.time <= time.after(half));
        let around = &seen[begin..end];
        let at = |seen: &Seen| seen.time.seconds_since(time);
        let reaches = at(around.first()?) <= -0.6 * half && at(around.last()?) >= 0.6 * half;
        let whole = around.iter().all(|seen| seen.kind == Kind::Car);
        let enough = around.len() >= self.fewest && self.rate() >= SLOWEST_CAMERAS;
        (whole && reaches && enough).then_some(around)
    }

    /// The smoothed motion of the car at `time`: a parabola through the poses around it (what Savitzky
    /// and Golay's filter of second order is for poses at equal times).
    pub fn motion(&self, time: Time) -> Option<Motion> {
        let around = self.around(time)?;
        let ([x, y, yaw], _) = parabolas(around, time)?;
        let axis = direction(around.first()?.pose.yaw + yaw.x);
        let in_car = |vx: f64, vy: f64| [axis.x * vx + axis.y * vy, axis.x * vy - axis.y * vx];
        let [forward, left] = in_car(x.y, y.y);
        Some(Motion {
            forward,
            left,
            yaw_rate: yaw.y,
            acceleration: in_car(2.0 * x.z, 2.0 * y.z),
        })
    }

    /// How far a pose is from the parabola through those around it, without its own pull on that: x
    /// and y in m, yaw in rad.
    pub fn residual(&self, now: &Seen) -> Option<[f64; 3]> {
        let around = self.around(now.time)?;
        let first = around.first()?.pose;
        let ([x, y, yaw], weight) = parabolas(around, now.time)?;
        let offset = now.pose.position - first.position;
        let left = (1.0 - weight).max(0.1).sqrt();
        Some([
            (offset.x - x.x) / left,
            (offset.y - y.x) / left,
            (wrap(now.pose.yaw - first.yaw) - yaw.x) / left,
        ])
    }
}

/// Stretches of poses of another body: first and last time.
pub fn ghosts_of(seen: impl Iterator<Item = Seen>) -> Vec<[Time; 2]> {
    let seen: Vec<Seen> = seen.collect();
    let is_ghost = |seen: &Seen| seen.kind == Kind::Ghost;
    let stretches = seen.chunk_by(|one, other| is_ghost(one) == is_ghost(other));
    let ghosts = stretches.filter(|stretch| is_ghost(&stretch[0]));
    ghosts
        .map(|ghost| [ghost[0].time, ghost[ghost.len() - 1].time])
        .collect()
}
