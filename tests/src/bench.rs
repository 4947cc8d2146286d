//! One test's rig, daemon and files.

use std::{
    path::{Path, PathBuf},
    time::Duration,
};

use singletrack_core::config::Config;
use singletrack_sim::BoardKind;
use tempfile::TempDir;

use crate::{
    Failure, Measurements, Outcome, Trace,
    client::{Client, Status},
    daemon::Daemon,
    ensure,
    rig::{Need, PhysicalRig, Rig, SimulatedRig, physical_lacks, simulated_lacks},
    settings, trace, wait,
};

/// Which board, which program.
#[derive(Clone, Debug)]
pub struct Equipment {
    /// The daemon's program.
    pub program: PathBuf,
    /// The port of a physical UNO; the simulator without one.
    pub port: Option<PathBuf>,
    /// What runs on the simulated board.
    pub board: BoardKind,
    /// How often the daemon is killed in mid-drive.
    pub kills: usize,
    /// Where the measurements go.
    pub measurements: Measurements,
}

impl Equipment {
    /// Why a test need not be begun: what it needs can't be had.
    #[must_use]
    pub fn lacks(&self, need: Need) -> Option<&'static str> {
        match &self.port {
            Some(_) => physical_lacks(need),
            None => simulated_lacks(self.board, need),
        }
    }
}

/// One test's rig, daemon and files.
pub struct Bench {
    test: String,
    equipment: Equipment,
    rig: Box<dyn Rig>,
    config: Config,
    daemon: Option<Daemon>,
    started: u32,
    folder: TempDir,
}

/// From the daemon's start to a board that can be armed: two seconds of neutral
/// for the ESC, half a second of poses, handshakes; a UNO's bootloader.
const READY: Duration = Duration::from_secs(10);
/// From arming to a car that moves.
const MOVING: Duration = Duration::from_secs(3);
/// From coasting to standing.
const STANDING: Duration = Duration::from_secs(4);
/// So long must neutral last to be more than a pulse in passing.
const LASTING: Duration = Duration::from_millis(200);
/// The longest that a pulse may differ from neutral after the last command: a
/// time to live of 95 ms, a servo period of 20 ms, a poll of 1 ms, and 4 ms.
pub const NEUTRAL_LIMIT_MS: f64 = 120.0;

impl Bench {
    /// Powers the rig on; the daemon is not yet there.
    ///
    /// # Errors
    ///
    /// The rig does not start.
    pub fn new(test: &str, equipment: &Equipment, seed: u64) -> Outcome<Self> {
        let folder = tempfile::Builder::new()
            .prefix("singletrack-hil-")
            .tempdir()
            .map_err(Failure::system("cannot make a folder for the test"))?;
        let link = folder.path().join("board");
        let rig: Box<dyn Rig> = match &equipment.port {
            Some(port) => Box::new(PhysicalRig::start(port, link, seed)?),
            None => Box::new(SimulatedRig::start(link, seed, equipment.board)?),
        };
        let config = settings::circle(rig.port(), rig.cameras(), folder.path());
        Ok(Self {
            test: test.to_owned(),
            equipment: equipment.clone(),
            rig,
            config,
            daemon: None,
            started: 0,
            folder,
        })
    }

    /// Why this bench can't do what a test needs, now that it is there.
    #[must_use]
    pub fn lacks(&self, need: Need) -> Option<&'static str> {
        self.rig.lacks(need)
    }

    /// The board, the car and the cameras.
    #[must_use]
    pub fn rig(&self) -> &dyn Rig {
        self.rig.as_ref()
    }

    /// The test's own folder.
    #[must_use]
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// Ends the daemon as it would end by itself, keeps configuration, logs and
    /// records for whoever looks into a failure, and says where.
    pub fn keep(&mut self) -> &Path {
        if let Some(daemon) = &mut self.daemon {
            // Killed otherwise, it would not finish its record.
            let _ = daemon.terminate(Duration::from_secs(3));
        }
        self.folder.disable_cleanup(true);
        self.folder.path()
    }

    /// What the next daemon is given.
    pub fn config_mut(&mut self) -> &mut Config {
        &mut self.config
    }

    /// What the daemon is given.
    #[must_use]
    pub const fn config(&self) -> &Config {
        &self.config
    }

    /// Where the configuration file is, once a daemon has been started.
    #[must_use]
    pub fn config_file(&self) -> PathBuf {
        self.folder().join("singletrackd.toml")
    }

    /// The daemon's program.
    #[must_use]
    pub fn program(&self) -> &Path {
        &self.equipment.program
    }

    /// How often the daemon is to be killed.
    #[must_use]
    pub const fn kills(&self) -> usize {
        self.equipment.kills
    }

    /// Drive commands that the board has refused since it started.
    ///
    /// # Errors
    ///
    /// It does not say.
    pub fn drives_refused(&mut self) -> Outcome<f64> {
        self.client()?.watch_board()?.next("drives_refused")
    }

    /// The pulse at which the motor gets nothing, in µs.
    #[must_use]
    pub const fn neutral_us(&self) -> u16 {
        self.config.board.esc.neutral_us
    }

    // The daemon.

    /// Starts a daemon; the one before must have ended.
    ///
    /// # Errors
    ///
    /// It does not start.
    pub fn start_daemon(&mut self) -> Outcome {
        let file = self.config_file();
        settings::write(&self.config, &file)?;
        self.started += 1;
        let log = self.folder().join(format!("daemon-{}.log", self.started));
        self.daemon = Some(Daemon::start(&self.equipment.program, &file, &log)?);
        Ok(())
    }

    /// The running daemon.
    ///
    /// # Errors
    ///
    /// There is none.
    pub fn daemon(&mut self) -> Outcome<&mut Daemon> {
        self.daemon
            .as_mut()
            .ok_or_else(|| Failure::new("no daemon was started"))
    }

    /// The end of the daemon's log, for whoever looks into a failure.
    #[must_use]
    pub fn last_log(&self) -> String {
        const LINES: usize = 25;
        let log = self.daemon.as_ref().map(Daemon::log).unwrap_or_default();
        let lines: Vec<&str> = log.lines().collect();
        let from = lines.len().saturating_sub(LINES);
        lines.get(from..).unwrap_or(&[]).join("\n")
    }

    /// Connects to the daemon's socket.
    ///
    /// # Errors
    ///
    /// No socket within five seconds, or a daemon that has ended.
    pub fn client(&mut self) -> Outcome<Client> {
        let path = settings::socket(self.folder());
        let daemon = self.daemon()?;
        wait::until("the control socket", Duration::from_secs(5), || {
            if let Some(status) = daemon.status()? {
                return Err(Failure::new(format!("the daemon has ended: {status}")));
            }
            Ok(Client::connect(&path).ok())
        })
    }

    /// How the daemon is.
    ///
    /// # Errors
    ///
    /// It does not say.
    pub fn status(&mut self) -> Outcome<Status> {
        self.client()?.status()
    }

    /// Waits for a mode, and returns the status that showed it.
    ///
    /// # Errors
    ///
    /// Another mode for the whole time.
    pub fn wait_for_mode(&mut self, mode: &str, limit: Duration) -> Outcome<Status> {
        let mut client = self.client()?;
        let mut last = String::new();
        wait::until(&format!("mode {mode}"), limit, || {
            let status = client.status()?;
            last = status.text();
            Ok((status.mode() == mode).then_some(status))
        })
        .map_err(|failure| match failure {
            Failure::Failed(text) => Failure::new(format!("{text}; last: {last}")),
            other => other,
        })
    }

    /// Waits until the car could be armed.
    ///
    /// # Errors
    ///
    /// It can't.
    pub fn wait_until_ready(&mut self) -> Outcome<Status> {
        self.wait_for_mode("ready", READY)
    }

    // Drives.

    /// Starts a daemon, arms, and waits until the car moves.
    ///
    /// # Errors
    ///
    /// It does not drive.
    pub fn start_driving(&mut self) -> Outcome {
        self.start_daemon()?;
        self.wait_until_ready()?;
        self.arm_and_drive()
    }

    /// Arms, and waits until the car moves.
    ///
    /// # Errors
    ///
    /// It does not drive.
    pub fn arm_and_drive(&mut self) -> Outcome {
        self.client()?.arm()?.accepted()?;
        self.wait_for_mode("driving", MOVING)?;
        wait::until("a moving car", MOVING, || {
            Ok((self.rig.truth()?.speed > 0.2).then_some(()))
        })
    }

    /// Lets the car drive; it must not stop by itself.
    ///
    /// # Errors
    ///
    /// It stopped.
    pub fn keep_driving(&mut self, time: Duration) -> Outcome {
        let mut client = self.client()?;
        wait::throughout(time, || {
            let status = client.status()?;
            ensure!(
                status.mode() == "driving",
                "the car stopped: {}",
                status.text()
            );
            Ok(())
        })
    }

    /// Waits until the car stands.
    ///
    /// # Errors
    ///
    /// It rolls on.
    pub fn wait_until_standing(&self) -> Outcome {
        wait::until("a standing car", STANDING, || {
            Ok((self.rig.truth()?.speed.abs() < 0.01).then_some(()))
        })
    }

    /// For the whole time: the motor gets nothing, although everything for a
    /// drive may be there.
    ///
    /// # Errors
    ///
    /// The car was driven, or the ESC had no pulses that could tell.
    pub fn stays_neutral(&self, time: Duration) -> Outcome {
        let place = self.rig.trace()?.len();
        std::thread::sleep(time);
        trace::has_pulses_for(self.rig.trace()?.since(place), time)?;
        self.was_neutral_since(place)
    }

    /// The motor got nothing since a place in the trace; the pulse that a reset cut
    /// aside.
    ///
    /// # Errors
    ///
    /// The car was driven.
    pub fn was_neutral_since(&self, place: usize) -> Outcome {
        let trace = self.rig.trace()?;
        let driven = trace
            .since(place)
            .iter()
            .filter(|pulses| !pulses.is_cut_short_of(self.neutral_us()))
            .find(|pulses| !pulses.is_neutral(self.neutral_us()));
        ensure!(
            driven.is_none(),
            "the motor was driven without having been armed: {driven:?}"
        );
        Ok(())
    }

    /// Every pulse was within the configured limits; one that a reset cut may be
    /// shorter.
    ///
    /// # Errors
    ///
    /// The pulses that were not.
    pub fn was_within_limits(&self, trace: &Trace) -> Outcome {
        let (servo, esc) = (&self.config.board.servo, &self.config.board.esc);
        let outside = trace.0.iter().find(|pulses| {
            let within = |width_us: u16, min_us: u16, max_us: u16| {
                width_us == 0 || width_us <= max_us && (pulses.cut || width_us >= min_us)
            };
            !(within(pulses.servo_us, servo.min_us, servo.max_us)
                && within(pulses.esc_us, esc.min_us, esc.max_us))
        });
        ensure!(outside.is_none(), "outside the limits: {outside:?}");
        Ok(())
    }

    // Measurements, in board time.

    /// Notes a value and holds it against its limit.
    ///
    /// # Errors
    ///
    /// The value above the limit.
    pub fn at_most(&self, what: &str, value: f64, limit: f64, unit: &'static str) -> Outcome {
        self.equipment
            .measurements
            .at_most(&self.test, what, value, limit, unit)
    }

    /// The board's clock.
    ///
    /// # Errors
    ///
    /// The board does not run.
    pub fn board_time_us(&self) -> Outcome<u32> {
        self.rig
            .board_time_us()?
            .ok_or_else(|| Failure::new("the board does not run"))
    }

    /// From a board time to the first pulse from which on the motor got nothing.
    ///
    /// # Errors
    ///
    /// It still gets something, or later than the limit.
    pub fn neutral_within(&self, what: &str, since_us: u32, limit_ms: f64) -> Outcome {
        // Longer than the limit, to see by how much it is exceeded.
        let patience = Duration::from_millis(500 + limit_ms as u64);
        wait::until(&format!("neutral {what}"), patience, || {
            Ok(self.rig.trace()?.neutral_from(self.neutral_us()))
        })?;
        // It counts only if it lasts.
        std::thread::sleep(LASTING);
        let first = self
            .rig
            .trace()?
            .neutral_from(self.neutral_us())
            .ok_or_else(|| Failure::new(format!("neutral {what}: it did not last")))?;
        let elapsed_ms = trace::elapsed_ms(since_us, first.board_time_us)?;
        self.at_most(
            &format!("neutral {what} (board time)"),
            elapsed_ms,
            limit_ms,
            "ms",
        )
    }

    /// Waits for the last command to run out, and measures from it.
    ///
    /// # Errors
    ///
    /// Neutral came too late, or never.
    pub fn neutral_after_last_command(&self) -> Outcome {
        let command_us = self.rig.last_command_us()?;
        self.neutral_within("after the last command", command_us, NEUTRAL_LIMIT_MS)
    }
}
