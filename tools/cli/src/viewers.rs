//! `singletrack page|live`: what shows a drive, in processes of their own beside any daemon.

use std::{net::IpAddr, path::PathBuf};

use clap::Args;
use singletrack_api::{Fleet, FleetCar, log};
use singletrack_core::{Config, config::SocketSection};
use singletrack_figures::output::print;
use singletrack_viewers::page::{OtherCar, Page};

use crate::{Result, arguments::ConfiguredSocket, interrupt::Interrupt};

/// The options of both.
#[derive(Clone, Debug, Args)]
struct ViewerArgs {
    #[command(flatten)]
    socket: ConfiguredSocket,

    /// The daemon's configuration, for the socket and for what the other options leave out
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,

    /// Address to listen on [default: that of --config, or 127.0.0.1]
    #[arg(long, value_name = "ADDRESS")]
    address: Option<IpAddr>,
}

impl ViewerArgs {
    /// The path of the socket, and a section of the configuration.
    fn settings<T: Default>(&self, section: impl Fn(Config) -> T) -> Result<(PathBuf, T)> {
        let (socket, section) = match &self.config {
            Some(path) => {
                let config = Config::read(path)?;
                (config.socket.path.clone(), section(config))
            }
            None => (SocketSection::default().path, T::default()),
        };
        Ok((self.socket.or(socket), section))
    }
}

/// Options of `singletrack page`.
#[derive(Clone, Debug, Args)]
pub struct PageArgs {
    #[command(flatten)]
    viewer: ViewerArgs,

    /// The cars of a fleet: the page of the first, which shows the others beside
    #[arg(long, value_name = "FILE.toml")]
    fleet: Option<PathBuf>,

    /// Another car of the fleet for the first
    #[arg(long, value_name = "NAME", requires = "fleet")]
    car: Option<String>,

    /// Port to listen on; 0 takes any free port [default: that of --config, or 8767]
    #[arg(long, value_name = "PORT")]
    port: Option<u16>,

    /// File for a new token, which browsers then give; needed for an address beyond loopback
    /// [default: that of --config]
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
}

/// Serves the page until Ctrl-C.
///
/// # Errors
///
/// The configuration is invalid, or the page can't be served.
pub fn page(args: &PageArgs) -> Result<()> {
    let interrupt = Interrupt::listen()?;
    let (mut socket, mut section) = args.viewer.settings(|config| config.page)?;
    let mut others = Vec::new();
    if let Some(path) = &args.fleet {
        let mut cars = Fleet::read(path)?.cars;
        let name = args.car.as_ref();
        let is_first = |car: &FleetCar| name.is_none_or(|it| *it == car.name);
        let Some(first) = cars.iter().position(is_first) else {
            let names: Vec<_> = cars.iter().map(|car| car.name.as_str()).collect();
            let why = format!("--car is none of the fleet: {}", names.join(", "));
            return Err(why.into());
        };
        socket = cars.remove(first).socket();
        let other = |car: FleetCar| OtherCar {
            socket: car.socket(),
            colour: car.colour,
        };
        others = cars.into_iter().map(other).collect();
    }
    section.address = args.viewer.address.unwrap_or(section.address);
    section.port = args.port.unwrap_or(section.port);
    section.token_file = args.token_file.clone().or(section.token_file);
    start_log();
    let page = Page::start(socket, others, &section)?;
    let token = section.token_file.map_or_else(String::new, |path| {
        format!("/?token=TOKEN with the token from {}", path.display())
    });
    print(&format!("Page: http://{}{token}\n", page.address))?;
    interrupt.wait();
    Ok(())
}

/// Options of `singletrack live`.
#[cfg(feature = "live")]
#[derive(Clone, Debug, Args)]
pub struct LiveArgs {
    #[command(flatten)]
    viewer: ViewerArgs,

    /// Port to listen on; 0 takes any free port [default: that of --config, or 8765]
    #[arg(long, value_name = "PORT")]
    port: Option<u16>,
}

/// Serves the live view until Ctrl-C.
///
/// # Errors
///
/// The configuration is invalid, or the live view can't be served.
#[cfg(feature = "live")]
pub fn live(args: &LiveArgs) -> Result<()> {
    let interrupt = Interrupt::listen()?;
    let (socket, mut section) = args.viewer.settings(|config| config.live)?;
    section.address = args.viewer.address.unwrap_or(section.address);
    section.port = args.port.unwrap_or(section.port);
    start_log();
    let live = singletrack_viewers::live::Live::start(socket, section)?;
    print(&format!("Live view: ws://{}\n", live.address))?;
    interrupt.wait();
    Ok(())
}

/// The log: the daemon lost and found again.
fn start_log() {
    log::start("singletrack_viewers", log::LevelFilter::WARN);
}
