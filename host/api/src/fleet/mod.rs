//! Several cars, by `fleet.toml`: requests to all of them, and a drive of all that one process holds.

mod drive;

use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
    thread,
    time::Duration,
};

use serde::Deserialize;

pub use drive::{FleetArm, FleetDrive, FleetEnd};

use crate::{
    Answer, ClientError, ClockOffset, Code, Connection, Refused, Request, Status, ask_within,
};

/// The longest wait for a daemon's answer: the others are asked meanwhile.
const PATIENCE: Duration = Duration::from_secs(1);

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
