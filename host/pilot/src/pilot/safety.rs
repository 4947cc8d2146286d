//! The safety filter between the outer loop, ours or one outside, and the law; and other rigid bodies,
//! which are obstacles of the drive.

use libm::fabs;
use singletrack_control::{
    Actuation, Ahead, Estimate, Expected, Filtered, LimitedLaw, Motion, NeighbourConfig,
    NeighbourSample, NeighbourSides, Neighbours, SafetyFilter, SafetyInput, Singularity,
    SpeedDemand, SteeringDemand, Time, Velocity, words,
};

use super::{Output, Pilot};
use crate::{supervisor::Reason, watch::WAVE};

words! {
    /// What the safety filter did in a tick.
    #[derive(Default)]
    pub enum Filtering {
        /// Nothing, or there is no filter.
        #[default]
        None = 1 "none",
        /// It gave the law the nearest velocity of P within its bounds.
        Limited = 2 "limited",
        /// It gave the law a part of what was wanted.
        Scaled = 3 "scaled",
        /// It slowed the car down, with the steering held.
        Stopped = 4 "stopped",
        /// It changed what was wanted for another rigid body: the car goes on when that has gone.
        Yielded = 5 "yielded",
    }
}

/// The filter's state in the pilot.
#[derive(Clone, Debug, Default)]
pub(super) struct Safety {
    filter: Option<SafetyFilter>,
    /// What it did in this tick.
    pub(super) filtering: Filtering,
    /// The number of ticks of the drive in which it did anything.
    pub(super) ticks: u32,
    /// Why the drive is to end at the next tick.
    pub(super) ends: Option<Reason>,
    /// How long the path has not bent as the filter assumes, s.
    bends_otherwise: f64,
}

/// The path may bend otherwise for so long, s: the wheels strike something, a pose jumps.
const BENDS_OTHERWISE: f64 = 0.2;

/// P goes no slower before another body, m/s: the car stands instead. A motor that is driven must turn.
const CREEP: f64 = 0.1;

/// What the law is given besides a velocity.
pub(super) struct LawStep {
    pub(super) motion: Motion,
    /// The angle of the front wheels that the law reckons with, rad.
    pub(super) wheels: f64,
    pub(super) ahead: Ahead,
}

impl Safety {
    pub(super) fn new(filter: Option<&SafetyFilter>) -> Self {
        Self {
            filter: filter.cloned(),
            ..Self::default()
        }
    }

    /// A drive begins, with the servo at `steering` (rad).
    pub(super) const fn begin(&mut self, steering: f64) {
        if let Some(filter) = &mut self.filter {
            filter.reset(steering);
        }
        self.ticks = 0;
        self.ends = None;
        self.bends_otherwise = 0.0;
    }

    /// A tick begins: see [`SafetyFilter::observe`].
    pub(super) fn observe(&mut self, pace: f64, sent: f64, braking: f64, period: f64) {
        self.filtering = Filtering::None;
        if let Some(filter) = &mut self.filter {
            filter.observe(pace, sent, braking, period);
        }
    }

    /// After it: whether the path bends as assumed, with the wheels up to `wave` (rad) from what
    /// was sent.
    pub(super) fn watch(&mut self, estimate: Option<&Estimate>, wave: f64, period: f64) {
        let fits = match (&self.filter, estimate) {
            (Some(filter), Some(estimate)) => filter.bends_as_assumed(estimate, wave),
            _ => true,
        };
        self.bends_otherwise = if fits {
            0.0
        } else {
            self.bends_otherwise + period
        };
    }

    /// Whether the path bends otherwise than the filter assumes: a stop may then leave the area.
    pub(super) fn bends_otherwise(&self) -> bool {
        self.bends_otherwise > BENDS_OTHERWISE
    }

    fn note(&mut self, filtering: Filtering) {
        if filtering != Filtering::None {
            self.filtering = filtering;
            self.ticks = self.ticks.saturating_add(1);
        }
    }
}

impl Pilot {
    /// The most by which the first metre turns the wheels from the law's angle, rad.
    pub(super) const fn wave(&self) -> f64 {
        if self.watches.proving.is_some() {
            WAVE
        } else {
            0.0
        }
    }

    fn safety_input<'a>(&'a self, estimate: &'a Estimate, wheels: f64) -> SafetyInput<'a> {
        SafetyInput {
            estimate,
            law: &self.law,
            wheels,
            wave: self.wave(),
            blind: self.watches.blind.distance,
            braking: self.watches.braking(&self.config),
            period: self.config.period,
            neighbours: &self.obstacles.sides,
        }
    }

    /// A step of the law towards the wanted velocity of P (m/s), or towards what the filter
    /// leaves of it.
    ///
    /// # Errors
    ///
    /// Where the law is singular.
    pub(super) fn step_law(
        &mut self,
        estimate: &Estimate,
        step: &LawStep,
        wanted: &Velocity,
        output: &mut Output,
    ) -> Result<Actuation, Singularity> {
        output.point_velocity = Some(*wanted);
        let (period, cap) = (self.config.period, self.watches.speed_cap());
        let advance = |law: &mut LimitedLaw, velocity: &Velocity| {
            law.step_ahead(&step.motion, estimate.speed, velocity, &step.ahead, period)
        };
        let Some(filter) = &self.safety.filter else {
            return advance(&mut self.law, wanted);
        };
        let trial = |law: &mut LimitedLaw, velocity: &Velocity| {
            advance(law, velocity)?;
            law.cap_speed(cap);
            Ok(law.actuation())
        };
        let input = self.safety_input(estimate, step.wheels);
        let filtered = filter.step(&input, wanted, trial);
        let without = alone(&input, &filtered).map(|alone| filter.step(&alone, wanted, trial));
        let moves = |velocity: &Velocity| velocity.norm() >= CREEP;
        let (velocity, yields) = self.what_is_left((filtered, without), *wanted, moves);
        if yields {
            let given = velocity.unwrap_or_default();
            self.delay = self.obstacles.delay(wanted, &given);
        }
        output.point_velocity = velocity;
        let actuation = match velocity {
            Some(velocity) => advance(&mut self.law, &velocity)?,
            None => self.stop_by_filter(wanted.norm().is_finite(), yields),
        };
        self.note_yielding(yields, &actuation);
        Ok(actuation)
    }

    /// A step towards steering and speed that a controller outside demands, or towards what the
    /// filter leaves of them.
    ///
    /// # Errors
    ///
    /// [`Singularity::NotFinite`] for a demand that is not finite, without a filter.
    pub(super) fn step_demand(
        &mut self,
        estimate: &Estimate,
        steering: SteeringDemand,
        speed: SpeedDemand,
    ) -> Result<Actuation, Singularity> {
        let (period, cap) = (self.config.period, self.watches.speed_cap());
        let Some(filter) = &self.safety.filter else {
            return self.law.follow(steering, speed, period);
        };
        let now = self.law.actuation();
        let part = |share| part_of(share, (steering, speed), &now, period);
        let trial = |law: &mut LimitedLaw, share: f64| {
            let (steering, speed) = part(share);
            law.follow(steering, speed, period)?;
            law.cap_speed(cap);
            Ok(law.actuation())
        };
        let input = self.safety_input(estimate, now.steering);
        let filtered = filter.demand(&input, trial);
        let without = alone(&input, &filtered).map(|alone| filter.demand(&alone, trial));
        let (share, yields) = self.what_is_left((filtered, without), 1.0, |share| *share > 0.0);
        let actuation = match share {
            Some(share) => {
                let (steering, speed) = part(share);
                self.law.follow(steering, speed, period)?
            }
            None => {
                let is_finite = self.law.clone().follow(steering, speed, period).is_ok();
                self.stop_by_filter(is_finite, yields)
            }
        };
        self.note_yielding(yields, &actuation);
        Ok(actuation)
    }

    /// What the filter leaves of the whole of a demand, from its answers with and without other bodies.
    /// The car yields to these where the answers differ; what does not move it then is nothing. None where
    /// it stops, and whether it yields, or did a moment ago.
    fn what_is_left<T: PartialEq>(
        &mut self,
        (filtered, without): (Filtered<T>, Option<Filtered<T>>),
        whole: T,
        moves: impl Fn(&T) -> bool,
    ) -> (Option<T>, bool) {
        let yields = without.is_some_and(|without| without != filtered);
        let (filtering, value) = match filtered {
            Filtered::Unchanged => (Filtering::None, Some(whole)),
            Filtered::Limited(value) => (Filtering::Limited, Some(value)),
            Filtered::Scaled(value) => (Filtering::Scaled, Some(value)),
            Filtered::Stop => (Filtering::Stopped, None),
        };
        let value = value.filter(|value| !yields || moves(value));
        let no_way = yields && value.is_none();
        let waits = self.obstacles.wait(no_way, self.config.period);
        let value = value.filter(|_| !waits);
        if value.is_some() {
            self.safety.note(filtering);
        }
        (value, yields || waits)
    }

    /// A tick of the pilot's stop. The drive ends if the car comes to stand by it, unless before
    /// another body, or was to follow no number; otherwise it goes on once a step leaves the car
    /// able to stop again.
    fn stop_by_filter(&mut self, is_finite: bool, yields: bool) -> Actuation {
        let config = &self.config;
        let actuation = self.law.slow_down(config.stop_deceleration, config.period);
        self.safety.note(Filtering::Stopped);
        self.safety.ends = if !is_finite {
            Some(Reason::LawSingular)
        } else if actuation.speed == 0.0 && !yields {
            Some(Reason::OutsideFence)
        } else {
            None
        };
        actuation
    }

    /// Notes whether the car yields to another body; the drive ends if it stands for too long.
    fn note_yielding(&mut self, yields: bool, actuation: &Actuation) {
        if yields {
            self.safety.filtering = Filtering::Yielded;
        }
        let stands = yields && fabs(actuation.speed) < self.config.supervisor.standing_speed;
        let ends = self.obstacles.stand(stands, self.config.period);
        self.safety.ends = self.safety.ends.or(ends);
    }
}

/// The car of a tick without other bodies; none if there are none, or if the filter changed nothing.
fn alone<'a, T: PartialEq>(
    input: &SafetyInput<'a>,
    filtered: &Filtered<T>,
) -> Option<SafetyInput<'a>> {
    let is_changed = *filtered != Filtered::Unchanged;
    (is_changed && !input.neighbours.is_empty()).then_some(SafetyInput {
        neighbours: &[],
        ..*input
    })
}

/// A share of what is demanded: as far from the present steering, and as fast. The whole is the
/// demand itself, to the bit.
fn part_of(
    share: f64,
    (steering, speed): (SteeringDemand, SpeedDemand),
    now: &Actuation,
    period: f64,
) -> (SteeringDemand, SpeedDemand) {
    if share == 1.0 {
        return (steering, speed);
    }
    let steering = match steering {
        SteeringDemand::Angle(angle) => {
            SteeringDemand::Angle(now.steering + share * (angle - now.steering))
        }
        SteeringDemand::AngleWithin { angle, rate } => SteeringDemand::AngleWithin {
            angle: now.steering + share * (angle - now.steering),
            rate: share * rate,
        },
        SteeringDemand::Rate(rate) => SteeringDemand::Rate(share * rate),
    };
    let speed = match speed {
        SpeedDemand::Speed(speed) | SpeedDemand::RearSpeed(speed) => share * speed,
        SpeedDemand::Acceleration(change) => share * (now.speed + change * period),
    };
    (steering, SpeedDemand::Speed(speed))
}

/// A body that no frame lists for so long is forgotten before a drive, s.
const SILENCE: f64 = 1.0;

/// The car waits for so long after there was no way, s: it must not jerk.
const PAUSE: f64 = 0.5;

/// The other bodies, and how the car waits for them.
#[derive(Clone, Debug, Default)]
pub(super) struct Obstacles {
    /// None if the car does not keep apart from them.
    neighbours: Option<Neighbours>,
    /// What keeps it apart in this tick.
    pub(super) sides: NeighbourSides,
    /// What it must not cross, even if they brake now.
    pub(super) last_sides: NeighbourSides,
    /// How long it still waits after there was no way, s.
    pause: f64,
    /// How long the car has stood before one of them, s.
    stood: f64,
}

impl Obstacles {
    pub(super) fn new(config: Option<&NeighbourConfig>) -> Self {
        Self {
            neighbours: config.map(|config| Neighbours::new(*config)),
            ..Self::default()
        }
    }

    pub(super) fn handle(&mut self, sample: &NeighbourSample) {
        if let Some(neighbours) = &mut self.neighbours {
            neighbours.handle(sample);
        }
    }

    /// A drive begins.
    pub(super) const fn begin(&mut self) {
        (self.pause, self.stood) = (0.0, 0.0);
    }

    /// A tick begins, of a drive or outside one.
    pub(super) fn observe(&mut self, now: Time, estimate: Option<&Estimate>, drives: bool) {
        let Some(neighbours) = &mut self.neighbours else {
            return;
        };
        if !drives {
            neighbours.forget(now, SILENCE);
        }
        let sides = |expected| {
            estimate.map_or_else(NeighbourSides::new, |estimate| {
                neighbours.sides(now, &estimate.position, expected)
            })
        };
        (self.sides, self.last_sides) = (sides(Expected::Worst), sides(Expected::BrakesNow));
    }

    /// Whether one of them may be anywhere.
    pub(super) fn are_unknown(&self) -> bool {
        self.neighbours
            .as_ref()
            .is_some_and(Neighbours::are_unknown)
    }

    /// The share of a period by which the reference waits: what the filter has left out of the wanted
    /// velocity of P (m/s).
    pub(super) fn delay(&self, wanted: &Velocity, given: &Velocity) -> f64 {
        if self.sides.is_empty() {
            return 0.0;
        }
        let share = given.dot(wanted) / wanted.norm_squared();
        // NaN, where nothing is wanted, delays nothing.
        (1.0 - share.clamp(0.0, 1.0)).max(0.0)
    }

    /// Whether the car stands for one of them: while they leave no way, and for a while after.
    pub(super) fn wait(&mut self, no_way: bool, period: f64) -> bool {
        self.pause = if no_way { PAUSE } else { self.pause - period };
        self.pause > 0.0
    }

    /// A tick in which the car stands before one of them, or not. Why the drive ends, if it has
    /// stood there for too long.
    pub(super) fn stand(&mut self, stands: bool, period: f64) -> Option<Reason> {
        let patience = self.neighbours.as_ref()?.config.patience;
        self.stood = if stands { self.stood + period } else { 0.0 };
        (self.stood > patience).then_some(Reason::NeighbourNear)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_share_of_a_demand_turns_as_much_less_and_is_as_much_slower() {
        use SpeedDemand::{Acceleration, RearSpeed, Speed};
        use SteeringDemand::{Angle, AngleWithin, Rate};
        let now = Actuation {
            steering: -0.125,
            speed: 0.75,
            ..Actuation::default()
        };
        let part = |share, steering, speed| part_of(share, (steering, speed), &now, 0.5);
        let whole = (Angle(0.3), Acceleration(2.0));
        assert_eq!(part(1.0, whole.0, whole.1), whole);
        for (share, steering, speed, expected) in [
            (0.25, Angle(0.375), Speed(2.0), (Angle(0.0), Speed(0.5))),
            (0.5, Rate(-3.0), Speed(-1.0), (Rate(-1.5), Speed(-0.5))),
            (0.5, Rate(3.0), Acceleration(2.5), (Rate(1.5), Speed(1.0))),
            (
                0.5,
                AngleWithin {
                    angle: 0.375,
                    rate: 2.0,
                },
                RearSpeed(1.0),
                (
                    AngleWithin {
                        angle: 0.125,
                        rate: 1.0,
                    },
                    Speed(0.5),
                ),
            ),
            (
                0.0,
                Angle(9.0),
                Acceleration(-9.0),
                (Angle(-0.125), Speed(0.0)),
            ),
        ] {
            assert_eq!(part(share, steering, speed), expected, "{share}");
        }
    }
}
