//! Requests to tune: checked against the configuration in force, and answered once the pilot has
//! the values.

use std::time::Duration;

use serde_json::json;
use singletrack_api::{Answer, Code, Refused};
use singletrack_pilot::{Tuned, Tuning};
use tokio::time::timeout;

use super::progress::next_tick;
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
    let latest = daemon.status.latest().tick.clone();
    let before = latest.and_then(|tick| tick.output.tuned);
    let rule = daemon.reconfigurer.tuning_rule();
    rule.check(&tuning, before.as_ref())
        .map_err(|error| Refused::new(Code::OutOfRange, error))?;
    let mut ticks = daemon.status.ticks.subscribe();
    let asked_ns = monotonic_ns();
    daemon.tunings.send(tuning);
    let taken = async {
        loop {
            let tick = next_tick(&mut ticks).await;
            // A tick that began before the request may not have seen it.
            if tick.start_ns > asked_ns {
                break tick.output.tuned;
            }
        }
    };
    let tuned = timeout(TIMEOUT, taken)
        .await
        .map_err(|_| Refused::new(Code::Stalled, "the control thread is stalled"))?
        .filter(|tuned| tuned.has(&tuning));
    let tuned = tuned.ok_or_else(|| {
        Refused::new(
            Code::Superseded,
            "another client or another configuration has come meanwhile; ask again",
        )
    })?;
    tracing::info!("tuned: {}", json!(tuning_of(&tuned)));
    Ok(tuned)
}
