//! Whether a stop slows the car down, and how fast.

use libm::fabs;
use singletrack_control::Time;

use super::{
    count,
    roll_out::{BEYOND, FreePart, REACTION, RollOut},
};

/// Watches every end of a drive: the speed must fall, and the way to standstill gives the
/// deceleration.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct StopWatch {
    run: Option<Run>,
    /// The last two stops.
    measured: [Option<Measured>; 2],
}

/// A deceleration that was measured, m/s².
#[derive(Clone, Copy, Debug)]
struct Measured {
    deceleration: f64,
    /// What it was at most, with the error of the speed from which it was measured.
    most: f64,
}

impl Measured {
    /// Measured without that error.
    const fn exactly(deceleration: f64) -> Self {
        Self {
            deceleration,
            most: deceleration,
        }
    }
}

/// A stop that is underway.
#[derive(Clone, Copy, Debug)]
struct Run {
    begin: Time,
    /// The tick before.
    last: Time,
    roll_out: RollOut,
    /// The speed that is commanded at the beginning, m/s: a ramp leads from there to zero. The
    /// board follows it, also upward if the brake was too strong.
    commanded: f64,
    /// The part of it with a free motor: after the reaction time the car was faster than the
    /// ramp.
    free: Option<RollOut>,
    /// The last such part without a brake.
    unbraked: FreePart,
    /// The share of the measured deceleration that counts.
    share: f64,
    /// The fall of the speed by motor and by cameras.
    falls: [Fall; 2],
    /// Since when the car has stood.
    standing: Option<Time>,
    /// Whether it measures the deceleration of the car: not that of wheels in the air, and not after
    /// a time in which neither motor nor cameras gave a speed.
    measures: bool,
    /// Whether the drive ended because the poses contradicted the rest.
    doubts_cameras: bool,
    /// Whether the motor sensor showed the wheels turn in this stop.
    wheels_turned: bool,
}

/// The fall of a measured speed.
#[derive(Clone, Copy, Debug, Default)]
struct Fall {
    /// The speed from which it must fall, m/s, and its time: the first one after the reaction time,
    /// and later the mean of a window.
    from: Option<(f64, Time)>,
    window: Window,
    /// Ticks in a row with too high a speed.
    too_fast: u32,
}

/// Speeds of a short time.
#[derive(Clone, Copy, Debug, Default)]
struct Window {
    begin: Option<Time>,
    sum: f64,
    count: f64,
}

impl Window {
    /// Adds a speed (m/s); the mean when the window is full, and how long ago that was, s.
    fn add(&mut self, now: Time, speed: f64) -> Option<(f64, f64)> {
        let begin = *self.begin.get_or_insert(now);
        self.sum += speed;
        self.count += 1.0;
        let span = now.seconds_since(begin);
        if span < WINDOW {
            return None;
        }
        let mean = self.sum / self.count;
        *self = Self::default();
        Some((mean, 0.5 * span))
    }
}

impl Fall {
    /// A tick after the reaction time, with the least deceleration (m/s²), and a speed that is
    /// in order (m/s). A sensor that returns is judged from then on, as is one that has shown
    /// no speed: a coarse motor sensor has none before its second pulse.
    fn tick(&mut self, now: Time, speed: Option<f64>, least: f64, floor: f64) {
        let Some(speed) = speed.map(fabs) else {
            *self = Self::default();
            return;
        };
        let (from, since) = match self.from {
            Some(from) if from.0 >= SLOW => from,
            _ => *self.from.insert((speed, now)),
        };
        let allowed = from - least * now.seconds_since(since) + TOLERANCE;
        // A speed that is no number has not fallen.
        let too_fast = speed.is_nan() || speed > allowed.max(floor);
        count(&mut self.too_fast, too_fast);
        // A car that has slowed down faster is not allowed to go on at the speed that it has now.
        if let Some((mean, ago)) = self.window.add(now, speed)
            && mean < from - least * (now.seconds_since(since) - ago)
        {
            self.from = Some((mean, now.before(ago)));
        }
    }
}

/// The speeds of a tick, in m/s; `None` where there is no recent measurement.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Speeds {
    pub(crate) motor: Option<f64>,
    pub(crate) cameras: Option<f64>,
    /// From the estimator, which fuses both.
    pub(crate) estimate: Option<f64>,
}

impl Speeds {
    /// The larger of motor and cameras.
    pub(crate) fn worst(&self) -> Option<f64> {
        match (self.motor, self.cameras) {
            (Some(motor), Some(cameras)) => Some(fabs(motor).max(fabs(cameras))),
            (motor, cameras) => motor.or(cameras).map(fabs),
        }
    }
}

/// The result of a tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct StopVerdict {
    /// The speed does not fall.
    pub(crate) disobeyed: bool,
    /// The deceleration of the stop that ended in this tick, m/s².
    pub(crate) measured: Option<f64>,
}

/// The limits of a stop.
#[derive(Clone, Copy, Debug)]
pub(crate) struct StopLimits {
    /// The configured deceleration, m/s².
    pub(crate) braking: f64,
    /// The commanded deceleration, m/s².
    pub(crate) ramp: f64,
    /// The car stands below this speed, m/s.
    pub(crate) standing: f64,
}

/// The share of the configured deceleration that the car must reach at least. It is low: a
/// car that only rolls well is weak, and does not disobey.
const LEAST_SHARE: f64 = 0.15;
/// Largest delay of a car that follows the ramp, s.
const FOLLOWS_AFTER: f64 = 0.2;
/// Tolerance of a measured speed, m/s.
const TOLERANCE: f64 = 0.03;
/// The time whose mean speed becomes the new start of the fall, s. A shorter mean follows the noise
/// of the cameras.
const WINDOW: f64 = 0.5;
/// Below this speed nothing is judged, m/s.
const SLOW: f64 = 0.08;
/// The number of fast ticks in a row that make a disobeyed stop...
const TOO_FAST: u32 = 3;
/// ...and if the cameras see the car stand, or slow down and slower than its wheels: they may be off
/// the floor, and a coarse pulse sensor shows the mean speed between the last two pulses for a while.
const TOO_FAST_IN_PLACE: u32 = 40;
/// Below this speed of the cameras, m/s, wheels that stand are believed more than cameras that
/// were found to contradict the rest: poses that drift go on drifting after the stop.
const DRIFTS_BELOW: f64 = 0.25;
/// The time for which the car stands at the end of a stop, s.
const STANDS: f64 = 0.2;
/// Below this speed it does, m/s: beyond the noise of the cameras' speed, or a hand that takes the
/// car up before the noise has let a stop end makes one that is not obeyed.
const STANDS_BELOW: f64 = 0.05;
/// The longest stop beyond its reaction time at [`LEAST_SHARE`], s. Afterwards a car that
/// moves is one that somebody carries or pushes.
const LONGER: f64 = 1.0;
/// The lowest speed from which a stop measures the deceleration, m/s.
const MEASURED_FROM: f64 = 0.25;
/// The error of the estimated speed when it begins to fall, m/s: a deceleration v²/2s from a low
/// speed is not known to a tenth.
const SPEED_ERROR: f64 = 0.02;
/// A stop below this share of the configured deceleration is weak...
const WEAK: f64 = 0.9;
/// ...and below this one is enough to refuse the next drive.
const TOO_WEAK: f64 = 0.6;

/// A measured deceleration counts as this at least, m/s²: a way to standstill is finite.
const LEAST: f64 = 0.05;

impl StopWatch {
    /// The drive ends at `now`: the motor is to slow down from this commanded speed (m/s), or
    /// is at neutral.
    ///
    /// `share` is what the motor shows of the cameras' speed if they contradict each other and
    /// it shows less, else 1. The estimate follows the cameras, and a deceleration v²/2s grows
    /// with the scale of speed and way: of two that differ the lower one counts.
    pub(crate) fn begin(&mut self, now: Time, speeds: &Speeds, commanded: f64, share: f64) {
        if self.run.is_some() {
            return;
        }
        let speed = speeds.estimate.map(fabs).or(speeds.worst());
        self.run = Some(Run {
            begin: now,
            last: now,
            roll_out: RollOut::begin(speed.unwrap_or(0.0)),
            commanded: fabs(commanded),
            free: None,
            unbraked: FreePart::default(),
            share,
            falls: [Fall::default(); 2],
            standing: None,
            measures: true,
            doubts_cameras: false,
            wheels_turned: speeds.motor.is_some_and(|motor| fabs(motor) >= SLOW),
        });
    }

    /// Poses that contradicted the rest ended the drive.
    pub(crate) const fn doubt_cameras(&mut self) {
        if let Some(run) = &mut self.run {
            run.doubts_cameras = true;
        }
    }

    /// Jogging ends at `now`: the motor is at neutral. The wheels must slow down; they may be
    /// off the floor, so that their deceleration says nothing of the car's.
    pub(crate) fn begin_after_jogging(&mut self, now: Time, speeds: &Speeds) {
        self.begin(now, speeds, 0.0, 1.0);
        if let Some(run) = &mut self.run {
            run.measures = false;
        }
    }

    /// Whether a stop is not over: the car has not stood for long enough.
    pub(crate) const fn is_underway(&self) -> bool {
        self.run.is_some()
    }

    /// The next drive begins.
    pub(crate) const fn end(&mut self) {
        self.run = None;
    }

    /// Whether the last stops were too weak to drive again with this configured deceleration
    /// (m/s²). A configured [`LEAST`] fits whatever was measured.
    pub(crate) fn is_too_weak(&self, braking: f64) -> bool {
        let is_below = |stop: &Measured, share: f64| stop.most.max(LEAST) < share * braking;
        let both_weak = self
            .measured
            .iter()
            .all(|measured| measured.is_some_and(|stop| is_below(&stop, WEAK)));
        let is_too_weak = |stop: &Measured| is_below(stop, TOO_WEAK);
        both_weak || self.measured.iter().flatten().any(is_too_weak)
    }

    /// The lowest deceleration of the last two stops, m/s².
    pub(crate) fn lowest(&self) -> f64 {
        let stops = self.measured.iter().flatten();
        stops.fold(f64::INFINITY, |lowest, stop| lowest.min(stop.deceleration))
    }

    /// The deceleration to rely on, m/s²: as configured or as measured, whichever is lower.
    pub(crate) fn relied_on(&self, braking: f64) -> f64 {
        braking.min(self.lowest().max(LEAST))
    }

    /// A tick.
    pub(crate) fn tick(&mut self, now: Time, speeds: &Speeds, limits: &StopLimits) -> StopVerdict {
        let mut verdict = StopVerdict::default();
        let Some(run) = &mut self.run else {
            return verdict;
        };
        let elapsed = now.seconds_since(run.begin);
        let worst = speeds.worst();
        run.measures &= worst.is_some();
        let pace = speeds.estimate.map(fabs).or(worst).unwrap_or(0.0);
        let way = pace * now.seconds_since(run.last);
        run.last = now;
        run.roll_out.tick(elapsed, pace, way);
        if let Some(free) = &mut run.free {
            free.tick(elapsed, pace, way);
        }
        let least = LEAST_SHARE * limits.braking;
        if elapsed >= REACTION {
            let [motor, cameras] = &mut run.falls;
            let behind = run.commanded - limits.ramp * (elapsed - FOLLOWS_AFTER);
            let floor = SLOW.max(behind);
            let ramp = run.commanded - limits.ramp * elapsed;
            if run.free.is_none() && pace > ramp + BEYOND {
                run.free = Some(RollOut::begin(pace));
            }
            run.unbraked.tick(now, pace, ramp, MEASURED_FROM, way);
            motor.tick(now, speeds.motor, least, floor);
            let wheels_stand =
                run.wheels_turned && speeds.motor.is_some_and(|motor| fabs(motor) < STANDS_BELOW);
            let floor = if run.doubts_cameras && wheels_stand {
                floor.max(DRIFTS_BELOW)
            } else {
                floor
            };
            cameras.tick(now, speeds.cameras, least, floor);
            let in_place = speeds.cameras.is_some_and(|seen| seen < SLOW);
            // They see it slower than its wheels, and its speed falls.
            let slows_down = cameras.too_fast == 0
                && speeds
                    .cameras
                    .zip(speeds.motor)
                    .is_some_and(|(seen, motor)| fabs(seen) + TOLERANCE < fabs(motor));
            let most = if in_place || (slows_down && !run.doubts_cameras) {
                TOO_FAST_IN_PLACE
            } else {
                TOO_FAST
            };
            verdict.disobeyed = motor.too_fast >= most || cameras.too_fast >= TOO_FAST;
        }
        // Without any measurement the car may still move.
        let stands = worst.is_some_and(|speed| speed < limits.standing.max(STANDS_BELOW));
        let since = if stands {
            Some(*run.standing.get_or_insert(now))
        } else {
            run.standing = None;
            None
        };
        let stood = since.is_some_and(|since| now.seconds_since(since) >= STANDS);
        let late = elapsed > REACTION + LONGER + run.roll_out.from / least;
        if stood || late || verdict.disobeyed {
            let ended = *run;
            self.run = None;
            let left = if stood { 0.0 } else { worst.unwrap_or(pace) };
            // A ramp that the motor follows hides how the car slows down without it, and so
            // does a brake.
            let unbraked = ended.unbraked.roll_out();
            let measured = [Some(ended.roll_out), ended.free, unbraked]
                .into_iter()
                .flatten()
                .filter(|roll_out| ended.measures && roll_out.from >= MEASURED_FROM)
                .map(|roll_out| {
                    let deceleration = ended.share * roll_out.deceleration(left);
                    let error = 1.0 + SPEED_ERROR / roll_out.from;
                    Measured {
                        deceleration,
                        most: deceleration * error * error,
                    }
                })
                .filter(|stop| stop.deceleration.is_finite())
                .min_by(|one, other| one.deceleration.total_cmp(&other.deceleration));
            if let Some(measured) = measured {
                verdict.measured = Some(measured.deceleration);
                self.note(measured);
            }
        }
        verdict
    }

    /// A measurement of the deceleration besides the stops, m/s².
    pub(crate) const fn coasted(&mut self, measured: f64) {
        self.note(Measured::exactly(measured));
    }

    const fn note(&mut self, measured: Measured) {
        self.measured = [Some(measured), self.measured[0]];
    }
}

#[cfg(test)]
mod tests;
