//! `[record]`, `[state]`, `[socket]`: where the daemon writes and listens; `[live]` and `[page]`: where
//! its viewers listen.

use std::{
    net::{IpAddr, Ipv4Addr},
    path::PathBuf,
};

use singletrack_settings::section;

use super::{ConfigError, refuse_if};

section! {
    /// The record of every tick, one file for each start of the daemon.
    "record", restart => pub RecordSection: Eq;
    [default];

    /// Whether ticks are recorded.
    enabled: bool = true;
    /// Folder of the records; it is created if it does not exist.
    directory: PathBuf = PathBuf::from("/var/log/singletrackd");
    /// With less free space on the disk of that folder, in MB, `arm` and the status warn that the record
    /// will end; 0 never warns. Records are never deleted.
    min_free_mb: u32 = 500;
}

section! {
    /// What the daemon remembers from one start to the next: the configurations that a car has
    /// proved on its first metre.
    "state", restart => pub StateSection: Eq;
    [default];

    /// Folder of the state file. If it can't be written, the daemon forgets what was proved,
    /// and the next drive begins slowly.
    directory: PathBuf = PathBuf::from("/var/lib/singletrackd");
}

section! {
    /// The control socket, for `singletrack status`, `arm`, `disarm`, `stop` and `dump live`.
    "socket", restart => pub SocketSection: Eq;
    [default];

    /// Whether the daemon listens on it.
    enabled: bool = true;
    /// Path of the socket; its folder is created if it does not exist.
    path: PathBuf = PathBuf::from("/run/singletrackd/control.sock");
    /// Port of 127.0.0.1 on which the daemon listens too, for programs that know no Unix
    /// sockets; 0 takes any free port. Clients give the token from the file `<path>.token`,
    /// which is open to the group of the socket. Left out, nothing listens.
    tcp_port: Option<u16> = None, example 8_766;
    /// Folder whose files a client may name as a reference; left out, that of the configuration.
    reference_folder: Option<PathBuf> = None, example PathBuf::from("/etc/singletrackd");
}

section! {
    /// The live view over WebSocket, which `singletrack live --config FILE` serves beside the daemon:
    /// Foxglove, Lichtblick and PlotJuggler connect to `ws://127.0.0.1:8765` and show the messages of
    /// the record as they are made. It accepts no commands.
    "live" => pub LiveSection: Copy, Eq;
    [default];

    /// Address on which it listens. There is no authentication; bind it to loopback only
    /// (`ssh -L 8765:127.0.0.1:8765` forwards it to a desk).
    address: IpAddr = IpAddr::V4(Ipv4Addr::LOCALHOST);
    /// Port on which it listens; 0 takes any free port, which the command prints.
    port: u16 = 8_765;
}

section! {
    /// The page for a browser, which `singletrack page --config FILE` serves beside the daemon: the car
    /// from above, mode and reason in words, ages, battery and charts, at `http://127.0.0.1:8767`. It
    /// accepts no commands.
    "page" => pub PageSection: Eq;
    [default];

    /// Address on which it listens. Beyond loopback it needs `token_file`.
    address: IpAddr = IpAddr::V4(Ipv4Addr::LOCALHOST);
    /// Port on which it listens; 0 takes any free port, which the command prints.
    port: u16 = 8_767;
    /// File to which the command writes a new token at every start, open to the group. Browsers
    /// then give it in the address: `http://ADDRESS:PORT/?token=TOKEN`. Left out, no token is
    /// asked for.
    token_file: Option<PathBuf> = None, example PathBuf::from("/run/singletrack-page/token");
}

/// Capacity of the address of a Unix-domain socket, without the closing zero.
const LONGEST_SOCKET_PATH: usize = 107;

impl RecordSection {
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        let is_empty = self.enabled && self.directory.as_os_str().is_empty();
        let fix = "name a folder for the records, or set record.enabled = false";
        refuse_if(is_empty, "record.directory", "empty", fix)
    }
}

impl StateSection {
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        let is_empty = self.directory.as_os_str().is_empty();
        let fix = "name a folder for the state file";
        refuse_if(is_empty, "state.directory", "empty", fix)
    }
}

impl SocketSection {
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        let fits = (1..=LONGEST_SOCKET_PATH).contains(&self.path.as_os_str().len());
        let fix = format!(
            "it must be 1 to {LONGEST_SOCKET_PATH} bytes long, or set socket.enabled = false"
        );
        let is_wrong = self.enabled && !fits;
        refuse_if(is_wrong, "socket.path", self.path.display(), fix)
    }
}

impl PageSection {
    /// Refuses a page that everyone could see.
    ///
    /// # Errors
    ///
    /// It listens beyond loopback without a token, or the file of the token has no name.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let token = self.token_file.as_ref();
        let is_open = token.is_none() && !self.address.is_loopback();
        let fix = "everyone who reaches it sees the page: set page.token_file, or listen on \
                   127.0.0.1 and forward the port with SSH";
        refuse_if(is_open, "page.address", self.address, fix)?;
        let is_empty = token.is_some_and(|path| path.as_os_str().is_empty());
        let fix = "name a file for the token, or leave the key out";
        refuse_if(is_empty, "page.token_file", "empty", fix)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn beyond_loopback_the_page_takes_a_token() {
        let page = |address: &str, token_file: Option<&str>| PageSection {
            address: address.parse().unwrap(),
            token_file: token_file.map(PathBuf::from),
            ..PageSection::default()
        };
        for address in ["127.0.0.1", "127.3.2.1", "::1"] {
            page(address, None).validate().unwrap();
        }
        for address in ["0.0.0.0", "192.168.1.2", "::"] {
            let error = page(address, None).validate().unwrap_err().to_string();
            for part in ["page.address", address, "page.token_file"] {
                assert!(error.contains(part), "{error}");
            }
            page(address, Some("/run/token")).validate().unwrap();
        }
        assert!(page("127.0.0.1", Some("")).validate().is_err());
    }
}
