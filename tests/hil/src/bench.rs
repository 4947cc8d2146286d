//! Rig, daemon and files of one test.

use std::{
    path::{Path, PathBuf},
    time::Duration,
};

use singletrack_core::config::{Config, ServerKind};
use singletrack_protocol::UNNAMED;
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

/// Board and program under test.
#[derive(Clone, Debug)]
pub struct Equipment {
    /// The daemon's program.
    pub program: PathBuf,
    /// The port of a physical UNO; `None` selects the simulator.
    pub port: Option<PathBuf>,
    /// Implementation of the simulated board.
    pub board: BoardKind,
    /// Number of times that the daemon is killed while driving.
    pub kills: usize,
    /// Whether there is time for every step of the procedures.
    pub whole: bool,
    /// Whether Octave is installed.
    pub octave: bool,
    /// Whether Chromium is installed.
    pub browser: bool,
    /// Collects the measurements.
    pub measurements: Measurements,
}

impl Equipment {
    /// Reason why a test can't run with this equipment, if any.
    pub fn lacks(&self, need: Need) -> Option<&'static str> {
        if need == Need::Whole && !self.whole {
            return Some("it takes a quarter of an hour: --whole");
        }
        if need == Need::Octave && !self.octave {
            return Some("it takes Octave with its package instrument-control: --octave");
        }
        if need == Need::Browser && !self.browser {
            return Some("it takes Chromium: --browser");
        }
        match &self.port {
            Some(_) => physical_lacks(need),
            None => simulated_lacks(self.board, need),
        }
    }
}

/// Rig, daemon and files of one test.
pub struct Bench {
    test: String,
    equipment: Equipment,
    rig: Box<dyn Rig>,
    config: Config,
    daemon: Option<Daemon>,
    started: u32,
    folder: TempDir,
}

/// Limit for the time from the daemon's start to readiness: two seconds of neutral
/// for the ESC, half a second of poses, handshakes, and a UNO's bootloader.
const READY: Duration = Duration::from_secs(10);
/// Limit for the time from arming to a moving car.
const MOVING: Duration = Duration::from_secs(3);
/// Limit for the time from coasting to standstill.
const STANDING: Duration = Duration::from_secs(4);
/// Shortest duration of neutral that counts.
const SUSTAINED: Duration = Duration::from_millis(200);
/// Limit for the time from the last command to neutral: a time to live of 95 ms, a
/// servo period of 20 ms, a poll of 1 ms, and 4 ms.
pub const NEUTRAL_LIMIT_MS: f64 = 120.0;

impl Bench {
    /// Powers the rig on without a daemon.
    ///
    /// # Errors
    ///
    /// Fails if the rig does not start.
    pub fn new(test: &str, equipment: &Equipment, seed: u64) -> Outcome<Self> {
        let folder = tempfile::Builder::new()
            .prefix("singletrack-hil-")
            .tempdir()
            .map_err(Failure::system("can't make a folder for the test"))?;
        let link = folder.path().join("board");
        let rig: Box<dyn Rig> = match &equipment.port {
            Some(port) => Box::new(PhysicalRig::start(port, link, seed)?),
            None => Box::new(SimulatedRig::start(link, seed, equipment.board, UNNAMED)?),
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

    /// Replaces the rig by one whose cameras have another kind of server, and configures the next
    /// daemon for it.
    ///
    /// # Errors
    ///
    /// Fails if the rig does not start, and with a physical board.
    pub fn exchange_cameras(&mut self, kind: ServerKind) -> Outcome {
        if let Some(lack) = self.lacks(Need::OtherCameras) {
            return Err(Failure::new(lack));
        }
        let simulated = match kind {
            ServerKind::NatNet => singletrack_sim::ServerKind::NatNet,
            ServerKind::Vrpn => singletrack_sim::ServerKind::Vrpn,
            ServerKind::Qualisys => singletrack_sim::ServerKind::Qualisys,
        };
        let link = self.folder().join(format!("board-{}", kind.name()));
        self.rig = Box::new(SimulatedRig::with_cameras(
            link,
            1,
            self.equipment.board,
            UNNAMED,
            simulated,
        )?);
        self.config.serial.port = self.rig.port().to_owned();
        self.config.motion_capture.kind = kind;
        self.config.motion_capture.command_port = Some(self.rig.cameras().port());
        Ok(())
    }

    /// Replaces board, car and cameras by those of another car, and configures the next daemon
    /// for it. The daemon must have ended.
    ///
    /// # Errors
    ///
    /// Fails if the rig does not start, and with a physical board.
    pub fn exchange_car(&mut self, car_id: u16) -> Outcome {
        if let Some(lack) = self.lacks(Need::AnotherCar) {
            return Err(Failure::new(lack));
        }
        let link = self.folder().join(format!("board-of-car-{car_id}"));
        self.rig = Box::new(SimulatedRig::start(
            link,
            u64::from(car_id),
            self.equipment.board,
            car_id,
        )?);
        self.config.serial.port = self.rig.port().to_owned();
        self.config.motion_capture.server = *self.rig.cameras().ip();
        self.config.motion_capture.command_port = Some(self.rig.cameras().port());
        self.config.board.car_id = car_id;
        Ok(())
    }

    /// Reason why this bench lacks what a test needs, if it does.
    pub fn lacks(&self, need: Need) -> Option<&'static str> {
        self.rig.lacks(need)
    }

    /// The board, the car and the cameras.
    pub fn rig(&self) -> &dyn Rig {
        self.rig.as_ref()
    }

    /// The test's folder.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// Terminates the daemon, keeps configuration, logs and records for the
    /// analysis of a failure, and returns their folder.
    pub fn keep(&mut self) -> &Path {
        if let Some(daemon) = &mut self.daemon {
            // A killed daemon would not finish its record.
            let _ = daemon.terminate(Duration::from_secs(3));
        }
        self.folder.disable_cleanup(true);
        self.folder.path()
    }

    /// Mutable access to the next daemon's configuration.
    pub fn config_mut(&mut self) -> &mut Config {
        &mut self.config
    }

    /// The daemon's configuration.
    pub const fn config(&self) -> &Config {
        &self.config
    }

    /// Path of the configuration file, which exists once a daemon has been started.
    pub fn config_file(&self) -> PathBuf {
        self.folder().join("singletrackd.toml")
    }

    /// The daemon's program.
    pub fn program(&self) -> &Path {
        &self.equipment.program
    }

    /// Number of times that the daemon is killed.
    pub const fn kills(&self) -> usize {
        self.equipment.kills
    }

    /// Number of drive commands refused by the board since its start.
    ///
    /// # Errors
    ///
    /// Fails without an answer.
    pub fn drives_refused(&mut self) -> Outcome<f64> {
        self.client()?.watch_board()?.next("drives_refused")
    }

    /// The neutral pulse, in µs.
    pub const fn neutral_us(&self) -> u16 {
        self.config.board.esc.neutral_us
    }

    // The daemon.

    /// Starts a daemon; the previous one must have ended.
    ///
    /// # Errors
    ///
    /// Fails if it does not start.
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
    /// Fails if there is none.
    pub fn daemon(&mut self) -> Outcome<&mut Daemon> {
        self.daemon
            .as_mut()
            .ok_or_else(|| Failure::new("no daemon was started"))
    }

    /// The end of the daemon's log, for the report of a failure.
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
    /// Fails without a socket within five seconds, or if the daemon has ended.
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

    /// The daemon's status.
    ///
    /// # Errors
    ///
    /// Fails without an answer.
    pub fn status(&mut self) -> Outcome<Status> {
        self.client()?.status()
    }

    /// Waits for a mode, and returns the status with it.
    ///
    /// # Errors
    ///
    /// Fails if the mode does not occur in time.
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

    /// Waits until the car can be armed.
    ///
    /// # Errors
    ///
    /// Fails if it does not become ready.
    pub fn wait_until_ready(&mut self) -> Outcome<Status> {
        self.wait_for_mode("ready", READY)
    }

    // Driving.

    /// Starts a daemon, arms, and waits until the car moves.
    ///
    /// # Errors
    ///
    /// Fails if it does not drive.
    pub fn start_driving(&mut self) -> Outcome {
        self.start_daemon()?;
        self.wait_until_ready()?;
        self.arm_and_drive()
    }

    /// Arms, and waits until the car moves.
    ///
    /// # Errors
    ///
    /// Fails if it does not drive.
    pub fn arm_and_drive(&mut self) -> Outcome {
        self.client()?.arm()?.accepted()?;
        self.wait_for_mode("driving", MOVING)?;
        wait::until("a moving car", MOVING, || {
            Ok((self.rig.truth()?.speed > 0.2).then_some(()))
        })
    }

    /// Keeps driving for a time; the car must not stop.
    ///
    /// # Errors
    ///
    /// Fails if it stops.
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

    /// Waits until the car stands still.
    ///
    /// # Errors
    ///
    /// Fails if it keeps rolling.
    pub fn wait_until_standing(&self) -> Outcome {
        wait::until("a standing car", STANDING, || {
            Ok((self.rig.truth()?.speed.abs() < 0.01).then_some(()))
        })
    }

    /// Checks for the whole time that the motor is not driven, although all
    /// conditions for driving may be met.
    ///
    /// # Errors
    ///
    /// Fails if the car was driven, or if there were too few ESC pulses to decide.
    pub fn stays_neutral(&self, time: Duration) -> Outcome {
        let place = self.rig.trace()?.len();
        std::thread::sleep(time);
        trace::has_pulses_for(self.rig.trace()?.since(place), time)?;
        self.was_neutral_since(place)
    }

    /// Checks that the motor was not driven since a position in the trace, except
    /// by a pulse cut by a reset.
    ///
    /// # Errors
    ///
    /// Fails if the car was driven.
    pub fn was_neutral_since(&self, place: usize) -> Outcome {
        let trace = self.rig.trace()?;
        let driven = trace
            .since(place)
            .iter()
            .filter(|pulses| !pulses.is_cut_short_of(self.neutral_us()))
            .find(|pulses| !pulses.is_neutral(self.neutral_us()));
        ensure!(
            driven.is_none(),
            "the motor was driven while not armed: {driven:?}"
        );
        Ok(())
    }

    /// Checks that every pulse was within the configured limits; one cut by a reset
    /// may be shorter.
    ///
    /// # Errors
    ///
    /// Fails with a pulse outside.
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

    /// Records a value and checks it against its limit.
    ///
    /// # Errors
    ///
    /// Fails if the value exceeds the limit.
    pub fn at_most(&self, what: &str, value: f64, limit: f64, unit: &'static str) -> Outcome {
        self.equipment
            .measurements
            .at_most(&self.test, what, value, limit, unit)
    }

    /// The board's clock.
    ///
    /// # Errors
    ///
    /// Fails if the board does not run.
    pub fn board_time_us(&self) -> Outcome<u32> {
        self.rig
            .board_time_us()?
            .ok_or_else(|| Failure::new("the board does not run"))
    }

    /// Measures the time from a board time to the pulse from which on the motor is
    /// not driven.
    ///
    /// # Errors
    ///
    /// Fails if it is still driven, or the limit is exceeded.
    pub fn neutral_within(&self, what: &str, since_us: u32, limit_ms: f64) -> Outcome {
        // Longer than the limit, to measure by how much it is exceeded.
        let timeout = Duration::from_millis(500 + limit_ms as u64);
        wait::until(&format!("neutral {what}"), timeout, || {
            Ok(self.rig.trace()?.neutral_from(self.neutral_us()))
        })?;
        // Only sustained neutral counts.
        std::thread::sleep(SUSTAINED);
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

    /// Waits until the last command has expired, and measures from it.
    ///
    /// # Errors
    ///
    /// Fails if neutral is late or missing.
    pub fn neutral_after_last_command(&self) -> Outcome {
        let command_us = self.rig.last_command_us()?;
        self.neutral_within("after the last command", command_us, NEUTRAL_LIMIT_MS)
    }
}
