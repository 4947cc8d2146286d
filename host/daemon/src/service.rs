//! The main thread: handles signals and notifies the service manager until the daemon
//! ends.

use std::{
    path::PathBuf,
    process::ExitCode,
    time::{Duration, Instant},
};

use rustix::fs::{Mode, OFlags, open};
use singletrack_core::{ControlRequest, Stalled};
use tracing::{error, info, warn};

use crate::{
    Daemon,
    log::log_summary,
    monotonic_ns,
    notify::{READY, STOPPING, ServiceManager, Watchdog},
    system::{Signal, Signals},
};

/// The longest time from the first signal until the control thread has stopped the car
/// and ended.
const STOP_TIMEOUT: Duration = Duration::from_secs(4);

/// Interval at which the main thread checks the daemon.
const CHECK_INTERVAL: Duration = Duration::from_millis(10);

/// A daemon, its signals and its service manager.
pub(crate) struct Service {
    daemon: Daemon,
    /// The file of the configuration, for a reload.
    path: PathBuf,
    manager: ServiceManager,
    watchdog: Option<Watchdog>,
    /// The last status sent to the manager; `None` before it was notified that the
    /// daemon is ready.
    sent_status: Option<String>,
    /// When the first signal to end came.
    ending_since: Option<Instant>,
    /// Whether the process was started from a terminal.
    has_terminal: bool,
}

impl Service {
    pub(crate) fn new(daemon: Daemon, path: PathBuf, manager: ServiceManager) -> Self {
        Self {
            daemon,
            path,
            watchdog: manager.watchdog.map(Watchdog::new),
            manager,
            sent_status: None,
            ending_since: None,
            has_terminal: has_terminal(),
        }
    }

    /// Runs until a signal ends the daemon, or one of its threads ends by itself.
    pub(crate) fn run(mut self, signals: &Signals) -> ExitCode {
        while self.daemon.ended_thread().is_none() {
            // A stuck control thread must not keep the process alive.
            if self
                .ending_since
                .is_some_and(|begin| begin.elapsed() > STOP_TIMEOUT)
            {
                error!("the control thread does not end");
                break;
            }
            self.notify();
            let result = match signals.wait(CHECK_INTERVAL) {
                None => continue,
                Some(Signal::End(name)) => self.begin_end(name),
                // A closed terminal sends SIGHUP twice, from the shell and from the system:
                // the second one is not a second request to end.
                Some(Signal::Reload) if self.has_lost_terminal() => match self.ending_since {
                    None => self.begin_end("SIGHUP"),
                    Some(_) => Ok(()),
                },
                Some(Signal::Reload) => {
                    self.reload();
                    Ok(())
                }
            };
            if let Err(error) = result {
                error!("{error}");
                break;
            }
        }
        self.end()
    }

    /// Sends the manager a changed status, and a sign of life while the control thread
    /// ticks.
    fn notify(&mut self) {
        self.daemon.check_record();
        let ticks = self.daemon.ticks();
        if ticks == 0 {
            return;
        }
        let status = self.status();
        if self.sent_status.as_ref() != Some(&status) {
            let state = self.sent_status.as_ref().map_or(READY, |_| "");
            self.manager.status(state, &status);
            self.sent_status = Some(status);
        }
        if let Some(watchdog) = &mut self.watchdog
            && watchdog.is_due(monotonic_ns(), ticks)
        {
            self.manager.alive();
        }
    }

    fn status(&self) -> String {
        let mut status = match self.daemon.mode() {
            (mode, Some(reason)) => format!("mode {mode}: {reason}"),
            (mode, None) => format!("mode {mode}"),
        };
        let configuration = self.daemon.configuration();
        if configuration.number > 1 {
            status += &format!("; configuration {}", configuration.number);
        }
        if let Some(change) = configuration.last_change
            && let Some(error) = change.error
        {
            status += &format!("; {} refused: {error}", change.by);
        }
        if let Some(trouble) = self.daemon.handle.record_trouble() {
            status += &format!("; {trouble}");
        }
        status
    }

    /// Reloads the configuration. The result is in the status.
    fn reload(&mut self) {
        if self.sent_status.is_none() || self.ending_since.is_some() {
            warn!("SIGHUP: the configuration is not reloaded while singletrackd starts or ends");
            return;
        }
        self.manager.reloading(monotonic_ns());
        // The daemon logs an error.
        let _ = self.daemon.reload(&self.path);
        let status = self.status();
        self.manager.status(READY, &status);
        self.sent_status = Some(status);
    }

    /// Whether the terminal that started the process has been closed.
    fn has_lost_terminal(&self) -> bool {
        self.has_terminal && !has_terminal()
    }

    /// Asks the daemon to end before anything is logged. A second signal disarms at once.
    fn begin_end(&mut self, signal: &str) -> Result<(), Stalled> {
        let requests = &self.daemon.handle.requests;
        if self.ending_since.is_some() {
            let result = requests.push(ControlRequest::Abort);
            warn!(signal, "disarming at once");
            return result;
        }
        let result = requests.push(ControlRequest::Finish);
        info!(signal, "stopping");
        let text = format!("{signal}: stopping the car");
        self.manager.status(STOPPING, &text);
        self.ending_since = Some(Instant::now());
        result
    }

    fn end(self) -> ExitCode {
        if self.ending_since.is_none()
            && let Some(name) = self.daemon.ended_thread()
        {
            let text = format!("the {name} thread has ended by itself: stopping the car");
            error!("{text}");
            self.manager.status(STOPPING, &text);
        }
        match self.daemon.stop() {
            Ok(summary) => {
                log_summary(&summary);
                match &summary.record_error {
                    None => ExitCode::SUCCESS,
                    Some(error) => {
                        error!("the record is incomplete: {error}");
                        ExitCode::FAILURE
                    }
                }
            }
            Err(error) => {
                error!("{error}");
                ExitCode::FAILURE
            }
        }
    }
}

/// Whether this process belongs to a terminal that has not hung up.
fn has_terminal() -> bool {
    let flags = OFlags::RDONLY | OFlags::NONBLOCK | OFlags::NOCTTY | OFlags::CLOEXEC;
    open("/dev/tty", flags, Mode::empty()).is_ok()
}
