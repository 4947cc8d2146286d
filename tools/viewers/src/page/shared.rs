//! What the page's connections share: its files, and what they show.

use singletrack_access::Token;
use tokio::sync::Semaphore;

use super::{feed::Feed, setup::Setup};

/// A file of the page.
#[derive(Clone, Copy, Debug)]
pub(super) struct Asset {
    path: &'static str,
    pub(super) content_type: &'static str,
    pub(super) bytes: &'static [u8],
}

const SCRIPT: &str = "text/javascript; charset=utf-8";

const ASSETS: [Asset; 6] = [
    Asset {
        path: "/",
        content_type: "text/html; charset=utf-8",
        bytes: include_bytes!("assets/index.html"),
    },
    Asset {
        path: "/page.css",
        content_type: "text/css; charset=utf-8",
        bytes: include_bytes!("assets/page.css"),
    },
    Asset {
        path: "/page.js",
        content_type: SCRIPT,
        bytes: include_bytes!("assets/page.js"),
    },
    Asset {
        path: "/view.js",
        content_type: SCRIPT,
        bytes: include_bytes!("assets/view.js"),
    },
    Asset {
        path: "/chart.js",
        content_type: SCRIPT,
        bytes: include_bytes!("assets/chart.js"),
    },
    Asset {
        path: "/icon.svg",
        content_type: "image/svg+xml",
        bytes: include_bytes!("assets/icon.svg"),
    },
];

/// The file at this path.
pub(super) fn asset(path: &str) -> Option<Asset> {
    ASSETS.into_iter().find(|asset| asset.path == path)
}

/// What all connections share.
#[derive(Debug)]
pub(super) struct Shared {
    pub(super) feed: Feed,
    pub(super) setup: Setup,
    pub(super) token: Option<Token>,
    /// For viewers of the events.
    pub(super) places: Semaphore,
}
