//! `singletrack cameras`: what the motion capture sends, without a daemon.

mod survey;

use std::{
    net::{Ipv4Addr, SocketAddr},
    path::PathBuf,
    process::ExitCode,
    thread,
    time::Duration,
};

use clap::{Args, ValueEnum};
use serde::Serialize;
use singletrack_core::{
    cameras::{Channel, Sockets as _, StreamEvent},
    config::{Config, MotionCaptureSection, ServerKind, TransportKind, UpAxis},
};
use singletrack_figures::output;
use singletrack_mocap::{Input, Phase, SessionEvent as Event, Source};
use singletrackd::{MocapSockets, monotonic_ns};

use crate::{Result, arguments::parse_duration, help::printable, progress::progress_bar};
use survey::{BodyReport, Survey, Times};

/// Options of `singletrack cameras`.
#[derive(Args, Debug)]
pub struct CamerasArgs {
    /// The daemon's configuration: what is looked at is its `[motion_capture]`
    #[arg(long, value_name = "FILE.toml", conflicts_with = "server")]
    config: Option<PathBuf>,

    /// Address of the computer with the cameras' program; every kind of server is tried. Without
    /// it and a configuration, the network is asked for NatNet and Qualisys servers
    #[arg(long, value_name = "ADDRESS", value_parser = parse_address)]
    server: Option<Ipv4Addr>,

    /// What the server speaks: natnet, vrpn or qualisys
    #[arg(long, value_name = "KIND", value_parser = parse_kind, requires = "server")]
    kind: Option<ServerKind>,

    /// Port of the server, if it is not the usual one
    #[arg(long, value_name = "PORT", requires = "kind")]
    port: Option<u16>,

    /// How the frames arrive: unicast, multicast or tcp
    #[arg(long, value_name = "TRANSPORT", value_parser = parse_transport, conflicts_with = "config")]
    transport: Option<TransportKind>,

    /// Address of this computer in the cameras' network, for multicast
    #[arg(long, value_name = "ADDRESS", conflicts_with = "config")]
    interface: Option<Ipv4Addr>,

    /// The server's axis that points up [default: y with NatNet, as Motive's; z with others]
    #[arg(long, value_name = "y|z", value_parser = parse_up_axis, conflicts_with = "config")]
    up_axis: Option<UpAxis>,

    /// How long to look
    #[arg(long = "for", value_name = "DURATION", default_value = "3s", value_parser = parse_duration)]
    duration: Duration,

    /// What to print
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Format {
    /// A table.
    Text,
    /// One JSON object a server.
    Json,
}

pub(crate) fn parse_address(text: &str) -> Result<Ipv4Addr, &'static str> {
    match text {
        "localhost" => Ok(Ipv4Addr::LOCALHOST),
        _ => text
            .parse()
            .map_err(|_| "write an IPv4 address, such as 192.168.1.10"),
    }
}

fn parse_kind(text: &str) -> Result<ServerKind, &'static str> {
    ServerKind::named(&text.to_lowercase()).ok_or("choose natnet, vrpn or qualisys")
}

fn parse_transport(text: &str) -> Result<TransportKind, &'static str> {
    TransportKind::named(text).ok_or("choose unicast, multicast or tcp")
}

fn parse_up_axis(text: &str) -> Result<UpAxis, &'static str> {
    UpAxis::named(text).ok_or("choose y or z")
}

/// The least rate to drive by, with a latency of 15 ms: a pose may be 50 ms old when the next one comes.
const LEAST_HZ: f64 = 30.0;

/// The most latency to be armed with, at 100 Hz.
const MOST_LATENCY_MS: f64 = 40.0;

/// Nobody answered.
const NO_SERVER: &str = "no NatNet or Qualisys server answers in this network; a firewall may keep \
                         answers away, and VRPN can't be asked: give its address with --server";

/// A server that is looked at.
struct Watched {
    section: MotionCaptureSection,
    source: Source,
    sockets: MocapSockets,
    survey: Survey,
    stream: Vec<u8>,
}

/// What was found.
#[derive(Serialize)]
struct Report {
    kind: &'static str,
    server: String,
    /// The axis with which the poses were read.
    up_axis: &'static str,
    answers: bool,
    frames: u64,
    lost: u64,
    late: u64,
    malformed: u64,
    times: Option<Times>,
    bodies: Vec<BodyReport>,
    notes: Vec<String>,
}

/// Looks at the cameras, and prints what they send. Failure: nothing sends poses.
///
/// # Errors
///
/// The configuration or a socket can't be used.
pub fn run(args: &CamerasArgs) -> Result<ExitCode> {
    let sections = sections(args)?.into_iter();
    let mut watched: Vec<_> = sections.map(Watched::new).collect::<Result<_>>()?;
    let millis = args.duration.as_millis() as u64;
    let bar = progress_bar(millis, "looking at the cameras {wide_bar} {eta}");
    let began_ns = monotonic_ns();
    loop {
        let elapsed_ms = (monotonic_ns() - began_ns) / 1_000_000;
        if elapsed_ms >= millis {
            break;
        }
        bar.set_position(elapsed_ms);
        watched.iter_mut().for_each(Watched::poll);
        thread::sleep(Duration::from_micros(200));
    }
    bar.finish_and_clear();
    let seconds = args.duration.as_secs_f64();
    watched.iter_mut().for_each(Watched::close);
    let mut reports: Vec<_> = watched.iter().map(|it| it.report(seconds)).collect();
    // Where all kinds were tried, those that do not answer are no news if one does.
    if reports.iter().any(|report| report.answers) && args.kind.is_none() {
        reports.retain(|report| report.answers);
    }
    let mut text = String::new();
    for report in &reports {
        match args.format {
            Format::Json => {
                text += &serde_json::to_string(report)?;
                text.push('\n');
            }
            Format::Text => report.write(&mut text),
        }
    }
    output::print(&text)?;
    let is_good = reports.iter().any(|report| report.frames > 0);
    Ok(ExitCode::from(u8::from(!is_good)))
}

fn sections(args: &CamerasArgs) -> Result<Vec<MotionCaptureSection>> {
    if let Some(path) = &args.config {
        return Ok(vec![Config::read(path)?.motion_capture]);
    }
    let of_server = |server| match args.kind {
        Some(kind) => vec![(kind, server)],
        None if args.transport == Some(TransportKind::Multicast) => {
            vec![(ServerKind::NatNet, server)]
        }
        None => ServerKind::ALL.map(|kind| (kind, server)).to_vec(),
    };
    let servers = match args.server {
        Some(server) => of_server(server),
        // A question to the network does not reach this computer's own servers.
        None => [Ipv4Addr::LOCALHOST, Ipv4Addr::BROADCAST]
            .into_iter()
            .filter_map(|asked| survey::servers(asked).ok())
            .flatten()
            .collect(),
    };
    if servers.is_empty() {
        return Err(NO_SERVER.into());
    }
    let section = |(kind, server)| MotionCaptureSection {
        kind,
        command_port: args.port,
        transport: args.transport.unwrap_or(TransportKind::Unicast),
        interface: args.interface.unwrap_or(Ipv4Addr::UNSPECIFIED),
        ..MotionCaptureSection::new(
            server,
            "car",
            args.up_axis.unwrap_or(match kind {
                ServerKind::NatNet => UpAxis::Y,
                ServerKind::Vrpn | ServerKind::Qualisys => UpAxis::Z,
            }),
        )
    };
    Ok(servers.into_iter().map(section).collect())
}

impl Watched {
    fn new(section: MotionCaptureSection) -> Result<Self> {
        section.validate()?;
        // All bodies: without a name that is followed.
        let source = Source::new(section.session()?.session, None)?;
        Ok(Self {
            source,
            sockets: MocapSockets::open(&section)?,
            section,
            survey: Survey::default(),
            stream: Vec::new(),
        })
    }

    fn poll(&mut self) {
        let survey = &mut self.survey;
        let mut take = |output: singletrack_mocap::Output<'_>| survey.take(&output);
        let mut buffer = [0; 65_535];
        for channel in [Channel::Command, Channel::Data] {
            while let Some((length, source)) = self.sockets.receive(channel, &mut buffer) {
                let bytes = buffer.get(..length).unwrap_or_default();
                let input = Input::Datagram { source, bytes };
                self.source.handle_input(monotonic_ns(), input, &mut take);
            }
        }
        let input = match self.sockets.stream(self.source.stream(), &mut self.stream) {
            StreamEvent::Nothing => None,
            StreamEvent::Received => Some(Input::Stream(&self.stream)),
            StreamEvent::Opened(local) => Some(Input::Opened(local)),
            StreamEvent::Closed => Some(Input::Closed),
        };
        if let Some(input) = input {
            let is_stream = matches!(input, Input::Stream(_));
            let used = self.source.handle_input(monotonic_ns(), input, &mut take);
            let used = if is_stream { used } else { usize::MAX };
            self.stream.drain(..used.min(self.stream.len()));
        }
        self.source.handle_timeout(monotonic_ns(), &mut take);
        self.transmit();
    }

    fn transmit(&mut self) {
        while let Some(transmit) = self.source.poll_transmit(monotonic_ns()) {
            if transmit.on_stream {
                self.sockets.write_stream(&transmit.bytes);
            } else {
                self.sockets.send(transmit.destination, &transmit.bytes);
            }
        }
    }

    fn close(&mut self) {
        self.source.close();
        self.transmit();
    }

    fn report(&self, seconds: f64) -> Report {
        let address = SocketAddr::new(self.section.server.into(), self.section.port());
        let (counters, events) = (self.source.counters(), &self.survey.events);
        let (frames, bodies) = (self.survey.frames, self.survey.bodies(seconds));
        let times = self.survey.times();
        let said = |event: Event| events.contains(&event);
        let is_foreign = said(Event::Foreign);
        let answers = events.iter().any(|event| {
            matches!(
                event,
                Event::Connected(_) | Event::Opened | Event::Refused(_)
            )
        });
        let mut notes = Vec::new();
        let mut note = |text: &str| notes.push(text.to_owned());
        if is_foreign {
            note(&format!(
                "what is at {address} says nothing or something else: another kind, or port?"
            ));
        } else if !answers {
            note(&format!(
                "nothing answers at {address}: address, program, streaming, firewall?"
            ));
        }
        for event in events {
            note(&match event {
                Event::Refused(version) => version.to_string(),
                Event::DefinitionsUnreadable(error) => {
                    format!("a part of its list of bodies can't be read: {error}")
                }
                Event::OtherSource(other) => {
                    format!("packets come from {other}: a second network card?")
                }
                _ => continue,
            });
        }
        if answers && frames == 0 {
            note("it answers and sends no frames: is it measuring, and streaming?");
        }
        let old = counters.duplicates + counters.late;
        if old > frames {
            note(&format!(
                "{old} frames were no newer than the one before: the server must stamp each with the \
                 time of its exposure"
            ));
        }
        let rate_hz = bodies.iter().map(|body| body.rate_hz).fold(0.0, f64::max);
        if answers && frames > 0 && rate_hz < LEAST_HZ {
            note(&format!(
                "{rate_hz:.0} poses a second are too few to drive by: at least {LEAST_HZ:.0}, best 100"
            ));
        }
        let latency_ms = times.as_ref().map_or(0.0, |times| times.latency_ms);
        if latency_ms >= 1_000.0 {
            note(
                "the stamps are not by the clock with which the server answers: VRPN stamps in UTC, \
                 not in local time",
            );
        }
        if frames > 0 && times.is_none() {
            note(
                "the stamps are after the arrival of the frames, or long before the server's clock",
            );
        }
        if (MOST_LATENCY_MS..1_000.0).contains(&latency_ms) {
            note(&format!(
                "above {MOST_LATENCY_MS:.0} ms the car is not armed at 100 Hz, at a lower rate sooner"
            ));
        }
        if said(Event::DatagramsBlocked) {
            note("poses come over TCP: none arrive over UDP, which a firewall closes");
        }
        if said(Event::Contradicted) {
            note("two programs send with the server's address");
        }
        if counters.clock_steps > 0 {
            note("the server's clock was set while it was looked at");
        }
        Report {
            kind: self.section.kind.name(),
            server: address.to_string(),
            up_axis: self.section.up_axis.name(),
            answers: answers && !matches!(self.source.phase(), Phase::Foreign),
            frames,
            lost: counters.lost,
            late: counters.late,
            malformed: counters.malformed,
            times,
            bodies,
            notes,
        }
    }
}

impl Report {
    fn write(&self, text: &mut String) {
        let (kind, server, up_axis) = (self.kind, &self.server, self.up_axis);
        let (frames, lost, late, damaged) = (self.frames, self.lost, self.late, self.malformed);
        // VRPN knows no frames.
        let unit = if kind == "vrpn" { "poses" } else { "frames" };
        *text += &format!(
            "{kind} server {server}: {frames} {unit}, {lost} lost, {late} late, {damaged} damaged\n"
        );
        if let Some(times) = &self.times {
            let (latency, uncertainty) = (times.latency_ms, times.uncertainty_ms);
            let times = format!(
                "{latency:.1} ms, known to {uncertainty:.1} ms ({})",
                times.source
            );
            *text += &format!("latency {times}\n");
        }
        for note in &self.notes {
            *text += &format!("{}\n", printable(note));
        }
        if self.bodies.is_empty() {
            return;
        }
        *text += &format!(
            "read with {up_axis} up (--up-axis); a car on the floor is at z = 0 to 0.3 m\n\n\
             body                 id     Hz   seen jitter    spread              x, y, z (m)     yaw\n"
        );
        for body in &self.bodies {
            let position = body
                .position_m
                .map(|[x, y, z]| format!("{x:7.3} {y:7.3} {z:7.3}"));
            let position = position.unwrap_or_else(|| "-".to_owned());
            let yaw = body.yaw_deg.map(|yaw| format!("{yaw:.1}"));
            *text += &format!(
                "{:<16} {:>6} {:>6.1} {:>4.0} % {:>3.1} ms {:>6.2} mm  {position:>23} {:>7}\n",
                printable(body.name.as_deref().unwrap_or("(no name)")),
                body.id,
                body.rate_hz,
                100.0 * body.seen,
                body.jitter_ms,
                body.spread_mm,
                yaw.as_deref().unwrap_or("-"),
            );
            for remark in &body.remarks {
                *text += &format!("  {remark}\n");
            }
        }
    }
}
