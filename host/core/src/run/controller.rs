//! Joins link session and pilot: one tick, without threads, ports or clocks.
//!
//! The real-time thread and the simulations in virtual time run the same code. They differ
//! only in the source of bytes and time.

use singletrack_control::{NeighbourSample, PoseSample, Position, SteeringMap, Time};
use singletrack_link::{DriveCommand, Event as LinkEvent, JogCommand, Session};
use singletrack_mocap::{Observation, PoseState};
use singletrack_pilot::{
    AttitudeSample, BoardRequest, Event, LineHealth, LinkState, Output, Pilot, PilotRequest,
    PoseMissing, Tilt, Underway,
};

pub use crate::run::queue::{Events, MAX_EVENTS};
use crate::{
    cameras::NewestSamples,
    line::Sent,
    run::messages::{Reconfiguration, Refusal},
    run::proof::{Proof, Proofs},
    run::queue::{Queue, RESERVED},
};

/// The number of other bodies that the pilot is told of in a tick.
const NEIGHBOURS: usize = 8;

/// Link session and pilot, and the events for the next tick.
///
/// Between ticks, pass in what arrives ([`received`](Self::received),
/// [`observed`](Self::observed), [`push`](Self::push), ...). At each tick, call
/// [`tick`](Self::tick), which writes the frames for the board.
#[derive(Debug)]
pub struct Controller {
    /// The session with the board.
    pub session: Session,
    steering: SteeringMap,
    /// The pilot.
    pub pilot: Pilot,
    /// The hash of the configuration in force, of what the first metre proves.
    configuration: u64,
    /// The number of the car; `None` before the board has given it.
    car_id: Option<u16>,
    proofs: Proofs,
    /// A drive contradicted the configuration in force on a car whose number is not known yet.
    contradicted: bool,
    /// The attitude of IMU and body since the last event that has it.
    attitude: AttitudeSample,
    neighbours: NewestSamples,
    queue: Queue,
    ticks: u32,
}

/// The result of a tick.
#[derive(Clone, Debug)]
pub struct Tick {
    /// The events that the pilot handled.
    pub events: Events,
    /// The number of events lost for want of room.
    pub dropped_events: u32,
    /// The pilot's output.
    pub output: Output,
    /// What counts as proved since this tick.
    pub proved: Option<Proof>,
    /// What counts as proved no longer since this tick: what a drive contradicted, as soon as it is
    /// known on which car.
    pub disproved: Option<Proof>,
}

/// Interval of the events with the share of damaged frames, in ticks.
const LINE_HEALTH_TICKS: u32 = 10;

impl Controller {
    /// A controller with a closed port, for a configuration with this hash
    /// ([`configuration_hash`](crate::configuration_hash)).
    pub fn new(
        session: Session,
        steering: SteeringMap,
        pilot: Pilot,
        configuration: u64,
        proofs: Proofs,
    ) -> Self {
        Self {
            session,
            steering,
            pilot,
            configuration,
            car_id: None,
            proofs,
            contradicted: false,
            attitude: AttitudeSample::default(),
            neighbours: NewestSamples::default(),
            queue: Queue::default(),
            ticks: 0,
        }
    }

    /// The configuration in force on this car; `None` before the board has given its number.
    pub fn proof(&self) -> Option<Proof> {
        self.car_id.map(|car_id| Proof {
            configuration: self.configuration,
            car_id,
        })
    }

    /// If a drive has contradicted the configuration in force, it counts as unproved as soon as the
    /// car is known, and the pilot is told so in its next tick. Returns what it was on.
    fn revoke(&mut self) -> Option<Proof> {
        let proof = self.proof().filter(|_| self.contradicted)?;
        self.contradicted = false;
        if self.proofs.remove(proof) {
            self.tell_proved();
        }
        Some(proof)
    }

    /// Tells the pilot whether the configuration in force is proved on this car.
    fn tell_proved(&mut self) {
        let proved = self
            .proof()
            .is_some_and(|proof| self.proofs.contains(proof));
        self.push(Event::Proved(proved));
    }

    /// The port was opened: the session greets the board.
    pub fn port_opened(&mut self, now: Time) {
        self.session.handle_opened(now.0);
    }

    /// The port was closed or has hung up: the link is down.
    pub fn port_closed(&mut self, now: Time, on_link: &mut impl FnMut(&LinkEvent)) {
        self.session.handle_closed(now.0, &mut |event| {
            on_link(&event);
            self.queue.link(&event);
        });
        self.push(Event::Link(LinkState::Down));
    }

    /// Bytes from the board were read at `time`.
    pub fn received(&mut self, time: Time, bytes: &[u8], on_link: &mut impl FnMut(&LinkEvent)) {
        let (before, rate) = (self.car_id, rate(&self.session));
        self.session.handle_bytes(time.0, bytes, &mut |event| {
            on_link(&event);
            match &event {
                // The next board may be in another car.
                LinkEvent::Connected { .. } => self.car_id = None,
                LinkEvent::Identified { car_id } => self.car_id = Some(*car_id),
                LinkEvent::Telemetry(record) if record.has_fresh_imu_sample() => {
                    // One wrong sample does not hide the others; wrong ones only are no tilt.
                    let tilt = imu_tilt(record.telemetry.attitude_q14);
                    self.attitude.imu = tilt.or(self.attitude.imu).or(Some(NO_TILT));
                }
                _ => {}
            }
            let of_board = |speed| self.pilot.speed_of_board(speed, rate);
            self.queue.link_with(&event, of_board);
        });
        if self.car_id != before {
            self.tell_proved();
        }
    }

    /// The motion capture reported on the rigid body.
    pub fn observed(&mut self, observation: &Observation) {
        if let PoseState::Valid(pose) = observation.state {
            self.attitude.body = Some(Tilt {
                roll: pose.roll_rad,
                pitch: pose.pitch_rad,
            });
            self.attitude.height = Some(pose.z_m);
            self.attitude.capture_uncertainty = Some(pose.capture_uncertainty_ns as f64 * 1e-9);
        }
        self.push(pose_event(&observation.state));
    }

    /// The motion capture saw another rigid body. Of each, the newest sample counts.
    pub fn saw_neighbour(&mut self, sample: NeighbourSample) {
        self.neighbours.add(sample);
    }

    /// Replaces the configuration of pilot and board. The next tick sends it to the board, which
    /// accepts no commands until it has acknowledged it.
    ///
    /// # Errors
    ///
    /// A [`Refusal`] while a drive is underway, and for an invalid configuration of the board.
    /// Nothing changes then.
    pub fn reconfigure(&mut self, now: Time, change: &Reconfiguration) -> Result<(), Refusal> {
        let mode = self.pilot.mode();
        // The new configuration would apply to an arm request that came before it.
        let arms = |event: &Event| matches!(event, Event::Request(PilotRequest::Arm(_)));
        let asked = self.queue.events.iter().any(arms);
        if mode.is_underway() || asked {
            return Err(Underway(mode).into());
        }
        if change.board != *self.session.configuration() {
            self.session.configure(now.0, change.board)?;
            self.push(Event::Link(LinkState::Down));
        }
        self.pilot.reconfigure(&change.pilot)?;
        self.steering.clone_from(&change.steering);
        self.push(Event::Reconfigured(change.number));
        if change.hash != self.configuration {
            self.configuration = change.hash;
            self.tell_proved();
        }
        Ok(())
    }

    /// One control tick. `write` accepts a whole frame or none.
    pub fn tick(
        &mut self,
        now: Time,
        write: &mut impl FnMut(&[u8]) -> Sent,
        on_link: &mut impl FnMut(&LinkEvent),
    ) -> Tick {
        self.session.handle_timeout(now.0, &mut |event| {
            on_link(&event);
            self.queue.link(&event);
        });
        if self.ticks.is_multiple_of(LINE_HEALTH_TICKS) {
            self.push(Event::Line(line_health(&self.session, now)));
            let attitude = core::mem::take(&mut self.attitude);
            if attitude != AttitudeSample::default() {
                self.push(Event::Attitude(attitude));
            }
        }
        for _ in 0..NEIGHBOURS {
            // They give way to all other events; one that waits only seems farther gone.
            if self.queue.events.len() >= MAX_EVENTS - RESERVED {
                break;
            }
            let Some(sample) = self.neighbours.take() else {
                break;
            };
            self.push(Event::Neighbour(sample));
        }
        self.ticks = self.ticks.wrapping_add(1);
        let known_late = self.revoke();
        let Queue { events, dropped } = core::mem::take(&mut self.queue);
        let output = self.pilot.step(now, &events);
        let proved = self.proof().filter(|_| output.proved);
        if let Some(proof) = proved {
            self.proofs.insert(proof);
        }
        self.contradicted |= output.disproved;
        let disproved = self.revoke().or(known_late);

        // The drive command is written first: it must not be late.
        let rate = rate(&self.session);
        // The command of the tick in which the first metre ends is still one of it.
        let rate = if output.proved { 1.0 } else { rate };
        let drive = output.command.and_then(|command| {
            let command = DriveCommand {
                speed_m_s: self.pilot.speed_for_board(command.rear_speed, rate),
                steering_rad: self.steering.commanded(command.steering),
                brake: command.brake,
                pose_time_ns: Some(command.pose_time.0),
            };
            self.session.drive(now.0, command).ok()
        });
        let jog = output.jog.and_then(|jog| {
            let command = JogCommand {
                servo_us: jog.servo_us,
                esc_us: jog.esc_us,
            };
            self.session.jog(now.0, command).ok()
        });
        // There is no frame for a board that is not ready.
        if let Some(frame) = drive.or(jog) {
            write(frame.as_bytes());
        }
        match output.request {
            Some(BoardRequest::Arm) => {
                let asked = self.session.arm(now.0);
                if asked.is_err() {
                    self.push(Event::ArmRefused);
                }
            }
            Some(BoardRequest::Disarm) => {
                self.session.disarm(now.0);
            }
            Some(BoardRequest::EmergencyStop) => {
                self.session.emergency_stop(now.0);
            }
            None => {}
        }
        while let Some(transmit) = self.session.poll_transmit(now.0) {
            write(transmit.as_bytes());
        }
        Tick {
            events,
            dropped_events: dropped,
            output,
            proved,
            disproved,
        }
    }

    /// Adds an event for the next tick. Of set-points and of the operator's pulses only the newest of
    /// a tick counts, and the tunings of a tick become one.
    pub fn push(&mut self, event: Event) {
        self.queue.push(event);
    }
}

/// Bound on how the square of a quaternion's length differs from 1: more than its rounding (0.0003),
/// less than a wrong bit of the three highest makes (0.25).
const UNIT: f64 = 0.04;

/// The tilt of a sensor that gives no rotation: within no limit.
const NO_TILT: Tilt = Tilt {
    roll: f64::NAN,
    pitch: f64::NAN,
};

/// Roll and pitch of a quaternion (w, x, y, z) in units of 2^-14, from car to world. None if it is
/// no rotation: its length is not 1.
pub fn imu_tilt(quaternion: [i16; 4]) -> Option<Tilt> {
    let [w, x, y, z] = quaternion.map(|part| f64::from(part) / 16_384.0);
    let squared = w * w + x * x + y * y + z * z;
    ((squared - 1.0).abs() <= UNIT).then(|| Tilt {
        roll: libm::atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
        pitch: libm::asin((2.0 * (w * y - x * z)).clamp(-1.0, 1.0)),
    })
}

/// The share of damaged frames, in both directions.
fn line_health(session: &Session, now: Time) -> LineHealth {
    let part = |fraction: Option<f32>| fraction.map(f64::from);
    LineHealth {
        to_host: part(session.line_quality(now.0).damaged_fraction()),
        to_board: part(
            session
                .board_line_quality()
                .and_then(|quality| quality.damaged_fraction()),
        ),
    }
}

/// How many seconds of the host's clock pass in one of the board's, with which the board
/// measures speeds.
fn rate(session: &Session) -> f64 {
    1.0 + 1e-6 * session.clock().skew_ppm()
}

/// What the pilot is told of a frame of the cameras.
pub const fn pose_event(state: &PoseState) -> Event {
    match state {
        PoseState::Valid(pose) => Event::Pose(PoseSample {
            capture: Time(pose.capture_time_ns),
            receive: Time(pose.receive_time_ns),
            frame: pose.frame_number,
            position: Position::new(pose.x_m, pose.y_m),
            yaw: pose.yaw_rad,
        }),
        PoseState::Untracked => Event::PoseMissing(PoseMissing::Untracked),
        PoseState::Absent | PoseState::Unbound(_) => Event::PoseMissing(PoseMissing::Absent),
        PoseState::Rejected(_) => Event::PoseMissing(PoseMissing::Rejected),
        PoseState::LockedOut(_) => Event::PoseMissing(PoseMissing::Untrustworthy),
        PoseState::Stale { .. } | PoseState::NoFrames => Event::PoseMissing(PoseMissing::Stale),
    }
}

#[cfg(test)]
mod tests {
    use singletrack_protocol::{
        Acknowledgement, Decoder, Identity, Message as _, Request, ToBoard,
    };

    use super::*;
    use crate::Config;

    fn controller(proofs: Proofs) -> Controller {
        let config =
            Config::from_toml(include_str!("../../../daemon/singletrackd.example.toml")).unwrap();
        Controller::new(
            Session::new(config.link(1)).unwrap(),
            config.steering_map().unwrap(),
            Pilot::new(config.pilot().unwrap()),
            5,
            proofs,
        )
    }

    #[test]
    fn the_imus_quaternion_gives_roll_and_pitch() {
        let near = |quaternion: [f64; 4], roll: f64, pitch: f64| {
            let tilt = imu_tilt(quaternion.map(|part| (part * 16_384.0) as i16)).unwrap();
            assert!((tilt.roll - roll).abs() < 1e-3, "{tilt:?}");
            assert!((tilt.pitch - pitch).abs() < 1e-3, "{tilt:?}");
        };
        let half = |angle: f64| (libm::sin(0.5 * angle), libm::cos(0.5 * angle));
        let ((sr, cr), (sp, cp), (sy, cy)) = (half(0.3), half(-0.2), half(0.9));
        near([cr, sr, 0.0, 0.0], 0.3, 0.0);
        near([cp, 0.0, sp, 0.0], 0.0, -0.2);
        // Yaw, then pitch, then roll.
        let all = [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ];
        near(all, 0.3, -0.2);
    }

    #[test]
    fn a_quaternion_with_a_wrong_bit_is_no_tilt() {
        // Level, and turned by 40 degrees.
        for quaternion in [[16_384, 0, 0, 0], [15_396, 0, 0, 5_604]] {
            assert!(imu_tilt(quaternion).is_some());
            for (part, bit) in (0..4).flat_map(|part| [13, 14, 15].map(|bit| (part, bit))) {
                let mut wrong: [i16; 4] = quaternion;
                wrong[part] ^= (1_u16 << bit).cast_signed();
                // The negative of a rotation is the same one.
                let is_level = |tilt: Tilt| tilt.roll.abs().max(tilt.pitch.abs()) < 1e-3;
                assert!(
                    imu_tilt(wrong).is_none_or(is_level),
                    "{quaternion:?}, bit {bit} of part {part}"
                );
            }
        }
        assert_eq!(imu_tilt([0; 4]), None);
    }

    #[test]
    fn a_port_that_is_closed_takes_the_link_down() {
        let mut controller = controller(Proofs::default());
        controller.port_opened(Time(1_000));
        controller.port_closed(Time(2_000), &mut |_| {});
        assert_eq!(
            controller.queue.events.as_slice(),
            [Event::Link(LinkState::Down)]
        );
        let state = controller.session.state();
        assert_eq!(state, singletrack_link::State::Disconnected);
    }

    #[test]
    fn a_disproved_configuration_is_unproved_for_the_pilot_and_on_this_car_alone() {
        let proof = |car_id| Proof {
            configuration: 5,
            car_id,
        };
        let mut controller = controller(Proofs::of(&[proof(1), proof(2)]));
        controller.contradicted = true;
        assert_eq!(controller.revoke(), None, "before the board's number");
        assert!(controller.proofs.contains(proof(1)));
        controller.car_id = Some(1);
        assert_eq!(controller.revoke(), Some(proof(1)));
        assert!(!controller.proofs.contains(proof(1)));
        assert_eq!(controller.queue.events.as_slice(), [Event::Proved(false)]);
        assert!(controller.proofs.contains(proof(2)));
        assert_eq!(controller.revoke(), None);
        // It is void already, and perhaps not in the file.
        controller.contradicted = true;
        assert_eq!(controller.revoke(), Some(proof(1)));
        assert_eq!(controller.queue.events.len(), 1);
    }

    /// A tick of a board that greets and accepts its configuration, and whose number may be lost.
    fn greeted_tick(controller: &mut Controller, now: Time, number_is_lost: bool) -> Tick {
        let mut frames = std::vec::Vec::new();
        let mut write = |frame: &[u8]| {
            frames.extend_from_slice(frame);
            Sent::Whole
        };
        let tick = controller.tick(now, &mut write, &mut |_| {});
        let mut decoder = Decoder::new();
        for byte in frames {
            let Some(Ok(packet)) = decoder.push(byte) else {
                continue;
            };
            let answer = match ToBoard::decode(packet) {
                Ok(ToBoard::Hello(hello)) => {
                    controller.received(now, hello.encode().as_bytes(), &mut |_| {});
                    if number_is_lost {
                        continue;
                    }
                    Identity { car_id: 0 }.encode()
                }
                Ok(ToBoard::Configure(configure)) => Acknowledgement {
                    request: Request::Configure,
                    sequence: configure.request,
                    configuration_hash: configure.configuration.hash(),
                }
                .encode(),
                _ => continue,
            };
            controller.received(now, answer.as_bytes(), &mut |_| {});
        }
        tick
    }

    #[test]
    fn a_contradiction_is_kept_until_the_board_has_given_its_number() {
        let proof = Proof {
            configuration: 5,
            car_id: 0,
        };
        let mut controller = controller(Proofs::of(&[proof]));
        controller.contradicted = true;
        controller.port_opened(Time(0));
        let ticks: std::vec::Vec<_> = (1..60_u64)
            .map(|tick| greeted_tick(&mut controller, Time(tick * 10_000_000), tick < 30))
            .collect();
        assert!(ticks[..29].iter().all(|tick| tick.disproved.is_none()));
        let state = controller.session.state();
        assert!(
            matches!(state, singletrack_link::State::Ready { .. }),
            "{state:?}"
        );
        let disproved: std::vec::Vec<_> = ticks.iter().filter_map(|tick| tick.disproved).collect();
        assert_eq!(disproved, [proof]);
        assert!(!controller.proofs.contains(proof));
        let told = ticks.iter().flat_map(|tick| &tick.events);
        let mut told = told.filter(|event| matches!(event, Event::Proved(_)));
        assert_eq!(told.next_back(), Some(&Event::Proved(false)));
    }
}
