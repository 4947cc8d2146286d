//! The whole pilot on the simulated car, board and cameras.

use std::path::Path;

use singletrack_control::{Position, Reference, direction};
use singletrack_core::config::{Config, LawKind};
use singletrack_pilot::{Mode, Reason};
use singletrack_record::Entry;
use singletrack_sim::{LossWindow, SimulationConfig, StartPose, Truth};

use super::{
    Simulation,
    row::{ROWS_PER_SECOND, Row},
    scenario::{Scenario, ScenarioError, SteeringHold},
};
use crate::{
    simulated::{self, daemon_config},
    virtual_drive::{VirtualDrive, VirtualDriveError, VirtualTick},
    virtual_record::{VirtualRecord, VirtualRecordError},
};

/// Why a scenario failed on the simulated car.
#[derive(Debug, thiserror::Error)]
pub enum CarError {
    /// The scenario can't be driven.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// The drive did not start.
    #[error(transparent)]
    Drive(#[from] VirtualDriveError),
    /// The record could not be written.
    #[error(transparent)]
    Record(#[from] VirtualRecordError),
}

/// The configurations of the daemon and of the simulation for a scenario.
///
/// # Errors
///
/// A scenario that only the ideal plant can run.
pub fn virtual_drive_config(scenario: &Scenario) -> Result<(Config, SimulationConfig), CarError> {
    if scenario.law.kind != LawKind::FrontPoint {
        return Err(ScenarioError::value(
            "law.kind",
            "velocity-point",
            "the pilot drives the car by the front-point law; use plant kind \"ideal\" for this one",
        )
        .into());
    }
    if scenario.control.period_ms == 0 {
        return Err(ScenarioError::value(
            "control.period_ms",
            0,
            "the pilot of plant kind \"car\" runs in ticks; set it to 10",
        )
        .into());
    }
    scenario
        .outer_loop
        .validate_for(&scenario.reference().map_err(ScenarioError::from)?)
        .map_err(ScenarioError::from)?;
    let vehicle = scenario.vehicle;
    let yaw = scenario.start.yaw_deg.to_radians();
    let [x, y] = scenario.start.point_p_m;
    let centre = Position::new(x, y)
        - (vehicle.front_axle_distance_m + scenario.law.point_distance_m) * direction(yaw);
    let mut simulation = SimulationConfig {
        seed: scenario.run.seed,
        ..SimulationConfig::default()
    };
    simulation.car.vehicle = vehicle;
    simulation.car.start = StartPose {
        x_m: centre.x,
        y_m: centre.y,
        yaw_rad: yaw,
    };

    let mut config = daemon_config(simulated::Drive {
        vehicle,
        law: scenario.law,
        outer_loop: scenario.outer_loop,
        reference: scenario.reference.clone(),
    });
    config.control.period_ms = scenario.control.period_ms;
    config.control.align_to_cameras = scenario.control.align_to_cameras;
    if let Some(limits) = scenario.limits {
        config.limits = limits;
    }
    if let Some(board) = scenario.board {
        config.board = board;
    }
    config.reference = config
        .reference
        .written_out()
        .map_err(ScenarioError::from)?;
    config.validate().map_err(ScenarioError::from)?;
    Ok((config, simulation))
}

/// Drives a scenario on the simulated car, without marker losses, and passes on each entry
/// of its record. Returns the configuration of the drive.
///
/// # Errors
///
/// The car can't drive the scenario, or does not start.
pub fn drive_entries(
    scenario: &Scenario,
    take: &mut impl FnMut(&Entry),
) -> Result<Config, CarError> {
    let (daemon, simulation) = virtual_drive_config(scenario)?;
    let mut drive = VirtualDrive::new(daemon.clone(), scenario.run.seed, simulation)?;
    drive.keep_entries();
    let first = drive.start()?;
    let mut now = first.now;
    while now.seconds_since(first.now) < scenario.run.duration_s {
        now = drive.step().now;
        for entry in drive.entries() {
            take(&entry);
        }
    }
    Ok(daemon)
}

/// Drives a scenario on the simulated car; time zero is its first driving tick.
///
/// # Errors
///
/// The car can't drive the scenario, or does not start.
pub(super) fn simulate(scenario: &Scenario, record: Option<&Path>) -> Result<Simulation, CarError> {
    let (daemon, simulation) = virtual_drive_config(scenario)?;
    let period_us = daemon.control.period_ns() / 1_000;
    let latency_us = simulation.cameras.latency_us;
    let under_way = latency_us.div_ceil(period_us);
    for loss in &scenario.marker_loss {
        if loss.first_tick <= under_way {
            return Err(ScenarioError::value(
                "marker_loss.first_tick",
                loss.first_tick,
                "on plant kind \"car\" the frames of the first ticks are under way when it starts; make it later",
            )
            .into());
        }
    }
    let reference = scenario.reference().map_err(ScenarioError::from)?;
    let mut drive = VirtualDrive::new(daemon.clone(), scenario.run.seed, simulation)?;
    let mut record = record
        .map(|path| VirtualRecord::start(path, &mut drive, &daemon, scenario.run.seed))
        .transpose()?;
    let mut last = drive.start()?;
    let start_us = last.now.0 / 1_000;
    for loss in &scenario.marker_loss {
        // A tick is lost when no frame arrives in the period before it.
        let first_us = start_us + (loss.first_tick - 1) * period_us - latency_us;
        drive.world_mut().cameras_mut().add_loss_window(LossWindow {
            start_us: first_us,
            end_us: first_us + loss.ticks * period_us,
        });
    }

    let rows = (scenario.run.duration_s * ROWS_PER_SECOND as f64 + 1e-6) as u64;
    let start = {
        let [x, y] = scenario.start.point_p_m;
        Position::new(x, y)
    };
    let mut ended = None;
    let mut unrecorded = None;
    let rows = (0..=rows)
        .map(|index| {
            let row_us = start_us + index * 1_000_000 / ROWS_PER_SECOND;
            while drive.next_tick_us() <= row_us {
                last = drive.step();
            }
            if let Some(record) = &mut record
                && unrecorded.is_none()
            {
                unrecorded = record.write(&mut drive).err();
            }
            let truth = if row_us == last.now.0 / 1_000 {
                last.truth
            } else {
                drive.advance_to(row_us);
                drive.world().truth()
            };
            let time = index as f64 / ROWS_PER_SECOND as f64;
            let output = &last.tick.output;
            if !matches!(output.mode, Mode::Driving | Mode::Slowing) && ended.is_none() {
                let reason = output.reason.map_or("no reason", Reason::name);
                ended = Some(format!(
                    "the car no longer follows its reference from t = {time} s on: {}, {reason}",
                    output.mode
                ));
            }
            row(scenario, &reference, start, time, &truth, &last)
        })
        .collect();
    if let Some(error) = unrecorded {
        return Err(error.into());
    }
    if let Some(record) = record {
        record.finish(&mut drive)?;
    }
    let mut notes = Vec::new();
    if scenario.control.delay_ticks > 0 || scenario.control.steering == SteeringHold::Step {
        notes.push(
            "control.delay_ticks and control.steering are the ideal plant's; the car has its own \
             delays, and a servo"
                .to_owned(),
        );
    }
    notes.extend(ended);
    Ok(Simulation { rows, notes })
}

fn row(
    scenario: &Scenario,
    reference: &Reference,
    start: Position,
    time: f64,
    truth: &Truth,
    last: &VirtualTick,
) -> Row {
    let output = &last.tick.output;
    let [x_p, y_p] = truth.point_p(
        scenario.vehicle.front_axle_distance_m,
        scenario.law.point_distance_m,
    );
    let nominal = match reference {
        Reference::VelocitySteps(steps) => steps.integrate(start, time),
        other => other.at(time).position.unwrap_or(start),
    };
    let wanted = output.point_velocity.unwrap_or_default();
    let rate = match output.mode {
        Mode::Driving | Mode::Slowing => output.actuation.steering_rate,
        _ => 0.0,
    };
    Row {
        t: time,
        yaw: truth.yaw,
        yaw_rate: truth.yaw_rate,
        sideslip: truth.sideslip,
        steering: truth.steering,
        x_g: truth.x,
        y_g: truth.y,
        speed: output.actuation.speed,
        steering_rate: rate,
        x_p,
        y_p,
        x_ref: nominal.x,
        y_ref: nominal.y,
        v_px: wanted.x,
        v_py: wanted.y,
    }
}
