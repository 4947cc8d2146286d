//! `singletrack fleet cameras`: one NatNet client of this computer for all its daemons.

use std::{
    error::Error,
    net::{Ipv4Addr, SocketAddr, SocketAddrV4, UdpSocket},
    process::ExitCode,
    sync::{Mutex, PoisonError},
    thread,
    time::{Duration, Instant},
};

use clap::Args;

use crate::operator::{cameras::parse_address, control::print};

/// A daemon asks more often. A server drops a silent client as late.
const SILENCE: Duration = Duration::from_secs(5);

/// The largest datagram.
const DATAGRAM: usize = 65_535;

/// Options of `singletrack fleet cameras`.
#[derive(Clone, Debug, Args)]
pub(super) struct FleetCamerasArgs {
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
pub(super) fn run(args: &FleetCamerasArgs) -> Result<ExitCode, Box<dyn Error>> {
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
