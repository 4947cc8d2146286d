//! The main thread: signals in, the service manager told, until the daemon ends.

use std::{
    path::PathBuf,
    process::ExitCode,
    time::{Duration, Instant},
};

use rustix::fs::{Mode, OFlags, open};
use singletrack_core::Stalled;
use singletrackd::{
    Daemon, monotonic_ns,
    notify::{ServiceManager, Watchdog},
    reconfigure::{ChangeView, ConfigurationView},
};
use tracing::{error, info, warn};

use crate::{
    signals::{Signal, Signals},
    tell,
};

/// How long the control thread may take to stop the car and to end, after the
/// first signal.
const STOP_PATIENCE: Duration = Duration::from_secs(4);

/// How often the main thread looks around.
const LOOK_AROUND: Duration = Duration::from_millis(10);

/// A daemon under the eyes of whoever started it.
pub(crate) struct Service {
    daemon: Daemon,
    /// Its configuration.
    path: PathBuf,
    manager: ServiceManager,
    watchdog: Option<Watchdog>,
    /// What the manager was last told; none before everything runs.
    told: Option<String>,
    /// When the first signal to end came.
    ending: Option<Instant>,
    /// It was started from a terminal.
    has_terminal: bool,
}

impl Service {
    pub(crate) fn new(daemon: Daemon, path: PathBuf, manager: ServiceManager) -> Self {
        Self {
            daemon,
            path,
            watchdog: manager.watchdog().map(Watchdog::new),
            manager,
            told: None,
            ending: None,
            has_terminal: has_terminal(),
        }
    }

    /// Until a signal says otherwise.
    pub(crate) fn run(mut self, signals: &Signals) -> ExitCode {
        while !self.daemon.has_ended() {
            // A control thread that is stuck does not keep the process.
            if self
                .ending
                .is_some_and(|begin| begin.elapsed() > STOP_PATIENCE)
            {
                error!("the control thread does not end");
                break;
            }
            self.report();
            let asked = match signals.wait(LOOK_AROUND) {
                None => continue,
                Some(Signal::End(name)) => self.begin_end(name),
                // Who is there no more does not ask twice: shell and system both say so.
                Some(Signal::Reload) if self.has_lost_terminal() => match self.ending {
                    None => self.begin_end("SIGHUP"),
                    Some(_) => Ok(()),
                },
                Some(Signal::Reload) => {
                    self.reload();
                    Ok(())
                }
            };
            if let Err(error) = asked {
                error!("{error}");
                break;
            }
        }
        self.end()
    }

    /// Tells the manager what has changed, and that the controller ticks.
    fn report(&mut self) {
        self.daemon.look_after_record();
        let ticks = self.daemon.ticks();
        if ticks == 0 {
            return;
        }
        let status = self.status();
        if self.told.as_ref() != Some(&status) {
            match self.told {
                None => self.manager.ready(&status),
                Some(_) => self.manager.status(&status),
            }
            self.told = Some(status);
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
        let ConfigurationView {
            number,
            last_change,
        } = self.daemon.configuration();
        if number > 1 {
            status += &format!("; configuration {number}");
        }
        if let Some(ChangeView {
            by,
            error: Some(error),
        }) = last_change
        {
            status += &format!("; {by} refused: {error}");
        }
        if let Some(error) = self.daemon.record_error() {
            status += &format!("; nothing is recorded: {error}");
        }
        status
    }

    /// What comes of it stands in the status.
    fn reload(&mut self) {
        if self.told.is_none() || self.ending.is_some() {
            warn!("SIGHUP: the configuration is not read anew while singletrackd starts or ends");
            return;
        }
        self.manager.reloading(monotonic_ns());
        // The daemon logs what comes of it.
        let _ = self.daemon.reload(&self.path);
        let status = self.status();
        self.manager.ready(&status);
        self.told = Some(status);
    }

    /// Whoever started it has gone: the window is closed, the connection broken.
    fn has_lost_terminal(&self) -> bool {
        self.has_terminal && !has_terminal()
    }

    /// First the car, then the log.
    fn begin_end(&mut self, signal: &str) -> Result<(), Stalled> {
        let asked = match self.ending {
            None => {
                let asked = self.daemon.begin_stop();
                info!(signal, "stopping");
                self.manager
                    .stopping(&format!("{signal}: stopping the car"));
                asked
            }
            Some(_) => {
                let asked = self.daemon.begin_abort();
                warn!(signal, "disarming at once");
                asked
            }
        };
        self.ending.get_or_insert_with(Instant::now);
        asked
    }

    fn end(self) -> ExitCode {
        if self.ending.is_none() {
            self.manager.stopping("the control thread has ended");
        }
        match self.daemon.stop() {
            Ok(summary) => {
                tell(&summary);
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
