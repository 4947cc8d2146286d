//! `singletrack demo --cars N`: several cars on circles that cross, each with a daemon of its own, in
//! real time or in virtual time.

use std::{
    f64::consts::{FRAC_PI_2, PI, TAU},
    fs,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
    thread,
    time::{Duration, Instant},
};

use indicatif::ProgressBar;
use serde::Serialize;
use singletrack_core::config::{ReferenceSection, Start};
use singletrack_figures::output::write;
use singletrack_pilot::{Filtering, Mode, Output, PilotRequest, Reason};
use singletrack_scenario::{
    simulated::{self, daemon_config},
    virtual_fleet::{FleetCar, VirtualFleet, fleet_floor, fleet_simulation},
    virtual_record::VirtualRecord,
};
use singletrack_sim::{SharedFloor, StartPose};

use super::{
    Demo, DemoArgs, INTERRUPTED,
    drive::{arm, stop, viewers},
    settings::{self, SUMMARY, not_made, private, record_of, write_configuration},
};
use crate::Result;

/// For a small fleet: its largest number of cars, the distance between neighbouring circles in m, and
/// the lead of a car before the last one, as a fraction of the angle between their circles. The
/// circles cross and the cars yield. More cars would block each other.
const CROSSING: (usize, f64, f64) = (3, 1.8, 0.5);
/// Distance and lead in a larger fleet.
const APART: (f64, f64) = (2.0, 0.0);
/// From the ring of the circles' centres to the geofence, in m.
const FLOOR: f64 = 3.0;
/// Speed on the circles, in rad/s and m/s.
const SPEED: f64 = 0.5;
/// How long boards, cameras and estimators may take to be ready.
const READY_TIMEOUT: Duration = Duration::from_secs(20);
/// How long a car may take to stop and to be disarmed.
const STOP_TIMEOUT: Duration = Duration::from_secs(4);
/// How often the demo looks at the daemons.
const POLL: Duration = Duration::from_millis(20);

/// How the drive of a car went.
#[derive(Clone, Debug, Default, Serialize)]
struct CarSummary {
    name: String,
    way_m: f64,
    /// The time for which it slowed down or stood for another car.
    yielded_s: f64,
    /// Why it stopped before its time.
    ended: Option<&'static str>,
    /// Points of the control grid at which no tick ran; none in virtual time.
    deadline_misses: Option<u64>,
}

impl CarSummary {
    fn note(&mut self, output: &Output, elapsed_s: f64) {
        if output.filtering == Filtering::Yielded {
            self.yielded_s += elapsed_s;
        }
        if !matches!(output.mode, Mode::Driving | Mode::Slowing) {
            let reason = output.reason.map_or("none", Reason::name);
            self.ended = self.ended.or(Some(reason));
        }
    }
}

/// Drives, and prints how it went.
pub(super) fn run(demo: &Demo<'_>) -> Result<()> {
    let args = demo.args;
    let cars: Vec<FleetCar> = (0..args.cars).map(|index| car(args, index)).collect();
    let summary = |car: &FleetCar| CarSummary {
        name: name(car).to_owned(),
        ..CarSummary::default()
    };
    let mut summaries: Vec<_> = cars.iter().map(summary).collect();
    let nearest_m = match args.virtual_time {
        true => virtual_time(demo, &cars, &mut summaries)?,
        false => real_time(demo, &cars, &mut summaries)?,
    };
    for summary in &summaries {
        let end = match summary.ended {
            Some(reason) => format!("stopped: {reason}"),
            None => "drove to the end".to_owned(),
        };
        let missed = summary.deadline_misses;
        let missed = missed.map(|misses| format!(", {misses} ticks missed"));
        let (name, way_m, yielded_s) = (&summary.name, summary.way_m, summary.yielded_s);
        let missed = missed.unwrap_or_default();
        println!("{name:6} {way_m:6.1} m, yielded {yielded_s:5.1} s, {end}{missed}");
    }
    println!("least distance between any two: {nearest_m:.3} m");
    let path = args.out.join(SUMMARY);
    let summary = serde_json::json!({
        "cars": summaries,
        "least_distance_m": nearest_m,
        "duration_s": args.duration.as_secs_f64(),
    });
    write(&path, &format!("{summary:#}\n"))?;
    println!("records and summary: {}", args.out.display());
    match demo.interrupt.is_raised() {
        true => Err(INTERRUPTED.into()),
        false => Ok(()),
    }
}

/// A car on one of the circles around a ring.
fn car(args: &DemoArgs, index: usize) -> FleetCar {
    let name = |index| format!("car{}", index + 1);
    let turn = TAU * index as f64 / args.cars as f64;
    let (spacing, ahead) = match CROSSING {
        (most, spacing, ahead) if args.cars <= most => (spacing, ahead),
        _ => APART,
    };
    let ring = 0.5 * spacing / libm::sin(PI / args.cars as f64);
    let centre = [ring * libm::cos(turn), ring * libm::sin(turn)];
    let mut config = daemon_config(simulated::Drive::following(ReferenceSection::Circle {
        radius_m: 1.0,
        angular_velocity_rad_s: SPEED,
        centre_m: centre,
        start: Start::Nearest,
    }));
    config.motion_capture.rigid_body = name(index);
    let half = ring + FLOOR;
    config.fence.corners_m = vec![[-half, -half], [half, -half], [half, half], [-half, half]];
    config.safety_filter.enabled = true;
    config.neighbours.enabled = true;
    let others = (0..args.cars).filter(|other| *other != index);
    config.neighbours.expected = others.map(name).collect();
    config.record.directory.clone_from(&args.out);
    let phase = ahead * turn;
    FleetCar {
        start: StartPose {
            x_m: centre[0] + libm::cos(phase),
            y_m: centre[1] + libm::sin(phase),
            yaw_rad: phase + FRAC_PI_2,
        },
        seed: args.seed + index as u64,
        config,
    }
}

fn show(bar: &ProgressBar, time_s: f64, summaries: &[CarSummary], nearest_m: f64) {
    let drive = summaries.iter().filter(|car| car.ended.is_none()).count();
    bar.set_position((time_s * 1e3) as u64);
    bar.set_message(format!(
        "{time_s:5.1} s  {drive} of {} cars drive, least distance {nearest_m:.2} m",
        summaries.len()
    ));
}

fn virtual_time(demo: &Demo<'_>, cars: &[FleetCar], summaries: &mut [CarSummary]) -> Result<f64> {
    let args = demo.args;
    for car in cars {
        write_configuration(args, name(car), &car.config)?;
    }
    let mut fleet = VirtualFleet::new(cars)?;
    let drives = fleet.cars.iter_mut().zip(cars);
    let record = |(drive, car): (_, &FleetCar)| {
        let path = record_of(args, name(car));
        VirtualRecord::start(Some(&path), drive, &car.config, car.seed)
    };
    let mut records: Vec<_> = drives.map(record).collect::<Result<_, _>>()?;
    fleet.start()?;
    let start_us = fleet.now_us;
    let duration_s = args.duration.as_secs_f64();
    let mut time_s = 0.0;
    while time_s < duration_s && !demo.interrupt.is_raised() {
        time_s = (time_s + 0.1).min(duration_s);
        fleet.advance_to(start_us + (time_s * 1e6) as u64, &mut |index, tick| {
            if let Some(summary) = summaries.get_mut(index) {
                summary.way_m = tick.truth.way;
                summary.note(&tick.tick.output, 0.01);
            }
        });
        for (record, drive) in records.iter_mut().zip(&mut fleet.cars) {
            record.write(drive)?;
        }
        show(&demo.bar, time_s, summaries, fleet.nearest_m());
    }
    demo.bar.finish_and_clear();
    for drive in fleet.cars.iter().filter(|drive| drive.mode().is_underway()) {
        drive.request(PilotRequest::Disarm)?;
    }
    let until_us = fleet.now_us + STOP_TIMEOUT.as_micros() as u64;
    fleet.advance_to(until_us, &mut |_, _| {});
    for (record, drive) in records.into_iter().zip(&mut fleet.cars) {
        record.finish(drive)?;
    }
    Ok(fleet.nearest_m())
}

fn real_time(demo: &Demo<'_>, cars: &[FleetCar], summaries: &mut [CarSummary]) -> Result<f64> {
    let args = demo.args;
    let private = private()?;
    let floor = Arc::new(Mutex::new(fleet_floor(cars)));
    let locked = || floor.lock().unwrap_or_else(PoisonError::into_inner);
    let nearest_m = || locked().nearest_m;
    let mut fleet = Vec::new();
    for (index, car) in cars.iter().enumerate() {
        let folder = folder(private.path(), car);
        fs::create_dir(&folder).map_err(|error| not_made(&error))?;
        let floor = Some(SharedFloor {
            floor: Arc::clone(&floor),
            index,
        });
        let simulator = settings::simulator(fleet_simulation(cars, index), floor, &folder)?;
        let config = car.config.clone();
        let daemon = settings::start(args, name(car), config, car.seed, &simulator, &folder)?;
        fleet.push((simulator, daemon));
    }
    let socket = |car| settings::socket(&folder(private.path(), car));
    let _viewers = viewers(args, cars.iter().map(socket))?;

    let daemons: Vec<_> = fleet.iter().map(|(_, daemon)| daemon).collect();
    arm(demo, &daemons, READY_TIMEOUT, |snapshot| {
        demo.bar
            .set_message(format!("waiting for all cars: {}", snapshot.mode()));
    })?;
    let begin = Instant::now();
    let mut last = begin;
    while begin.elapsed() < args.duration && !demo.interrupt.is_raised() {
        thread::sleep(POLL);
        let elapsed_s = last.elapsed().as_secs_f64();
        last = Instant::now();
        for (summary, daemon) in summaries.iter_mut().zip(&daemons) {
            if let Some(output) = daemon.snapshot().output() {
                summary.note(output, elapsed_s);
            }
        }
        let time_s = begin.elapsed().as_secs_f64();
        show(&demo.bar, time_s, summaries, nearest_m());
    }
    demo.bar.finish_and_clear();
    stop(&daemons)?;
    for (summary, (simulator, daemon)) in summaries.iter_mut().zip(fleet) {
        let driven = daemon.stop()?;
        summary.deadline_misses = Some(driven.figures.deadline_misses);
        summary.way_m = simulator.stop()?.world.truth().way;
    }
    Ok(nearest_m())
}

/// The name of a car, and of its files.
fn name(car: &FleetCar) -> &str {
    &car.config.motion_capture.rigid_body
}

/// The private folder of a car.
fn folder(private: &Path, car: &FleetCar) -> PathBuf {
    private.join(name(car))
}
