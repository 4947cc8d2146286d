//! Several cars: requests to all of them, and a drive of all that one process holds.

mod drive;
mod file;

use std::{thread, time::Duration};

pub use drive::{FleetArm, FleetDrive, FleetEnd};
pub use file::{Fleet, FleetCar, FleetFileError};

use crate::{
    Answer, ClientError, ClockOffset, Code, Connection, Refused, Reply, Request, Status, ask_within,
};

/// The longest wait for a daemon's answer: the others are asked meanwhile.
const PATIENCE: Duration = Duration::from_secs(1);

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
            let status = answer(&mut connection, &Request::Status {})?.status;
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
    /// A connection to its daemon, which must have its number and its body, and how far the daemon's
    /// clock is ahead of `clock`.
    fn connect(&self, clock: impl Fn() -> u64) -> Result<(Connection, ClockOffset), ClientError> {
        let mut connection = Connection::open(&self.socket(), PATIENCE)?;
        let number = self
            .number
            .map(|number| toml::Value::from(i64::from(number)));
        let body = self.body.clone().map(toml::Value::from);
        if number.is_some() || body.is_some() {
            let toml = answer(&mut connection, &Request::Configuration {})?.toml;
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

/// The answer to a request.
fn answer(connection: &mut Connection, request: &Request) -> Result<Answer, ClientError> {
    connection.send(request)?;
    let reply = connection.receive_within::<Reply>(PATIENCE)?;
    reply.ok_or(ClientError::Ended)?.agreed()
}
