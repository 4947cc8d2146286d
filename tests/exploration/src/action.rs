//! What can happen in a tick.

use singletrack_pilot::{Arming, PilotRequest};

use crate::line::Passage;

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
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Frames => "frames",
            Self::Wires => "wires",
            Self::Operator => "operator",
            Self::All => "all",
        }
    }

    /// What can happen in a tick.
    #[must_use]
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
