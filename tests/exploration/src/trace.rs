//! What happened, for people and for the campaign.

use core::fmt;

use singletrack_pilot::{Arming, PilotRequest};

use crate::{
    action::{Action, Event},
    line::Passage,
};

/// The actions from the start, each with the time at which it began, in ms.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Trace {
    pub(crate) actions: Vec<(u64, Action)>,
    pub(crate) end_ms: u64,
}

impl Trace {
    /// The actions, with their times in ms.
    #[must_use]
    pub fn actions(&self) -> &[(u64, Action)] {
        &self.actions
    }

    /// The schedule of the fault campaign that comes nearest, for `cargo faults --replay`: there a
    /// wire is cut both ways (of a board with its own supply), and nobody jogs.
    #[must_use]
    pub fn schedule(&self) -> String {
        let entries = ["seed 1", "proved true", "own_supply true"];
        let mut entries: Vec<_> = entries.into_iter().map(str::to_owned).collect();
        let fault = |kind: &str, at_ms: u64, for_ms: u64| {
            format!("fault {kind} at {at_ms} for {for_ms} severity 1000")
        };
        let mut began = Vec::new();
        for &(at_ms, action) in &self.actions {
            let entry = match action {
                Action::Event(Event::Request(request)) => match request {
                    PilotRequest::Arm(Arming::Unattended | Arming::Held) => {
                        format!("ask arm at {at_ms}")
                    }
                    PilotRequest::EmergencyStop => format!("ask stop at {at_ms}"),
                    PilotRequest::Disarm | PilotRequest::Halt => format!("ask disarm at {at_ms}"),
                    _ => continue,
                },
                Action::Event(Event::Reconfigure) => format!("ask reload at {at_ms}"),
                Action::Event(Event::BoardRestart) => fault("board-reset", at_ms, 1),
                Action::Event(Event::HostRestart) => fault("daemon-killed", at_ms, 10),
                Action::Event(Event::HangUp) => fault("line-unplugged", at_ms, 10),
                Action::Event(event @ (Event::Cameras | Event::CutToBoard | Event::CutToHost)) => {
                    let lasts = began.iter().position(|&(_, other)| other == event);
                    let Some(index) = lasts else {
                        began.push((at_ms, event));
                        continue;
                    };
                    let (from_ms, event) = began.remove(index);
                    fault(lasting(event), from_ms, at_ms - from_ms)
                }
                Action::ToBoard(passage) | Action::ToHost(passage) | Action::BothWays(passage) => {
                    match passage {
                        Passage::Lost => fault("line-drop", at_ms, 10),
                        Passage::Late => fault("line-stuck", at_ms, 10),
                        Passage::Whole | Passage::Twice => continue,
                    }
                }
                Action::HostLate => fault("daemon-paused", at_ms, 10),
                Action::Calm | Action::Wait | Action::Event(Event::Hand) => continue,
            };
            entries.push(entry);
        }
        for (from_ms, event) in began {
            entries.push(fault(lasting(event), from_ms, self.end_ms - from_ms));
        }
        entries.push(format!("end_ms {}", self.end_ms));
        entries.join("; ")
    }
}

const fn lasting(event: Event) -> &'static str {
    match event {
        Event::Cameras => "camera-absent",
        _ => "line-unplugged",
    }
}

impl fmt::Display for Trace {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (at_ms, action) in &self.actions {
            writeln!(out, "{at_ms:>8} ms  {action:?}")?;
        }
        Ok(())
    }
}
