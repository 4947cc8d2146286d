//! The token of the control socket on TCP: as the first line of a client, and its file.

use std::path::{Path, PathBuf};

use serde::Deserialize;
use singletrack_access::Token;

use singletrack_api::SOCKET_VERSION;

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

#[cfg(test)]
mod tests {
    use std::{fs, net::SocketAddr};

    use serde_json::Value;
    use singletrack_access::TokenFile;

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
        assert!(given(r#"{"version":2,"command":"token","token":"RIGHT"}"#));
        for line in [
            "",
            "RIGHT",
            r#"{"version":2,"command":"token"}"#,
            r#"{"version":2,"command":"token","token":""}"#,
            r#"{"version":2,"command":"token","token":"RIGHTf"}"#,
            r#"{"version":2,"command":"token","token":" RIGHT"}"#,
            r#"{"version":2,"command":"token","token":null}"#,
            r#"{"version":1,"command":"token","token":"RIGHT"}"#,
            r#"{"version":2,"command":"stop","token":"RIGHT"}"#,
            r#"{"version":2,"command":"token","token":"","token":"RIGHT"}"#,
            r#"POST / {"version":2,"command":"token","token":"RIGHT"}"#,
        ] {
            assert!(!given(line), "{line}");
        }
        let cut = r#"{"version":2,"command":"token","token":"CUT"}"#.replace("CUT", &right[1..]);
        assert!(!given(&cut));
        let upper = right.to_ascii_uppercase();
        let upper = format!(r#"{{"version":2,"command":"token","token":"{upper}"}}"#);
        assert!(!given(&upper));
    }
}
