//! `singletrack fleet`: one command for several cars, each with a daemon of its own.

mod arm;
mod cameras;
mod file;

use std::{
    io::{self, IsTerminal as _, Write as _},
    path::PathBuf,
    process::ExitCode,
    thread,
    time::Duration,
};

use clap::{Args, Subcommand};
use singletrack_api::{
    Answer, ClientError, ClockOffset, Connection, Reply, Request, Status, ask_within,
};
use singletrackd::monotonic_ns;

use crate::{
    control::{ControlError, print},
    interrupt::Interrupt,
};
use file::{Car, Fleet};

pub use cameras::RelayError;
pub use file::FleetFileError;

/// The longest wait for a daemon's answer: the others are asked meanwhile.
const PATIENCE: Duration = Duration::from_secs(1);
/// Interval of `status --watch`.
const WATCH: Duration = Duration::from_millis(500);

/// Options of `singletrack fleet`.
#[derive(Clone, Debug, Args)]
pub struct FleetArgs {
    /// The cars
    #[arg(
        long,
        value_name = "FILE.toml",
        default_value = "fleet.toml",
        global = true
    )]
    fleet: PathBuf,
    #[command(subcommand)]
    command: FleetCommand,
}

#[derive(Clone, Debug, Subcommand)]
enum FleetCommand {
    /// Print a line for each car: mode, reason, place and speed.
    ///
    /// The exit status is 1 if a daemon does not answer.
    Status {
        /// Print them again twice a second, until Ctrl-C
        #[arg(long)]
        watch: bool,
    },
    /// Arm all cars and hold their drives: all stop when this command ends.
    ///
    /// No car is armed if one of them is not ready. The exit status is 0 if all drives ended as
    /// wanted, 1 if the cars were not armed, and 3 if something else stopped one of them.
    Arm(arm::FleetArmArgs),
    /// Slow all cars down, stop and disarm them.
    Disarm,
    /// Emergency stop of all cars: neutral at once, until their boards are reset.
    Stop,
    /// Hear a NatNet server once for all daemons of this computer, until Ctrl-C.
    ///
    /// For unicast: a server may send to one client of a computer only. With multicast, each daemon
    /// hears the one stream.
    Cameras(cameras::FleetCamerasArgs),
}

/// Why a command for a fleet failed.
#[derive(Debug, thiserror::Error)]
pub enum FleetError {
    /// There is no fleet.
    #[error(transparent)]
    File(#[from] FleetFileError),
    /// The cameras' frames can't be passed on.
    #[error(transparent)]
    Relay(#[from] RelayError),
    /// Cars did not obey.
    #[error("{}", .0.join("\n"))]
    Cars(Vec<String>),
    /// A terminal, or a signal.
    #[error(transparent)]
    Control(#[from] ControlError),
}

/// Runs the command.
///
/// # Errors
///
/// There is no fleet, or a car did not obey; all others were asked all the same.
pub fn run(args: &FleetArgs) -> Result<ExitCode, FleetError> {
    let fleet = || Fleet::read(&args.fleet);
    match &args.command {
        FleetCommand::Status { watch: false } => {
            let (lines, failures) = status(&fleet()?);
            print(&lines.join("\n"))?;
            obeyed(failures)?;
        }
        FleetCommand::Status { watch: true } => watch(&fleet()?)?,
        FleetCommand::Arm(args) => return arm::run(&fleet()?, args),
        FleetCommand::Disarm => {
            tell(&fleet()?, &Request::DISARM)?;
            print("disarming: all cars slow down and stop")?;
        }
        FleetCommand::Stop => {
            tell(&fleet()?, &Request::Stop {})?;
            print("stopped: neutral until the boards are reset")?;
        }
        FleetCommand::Cameras(args) => return cameras::run(args),
    }
    Ok(ExitCode::SUCCESS)
}

/// Does something with all cars at once; the results are in their order.
fn with_all<T: Send>(
    fleet: &Fleet,
    ask: impl Fn(&Car) -> Result<T, ClientError> + Sync,
) -> Vec<Result<T, ClientError>> {
    thread::scope(|scope| {
        let ask = &ask;
        let cars = fleet.cars.iter();
        let asked: Vec<_> = cars.map(|car| scope.spawn(move || ask(car))).collect();
        let answers = asked.into_iter().map(thread::ScopedJoinHandle::join);
        // A thread that has panicked has not heard its daemon.
        answers
            .map(|answer| answer.unwrap_or(Err(ClientError::Ended)))
            .collect()
    })
}

/// Asks all cars at once.
fn ask_all(fleet: &Fleet, request: &Request) -> Vec<Result<Answer, ClientError>> {
    with_all(fleet, |car| ask_within(request, &car.socket(), PATIENCE))
}

/// A connection to the daemon of a car with its number, and how far its clock is ahead of this
/// computer's.
fn connect(car: &Car) -> Result<(Connection, ClockOffset), ClientError> {
    let mut connection = Connection::open(&car.socket(), PATIENCE)?;
    if let Some(number) = car.number {
        let toml = answer(&mut connection, &Request::Configuration {})?.toml;
        let table = toml.and_then(|toml| toml.parse::<toml::Table>().ok());
        let configured = table
            .as_ref()
            .and_then(|table| table.get("board")?.get("car_id"));
        if configured.and_then(toml::Value::as_integer) != Some(number.into()) {
            let configured = configured.map_or_else(|| "unknown".to_owned(), ToString::to_string);
            return Err(ClientError::Refused(format!(
                "number is {number}, and board.car_id of its daemon is {configured}: correct the \
                 number or the socket in the fleet's file"
            )));
        }
    }
    let offset = connection.clock_offset(monotonic_ns, PATIENCE)?;
    Ok((connection, offset))
}

/// The answer to a request.
fn answer(connection: &mut Connection, request: &Request) -> Result<Answer, ClientError> {
    connection.send(request)?;
    let reply = connection.receive_within::<Reply>(PATIENCE)?;
    reply.ok_or(ClientError::Ended)?.agreed()
}

/// Tells all cars something.
fn tell(fleet: &Fleet, request: &Request) -> Result<(), FleetError> {
    let answers = ask_all(fleet, request).into_iter().zip(&fleet.cars);
    obeyed(
        answers
            .filter_map(|(answer, car)| Some(failure(car, &answer.err()?)))
            .collect(),
    )
}

fn failure(car: &Car, error: &ClientError) -> String {
    format!("{}: {error}", car.name)
}

fn obeyed(failures: Vec<String>) -> Result<(), FleetError> {
    if failures.is_empty() {
        Ok(())
    } else {
        Err(FleetError::Cars(failures))
    }
}

/// A line for each car that answers, and what failed of the others.
fn status(fleet: &Fleet) -> (Vec<String>, Vec<String>) {
    let (mut lines, mut failures) = (Vec::new(), Vec::new());
    let width = fleet
        .cars
        .iter()
        .map(|car| car.name.len())
        .max()
        .unwrap_or(0);
    let ask = |car: &Car| {
        let (mut connection, offset) = connect(car)?;
        let status = answer(&mut connection, &Request::Status {})?.status;
        Ok((status.ok_or(ClientError::Ended)?, offset))
    };
    for (answer, car) in with_all(fleet, ask).into_iter().zip(&fleet.cars) {
        match answer {
            Ok((status, offset)) => {
                lines.push(format!("{:width$}  {}", car.name, line(&status, &offset)));
            }
            Err(error) => failures.push(failure(car, &error)),
        }
    }
    (lines, failures)
}

/// What one car does, in a line.
fn line(status: &Status, clock: &ClockOffset) -> String {
    let place = status.estimate.as_ref().map_or_else(
        || "no pose".to_owned(),
        |estimate| {
            format!(
                "({:6.2}, {:6.2}) m {:5.2} m/s",
                estimate.x_m, estimate.y_m, estimate.speed_m_s
            )
        },
    );
    let filtering = status.filtering.as_deref().filter(|word| *word != "none");
    let reason = status.reason.as_deref().or(filtering).unwrap_or("");
    let [offset_ms, bound_ms] = [clock.offset_ns as f64, clock.bound_ns as f64].map(|ns| ns / 1e6);
    format!(
        "{:12} {place}  clock {offset_ms:+.3} ms ± {bound_ms:.3}  {reason}",
        status.mode
    )
    .trim_end()
    .to_owned()
}

fn watch(fleet: &Fleet) -> Result<(), FleetError> {
    let interrupt = Interrupt::listen().map_err(ControlError::from)?;
    let is_terminal = io::stdout().is_terminal();
    let mut drawn = 0;
    while !interrupt.is_raised() {
        let (mut lines, failures) = status(fleet);
        lines.extend(failures);
        if is_terminal && drawn > 0 {
            // Over the last ones.
            let up = write!(io::stdout(), "\x1b[{drawn}A\x1b[J");
            up.map_err(ControlError::Output)?;
        }
        drawn = lines.len();
        print(&lines.join("\n"))?;
        thread::sleep(WATCH);
    }
    Ok(())
}
