//! Stops of the true car: when one began, and how the car slows down.

use singletrack_pilot::Mode;

use crate::{
    pins::{Effect, Pulse},
    spec::Spec,
};

/// Time from the decision to stop until the car decelerates, in µs, as it is promised: 120 ms
/// to the neutral pulse if the host dies with its last command, and the 0.1 s of reaction
/// that the geofence assumes.
pub(crate) const REACTION_US: u64 = 120_000 + 100_000;

/// A car that is slower stands, in m/s.
pub(crate) const STANDING: f64 = 0.03;

/// A car whose motor is free.
#[derive(Clone, Copy, Debug)]
struct Rolling {
    /// Since the pulse that freed the motor.
    since_us: u64,
    /// Speed and way when it was free; zero until then.
    from: Option<(f64, f64)>,
}

/// A stop: since the host has decided it, or since the board is not armed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Stop {
    pub(crate) began_us: u64,
    /// Highest speed until the reaction time has passed, in m/s.
    pub(crate) speed: f64,
    /// True way since it began, in m.
    pub(crate) way: f64,
    /// Time for which the ESC held the last pulse of a board that gave no more, in µs; at
    /// most the true time of signal loss.
    pub(crate) held_us: u64,
    /// Time that the host's ramp takes from the command to the speed of a car that lags
    /// behind it, in µs.
    lead_us: u64,
    /// Whether the car has stood since.
    pub(crate) stood: bool,
    /// Whether it ended a jog.
    pub(crate) jogged: bool,
    rolling: Option<Rolling>,
    now_us: u64,
    now_speed: f64,
}

impl Stop {
    /// Time after which the car decelerates, in µs.
    pub(crate) const fn reaction_us(&self) -> u64 {
        REACTION_US + self.held_us + self.lead_us
    }

    /// The deceleration that the configuration promises, in m/s²: a stop by the host
    /// commands `control.stop_deceleration_m_s2`.
    pub(crate) const fn promised(spec: &Spec) -> f64 {
        spec.braking.min(spec.stop_deceleration)
    }

    /// The longest way of a car that brakes as configured, in m.
    pub(crate) fn allowed_way(&self, spec: &Spec) -> f64 {
        let reaction = self.reaction_us() as f64 * 1e-6;
        self.speed * reaction + 0.5 * self.speed * self.speed / Self::promised(spec) + WAY_M
    }

    /// The longest time of a car that brakes as configured, in µs. A car whose deceleration
    /// falls with its speed takes longer than `v / a`, but no more than twice as long for
    /// the same way.
    pub(crate) fn allowed_us(&self, spec: &Spec) -> u64 {
        let braking_us = 2e6 * self.speed / Self::promised(spec);
        self.reaction_us() + braking_us as u64 + TIME_US
    }

    /// The mean deceleration since the motor was free, in m/s², and the speed from which;
    /// `None` while it is not, or before 2 cm of way.
    pub(crate) fn deceleration(&self) -> Option<(f64, f64)> {
        let (speed, way) = self.rolling?.from?;
        let rolled = self.way - way;
        let lost = speed * speed - self.now_speed * self.now_speed;
        (rolled > 0.02).then(|| (0.5 * lost / rolled, speed))
    }

    /// How long the motor has been free, in µs.
    pub(crate) fn free_us(&self) -> u64 {
        match self.rolling {
            Some(Rolling { since_us, from }) if from.is_some() => self.now_us - since_us,
            _ => 0,
        }
    }

    /// Whether the car brakes less than configured although its motor is free.
    ///
    /// It must brake: a car that has hardly slowed down when board and host must have
    /// noticed is not weak, its motor drives. They notice after the longest roll-out and
    /// half a second; the ESC may then hold its last pulse for the true time of signal
    /// loss.
    pub(crate) fn is_weak(&self, spec: &Spec) -> bool {
        let noticed_us = spec.max_roll_out_us + NOTICED_US + spec.true_signal_loss_us;
        let may_keep_its_speed = self.now_us <= self.began_us + self.held_us + noticed_us;
        self.deceleration().is_some_and(|(deceleration, _)| {
            deceleration < spec.braking
                && (may_keep_its_speed || deceleration >= LEAST_SHARE * spec.braking)
        })
    }
}

/// Time in which a board or a host notices that the wheels do not come to rest, in µs.
const NOTICED_US: u64 = 500_000;

/// The share of the configured deceleration below which a stop is not obeyed.
pub(crate) const LEAST_SHARE: f64 = 0.15;

/// Tolerances of way and time: the noise of the speed when the stop begins.
const WAY_M: f64 = 0.05;
const TIME_US: u64 = 200_000;

/// What happened in a step.
pub(crate) struct Step<'a> {
    pub(crate) now_us: u64,
    pub(crate) spec: &'a Spec,
    pub(crate) speed: f64,
    pub(crate) position: [f64; 2],
    pub(crate) pulses: &'a [Pulse],
    /// Whether the running board is armed, by its telemetry.
    pub(crate) board_is_armed: bool,
    /// Whether the board was last given pulses of a jog.
    pub(crate) jogs: bool,
    /// Whether somebody moves the car: no stop is judged then.
    pub(crate) moved_by_hand: bool,
    /// Mode after a tick in this step.
    pub(crate) mode: Option<Mode>,
    /// The speed that the tick commanded, in m/s.
    pub(crate) commanded: f64,
}

/// Follows the stops.
#[derive(Debug, Default)]
pub(crate) struct Stops {
    stop: Option<Stop>,
    mode: Option<Mode>,
    position: Option<[f64; 2]>,
    /// The last pulse, and whether the ESC was left with one that drives.
    last_pulse_us: u64,
    last_drives: bool,
    /// Driven while armed, since the present drive began.
    driven: bool,
}

impl Stops {
    pub(crate) const fn stop(&self) -> Option<&Stop> {
        self.stop.as_ref()
    }

    pub(crate) fn step(&mut self, step: &Step<'_>) {
        let now_us = step.now_us;
        let [x, y] = step.position;
        let [last_x, last_y] = self.position.replace(step.position).unwrap_or([x, y]);
        if let Some(stop) = &mut self.stop {
            stop.way += libm::hypot(x - last_x, y - last_y);
            stop.now_us = now_us;
            stop.now_speed = step.speed.abs();
        }
        if let Some(mode) = step.mode {
            let before = self.mode.replace(mode);
            let drives = |mode| matches!(mode, Some(Mode::Driving | Mode::Slowing | Mode::Jogging));
            if drives(Some(mode)) && before == Some(Mode::Arming) {
                self.stop = None;
                self.driven = false;
            } else if drives(before) && !drives(Some(mode)) {
                let lead = (step.commanded - step.speed.abs()) / step.spec.stop_deceleration;
                self.begin(step, (1e6 * lead.max(0.0)) as u64);
            }
        }
        for pulse in step.pulses {
            let released = match pulse.effect {
                // The ESC holds what it had; it takes no pulse that a reset cut short.
                Effect::Absent => !self.last_drives,
                Effect::Neutral if pulse.cut => !self.last_drives,
                _ => {
                    self.last_pulse_us = pulse.time_us;
                    self.last_drives = pulse.drives_on(step.spec);
                    pulse.releases(step.spec)
                }
            };
            self.driven |= pulse.drives() && step.board_is_armed;
            if let Some(stop) = &mut self.stop {
                if released {
                    stop.rolling.get_or_insert(Rolling {
                        since_us: pulse.time_us,
                        from: None,
                    });
                } else {
                    stop.rolling = None;
                }
            }
        }
        // A slowing car that stands may drive on, as long as the board is armed.
        if self.driven && !step.board_is_armed {
            self.begin(step, 0);
        }
        if step.moved_by_hand {
            self.stop = None;
            self.driven = false;
        }
        let Some(stop) = &mut self.stop else { return };
        if self.last_drives {
            // Beyond a servo period there is no pulse.
            let silent_us = now_us.saturating_sub(self.last_pulse_us.max(stop.began_us));
            let loss_us = step.spec.true_signal_loss_us;
            if silent_us > 25_000 {
                stop.held_us = stop.held_us.max(silent_us.min(loss_us));
            }
            if silent_us > loss_us {
                stop.rolling.get_or_insert(Rolling {
                    since_us: now_us,
                    from: None,
                });
            }
        }
        let speed = step.speed.abs();
        if now_us <= stop.began_us + stop.reaction_us() {
            stop.speed = stop.speed.max(speed);
        }
        if let Some(rolling) = &mut stop.rolling
            && rolling.from.is_none()
            && now_us >= rolling.since_us + step.spec.true_release_us
        {
            rolling.from = Some((speed, stop.way));
        }
        stop.stood |= speed < STANDING && now_us > stop.began_us + step.spec.true_release_us;
    }

    fn begin(&mut self, step: &Step<'_>, lead_us: u64) {
        let speed = step.speed.abs();
        self.stop.get_or_insert(Stop {
            began_us: step.now_us,
            speed,
            way: 0.0,
            held_us: 0,
            lead_us,
            stood: false,
            jogged: step.jogs,
            rolling: None,
            now_us: step.now_us,
            now_speed: speed,
        });
    }
}
