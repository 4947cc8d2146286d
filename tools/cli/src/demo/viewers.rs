//! What shows the drive while it goes on, as a client of the daemon's socket.

use std::{
    any::Any,
    error::Error,
    path::{Path, PathBuf},
};

use singletrack_core::config::PageSection;
use singletrack_viewers::page::{OtherCar, Page};

use super::DemoArgs;

/// The servers that the options ask for. They end when this value is dropped.
#[derive(Default)]
pub(super) struct Viewers(Vec<Box<dyn Any>>);

impl Viewers {
    /// Starts them for the daemon at `socket`, the page with the cars of `others`, and prints their
    /// addresses.
    pub(super) fn start(
        args: &DemoArgs,
        socket: &Path,
        others: &[PathBuf],
    ) -> Result<Self, Box<dyn Error>> {
        let mut viewers = Self::default();
        if let Some(port) = args.watch {
            let section = PageSection {
                port,
                ..PageSection::default()
            };
            let other = |socket: &PathBuf| OtherCar {
                socket: socket.clone(),
                colour: None,
            };
            let others = others.iter().map(other).collect();
            let page = Page::start(socket.to_owned(), others, &section)?;
            eprintln!("Watch the drive in a browser: http://{}", page.address);
            viewers.0.push(Box::new(page));
        }
        #[cfg(feature = "live")]
        if let Some(port) = args.live {
            let section = singletrack_core::config::LiveSection {
                port,
                ..Default::default()
            };
            let live = singletrack_viewers::live::Live::start(socket.to_owned(), section)?;
            eprintln!(
                "Live view: ws://{} (open a WebSocket connection in Foxglove, Lichtblick or \
                 PlotJuggler)",
                live.address
            );
            viewers.0.push(Box::new(live));
        }
        Ok(viewers)
    }
}
