//! Several cars on one floor: random circles, random faults of cars and of what their neighbours see
//! of them. No two cars may touch.

use std::{
    collections::BTreeSet,
    f64::consts::{FRAC_PI_2, TAU},
    panic::{self, AssertUnwindSafe},
    path::PathBuf,
};

use serde::{Deserialize, Serialize};
use singletrack_campaign::Experiment;
use singletrack_core::config::{ReferenceSection, Start};
use singletrack_pilot::{Arming, Filtering, Mode, PilotRequest, Reason};
use singletrack_scenario::{
    simulated::{Drive, daemon_config},
    virtual_drive::VirtualDriveError,
    virtual_fleet::{FleetCar, Sight, VirtualFleet},
};
use singletrack_sim::{LossKind, StartPose};

use crate::{
    SetupError,
    campaign::message,
    random::{Random, Stream},
};

/// How long the cars drive, in ms.
const DRIVE_MS: u32 = 15_000;
/// Two cars start this far apart at least, in m: none is in another one's way.
const APART_M: f64 = 1.2;
/// How often a start is drawn before the cars are moved apart.
const DRAWS: usize = 100;

/// The schedules to run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FleetCampaign {
    /// First seed; the others follow consecutively.
    pub first_seed: u64,
    /// Number of seeds.
    pub count: u64,
    /// Number of cars.
    pub cars: usize,
}

/// A bug of all cars, to see that it is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FleetBug {
    /// They do not look at each other.
    Blind,
    /// They keep apart by less than their lengths, and trust each other's brakes.
    Touching,
}

impl FleetBug {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::Blind, Self::Touching];
}

/// What became of a schedule.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FleetOutcome {
    /// The seed of the schedule.
    pub seed: u64,
    /// The least distance between two cars, in m.
    pub nearest_m: f64,
    /// For how long cars drove, in ms, added up.
    pub driven_ms: u64,
    /// For how long they yielded, in ms.
    pub yielded_ms: u64,
    /// The names of the reasons for which a car did not drive.
    pub reasons: BTreeSet<String>,
    /// What was violated: the cars touched, or a part has panicked.
    pub failure: Option<String>,
}

#[derive(Clone, Copy, Debug)]
enum Fault {
    /// The cameras lose the car, for all.
    Lost,
    /// The others do not see it.
    Hidden,
    /// The others see where it was.
    Frozen,
    /// It hears nothing of the cameras.
    Deaf,
    /// Its USB cable is pulled, which takes the power along.
    Unplugged,
    /// Its board has no power.
    Unpowered,
    /// It is disarmed, and armed again at the end.
    Disarmed,
    /// Its pose jumps.
    Jumps,
    /// Its cameras take it for another car, and that one for it.
    Swapped,
}

const FAULTS: [Fault; 8] = [
    Fault::Hidden,
    Fault::Frozen,
    Fault::Deaf,
    Fault::Unplugged,
    Fault::Unpowered,
    Fault::Disarmed,
    Fault::Jumps,
    Fault::Swapped,
];

impl Experiment for FleetCampaign {
    const NAME: &'static str = "fleet-faults";
    type Result = FleetOutcome;

    fn units(&self) -> u64 {
        self.count
    }

    fn files(&self) -> Vec<PathBuf> {
        Vec::new()
    }

    fn run(&self, unit: u64) -> singletrack_campaign::Result<FleetOutcome> {
        Ok(drive_fleet(
            self.first_seed.wrapping_add(unit),
            self.cars,
            None,
        )?)
    }
}

/// Runs the schedule of a seed, with a bug or without.
///
/// # Errors
///
/// The cars can't be set up, or do not start.
pub fn drive_fleet(
    seed: u64,
    cars: usize,
    bug: Option<FleetBug>,
) -> Result<FleetOutcome, SetupError> {
    let drive = || attempt(seed, cars, bug);
    match panic::catch_unwind(AssertUnwindSafe(drive)) {
        Ok(outcome) => outcome.map_err(|error| SetupError::Other {
            part: "the fleet",
            reason: format!("seed {seed}: {error}"),
        }),
        Err(payload) => Ok(FleetOutcome {
            seed,
            nearest_m: 0.0,
            driven_ms: 0,
            yielded_ms: 0,
            reasons: BTreeSet::new(),
            failure: Some(format!("panic: {}", message(&*payload))),
        }),
    }
}

fn attempt(
    seed: u64,
    cars: usize,
    bug: Option<FleetBug>,
) -> Result<FleetOutcome, VirtualDriveError> {
    let mut random = Random::new(seed, Stream::Fleet);
    let mut fleet = VirtualFleet::new(&draw_cars(&mut random, seed, cars, bug))?;
    fleet.start()?;
    let begin_us = fleet.now_us;
    let mut changes = Vec::new();
    for _ in 0..random.between(0, 4) {
        let fault = random.choose(Fault::Lost, &FAULTS);
        let car = random.between(0, cars as u32 - 1) as usize;
        let at_ms = random.between(0, DRIVE_MS);
        let until_ms = at_ms + random.spread(20, 4_000);
        changes.extend([(at_ms, car, fault, true), (until_ms, car, fault, false)]);
    }
    changes.push((DRIVE_MS, 0, Fault::Lost, false));
    changes.sort_by_key(|(at_ms, ..)| *at_ms);
    let mut outcome = FleetOutcome {
        seed,
        nearest_m: f64::INFINITY,
        driven_ms: 0,
        yielded_ms: 0,
        reasons: BTreeSet::new(),
        failure: None,
    };
    for (at_ms, car, fault, begins) in changes {
        if at_ms > DRIVE_MS {
            break;
        }
        fleet.advance_to(begin_us + u64::from(at_ms) * 1_000, &mut |_, tick| {
            let output = &tick.tick.output;
            outcome.driven_ms += 10 * u64::from(output.mode == Mode::Driving);
            outcome.yielded_ms += 10 * u64::from(output.filtering == Filtering::Yielded);
            if !output.mode.commands() {
                outcome
                    .reasons
                    .extend(output.reason.map(|reason| Reason::name(reason).to_owned()));
            }
        });
        change(&mut fleet, car, fault, begins);
    }
    outcome.nearest_m = fleet.nearest_m();
    if outcome.nearest_m <= 0.0 {
        outcome.failure = Some(format!("collision: {:.3} m", outcome.nearest_m));
    }
    Ok(outcome)
}

fn change(fleet: &mut VirtualFleet, index: usize, fault: Fault, begins: bool) {
    let seen = match fault {
        _ if !begins => Sight::Now,
        Fault::Frozen => Sight::Frozen,
        _ => Sight::Not,
    };
    if matches!(fault, Fault::Lost | Fault::Hidden | Fault::Frozen) {
        fleet.show(index, seen);
    }
    let Some(car) = fleet.cars.get_mut(index) else {
        return;
    };
    match fault {
        Fault::Hidden | Fault::Frozen => {}
        Fault::Lost | Fault::Deaf => {
            let kind = match fault {
                Fault::Lost => LossKind::Occluded,
                _ => LossKind::Silent,
            };
            car.world.cameras.faults.loss = begins.then_some(kind);
        }
        Fault::Unplugged => car.world.set_cable(!begins),
        Fault::Unpowered => car.world.set_board_power(!begins),
        Fault::Jumps => {
            let jump = if begins { 0.7 } else { 0.0 };
            car.world.cameras.faults.jump_m = [jump, 0.0, 0.0];
        }
        Fault::Swapped => car.world.cameras.faults.swapped = begins,
        Fault::Disarmed => {
            let request = if begins {
                PilotRequest::Disarm
            } else {
                PilotRequest::Arm(Arming::Unattended)
            };
            // A stalled loop takes no requests.
            let _ = car.request(request);
        }
    }
}

/// Cars on random circles, which start apart.
fn draw_cars(random: &mut Random, seed: u64, cars: usize, bug: Option<FleetBug>) -> Vec<FleetCar> {
    let mut milli = |least: i32, most: i32| f64::from(random.signed(least, most)) * 1e-3;
    let mut drawn: Vec<FleetCar> = Vec::new();
    for index in 0..cars {
        let mut best: Option<(f64, FleetCar)> = None;
        for _ in 0..DRAWS {
            let half = (600 * cars) as i32;
            let centre = [milli(-half, half), milli(-half, half)];
            let (radius, speed) = (milli(700, 1_300), milli(250, 900));
            let turn = if milli(0, 1_000) < 0.5 { 1.0 } else { -1.0 };
            let phase = milli(0, 6_283);
            let start = StartPose {
                x_m: centre[0] + radius * libm::cos(phase),
                y_m: centre[1] + radius * libm::sin(phase),
                yaw_rad: (phase + turn * FRAC_PI_2) % TAU,
            };
            let apart = |other: &FleetCar| {
                libm::hypot(other.start.x_m - start.x_m, other.start.y_m - start.y_m)
            };
            let nearest = drawn.iter().map(apart).fold(f64::INFINITY, f64::min);
            if best.as_ref().is_none_or(|(best, _)| nearest > *best) {
                let reference = ReferenceSection::Circle {
                    radius_m: radius,
                    angular_velocity_rad_s: turn * speed / radius,
                    centre_m: centre,
                    start: Start::Nearest,
                };
                best = Some((nearest, car(reference, start, seed, index, cars, bug)));
            }
            if nearest >= APART_M {
                break;
            }
        }
        drawn.extend(best.map(|(_, car)| car));
    }
    drawn
}

fn car(
    reference: ReferenceSection,
    start: StartPose,
    seed: u64,
    index: usize,
    cars: usize,
    bug: Option<FleetBug>,
) -> FleetCar {
    let name = |index| format!("car{}", index + 1);
    let mut config = daemon_config(Drive::following(reference));
    config.motion_capture.rigid_body = name(index);
    config.safety_filter.enabled = true;
    let neighbours = &mut config.neighbours;
    neighbours.enabled = bug != Some(FleetBug::Blind);
    neighbours.expected = (0..cars)
        .filter(|other| *other != index)
        .map(name)
        .collect();
    if bug == Some(FleetBug::Touching) {
        neighbours.clearance_m = Some(0.05);
        neighbours.braking_m_s2 = Some(50.0);
        neighbours.reaction_ms = Some(0.0);
        neighbours.acceleration_m_s2 = 0.01;
    }
    FleetCar {
        config,
        start,
        seed: seed ^ index as u64,
    }
}
