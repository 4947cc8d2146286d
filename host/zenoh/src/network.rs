//! Sessions of zenoh, and the keys of a car.

use std::{net::IpAddr, path::Path, thread};

use zenoh::{Config, Session, Wait as _};

/// A computer that is silent for as long has left. A drive has ended before: its holder is not heard.
const LEASE_MS: u32 = 1_000;

/// Why the program ends.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ZenohError {
    /// A session does not open, or a key can't be declared.
    #[error("zenoh: {0}")]
    Session(#[from] zenoh::Error),
    /// There is no such fleet.
    #[error(transparent)]
    Fleet(#[from] singletrack_api::FleetFileError),
    /// Anything else: a text which says what to do.
    #[error("{0}")]
    Other(String),
}

/// A client of a router. It waits until the router is there, and comes back when it was lost.
pub(crate) fn join(file: Option<&Path>, router: &str) -> Result<Session, ZenohError> {
    let mut config = configuration(file, "client", "connect", router)?;
    config.insert_json5("connect/timeout_ms", "-1")?;
    let retry = r#"{ period_init_ms: 100, period_max_ms: 500, period_increase_factor: 2 }"#;
    config.insert_json5("connect/retry", retry)?;
    tracing::info!(router, "connecting");
    let session = zenoh::open(config).wait()?;
    tracing::info!(router, "connected");
    Ok(session)
}

/// Runs a router until the process ends. Beyond loopback its configuration must ask for a password,
/// unless the operator says that it need not.
pub(crate) fn route(
    file: Option<&Path>,
    listen: &str,
    without_password: bool,
) -> Result<(), ZenohError> {
    let config = configuration(file, "router", "listen", listen)?;
    if !(without_password || is_loopback(listen) || asks_for_password(&config)) {
        return Err(ZenohError::Other(format!(
            "--listen {listen}: everyone who reaches it could drive the cars: give a password with \
             --config FILE, a file such as {{ transport: {{ auth: {{ usrpwd: {{ dictionary_file: \
             \"/etc/zenoh/users\" }} }} }} }} whose dictionary has lines NAME:PASSWORD; or listen on \
             tcp/127.0.0.1:7447; or, in a network of the cars alone, add --without-password"
        )));
    }
    let _router = zenoh::open(config).wait()?;
    tracing::info!(listen, "the router has started");
    loop {
        thread::park();
    }
}

fn configuration(
    file: Option<&Path>,
    mode: &str,
    direction: &str,
    endpoint: &str,
) -> Result<Config, ZenohError> {
    let mut config = match file {
        None => Config::default(),
        Some(path) => Config::from_file(path).map_err(|error| {
            let (path, error) = (path.display(), said(&error));
            ZenohError::Other(format!("{path}: {error}"))
        })?,
    };
    config.insert_json5("mode", &format!("{mode:?}"))?;
    let (key, endpoints) = (format!("{direction}/endpoints"), format!("[{endpoint:?}]"));
    config.insert_json5(&key, &endpoints).map_err(|error| {
        let error = said(&error);
        ZenohError::Other(format!(
            "{endpoint:?} is no endpoint of zenoh ({error}): write tcp/192.168.1.30:7447"
        ))
    })?;
    // Only the router that is named.
    config.insert_json5("scouting/multicast/enabled", "false")?;
    config.insert_json5("transport/link/tx/lease", &LEASE_MS.to_string())?;
    Ok(config)
}

/// Whether only programs of this computer reach an endpoint.
fn is_loopback(endpoint: &str) -> bool {
    let (_, address) = endpoint.split_once('/').unwrap_or(("", endpoint));
    let address = address.split(['?', '#']).next().unwrap_or_default();
    let host = address.rsplit_once(':').map_or(address, |(host, _)| host);
    let host = host.trim_start_matches('[').trim_end_matches(']');
    host == "localhost" || host.parse().is_ok_and(|ip: IpAddr| ip.is_loopback())
}

/// Whether a router of this configuration lets in only those who know a password.
fn asks_for_password(config: &Config) -> bool {
    let dictionary = config.get_json("transport/auth/usrpwd/dictionary_file");
    dictionary.is_ok_and(|file| file != "null" && file != "\"\"")
}

/// What zenoh says, without the lines of its source that it adds.
fn said(error: &zenoh::Error) -> String {
    let error = error.to_string();
    let end = error.find(" at /").unwrap_or(error.len());
    error[..end].to_owned()
}

/// The keys of a car.
#[derive(Clone, Debug)]
pub(crate) struct Keys(String);

impl Keys {
    pub(crate) fn of(name: &str) -> Result<Self, ZenohError> {
        let is_allowed = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        if name.is_empty() || !name.chars().all(is_allowed) {
            return Err(ZenohError::Other(format!(
                "the name of the car is {name:?}: it must be of letters, digits, - and _"
            )));
        }
        Ok(Self(format!("singletrack/{name}")))
    }

    /// The key that is alive while a process serves the car.
    pub(crate) fn server(&self, process: &str) -> String {
        format!("{}/server/{process}", self.0)
    }

    /// The key that is alive while the client of a connection is connected.
    pub(crate) fn client(&self, connection: &str) -> String {
        format!("{}/client/{connection}", self.0)
    }

    /// The key that is alive while the daemon is connected to a client.
    pub(crate) fn daemon(&self, connection: &str) -> String {
        format!("{}/daemon/{connection}", self.0)
    }

    /// The key of what the client of a connection sends.
    pub(crate) fn up(&self, connection: &str) -> String {
        format!("{}/up/{connection}", self.0)
    }

    /// The key of what the daemon sends to the client of a connection.
    pub(crate) fn down(&self, connection: &str) -> String {
        format!("{}/down/{connection}", self.0)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may fail")]
mod tests {
    use super::*;

    #[test]
    fn a_name_that_would_be_a_pattern_of_keys_is_refused() {
        for name in ["", "*", "a/b", "a b", "$*", "é"] {
            let error = Keys::of(name).unwrap_err().to_string();
            assert!(error.contains(&format!("{name:?}")), "{error}");
        }
        let keys = Keys::of("car-1_a").unwrap();
        assert_eq!(keys.up("7"), "singletrack/car-1_a/up/7");
    }

    #[test]
    fn a_router_beyond_loopback_asks_for_a_password_or_is_refused() {
        for endpoint in [
            "tcp/[::]:7447",
            "tcp/0.0.0.0:7447",
            "tcp/192.168.1.30:7447",
            "tcp/car.local:7447",
            "tcp/127.0.0.1.example.org:7447",
            "udp/[fe80::1]:7447#iface=lo",
        ] {
            assert!(!is_loopback(endpoint), "{endpoint}");
            let error = route(None, endpoint, false).unwrap_err().to_string();
            for part in [endpoint, "--without-password", "dictionary_file"] {
                assert!(error.contains(part), "{error}");
            }
        }
        for endpoint in ["tcp/127.0.0.1:7447", "tcp/[::1]:7447", "tcp/localhost:0"] {
            assert!(is_loopback(endpoint), "{endpoint}");
        }
        let mut config = Config::default();
        assert!(!asks_for_password(&config));
        let key = "transport/auth/usrpwd/dictionary_file";
        config.insert_json5(key, "\"/etc/zenoh/users\"").unwrap();
        assert!(asks_for_password(&config));
    }

    #[test]
    fn an_endpoint_or_a_file_that_is_none_is_named_with_what_to_write() {
        let error = configuration(None, "client", "connect", "192.168.1.30").unwrap_err();
        let error = error.to_string();
        assert!(error.contains("write tcp/192.168.1.30:7447"), "{error}");
        assert!(!error.contains(".rs:"), "{error}");
        let file = Path::new("/nonexistent/zenoh.json5");
        let error = configuration(Some(file), "client", "connect", "tcp/[::1]:1").unwrap_err();
        assert!(
            error.to_string().starts_with("/nonexistent/zenoh.json5: "),
            "{error}"
        );
    }
}
