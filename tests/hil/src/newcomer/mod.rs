//! A newcomer with a car that has just been built, at a terminal.
//!
//! Car, board and cameras are those of `singletrack-sim`, the daemon is the shipped one, and the
//! procedures are the commands that a person types. The person is that of `cargo onboard`: it
//! reads the questions on the terminal, moves the car through the socket of the simulator, holds
//! the space bar and types the answers.

mod hands;
mod terminal;

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Child, Command, ExitStatus, Stdio},
    thread,
    time::{Duration, Instant},
};

use serde_json::json;
use singletrack_commissioning::{Answer, Answers, Question, edit::Edit};
use singletrack_onboard::{Hands as _, OnboardCar, Person, Rehearsal};
use singletrack_sim::{HandCommand, HandMotion, Seen, StartPose};

use crate::{Failure, Outcome, client::Client, daemon::Daemon, ensure, rig::as_hardware, wait};
pub use hands::SocketHands;
pub use terminal::Terminal;

/// How often terminal and car are looked at.
const LOOK: Duration = Duration::from_millis(5);

/// What a person takes to read a question before a hand moves. A car that is carried a tenth of a
/// second after its stop moves although it was stopped.
const REACTION: Duration = Duration::from_millis(500);

/// Radius of the circle in an owner's configuration.
pub const CIRCLE_RADIUS_M: f64 = 1.0;

/// The longest time in which nothing new is printed.
const SILENCE: Duration = Duration::from_secs(150);

/// A newcomer, the car and the programs.
pub struct Newcomer {
    folder: PathBuf,
    programs: PathBuf,
    simulator: Child,
    daemon: Daemon,
    hands: SocketHands,
    person: Person,
    car: OnboardCar,
}

/// What became of a command.
#[derive(Debug)]
pub struct Session {
    /// What it printed.
    pub text: String,
    /// How it ended; none if it was left running.
    pub status: Option<ExitStatus>,
    /// Time that it took.
    pub time: Duration,
}

/// What the person does next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// Goes on as the terminal asks.
    GoOn,
    /// Kills the command.
    Kill,
    /// Types Ctrl-C.
    Interrupt,
    /// Lets the space bar go.
    LetGo,
}

impl Newcomer {
    /// Switches the car on and starts the daemon, with what its owner has written down, or with
    /// the configuration that is in `folder` already. Files are written to `folder`, and
    /// `programs` is the folder of the programs.
    ///
    /// # Errors
    ///
    /// A program does not start.
    pub fn start(car: OnboardCar, folder: &Path, programs: &Path) -> Outcome<Self> {
        let folder = folder.to_owned();
        let written = || Failure::system(format!("can't write to {}", folder.display()));
        fs::create_dir_all(&folder).map_err(written())?;
        let truth = toml::to_string(&car.simulation)
            .map_err(|error| Failure::new(format!("the simulation: {error}")))?;
        fs::write(folder.join("car.toml"), truth).map_err(written())?;
        let (mut simulator, cameras) = start_simulator(&folder, programs)?;
        let prepared = write_configuration(&car, &folder, cameras).and_then(|config| {
            let daemon = start_daemon(&folder, programs, &config)?;
            let rear_axle_m = car.simulation.car.vehicle.rear_axle_distance_m;
            let hands = SocketHands::connect(&folder.join("hands"), rear_axle_m)?;
            Ok((daemon, hands))
        });
        let (daemon, hands) = match prepared {
            Ok(prepared) => prepared,
            Err(failure) => {
                end(&mut simulator);
                return Err(failure);
            }
        };
        let mut newcomer = Self {
            person: Person::in_a_hurry(car.seed),
            folder,
            programs: programs.to_owned(),
            simulator,
            daemon,
            hands,
            car,
        };
        newcomer.wait_for_board()?;
        Ok(newcomer)
    }

    /// The car.
    pub const fn car(&self) -> &OnboardCar {
        &self.car
    }

    /// The configuration file.
    pub fn config(&self) -> PathBuf {
        self.folder.join("singletrackd.toml")
    }

    /// The text of the configuration.
    ///
    /// # Errors
    ///
    /// It can't be read.
    pub fn configuration(&self) -> Outcome<String> {
        fs::read_to_string(self.config()).map_err(Failure::system("the configuration"))
    }

    /// The folder with journals and pages.
    fn state(&self) -> PathBuf {
        self.folder.join("singletrackd.toml.commissioning")
    }

    /// A connection to the daemon.
    ///
    /// # Errors
    ///
    /// There is none.
    pub fn client(&mut self) -> Outcome<Client> {
        let path = self.folder.join("control.sock");
        let daemon = &mut self.daemon;
        wait::until("the control socket", Duration::from_secs(5), || {
            if let Some(status) = daemon.status()? {
                return Err(Failure::new(format!(
                    "the daemon has ended: {status}: {}",
                    daemon.log()
                )));
            }
            Ok(Client::connect(&path).ok())
        })
    }

    fn wait_for_board(&mut self) -> Outcome {
        let mut client = self.client()?;
        wait::until("the board", Duration::from_secs(15), || {
            Ok((client.status()?.link() == "ready").then_some(()))
        })
    }

    /// Waits for a mode of the pilot.
    ///
    /// # Errors
    ///
    /// Not within ten seconds.
    pub fn wait_for_mode(&mut self, mode: &str) -> Outcome {
        let mut client = self.client()?;
        let mut last = String::new();
        wait::until(&format!("mode {mode}"), Duration::from_secs(10), || {
            let status = client.status()?;
            last = status.text();
            Ok((status.mode() == mode).then_some(()))
        })
        .map_err(|failure| Failure::new(format!("{failure}; last: {last}")))
    }

    /// Takes what was found in virtual time for these steps of a procedure, as if the procedure
    /// had been interrupted after them: the values are in the configuration, and the findings in
    /// the journal.
    ///
    /// # Errors
    ///
    /// A file can't be written, or the daemon does not take it.
    pub fn take_over(
        &mut self,
        rehearsal: &Rehearsal,
        procedure: &str,
        is_done: impl Fn(&str) -> bool,
    ) -> Outcome {
        let edited = |error: singletrack_commissioning::edit::EditError| {
            Failure::new(format!("the configuration: {error}"))
        };
        self.client()?
            .report_procedure(procedure, "begun")?
            .accepted()?;
        let mut file = Edit::read(&self.config()).map_err(edited)?;
        rehearsal
            .apply(procedure, &is_done, &mut file)
            .map_err(edited)?;
        let _ = file.write(&self.config(), "rehearsal").map_err(edited)?;
        let now = jiff::Timestamp::now().to_string();
        let entries: Vec<_> = rehearsal
            .steps
            .iter()
            .filter(|step| step.procedure == procedure && is_done(&step.finding.step))
            .map(|step| json!({ "time": now, "finding": step.finding }))
            .collect();
        let journal = json!({ "car_id": self.car.simulation.board.car_id, "entries": entries });
        let written = || Failure::system("can't write the journal");
        fs::create_dir_all(self.state()).map_err(written())?;
        let path = self.state().join(format!("{procedure}.json"));
        fs::write(path, journal.to_string()).map_err(written())?;
        self.client()?.reload()?.accepted()?;
        self.client()?
            .report_procedure(procedure, "changed")?
            .accepted()?;
        self.wait_for_board()
    }

    /// Types a command of `singletrack`, and does what it asks for, until it has ended or `next`
    /// says otherwise; that gets what was printed and what is seen of the car.
    ///
    /// # Errors
    ///
    /// A question is not known, or the command hangs.
    pub fn run(
        &mut self,
        command: &[&str],
        rehearsal: &Rehearsal,
        next: impl FnMut(&str, &Seen, bool) -> Next,
    ) -> Outcome<Session> {
        let mut arguments: Vec<String> = command.iter().map(|word| (*word).to_owned()).collect();
        let socket = self.folder.join("control.sock");
        arguments.extend(["--socket".to_owned(), socket.display().to_string()]);
        if command.first() != Some(&"arm") {
            let config = self.config();
            arguments.extend(["--config".to_owned(), config.display().to_string()]);
        }
        let mut terminal = Terminal::start(&self.programs.join("singletrack"), &arguments)?;
        let result = self.attend(&mut terminal, rehearsal, next);
        let text = terminal.text().to_owned();
        let name = format!("terminal-{}.txt", command.first().unwrap_or(&""));
        let mut all = fs::read_to_string(self.folder.join(&name)).unwrap_or_default();
        all.push_str(&text);
        let _ = fs::write(self.folder.join(&name), all);
        result.map_err(|failure| {
            Failure::new(format!(
                "{failure}\nend of the terminal:\n{}",
                terminal.last()
            ))
        })
    }

    fn attend(
        &mut self,
        terminal: &mut Terminal,
        rehearsal: &Rehearsal,
        mut next: impl FnMut(&str, &Seen, bool) -> Next,
    ) -> Outcome<Session> {
        let begun = Instant::now();
        let (mut heard, mut length) = (begun, 0);
        // When a question was first seen; the question, and when it is answered.
        let mut printed: Option<Instant> = None;
        let mut asked: Option<(Question, Instant)> = None;
        loop {
            self.hands.poll()?;
            self.person.act(&mut self.hands);
            terminal.look()?;
            if let Some(status) = terminal.status()? {
                terminal.look()?;
                return Ok(Session {
                    text: terminal.text().to_owned(),
                    status: Some(status),
                    time: begun.elapsed(),
                });
            }
            match next(terminal.text(), &self.hands.look(), self.hands.is_moving()) {
                Next::GoOn => {}
                Next::Interrupt => terminal.interrupt()?,
                Next::LetGo => terminal.let_go(),
                Next::Kill => {
                    terminal.kill()?;
                    return Ok(Session {
                        text: terminal.text().to_owned(),
                        status: None,
                        time: begun.elapsed(),
                    });
                }
            }
            if terminal.printed() > length {
                (heard, length) = (Instant::now(), terminal.printed());
            }
            ensure!(
                heard.elapsed() < SILENCE,
                "nothing is printed for {SILENCE:?}"
            );
            if asked.is_none()
                && let Some(text) = terminal.question()
                && printed.get_or_insert_with(Instant::now).elapsed() >= REACTION
            {
                let question = rehearsal
                    .question(text)
                    .ok_or_else(|| Failure::new(format!("nobody knows the question: {text}")))?;
                let think_s = self
                    .person
                    .consider(question, &self.hands)
                    .ok_or_else(|| Failure::new(format!("nobody can do this: {text}")))?;
                let think = Duration::from_secs_f64(think_s);
                asked = Some((question.clone(), Instant::now() + think));
                // What is to be done first begins.
                self.person.act(&mut self.hands);
            }
            if let Some((question, when)) = &asked
                && Instant::now() >= *when
                && !self.person.is_busy(&self.hands)
            {
                let answer = self.person.answer(question, &self.hands);
                terminal.answer(&typed(&question.answers, answer))?;
                (asked, printed) = (None, None);
            }
            thread::sleep(LOOK);
        }
    }

    /// Does something with the car, and waits for its end.
    ///
    /// # Errors
    ///
    /// The simulator has ended.
    pub fn do_by_hand(&mut self, command: HandCommand) -> Outcome {
        self.hands.apply(command);
        self.look_until(Duration::from_secs(20), |_, is_moving| !is_moving)
            .map(drop)
    }

    /// Carries the car to where P is at the start of its owner's circle, and waits until it can
    /// be armed.
    ///
    /// # Errors
    ///
    /// The daemon does not become ready.
    pub fn place_at_circle(&mut self) -> Outcome {
        let config = singletrack_core::config::Config::read(&self.config())
            .map_err(|error| Failure::new(error.to_string()))?;
        let front_m = self.car.simulation.car.vehicle.front_axle_distance_m;
        let to = StartPose {
            x_m: CIRCLE_RADIUS_M,
            y_m: -front_m - config.law.point_distance_m,
            yaw_rad: core::f64::consts::FRAC_PI_2,
        };
        // A car that is lifted right after a drive moves although it was stopped.
        self.wait_for_mode("ready")?;
        self.do_by_hand(HandCommand::Move(HandMotion::Carry { to, for_s: 1.0 }))?;
        self.wait_for_mode("ready")
    }

    /// Looks at the car until `ends` says so, and gives the time that it took.
    ///
    /// # Errors
    ///
    /// Not within the limit.
    pub fn look_until(
        &mut self,
        limit: Duration,
        mut ends: impl FnMut(&Seen, bool) -> bool,
    ) -> Outcome<Duration> {
        let begun = Instant::now();
        // What was under way was seen earlier.
        let mut looks = 0;
        loop {
            self.hands.poll()?;
            thread::sleep(Duration::from_millis(1));
            looks += 1;
            if looks > 10 && ends(&self.hands.look(), self.hands.is_moving()) {
                return Ok(begun.elapsed());
            }
            ensure!(
                begun.elapsed() < limit,
                "not within {limit:?}: {:?}",
                self.hands.look()
            );
        }
    }

    /// The end of the daemon's log.
    pub fn log(&self) -> String {
        self.daemon.log()
    }
}

impl Drop for Newcomer {
    fn drop(&mut self) {
        // So that the record is complete.
        let _ = self.daemon.terminate(Duration::from_secs(3));
        end(&mut self.simulator);
    }
}

fn end(simulator: &mut Child) {
    let _ = simulator.kill();
    let _ = simulator.wait();
}

/// An answer as a person types it.
fn typed(answers: &Answers, answer: Answer) -> String {
    match (answer, answers) {
        (Answer::Begin, _) => String::new(),
        (Answer::YesNo(true), _) => "y".to_owned(),
        (Answer::YesNo(false), _) => "n".to_owned(),
        (Answer::Choice(index), Answers::Choice(words)) => {
            words.get(index).copied().unwrap_or("s").to_owned()
        }
        (Answer::Number(number), _) => number.to_string(),
        (Answer::Skip | Answer::Choice(_), _) => "s".to_owned(),
    }
}

/// Starts the simulator, and gives the port of the cameras' commands.
fn start_simulator(folder: &Path, programs: &Path) -> Outcome<(Child, u16)> {
    let log = folder.join("simulator.log");
    let output = fs::File::create(&log).map_err(Failure::system("can't write the log"))?;
    let mut command = Command::new(programs.join("singletrack-sim"));
    command
        .arg("--config")
        .arg(folder.join("car.toml"))
        .arg("--port")
        .arg(folder.join("board"))
        .args(["--command-port", "0", "--data-port", "0", "--hands"])
        .arg(folder.join("hands"))
        .stdin(Stdio::null())
        .stdout(output);
    let mut simulator = as_hardware(move || command.spawn())?
        .map_err(Failure::system("can't run singletrack-sim"))?;
    let port = wait::until("the simulator", Duration::from_secs(10), || {
        let text = fs::read_to_string(&log).unwrap_or_default();
        Ok(text.lines().find_map(|line| {
            let address = line.strip_prefix("NatNet")?.split_whitespace().next()?;
            address.rsplit_once(':')?.1.parse().ok()
        }))
    });
    match port {
        Ok(port) => Ok((simulator, port)),
        Err(failure) => {
            end(&mut simulator);
            Err(failure)
        }
    }
}

/// Writes the owner's configuration, for this simulator.
fn write_configuration(car: &OnboardCar, folder: &Path, cameras: u16) -> Outcome<PathBuf> {
    let failed = |error: singletrack_commissioning::edit::EditError| {
        Failure::new(format!("the configuration: {error}"))
    };
    let config = folder.join("singletrackd.toml");
    // What procedures have found out is kept.
    let mut file = if config.exists() {
        Edit::read(&config)
    } else {
        Edit::new(&car.file.to_string())
    }
    .map_err(failed)?;
    let path = |name: &str| folder.join(name).display().to_string();
    for (key, value) in [
        ("serial.port", path("board").into()),
        ("motion_capture.command_port", i64::from(cameras).into()),
        ("record.directory", path("records").into()),
        ("state.directory", path("state").into()),
        ("socket.path", path("control.sock").into()),
        ("outer_loop.feed_forward", true.into()),
    ] {
        file.set(key, &value).map_err(failed)?;
    }
    fs::write(&config, file.text()).map_err(Failure::system("can't write the configuration"))?;
    Ok(config)
}

fn start_daemon(folder: &Path, programs: &Path, config: &Path) -> Outcome<Daemon> {
    Daemon::start(
        &programs.join("singletrackd"),
        config,
        &folder.join("daemon.log"),
    )
}
