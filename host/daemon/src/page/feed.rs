//! The newest state and status, for all viewers at once.

use std::{sync::Arc, time::Duration};

use tokio::{
    sync::{
        broadcast::{self, error::TryRecvError},
        watch,
    },
    time::{MissedTickBehavior, interval},
};

use crate::handle::DaemonHandle;

/// Interval of the states, and how many of them make one of the statuses.
const STATE_INTERVAL: Duration = Duration::from_millis(40);
const STATES_PER_STATUS: u32 = 25;

/// The newest events, ready to be sent. Empty before the first.
#[derive(Debug)]
pub(super) struct Feed {
    pub(super) states: watch::Sender<Arc<str>>,
    pub(super) statuses: watch::Sender<Arc<str>>,
}

impl Default for Feed {
    fn default() -> Self {
        Self {
            states: watch::Sender::new(Arc::from("")),
            statuses: watch::Sender::new(Arc::from("")),
        }
    }
}

impl Feed {
    /// Publishes for as long as the daemon lives. The state stream is read, and lines are made,
    /// only while there is a viewer.
    pub(super) async fn run(&self, daemon: &DaemonHandle) {
        let mut ticks = interval(STATE_INTERVAL);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut lines = None;
        let mut count = 0;
        loop {
            ticks.tick().await;
            if self.states.receiver_count() == 0 {
                lines = None;
                continue;
            }
            let lines = lines.get_or_insert_with(|| daemon.status.states.subscribe());
            if let Some(line) = newest(lines) {
                self.states.send_replace(event("state", line.trim_end()));
            }
            count = (count + 1) % STATES_PER_STATUS;
            if count == 0 {
                self.statuses.send_replace(status(daemon));
            }
        }
    }
}

/// The status of the control socket as an event.
pub(super) fn status(daemon: &DaemonHandle) -> Arc<str> {
    event(
        "status",
        &serde_json::to_string(&daemon.snapshot().status()).unwrap_or_default(),
    )
}

/// An event; the data must be one line.
fn event(name: &str, data: &str) -> Arc<str> {
    Arc::from(format!("event: {name}\ndata: {data}\n\n"))
}

/// The last of the lines that wait.
fn newest(lines: &mut broadcast::Receiver<Arc<str>>) -> Option<Arc<str>> {
    let mut last = None;
    loop {
        match lines.try_recv() {
            Ok(line) => last = Some(line),
            Err(TryRecvError::Lagged(_)) => {}
            Err(TryRecvError::Empty | TryRecvError::Closed) => return last,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_line_is_taken_and_the_others_are_skipped() {
        let sender = broadcast::Sender::new(2);
        let mut lines = sender.subscribe();
        assert_eq!(newest(&mut lines), None);
        for line in ["a", "b", "c"] {
            sender.send(Arc::from(line)).unwrap();
        }
        assert_eq!(newest(&mut lines).as_deref(), Some("c"));
        assert_eq!(newest(&mut lines), None);
        drop(sender);
        assert_eq!(newest(&mut lines), None);
        assert_eq!(&*event("state", "{}"), "event: state\ndata: {}\n\n");
    }
}
