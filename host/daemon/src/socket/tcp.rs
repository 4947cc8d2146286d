//! The control socket on TCP, whose connections begin with a token.

use std::{
    io,
    net::{Ipv4Addr, SocketAddr, TcpListener},
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};

use serde::Deserialize;
use singletrack_api::access::{Token, TokenFile, WaitingRoom, linger};
use singletrack_api::{Answer, Code, SOCKET_VERSION};
use tokio::{
    io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt},
    time::{sleep, timeout},
};

use super::stream::{Connection, send};

/// The first line of a client.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FirstLine {
    version: u32,
    command: String,
    token: String,
}

/// Whether a line gives this token.
pub(super) fn is_given_by(token: &Token, line: &[u8]) -> bool {
    serde_json::from_slice::<FirstLine>(line).is_ok_and(|line| {
        line.version == SOCKET_VERSION && line.command == "token" && token.is(&line.token)
    })
}

/// The place of the token of the daemon that listens on `socket`.
pub(super) fn token_path(socket: &Path) -> PathBuf {
    let mut path = socket.as_os_str().to_owned();
    path.push(".token");
    path.into()
}

/// The largest number of connections at a time that have not given the token. They take no place
/// of a client who may connect, and a newer one takes the place of the oldest.
const STRANGERS: usize = 16;

/// The longest wait for the first line, and its longest length in bytes.
const FIRST_LINE_TIMEOUT: Duration = Duration::from_secs(2);
const LONGEST_FIRST_LINE: u64 = 256;

/// From a wrong token to its answer.
const REFUSAL_DELAY: Duration = Duration::from_millis(500);

/// A listening port, its token, and the file of the token.
#[derive(Debug)]
pub(super) struct BoundPort {
    pub(super) listener: TcpListener,
    pub(super) gate: Arc<Gate>,
    pub(super) file: TokenFile,
}

/// Lets those through who know the token.
#[derive(Debug)]
pub(super) struct Gate {
    token: Token,
    token_path: PathBuf,
    strangers: WaitingRoom,
}

impl BoundPort {
    /// Listens on `port` of 127.0.0.1, and writes the token beside the Unix socket `beside`.
    pub(super) fn bind(port: u16, beside: &Path) -> Result<Self, String> {
        let during =
            |action: &'static str| move |error: io::Error| format!("can't {action}: {error}");
        let listener =
            TcpListener::bind((Ipv4Addr::LOCALHOST, port)).map_err(during("listen on its port"))?;
        listener
            .set_nonblocking(true)
            .map_err(during("make it non-blocking"))?;
        let address = listener.local_addr().map_err(during("read its port"))?;
        let token = Token::random().map_err(during("make a token"))?;
        let token_path = token_path(beside);
        let file = TokenFile::create(token_path.clone(), address, &token)
            .map_err(during("write the file of the token"))?;
        tracing::info!(%address, token = %token_path.display(), "control socket on TCP");
        Ok(Self {
            listener,
            gate: Arc::new(Gate::new(token, token_path)),
            file,
        })
    }
}

impl Gate {
    fn new(token: Token, token_path: PathBuf) -> Self {
        Self {
            token,
            token_path,
            strangers: WaitingRoom::new(STRANGERS),
        }
    }

    /// Whether a client has given the token. The connection of any other one is to be closed.
    pub(super) async fn passes(
        &self,
        connection: &mut Connection,
        peer: SocketAddr,
    ) -> io::Result<bool> {
        let mut place = self.strangers.enter();
        let Connection { read, write } = connection;
        let mut line = Vec::new();
        let mut first = (&mut *read).take(LONGEST_FIRST_LINE);
        let first_line = timeout(FIRST_LINE_TIMEOUT, first.read_until(b'\n', &mut line));
        let Some(first_line) = place.until_lost(first_line).await else {
            return Ok(false);
        };
        let count = first_line.unwrap_or(Ok(0))?;
        if count > 0 && is_given_by(&self.token, &line) {
            send(write, &Answer::done()).await?;
            return Ok(true);
        }
        tracing::warn!(%peer, "a connection to the control socket on TCP without the token");
        if place.until_lost(sleep(REFUSAL_DELAY)).await.is_none() {
            return Ok(false);
        }
        let error = format!(
            "the first line must be {{\"version\":{SOCKET_VERSION},\"command\":\"token\",\
             \"token\":\"...\"}}, with the token from {}",
            self.token_path.display()
        );
        send(write, &Answer::failure(Code::Token, error)).await?;
        write.shutdown().await?;
        place.until_lost(linger(read)).await;
        Ok(false)
    }
}

#[cfg(test)]
mod tests {
    use std::{fs, net::SocketAddr};

    use serde_json::Value;
    use singletrack_api::access::TokenFile;

    use super::*;

    #[test]
    fn only_the_whole_token_in_its_own_command_is_right() {
        let folder = tempfile::tempdir().unwrap();
        let path = token_path(&folder.path().join("control.sock"));
        let address = SocketAddr::from(([127, 0, 0, 1], 8_766));
        let token = Token::random().unwrap();
        let _file = TokenFile::create(path.clone(), address, &token).unwrap();
        let content: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
        let right = content["token"].as_str().unwrap();
        let given = |line: &str| is_given_by(&token, line.replace("RIGHT", right).as_bytes());
        assert!(given(r#"{"version":3,"command":"token","token":"RIGHT"}"#));
        for line in [
            "",
            "RIGHT",
            r#"{"version":3,"command":"token"}"#,
            r#"{"version":3,"command":"token","token":""}"#,
            r#"{"version":3,"command":"token","token":"RIGHTf"}"#,
            r#"{"version":3,"command":"token","token":" RIGHT"}"#,
            r#"{"version":3,"command":"token","token":null}"#,
            r#"{"version":1,"command":"token","token":"RIGHT"}"#,
            r#"{"version":3,"command":"stop","token":"RIGHT"}"#,
            r#"{"version":3,"command":"token","token":"","token":"RIGHT"}"#,
            r#"POST / {"version":3,"command":"token","token":"RIGHT"}"#,
        ] {
            assert!(!given(line), "{line}");
        }
        let cut = r#"{"version":3,"command":"token","token":"CUT"}"#.replace("CUT", &right[1..]);
        assert!(!given(&cut));
        let upper = right.to_ascii_uppercase();
        let upper = format!(r#"{{"version":3,"command":"token","token":"{upper}"}}"#);
        assert!(!given(&upper));
    }
}
