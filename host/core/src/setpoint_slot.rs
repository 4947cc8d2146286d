//! A slot with the newest set-point for the control thread.
//!
//! It is not a queue: a newer set-point replaces one that was not taken, of whatever kind both
//! are. Sender and receiver never wait for each other.

use core::sync::atomic::{AtomicU64, Ordering, fence};
use std::{
    fmt,
    sync::{Arc, Mutex, PoisonError},
};

use singletrack_control::{
    Demand, MAX_TRAJECTORY_POINTS, Position, ReferencePoint, Setpoint, SetpointStamp, SpeedDemand,
    SteeringDemand, Time, Trajectory, TrajectoryPiece, TrajectoryPoint, Velocity,
};

/// The words before the values: the kind, the number if there is one, the time.
const HEAD: usize = 3;

/// The words of the values of a set-point.
const DEMAND: usize = 4;

/// The words of a point of a trajectory: its time, position and velocity.
const POINT: usize = 5;

/// The words of the longest trajectory.
const WORDS: usize = HEAD + POINT * MAX_TRAJECTORY_POINTS;

/// Attempts of the reader to copy a set-point that is not being overwritten.
const ATTEMPTS: usize = 3;

/// Two copies, and the number of set-points so far. Its lowest bit selects the complete
/// copy; the next set-point is written to the other one.
struct Shared {
    written: AtomicU64,
    copies: [[AtomicU64; WORDS]; 2],
}

/// The sending end, for every thread but the control thread.
#[derive(Clone, Debug)]
pub struct SetpointSender(Arc<Mutex<Arc<Shared>>>);

/// The receiving end, for the control thread.
#[derive(Debug)]
pub struct SetpointReceiver {
    shared: Arc<Shared>,
    taken: u64,
    /// The words of the set-point that was taken last.
    values: [u64; WORDS],
    /// The next point of that trajectory to pass on, and their number; equal if there is none.
    next: usize,
    count: usize,
}

/// What the control thread takes from the slot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Taken {
    /// The newest set-point.
    Setpoint(Setpoint),
    /// The next point of the newest trajectory.
    Piece(TrajectoryPiece),
}

/// Makes an empty slot.
#[must_use]
pub fn setpoint_slot() -> (SetpointSender, SetpointReceiver) {
    let words = || [const { AtomicU64::new(0) }; WORDS];
    let shared = Arc::new(Shared {
        written: AtomicU64::new(0),
        copies: [words(), words()],
    });
    let sender = SetpointSender(Arc::new(Mutex::new(Arc::clone(&shared))));
    let receiver = SetpointReceiver {
        shared,
        taken: 0,
        values: [0; WORDS],
        next: 0,
        count: 0,
    };
    (sender, receiver)
}

impl fmt::Debug for Shared {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter
            .debug_struct("Shared")
            .field("written", &self.written)
            .finish_non_exhaustive()
    }
}

impl Shared {
    const fn copy(&self, number: u64) -> &[AtomicU64; WORDS] {
        let [even, odd] = &self.copies;
        if number.is_multiple_of(2) { even } else { odd }
    }
}

impl SetpointSender {
    /// Replaces the set-point in the slot. Senders may wait for each other.
    pub fn send(&self, setpoint: &Setpoint) {
        let (kind, values) = demand_words(&setpoint.demand);
        self.write(head(kind, 0, &setpoint.stamp).into_iter().chain(values));
    }

    /// Replaces the set-point in the slot by a trajectory.
    pub fn send_trajectory(&self, trajectory: &Trajectory) {
        let points = trajectory.points.iter().flat_map(|point| {
            [
                point.time.0,
                point.position.x.to_bits(),
                point.position.y.to_bits(),
                point.velocity.x.to_bits(),
                point.velocity.y.to_bits(),
            ]
        });
        let head = head(Kind::Trajectory, trajectory.points.len(), &trajectory.stamp);
        self.write(head.into_iter().chain(points));
    }

    fn write(&self, values: impl Iterator<Item = u64>) {
        // The slot is consistent: a sender that panicked while writing left the copy that
        // is read unchanged.
        let shared = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let number = shared.written.load(Ordering::Relaxed).wrapping_add(1);
        // A reader that sees any of the following stores also sees the number read above,
        // and so that its copy is being replaced.
        fence(Ordering::Release);
        for (word, value) in shared.copy(number).iter().zip(values) {
            word.store(value, Ordering::Relaxed);
        }
        shared.written.store(number, Ordering::Release);
    }
}

impl SetpointReceiver {
    /// The next point of the trajectory that was begun, else the newest set-point or the first
    /// point of a new trajectory; `None` if it was taken before.
    ///
    /// A trajectory that was begun is passed on to its end: a sender that replaces it before
    /// would keep every one from coming into force.
    pub fn take(&mut self) -> Option<Taken> {
        if self.next == self.count {
            self.read()?;
            let [kind, ..] = self.values;
            let stamp = self.stamp();
            match Kind::of(kind) {
                Kind::Trajectory => {
                    self.next = 0;
                    // The bound is for what the compiler cannot know.
                    self.count = ((kind >> 8) as usize).min(MAX_TRAJECTORY_POINTS);
                    if self.count == 0 {
                        return None;
                    }
                }
                kind => {
                    let demand = demand(kind, self.array(HEAD));
                    return Some(Taken::Setpoint(Setpoint { stamp, demand }));
                }
            }
        }
        let [time, x, y, v_x, v_y] = self.array(HEAD + POINT * self.next);
        let piece = TrajectoryPiece {
            stamp: self.stamp(),
            index: self.next as u8,
            count: self.count as u8,
            point: TrajectoryPoint {
                time: Time(time),
                position: Position::new(f64::from_bits(x), f64::from_bits(y)),
                velocity: Velocity::new(f64::from_bits(v_x), f64::from_bits(v_y)),
            },
        };
        self.next += 1;
        Some(Taken::Piece(piece))
    }

    /// Copies a set-point that was not copied before.
    fn read(&mut self) -> Option<()> {
        for _ in 0..ATTEMPTS {
            let number = self.shared.written.load(Ordering::Acquire);
            if number == self.taken {
                return None;
            }
            let words = self.shared.copy(number);
            let [kind, ..] = words;
            let kind = kind.load(Ordering::Relaxed);
            let length = match Kind::of(kind) {
                Kind::Trajectory => HEAD + POINT * (kind >> 8) as usize,
                _ => HEAD + DEMAND,
            };
            for (value, word) in self.values.iter_mut().zip(words).take(length) {
                *value = word.load(Ordering::Relaxed);
            }
            // If any of these words is of a newer set-point, the number is newer too.
            fence(Ordering::Acquire);
            if self.shared.written.load(Ordering::Relaxed) == number {
                self.taken = number;
                return Some(());
            }
        }
        // Senders write without a pause. The next tick tries again.
        None
    }

    const fn stamp(&self) -> SetpointStamp {
        let [_, sequence, time, ..] = self.values;
        SetpointStamp {
            time: Time(time),
            sequence: if sequence > u32::MAX as u64 {
                None
            } else {
                Some(sequence as u32)
            },
        }
    }

    /// The `LENGTH` words from `place` on.
    fn array<const LENGTH: usize>(&self, place: usize) -> [u64; LENGTH] {
        let words = self.values.get(place..).and_then(<[u64]>::first_chunk);
        words.copied().unwrap_or([0; LENGTH])
    }
}

/// What the values of a set-point are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Velocity = 0,
    Position = 1,
    AngleAndSpeed = 2,
    AngleAndAcceleration = 3,
    RateAndSpeed = 4,
    RateAndAcceleration = 5,
    Trajectory = 6,
}

impl Kind {
    const fn of(word: u64) -> Self {
        match word as u8 {
            0 => Self::Velocity,
            1 => Self::Position,
            2 => Self::AngleAndSpeed,
            3 => Self::AngleAndAcceleration,
            4 => Self::RateAndSpeed,
            5 => Self::RateAndAcceleration,
            _ => Self::Trajectory,
        }
    }
}

/// The words before the values; `count` is the number of points of a trajectory.
fn head(kind: Kind, count: usize, stamp: &SetpointStamp) -> [u64; HEAD] {
    let sequence = stamp.sequence.map_or(u64::MAX, u64::from);
    [kind as u64 | ((count as u64) << 8), sequence, stamp.time.0]
}

fn demand_words(demand: &Demand) -> (Kind, [u64; DEMAND]) {
    match *demand {
        Demand::Point(ReferencePoint { position, velocity }) => {
            let kind = position.map_or(Kind::Velocity, |_| Kind::Position);
            let position = position.unwrap_or_default();
            let values = [velocity.x, velocity.y, position.x, position.y];
            (kind, values.map(f64::to_bits))
        }
        Demand::Actuation { steering, speed } => {
            let (kind, steers, drives) = match (steering, speed) {
                (SteeringDemand::Angle(angle), SpeedDemand::Speed(speed)) => {
                    (Kind::AngleAndSpeed, angle, speed)
                }
                (SteeringDemand::Angle(angle), SpeedDemand::Acceleration(acceleration)) => {
                    (Kind::AngleAndAcceleration, angle, acceleration)
                }
                (SteeringDemand::Rate(rate), SpeedDemand::Speed(speed)) => {
                    (Kind::RateAndSpeed, rate, speed)
                }
                (SteeringDemand::Rate(rate), SpeedDemand::Acceleration(acceleration)) => {
                    (Kind::RateAndAcceleration, rate, acceleration)
                }
            };
            (kind, [steers.to_bits(), drives.to_bits(), 0, 0])
        }
    }
}

const fn demand(kind: Kind, [a, b, x, y]: [u64; DEMAND]) -> Demand {
    let (a, b) = (f64::from_bits(a), f64::from_bits(b));
    let (steering, speed) = match kind {
        Kind::Velocity | Kind::Position | Kind::Trajectory => {
            return Demand::Point(ReferencePoint {
                position: match kind {
                    Kind::Position => Some(Position::new(f64::from_bits(x), f64::from_bits(y))),
                    _ => None,
                },
                velocity: Velocity::new(a, b),
            });
        }
        Kind::AngleAndSpeed => (SteeringDemand::Angle(a), SpeedDemand::Speed(b)),
        Kind::AngleAndAcceleration => (SteeringDemand::Angle(a), SpeedDemand::Acceleration(b)),
        Kind::RateAndSpeed => (SteeringDemand::Rate(a), SpeedDemand::Speed(b)),
        Kind::RateAndAcceleration => (SteeringDemand::Rate(a), SpeedDemand::Acceleration(b)),
    };
    Demand::Actuation { steering, speed }
}

#[cfg(test)]
mod tests {
    use std::thread;

    use super::*;

    /// Every kind in turn.
    fn numbered(number: u64) -> Setpoint {
        let value = number as f64;
        let steering = match number % 4 {
            0 | 1 => SteeringDemand::Angle(value),
            _ => SteeringDemand::Rate(-value),
        };
        let speed = match number % 8 {
            0..4 => SpeedDemand::Speed(2.0 * value),
            _ => SpeedDemand::Acceleration(3.0 * value),
        };
        let position = Some(Position::new(value, -value));
        let demand = match number % 3 {
            0 => Demand::Actuation { steering, speed },
            rest => Demand::Point(ReferencePoint {
                position: position.filter(|_| rest == 1),
                velocity: Velocity::new(2.0 * value, 3.0 * value),
            }),
        };
        Setpoint {
            stamp: stamp(number),
            demand,
        }
    }

    fn stamp(number: u64) -> SetpointStamp {
        SetpointStamp {
            time: Time(number),
            sequence: (!number.is_multiple_of(5)).then_some(number as u32),
        }
    }

    fn trajectory(number: u64) -> Trajectory {
        let count = 2 + number % 99;
        Trajectory {
            stamp: stamp(number),
            points: (0..count)
                .map(|index| {
                    let value = (1_000 * number + index) as f64;
                    TrajectoryPoint {
                        time: Time(number + index),
                        position: Position::new(value, -value),
                        velocity: Velocity::new(2.0 * value, -2.0 * value),
                    }
                })
                .collect(),
        }
    }

    fn assert_pieces(receiver: &mut SetpointReceiver, trajectory: &Trajectory) {
        for piece in trajectory.pieces() {
            assert_eq!(receiver.take(), Some(Taken::Piece(piece)));
        }
    }

    #[test]
    fn only_the_newest_is_taken_and_only_once() {
        let (sender, mut receiver) = setpoint_slot();
        assert_eq!(receiver.take(), None);
        for number in 1..=1_000 {
            sender.send(&numbered(number));
            if number > 950 {
                assert_eq!(receiver.take(), Some(Taken::Setpoint(numbered(number))));
            }
        }
        assert_eq!(receiver.take(), None);
        sender.send_trajectory(&trajectory(5));
        sender.clone().send(&numbered(3));
        assert_eq!(receiver.take(), Some(Taken::Setpoint(numbered(3))));
    }

    #[test]
    fn a_trajectory_that_was_begun_is_passed_on_to_its_end() {
        let (sender, mut receiver) = setpoint_slot();
        for number in [98, 0, 17] {
            sender.send_trajectory(&trajectory(number));
            let first = trajectory(number).pieces().next().map(Taken::Piece);
            assert_eq!(receiver.take(), first);
            sender.send_trajectory(&trajectory(number + 1));
            sender.send(&numbered(number));
            for piece in trajectory(number).pieces().skip(1) {
                assert_eq!(receiver.take(), Some(Taken::Piece(piece)));
            }
            assert_eq!(receiver.take(), Some(Taken::Setpoint(numbered(number))));
            assert_eq!(receiver.take(), None);
        }
    }

    #[test]
    fn set_points_taken_while_others_send_are_complete_and_in_order() {
        const COUNT: u64 = 200_000;
        let (sender, mut receiver) = setpoint_slot();
        let writer = thread::spawn(move || {
            for number in 1..=COUNT {
                if number.is_multiple_of(7) {
                    sender.send_trajectory(&trajectory(number));
                } else {
                    sender.send(&numbered(number));
                }
            }
        });
        let mut last = 0;
        while last < COUNT {
            let number = match receiver.take() {
                Some(Taken::Setpoint(taken)) => {
                    assert_eq!(taken, numbered(taken.stamp.time.0));
                    taken.stamp.time.0
                }
                Some(Taken::Piece(first)) => {
                    let number = first.stamp.time.0;
                    let mut expected = trajectory(number).pieces().collect::<Vec<_>>();
                    assert_eq!(first, expected.remove(0));
                    for piece in expected {
                        assert_eq!(receiver.take(), Some(Taken::Piece(piece)));
                    }
                    number
                }
                None => continue,
            };
            assert!(number > last);
            last = number;
        }
        writer.join().unwrap();
    }

    #[test]
    fn a_whole_trajectory_comes_out_as_it_went_in() {
        let (sender, mut receiver) = setpoint_slot();
        let longest = trajectory(98);
        assert_eq!(longest.points.len(), MAX_TRAJECTORY_POINTS);
        sender.send_trajectory(&longest);
        assert_pieces(&mut receiver, &longest);
        assert_eq!(receiver.take(), None);
    }
}
