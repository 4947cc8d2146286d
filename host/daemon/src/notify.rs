//! Notifications for the service manager: the datagrams of `sd_notify(3)`.
//!
//! systemd gives its socket in `NOTIFY_SOCKET`, and in `WATCHDOG_USEC` the longest time
//! between two signs of life before it kills the service. Without these variables
//! nothing is sent.

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

/// The start, or a reload, is complete.
pub const READY: &str = "READY=1\n";

/// The shutdown has begun.
pub const STOPPING: &str = "STOPPING=1\n";

/// The longest time that a notification may block if the manager does not read its
/// socket.
const SEND_TIMEOUT: Duration = Duration::from_millis(50);

/// The service manager that started this process, if one did.
#[derive(Debug, Default)]
pub struct ServiceManager {
    peer: Option<(UnixDatagram, SocketAddr)>,
    /// The longest time between two signs of life; `None` without a watchdog.
    pub watchdog: Option<Duration>,
}

impl ServiceManager {
    /// The manager named by the environment; one that is never notified if there is none.
    ///
    /// # Errors
    ///
    /// A variable of the environment is invalid, or the socket can't be opened.
    pub fn from_environment() -> Result<Self, String> {
        Self::new(
            env::var_os("NOTIFY_SOCKET"),
            env::var_os("WATCHDOG_USEC"),
            env::var_os("WATCHDOG_PID"),
            process::id(),
        )
    }

    /// `process` is this process: a watchdog with another `WATCHDOG_PID` is ignored.
    fn new(
        socket: Option<OsString>,
        watchdog_usec: Option<OsString>,
        watchdog_pid: Option<OsString>,
        process: u32,
    ) -> Result<Self, String> {
        let Some(name) = socket.filter(|name| !name.is_empty()) else {
            return Ok(Self::default());
        };
        let is_ours = watchdog_pid
            .is_none_or(|pid| pid.to_str().and_then(|pid| pid.parse().ok()) == Some(process));
        let watchdog = match watchdog_usec.filter(|_| is_ours) {
            None => None,
            Some(text) => match text.to_str().and_then(|text| text.parse().ok()) {
                Some(microseconds @ 1..) => Some(Duration::from_micros(microseconds)),
                _ => {
                    return Err(format!(
                        "WATCHDOG_USEC is {text:?}: it must be a number of microseconds above 0"
                    ));
                }
            },
        };
        let address = address(&name)?;
        let open = || -> io::Result<UnixDatagram> {
            let socket = UnixDatagram::unbound()?;
            socket.set_write_timeout(Some(SEND_TIMEOUT))?;
            Ok(socket)
        };
        let socket = open().map_err(|error| format!("NOTIFY_SOCKET {name:?}: {error}"))?;
        Ok(Self {
            peer: Some((socket, address)),
            watchdog,
        })
    }

    /// A new status line; `state` comes before it.
    pub fn status(&self, state: &str, status: &str) {
        self.send(&format!("{state}STATUS={}", one_line(status)));
    }

    /// A reload of the configuration began at `monotonic_ns` of `CLOCK_MONOTONIC`.
    pub fn reloading(&self, monotonic_ns: u64) {
        self.send(&reloading(monotonic_ns));
    }

    /// A sign of life for the watchdog.
    pub fn alive(&self) {
        self.send("WATCHDOG=1");
    }

    fn send(&self, state: &str) {
        if let Some((socket, address)) = &self.peer
            && let Err(error) = socket.send_to_addr(state.as_bytes(), address)
        {
            // The next notification repeats the state; no reason to stop the car.
            tracing::debug!(%error, state, "the service manager was not notified");
        }
    }
}

fn address(name: &OsStr) -> Result<SocketAddr, String> {
    let address = match name.as_bytes() {
        [b'@', abstract_name @ ..] => SocketAddr::from_abstract_name(abstract_name),
        [b'/', ..] => SocketAddr::from_pathname(name),
        _ => {
            return Err(format!(
                "NOTIFY_SOCKET is {name:?}: only /paths and @abstract names are known; \
                 is it set by systemd, or left over?"
            ));
        }
    };
    address.map_err(|error| format!("NOTIFY_SOCKET {name:?}: {error}"))
}

/// The notification of a reload. The time needs 64 bits: microseconds of
/// `CLOCK_MONOTONIC` exceed 2^31 after 36 minutes and 2^32 after 72.
fn reloading(monotonic_ns: u64) -> String {
    format!("RELOADING=1\nMONOTONIC_USEC={}", monotonic_ns / 1_000)
}

/// The text without line breaks: a line break would begin another assignment.
fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// When to send a sign of life: twice per interval of the manager, and only while the
/// control thread ticks.
#[derive(Clone, Copy, Debug)]
pub struct Watchdog {
    period_ns: u64,
    due_ns: u64,
    ticks: u64,
}

impl Watchdog {
    /// A watchdog for a manager that allows `interval` between two signs of life.
    pub fn new(interval: Duration) -> Self {
        Self {
            period_ns: u64::try_from(interval.as_nanos() / 2).unwrap_or(u64::MAX),
            due_ns: 0,
            ticks: 0,
        }
    }

    /// Whether to send one at `now_ns`, with `ticks` ticks done. Without a tick since the
    /// last one, none is due.
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
        // A 32-bit timespec, as clock_gettime fills it in.
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
    fn signs_of_life_are_due_twice_per_interval_while_ticks_pass() {
        let mut watchdog = Watchdog::new(Duration::from_micros(200));
        let due: Vec<u64> = (1..=100)
            .filter(|tick| watchdog.is_due(tick * 10_000, *tick))
            .collect();
        assert_eq!(due, [1, 11, 21, 31, 41, 51, 61, 71, 81, 91]);
    }

    #[test]
    fn no_sign_of_life_is_due_while_the_controller_hangs() {
        let mut watchdog = Watchdog::new(Duration::from_micros(200));
        assert!(!watchdog.is_due(0, 0), "no tick at all");
        assert!(watchdog.is_due(1, 1));
        for now_ns in 2..1_000_000 {
            assert!(!watchdog.is_due(now_ns, 1), "at {now_ns}");
        }
        assert!(watchdog.is_due(1_000_000, 2));
    }

    #[test]
    fn a_status_is_always_one_assignment() {
        assert_eq!(one_line("a\nWATCHDOG=1\r\n\tb"), "a WATCHDOG=1 b");
    }

    #[test]
    fn the_watchdog_of_another_process_is_ignored() {
        let manager = |usec: &str, pid: Option<&str>| {
            ServiceManager::new(
                Some("@example".into()),
                Some(usec.into()),
                pid.map(Into::into),
                7,
            )
        };
        let interval = |manager: Result<ServiceManager, _>| manager.ok()?.watchdog;
        let two_seconds = Some(Duration::from_secs(2));
        assert_eq!(interval(manager("2000000", None)), two_seconds);
        assert_eq!(interval(manager("2000000", Some("7"))), two_seconds);
        assert_eq!(interval(manager("2000000", Some("8"))), None);
        for wrong in ["", "0", "-1", "2s"] {
            let error = manager(wrong, None).unwrap_err();
            assert!(error.contains("WATCHDOG_USEC"), "{error}");
        }
    }

    #[test]
    fn an_unknown_kind_of_address_is_named() {
        let error = ServiceManager::new(Some("vsock:2:1".into()), None, None, 7).unwrap_err();
        assert!(error.to_string().contains("vsock:2:1"), "{error}");
        assert!(
            ServiceManager::new(None, Some("1".into()), None, 7)
                .unwrap()
                .watchdog
                .is_none()
        );
    }
}
