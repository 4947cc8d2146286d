//! Changes of the configuration's file, and of what is in force.

use std::{thread, time::Instant};

use jiff::Timestamp;
use serde_json::json;
use singletrack_api::{ClientError, Code, Request, ask};
use singletrack_commissioning::{
    Answer, Question, Refused,
    edit::{Edit, EditError},
};

use super::{ANSWER, LiveBench, TOPICS, WAIT};
use crate::operator::entries::Entries;

impl LiveBench {
    /// What has changed in the configuration's file since the start, as a unified diff.
    pub(super) fn diff(&self) -> Result<String, EditError> {
        let now = Edit::read(&self.path)?;
        Ok(self
            .before
            .until(&now)
            .diff(&self.path.display().to_string()))
    }

    /// Reports to the daemon what becomes of a procedure that `arm` requires.
    pub(super) fn report(&self, result: &str) -> Result<(), ClientError> {
        let Some(procedure) = self.reported else {
            return Ok(());
        };
        let request = Request::Commissioned {
            procedure: procedure.to_owned(),
            result: result.to_owned(),
            uncalibrated: self.uncalibrated,
        };
        ask(&request, &self.socket).map(drop)
    }

    /// Writes new values to the file and prints what changes. Gives the change for taking it
    /// back, or none if there is none.
    pub(super) fn write(
        &mut self,
        values: &[(&str, toml_edit::Value)],
    ) -> Result<Option<Edit>, EditError> {
        let mut edit = Edit::read(&self.path)?;
        if edit.text() != self.known.text() {
            // What was measured may not hold with what somebody else has changed.
            let why = "it was changed by somebody else meanwhile";
            return Err(EditError::of(&self.path)(why));
        }
        for (key, value) in values {
            edit.set(key, value)?;
        }
        let date = Timestamp::now().strftime("%Y-%m-%dT%H%M%SZ").to_string();
        let Some(kept) = edit.write(&self.path, &date)? else {
            return Ok(None);
        };
        let diff = edit.diff(&self.path.display().to_string());
        self.terminal
            .say(&format!("{diff}The old file is {}.", kept.display()));
        let _ = self
            .terminal
            .tell(&json!({ "changed": diff, "kept": kept }));
        Ok(Some(edit))
    }

    /// Has the daemon read its file again. What takes a restart is done by the operator.
    pub(super) fn reload(&mut self) -> Result<(), Refused> {
        match ask(&Request::Reload {}, &self.socket) {
            Ok(_) => Ok(()),
            Err(ClientError::Refused(refused)) if refused.code == Code::NeedsRestart => {
                self.restart()
            }
            Err(error) => Err(Refused::because(error)),
        }
    }

    /// Asks the operator to restart the daemon, until it is there again.
    fn restart(&mut self) -> Result<(), Refused> {
        let question = Question::begin(
            "restart-daemon",
            "These values take a restart of the daemon: sudo systemctl restart \
                   singletrackd. Press Enter when that is done.",
        );
        match self.ask_of(&question, false).map_err(Refused::because)? {
            Answer::Skip => return Err(Refused("the daemon was not restarted".to_owned())),
            _ => self.terminal.say("Waiting for the daemon..."),
        }
        let asked = Instant::now();
        loop {
            match Entries::watch(&self.socket, TOPICS.to_vec()) {
                Ok(entries) => {
                    self.entries = entries;
                    self.heard = Instant::now();
                    self.is_linked = None;
                    return Ok(());
                }
                Err(_) if asked.elapsed() < ANSWER => thread::sleep(WAIT),
                Err(error) => return Err(Refused::because(error)),
            }
        }
    }
}
