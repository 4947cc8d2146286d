//! The two sides: on the computer of a car, clients elsewhere are connected to the daemon; on another
//! computer there is a socket for each car that is reached by a router.

use std::{
    collections::{BTreeMap, HashMap},
    fs, io,
    os::unix::net::{UnixListener, UnixStream},
    path::{Path, PathBuf},
    sync::mpsc::sync_channel,
    thread,
    time::Duration,
};

use clap::Args;
use rustix::{fs::Mode, process::umask};
use singletrack_api::Fleet;
use zenoh::{
    Session, Wait as _,
    sample::{Sample, SampleKind},
};

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
            match connect_client(&session, &keys, id, &car.socket) {
                Ok(cut) => drop(open.insert(id.to_owned(), cut)),
                Err(error) => tracing::warn!(client = id, "not connected: {error}"),
            }
        }
    }
    Ok(())
}

/// Connects a client to the daemon, and returns what cuts it off when the client is gone.
fn connect_client(session: &Session, keys: &Keys, id: &str, socket: &Path) -> zenoh::Result<Cut> {
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

/// The longest wait for the daemon of a car, as a client waits for an answer.
const PATIENCE: Duration = Duration::from_secs(1);

/// Offers the sockets until the process ends.
pub(crate) fn offer(config: Option<&Path>, file: &Path) -> Result<(), ZenohError> {
    let fleet = Fleet::read(file)?;
    let mut offered = Vec::new();
    for car in &fleet.cars {
        if let Some(router) = &car.router {
            offered.push((car, router, Keys::of(&car.name)?, listen(&car.socket())?));
        }
    }
    if offered.is_empty() {
        return Err(ZenohError::Other(format!(
            "{}: no car has a router: write router = \"tcp/192.168.1.30:7447\"",
            file.display()
        )));
    }
    let mut sessions = BTreeMap::new();
    for (car, router, keys, listener) in offered {
        if !sessions.contains_key(router) {
            sessions.insert(router, join(config, router)?);
        }
        if let Some(session) = sessions.get(router).cloned() {
            tracing::info!(car = car.name, socket = %car.socket().display(), "offered");
            thread::spawn(move || accept(&session, &keys, &listener));
        }
    }
    loop {
        thread::park();
    }
}

/// Listens for programs of this user.
fn listen(path: &Path) -> Result<UnixListener, ZenohError> {
    let listen = || {
        if UnixStream::connect(path).is_ok() {
            return Err(io::ErrorKind::AddrInUse.into());
        }
        match fs::remove_file(path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        let before = umask(Mode::RWXG | Mode::RWXO);
        let listener = UnixListener::bind(path);
        umask(before);
        listener
    };
    listen().map_err(|error| {
        let path = path.display();
        ZenohError::Other(format!(
            "can't listen at {path}: {error}; give the car a socket of yours in the fleet's file, such \
             as /tmp/car2.sock"
        ))
    })
}

fn accept(session: &Session, keys: &Keys, listener: &UnixListener) {
    for number in 0_u64.. {
        let id = format!("{}-{number}", session.zid());
        match listener.accept() {
            Ok((stream, _)) => {
                let (session, keys) = (session.clone(), keys.clone());
                thread::spawn(move || {
                    if let Err(error) = connect_program(&session, &keys, &id, stream) {
                        tracing::warn!(client = id, "ended: {error}");
                    }
                });
            }
            Err(error) => {
                // Out of files: those that end make room.
                tracing::warn!("can't accept a client: {error}");
                thread::sleep(PATIENCE);
            }
        }
    }
}

/// Connects a program to the daemon of a car until one of them ends.
fn connect_program(
    session: &Session,
    keys: &Keys,
    id: &str,
    stream: UnixStream,
) -> zenoh::Result<()> {
    let (heard, daemon) = sync_channel(1);
    let (up, down) = (keys.up(id), keys.down(id));
    let connection = Connection::declare(session, stream, up, down)?;
    let (cut, gone) = (connection.cut(), connection.cut());
    let liveliness = session.liveliness();
    let _daemon = liveliness
        .declare_subscriber(keys.daemon(id))
        .callback(move |change: Sample| match change.kind() {
            SampleKind::Put => drop(heard.try_send(())),
            SampleKind::Delete => gone.off(),
        })
        .wait()?;
    let _client = liveliness.declare_token(keys.client(id)).wait()?;
    if daemon.recv_timeout(PATIENCE).is_err() {
        cut.off();
        return Err("the daemon of the car is not reached".into());
    }
    Ok(connection.carry()?)
}
