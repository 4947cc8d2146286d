//! The front wheels by the steering that was sent: a dead time, then a lag of first order.

use heapless::Deque;
use libm::{exp, tan};

use crate::measurement::Time;

/// The commands kept: more than the largest lag of the filter at the shortest period.
const COMMANDS: usize = 128;

/// How the front wheels stand in the middle of a step, and how they turn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Wheels {
    /// Tangent of their angle.
    pub(super) tangent: f64,
    /// Its change, 1/s.
    pub(super) change: f64,
}

/// From when on the wheels go to an angle, and from where.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Command {
    from: Time,
    angle: f64,
    target: f64,
}

/// The steering that was sent.
#[derive(Clone, Debug)]
pub(super) struct Sent {
    dead_time: f64,
    lag: f64,
    commands: Deque<Command, COMMANDS>,
}

impl Sent {
    /// Straight wheels. Both times are in s.
    pub(super) const fn new(dead_time: f64, lag: f64) -> Self {
        Self {
            dead_time,
            lag,
            commands: Deque::new(),
        }
    }

    /// The steering angle `steering` (rad) is sent at `now`.
    pub(super) fn send(&mut self, now: Time, steering: f64) {
        let from = now.after(self.dead_time);
        let angle = match self.commands.back() {
            Some(last) if last.target == steering || last.from >= from => return,
            Some(last) => self.angle(last, from),
            None => steering,
        };
        if self.commands.is_full() {
            self.commands.pop_front();
        }
        // There is room.
        let _ = self.commands.push_back(Command {
            from,
            angle,
            target: steering,
        });
    }

    /// The angle of the wheels at a time, rad.
    pub(super) fn at(&self, time: Time) -> f64 {
        let command = self.commands.iter().rev().find(|it| it.from <= time);
        match (command, self.commands.front()) {
            (Some(command), _) => self.angle(command, time),
            (None, Some(first)) => first.angle,
            (None, None) => 0.0,
        }
    }

    fn angle(&self, command: &Command, time: Time) -> f64 {
        if self.lag <= 0.0 {
            return command.target;
        }
        let since = time.seconds_since(command.from);
        command.target + (command.angle - command.target) * exp(-since / self.lag)
    }

    /// The wheels from a time to another.
    pub(super) fn between(&self, from: Time, to: Time) -> Wheels {
        let [before, after] = [from, to].map(|time| tan(self.at(time)));
        let elapsed = to.seconds_since(from);
        Wheels {
            tangent: 0.5 * (before + after),
            change: if elapsed > 0.0 {
                (after - before) / elapsed
            } else {
                0.0
            },
        }
    }
}
