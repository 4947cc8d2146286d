//! Publishes the counts of this program once a second, beside the daemon's diagnostics.

use std::{collections::BTreeMap, sync::Arc, thread, time::Duration};

use crate::{
    clocks::Now,
    message::{DiagnosticArray, DiagnosticStatus, Header, Time},
    node::{Node, prompt, start as start_thread},
    shared::{Counts, Shared},
};

const INTERVAL: Duration = Duration::from_secs(1);

/// Levels of `diagnostic_msgs/msg/DiagnosticStatus`.
const OK: u8 = 0;
const WARN: u8 = 1;

pub(crate) fn start(node: &mut Node, shared: &Arc<Shared>) -> Result<(), String> {
    let kind = ("diagnostic_msgs", "DiagnosticArray");
    let publisher = node.publisher("diagnostics", kind, prompt())?;
    let shared = Arc::clone(shared);
    start_thread("diagnostics", move || {
        let mut before = 0;
        loop {
            thread::sleep(INTERVAL);
            let counts = shared.state().counts.clone();
            let codes = counts.refused.values().chain(counts.rejected.values());
            let refused = codes.sum();
            let level = if refused > before { WARN } else { OK };
            before = refused;
            // A slow subscriber sees the next one.
            let _ = publisher.publish(report(&counts, level, Now::read()));
        }
    })
}

fn report(counts: &Counts, level: u8, now: Now) -> DiagnosticArray {
    let message = match level {
        OK => "set-points pass",
        _ => "set-points are refused",
    };
    DiagnosticArray {
        header: Header {
            stamp: Time::from_ns(now.wall),
            frame_id: String::new(),
        },
        status: vec![DiagnosticStatus {
            level,
            name: "singletrack-ros",
            message: message.to_owned(),
            hardware_id: "",
            values: vec![
                ("set-points passed on", counts.passed.to_string()),
                ("set-points refused", by_code(&counts.refused)),
                (
                    "set-points rejected by the daemon",
                    by_code(&counts.rejected),
                ),
                ("set-points lost", counts.lost.to_string()),
                ("entries missed", counts.missed.to_string()),
                ("messages held up", counts.held_up.to_string()),
            ],
        }],
    }
}

/// Codes with how often each came.
fn by_code(counts: &BTreeMap<&str, u64>) -> String {
    let codes = counts.iter().map(|(code, count)| format!("{code} {count}"));
    codes.collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
#[allow(clippy::indexing_slicing, reason = "a test may fail")]
mod tests {
    use super::*;

    #[test]
    fn every_reason_is_reported_with_its_count() {
        let mut counts = Counts::default();
        counts.refused.insert("old", 3);
        counts.refused.insert("invalid", 1);
        let now = Now {
            monotonic: 0,
            wall: 1_500_000_000,
        };
        let report = report(&counts, WARN, now);
        assert_eq!(
            report.header.stamp,
            Time {
                sec: 1,
                nanosec: 500_000_000
            }
        );
        assert_eq!(report.status[0].values[1].1, "invalid 1, old 3");
    }
}
