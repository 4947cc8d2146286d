//! `singletrack demo`: the paper's circle, driven by the daemon on the simulated car, in real time
//! or, where the computer can't keep it, in virtual time.

mod arguments;
mod files;
mod fleet;
mod outcome;
mod real_time;
mod report;
mod settings;
mod viewers;
mod virtual_time;

use std::error::Error;

use singletrack_figures::plot::because;
use singletrack_pilot::Reason;

use crate::interrupt::Interrupt;
use files::prepare;
use outcome::{Drive, INTERRUPTED, NotStarted, Progress};

pub use arguments::DemoArgs;

/// Runs the demo.
///
/// # Errors
///
/// Why the car did not drive to the end; the record and the figures so far are
/// written all the same.
pub fn run(args: &DemoArgs) -> Result<(), Box<dyn Error>> {
    if args.live.is_some() && !cfg!(feature = "live") {
        let why = "--live needs the feature `live`, without which this program was built: `cargo \
                   demo --live` builds it with it";
        return Err(why.into());
    }
    let interrupt = Interrupt::listen()?;
    let folder = prepare(&args.out)?;
    if args.cars > 1 {
        return fleet::run(args, &interrupt);
    }
    let mut progress = Progress::new(args.duration, settings::expected(args.feed_forward).error_m);
    let driven = if args.virtual_time {
        virtual_time::run(args, &mut progress, &interrupt)?
    } else {
        let driven = real_time::run(args, &mut progress, &interrupt);
        match untimely(args, &driven) {
            Some(reason) if !interrupt.is_raised() => {
                let note = format!(
                    "singletrack: this computer is too busy for real time ({reason}): the demo goes \
                     on in virtual time, which --virtual asks for"
                );
                progress.bar.suspend(|| eprintln!("{note}"));
                files::clear(&args.out)?;
                virtual_time::run(args, &mut progress, &interrupt)?
            }
            _ => driven?,
        }
    };
    progress.bar.finish_and_clear();
    drop(folder);

    let plotted = report::plot(args, &driven);
    report::write(args, &driven, plotted.is_ok())?;
    if let (Some(_), Err(error)) = (&driven.ended, &plotted) {
        // Why the drive ended matters more, and comes last.
        eprintln!("singletrack: no figures: {error}");
    }
    match driven.ended {
        None => Ok(plotted?),
        Some(_) if interrupt.is_raised() => Err(INTERRUPTED.into()),
        Some(ended) => Err(format!(
            "the drive ended after {:.1} s of {:.1} s: mode {}{}; see {}",
            ended.after_s,
            args.duration.as_secs_f64(),
            ended.mode,
            because(ended.reason),
            args.out.display()
        )
        .into()),
    }
}

/// Why a drive ended or did not begin, if that is what happens on a computer that holds up programs
/// and lines for longer than a command lives. In a drive without lost markers nothing else is wrong.
fn untimely(args: &DemoArgs, driven: &Result<Drive, Box<dyn Error>>) -> Option<Reason> {
    let reason = match driven {
        Ok(drive) => drive.ended.as_ref()?.reason?,
        Err(error) => error.downcast_ref::<NotStarted>()?.reason?,
    };
    let by_line = matches!(
        reason,
        Reason::BatteryUnknown
            | Reason::BoardBooting
            | Reason::BoardFailsafe
            | Reason::BoardTimeout
            | Reason::DeadlineMissed
            | Reason::ImuSilent
            | Reason::LinkDown
    );
    let by_cameras = matches!(
        reason,
        Reason::BlindTooFar | Reason::CaptureTimeUncertain | Reason::NoPose | Reason::PoseTooOld
    );
    (by_line || (by_cameras && args.loss.is_none())).then_some(reason)
}
