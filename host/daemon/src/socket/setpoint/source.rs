//! Which connection gives the set-points.
//!
//! Two programs that steer at the same time would drive the car by turns. So one connection is
//! the source: the one that gave the newest set-point, for as long as it is connected and that
//! set-point is younger than the time-out. It need not be the one that holds the drive: a person
//! may hold it while a program steers.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

use singletrack_api::{Code, Refused};
use singletrack_control::Time;

/// The source of the set-points, shared by all connections.
#[derive(Clone, Debug, Default)]
pub(crate) struct SetpointSource(Arc<Mutex<Newest>>);

/// A connection, for as long as it exists.
pub(super) type Identity = Arc<()>;

/// The newest set-point that was accepted: when it was decided, and of which connection it is.
#[derive(Debug, Default)]
pub(super) struct Newest(Option<(Time, Weak<()>)>);

impl SetpointSource {
    pub(super) fn lock(&self) -> MutexGuard<'_, Newest> {
        // It is replaced as a whole.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Newest {
    /// Whether a set-point of `connection` may replace it at `now`.
    pub(super) fn admits(
        &self,
        connection: &Identity,
        now: Time,
        timeout: f64,
    ) -> Result<(), Refused> {
        let Self(Some((newest, source))) = self else {
            return Ok(());
        };
        let is_other = source
            .upgrade()
            .is_some_and(|source| !Arc::ptr_eq(&source, connection));
        if is_other && now.seconds_since(*newest) <= timeout {
            return Err(Refused::new(
                Code::OtherSource,
                format_args!(
                    "another connection gives the set-points: end that program, or wait until it \
                     has given none for {:.0} ms (reference.setpoint_timeout_ms)",
                    timeout * 1e3
                ),
            ));
        }
        Ok(())
    }

    /// Takes note of a set-point that was decided at `time`.
    pub(super) fn replace(&mut self, connection: &Identity, time: Time) {
        let Self(newest) = self;
        // The pilot refuses one that was decided before the newest.
        if newest.as_ref().is_none_or(|(newest, _)| *newest <= time) {
            *newest = Some((time, Arc::downgrade(connection)));
        }
    }
}
