//! Prints the poses of all rigid bodies that a NatNet server streams.
//!
//! ```text
//! cargo run --example natnet_client -- 192.168.1.10
//! cargo run --example natnet_client -- 192.168.1.10 --multicast 192.168.1.20 --up-axis z
//! ```
//!
//! The server streams unicast unless `--multicast` names the local address of the
//! network interface on which the frames arrive. A line holds the time of the exposure
//! since the program started with its uncertainty, the body, its position in metres
//! (z up) and its quaternion x, y, z, w.

use std::{
    collections::BTreeMap,
    error::Error,
    io::{self, Write},
    net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket},
    sync::{
        atomic::{AtomicBool, Ordering},
        mpsc::{self, Receiver, Sender},
    },
    thread,
    time::{Duration, Instant},
};

use singletrack_mocap::{
    BodyState, DEFAULT_COMMAND_PORT, DEFAULT_DATA_PORT, DEFAULT_MULTICAST_GROUP, Input, NameText,
    Output, PoseFrame, PoseSource as _, Session, SessionConfig, Transport, UpAxis,
    codec::{BitstreamVersion, MAX_DATAGRAM_LEN},
};

const USAGE: &str = "usage: natnet_client SERVER [--multicast INTERFACE] [--group ADDRESS]
                     [--command-port PORT] [--data-port PORT]
                     [--up-axis y|z] [--frames COUNT]";

/// How often a reader looks whether the program ends.
const READ_TIMEOUT: Duration = Duration::from_millis(100);

/// The command line.
#[derive(Clone, Debug)]
pub(crate) struct Options {
    /// The server's address.
    pub(crate) server: Ipv4Addr,
    /// The local address of the interface on which multicast arrives; `None` is unicast.
    pub(crate) multicast: Option<Ipv4Addr>,
    /// The multicast group.
    pub(crate) group: Ipv4Addr,
    /// The server's command port.
    pub(crate) command_port: u16,
    /// The port of multicast frames.
    pub(crate) data_port: u16,
    /// The axis that points up in the stream.
    pub(crate) up_axis: UpAxis,
    /// Ends after this number of frames.
    pub(crate) frames: Option<u64>,
}

impl Options {
    /// Reads the arguments that follow the program's name.
    pub(crate) fn parse(
        mut arguments: impl Iterator<Item = String>,
    ) -> Result<Self, Box<dyn Error>> {
        let mut options = Self {
            server: arguments.next().ok_or(USAGE)?.parse().map_err(|_| USAGE)?,
            multicast: None,
            group: DEFAULT_MULTICAST_GROUP,
            command_port: DEFAULT_COMMAND_PORT,
            data_port: DEFAULT_DATA_PORT,
            up_axis: UpAxis::Y,
            frames: None,
        };
        while let Some(name) = arguments.next() {
            let value = arguments.next().ok_or(USAGE)?;
            match name.as_str() {
                "--multicast" => options.multicast = Some(value.parse()?),
                "--group" => options.group = value.parse()?,
                "--command-port" => options.command_port = value.parse()?,
                "--data-port" => options.data_port = value.parse()?,
                "--up-axis" if value == "y" => options.up_axis = UpAxis::Y,
                "--up-axis" if value == "z" => options.up_axis = UpAxis::Z,
                "--frames" => options.frames = Some(value.parse()?),
                _ => return Err(USAGE.into()),
            }
        }
        Ok(options)
    }

    fn session(&self) -> Result<Session, Box<dyn Error>> {
        let transport = match self.multicast {
            Some(_) => Transport::Multicast,
            // A server newer than this crate is asked for the newest version it reads.
            None => Transport::Unicast {
                bitstream: Some(BitstreamVersion::NEWEST),
            },
        };
        let mut config = SessionConfig::new(IpAddr::V4(self.server), transport, self.up_axis);
        config.command_port = self.command_port;
        Ok(Session::new(config)?)
    }

    /// The socket for commands, and one for multicast frames. Unicast frames arrive at
    /// the socket for commands.
    fn sockets(&self) -> io::Result<Vec<UdpSocket>> {
        let interface = self.multicast.unwrap_or(Ipv4Addr::UNSPECIFIED);
        let mut sockets = vec![UdpSocket::bind((interface, 0))?];
        if self.multicast.is_some() {
            // Bound to the group, the socket receives nothing else, and a server on the same
            // machine can use the port as well. Windows can't bind to a group.
            let address = if cfg!(windows) {
                Ipv4Addr::UNSPECIFIED
            } else {
                self.group
            };
            let data = UdpSocket::bind((address, self.data_port))?;
            data.join_multicast_v4(&self.group, &interface)?;
            sockets.push(data);
        }
        Ok(sockets)
    }
}

/// A datagram and the time of its arrival.
struct Arrival {
    time_ns: u64,
    source: SocketAddr,
    datagram: Vec<u8>,
}

/// The local monotonic clock.
#[derive(Clone, Copy)]
struct Clock(Instant);

impl Clock {
    fn now_ns(self) -> u64 {
        u64::try_from(self.0.elapsed().as_nanos()).unwrap_or(u64::MAX)
    }
}

/// Reads a socket until `stop`. The time of arrival is taken here, so that nothing which
/// the other thread does makes a datagram look later than it was.
fn read(socket: &UdpSocket, clock: Clock, stop: &AtomicBool, arrivals: &Sender<Arrival>) {
    let mut buffer = vec![0; MAX_DATAGRAM_LEN];
    while !stop.load(Ordering::Relaxed) {
        // An error is a time-out, or an earlier datagram that was not delivered.
        let Ok((length, source)) = socket.recv_from(&mut buffer) else {
            continue;
        };
        let arrival = Arrival {
            time_ns: clock.now_ns(),
            source,
            datagram: buffer.get(..length).unwrap_or_default().to_vec(),
        };
        if arrivals.send(arrival).is_err() {
            return;
        }
    }
}

/// Connects, and prints poses until the number of frames is reached.
pub(crate) fn run(options: &Options, out: &mut impl Write) -> Result<(), Box<dyn Error>> {
    let session = options.session()?;
    let sockets = options.sockets()?;
    for socket in &sockets {
        socket.set_read_timeout(Some(READ_TIMEOUT))?;
    }
    let command = sockets.first().ok_or("no socket")?;
    let clock = Clock(Instant::now());
    let stop = AtomicBool::new(false);
    let (sender, arrivals) = mpsc::channel();
    thread::scope(|scope| {
        for socket in &sockets {
            let (sender, stop) = (sender.clone(), &stop);
            scope.spawn(move || read(socket, clock, stop, &sender));
        }
        let client = Client {
            names: BTreeMap::new(),
            frames: 0,
            out,
        };
        let result = client.run(session, options.frames, command, clock, &arrivals);
        stop.store(true, Ordering::Relaxed);
        result
    })
}

struct Client<W> {
    /// The bodies' names by their streaming ids.
    names: BTreeMap<i32, String>,
    frames: u64,
    out: W,
}

impl<W: Write> Client<W> {
    fn run(
        mut self,
        mut session: Session,
        frames: Option<u64>,
        command: &UdpSocket,
        clock: Clock,
        arrivals: &Receiver<Arrival>,
    ) -> Result<(), Box<dyn Error>> {
        let mut waiting: Option<Arrival> = None;
        loop {
            // 1. What has arrived, oldest first.
            for arrival in waiting.take().into_iter().chain(arrivals.try_iter()) {
                let input = Input::Datagram {
                    source: arrival.source,
                    bytes: &arrival.datagram,
                };
                let mut result = Ok(());
                session.handle_input(arrival.time_ns, input, &mut |output| {
                    result = self.take(&output);
                });
                result?;
            }
            // 2. What did not arrive.
            let now_ns = clock.now_ns();
            session.handle_timeout(now_ns, &mut |output| eprintln!("{output:?}"));
            if frames.is_some_and(|frames| self.frames >= frames) {
                session.close();
            }
            // 3. What is due to be sent.
            while let Some(transmit) = session.poll_transmit(now_ns) {
                // The session repeats what matters.
                if let Err(error) = command.send_to(&transmit.bytes, transmit.destination) {
                    eprintln!("can't send to {}: {error}", transmit.destination);
                }
            }
            // 4. When to wake up. A closed session has no deadline.
            let Some(deadline_ns) = session.poll_timeout() else {
                return Ok(());
            };
            let wait = Duration::from_nanos(deadline_ns.saturating_sub(now_ns));
            waiting = arrivals.recv_timeout(wait).ok();
        }
    }

    fn take(&mut self, output: &Output<'_>) -> io::Result<()> {
        match output {
            Output::Names(names) => {
                self.names.clear();
                names.for_each(&mut |id, name| {
                    self.names.insert(id, NameText(name).to_string());
                });
            }
            Output::Frame(frame) => {
                self.frames += 1;
                self.print(frame)?;
            }
            Output::Event(event) => eprintln!("{event:?}"),
        }
        Ok(())
    }

    fn print(&mut self, frame: &PoseFrame<'_>) -> io::Result<()> {
        let time = frame.capture.map_or_else(
            || "no time".to_owned(),
            |capture| {
                let (time_s, uncertainty_ms) = (
                    capture.time_ns as f64 * 1e-9,
                    capture.uncertainty_ns as f64 * 1e-6,
                );
                format!("{time_s:.6} s ± {uncertainty_ms:.3} ms")
            },
        );
        for body in frame.bodies() {
            // Without current definitions an id may mean another body.
            let name = match self.names.get(&body.id) {
                Some(name) if frame.definitions_current => name,
                _ => "?",
            };
            write!(self.out, "{time}  {name} ({})  ", body.id)?;
            match body.state {
                BodyState::Tracked(pose) => {
                    let [x, y, z] = pose.position_m;
                    let [qx, qy, qz, qw] = pose.orientation_xyzw;
                    writeln!(
                        self.out,
                        "{x:.4} {y:.4} {z:.4} m  {qx:.4} {qy:.4} {qz:.4} {qw:.4}"
                    )?;
                }
                BodyState::Untracked => writeln!(self.out, "not tracked")?,
                BodyState::Invalid(reason) => writeln!(self.out, "{reason}")?,
            }
        }
        Ok(())
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let options = Options::parse(std::env::args().skip(1))?;
    run(&options, &mut io::stdout().lock())
}
