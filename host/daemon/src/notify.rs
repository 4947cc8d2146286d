//! What the service manager is told: the datagrams of `sd_notify(3)`.
//!
//! systemd names its socket in `NOTIFY_SOCKET`, and in `WATCHDOG_USEC` how long
//! it waits for a sign of life before it kills the service. Started by hand,
//! nobody is told anything.

use std::{
    env,
    ffi::{OsStr, OsString},
    io,
    os::{
        linux::net::SocketAddrExt,
        unix::{
            ffi::OsStrExt,
            net::{SocketAddr, UnixDatagram},
        },
    },
    process,
    time::Duration,
};

/// How long a manager that does not read its socket may hold up who tells it
/// something. Without a limit it would be forever.
const PATIENCE: Duration = Duration::from_millis(50);

/// Why the service manager can't be told anything.
#[derive(Debug, thiserror::Error)]
pub enum NotifyError {
    /// Neither a path nor an abstract name.
    #[error(
        "NOTIFY_SOCKET is {0:?}: only /paths and @abstract names are known; \
         is it set by systemd, or left over?"
    )]
    Address(OsString),
    /// The system says no.
    #[error("NOTIFY_SOCKET {0:?}: {1}")]
    Socket(OsString, io::Error),
    /// No time.
    #[error("WATCHDOG_USEC is {0:?}: it must be a number of microseconds above 0")]
    Watchdog(OsString),
}

/// The service manager that started this process, if one did.
#[derive(Debug, Default)]
pub struct ServiceManager {
    peer: Option<(UnixDatagram, SocketAddr)>,
    watchdog: Option<Duration>,
}

impl ServiceManager {
    /// The one that the environment names.
    ///
    /// # Errors
    ///
    /// What it names makes no sense.
    pub fn from_environment() -> Result<Self, NotifyError> {
        Self::new(
            env::var_os("NOTIFY_SOCKET"),
            env::var_os("WATCHDOG_USEC"),
            env::var_os("WATCHDOG_PID"),
            process::id(),
        )
    }

    /// `process`: this one; a watchdog that is meant for another is not ours.
    fn new(
        socket: Option<OsString>,
        watchdog_usec: Option<OsString>,
        watchdog_pid: Option<OsString>,
        process: u32,
    ) -> Result<Self, NotifyError> {
        let Some(name) = socket.filter(|name| !name.is_empty()) else {
            return Ok(Self::default());
        };
        let is_ours = watchdog_pid
            .is_none_or(|pid| pid.to_str().and_then(|pid| pid.parse().ok()) == Some(process));
        let watchdog = match watchdog_usec.filter(|_| is_ours) {
            None => None,
            Some(text) => match text.to_str().and_then(|text| text.parse().ok()) {
                Some(microseconds @ 1..) => Some(Duration::from_micros(microseconds)),
                _ => return Err(NotifyError::Watchdog(text)),
            },
        };
        let address = address(&name)?;
        let open = || -> io::Result<UnixDatagram> {
            let socket = UnixDatagram::unbound()?;
            socket.set_write_timeout(Some(PATIENCE))?;
            Ok(socket)
        };
        let socket = open().map_err(|error| NotifyError::Socket(name, error))?;
        Ok(Self {
            peer: Some((socket, address)),
            watchdog,
        })
    }

    /// How long it waits for a sign of life; none if it does not.
    #[must_use]
    pub const fn watchdog(&self) -> Option<Duration> {
        self.watchdog
    }

    /// Everything runs.
    pub fn ready(&self, status: &str) {
        self.tell(&format!("READY=1\nSTATUS={}", one_line(status)));
    }

    /// How it is going.
    pub fn status(&self, status: &str) {
        self.tell(&format!("STATUS={}", one_line(status)));
    }

    /// The configuration is read anew, from `monotonic_ns` on.
    pub fn reloading(&self, monotonic_ns: u64) {
        self.tell(&reloading(monotonic_ns));
    }

    /// The end has begun.
    pub fn stopping(&self, status: &str) {
        self.tell(&format!("STOPPING=1\nSTATUS={}", one_line(status)));
    }

    /// A sign of life.
    pub fn alive(&self) {
        self.tell("WATCHDOG=1");
    }

    fn tell(&self, state: &str) {
        if let Some((socket, address)) = &self.peer
            && let Err(error) = socket.send_to_addr(state.as_bytes(), address)
        {
            // It is told again, or it has gone: nothing to stop a car for.
            tracing::debug!(%error, state, "the service manager does not listen");
        }
    }
}

fn address(name: &OsStr) -> Result<SocketAddr, NotifyError> {
    let address = match name.as_bytes() {
        [b'@', abstract_name @ ..] => SocketAddr::from_abstract_name(abstract_name),
        [b'/', ..] => SocketAddr::from_pathname(name),
        _ => return Err(NotifyError::Address(name.to_owned())),
    };
    address.map_err(|error| NotifyError::Socket(name.to_owned(), error))
}

/// In 64 bits: microseconds of `CLOCK_MONOTONIC` pass 2^31 after 36 minutes and
/// 2^32 after 72.
fn reloading(monotonic_ns: u64) -> String {
    format!("RELOADING=1\nMONOTONIC_USEC={}", monotonic_ns / 1_000)
}

/// A line break would begin another assignment.
fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// When to give a sign of life: twice in the manager's patience, and only while
/// the controller ticks.
#[derive(Clone, Copy, Debug)]
pub struct Watchdog {
    period_ns: u64,
    due_ns: u64,
    ticks: u64,
}

impl Watchdog {
    /// `patience`: how long the manager waits.
    #[must_use]
    pub fn new(patience: Duration) -> Self {
        Self {
            period_ns: u64::try_from(patience.as_nanos() / 2).unwrap_or(u64::MAX),
            due_ns: 0,
            ticks: 0,
        }
    }

    /// Whether to give one at `now_ns`, after `ticks` ticks. None is due without
    /// a tick since the last.
    pub const fn is_due(&mut self, now_ns: u64, ticks: u64) -> bool {
        if now_ns < self.due_ns || ticks == self.ticks {
            return false;
        }
        self.due_ns = now_ns.saturating_add(self.period_ns);
        self.ticks = ticks;
        true
    }
}

#[cfg(test)]
mod tests {
    use crate::clock::nanoseconds;

    use super::*;

    #[test]
    fn monotonic_microseconds_are_right_beyond_36_and_72_minutes_on_32_bits() {
        // As clock_gettime fills in a 32-bit timespec.
        for (seconds, nanoseconds_part, text) in [
            (0_i32, 0_i32, "0"),
            (1, 999, "1000000"),
            (2_147, 483_647_999, "2147483647"),
            (2_147, 483_648_000, "2147483648"),
            (4_294, 967_295_999, "4294967295"),
            (4_294, 967_296_000, "4294967296"),
            (i32::MAX, 999_999_999, "2147483647999999"),
        ] {
            assert_eq!(
                reloading(nanoseconds(seconds, nanoseconds_part)),
                format!("RELOADING=1\nMONOTONIC_USEC={text}")
            );
        }
    }

    #[test]
    fn signs_of_life_come_twice_in_the_patience_while_ticks_pass() {
        let mut watchdog = Watchdog::new(Duration::from_micros(200));
        let due: Vec<u64> = (1..=100)
            .filter(|tick| watchdog.is_due(tick * 10_000, *tick))
            .collect();
        assert_eq!(due, [1, 11, 21, 31, 41, 51, 61, 71, 81, 91]);
    }

    #[test]
    fn a_controller_that_hangs_gives_no_sign_of_life_and_one_that_goes_on_does() {
        let mut watchdog = Watchdog::new(Duration::from_micros(200));
        assert!(!watchdog.is_due(0, 0), "no tick at all");
        assert!(watchdog.is_due(1, 1));
        for now_ns in 2..1_000_000 {
            assert!(!watchdog.is_due(now_ns, 1), "at {now_ns}");
        }
        assert!(watchdog.is_due(1_000_000, 2));
    }

    #[test]
    fn a_status_is_one_assignment_whatever_is_in_it() {
        assert_eq!(one_line("a\nWATCHDOG=1\r\n\tb"), "a WATCHDOG=1 b");
    }

    #[test]
    fn a_watchdog_of_another_process_is_not_ours() {
        let manager = |usec: &str, pid: Option<&str>| {
            ServiceManager::new(
                Some("@nobody".into()),
                Some(usec.into()),
                pid.map(Into::into),
                7,
            )
        };
        let patience = |manager: Result<ServiceManager, _>| manager.ok()?.watchdog();
        let two_seconds = Some(Duration::from_secs(2));
        assert_eq!(patience(manager("2000000", None)), two_seconds);
        assert_eq!(patience(manager("2000000", Some("7"))), two_seconds);
        assert_eq!(patience(manager("2000000", Some("8"))), None);
        for wrong in ["", "0", "-1", "2s"] {
            let error = manager(wrong, None).unwrap_err().to_string();
            assert!(error.contains("WATCHDOG_USEC"), "{error}");
        }
    }

    #[test]
    fn an_address_that_is_not_known_is_named() {
        let error = ServiceManager::new(Some("vsock:2:1".into()), None, None, 7).unwrap_err();
        assert!(error.to_string().contains("vsock:2:1"), "{error}");
        assert!(
            ServiceManager::new(None, Some("1".into()), None, 7)
                .unwrap()
                .watchdog()
                .is_none()
        );
    }
}
