//! The reference from a moment on.

use singletrack_control::{Governor, Reference, ReferencePoint, Time};

/// The reference from now on.
#[derive(Clone, Copy)]
pub(super) struct PathAhead<'a> {
    pub(super) reference: &'a Reference,
    pub(super) governor: Option<&'a Governor>,
    pub(super) now: Time,
    /// Time since the start of the drive, s.
    pub(super) time: f64,
}

impl PathAhead<'_> {
    /// The point that is demanded `ahead` seconds from now; none where steering and speed are.
    pub(super) fn at(&self, ahead: f64) -> Option<ReferencePoint> {
        match self.governor {
            Some(governor) => Some(governor.at(self.reference, ahead)),
            None => self.reference.point_ahead(self.now, self.time, ahead),
        }
    }
}
