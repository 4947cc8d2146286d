//! Breadth first, over all that can happen.

use std::{
    collections::{HashMap, HashSet, VecDeque},
    fmt,
    hash::{DefaultHasher, Hasher as _},
};

use singletrack_pilot::{Arming, Mode, PilotRequest, Reason};
use singletrack_protocol::BoardMode;

use crate::{
    action::{Action, Event, Theme, Trace},
    canonical::{Canonical, Key},
    claim::Violation,
    world::{Setting, World},
};

/// The period of the board's slowest message, in ticks: at rest, all is as it was before it.
const STATUS_TICKS: u32 = 20;

/// The longest calm, in ticks: ten seconds of jogging, and what follows.
const LONGEST_CALM: u32 = 1_500;

/// The most waits until a car that is mended can be armed, or drives.
const WAITS: usize = 12;

/// Every 256th of the states that are reached again is compared with the one found before...
const COMPARED: u64 = 256;

/// ...for this number of ticks.
const COMPARED_TICKS: usize = 100;

/// How far to explore.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// What can happen.
    pub theme: Theme,
    /// Ticks in which something happens between two times of calm.
    pub burst: u8,
    /// States, unless all are found before.
    pub states: usize,
}

/// What was explored.
#[derive(Clone, Debug, Default)]
pub struct Explored {
    /// Different states.
    pub states: usize,
    /// Actions tried.
    pub actions: u64,
    /// Ticks simulated.
    pub ticks: u64,
    /// States in which nothing changes any more by itself.
    pub rests: usize,
    /// The longest shortest way to a state, in actions.
    pub depth: u32,
    /// The depth up to which every way was taken; as `depth` if all states were found.
    pub complete_depth: u32,
    /// Whether every action was tried in every state.
    pub is_closed: bool,
    /// Modes of host and board that were seen together.
    pub modes: Vec<(Mode, BoardMode)>,
    /// Reasons that were seen.
    pub reasons: Vec<Reason>,
    /// How often a state was reached again, on another way.
    pub merges: u64,
    /// Merges whose two states were driven on.
    pub compared: u64,
}

impl fmt::Display for Explored {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            out,
            "{} states, {} actions tried, {} ticks; ",
            self.states, self.actions, self.ticks
        )?;
        if self.is_closed {
            write!(out, "every sequence, of any length")?;
        } else {
            write!(out, "every sequence of {} actions", self.complete_depth)?;
        }
        write!(
            out,
            ": no claim is violated\n    {} pairs of modes of host and board, {} reasons; {} states at rest, from \
             each a mended car drives again\n    {} times a state was reached again; {} of them went on for {} ticks as \
             before",
            self.modes.len(),
            self.reasons.len(),
            self.rests,
            self.merges,
            self.compared,
            COMPARED_TICKS
        )
    }
}

/// A claim that does not hold, and how to come there.
#[derive(Clone, Debug)]
pub struct Counterexample {
    /// What does not hold.
    pub violation: Violation,
    /// What happened.
    pub trace: Trace,
}

impl fmt::Display for Counterexample {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Violation { claim, found } = &self.violation;
        writeln!(out, "{claim} is violated: {found}\n\n{}", self.trace)?;
        write!(
            out,
            "in the campaign, as near as it comes:\n\n    cargo faults --replay '{}'",
            self.trace.schedule()
        )
    }
}

/// Why an exploration ended early.
#[derive(Clone, Debug)]
pub enum Stopped {
    /// A claim does not hold.
    Violated(Box<Counterexample>),
    /// The configuration is not valid.
    Setting(String),
}

impl From<String> for Stopped {
    fn from(text: String) -> Self {
        Self::Setting(text)
    }
}

/// A state that was found: where from, and how.
#[derive(Clone, Copy, Debug)]
struct Node {
    parent: u32,
    action: Action,
    depth: u32,
}

struct Open {
    world: World,
    node: u32,
    /// Ticks of the burst that are left.
    left: u8,
}

/// Explores.
#[derive(Debug)]
pub struct Explorer<'a> {
    setting: &'a Setting,
    limits: Limits,
    canonical: Canonical,
    nodes: Vec<Node>,
    /// The ticks that were left when a state was found, and its node.
    found: HashMap<Key, (u8, u32)>,
    recovered: HashSet<Key>,
    explored: Explored,
}

impl<'a> Explorer<'a> {
    /// An exploration from a board and a host that have just started.
    pub fn new(setting: &'a Setting, limits: Limits) -> Self {
        Self {
            setting,
            limits,
            canonical: Canonical::default(),
            nodes: Vec::new(),
            found: HashMap::new(),
            recovered: HashSet::new(),
            explored: Explored::default(),
        }
    }

    /// Explores all states, or as many as the limits say. `progress` is told of every thousandth.
    ///
    /// # Errors
    ///
    /// A claim does not hold, or the configuration is not valid.
    pub fn run(mut self, mut progress: impl FnMut(&Explored, usize)) -> Result<Explored, Stopped> {
        let actions = self.limits.theme.actions();
        let mut queue = VecDeque::new();
        let world = World::new(self.setting)?;
        let key = self.canonical.key(&world);
        self.nodes.push(Node {
            parent: 0,
            action: Action::Calm,
            depth: 0,
        });
        self.found.insert(key, (self.limits.burst, 0));
        queue.push_back(Open {
            world,
            node: 0,
            left: self.limits.burst,
        });
        while let Some(open) = queue.pop_front() {
            let depth = self.nodes[open.node as usize].depth;
            if self.found.len() >= self.limits.states {
                self.explored.complete_depth = depth;
                break;
            }
            self.explored.depth = depth;
            let of_a_tick = if open.left > 0 { &actions[..] } else { &[] };
            for &action in of_a_tick.iter().chain(&[Action::Wait]) {
                self.explored.actions += 1;
                let mut world = open.world.clone();
                let taken = self.take(&mut world, action);
                let node = self.nodes.len() as u32;
                let reached = taken.map_err(|stopped| match stopped {
                    Taken::Violated(violation) => self.counterexample(open.node, action, violation),
                    Taken::Setting(text) => Stopped::Setting(text),
                })?;
                let left = match action {
                    Action::Wait => self.limits.burst,
                    _ => open.left - 1,
                };
                if let Some(&(known, node)) = self.found.get(&reached)
                    && known >= left
                {
                    self.explored.merges += 1;
                    if self.explored.merges.is_multiple_of(COMPARED) {
                        self.compare(&world, node).map_err(|taken| match taken {
                            Taken::Violated(violation) => {
                                self.counterexample(open.node, action, violation)
                            }
                            Taken::Setting(text) => Stopped::Setting(text),
                        })?;
                    }
                    continue;
                }
                self.nodes.push(Node {
                    parent: open.node,
                    action,
                    depth: depth + 1,
                });
                self.found.insert(reached, (left, node));
                queue.push_back(Open { world, node, left });
                self.explored.states = self.found.len();
                if self.nodes.len().is_multiple_of(1_000) {
                    progress(&self.explored, queue.len());
                }
            }
        }
        self.explored.is_closed = queue.is_empty() && self.found.len() < self.limits.states;
        if self.explored.is_closed {
            self.explored.complete_depth = self.explored.depth;
        }
        self.explored.rests = self.recovered.len();
        Ok(self.explored)
    }

    /// The actions that lead to a node.
    fn way(&self, node: u32) -> Vec<Action> {
        let mut actions = Vec::new();
        let mut at = node;
        while at != 0 {
            let node = self.nodes[at as usize];
            actions.push(node.action);
            at = node.parent;
        }
        actions.reverse();
        actions
    }

    /// The state that actions lead to, and when each began.
    fn follow(&mut self, actions: &[Action]) -> Result<(World, Trace), String> {
        let mut world = World::new(self.setting)?;
        let start = world.now.0;
        let mut timed = Vec::new();
        for &action in actions {
            timed.push(((world.now.0 - start) / 1_000_000, action));
            match self.step(&mut world, action) {
                Ok(_) | Err(Taken::Violated(_)) => {}
                Err(Taken::Setting(text)) => return Err(text),
            }
        }
        let trace = Trace {
            actions: timed,
            end_ms: (world.now.0 - start) / 1_000_000,
        };
        Ok((world, trace))
    }

    fn counterexample(&mut self, node: u32, action: Action, violation: Violation) -> Stopped {
        let mut actions = self.way(node);
        actions.push(action);
        match self.follow(&actions) {
            Ok((_, trace)) => Stopped::Violated(Box::new(Counterexample { violation, trace })),
            Err(text) => Stopped::Setting(text),
        }
    }

    /// A state that was found before, on another way: whatever happens next must do the same to
    /// both.
    fn compare(&mut self, world: &World, known: u32) -> Result<(), Taken> {
        let way = self.way(known);
        let (mut other, trace) = self.follow(&way)?;
        let mut world = world.clone();
        self.explored.compared += 1;
        let actions = self.limits.theme.actions();
        let mut hasher = DefaultHasher::new();
        for tick in 0..COMPARED_TICKS {
            hasher.write_u64(self.explored.compared);
            let draw = hasher.finish() as usize;
            // Mostly calm: what happened must have time to take effect.
            let action = match draw % 8 {
                0 => actions[draw / 8 % actions.len()],
                _ => Action::Calm,
            };
            self.step(&mut world, action)?;
            self.step(&mut other, action)?;
            if world.outline() != other.outline() {
                return Err(Taken::Violated(Violation {
                    claim: "same-state-same-future",
                    found: format!(
                        "{tick} ticks later {:?}, and {:?} after\n{trace}",
                        world.outline(),
                        other.outline()
                    ),
                }));
            }
        }
        Ok(())
    }

    /// Takes an action; the key of the state that it leads to.
    fn take(&mut self, world: &mut World, action: Action) -> Result<Key, Taken> {
        if self.step(world, action)? {
            self.recover(world)?;
        }
        Ok(self.canonical.key(world))
    }

    /// Takes an action; true if nothing changes any more after it.
    fn step(&mut self, world: &mut World, action: Action) -> Result<bool, Taken> {
        match action {
            Action::Wait => return self.wait(world),
            Action::Event(event) => world.apply(event, self.setting)?,
            _ => {}
        }
        self.tick(world, action)?;
        Ok(false)
    }

    fn tick(&mut self, world: &mut World, action: Action) -> Result<(), Taken> {
        self.explored.ticks += 1;
        world.tick(action)?;
        let outline = world.outline();
        note(&mut self.explored.modes, (outline.mode, outline.board));
        if let Some(reason) = world.host.reason() {
            note(&mut self.explored.reasons, reason);
        }
        Ok(())
    }

    /// Calm until something changes; true if nothing does any more.
    fn wait(&mut self, world: &mut World) -> Result<bool, Taken> {
        let outline = world.outline();
        // Requests are repeated at intervals of their own: a cycle is rest too.
        let mut before = Vec::new();
        for tick in 0..LONGEST_CALM {
            if tick % STATUS_TICKS == 0 {
                let key = self.canonical.key(world);
                if before.contains(&key) {
                    return Ok(true);
                }
                before.push(key);
            }
            self.tick(world, Action::Calm)?;
            if world.outline() != outline {
                return Ok(false);
            }
        }
        Err(Taken::Violated(Violation {
            claim: "comes-to-rest",
            found: format!("after {LONGEST_CALM} ticks of calm the state still changes: {world:?}"),
        }))
    }

    /// Waits until nothing changes any more.
    fn rest(&mut self, world: &mut World) -> Result<(), Taken> {
        for _ in 0..WAITS {
            if self.wait(world)? {
                break;
            }
        }
        Ok(())
    }

    /// From a state at rest, a person can always come to a drive: what is cut is mended, a board
    /// that has latched a stop is reset, then disarm, and arm.
    fn recover(&mut self, world: &World) -> Result<(), Taken> {
        let key = self.canonical.key(world);
        if !self.recovered.insert(key) {
            return Ok(());
        }
        let mut world = world.clone();
        world.mend();
        self.rest(&mut world)?;
        if world.board.mode() == BoardMode::EmergencyStopped {
            world.apply(Event::BoardRestart, self.setting)?;
            self.rest(&mut world)?;
        }
        world.apply(Event::Request(PilotRequest::Disarm), self.setting)?;
        self.rest(&mut world)?;
        world.apply(
            Event::Request(PilotRequest::Arm(Arming::Unattended)),
            self.setting,
        )?;
        for _ in 0..WAITS {
            if world.board.mode() == BoardMode::Driving {
                return Ok(());
            }
            self.wait(&mut world)?;
        }
        Err(Taken::Violated(Violation {
            claim: "drives-again",
            found: format!("{:?}", world.outline()),
        }))
    }
}

fn note<T: PartialEq>(seen: &mut Vec<T>, value: T) {
    if !seen.contains(&value) {
        seen.push(value);
    }
}

/// Why an action was not taken to its end.
enum Taken {
    Violated(Violation),
    Setting(String),
}

impl From<Violation> for Taken {
    fn from(violation: Violation) -> Self {
        Self::Violated(violation)
    }
}

impl From<String> for Taken {
    fn from(text: String) -> Self {
        Self::Setting(text)
    }
}
