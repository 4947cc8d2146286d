//! The drive in virtual time: the same host loop, board and cameras, on one thread.

use std::error::Error;

use singletrack_figures::output::write;
use singletrack_pilot::{Mode, PilotRequest};
use singletrack_scenario::{virtual_drive::VirtualDrive, virtual_record::VirtualRecord};
use singletrack_sim::TimedTruth;

use super::{
    DemoArgs, Drive, Ended, Progress,
    files::{BoardFigures, CONFIGURATION, RECORD, SIMULATION},
    settings,
};
use crate::interrupt::Interrupt;

/// How long the car may take to stop and to be disarmed, s.
const STOP_TIMEOUT: f64 = 4.0;

/// Drives, and returns how it went.
pub(super) fn run(
    args: &DemoArgs,
    progress: &mut Progress,
    interrupt: &Interrupt,
) -> Result<Drive, Box<dyn Error>> {
    let simulation = settings::simulation(args)?;
    let front_axle_distance_m = args.car.vehicle()?.front_axle_distance_m;
    let config = settings::daemon(args)?;
    write(&args.out.join(CONFIGURATION), &config.to_toml()?)?;
    write(&args.out.join(SIMULATION), &toml::to_string(&simulation)?)?;
    let mut drive = VirtualDrive::new(config.clone(), args.seed, simulation)?;
    drive.world.cameras.loss_epoch_us = None;
    let mut record =
        VirtualRecord::start(Some(&args.out.join(RECORD)), &mut drive, &config, args.seed)?;
    let first = drive.start()?;
    let epoch_us = drive.now_us();
    drive.world.cameras.loss_epoch_us = Some(epoch_us);

    let wanted_s = args.duration.as_secs_f64();
    let (mut truth, mut last_s) = (Vec::new(), 0.0);
    let ended = loop {
        let tick = drive.step();
        record.write(&mut drive)?;
        truth.push(TimedTruth {
            monotonic_ns: tick.now.0,
            truth: tick.truth,
        });
        let output = &tick.tick.output;
        if !matches!(output.mode, Mode::Driving | Mode::Slowing) || interrupt.is_raised() {
            break Some(Ended {
                mode: output.mode,
                reason: output.reason,
                after_s: last_s,
            });
        }
        let time = tick.now.seconds_since(first.now);
        if time >= wanted_s {
            break None;
        }
        last_s = time;
        let point = settings::point(&tick.truth, front_axle_distance_m);
        let error_m = settings::tracking_error(point, time);
        progress.driving(time, &tick.truth, error_m, output.held);
    };
    if drive.mode().is_underway() {
        drive.request(PilotRequest::Disarm)?;
    }
    let mut now = drive.step().now;
    let until = now.after(STOP_TIMEOUT);
    while drive.mode().commands() && now < until {
        now = drive.step().now;
    }
    record.finish(&mut drive)?;
    Ok(Drive {
        ended,
        start_ns: first.now.0,
        duration_s: ended.as_ref().map_or(wanted_s, |ended| ended.after_s),
        front_axle_distance_m,
        truth,
        summary: None,
        board: BoardFigures::of(&mut drive.world.board)?,
    })
}
