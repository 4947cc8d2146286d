//! Who may connect to a server on TCP: tokens in files, and bounded places for connections that have yet
//! to send their first line.
//!
//! A newer connection takes the place of the oldest, so that those which send nothing keep nobody out,
//! and cost a bounded number of files.

use core::fmt;
use std::{
    collections::VecDeque,
    fs,
    io::{self, Write as _},
    net::{IpAddr, SocketAddr},
    os::unix::fs::{OpenOptionsExt, PermissionsExt},
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
    time::Duration,
};

use constant_time_eq::constant_time_eq;
use rustix::rand::{GetRandomFlags, getrandom};
use serde::Deserialize;
use serde_json::json;
use tokio::{
    io::{AsyncRead, AsyncReadExt as _, copy, sink},
    sync::oneshot::{Receiver, Sender, channel},
    time::timeout,
};

/// Random bytes of a token.
const BYTES: usize = 32;

/// More than the bytes of a file of a token.
const LONGEST_FILE: u64 = 512;

/// The owner may write, the group read: those who may connect to the Unix socket.
const PERMISSIONS: u32 = 0o640;

/// A random word that a client has to give, new at every start of the server.
pub struct Token(String);

// It must not get into a log.
impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Token(..)")
    }
}

impl Token {
    /// A new token.
    ///
    /// # Errors
    ///
    /// The system gives no random bytes.
    pub fn random() -> io::Result<Self> {
        let mut bytes = [0_u8; BYTES];
        // The system gives so few bytes at once or not at all.
        let count = getrandom(&mut bytes, GetRandomFlags::empty())?;
        if count != BYTES {
            return Err(io::Error::other("too few random bytes"));
        }
        Ok(Self(
            bytes.iter().map(|byte| format!("{byte:02x}")).collect(),
        ))
    }

    /// Whether `text` is this token. How long it takes does not depend on how much of a wrong token
    /// is right.
    pub fn is(&self, text: &str) -> bool {
        constant_time_eq(text.as_bytes(), self.0.as_bytes())
    }
}

/// The file with the address and the token, removed when this value is dropped.
#[derive(Debug)]
pub struct TokenFile(PathBuf);

/// What is in it.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(dead_code, reason = "a file with these keys is one of ours")]
struct Content {
    address: IpAddr,
    port: u16,
    token: String,
}

impl Drop for TokenFile {
    fn drop(&mut self) {
        // An error means that the file is gone already, or another one is there.
        let _ = remove_token_file(&self.0);
    }
}

/// Removes a file of a token, and no other file: a mistaken path costs nobody a file.
fn remove_token_file(path: &Path) -> io::Result<()> {
    let metadata = match fs::symlink_metadata(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        metadata => metadata?,
    };
    // Nothing is in one whose writer was killed.
    let is_ours = metadata.is_file()
        && metadata.len() <= LONGEST_FILE
        && (metadata.len() == 0 || serde_json::from_slice::<Content>(&fs::read(path)?).is_ok());
    if !is_ours {
        return Err(io::Error::other(
            "this file was there before and has no token in it; move it away, or choose another path",
        ));
    }
    fs::remove_file(path)
}

impl TokenFile {
    /// Writes the file for a server on `address`. Replaces the one that a killed server left.
    ///
    /// # Errors
    ///
    /// It can't be written, or a file without a token is there.
    pub fn create(path: PathBuf, address: SocketAddr, token: &Token) -> io::Result<Self> {
        remove_token_file(&path)?;
        // A new file and no link: it is the server's own from its first byte.
        let mut file = fs::OpenOptions::new()
            .write(true)
            .create_new(true)
            .mode(0o600)
            .open(&path)?;
        let made = Self(path);
        let content = json!({
            "address": address.ip(),
            "port": address.port(),
            "token": token.0,
        });
        if let Err(error) = file.write_all(format!("{content}\n").as_bytes()) {
            // It is new: what is in it is ours.
            let _ = fs::remove_file(&made.0);
            return Err(error);
        }
        file.set_permissions(fs::Permissions::from_mode(PERMISSIONS))?;
        Ok(made)
    }
}

/// The places, oldest first.
#[derive(Debug)]
pub struct WaitingRoom {
    places: usize,
    taken: Mutex<VecDeque<Sender<()>>>,
}

/// A place. It ends when this value is dropped.
#[derive(Debug)]
pub struct Place(Receiver<()>);

impl WaitingRoom {
    /// A room with this number of places.
    pub const fn new(places: usize) -> Self {
        Self {
            places,
            taken: Mutex::new(VecDeque::new()),
        }
    }

    /// Takes a place, that of the oldest if there is no other.
    pub fn enter(&self) -> Place {
        let mut taken = self.taken.lock().unwrap_or_else(PoisonError::into_inner);
        taken.retain(|place| !place.is_closed());
        while taken.len() >= self.places {
            taken.pop_front();
        }
        let (sender, place) = channel();
        taken.push_back(sender);
        Place(place)
    }
}

impl Place {
    /// What `first` gives; `None` if the place is lost before. What has arrived by then counts.
    pub async fn until_lost<T>(&mut self, first: impl Future<Output = T>) -> Option<T> {
        tokio::select! {
            biased;
            result = first => Some(result),
            _ = &mut self.0 => None,
        }
    }
}

/// The longest time, and the most bytes, for which what still comes is read and discarded.
const LINGER: Duration = Duration::from_millis(200);
const LINGER_BYTES: u64 = 65_536;

/// Reads and discards what a client still sends after its answer: a connection that is closed with
/// something unread is reset, and the answer is lost.
pub async fn linger(read: impl AsyncRead + Unpin) {
    let mut rest = read.take(LINGER_BYTES);
    let _ = timeout(LINGER, copy(&mut rest, &mut sink())).await;
}

#[cfg(test)]
mod tests {
    use std::future::{pending, ready};

    use serde_json::Value;

    use super::*;

    #[test]
    fn a_token_is_random_and_not_shown() {
        let [one, other] = [(); 2].map(|()| Token::random().unwrap());
        assert_ne!(one.0, other.0);
        assert_eq!(one.0.len(), 2 * BYTES);
        assert_eq!(format!("{one:?}"), "Token(..)");
    }

    #[test]
    fn the_file_of_a_dead_server_is_replaced_and_any_other_file_stays() {
        let folder = tempfile::tempdir().unwrap();
        let precious = folder.path().join("precious");
        fs::write(&precious, "precious").unwrap();
        let path = folder.path().join("token");
        let token = Token::random().unwrap();
        let address = SocketAddr::from(([127, 0, 0, 1], 8_766));
        let create = |path: &Path| TokenFile::create(path.to_owned(), address, &token);
        let error = create(&precious).unwrap_err().to_string();
        assert!(error.contains("has no token in it"), "{error}");
        assert_eq!(fs::read_to_string(&precious).unwrap(), "precious");
        // Nor is a link followed, to whatever it leads.
        std::os::unix::fs::symlink(&precious, &path).unwrap();
        create(&path).unwrap_err();
        fs::remove_file(&path).unwrap();
        std::mem::forget(create(&path).unwrap());
        let file = create(&path).unwrap();
        let mode = fs::symlink_metadata(&path).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, PERMISSIONS);
        let content: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
        assert_eq!(
            content,
            json!({"address": "127.0.0.1", "port": 8766, "token": token.0})
        );
        drop(file);
        assert!(!path.exists());
        let file = create(&path).unwrap();
        fs::write(&path, "precious").unwrap();
        drop(file);
        assert_eq!(fs::read_to_string(&path).unwrap(), "precious");
    }

    #[tokio::test]
    async fn a_newer_one_takes_the_place_of_the_oldest() {
        let room = WaitingRoom::new(3);
        let mut places: Vec<Place> = (0..3).map(|_| room.enter()).collect();
        // A place that was left is taken first.
        drop(places.remove(1));
        places.push(room.enter());
        places.push(room.enter());
        let lost = places.first_mut().unwrap();
        assert_eq!(lost.until_lost(ready(7)).await, Some(7));
        assert_eq!(lost.until_lost(pending::<()>()).await, None);
        for place in places.iter_mut().skip(1) {
            assert!(place.0.try_recv() == Err(tokio::sync::oneshot::error::TryRecvError::Empty));
        }
    }
}
