//! The dead-man switch of all cars.

use std::time::{Duration, Instant};

use super::{Fleet, NotObeyed};
use crate::{Arm, Attendance, ClientError, ClockOffset, Ended, HeldDrive, Reply, Request};

/// How all cars are armed.
#[derive(Clone, Copy, Debug)]
pub struct FleetArm {
    /// The time until all references begin, within 10 ms of each other; the cars are armed before.
    pub start_in: Duration,
    /// Stop all cars when the drive of one of them ends.
    pub together: bool,
    /// Arm also cars that are not commissioned.
    pub uncalibrated: bool,
}

/// Interval of the renewals: shorter than that of one car, as the hold is.
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

/// The drive of all cars of a fleet. It goes on while [`Self::step`] is called at least every 0.1 s;
/// 0.15 s after the last call, each car stops by itself.
#[derive(Debug)]
pub struct FleetDrive {
    fleet: Fleet,
    cars: Vec<Held>,
    together: bool,
    /// When all references begin.
    pub start: Instant,
    disarmed: Option<Instant>,
}

/// How the drive of a car ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FleetEnd {
    /// Name of the car.
    pub name: String,
    /// Mode and reason. The mode is `lost` when its daemon did not say.
    pub ended: Ended,
}

/// A car whose drive is held.
#[derive(Debug)]
struct Held {
    name: String,
    drive: HeldDrive,
    clock: ClockOffset,
    /// The last line of an armed car.
    heard: Option<Instant>,
    ended: Option<Ended>,
    /// Why it was not armed.
    refused: Option<String>,
    /// What its daemon has warned of since the last look.
    warnings: Vec<String>,
}

impl FleetDrive {
    /// Arms all cars, if all are ready. `clock` is a steady clock, in ns.
    ///
    /// # Errors
    ///
    /// A car is not ready, is not the one of the file, or its clock is not known well enough: no car
    /// was armed.
    pub fn begin(
        fleet: &Fleet,
        options: &FleetArm,
        clock: impl Fn() -> u64 + Sync,
    ) -> Result<Self, NotObeyed> {
        fleet.all_ready()?;
        let (mut cars, mut failures) = (Vec::new(), Vec::new());
        let connected = fleet.with_all(|car| car.connect(&clock));
        for (connected, car) in connected.into_iter().zip(&fleet.cars) {
            match connected {
                Ok((_, clock)) if u128::from(clock.bound_ns) > CLOCK_BOUND.as_nanos() => {
                    let bound_ms = clock.bound_ns as f64 / 1e6;
                    failures.push(format!(
                        "{}: its clock is known to {bound_ms:.3} ms only, and {CLOCK_BOUND:?} is \
                         needed to start the cars together: no car was armed; use a faster network",
                        car.name
                    ));
                }
                Ok((connection, clock)) => cars.push(Held {
                    name: car.name.clone(),
                    drive: HeldDrive::new(connection, RENEWAL),
                    clock,
                    heard: None,
                    ended: None,
                    refused: None,
                    warnings: Vec::new(),
                }),
                Err(error) => failures.push(car.failure(&error)),
            }
        }
        NotObeyed::check(failures)?;
        let now = Instant::now();
        let start_ns = clock() + options.start_in.as_nanos() as u64;
        for car in &mut cars {
            car.send(&Request::Arm(Arm {
                attendance: Some(Attendance::Hold),
                hold_ms: Some(HOLD.as_millis() as u64),
                start_ns: Some(car.clock.daemon_ns(start_ns)),
                uncalibrated: options.uncalibrated,
                ..Arm::default()
            }));
        }
        Ok(Self {
            fleet: fleet.clone(),
            cars,
            together: options.together,
            start: now + options.start_in,
            disarmed: None,
        })
    }

    /// Whether the drives of all cars have ended.
    pub fn is_over(&self) -> bool {
        self.cars.iter().all(|car| car.ended.is_some())
    }

    /// Ends the drives: all cars slow down, stop and are disarmed during the next steps.
    pub fn disarm(&mut self) {
        if self.disarmed.is_none() {
            self.disarmed = Some(Instant::now());
            // The drives are not held any longer: a car that is not told stops all the same.
            let _ = self.fleet.tell(&Request::DISARM);
        }
    }

    /// Renews the drives when they are due, and takes what the daemons have said. It returns after a
    /// few milliseconds.
    pub fn step(&mut self) {
        let one_ended = self.cars.iter().any(|car| car.ended.is_some());
        let one_refused = self.cars.iter().any(|car| car.refused.is_some());
        // Before the start, all drive or none.
        let together = self.together || Instant::now() < self.start;
        if one_refused || (together && one_ended) {
            self.disarm();
        }
        let disarmed = self.disarmed;
        let driving = self.cars.iter_mut().filter(|car| car.ended.is_none());
        if disarmed.is_none() {
            driving.for_each(Held::renew);
        }
        let must_be_armed = self.start.saturating_duration_since(Instant::now()) < ARMED_BEFORE;
        for car in self.cars.iter_mut().filter(|car| car.ended.is_none()) {
            car.listen();
            if must_be_armed && car.heard.is_none() && disarmed.is_none() {
                car.refuse("it was not armed before the start: give a longer time until the start");
            }
            if disarmed.is_some_and(|since| since.elapsed() > STOP_TIMEOUT) {
                car.lose("its daemon does not say that it stands");
            }
        }
    }

    /// What the daemons have warned of since the last call, such as a drive that is not recorded;
    /// each with the name of its car.
    pub fn warnings(&mut self) -> Vec<String> {
        let cars = self.cars.iter_mut();
        cars.flat_map(|car| {
            let warnings = core::mem::take(&mut car.warnings).into_iter();
            warnings.map(|warning| format!("{}: {warning}", car.name))
        })
        .collect()
    }

    /// How the drives ended that have ended.
    ///
    /// # Errors
    ///
    /// A car was not armed: no car drives.
    pub fn ends(&self) -> Result<Vec<FleetEnd>, NotObeyed> {
        let refusals = self.cars.iter().filter_map(|car| {
            let why = car.refused.as_ref()?;
            Some(format!("{}: {why}: no car drives", car.name))
        });
        NotObeyed::check(refusals.collect())?;
        let ends = self.cars.iter().filter_map(|car| {
            let (name, ended) = (car.name.clone(), car.ended.clone()?);
            Some(FleetEnd { name, ended })
        });
        Ok(ends.collect())
    }
}

impl Fleet {
    /// Refuses unless every car can be armed.
    fn all_ready(&self) -> Result<(), NotObeyed> {
        let answers = self.ask(&Request::Status {}).into_iter().zip(&self.cars);
        let failures = answers.filter_map(|(answer, car)| {
            let answer = answer.and_then(|answer| answer.status.ok_or(ClientError::Ended));
            let status = match answer {
                Ok(status) => status,
                Err(error) => return Some(car.failure(&error)),
            };
            let why = status.preflight().or(status.reason()).unwrap_or_default();
            let mode = status.mode();
            (mode != "ready").then(|| {
                format!(
                    "{}: not ready (mode {mode}, {why}): no car was armed; `singletrack status \
                     --socket {}` says what to do",
                    car.name,
                    car.socket().display()
                )
            })
        });
        NotObeyed::check(failures.collect())
    }
}

impl Held {
    /// A lost connection ends the drive.
    fn send(&mut self, request: &Request) {
        if let Err(error) = self.drive.connection.send(request) {
            self.lose(&error.to_string());
        }
    }

    /// Renews the drive if that is due.
    fn renew(&mut self) {
        if let Err(error) = self.drive.renew() {
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
        let received = self.drive.connection.receive_within(WAIT);
        if matches!(received, Ok(Some(_))) {
            self.heard = Some(Instant::now());
        } else if self.heard.is_some_and(|heard| heard.elapsed() > HOLD) {
            self.lose("its daemon is silent");
        }
        match received {
            Ok(Some(Reply::Ended { ended, .. })) => self.ended = Some(ended),
            Ok(Some(Reply::Answer(answer))) => match answer.agreed() {
                Ok(answer) => self.warnings.extend(answer.warnings),
                Err(error) => self.refuse(&error.to_string()),
            },
            Ok(_) => {}
            Err(error) => self.lose(&error.to_string()),
        }
    }
}
