//! Requests to tune: checked against the configuration in force, and answered once the pilot has
//! the values.

use std::time::Duration;

use serde_json::json;
use singletrack_api::{Answer, Code, Refused};
use singletrack_pilot::{Tuned, Tuning};
use tokio::time::{Instant, sleep};

use super::progress::POLL;
use crate::{clock::monotonic_ns, handle::DaemonHandle, snapshot::tuning_of};

/// The longest wait for the tick that takes the values: much less than the time in which a client
/// must renew the drive that it holds.
const TIMEOUT: Duration = Duration::from_millis(200);

/// Tunes the pilot, and says what is in force then.
pub(super) async fn tune(tuning: Tuning, daemon: &DaemonHandle) -> Answer {
    match try_tune(tuning, daemon).await {
        Ok(tuned) => Answer {
            tuning: Some(tuning_of(&tuned)),
            ..Answer::done()
        },
        Err(Refused { code, text }) => Answer::failure(code, format!("can't tune: {text}")),
    }
}

async fn try_tune(tuning: Tuning, daemon: &DaemonHandle) -> Result<Tuned, Refused> {
    let before = daemon.snapshot().output().and_then(|output| output.tuned);
    let rule = daemon.reconfigurer.tuning_rule();
    rule.check(&tuning, before.as_ref())
        .map_err(|error| Refused::new(Code::OutOfRange, error))?;
    let asked_ns = monotonic_ns();
    daemon.tunings.send(tuning);
    let asked = Instant::now();
    while asked.elapsed() < TIMEOUT {
        sleep(POLL).await;
        // A tick that began before the request may not have seen it.
        let tick = daemon.snapshot().tick;
        if let Some(tick) = tick.filter(|tick| tick.start_ns > asked_ns) {
            let tuned = tick.output.tuned.filter(|tuned| tuned.has(&tuning));
            if let Some(tuned) = tuned {
                tracing::info!("tuned: {}", json!(tuning_of(&tuned)));
            }
            return tuned.ok_or_else(|| {
                Refused::new(
                    Code::Superseded,
                    "another client or another configuration has come meanwhile; ask again",
                )
            });
        }
    }
    Err(Refused::new(Code::Stalled, "the control thread is stalled"))
}
