//! On another computer: a socket for each car that is reached by a router.

use std::{
    collections::BTreeMap,
    fs, io,
    os::unix::net::{UnixListener, UnixStream},
    path::Path,
    sync::mpsc::sync_channel,
    thread,
    time::Duration,
};

use rustix::{fs::Mode, process::umask};
use singletrack_api::Fleet;
use zenoh::{
    Session, Wait as _,
    sample::{Sample, SampleKind},
};

use crate::{
    connection::Connection,
    network::{Keys, ZenohError, join},
};

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
                    if let Err(error) = connect(&session, &keys, &id, stream) {
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
fn connect(session: &Session, keys: &Keys, id: &str, stream: UnixStream) -> zenoh::Result<()> {
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
