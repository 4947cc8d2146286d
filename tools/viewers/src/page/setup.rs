//! What the page needs once: where the car may be, where it should be, how large it is, and what
//! the reasons mean.

use std::{
    path::Path,
    sync::Arc,
    time::{Duration, Instant},
};

use serde_json::{Value, json};
use singletrack_api::{ClientError, Code, Refused, Request};
use singletrack_core::{config::Config, top_view};
use tokio::{
    sync::{Notify, watch},
    task::spawn_blocking,
};

use crate::daemon::PATIENCE;

/// For this long an answer is given again.
const FRESH: Duration = Duration::from_secs(1);

/// The answer to `/setup.json`: made once for all that ask for it together.
#[derive(Debug, Default)]
pub(super) struct Setup {
    wanted: Notify,
    newest: watch::Sender<Option<(Instant, Answer)>>,
}

/// The answer, or why there is none.
type Answer = Result<Arc<str>, Arc<str>>;

impl Setup {
    /// An answer that is at most [`FRESH`] old.
    pub(super) async fn get(&self) -> Answer {
        let mut newest = self.newest.subscribe();
        loop {
            if let Some(answer) = fresh(newest.borrow_and_update().as_ref()) {
                return answer;
            }
            self.wanted.notify_one();
            if newest.changed().await.is_err() {
                return Err(Arc::from("the page ends"));
            }
        }
    }

    /// Asks the daemon at `socket`, one question at a time, for as long as it is polled.
    pub(super) async fn run(&self, socket: &Path) {
        loop {
            self.wanted.notified().await;
            if fresh(self.newest.borrow().as_ref()).is_some() {
                continue;
            }
            let socket = socket.to_owned();
            let asked = spawn_blocking(move || {
                let (number, config) = configuration(&socket)?;
                Ok::<_, ClientError>(top_view::setup(number, &config).to_string())
            })
            .await;
            let answer = match asked {
                Ok(Ok(setup)) => Ok(Arc::from(setup)),
                Ok(Err(error)) => Err(Arc::from(error.to_string())),
                Err(error) => Err(Arc::from(error.to_string())),
            };
            self.newest.send_replace(Some((Instant::now(), answer)));
        }
    }
}

fn fresh(newest: Option<&(Instant, Answer)>) -> Option<Answer> {
    let (made, answer) = newest?;
    (made.elapsed() < FRESH).then(|| answer.clone())
}

/// The configuration in force of the daemon at `socket`, and its number.
fn configuration(socket: &Path) -> Result<(u32, Config), ClientError> {
    let answer = singletrack_api::ask_within(&Request::Configuration {}, socket, PATIENCE)?;
    let (Some(number), Some(text)) = (answer.configuration, answer.toml) else {
        let why = "the daemon's configuration has no number or no text";
        return Err(Refused::new(Code::Other, why).into());
    };
    // It is in force: the daemon has judged it.
    let config = toml::from_str(&text).map_err(|error| {
        Refused::new(
            Code::Other,
            format_args!("can't read the daemon's configuration: {error}; is it the same version?"),
        )
    })?;
    Ok((number, config))
}

/// What the page needs of another car, whose daemon is at `socket`.
pub(super) fn car(socket: &Path) -> Result<Value, ClientError> {
    let (_, config) = configuration(socket)?;
    Ok(json!({
        "car": top_view::car(&config),
        "corners_m": config.fence.corners_m,
        "hold_ms": config.supervisor.hold_ms,
    }))
}
