//! On the computer of a car: connects clients elsewhere to the daemon.

use std::{
    collections::HashMap,
    path::{Path, PathBuf},
    thread,
};

use clap::Args;
use zenoh::{Session, Wait as _, sample::SampleKind};

use crate::{
    connection::{Connection, Cut},
    network::{Keys, ZenohError, join},
};

/// Connections at once: more than a daemon serves, whose refusal then says why.
const CONNECTIONS: usize = 64;

#[derive(Debug, Args)]
pub(crate) struct Car {
    /// Name of the car, as in the file of the fleet
    #[arg(long)]
    pub(crate) name: String,
    /// The daemon's control socket
    #[arg(
        long,
        value_name = "PATH",
        env = "SINGLETRACK_SOCKET",
        hide_env_values = true,
        default_value = "/run/singletrackd/control.sock"
    )]
    pub(crate) socket: PathBuf,
    /// The router, such as tcp/192.168.1.30:7447
    #[arg(long, value_name = "ENDPOINT")]
    pub(crate) router: String,
}

/// Serves a car until the process ends.
pub(crate) fn serve(config: Option<&Path>, car: &Car) -> Result<(), ZenohError> {
    let keys = Keys::of(&car.name)?;
    let session = join(config, &car.router)?;
    let liveliness = session.liveliness();
    let me = keys.server(&session.zid().to_string());
    let _served = liveliness.declare_token(&me).wait()?;
    // After this one is declared: of two that start at once, one sees the other.
    for reply in liveliness.get(keys.server("*")).wait()? {
        if reply.result().is_ok_and(|it| it.key_expr().as_str() != me) {
            return Err(ZenohError::Other(format!(
                "another singletrack-zenoh serves a car with the name {} at this router: give each \
                 car a name of its own",
                car.name
            )));
        }
    }
    let clients = liveliness.declare_subscriber(keys.client("*"));
    let clients = clients.history(true).wait()?;
    tracing::info!(car = car.name, socket = %car.socket.display(), "serving");
    let mut open = HashMap::new();
    while let Ok(change) = clients.recv() {
        let key = change.key_expr().as_str();
        let Some((_, id)) = key.rsplit_once('/') else {
            continue;
        };
        if change.kind() == SampleKind::Delete {
            tracing::info!(client = id, "gone");
            if let Some(cut) = open.remove(id) {
                Cut::off(&cut);
            }
        } else if open.len() >= CONNECTIONS {
            tracing::warn!(client = id, "refused: {CONNECTIONS} clients are connected");
        } else if !open.contains_key(id) {
            match connect(&session, &keys, id, &car.socket) {
                Ok(cut) => drop(open.insert(id.to_owned(), cut)),
                Err(error) => tracing::warn!(client = id, "not connected: {error}"),
            }
        }
    }
    Ok(())
}

/// Connects a client to the daemon, and returns what cuts it off when the client is gone.
fn connect(session: &Session, keys: &Keys, id: &str, socket: &Path) -> zenoh::Result<Cut> {
    let stream = singletrack_api::connect(socket)?;
    let (down, up) = (keys.down(id), keys.up(id));
    let connection = Connection::declare(session, stream, down, up)?;
    let cut = connection.cut();
    // The client begins when it sees this, and all is declared.
    let liveliness = session.liveliness();
    let token = liveliness.declare_token(keys.daemon(id)).wait()?;
    thread::Builder::new().spawn(move || {
        if let Err(error) = connection.carry() {
            tracing::debug!("a connection ended: {error}");
        }
        drop(token);
    })?;
    tracing::info!(client = id, "connected");
    Ok(cut)
}
