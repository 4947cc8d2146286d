//! Slots in which the newest value waits for the control loop, which takes it without waiting; that of
//! the set-points also keeps the pieces of a trajectory.

use std::sync::{Arc, Mutex, PoisonError, TryLockError};

use singletrack_control::{Setpoint, Trajectory};
use singletrack_pilot::{Event, Jog, Tuning};

use crate::setpoint::SetpointCommand;

/// The sending end, for every thread but the control thread.
#[derive(Debug)]
pub struct SlotSender<T>(Arc<Mutex<Option<T>>>);

/// The receiving end, for the control thread.
#[derive(Debug)]
pub struct SlotReceiver<T>(Arc<Mutex<Option<T>>>);

/// Makes an empty slot.
pub fn slot<T>() -> (SlotSender<T>, SlotReceiver<T>) {
    let shared = Arc::new(Mutex::new(None));
    (SlotSender(Arc::clone(&shared)), SlotReceiver(shared))
}

impl<T> Clone for SlotSender<T> {
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}

impl<T> SlotSender<T> {
    /// Replaces the value in the slot by one that may follow from it.
    pub(crate) fn replace(&self, by: impl FnOnce(Option<T>) -> T) {
        let mut slot = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        *slot = Some(by(slot.take()));
    }
}

impl<T> SlotReceiver<T> {
    /// The newest value; `None` if it was taken before.
    pub fn take(&mut self) -> Option<T> {
        match self.0.try_lock() {
            Ok(mut slot) => slot.take(),
            Err(TryLockError::Poisoned(error)) => error.into_inner().take(),
            Err(TryLockError::WouldBlock) => None,
        }
    }
}

impl SlotSender<Jog> {
    /// Replaces the operator's pulses in the slot.
    pub fn send(&self, jog: Jog) {
        self.replace(|_| jog);
    }
}

impl SlotSender<Tuning> {
    /// Replaces the values in the slot by those that are given.
    ///
    /// The sender has checked them: [`TuningRule::check`](crate::config::TuningRule::check).
    pub fn send(&self, tuning: Tuning) {
        self.replace(|waiting| tuning.or(waiting.unwrap_or_default()));
    }
}

/// The sending end, for every thread but the control thread.
#[derive(Clone, Debug)]
pub struct SetpointSender(SlotSender<Sent>);

/// The receiving end, for the control thread.
#[derive(Debug)]
pub struct SetpointReceiver {
    slot: SlotReceiver<Sent>,
    /// The trajectory that was begun, and its next point to pass on.
    trajectory: Trajectory,
    next: usize,
}

#[derive(Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "the control thread must not free a box"
)]
enum Sent {
    Setpoint(Setpoint),
    Trajectory(Trajectory),
}

/// Makes an empty slot.
pub fn setpoint_slot() -> (SetpointSender, SetpointReceiver) {
    let (sender, slot) = slot();
    let receiver = SetpointReceiver {
        slot,
        trajectory: Trajectory::default(),
        next: 0,
    };
    (SetpointSender(sender), receiver)
}

impl SetpointSender {
    /// Replaces the set-point in the slot. Senders may wait for each other.
    pub fn send(&self, setpoint: &Setpoint) {
        let sent = Sent::Setpoint(*setpoint);
        self.0.replace(|_| sent);
    }

    /// Replaces the set-point in the slot by a trajectory.
    pub fn send_trajectory(&self, trajectory: &Trajectory) {
        let sent = Sent::Trajectory(trajectory.clone());
        self.0.replace(|_| sent);
    }

    /// Replaces what is in the slot.
    pub fn pass(&self, command: &SetpointCommand) {
        match command {
            SetpointCommand::Setpoint(setpoint) => self.send(setpoint),
            SetpointCommand::Trajectory(trajectory) => self.send_trajectory(trajectory),
        }
    }
}

impl SetpointReceiver {
    /// The next point of the trajectory that was begun, else the newest set-point or the first
    /// point of a new trajectory; `None` if it was taken before.
    ///
    /// A trajectory that was begun is passed on to its end: a sender that replaces it before
    /// would keep every one from coming into force.
    pub fn take(&mut self) -> Option<Event> {
        if self.next >= self.trajectory.points.len() {
            match self.slot.take()? {
                Sent::Setpoint(setpoint) => return Some(Event::Setpoint(setpoint)),
                Sent::Trajectory(trajectory) => self.trajectory = trajectory,
            }
            self.next = 0;
        }
        let piece = self.trajectory.pieces().nth(self.next)?;
        self.next += 1;
        Some(Event::TrajectoryPiece(piece))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use singletrack_control::Demand;
    use singletrack_control::MAX_TRAJECTORY_POINTS;
    use singletrack_control::Position;
    use singletrack_control::ReferencePoint;
    use singletrack_control::SetpointStamp;
    use singletrack_control::SpeedDemand;
    use singletrack_control::SteeringDemand;
    use singletrack_control::Time;
    use singletrack_control::TrajectoryPoint;
    use singletrack_control::Velocity;
    use std::thread;

    const fn jog(number: u16) -> Jog {
        Jog {
            servo_us: number,
            esc_us: !number,
        }
    }

    #[test]
    fn only_the_newest_is_taken_and_only_once_also_if_it_is_equal() {
        let (sender, mut receiver) = slot::<Jog>();
        assert_eq!(receiver.take(), None);
        for number in 0..1_000 {
            sender.send(jog(number));
        }
        assert_eq!(receiver.take(), Some(jog(999)));
        assert_eq!(receiver.take(), None);
        sender.clone().send(jog(999));
        assert_eq!(receiver.take(), Some(jog(999)));
    }

    #[test]
    fn pulses_taken_while_others_send_belong_together() {
        const COUNT: u16 = 50_000;
        let (sender, mut receiver) = slot::<Jog>();
        let writer = thread::spawn(move || {
            for number in 1..=COUNT {
                sender.send(jog(number));
            }
        });
        let mut last = 0;
        while last < COUNT {
            if let Some(taken) = receiver.take() {
                assert_eq!(taken, jog(taken.servo_us));
                assert!(taken.servo_us > last);
                last = taken.servo_us;
            }
        }
        writer.join().unwrap();
    }

    #[test]
    fn the_newest_of_each_value_to_tune_is_taken_once() {
        let (sender, mut receiver) = slot::<Tuning>();
        let tuning = |gain: Option<f64>, point_distance| Tuning {
            gain: gain.map(|gain| [gain, gain].into()),
            point_distance,
        };
        assert_eq!(receiver.take(), None);
        for number in 0..1_000 {
            sender.send(tuning(Some(f64::from(number)), None));
        }
        sender.send(tuning(None, Some(0.3)));
        assert_eq!(receiver.take(), Some(tuning(Some(999.0), Some(0.3))));
        assert_eq!(receiver.take(), None);
    }

    #[test]
    fn a_sender_holds_up_no_tick_and_one_that_panicked_no_other() {
        let (sender, mut receiver) = slot::<Jog>();
        sender.send(jog(1));
        {
            let _sending = sender.0.lock().unwrap();
            assert_eq!(receiver.take(), None);
        }
        let other = sender.clone();
        let panicked = thread::spawn(move || other.replace(|_| panic!("while sending"))).join();
        assert!(panicked.is_err());
        sender.send(jog(2));
        assert_eq!(receiver.take(), Some(jog(2)));
    }

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
            assert_eq!(receiver.take(), Some(Event::TrajectoryPiece(piece)));
        }
    }

    #[test]
    fn only_the_newest_is_taken_and_only_once() {
        let (sender, mut receiver) = setpoint_slot();
        assert_eq!(receiver.take(), None);
        for number in 1..=1_000 {
            sender.send(&numbered(number));
            if number > 950 {
                assert_eq!(receiver.take(), Some(Event::Setpoint(numbered(number))));
            }
        }
        assert_eq!(receiver.take(), None);
        sender.send_trajectory(&trajectory(5));
        sender.clone().send(&numbered(3));
        assert_eq!(receiver.take(), Some(Event::Setpoint(numbered(3))));
    }

    #[test]
    fn a_trajectory_that_was_begun_is_passed_on_to_its_end() {
        let (sender, mut receiver) = setpoint_slot();
        for number in [98, 0, 17] {
            sender.send_trajectory(&trajectory(number));
            let first = trajectory(number)
                .pieces()
                .next()
                .map(Event::TrajectoryPiece);
            assert_eq!(receiver.take(), first);
            sender.send_trajectory(&trajectory(number + 1));
            sender.send(&numbered(number));
            for piece in trajectory(number).pieces().skip(1) {
                assert_eq!(receiver.take(), Some(Event::TrajectoryPiece(piece)));
            }
            assert_eq!(receiver.take(), Some(Event::Setpoint(numbered(number))));
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
                Some(Event::Setpoint(taken)) => {
                    assert_eq!(taken, numbered(taken.stamp.time.0));
                    taken.stamp.time.0
                }
                Some(Event::TrajectoryPiece(first)) => {
                    let number = first.stamp.time.0;
                    let mut expected = trajectory(number).pieces().collect::<Vec<_>>();
                    assert_eq!(first, expected.remove(0));
                    for piece in expected {
                        assert_eq!(receiver.take(), Some(Event::TrajectoryPiece(piece)));
                    }
                    number
                }
                _ => continue,
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
