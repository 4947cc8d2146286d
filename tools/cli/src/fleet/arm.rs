//! `singletrack fleet arm`: the dead-man switch of all cars.

use std::{
    process::ExitCode,
    time::{Duration, Instant},
};

use clap::Args;
use singletrack_api::{
    Arm, Attendance, ClientError, ClockOffset, Connection, Ended, Reply, Request,
};
use singletrackd::monotonic_ns;

use super::{FleetError, ask_all, connect, failure, file::Fleet, obeyed, tell, with_all};
use crate::{
    arm::{STOPPED, WANTED, parse_time},
    control::{ControlError, print},
    interrupt::Interrupt,
};

/// Options of `singletrack fleet arm`.
#[derive(Clone, Debug, Args)]
pub(super) struct FleetArmArgs {
    /// Drive for this time, such as 60s, and stop
    #[arg(long = "for", value_name = "DURATION", value_parser = parse_time)]
    time: Option<Duration>,
    /// The time until all references begin, within 10 ms of each other; the cars are armed before
    #[arg(long, value_name = "DURATION", value_parser = parse_time, default_value = "3s")]
    start_in: Duration,
    /// Stop all cars when the drive of one of them ends
    #[arg(long)]
    together: bool,
    /// Arm also cars that have not passed doctor, bring-up and calibrate
    #[arg(long)]
    uncalibrated: bool,
}

/// Interval of the renewals.
const RENEWAL: Duration = Duration::from_millis(50);

/// All cars are armed so long before the start, or none drives.
const ARMED_BEFORE: Duration = Duration::from_millis(100);

/// The clock of each daemon must be known to this: half the round trip of the fastest exchange.
const CLOCK_BOUND: Duration = Duration::from_millis(1);

/// The longest wait for a line of one car: renewals must not be late.
const WAIT: Duration = Duration::from_millis(2);

/// A car stops this long after the last renewal. Its daemon reports on the drive three times as
/// often; one that is silent for as long is lost.
const HOLD: Duration = Duration::from_millis(150);

/// The longest time until a car has stopped.
const STOP_TIMEOUT: Duration = Duration::from_secs(6);

/// A car whose drive this command holds.
struct Held<'a> {
    name: &'a str,
    connection: Connection,
    clock: ClockOffset,
    /// The last line of an armed car.
    heard: Option<Instant>,
    ended: Option<Ended>,
    /// Why it was not armed.
    refused: Option<String>,
}

/// Arms all cars, if all are ready, and holds their drives until all have ended.
pub(super) fn run(fleet: &Fleet, args: &FleetArmArgs) -> Result<ExitCode, FleetError> {
    let interrupt = Interrupt::listen().map_err(ControlError::from)?;
    all_ready(fleet)?;
    let (mut cars, mut failures) = (Vec::new(), Vec::new());
    for (connected, car) in with_all(fleet, connect).into_iter().zip(&fleet.cars) {
        match connected {
            Ok((_, clock)) if u128::from(clock.bound_ns) > CLOCK_BOUND.as_nanos() => {
                let bound_ms = clock.bound_ns as f64 / 1e6;
                failures.push(format!(
                    "{}: its clock is known to {bound_ms:.3} ms only, and {CLOCK_BOUND:?} is needed \
                     to start the cars together: no car was armed; use a faster network",
                    car.name
                ));
            }
            Ok((connection, clock)) => cars.push(Held {
                name: &car.name,
                connection,
                clock,
                heard: None,
                ended: None,
                refused: None,
            }),
            Err(error) => failures.push(failure(car, &error)),
        }
    }
    obeyed(failures)?;
    let mut renewed = Instant::now();
    let start = renewed + args.start_in;
    let start_ns = monotonic_ns() + args.start_in.as_nanos() as u64;
    for car in &mut cars {
        car.send(&Request::Arm(Arm {
            attendance: Some(Attendance::Hold),
            hold_ms: Some(HOLD.as_millis() as u64),
            start_ns: Some(car.clock.daemon_ns(start_ns)),
            uncalibrated: args.uncalibrated,
            ..Arm::default()
        }));
    }
    let mut disarmed = None;
    while cars.iter().any(|car| car.ended.is_none()) {
        let one_ended = cars.iter().any(|car| car.ended.is_some());
        let one_refused = cars.iter().any(|car| car.refused.is_some());
        let is_over = args.time.is_some_and(|time| start.elapsed() >= time);
        // Before the start, all drive or none.
        let together = args.together || Instant::now() < start;
        if (interrupt.is_raised() || is_over || one_refused || (together && one_ended))
            && disarmed.is_none()
        {
            disarmed = Some(Instant::now());
            // The drives are not held any longer: a car that is not told stops all the same.
            let _ = tell(fleet, &Request::DISARM);
        }
        if disarmed.is_none() && renewed.elapsed() >= RENEWAL {
            renewed = Instant::now();
            for car in cars.iter_mut().filter(|car| car.ended.is_none()) {
                car.send(&Request::Hold {});
            }
        }
        let must_be_armed = start.saturating_duration_since(Instant::now()) < ARMED_BEFORE;
        for car in cars.iter_mut().filter(|car| car.ended.is_none()) {
            car.listen();
            if must_be_armed && car.heard.is_none() && disarmed.is_none() {
                car.refuse("it was not armed before the start: give a longer --start-in");
            }
            if disarmed.is_some_and(|since| since.elapsed() > STOP_TIMEOUT) {
                car.lose("its daemon does not say that it stands");
            }
        }
    }
    let refusals = cars.iter().filter_map(|car| {
        let why = car.refused.as_ref()?;
        Some(format!("{}: {why}: no car drives", car.name))
    });
    obeyed(refusals.collect())?;
    let mut as_wanted = true;
    for Held { name, ended, .. } in &cars {
        let Some(ended) = ended else { continue };
        let reason = ended.reason.as_deref();
        as_wanted &= reason.is_none_or(|reason| WANTED.contains(&reason)) && ended.mode != "fault";
        print(&format!("{name}: {ended}"))?;
    }
    Ok(if as_wanted {
        ExitCode::SUCCESS
    } else {
        ExitCode::from(STOPPED)
    })
}

/// Refuses unless every car can be armed.
fn all_ready(fleet: &Fleet) -> Result<(), FleetError> {
    let answers = ask_all(fleet, &Request::Status {})
        .into_iter()
        .zip(&fleet.cars);
    let failures = answers.filter_map(|(answer, car)| {
        let answer = answer.and_then(|answer| answer.status.ok_or(ClientError::Ended));
        let status = match answer {
            Ok(status) => status,
            Err(error) => return Some(failure(car, &error)),
        };
        let why = status.preflight.or(status.reason).unwrap_or_default();
        (status.mode != "ready").then(|| {
            format!(
                "{}: not ready (mode {}, {why}): no car was armed; `singletrack status --socket {}` \
                 says what to do",
                car.name,
                status.mode,
                car.socket().display()
            )
        })
    });
    obeyed(failures.collect())
}

impl Held<'_> {
    /// A lost connection ends the drive.
    fn send(&mut self, request: &Request) {
        if let Err(error) = self.connection.send(request) {
            self.lose(&error.to_string());
        }
    }

    fn refuse(&mut self, why: &str) {
        self.lose(why);
        self.refused = Some(why.to_owned());
    }

    fn lose(&mut self, why: &str) {
        self.ended = Some(Ended {
            mode: "lost".into(),
            reason: Some(why.to_owned().into()),
        });
    }

    /// Takes what the daemon has said.
    fn listen(&mut self) {
        let received = self.connection.receive_within(WAIT);
        if matches!(received, Ok(Some(_))) {
            self.heard = Some(Instant::now());
        } else if self.heard.is_some_and(|heard| heard.elapsed() > HOLD) {
            self.lose("its daemon is silent");
        }
        match received {
            Ok(Some(Reply::Ended { ended, .. })) => self.ended = Some(ended),
            Ok(Some(Reply::Answer(answer))) => {
                if let Err(error) = answer.agreed() {
                    self.refuse(&error.to_string());
                }
            }
            Ok(_) => {}
            Err(error) => self.lose(&error.to_string()),
        }
    }
}
