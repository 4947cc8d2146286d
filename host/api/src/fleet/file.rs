//! `fleet.toml`: the cars of a fleet.

use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
};

use serde::Deserialize;

/// Several cars, each with a daemon of its own.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fleet {
    /// In the order of the file.
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

impl FleetCar {
    /// The control socket of its daemon.
    pub fn socket(&self) -> PathBuf {
        let default = || PathBuf::from(format!("/run/singletrackd-{}/control.sock", self.name));
        self.socket.clone().unwrap_or_else(default)
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
        #[derive(Deserialize)]
        #[serde(deny_unknown_fields)]
        struct File {
            car: Vec<FleetCar>,
        }
        let File { car: cars } = toml::from_str(text).map_err(|error| {
            let message = error.to_string();
            let message = message.trim_end();
            format!("{message}: write a table [[car]] for each, with name = \"car1\"")
        })?;
        let mut taken = BTreeSet::new();
        for car in &cars {
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
        Ok(Self { cars })
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
