//! Drives on the floor: where there is room, and what a drive shows.

use singletrack_control::{Position, Time, Velocity, direction, wrap};
use singletrack_core::Config;
use singletrack_pilot::{Fence, Mode, Reason};
use singletrack_protocol::BoardMode;

use crate::{
    Answer, Attendance, Bench, Interrupted, Question, TickReading, Trouble,
    finding::{change, failed, require, stopped},
    observed::Readings,
};

/// The speed of the first drives, m/s.
pub(super) const SLOW: f64 = 0.3;

/// The top speed of the configuration above the speed of a drive, m/s: for corrections.
const SPARE: f64 = 0.05;

/// Room that is kept beyond the margin of the geofence, m.
const ROOM: f64 = 0.15;

/// How far P may be from where it should be before a drive is given up, m.
const ASTRAY: f64 = 2.5;

/// The way waits for a car that is behind it: not at all up to the first distance of P, and
/// fully from the second one on, m.
const WAITS: [f64; 2] = [0.15, 0.4];

/// The gain of the position loop around P, per second. The one of the configuration may be
/// anything.
const GAIN: f64 = 1.0;

/// How long a car must have been ready before it is armed, in ticks: the board wants neutral for
/// a while.
const RESTS: usize = 100;

/// How long a car may take to be ready, in ticks.
const READY_TICKS: usize = 1_500;

/// Where P is to be and how fast, in m and m/s.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wanted {
    pub(super) position: Position,
    pub(super) velocity: Velocity,
}

/// What a drive showed.
#[derive(Default)]
pub(super) struct Drive {
    pub(super) readings: Readings,
    /// When the drive was how far, in s.
    progress: Vec<(Time, f64)>,
    /// Why it ended, if by itself.
    pub(super) reason: Option<&'static str>,
}

/// Limits the car to this speed.
pub(super) fn limit_speed(bench: &mut dyn Bench, speed: f64) -> Result<(), Trouble> {
    let top = round(speed + SPARE, 2);
    let limits = &bench.configuration().limits;
    let mut values = Vec::new();
    if limits.creep_speed_m_s > top {
        values.push(("limits.creep_speed_m_s", SLOW.into()));
    }
    if limits.max_speed_m_s != top {
        values.push(("limits.max_speed_m_s", top.into()));
    }
    change(bench, &values)
}

/// A value with so many digits after the point.
pub(super) fn round(value: f64, digits: i32) -> f64 {
    let scale = 10.0_f64.powi(digits);
    (value * scale).round() / scale
}

/// Waits until the car can be armed, and gives where it stands.
pub(super) fn ready(bench: &mut dyn Bench) -> Result<TickReading, Trouble> {
    let mut observed = Vec::new();
    let mut reason = None;
    let mut rested = 0;
    for _ in 0..READY_TICKS {
        bench.wait(&mut observed)?;
        let mut readings = Readings::default();
        readings.take(&mut observed);
        for tick in readings.ticks {
            reason = tick.preflight.or(tick.reason);
            // The set-points begin with the request to arm.
            let is_ready = match tick.mode {
                Mode::Idle => tick.preflight == Some(Reason::SetpointStale),
                mode => mode == Mode::Ready,
            };
            rested = if is_ready { rested + 1 } else { 0 };
            if tick.pose.is_some() && rested > RESTS {
                return Ok(tick);
            }
        }
    }
    let word = reason.map_or("no reason", Reason::name);
    Err(stopped("the car is not ready to be armed", word))
}

/// Waits for a car on the floor that can be armed for a drive of at most this speed, m/s, and gives
/// where it stands.
pub(super) fn begin(bench: &mut dyn Bench, speed: f64) -> Result<TickReading, Trouble> {
    place(bench)?;
    limit_speed(bench, speed)?;
    ready(bench)
}

/// Asks the operator to put the car on the floor.
pub(super) fn place(bench: &mut dyn Bench) -> Result<(), Trouble> {
    let request = "Put the car on the floor in the middle of the geofence, looking along its longer \
                   side. Keep everybody out of the geofence. The car drives by itself while you \
                   hold the key, and stops when you let it go.";
    let answer = bench.ask(&Question::begin("place-on-floor", request))?;
    let fix = "run this step again when there is room";
    require(answer != Answer::Skip, "the car is not on the floor", fix)
}

/// Two circles that touch where P is: the way is to the left first.
#[derive(Clone, Copy, Debug)]
pub(super) struct Figure {
    start: Position,
    tangent: Position,
    heading: f64,
    /// 1 if the circle to the left comes first, -1 if the one to the right does.
    first: f64,
    pub(super) radius: f64,
}

impl Figure {
    /// The one that has room nearest to where the car stands.
    pub(super) fn find(bench: &dyn Bench, stands: &TickReading) -> Result<Self, Trouble> {
        let config = bench.configuration();
        let no_room = || {
            let found = "the geofence has no room for two circles that touch each other";
            let fix = format!(
                "put the car in the middle of the geofence, or widen fence.corners_m: {}",
                size(config)
            );
            failed(found, fix)
        };
        let fence = config.fence.fence(&config.vehicle).map_err(|_| no_room())?;
        let (Some(start), Some((_, yaw))) = (stands.point, stands.pose) else {
            return Err(no_room());
        };
        let radius = radius(config);
        let corners = fence.corners();
        let sum: Velocity = corners.iter().map(|corner| corner.coords).sum();
        let middle = Position::from(sum / corners.len() as f64);
        let to_middle = middle - start;
        let to_middle = to_middle.y.atan2(to_middle.x);
        let mut figures = Vec::new();
        for (tangent, course) in [(start, yaw), (middle, to_middle)] {
            for turn in -11..=12 {
                let turned = f64::from(turn) * 15.0_f64.to_radians();
                let touching = Self::touching(tangent, course + turned, radius);
                let figure = Self { start, ..touching };
                // A way to drive there, and a turn at both of its ends, are to be avoided.
                let off = wrap(course - yaw).abs();
                figures.push((figure.approach() + turned.abs() + off, figure));
            }
        }
        let figures = figures.into_iter();
        figures
            .filter(|(_, figure)| figure.fits(&fence, 2.0, ROOM))
            .min_by(|(one, _), (other, _)| one.total_cmp(other))
            .map(|(_, figure)| figure)
            .ok_or_else(no_room)
    }

    /// The one that begins where its circles touch.
    fn touching(tangent: Position, heading: f64, radius: f64) -> Self {
        Self {
            start: tangent,
            tangent,
            heading,
            first: 1.0,
            radius,
        }
    }

    /// A circle from where the car stands, along its heading, with room beyond it for a stop
    /// from `speed` m/s; none if there is no room for one.
    pub(super) fn circle(bench: &dyn Bench, stands: &TickReading, speed: f64) -> Option<Self> {
        let config = bench.configuration();
        let fence = config.fence.fence(&config.vehicle).ok()?;
        let (start, (_, yaw)) = (stands.point?, stands.pose?);
        // A stop holds the steering: it needs less.
        let room = ROOM + 0.5 * speed * speed / (2.0 * config.fence.braking_m_s2);
        let left = Self::touching(start, yaw, radius(config));
        let circles = [1.0, -1.0].map(|first| Self { first, ..left });
        circles
            .into_iter()
            .find(|circle| circle.fits(&fence, 1.0, room))
    }

    /// Whether there is room for so many laps, with this distance to the geofence, m.
    fn fits(&self, fence: &Fence, laps: f64, room: f64) -> bool {
        (0..48).all(|index| {
            let way = f64::from(index) / 48.0 * laps * self.lap();
            fence.clearance(&self.at(self.approach() + way, 0.0).position) > room
        })
    }

    /// The way around one circle, m.
    pub(super) fn lap(&self) -> f64 {
        core::f64::consts::TAU * self.radius
    }

    /// The way to where the circles touch, m.
    pub(super) fn approach(&self) -> f64 {
        (self.tangent - self.start).norm()
    }

    /// Where P is to be after a way, and how fast: `speed` m/s along it.
    pub(super) fn at(&self, way: f64, speed: f64) -> Wanted {
        let approach = self.approach();
        if way < approach {
            let along = (self.tangent - self.start) / approach;
            return Wanted {
                position: self.start + way * along,
                velocity: speed * along,
            };
        }
        let laps = (way - approach) / self.lap();
        let is_first = laps.rem_euclid(2.0) < 1.0;
        let side = if is_first { self.first } else { -self.first };
        let phase = laps.rem_euclid(1.0) * core::f64::consts::TAU;
        let course = self.heading + side * phase;
        // From where the circles touch to the centre, and from there outward.
        let inward = self.heading + side * core::f64::consts::FRAC_PI_2;
        let outward = course - side * core::f64::consts::FRAC_PI_2;
        Wanted {
            position: self.tangent + self.radius * (direction(inward) + direction(outward)),
            velocity: speed * direction(course),
        }
    }
}

/// Refuses a straight way of P from `start` (m) for which the geofence has no room.
pub(super) fn room_ahead(bench: &dyn Bench, start: Position, way: Velocity) -> Result<(), Trouble> {
    let config = bench.configuration();
    let stop = SLOW * SLOW / (2.0 * config.fence.braking_m_s2);
    let way = way * (1.0 + (stop + ROOM) / way.norm());
    let fence = config.fence.fence(&config.vehicle).ok();
    if fence.is_some_and(|fence| fence.contains_way(&start, &way)) {
        return Ok(());
    }
    Err(failed(
        format!(
            "the geofence has no room for a straight line of {:.1} m from where the car stands",
            way.norm()
        ),
        "turn the car towards the middle of the geofence, or put it farther back, and run this step \
         again",
    ))
}

/// The length and the width of the least rectangle that a figure fits into, in words.
fn size(config: &Config) -> String {
    let radius = radius(config);
    let around = 2.0 * (ROOM + config.fence.margin_m(&config.vehicle));
    // To the next tenth, beyond which the places between the points of the search are as well.
    let up = |side: f64| ((side + around) * 10.0).ceil() / 10.0 + 0.1;
    format!(
        "this car needs a rectangle of {:.1} by {:.1} m",
        up(2.0 * radius),
        up(4.0 * radius)
    )
}

/// Why the geofence has no room for the drives, with the size that they need; `None` if it has.
pub fn lacks_room(config: &Config) -> Option<String> {
    /// The places that are looked at along each side of the geofence.
    const PLACES: usize = 24;
    let refusal = |found: &str| {
        Some(format!(
            "{found}: two circles that touch, of which the drives are made, do not fit. Widen \
             fence.corners_m: {}",
            size(config)
        ))
    };
    let Ok(fence) = config.fence.fence(&config.vehicle) else {
        return refusal("there is no geofence");
    };
    let sides = |of: fn(&Position) -> f64| {
        let values = fence.corners().iter().map(of);
        let least = values.clone().fold(f64::INFINITY, f64::min);
        [least, values.fold(f64::NEG_INFINITY, f64::max) - least]
    };
    let [x, y] = [sides(|corner| corner.x), sides(|corner| corner.y)];
    let part = |[least, side]: [f64; 2], index: usize| least + side * index as f64 / PLACES as f64;
    let radius = radius(config);
    let fits = (0..=PLACES * PLACES).any(|place| {
        let tangent = Position::new(part(x, place % PLACES), part(y, place / PLACES));
        // Both circles are the same from behind.
        fence.clearance(&tangent) > ROOM
            && (0..12).any(|turn| {
                let heading = f64::from(turn) * 15.0_f64.to_radians();
                Figure::touching(tangent, heading, radius).fits(&fence, 2.0, ROOM)
            })
    });
    if fits {
        return None;
    }
    refusal(&format!(
        "the geofence of {:.1} by {:.1} m is too small",
        x[1], y[1]
    ))
}

/// The radius of circles of P that the car can steer, with something to spare, m.
fn radius(config: &Config) -> f64 {
    let steering = 0.7 * config.limits.max_steering_rad.min(0.5);
    let length = config.vehicle.wheelbase_m();
    let p = config.law.point_distance_m;
    (length + p * steering.cos()).hypot(length / steering.tan() - p * steering.sin())
}

impl Wanted {
    /// Moved across its course by `offset` m to the left, which grows with `rate` m/s.
    pub(super) fn aside(self, offset: f64, rate: f64) -> Self {
        let along = self.velocity / self.velocity.norm().max(1e-6);
        let left = Velocity::new(-along.y, along.x);
        Self {
            position: self.position + offset * left,
            velocity: self.velocity + rate * left,
        }
    }
}

/// Drives P as wanted for a time in s, then stops and disarms; the car rolls out at neutral while
/// nothing is wanted. A drive that ends by itself is no error.
pub(super) fn drive(
    bench: &mut dyn Bench,
    seconds: f64,
    text: &str,
    wanted: &dyn Fn(f64) -> Option<Wanted>,
) -> Result<Drive, Trouble> {
    let mut point: Option<Position> = None;
    const FIX: &str = "Correct it and run this step again.";
    bench
        .arm(Attendance::Drive)
        .map_err(|error| failed(format!("the car can't be armed: {error}"), FIX))?;
    let mut drive = Drive::default();
    let mut observed = Vec::new();
    let mut is_over = false;
    let mut last = None;
    let (mut now, mut pace) = (0.0, 1.0);
    while !is_over && now < seconds {
        let next = wanted(now);
        let velocity = match (point, last, next) {
            // What waits does not move.
            (Some(point), Some(_), Some(next)) => {
                pace * next.velocity + GAIN * (next.position - point)
            }
            // The board arms, or the car rolls: a lower speed than the present one is neutral.
            _ => Velocity::zeros(),
        };
        if let Err(error) = bench.drive(velocity, None) {
            stop(bench, &mut drive)?;
            return Err(failed(format!("the drive ended: {error}"), FIX));
        }
        bench.wait(&mut observed)?;
        let before = drive.readings.ticks.len();
        drive.readings.take(&mut observed);
        for tick in &drive.readings.ticks[before..] {
            point = tick.point;
            if tick.mode == Mode::Arming {
                continue;
            }
            if tick.mode != Mode::Driving {
                drive.reason = tick.reason.map(Reason::name);
                is_over |= tick.mode != Mode::Slowing;
            }
            let behind = point.zip(next);
            let behind = behind.map_or(0.0, |(point, next)| (point - next.position).norm());
            if behind > ASTRAY {
                drive.reason = Some("astray");
                is_over = true;
            }
            let elapsed = tick.time.seconds_since(last.unwrap_or(tick.time));
            pace = 1.0 - ((behind - WAITS[0]) / (WAITS[1] - WAITS[0])).clamp(0.0, 1.0);
            now += pace * elapsed.max(0.0);
            last = Some(tick.time);
            drive.progress.push((tick.time, now));
        }
        bench.show(text, (now / seconds).clamp(0.0, 1.0));
    }
    stop(bench, &mut drive)?;
    Ok(drive)
}

/// Stops the car, and waits until it stands and can be armed again.
fn stop(bench: &mut dyn Bench, drive: &mut Drive) -> Result<(), Interrupted> {
    use BoardMode::{Armed, Driving, PoweringUp};
    use Mode::{Disconnected, Fault, Idle, Ready};

    let _ = bench.disarm();
    let mut observed = Vec::new();
    for _ in 0..600 {
        bench.wait(&mut observed)?;
        drive.readings.take(&mut observed);
        let mode = drive.readings.ticks.last().map(|tick| tick.mode);
        let of_board = drive.readings.boards.last().map(|board| board.mode);
        if matches!(mode, Some(Idle | Ready | Disconnected | Fault))
            && !matches!(of_board, Some(Armed | Driving | PoweringUp))
        {
            break;
        }
    }
    Ok(())
}

impl Drive {
    /// When the drive was so far, in s of its readings.
    pub(super) fn when(&self, far: f64) -> f64 {
        let index = self.progress.partition_point(|(_, now)| *now < far);
        let at = self.progress.get(index).or(self.progress.last());
        at.map_or(0.0, |(time, _)| self.readings.at(*time))
    }

    /// Refuses a drive that ended by itself.
    pub(super) fn completed(self) -> Result<Self, Trouble> {
        match self.reason {
            None => Ok(self),
            Some("astray") => Err(failed(
                format!("the car was {ASTRAY} m from its path, and was stopped"),
                "check board.servo.gain_us_per_rad, marker_yaw_rad and vehicle.*, or run \
                 `singletrack bring-up` again",
            )),
            Some(reason) => Err(stopped("the drive ended by itself", reason)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_geofence_without_room_is_refused_with_a_size_that_is_not() {
        let text = include_str!("../../../daemon/singletrackd.example.toml");
        let example = Config::from_toml(text).unwrap();
        let of = |length: f64, width: f64, turned: f64, moved: f64| {
            let mut config = example.clone();
            let corner = |x: f64, y: f64| {
                let (along, across) = (
                    direction(turned),
                    direction(turned + core::f64::consts::FRAC_PI_2),
                );
                let place = 0.5 * x * length * along + 0.5 * y * width * across;
                [place.x + moved, place.y]
            };
            config.fence.corners_m = vec![
                corner(-1.0, -1.0),
                corner(1.0, -1.0),
                corner(1.0, 1.0),
                corner(-1.0, 1.0),
            ];
            config
        };
        let refusal = lacks_room(&of(2.0, 2.0, 0.0, 0.0)).unwrap();
        assert!(
            refusal.contains("of 2.0 by 2.0 m is too small"),
            "{refusal}"
        );
        let (_, size) = refusal.split_once("a rectangle of ").unwrap();
        let (width, rest) = size.split_once(" by ").unwrap();
        let [width, length]: [f64; 2] =
            [width, rest.trim_end_matches(" m")].map(|side| side.parse().unwrap());
        assert!(
            width < 3.0 && length < 5.0,
            "docs/parts.md says 3 by 5 m: {refusal}"
        );
        for turned in [0.0, 90.0_f64.to_radians()] {
            for moved in [0.0, 7.3] {
                assert_eq!(
                    lacks_room(&of(length, width, turned, moved)),
                    None,
                    "{turned} {moved}"
                );
                for (less, too_little) in [(0.4, 0.0), (0.0, 0.4)] {
                    let config = of(length - less, width - too_little, turned, moved);
                    assert!(lacks_room(&config).is_some(), "{less} {too_little}");
                }
            }
        }
        assert_eq!(lacks_room(&of(5.0, 3.0, 0.4, 0.0)), None);
    }

    #[test]
    fn the_figure_goes_around_both_circles_without_a_jump() {
        let figure = Figure {
            start: Position::new(-1.0, 0.5),
            tangent: Position::new(0.2, 0.1),
            heading: 0.7,
            first: 1.0,
            radius: 0.9,
        };
        let length = figure.approach() + 4.0 * figure.lap();
        let mut last = figure.at(0.0, 0.3);
        assert_eq!(last.position, figure.start);
        let step = 0.005;
        for index in 1..(length / step) as u32 {
            let next = figure.at(f64::from(index) * step, 0.3);
            let moved = next.position - last.position;
            assert!((moved.norm() - step).abs() < 1e-4, "{index}");
            if f64::from(index) * step > figure.approach() + step {
                // The course is along the way.
                let along = moved.dot(&next.velocity) / 0.3;
                assert!((along - step).abs() < 1e-3 * step, "{index}: {along}");
            }
            last = next;
        }
        let half = figure.at(figure.approach() + 0.5 * figure.lap(), 0.3);
        let across = half.position - figure.tangent;
        assert!((across.norm() - 1.8).abs() < 1e-9);
        // To the left of the heading.
        assert!(across.y * figure.heading.cos() - across.x * figure.heading.sin() > 1.7);
    }
}
