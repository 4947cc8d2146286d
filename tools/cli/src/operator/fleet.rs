//! `singletrack fleet`: one command for several cars, each with a daemon of its own.

use std::{
    io::{self, IsTerminal as _, Write as _},
    net::{Ipv4Addr, SocketAddr, SocketAddrV4, UdpSocket},
    path::PathBuf,
    process::ExitCode,
    sync::{Mutex, PoisonError},
    thread,
    time::{Duration, Instant},
};

use clap::{Args, Subcommand};
use singletrack_api::{ClockOffset, Fleet, FleetArm, FleetDrive, NotObeyed, Request, Status};
use singletrackd::monotonic_ns;

use crate::{
    Result,
    interrupt::Interrupt,
    operator::{
        arm::{ended_as_wanted, is_wanted, parse_time, warn},
        cameras::parse_address,
        control::print,
    },
};

/// Interval of `status --watch`.
const WATCH: Duration = Duration::from_millis(500);

/// Options of `singletrack fleet`.
#[derive(Clone, Debug, Args)]
pub struct FleetArgs {
    /// The cars
    #[arg(long, value_name = "FILE.toml", global = true)]
    #[arg(default_value = "fleet.toml")]
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
    Arm(FleetArmArgs),
    /// Slow all cars down, stop and disarm them.
    Disarm,
    /// Emergency stop of all cars: neutral at once, until their boards are reset.
    Stop,
    /// Hear a NatNet server once for all daemons of this computer, until Ctrl-C.
    ///
    /// For unicast: a server may send to one client of a computer only. With multicast, each daemon
    /// hears the one stream.
    Cameras(FleetCamerasArgs),
}

/// Runs the command.
///
/// # Errors
///
/// There is no fleet, or a car did not obey; all others were asked all the same.
pub fn run(args: &FleetArgs) -> Result<ExitCode> {
    let fleet = || Fleet::read(&args.fleet);
    match &args.command {
        FleetCommand::Status { watch: false } => {
            let (lines, failures) = status(&fleet()?);
            print(&lines.join("\n"))?;
            if !failures.is_empty() {
                return Err(NotObeyed(failures).into());
            }
        }
        FleetCommand::Status { watch: true } => watch(&fleet()?)?,
        FleetCommand::Arm(args) => return arm(&fleet()?, args),
        FleetCommand::Disarm => {
            fleet()?.tell(&Request::DISARM)?;
            print("disarming: all cars slow down and stop")?;
        }
        FleetCommand::Stop => {
            fleet()?.tell(&Request::Stop {})?;
            print("stopped: neutral until the boards are reset")?;
        }
        FleetCommand::Cameras(args) => return cameras(args),
    }
    Ok(ExitCode::SUCCESS)
}

/// A line for each car that answers, and what failed of the others.
fn status(fleet: &Fleet) -> (Vec<String>, Vec<String>) {
    let (mut lines, mut failures) = (Vec::new(), Vec::new());
    let names = fleet.cars.iter().map(|car| car.name.as_str());
    let width = names.clone().map(str::len).max().unwrap_or(0);
    for (answer, name) in fleet.status(monotonic_ns).into_iter().zip(names) {
        match answer {
            Ok((status, offset)) => {
                lines.push(format!("{name:width$}  {}", line(&status, &offset)));
            }
            Err(failure) => failures.push(failure),
        }
    }
    (lines, failures)
}

/// What one car does, in a line.
fn line(status: &Status, clock: &ClockOffset) -> String {
    let state = status.state.as_ref();
    let place = state.and_then(|state| {
        let (x_m, y_m, speed_m_s) = (state.x_m?, state.y_m?, state.speed_m_s?);
        Some(format!("({x_m:6.2}, {y_m:6.2}) m {speed_m_s:5.2} m/s"))
    });
    let place = place.unwrap_or_else(|| "no pose".to_owned());
    let filtering = state.map(|state| &*state.filtering);
    let filtering = filtering.filter(|word| *word != "none");
    let reason = status.reason().or(filtering).unwrap_or("");
    let [offset_ms, bound_ms] = [clock.offset_ns as f64, clock.bound_ns as f64].map(|ns| ns / 1e6);
    let mode = status.mode();
    let line = format!("{mode:12} {place}  clock {offset_ms:+.3} ms ± {bound_ms:.3}  {reason}");
    line.trim_end().to_owned()
}

fn watch(fleet: &Fleet) -> Result<()> {
    let interrupt = Interrupt::listen()?;
    let is_terminal = io::stdout().is_terminal();
    let mut drawn = 0;
    while !interrupt.is_raised() {
        let (mut lines, failures) = status(fleet);
        lines.extend(failures);
        if is_terminal && drawn > 0 {
            // Over the last ones.
            write!(io::stdout(), "\x1b[{drawn}A\x1b[J")?;
        }
        drawn = lines.len();
        print(&lines.join("\n"))?;
        thread::sleep(WATCH);
    }
    Ok(())
}

/// Options of `singletrack fleet arm`.
#[derive(Clone, Debug, Args)]
struct FleetArmArgs {
    /// Drive for this time, such as 60s, and stop
    #[arg(long = "for", value_name = "DURATION", value_parser = parse_time)]
    time: Option<Duration>,
    /// The time until all references begin, within 10 ms of each other; the cars are armed before
    #[arg(long, value_name = "DURATION", value_parser = parse_time, default_value = "3s")]
    start_in: Duration,
    /// Stop all cars when the drive of one of them ends
    #[arg(long)]
    together: bool,
    /// Arm also cars that have not passed doctor, bring-up and calibrate
    #[arg(long)]
    uncalibrated: bool,
}

/// Arms all cars, if all are ready, and holds their drives until all have ended.
fn arm(fleet: &Fleet, args: &FleetArmArgs) -> Result<ExitCode> {
    let interrupt = Interrupt::listen()?;
    let options = FleetArm {
        start_in: args.start_in,
        together: args.together,
        uncalibrated: args.uncalibrated,
    };
    let mut drive = FleetDrive::begin(fleet, &options, monotonic_ns)?;
    while !drive.is_over() {
        let is_over = args.time.is_some_and(|time| drive.start.elapsed() >= time);
        if interrupt.is_raised() || is_over {
            drive.disarm();
        }
        drive.step();
        warn(&drive.warnings());
    }
    let mut as_wanted = true;
    for car in drive.ends()? {
        as_wanted &= is_wanted(&car.ended);
        print(&format!("{}: {}", car.name, car.ended))?;
    }
    Ok(ended_as_wanted(as_wanted))
}

/// A daemon asks more often. A server drops a silent client as late.
const SILENCE: Duration = Duration::from_secs(5);

/// The largest datagram.
const DATAGRAM: usize = 65_535;

/// Options of `singletrack fleet cameras`.
#[derive(Clone, Debug, Args)]
struct FleetCamerasArgs {
    /// Address of the computer with Motive
    #[arg(long, value_name = "ADDRESS", value_parser = parse_address)]
    server: Ipv4Addr,
    /// Its command port
    #[arg(long, value_name = "PORT", default_value_t = 1510)]
    port: u16,
    /// Where the daemons find the cameras: their `motion_capture.server` and `command_port`
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:1510")]
    listen: SocketAddrV4,
}

/// The daemons, and when each was heard.
#[derive(Debug, Default)]
struct Clients(Vec<(SocketAddr, Instant)>);

impl Clients {
    /// Notes that one was heard. Those that were silent for too long are dropped.
    fn hear(&mut self, client: SocketAddr, now: Instant) {
        self.0
            .retain(|(other, heard)| *other != client && now.duration_since(*heard) < SILENCE);
        self.0.push((client, now));
    }
}

/// Passes what the daemons ask on to the server, and every answer and frame on to all of them,
/// until it is killed. A daemon takes only the answers to its own questions, among them the
/// server's clock: so what the way through this process takes is in the age of a pose.
fn cameras(args: &FleetCamerasArgs) -> Result<ExitCode> {
    let server = SocketAddrV4::new(args.server, args.port);
    let is_itself = args.server.is_loopback() || args.server == *args.listen.ip();
    if is_itself && args.port == args.listen.port() {
        let listen = args.listen;
        return Err(format!(
            "--listen {listen} is the cameras' own address: give another one, such as 127.0.0.1:1512"
        )
        .into());
    }
    let bind = |address: SocketAddrV4| {
        UdpSocket::bind(address).map_err(|error| {
            format!("can't receive on {address}: {error}; is another program at this address?")
        })
    };
    let daemons = bind(args.listen)?;
    let cameras = bind(SocketAddrV4::new(Ipv4Addr::UNSPECIFIED, 0))?;
    let here = daemons.local_addr().unwrap_or(args.listen.into());
    print(&format!("cameras at {server} for daemons at {here}"))?;
    let clients = Mutex::new(Clients::default());
    thread::scope(|scope| {
        scope.spawn(|| {
            let mut buffer = [0; DATAGRAM];
            loop {
                // An error, such as an unreachable network, is a lost datagram: all is repeated.
                let Ok((length, client)) = daemons.recv_from(&mut buffer) else {
                    continue;
                };
                let mut clients = clients.lock().unwrap_or_else(PoisonError::into_inner);
                clients.hear(client, Instant::now());
                let _ = cameras.send_to(buffer.get(..length).unwrap_or_default(), server);
            }
        });
        let mut buffer = [0; DATAGRAM];
        loop {
            let Ok((length, source)) = cameras.recv_from(&mut buffer) else {
                continue;
            };
            // Frames come from another port than answers.
            if source.ip() != args.server {
                continue;
            }
            let clients = clients.lock().unwrap_or_else(PoisonError::into_inner);
            for (client, _) in &clients.0 {
                let _ = daemons.send_to(buffer.get(..length).unwrap_or_default(), client);
            }
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_silent_daemon_is_dropped() {
        let [one, two] = [1, 2].map(|port| SocketAddr::from(([127, 0, 0, 1], port)));
        let begin = Instant::now();
        let mut clients = Clients::default();
        clients.hear(one, begin);
        clients.hear(two, begin + SILENCE / 2);
        clients.hear(two, begin + SILENCE * 3 / 4);
        let is_heard = |clients: &Clients, which| clients.0.iter().any(|(it, _)| *it == which);
        assert!(is_heard(&clients, one) && clients.0.len() == 2);
        clients.hear(two, begin + SILENCE);
        assert!(!is_heard(&clients, one) && is_heard(&clients, two));
    }
}
