//! The events of the next tick: what those of the link say to the pilot, which of all share a place,
//! and which give way to others.

use singletrack_control::{InertialSample, Time};
use singletrack_link::{Event as LinkEvent, TimedTelemetry};
use singletrack_pilot::{
    BoardHealth, BoardSample, BoardState, Event, LinkState, PilotRequest, Tuning,
};
use singletrack_protocol::{
    BoardMode, RefusalReason, Request as BoardRequestKind, Status, StopCause,
};
pub use singletrack_record::MAX_EVENTS;

/// Places for events that must not be lost, such as a stop: after a stall, samples fill the
/// others.
pub(crate) const RESERVED: usize = 19;

/// The events of one tick, in order.
pub type Events = heapless::Vec<Event, MAX_EVENTS>;

/// The events of the next tick, and the number of those that found no room.
#[derive(Debug, Default)]
pub(crate) struct Queue {
    pub(crate) events: Events,
    pub(crate) dropped: u32,
}

impl Queue {
    pub(crate) fn push(&mut self, event: Event) {
        let room = match event {
            Event::Pose(_)
            | Event::PoseMissing(_)
            | Event::Neighbour(_)
            | Event::Board(_)
            | Event::TrajectoryPiece(_) => MAX_EVENTS - RESERVED,
            // Only the latest value matters.
            Event::Health(_)
            | Event::Line(_)
            | Event::Attitude(_)
            | Event::RealTime(_)
            | Event::Learned(_)
            | Event::Setpoint(_)
            | Event::Jog(_) => {
                if self.take_place_of_last(event) {
                    return;
                }
                MAX_EVENTS - RESERVED
            }
            // A held drive lives from the newest of these; a flood must not displace a stop.
            Event::Request(PilotRequest::Hold) => {
                if self.events.contains(&event) {
                    return;
                }
                MAX_EVENTS - RESERVED
            }
            Event::Tuning(tuning) if self.joins_last(tuning) => return,
            Event::Link(_)
            | Event::Request(_)
            | Event::Tuning(_)
            | Event::ArmRefused
            | Event::Begin(_)
            | Event::Proved(_)
            | Event::Reconfigured(_) => {
                self.drop_repeated_link(event);
                if self.events.is_full() {
                    self.drop_oldest_sample();
                }
                MAX_EVENTS
            }
        };
        if self.events.len() >= room || self.events.push(event).is_err() {
            self.dropped = self.dropped.saturating_add(1);
        }
    }

    /// Adds a tuning to the last one, unless the configuration has changed in between; false if
    /// there is none.
    fn joins_last(&mut self, tuning: Tuning) -> bool {
        for other in self.events.iter_mut().rev() {
            match other {
                Event::Reconfigured(_) => return false,
                Event::Tuning(last) => {
                    *last = tuning.or(*last);
                    return true;
                }
                _ => {}
            }
        }
        false
    }

    /// Removes an equal state of the link if it is the last one: the later event counts.
    fn drop_repeated_link(&mut self, event: Event) {
        let mut links = self.events.iter().enumerate().rev();
        let last = links.find(|(_, other)| matches!(other, Event::Link(_)));
        if let Some((index, last)) = last
            && *last == event
        {
            self.events.remove(index);
        }
    }

    fn drop_oldest_sample(&mut self) {
        let oldest = self.events.iter().position(|event| {
            matches!(
                event,
                Event::Pose(_) | Event::PoseMissing(_) | Event::Neighbour(_) | Event::Board(_)
            )
        });
        if let Some(oldest) = oldest {
            self.events.remove(oldest);
            self.dropped = self.dropped.saturating_add(1);
        }
    }

    /// Replaces the last event of the same kind; false if there is none. An event before a
    /// change of link or configuration is not replaced: the change may have invalidated it.
    fn take_place_of_last(&mut self, event: Event) -> bool {
        let kind = core::mem::discriminant(&event);
        for other in self.events.iter_mut().rev() {
            if matches!(other, Event::Link(_) | Event::Reconfigured(_)) {
                return false;
            }
            if core::mem::discriminant(other) == kind {
                *other = event;
                return true;
            }
        }
        false
    }

    /// Translates an event of the link for the pilot.
    pub(crate) fn link(&mut self, event: &LinkEvent) {
        self.link_with(event, |speed| speed);
    }

    /// [`link`](Self::link) with a conversion of the motor's speed.
    pub(crate) fn link_with(&mut self, event: &LinkEvent, motor_speed: impl Fn(f64) -> f64) {
        if let Some(mut event) = pilot_event(event) {
            if let Event::Board(sample) = &mut event {
                sample.motor_speed = motor_speed(sample.motor_speed);
            }
            self.push(event);
        }
    }
}

/// The pilot's event for one of the link; none for what does not concern it. The motor's speed is
/// by the board's clock.
pub fn pilot_event(event: &LinkEvent) -> Option<Event> {
    Some(match event {
        LinkEvent::Telemetry(record) => Event::Board(board_sample(record)),
        LinkEvent::ConfigurationAccepted { .. } => Event::Link(LinkState::Ready),
        LinkEvent::VersionMismatch(_) => Event::Link(LinkState::VersionDiffers),
        LinkEvent::ConfigurationRefused {
            reason: RefusalReason::EmergencyStopLatched,
            ..
        } => Event::Link(LinkState::EmergencyStopped),
        LinkEvent::ConfigurationRefused { .. } => Event::Link(LinkState::ConfigurationRefused),
        LinkEvent::BoardRestarted { .. } | LinkEvent::Lost { .. } => Event::Link(LinkState::Down),
        LinkEvent::Status(status) => Event::Health(BoardHealth {
            // What a floating input shows is no battery.
            battery_mv: if status.battery_open {
                0
            } else {
                status.battery_mv
            },
            stop_input_open: status.stop_input_open,
            battery_open: status.battery_open,
            imu_fault: imu_fault(status),
        }),
        LinkEvent::Refused {
            request: BoardRequestKind::Arm,
            ..
        } => Event::ArmRefused,
        LinkEvent::Connected { .. }
        | LinkEvent::Identified { .. }
        | LinkEvent::Acknowledged { .. }
        | LinkEvent::Refused { .. }
        | LinkEvent::Unanswered { .. }
        | LinkEvent::StopConfirmed { .. } => return None,
    })
}

/// Whether the IMU's registers report an error. A self-test of zero has not been read yet.
const fn imu_fault(status: &Status) -> bool {
    /// `SYS_STATUS` of a system error.
    const ERROR: u8 = 1;
    /// Accelerometer, gyro and controller; the magnetometer is not used.
    const PASSED: u8 = 0b1101;
    status.imu_status == ERROR
        || (status.imu_self_test != 0 && status.imu_self_test & PASSED != PASSED)
}

/// Converts telemetry to SI units.
fn board_sample(record: &TimedTelemetry) -> BoardSample {
    let telemetry = &record.telemetry;
    let milli = |value: i16| f64::from(value) / 1000.0;
    let [forward, left, _] = telemetry.linear_acceleration_mm_s2.map(milli);
    let [_, _, yaw_rate] = telemetry.angular_velocity_mrad_s.map(milli);
    BoardSample {
        time: Time(record.board_time_host_ns),
        inertial: record
            .imu_time_host_ns
            .filter(|_| record.has_fresh_imu_sample())
            .map(|time| InertialSample {
                time: Time(time),
                yaw_rate,
                forward_acceleration: forward,
                left_acceleration: left,
            }),
        motor_speed: milli(telemetry.motor_speed_mm_s),
        state: match telemetry.mode {
            BoardMode::Boot => BoardState::Booting,
            BoardMode::Neutral => BoardState::Neutral,
            BoardMode::Armed => BoardState::Armed,
            BoardMode::Driving => BoardState::Driving,
            BoardMode::Failsafe => BoardState::Failsafe,
            BoardMode::EmergencyStopped if telemetry.stop_cause == StopCause::RunsAtNeutral => {
                BoardState::RunsAtNeutral
            }
            BoardMode::EmergencyStopped => BoardState::EmergencyStopped,
            BoardMode::PoweringUp => BoardState::PoweringUp,
            BoardMode::Jogging => BoardState::Jogging,
        },
    }
}

#[cfg(test)]
mod tests {
    use singletrack_pilot::PoseMissing;

    use super::*;

    #[test]
    fn a_flood_of_samples_displaces_no_stop_and_a_stop_the_oldest_sample() {
        let mut queue = Queue::default();
        let missing = Event::PoseMissing(PoseMissing::Absent);
        for _ in 0..MAX_EVENTS {
            queue.push(missing);
        }
        assert_eq!(queue.events.len(), MAX_EVENTS - RESERVED);
        assert_eq!(queue.dropped, RESERVED as u32);
        let stop = Event::Request(PilotRequest::EmergencyStop);
        for _ in 0..=RESERVED {
            queue.push(stop);
        }
        // The last one took the place of a sample.
        assert!(queue.events.is_full());
        assert_eq!(queue.dropped, RESERVED as u32 + 1);
        let stops = queue.events.iter().filter(|event| **event == stop);
        assert_eq!(stops.count(), RESERVED + 1);
    }

    #[test]
    fn of_equal_states_of_the_link_in_a_row_the_later_one_counts() {
        let mut queue = Queue::default();
        let (down, ready) = (Event::Link(LinkState::Down), Event::Link(LinkState::Ready));
        let missing = Event::PoseMissing(PoseMissing::Absent);
        for event in [down, missing, down, ready, down] {
            queue.push(event);
        }
        assert_eq!(queue.events.as_slice(), [missing, down, ready, down]);
    }

    #[test]
    fn the_tunings_of_a_tick_are_one_event_with_the_newest_of_each_value() {
        let mut queue = Queue::default();
        let gain = |gain: f64| Some(singletrack_control::Velocity::new(gain, gain));
        let tuning = |gain, point_distance| Tuning {
            gain,
            point_distance,
        };
        queue.push(Event::Tuning(tuning(gain(1.0), Some(0.3))));
        queue.push(Event::Request(PilotRequest::Hold));
        queue.push(Event::Tuning(tuning(gain(2.0), None)));
        let events = [
            Event::Tuning(tuning(gain(2.0), Some(0.3))),
            Event::Request(PilotRequest::Hold),
        ];
        assert_eq!(queue.events.as_slice(), events);
        // It belongs to the configuration before or after.
        queue.push(Event::Reconfigured(2));
        queue.push(Event::Tuning(tuning(None, Some(0.4))));
        assert_eq!(queue.events.len(), 4);
    }
}
