//! What a drive is checked by: all that a step did is one observation, which every invariant sees.

use core::ops::AddAssign;
use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};
use singletrack_pilot::{Filtering, Mode, Output, Reason};
use singletrack_protocol::{BoardMode, ToBoard};
use singletrack_record::TickRecord;

use super::{Buffers, Drive, LOOK_US};
use crate::{
    SetupError, invariant,
    observation::Observation,
    spec::Spec,
    stop::{STANDING, Step},
    tamper::Tamper,
};

/// The result of a drive.
#[derive(Clone, Debug, PartialEq)]
pub struct DriveOutcome {
    /// A hash of all events of the drive: the same for the same schedule.
    pub digest: u64,
    /// The first violation, if there was one.
    pub violation: Option<Violation>,
    /// The violated invariants: more than one only if the drive went on.
    pub violated: BTreeSet<&'static str>,
    /// How long the motor was driven, in ms.
    pub driven_ms: u32,
    /// The names of the reasons for which the host did not drive.
    pub reasons: BTreeSet<&'static str>,
    /// What the safety filter did.
    pub filter: FilterTicks,
}

/// Numbers of ticks that followed an outer loop with the safety filter on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FilterTicks {
    /// All of them.
    pub driving: u64,
    /// Those in which it limited the velocity of P.
    pub limited: u64,
    /// Those in which it scaled what was wanted.
    pub scaled: u64,
    /// Those in which it slowed the car down.
    pub stopped: u64,
    /// Drives that ended because the car came to stand by it.
    pub cornered: u64,
    /// Drives that the supervisor's geofence ended.
    pub fenced: u64,
}

impl FilterTicks {
    /// Counts a tick; `last` is what the filter did in the tick before, if that drove.
    fn count(&mut self, output: &Output, last: Option<Filtering>) {
        if output.mode == Mode::Driving {
            self.driving += 1;
            match output.filtering {
                Filtering::None => {}
                Filtering::Limited => self.limited += 1,
                Filtering::Scaled => self.scaled += 1,
                Filtering::Stopped | Filtering::Yielded => self.stopped += 1,
            }
        } else if output.mode == Mode::Stopping && output.reason == Some(Reason::OutsideFence) {
            match last {
                None => {}
                Some(Filtering::Stopped) => self.cornered += 1,
                Some(_) => self.fenced += 1,
            }
        }
    }
}

impl AddAssign for FilterTicks {
    fn add_assign(&mut self, other: Self) {
        self.driving += other.driving;
        self.limited += other.limited;
        self.scaled += other.scaled;
        self.stopped += other.stopped;
        self.cornered += other.cornered;
        self.fenced += other.fenced;
    }
}

/// A violation of an invariant.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Violation {
    /// The invariant's name.
    pub invariant: &'static str,
    /// When, in µs of the simulation.
    pub time_us: u64,
    /// What the invariant found.
    pub details: String,
}

/// Where a drive ends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Until {
    /// At the first violation.
    #[default]
    Violation,
    /// At the end of its schedule; an invariant is no longer checked once it is violated.
    End,
}

impl Drive<'_> {
    /// Checks every invariant.
    pub(super) fn watch(
        &mut self,
        has_read: bool,
        mut tick: Option<TickRecord>,
        tamper: &mut dyn Tamper,
    ) -> Result<(), SetupError> {
        let now_us = self.now_us;
        let mut configuration = None;
        if let Some((number, mut config)) = self.changed.take() {
            tamper.configuration(number, &mut config);
            let world = &self.world.config;
            self.spec = Spec::new(self.schedule, world, &config).map_err(SetupError::Config)?;
            let toml = config.to_toml().map_err(|error| SetupError::Other {
                part: "the daemon's configuration",
                reason: error.to_string(),
            })?;
            self.is_proved = self.schedule.situation.proved || self.proved.contains(&toml);
            self.toml = toml;
            let pilot = config.pilot().map_err(SetupError::Config)?;
            configuration = Some((number, pilot));
        }
        self.write(tamper);
        let is_held = self.is_held();
        let Buffers {
            heard,
            pulses,
            written,
            ..
        } = &mut self.buffers;
        let board = &mut self.world.board;
        heard.clear();
        heard.extend(core::iter::from_fn(|| board.next_received()));
        let is_running = board.is_running();
        if board.resets != self.resets || is_running != self.was_running {
            self.resets = board.resets;
            self.was_running = is_running;
            self.board_since_us = is_running.then_some(now_us);
            self.jogs = false;
            self.bites_us = self.bites_us.filter(|_| is_running);
        }
        for received in &*heard {
            match received.message {
                ToBoard::Jog(_) => self.jogs = true,
                ToBoard::Arm(_) | ToBoard::Drive(_) => self.jogs = false,
                _ => {}
            }
        }
        let log = &board.pulses;
        let new = log.total - self.pulses;
        self.pulses = log.total;
        pulses.clear();
        // Oldest first.
        let newest = || log.iter().rev().take(new as usize);
        for index in (0..newest().count()).rev() {
            let record = newest().nth(index);
            pulses.extend(record.map(|record| self.pins.observe(&self.spec, *record, self.jogs)));
        }
        if let Some(tick) = &mut tick {
            tamper.tick(tick);
            if let Some(learned) = &mut self.learned {
                tamper.learned(tick.index, learned);
            }
        }
        let truth = self.world.truth();
        let telemetry = self.world.board.telemetry();
        let board_mode = telemetry.map(|record| record.mode);
        let board_cause = telemetry.map(|record| record.stop_cause);
        let board_is_armed = is_running
            && matches!(
                board_mode,
                Some(
                    BoardMode::PoweringUp
                        | BoardMode::Armed
                        | BoardMode::Driving
                        | BoardMode::Jogging
                )
            );
        let is_pushed = self.pushes.iter().any(|fault| {
            let [from, to] = [fault.at_ms, fault.end_ms()].map(|ms| u64::from(ms) * 1_000);
            let rolls_us = (2e6 / self.spec.braking) as u64;
            if !(from..to + rolls_us + 500_000).contains(&now_us) {
                return false;
            }
            // A blow acts within the step.
            self.is_pushed |= now_us <= to + LOOK_US;
            self.is_pushed &= now_us <= to + LOOK_US || truth.speed.abs() >= STANDING;
            self.is_pushed
        });
        let moved_by_hand = is_held || is_pushed;
        let tick_mode = tick.as_ref().map(|tick| tick.output.mode);
        if tick_mode == Some(Mode::Arming) {
            self.armed_at_m = truth.way;
        }
        let way_since_arm = truth.way - self.armed_at_m;
        self.stops.step(&Step {
            now_us,
            spec: &self.spec,
            speed: truth.speed,
            position: [truth.x, truth.y],
            pulses,
            board_is_armed,
            jogs: self.jogs,
            moved_by_hand,
            mode: tick_mode,
            commanded: tick
                .as_ref()
                .map_or(0.0, |tick| tick.output.actuation.speed.abs()),
        });
        let observation = Observation {
            now_us,
            spec: &self.spec,
            truth,
            pulses,
            stop: self.stops.stop(),
            board_received: heard,
            board_since_us: self.board_since_us,
            board_mode,
            board_cause,
            board_is_armed,
            is_proved: self.is_proved,
            jogs: self.jogs,
            renewed: self.operator.renewed(),
            way_since_arm,
            esc_has_power: self.world.car.esc_has_power(),
            moved_by_hand,
            tick: tick.as_ref(),
            is_replayed: tamper.is_replayed(),
            written,
            has_read,
            daemon_since_us: self.daemon_since_us,
            newest_pose: self.newest_pose,
            faults: &self.faults,
            new_faults: &self.new_faults,
            pending_requests: &self.pending_requests,
            configuration: configuration.as_ref(),
            newest_setpoint_ns: self.newest_setpoint_ns,
            learned: self.learned,
        };
        let has_ticked = observation.tick.is_some();
        if let Some(tick) = observation.tick {
            self.reason = tick.output.reason;
            self.reasons.extend(self.reason.map(Reason::name));
        }
        if let Some(tick) = observation.tick
            && self.schedule.situation.safety_filter
        {
            let output = &tick.output;
            let drives = output.mode == Mode::Driving;
            let last = drives.then_some(output.filtering);
            let last = core::mem::replace(&mut self.filtering, last);
            self.filter.count(output, last);
        }
        self.digest.add(&observation);
        for pulse in observation.pulses {
            self.driven_ms += 20 * u32::from(pulse.drives());
        }
        let (first, violated) = (&mut self.violation, &mut self.violated);
        self.invariants
            .retain_mut(|invariant| match invariant.check(&observation) {
                Ok(()) => true,
                Err(details) => {
                    violated.insert(invariant.name());
                    first.get_or_insert(Violation {
                        invariant: invariant.name(),
                        time_us: now_us,
                        details,
                    });
                    false
                }
            });
        if let Some(tick) = &tick {
            self.note_proof(tick, way_since_arm);
        }
        if has_ticked {
            self.pending_requests.clear();
        }
        Ok(())
    }

    /// A proof counts from the next tick on, if the car has driven far enough for it (see
    /// `false-proof`). A contradiction revokes it.
    fn note_proof(&mut self, tick: &TickRecord, way_since_arm: f64) {
        let output = &tick.output;
        if output.proved && way_since_arm >= invariant::METRE {
            self.is_proved = true;
            self.proved.insert(self.toml.clone());
        }
        let drives = matches!(output.mode, Mode::Driving | Mode::Slowing);
        let ends = core::mem::replace(&mut self.was_driving, drives) && !drives;
        let contradicts = ends && output.reason.is_some_and(invariant::is_contradiction);
        if contradicts || output.disproved {
            self.proved.remove(&self.toml);
            self.is_proved = self.schedule.situation.proved;
        }
    }

    /// Passes the bytes that the daemon wrote to the line.
    fn write(&mut self, tamper: &mut dyn Tamper) {
        let Buffers { bytes, written, .. } = &mut self.buffers;
        bytes.clear();
        written.clear();
        self.port.take_written(bytes);
        tamper.written(self.now_us, bytes);
        for &byte in &*bytes {
            if let Some(Ok(packet)) = self.written.push(byte)
                && let Ok(message) = ToBoard::decode(packet)
            {
                written.push(message);
            }
        }
        tamper.to_board(self.now_us, bytes);
        if !bytes.is_empty() {
            self.world.host_write(bytes);
        }
    }
}
