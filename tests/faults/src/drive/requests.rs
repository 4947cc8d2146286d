//! What operator, program and other clients ask of the daemon in a drive.

use singletrack_control::{Position, Time};
use singletrack_pilot::{Arming, PilotRequest};
use singletrack_sim::HandMotion;

use super::Drive;
use crate::{
    SetupError,
    daemon::host_ns,
    program::{Attends, Renewal, Sight},
    schedule::{FaultKind, OperatorRequest, ReferenceKind},
    setting,
    stop::STANDING,
};

/// From a request to arm to the start that it gives.
const WAIT_US: u64 = 1_200_000;

/// Height of the wheels of a car on its stand, in m.
const STAND_M: f64 = 0.1;

impl Drive<'_> {
    /// Sends the operator's requests and the program's set-points. A daemon that does not
    /// run misses them; a paused one gets the requests later.
    pub(super) fn send_requests(&mut self) -> Result<(), SetupError> {
        if self.paused {
            return Ok(());
        }
        self.flood();
        self.attend();
        while let Some(ask) = self.schedule.requests.get(self.next_request)
            && u64::from(ask.at_ms) * 1_000 <= self.now_us
        {
            self.next_request += 1;
            let situation = &self.schedule.situation;
            let attends = match ask.request {
                OperatorRequest::Arm if situation.waits || situation.attended => {
                    Some(Attends::Drive)
                }
                OperatorRequest::Jog => Some(Attends::Taps),
                OperatorRequest::JogOn => Some(Attends::Throttle),
                _ => None,
            };
            let request = match ask.request {
                OperatorRequest::Arm if situation.waits => {
                    if let Some(daemon) = &self.daemon {
                        daemon.arm_at(host_ns(self.now_us + WAIT_US));
                        self.operator.attend(self.now_us, Attends::Drive);
                    }
                    continue;
                }
                OperatorRequest::Arm if situation.attended => PilotRequest::Arm(Arming::Held),
                OperatorRequest::Arm => PilotRequest::Arm(Arming::Unattended),
                OperatorRequest::Jog | OperatorRequest::JogOn => PilotRequest::Arm(Arming::Jog),
                OperatorRequest::Disarm => PilotRequest::Disarm,
                OperatorRequest::Stop => PilotRequest::EmergencyStop,
                OperatorRequest::Gone => PilotRequest::OperatorGone,
                OperatorRequest::TimeUp => PilotRequest::TimeUp,
                OperatorRequest::Halt => PilotRequest::Halt,
                OperatorRequest::Lift | OperatorRequest::PutDown => {
                    self.lift(ask.request == OperatorRequest::Lift);
                    continue;
                }
                OperatorRequest::Reload => {
                    self.reload()?;
                    continue;
                }
                OperatorRequest::Carry => {
                    let truth = self.world.truth();
                    let held = self.is_held();
                    if self.was_driving || held || truth.speed.abs() >= STANDING {
                        continue;
                    }
                    let car = &mut self.world.car;
                    let (start, battery) = (car.parameters.start, car.parameters.battery);
                    car.place(start);
                    car.drain_battery((truth.battery_v - battery.start_v) / battery.fall_v_per_ah);
                    PilotRequest::Carried
                }
            };
            if let Some(daemon) = &mut self.daemon {
                let is_taken = daemon.request(request);
                let arms = matches!(request, PilotRequest::Arm(_));
                // A stop may not be refused.
                if is_taken || !arms {
                    self.pending_requests.push(request);
                }
                match attends {
                    Some(attends) if is_taken => self.operator.attend(self.now_us, attends),
                    Some(_) => {}
                    None => self.operator.leave(),
                }
            }
        }
        if let Some(daemon) = &self.daemon
            && self.schedule.situation.reference == ReferenceKind::External
        {
            let truth = self.world.truth();
            let sight = Sight {
                position: Position::new(truth.x, truth.y),
                yaw: truth.yaw,
                drive_time_s: self.drive_time_s,
            };
            let mut faults = self.faults.iter().copied();
            let fault = faults.find(|fault| fault.kind.changes_setpoints());
            let situation = &self.schedule.situation;
            let now = Time(host_ns(self.now_us));
            for sent in self.program.poll(self.now_us, situation, sight, fault) {
                daemon.send(&sent);
                if sent.check(now, f64::INFINITY).is_ok() {
                    let decided = Some(sent.stamp().time.0);
                    self.newest_setpoint_ns = self.newest_setpoint_ns.max(decided);
                }
            }
        }
        Ok(())
    }

    /// Renews what the operator attends.
    fn attend(&mut self) {
        let Some(daemon) = &self.daemon else { return };
        let (faults, board) = (&self.faults, &self.spec.board);
        match self.operator.poll(self.now_us, faults, board) {
            None => {}
            Some(Renewal::Hold) => {
                daemon.request(PilotRequest::Hold);
            }
            Some(Renewal::Jog(jog)) => daemon.jog(jog),
        }
    }

    /// Whether the car is in somebody's hands, or on a stand.
    pub(super) fn is_held(&self) -> bool {
        let car = &self.world.car;
        car.is_in_motion_by_hand() || car.wheels_are_up()
    }

    /// Puts a car that stands onto a stand, or down again.
    fn lift(&mut self, up: bool) {
        let stands = self.world.truth().speed.abs() < STANDING;
        if up && !self.is_held() && !self.was_driving && stands {
            let motion = HandMotion::Lift { height_m: STAND_M };
            self.world.car.begin_by_hand(motion);
        } else if !up && self.is_held() {
            self.world.car.begin_by_hand(HandMotion::PutDown);
        }
    }

    /// Sends what other clients send.
    fn flood(&mut self) {
        let mut faults = self.faults.iter();
        let flood = faults.find(|fault| fault.kind == FaultKind::RequestFlood);
        let (Some(flood), Some(daemon)) = (flood, &self.daemon) else {
            return;
        };
        let [least, most] = setting::TUNED_GAIN;
        for index in 0..=flood.severity / 10 {
            let share = f64::from(index % 11) / 10.0;
            daemon.tune(least + share * (most - least));
            // Most find no room.
            daemon.request(PilotRequest::Hold);
        }
        self.operator.was_renewed(self.now_us);
    }

    /// The operator edits the daemon's configuration file and reloads it.
    fn reload(&mut self) -> Result<(), SetupError> {
        self.file = self.file.other();
        let config = setting::config(&self.schedule.situation, self.file)?;
        if let Some(daemon) = &mut self.daemon {
            daemon.reload(self.now_us, &config);
        }
        Ok(())
    }
}
