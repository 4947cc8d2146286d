//! Several cars, by `fleet.toml`: requests to all of them, and a drive of all that one process holds.

use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
    thread,
    time::{Duration, Instant},
};

use serde::Deserialize;

use crate::{
    Answer, Arm, Attendance, ClientError, ClockOffset, Code, Connection, Ended, HeldDrive, Refused,
    Reply, Request, Status, ask_within,
};

/// The longest wait for a daemon's answer: the others are asked meanwhile.
const PATIENCE: Duration = Duration::from_secs(1);

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

/// Several cars, each with a daemon of its own.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fleet {
    /// In the order of the file.
    #[serde(rename = "car")]
    pub cars: Vec<FleetCar>,
}

/// A car of a fleet.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FleetCar {
    /// Name of the car, as in `singletrackd@NAME.service`.
    pub name: String,
    /// The control socket of its daemon; for a car on another computer, one that `ssh -L` forwards.
    socket: Option<PathBuf>,
    /// The number of its board, as `board.car_id` in its configuration.
    pub number: Option<u16>,
    /// Its body in the cameras' software, as `motion_capture.rigid_body` in its configuration.
    pub body: Option<String>,
    /// Its colour on the page, as CSS writes it.
    pub colour: Option<String>,
    /// The zenoh router by which its computer is reached: `singletrack-zenoh desk` offers `socket`.
    pub router: Option<String>,
}

/// Why a fleet's file can't be taken, and what to write.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct FleetFileError(String);

/// Cars did not obey: a line for each.
#[derive(Debug, thiserror::Error)]
#[error("{}", .0.join("\n"))]
pub struct NotObeyed(pub Vec<String>);

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

impl NotObeyed {
    fn check(failures: Vec<String>) -> Result<(), Self> {
        if failures.is_empty() {
            Ok(())
        } else {
            Err(Self(failures))
        }
    }
}

impl Fleet {
    /// Reads a file.
    ///
    /// # Errors
    ///
    /// There is none, or it does not name cars that differ.
    pub fn read(path: &Path) -> Result<Self, FleetFileError> {
        let name = path.display();
        let text = fs::read_to_string(path)
            .map_err(|error| FleetFileError(format!("can't read the fleet {name}: {error}")))?;
        Self::parse(&text).map_err(|error| FleetFileError(format!("{name}: {error}")))
    }

    fn parse(text: &str) -> Result<Self, String> {
        let fleet: Self = toml::from_str(text).map_err(|error| {
            let message = error.to_string();
            let message = message.trim_end();
            format!("{message}: write a table [[car]] for each, with name = \"car1\"")
        })?;
        let mut taken = BTreeSet::new();
        for car in &fleet.cars {
            let name = car.name.clone();
            let is_allowed = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
            if name.is_empty() || !name.chars().all(is_allowed) {
                return Err(format!(
                    "car.name is {name:?}: it must be of letters, digits, - and _, as it names a \
                     service"
                ));
            }
            let socket = car.socket().display().to_string();
            let number = car.number.map(|number| ("number", number.to_string()));
            let body = car.body.clone().map(|body| ("body", body));
            let named = [("name", name), ("socket", socket)];
            for (what, value) in named.into_iter().chain(number).chain(body) {
                if !taken.insert((what, value.clone())) {
                    return Err(format!(
                        "two cars have the {what} {value}: give each one of its own"
                    ));
                }
            }
        }
        Ok(fleet)
    }

    /// Tells all cars something at once.
    ///
    /// # Errors
    ///
    /// Those that refuse or do not answer, by name; the others have been told all the same.
    pub fn tell(&self, request: &Request) -> Result<(), NotObeyed> {
        let answers = self.ask(request).into_iter().zip(&self.cars);
        let failures = answers.filter_map(|(answer, car)| Some(car.failure(&answer.err()?)));
        NotObeyed::check(failures.collect())
    }

    /// The status of each car, and how far its clock is ahead of `clock`, in ns; or what failed.
    /// They are in their order.
    pub fn status(
        &self,
        clock: impl Fn() -> u64 + Sync,
    ) -> Vec<Result<(Status, ClockOffset), String>> {
        let ask = |car: &FleetCar| {
            let (mut connection, offset) = car.connect(&clock)?;
            let status = connection.exchange(&Request::Status {}, PATIENCE)?.status;
            Ok((status.ok_or(ClientError::Ended)?, offset))
        };
        let answers = self.with_all(ask).into_iter().zip(&self.cars);
        answers
            .map(|(answer, car)| answer.map_err(|error| car.failure(&error)))
            .collect()
    }

    fn ask(&self, request: &Request) -> Vec<Result<Answer, ClientError>> {
        self.with_all(|car| ask_within(request, &car.socket(), PATIENCE))
    }

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

    /// Does something with all cars at once; the results are in their order.
    fn with_all<T: Send>(
        &self,
        ask: impl Fn(&FleetCar) -> Result<T, ClientError> + Sync,
    ) -> Vec<Result<T, ClientError>> {
        thread::scope(|scope| {
            let ask = &ask;
            let cars = self.cars.iter();
            let asked: Vec<_> = cars.map(|car| scope.spawn(move || ask(car))).collect();
            let answers = asked.into_iter().map(thread::ScopedJoinHandle::join);
            // A thread that has panicked has not heard its daemon.
            answers
                .map(|answer| answer.unwrap_or(Err(ClientError::Ended)))
                .collect()
        })
    }
}

impl FleetCar {
    /// The control socket of its daemon.
    pub fn socket(&self) -> PathBuf {
        let default = || PathBuf::from(format!("/run/singletrackd-{}/control.sock", self.name));
        self.socket.clone().unwrap_or_else(default)
    }

    /// A connection to its daemon, which must have its number and its body, and how far the daemon's
    /// clock is ahead of `clock`.
    fn connect(&self, clock: impl Fn() -> u64) -> Result<(Connection, ClockOffset), ClientError> {
        let mut connection = Connection::open(&self.socket(), PATIENCE)?;
        let number = self
            .number
            .map(|number| toml::Value::from(i64::from(number)));
        let body = self.body.clone().map(toml::Value::from);
        if number.is_some() || body.is_some() {
            let toml = connection
                .exchange(&Request::Configuration {}, PATIENCE)?
                .toml;
            let table = toml.and_then(|toml| toml.parse::<toml::Table>().ok());
            for (name, wanted, section, key) in [
                ("number", number, "board", "car_id"),
                ("body", body, "motion_capture", "rigid_body"),
            ] {
                let configured = table
                    .as_ref()
                    .and_then(|table| table.get(section)?.get(key));
                let Some(wanted) = wanted.filter(|wanted| configured != Some(wanted)) else {
                    continue;
                };
                let configured =
                    configured.map_or_else(|| "unknown".to_owned(), ToString::to_string);
                return Err(ClientError::Refused(Refused::new(
                    Code::Other,
                    format_args!(
                        "{name} is {wanted}, and {section}.{key} of its daemon is {configured}: \
                     correct the {name} or the socket in the fleet's file"
                    ),
                )));
            }
        }
        let offset = connection.clock_offset(clock, PATIENCE)?;
        Ok((connection, offset))
    }

    fn failure(&self, error: &ClientError) -> String {
        format!("{}: {error}", self.name)
    }
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

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may fail")]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Fleet, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("fleet.toml");
        fs::write(&path, text).unwrap();
        Fleet::read(&path).map_err(|error| error.to_string())
    }

    #[test]
    fn a_car_has_the_socket_of_its_service_or_another_one() {
        let fleet =
            read("[[car]]\nname = \"car1\"\n[[car]]\nname = \"two\"\nsocket = \"/tmp/two.sock\"\n")
                .unwrap();
        let sockets: Vec<_> = fleet.cars.iter().map(FleetCar::socket).collect();
        let expected = ["/run/singletrackd-car1/control.sock", "/tmp/two.sock"];
        assert_eq!(sockets, expected.map(PathBuf::from));
    }

    #[test]
    fn what_is_wrong_is_named_with_what_to_write() {
        for (text, named) in [
            ("[[car]]\nname = \"a b\"\n", "\"a b\""),
            (
                "[[car]]\nname = \"a\"\n[[car]]\nname = \"a\"\n",
                "two cars have the name a",
            ),
            ("[[car]]\nnane = \"a\"\n", "unknown field `nane`"),
            (
                "[[car]]\nname = \"a\"\nnumber = 1\n[[car]]\nname = \"b\"\nnumber = 1\n",
                "two cars have the number 1",
            ),
            (
                "[[car]]\nname = \"a\"\nbody = \"x\"\n[[car]]\nname = \"b\"\nbody = \"x\"\n",
                "two cars have the body x",
            ),
            ("", "[[car]]"),
            (
                "[[car]]\nname = \"a\"\nsocket = \"/s\"\n[[car]]\nname = \"b\"\nsocket = \"/s\"\n",
                "two cars have the socket /s",
            ),
        ] {
            let error = read(text).unwrap_err();
            assert!(
                error.contains("fleet.toml: ") && error.contains(named),
                "{error}"
            );
        }
    }
}
