//! What can happen in a tick, and what happened, for people and for the campaign.

use core::fmt;

use singletrack_pilot::{Arming, PilotRequest};

/// What happens before a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// The operator asks for something.
    Request(PilotRequest),
    /// The operator takes the hand from the drive, or puts it back.
    Hand,
    /// The cameras lose the car, or find it.
    Cameras,
    /// The wire to the board breaks, or is mended.
    CutToBoard,
    /// The wire to the host breaks, or is mended.
    CutToHost,
    /// The plug is pulled and put back; what was under way is gone.
    HangUp,
    /// The board is reset.
    BoardRestart,
    /// The daemon is killed and started again.
    HostRestart,
    /// The operator gives the board the other of two configurations.
    Reconfigure,
}

/// What happens to the frames of a tick.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Passage {
    /// They arrive, after those that are late.
    #[default]
    Whole,
    /// They are lost.
    Lost,
    /// They wait for the next tick, with those that are late.
    Late,
    /// Each arrives, and once more in the next tick.
    Twice,
}

/// A tick, and what is not as usual in it; or calm for a time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// Nothing happens, for one tick.
    Calm,
    /// Nothing happens until something changes: a mode, a reason, the link, the car.
    Wait,
    /// Something happens.
    Event(Event),
    /// The frames to the board.
    ToBoard(Passage),
    /// The frames to the host.
    ToHost(Passage),
    /// The frames both ways.
    BothWays(Passage),
    /// The host misses the tick.
    HostLate,
}

/// A part of what can happen: any sequence of it is explored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Theme {
    /// Frames are lost, late and twice; either side restarts; a drive is begun and ended.
    Frames,
    /// Wires break and are mended, the plug is pulled, the cameras lose the car.
    Wires,
    /// An operator asks for anything.
    Operator,
    /// All of it.
    All,
}

impl Theme {
    /// All themes.
    pub const ALL: [Self; 4] = [Self::Frames, Self::Wires, Self::Operator, Self::All];

    /// Its word.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Frames => "frames",
            Self::Wires => "wires",
            Self::Operator => "operator",
            Self::All => "all",
        }
    }

    /// What can happen in a tick.
    pub fn actions(self) -> Vec<Action> {
        const DRIVE: &[Action] = &[
            Action::Calm,
            Action::Event(Event::Request(PilotRequest::Arm(Arming::Unattended))),
            Action::Event(Event::Request(PilotRequest::Disarm)),
            Action::Event(Event::Request(PilotRequest::EmergencyStop)),
            Action::Event(Event::BoardRestart),
            Action::Event(Event::HostRestart),
        ];
        const FRAMES: &[Action] = &[
            Action::ToBoard(Passage::Lost),
            Action::ToBoard(Passage::Late),
            Action::ToBoard(Passage::Twice),
            Action::ToHost(Passage::Lost),
            Action::ToHost(Passage::Late),
            Action::ToHost(Passage::Twice),
            Action::BothWays(Passage::Lost),
            Action::BothWays(Passage::Late),
            Action::HostLate,
        ];
        const WIRES: &[Action] = &[
            Action::Event(Event::Cameras),
            Action::Event(Event::CutToBoard),
            Action::Event(Event::CutToHost),
            Action::Event(Event::HangUp),
        ];
        const OPERATOR: &[Action] = &[
            Action::Event(Event::Request(PilotRequest::Arm(Arming::Held))),
            Action::Event(Event::Request(PilotRequest::Arm(Arming::Jog))),
            Action::Event(Event::Request(PilotRequest::Halt)),
            Action::Event(Event::Hand),
            Action::Event(Event::Reconfigure),
        ];
        match self {
            Self::Frames => [DRIVE, FRAMES].concat(),
            Self::Wires => [DRIVE, WIRES].concat(),
            Self::Operator => [DRIVE, OPERATOR].concat(),
            Self::All => [DRIVE, FRAMES, WIRES, OPERATOR].concat(),
        }
    }
}

impl Action {
    /// What happens to the frames to the board and to the host.
    pub(crate) const fn passages(self) -> [Passage; 2] {
        match self {
            Self::ToBoard(passage) => [passage, Passage::Whole],
            Self::ToHost(passage) => [Passage::Whole, passage],
            Self::BothWays(passage) => [passage; 2],
            _ => [Passage::Whole; 2],
        }
    }

    pub(crate) const fn host_is_late(self) -> bool {
        matches!(self, Self::HostLate)
    }
}

/// The actions from the start, each with the time at which it began, in ms.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Trace {
    pub(crate) actions: Vec<(u64, Action)>,
    pub(crate) end_ms: u64,
}

impl Trace {
    /// The actions, with their times in ms.
    pub fn actions(&self) -> &[(u64, Action)] {
        &self.actions
    }

    /// The schedule of the fault campaign that comes nearest, for `cargo faults --replay`: there a
    /// wire is cut both ways (of a board with its own supply), and nobody jogs.
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
