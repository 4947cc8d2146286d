//! The true car stands after every stop, or is not armed again.

use singletrack_pilot::{Mode, Reason};
use singletrack_protocol::BoardMode;

use super::{Invariant, SERVO_US, Verdict};
use crate::{
    observation::Observation,
    pins::START_PULSE_US,
    schedule::{Fault, FaultKind},
    stop::{LEAST_SHARE, STANDING, Stop},
};

/// `stands`: after a stop the true car stands within the time and the way that the
/// configuration promises: a reaction time, then `fence.braking_m_s2`. (See
/// [`Stop::allowed_way`].) The ESC of a dead board holds the last pulse for its true time
/// of signal loss, which is added.
///
/// A car whose motor is free and that brakes less than configured may take longer: what
/// follows from that is the subject of `weak-brakes` and `stop-not-obeyed`. One that keeps
/// its speed may not: see [`Stop::is_weak`]. An ESC whose throttle is stuck is stopped by a
/// kill output once the host has noticed it. A board that restarts gives the start pulse,
/// which drives a car whose neutral is another one: see `unarmed-motion`.
#[derive(Default)]
pub(super) struct Stands;

/// Time between the restart of a board and its first telemetry, in µs.
const RESETS_US: u64 = 20_000;

/// Time in which the host notices that a stop is not obeyed, in µs.
const KILLED_US: u64 = 1_000_000;

impl Invariant for Stands {
    fn name(&self) -> &'static str {
        "stands"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        let Some(stop) = observation.stop.filter(|stop| !stop.stood) else {
            return Ok(());
        };
        let spec = observation.spec;
        let esc = &spec.board.esc;
        let restarted = observation
            .board_since_us
            .is_none_or(|us| us + RESETS_US >= stop.began_us);
        if restarted && esc.neutral_us != START_PULSE_US {
            return Ok(());
        }
        let after_us = observation.now_us - stop.began_us;
        let (mut allowed_way, mut allowed_us) = (stop.allowed_way(spec), stop.allowed_us(spec));
        if observation.is_active(FaultKind::EscStuck) {
            if !spec.situation.kill_output {
                // Nothing stops it: see `stop-not-obeyed`.
                return Ok(());
            }
            allowed_way += stop.speed * KILLED_US as f64 * 1e-6;
            allowed_us += KILLED_US;
        }
        if (stop.way <= allowed_way && after_us <= allowed_us) || stop.is_weak(spec) {
            return Ok(());
        }
        Err(format!(
            "{:.2} m/s {} ms and {:.3} m after a stop from {:.2} m/s, {} ms and {allowed_way:.3} m allowed",
            observation.truth.speed,
            after_us / 1_000,
            stop.way,
            stop.speed,
            allowed_us / 1_000,
        ))
    }
}

/// `weak-brakes`: a car that has braked clearly less than configured in one stop, or less
/// than configured in two, does not drive again under that configuration.
///
/// Stops with a fault, a false pose or a restart of daemon or board do not count: the
/// host may not have seen them.
#[derive(Default)]
pub(super) struct WeakBrakes {
    judged_us: u64,
    daemon_since_us: Option<u64>,
    board_since_us: Option<u64>,
    disturbed: bool,
    clear: u32,
    doubtful: u32,
}

/// Lowest speed of a stop that counts, in m/s, and its least way, in m.
const COUNTS_FROM: f64 = 0.3;
const COUNTS_WAY: f64 = 0.1;

/// Shares of the configured deceleration below which a stop is weak: clearly, or maybe by
/// an error of the measurement.
const CLEARLY: f64 = 0.5;
const MAYBE: f64 = 0.75;

impl WeakBrakes {
    fn is_disturbed(observation: &Observation<'_>) -> bool {
        observation.is_blinded()
            || observation
                .newest_pose
                .is_none_or(|pose| pose.exposure.falsified)
    }

    fn judge(&mut self, stop: &Stop, observation: &Observation<'_>) {
        let Some((deceleration, speed)) = stop.deceleration() else {
            return;
        };
        // The wheels of a jog may be off the floor: the host measures nothing by them.
        if self.disturbed || stop.jogged || speed < COUNTS_FROM || stop.way < COUNTS_WAY {
            return;
        }
        let share = deceleration / observation.spec.braking;
        self.clear += u32::from(share < CLEARLY);
        self.doubtful += u32::from(share < MAYBE);
    }
}

impl Invariant for WeakBrakes {
    fn name(&self) -> &'static str {
        "weak-brakes"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        let restarted = observation.daemon_since_us != self.daemon_since_us
            || observation.board_since_us != self.board_since_us;
        if restarted || observation.configuration.is_some() {
            *self = Self {
                judged_us: self.judged_us,
                daemon_since_us: observation.daemon_since_us,
                board_since_us: observation.board_since_us,
                disturbed: true,
                ..Self::default()
            };
        }
        match observation.stop {
            Some(stop) if stop.began_us > self.judged_us => {
                self.disturbed |= Self::is_disturbed(observation);
                if stop.stood {
                    self.judge(stop, observation);
                    self.judged_us = stop.began_us;
                }
            }
            _ => self.disturbed = Self::is_disturbed(observation),
        }
        let drives = observation
            .tick
            .is_some_and(|tick| tick.output.mode == Mode::Driving);
        if drives && observation.stop.is_none() && (self.clear >= 1 || self.doubtful >= 2) {
            return Err(format!(
                "driving after {} stops with less than {} m/s², {} of them clearly",
                self.doubtful, observation.spec.braking, self.clear
            ));
        }
        Ok(())
    }
}

/// `stop-not-obeyed`: a car whose speed does not fall after neutral is a fault that the
/// host declares within a second and a half.
///
/// Only where the host can see it: no other fault, no false pose, and not by a daemon that
/// was started after the stop.
#[derive(Default)]
pub(super) struct StopNotObeyed {
    since_us: Option<u64>,
}

/// A car that has kept this share of its speed for this time does not slow down, in µs.
const KEPT: f64 = 0.9;
const KEPT_US: u64 = 1_000_000;
const DECLARED_US: u64 = 500_000;

/// The tolerance of the host's measurement of a speed, in m/s: a low configured deceleration
/// takes as much longer to show.
const SPEED_TOLERANCE: f64 = 0.03;

impl Invariant for StopNotObeyed {
    fn name(&self) -> &'static str {
        "stop-not-obeyed"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        let speed = observation.truth.speed.abs();
        let keeps = observation.stop.is_some_and(|stop| {
            observation.daemon_since_us < Some(stop.began_us)
                && !stop.stood
                && stop.free_us() > KEPT_US
                && stop
                    .deceleration()
                    .is_some_and(|(_, from)| from > COUNTS_FROM && speed > KEPT * from)
        });
        if !keeps || WeakBrakes::is_disturbed(observation) {
            self.since_us = None;
            return Ok(());
        }
        let since_us = *self.since_us.get_or_insert(observation.now_us);
        let is_fault = observation.tick.is_none_or(|tick| {
            let output = &tick.output;
            // Acknowledged; the board is silent and there is nothing left to do.
            let latched = observation.board_mode == Some(BoardMode::EmergencyStopped)
                && output.reason == Some(Reason::EmergencyStop);
            let declared = matches!(
                output.reason,
                Some(Reason::StopNotObeyed | Reason::EmergencyStop | Reason::RunsAtNeutral)
            );
            latched || (output.mode == Mode::Fault && declared)
        });
        let least = LEAST_SHARE * observation.spec.braking;
        let shows_us = (1e6 * SPEED_TOLERANCE / least) as u64;
        if is_fault || observation.now_us < since_us + DECLARED_US + shows_us {
            return Ok(());
        }
        Err(format!("{speed:.2} m/s, and the host declares no fault"))
    }
}

/// `unarmed-motion`: while the board is not armed, the true car is driven no longer than a
/// roll-out (3 s at most), half a second to notice it and the true time of signal loss. From
/// then on it slows down.
///
/// It may brake less than configured, as after any stop, but by no less than
/// [`LEAST_SHARE`]: what drives it is not its momentum then.
///
/// A car that has not stood since its last stop is judged by `stands`. Without a motor
/// sensor the board can't notice anything, a reset makes it begin again, as do wheels that are
/// so slow that they stand by its pulses, and half a metre by its configured pulse distance, with
/// a sensor that loses every second pulse a metre, counts as nothing. An ESC whose throttle is
/// stuck is stopped by a kill output alone.
#[derive(Default)]
pub(super) struct UnarmedMotion {
    since_us: Option<u64>,
    last_us: u64,
    /// The way that the sensor shows, in m.
    way: f64,
    /// When that was enough for the board.
    told_us: Option<u64>,
    /// When the motor must be free, and the speed at that time.
    free: Option<(u64, f64)>,
    board_since_us: Option<u64>,
}

/// Way by which a board tells wheels that turn from interference, with a tenth of tolerance,
/// in m.
const TOLD_APART_M: f64 = 0.55;

/// The speed in m/s below which wheels stand, as far as a board can tell whose pulses come at every pulse
/// distance (µm): one in 150 ms, or in 20 ms for each millimetre; and a fifth of tolerance.
fn creeping(pulse_distance_um: u16) -> f64 {
    let distance_um = f64::from(pulse_distance_um);
    let standstill_us = f64::max(150_000.0, 20.0 * distance_um);
    STANDING.max(1.2 * distance_um / standstill_us)
}

const NOTICED_US: u64 = 500_000;

/// Tolerance of a speed that must fall, in m/s.
const SLOWS_LATE: f64 = 0.03;

/// A car that stood is given no longer roll-out than this, in µs.
const FROM_STANDSTILL_US: u64 = 3_000_000;

impl Invariant for UnarmedMotion {
    fn name(&self) -> &'static str {
        "unarmed-motion"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        let spec = observation.spec;
        let speed = observation.truth.wheel_speed.abs();
        let stopping = observation.stop.is_some_and(|stop| !stop.stood);
        let is_halved = observation.is_effective(FaultKind::PulsesHalved);
        let is_sparse = is_halved || observation.is_effective(FaultKind::PulsesErratic);
        // Between two pulses, in configured pulse distances.
        let longest_gap = spec.true_pulse_share.max(1.0) * if is_sparse { 2.0 } else { 1.0 };
        let elapsed_us =
            observation.now_us - core::mem::replace(&mut self.last_us, observation.now_us);
        let restarted = core::mem::replace(&mut self.board_since_us, observation.board_since_us)
            != observation.board_since_us;
        if observation.board_is_armed
            || restarted
            || observation.is_without_motor_pulses()
            || stopping
            || observation.is_unstoppable()
            || speed < creeping(spec.board.speed.pulse_distance_um) * longest_gap
            || observation.is_moved_by_hand()
        {
            *self = Self {
                last_us: self.last_us,
                board_since_us: self.board_since_us,
                ..Self::default()
            };
            return Ok(());
        }
        let shown = if is_halved { 0.5 } else { 1.0 };
        self.way += shown * speed * elapsed_us as f64 * 1e-6;
        let since_us = *self.since_us.get_or_insert(observation.now_us);
        let after_us = observation.now_us - since_us;
        if self.way > TOLD_APART_M * spec.true_pulse_share.max(1.0) {
            self.told_us.get_or_insert(observation.now_us);
        }
        let told_after_us = self.told_us.map_or(u64::MAX, |told_us| told_us - since_us);
        let rolled_us = spec.max_roll_out_us.min(FROM_STANDSTILL_US);
        let noticed_us = rolled_us.max(told_after_us);
        let limit_us = noticed_us
            .saturating_add(NOTICED_US)
            .saturating_add(spec.true_signal_loss_us);
        if after_us <= limit_us {
            return Ok(());
        }
        let (free_us, from) = *self.free.get_or_insert((observation.now_us, speed));
        let rolls_s = (observation.now_us - free_us) as f64 * 1e-6;
        let allowed = from - LEAST_SHARE * spec.braking * rolls_s + SLOWS_LATE;
        if speed <= allowed {
            return Ok(());
        }
        Err(format!(
            "{speed:.2} m/s after {} ms while not armed, driven for {} ms at most, {allowed:.2} m/s allowed",
            after_us / 1_000,
            limit_us / 1_000
        ))
    }
}

/// `arming-motion`: while the board powers up or is armed, and has not been commanded to
/// drive yet, the wheels turn for half a second at most: the host notices it and disarms.
///
/// Only where the host can see it, and not where somebody moves the car. An ESC whose
/// throttle is stuck is stopped by a kill output alone.
#[derive(Default)]
pub(super) struct ArmingMotion {
    since_us: Option<u64>,
}

/// Slower wheels may stand, as far as a coarse motor sensor shows, in m/s.
const TURNING: f64 = 0.15;

impl Invariant for ArmingMotion {
    fn name(&self) -> &'static str {
        "arming-motion"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        let waits = matches!(
            observation.board_mode,
            Some(BoardMode::PoweringUp | BoardMode::Armed)
        );
        let speed = observation.truth.wheel_speed.abs();
        if !(observation.board_is_armed && waits)
            || speed < TURNING
            || observation.is_unstoppable()
            || observation.is_moved_by_hand()
            || observation.is_blinded()
        {
            self.since_us = None;
            return Ok(());
        }
        let since_us = *self.since_us.get_or_insert(observation.now_us);
        let after_us = observation.now_us - since_us;
        if after_us <= NOTICED_US {
            return Ok(());
        }
        Err(format!(
            "{:.2} m/s for {} ms without a command, while the board arms",
            observation.truth.wheel_speed,
            after_us / 1_000
        ))
    }
}

/// `backward`: while reverse is disabled, the true car moves backward no farther than it
/// takes to notice that the motor turns the wrong way: half a metre and the roll-out from
/// there, or 0.25 m if it began with a pulse below neutral, which no car has asked for. A car
/// that runs while the board is not armed is the subject of `unarmed-motion`; an operator who jogs
/// may ask for reverse. An ESC whose throttle
/// is stuck in reverse is stopped by a kill output alone.
#[derive(Default)]
pub(super) struct Backward {
    way: f64,
    fastest: f64,
    by_brake: bool,
    braked_us: u64,
    /// The throttle got stuck while a pulse below neutral acted.
    stuck_in_reverse: bool,
    position: Option<[f64; 2]>,
}

const BACKWARD_M: f64 = 0.5;
const BACKWARD_BY_BRAKE_M: f64 = 0.25;
/// Time in which a pulse below neutral still acts, in µs.
const BRAKE_ACTS_US: u64 = 100_000;

impl Invariant for Backward {
    fn name(&self) -> &'static str {
        "backward"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        let spec = observation.spec;
        let esc = &spec.board.esc;
        for pulse in observation.pulses {
            if pulse.esc_us != 0 && pulse.esc_us < esc.neutral_us - esc.deadband_us {
                self.braked_us = pulse.time_us;
            }
        }
        let sticks = |fault: &Fault| fault.kind == FaultKind::EscStuck;
        if observation.new_faults.iter().any(sticks) && self.braked_us > 0 {
            let acts_us = spec.true_release_us + SERVO_US;
            self.stuck_in_reverse |= observation.now_us <= self.braked_us + acts_us;
        }
        let truth = &observation.truth;
        let [last_x, last_y] = self
            .position
            .replace([truth.x, truth.y])
            .unwrap_or([truth.x, truth.y]);
        let may_reverse = spec.board.speed.max_reverse_mm_s != 0;
        if truth.speed > -STANDING
            || may_reverse
            || observation.jogs
            || observation.is_moved_by_hand()
            || (observation.is_unstoppable() && self.stuck_in_reverse)
        {
            self.way = 0.0;
            self.fastest = 0.0;
            return Ok(());
        }
        if self.way == 0.0 {
            self.by_brake =
                self.braked_us > 0 && observation.now_us < self.braked_us + BRAKE_ACTS_US;
        }
        if !self.by_brake && !observation.board_is_armed {
            return Ok(());
        }
        self.way += libm::hypot(truth.x - last_x, truth.y - last_y);
        self.fastest = self.fastest.max(-truth.speed);
        let noticed = if self.by_brake {
            BACKWARD_BY_BRAKE_M
        } else {
            BACKWARD_M
        };
        let rolls = 0.5 * self.fastest * self.fastest / spec.braking + 0.27 * self.fastest;
        if self.way <= noticed + rolls {
            return Ok(());
        }
        Err(format!(
            "{:.2} m backward at {:.2} m/s, {:.2} allowed",
            self.way,
            truth.speed,
            noticed + rolls
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{observation::scene::Scene, schedule::FaultTarget};

    /// Whether a car is found that rolls 2 m backward while its throttle is stuck, which was given this pulse
    /// when it got stuck.
    fn is_found(esc_us: u16) -> bool {
        let stuck = [Fault {
            kind: FaultKind::EscStuck,
            at_ms: 5_000,
            for_ms: 1,
            severity: 1,
        }];
        assert_eq!(stuck[0].kind.target(), FaultTarget::Car);
        let mut scene = Scene::new();
        scene.pulses[0].record.esc_us = esc_us;
        scene.truth.speed = -0.5;
        let mut invariant = Backward::default();
        (0..400).any(|step| {
            scene.truth.x = -0.005 * f64::from(step);
            let mut observation = scene.observation(0);
            observation.faults = &stuck;
            observation.new_faults = if step == 0 { &stuck } else { &[] };
            observation.now_us += u64::try_from(step).unwrap_or(0) * 10_000;
            if step > 0 {
                observation.pulses = &[];
            }
            invariant.check(&observation).is_err()
        })
    }

    #[test]
    fn only_a_throttle_that_got_stuck_in_reverse_excuses_a_car_that_goes_backward() {
        assert!(!is_found(1_350));
        assert!(is_found(1_600));
        assert!(is_found(1_500));
    }

    #[test]
    fn a_board_with_fine_pulses_can_tell_that_a_car_creeps() {
        for (pulse_distance_um, speed) in [
            (3_000, 0.03),
            (6_000, 0.048),
            (10_000, 0.06),
            (30_000, 0.06),
        ] {
            let found = creeping(pulse_distance_um);
            assert!((found - speed).abs() < 1e-9, "{pulse_distance_um}: {found}");
        }
    }
}
