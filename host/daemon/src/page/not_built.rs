//! The server of a program without the feature `page`: it never starts.

use singletrack_core::config::PageSection;

use super::status::PageError;
use crate::{handle::DaemonHandle, live::LiveView};

#[derive(Clone, Copy, Debug)]
pub(crate) enum BoundPage {}

#[derive(Debug)]
pub(crate) enum PageThread {}

impl BoundPage {
    pub(crate) fn open(_: &PageSection) -> Result<Self, PageError> {
        Err(PageError::NotBuilt)
    }

    pub(crate) fn view(&self) -> LiveView {
        match *self {}
    }
}

impl PageThread {
    pub(crate) fn start(page: BoundPage, _: DaemonHandle) -> Result<Self, PageError> {
        match page {}
    }
}
