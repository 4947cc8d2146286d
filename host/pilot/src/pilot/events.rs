//! Handles the events of a tick.

use singletrack_control::{External, PoseSample, PoseVerdict, Reference, SetpointError, Time};

use super::{Begins, Pilot};
use crate::{
    event::{Arming, BoardSample, Event, PilotRequest},
    refusal::SetpointRefusal,
};

impl Pilot {
    /// Handles an event; the verdict if it is a pose.
    pub(super) fn handle(&mut self, now: Time, event: &Event) -> Option<PoseVerdict> {
        match event {
            Event::Pose(pose) => return Some(self.handle_pose(pose)),
            Event::PoseMissing(missing) => self.supervisor.handle_pose_missing(*missing),
            Event::Neighbour(sample) => self.obstacles.handle(sample),
            Event::Board(sample) => self.handle_board(sample),
            Event::Link(link) => self.supervisor.handle_link(*link),
            Event::Request(request) => self.handle_request(*request),
            Event::ArmRefused => self.supervisor.handle_arm_refused(),
            Event::Health(health) => self.supervisor.handle_health(*health),
            Event::Line(line) => self.supervisor.handle_line(*line),
            Event::RealTime(state) => self.supervisor.handle_real_time(*state),
            Event::Setpoint(setpoint) => {
                self.handle_setpoint(|external| external.handle(setpoint, now));
            }
            Event::TrajectoryPiece(piece) => {
                self.handle_setpoint(|external| external.handle_piece(piece, now));
            }
            Event::Jog(jog) => {
                self.supervisor.handle_jog();
                self.jog = Some(*jog);
            }
            Event::Attitude(sample) => self.watches.attitude.handle(sample, &self.config.watch),
            Event::Proved(proved) => self.proved = *proved,
            Event::Tuning(tuning) => self.tune(tuning),
            Event::Begin(time) => {
                self.supervisor.handle_begin();
                self.begins = Begins::At(*time);
            }
            Event::Learned(learned) => {
                if let Some(learning) = &mut self.learning {
                    learning.learned(now, *learned);
                }
            }
            // The caller has called `reconfigure` before this tick.
            Event::Reconfigured(_) => {}
        }
        None
    }

    /// A lost car is taken up elsewhere by the operator's word alone: a program that ends disarms as
    /// well.
    fn handle_request(&mut self, request: PilotRequest) {
        self.supervisor.handle_request(request);
        match request {
            // One that comes in a drive is without effect: a car that waits goes on to wait.
            _ if self.supervisor.mode().is_underway() => {}
            PilotRequest::Arm(Arming::Waiting) => self.begins = Begins::Later,
            PilotRequest::Arm(_) => self.begins = Begins::AtOnce,
            _ => {}
        }
        if request == PilotRequest::Carried && !self.supervisor.mode().commands() {
            self.carried();
        }
    }

    /// Gives the reference a set-point. Without one that it does not refuse, it becomes stale.
    fn handle_setpoint(&mut self, give: impl FnOnce(&mut External) -> Result<(), SetpointError>) {
        let refused = match &mut self.config.reference {
            Reference::External(external) => give(external).err().map(SetpointRefusal::from),
            _ => Some(SetpointRefusal::NotExternal),
        };
        self.setpoint_refused = refused.or(self.setpoint_refused);
    }

    fn handle_pose(&mut self, pose: &PoseSample) -> PoseVerdict {
        self.watches.observe_pose(pose, &self.config);
        let verdict = self.estimator.handle_pose(pose);
        if verdict == PoseVerdict::Accepted {
            self.pose_time = Some(pose.capture);
            self.supervisor.handle_pose();
            let mode = self.supervisor.mode();
            self.watches
                .observe_accepted(pose, &self.estimator, mode, &self.config);
        }
        verdict
    }

    fn handle_board(&mut self, sample: &BoardSample) {
        self.supervisor.handle_board(sample.state);
        self.motor_speed = sample.motor_speed;
        // A board without its configuration does not know how far a pulse is: it says 0 whatever
        // the wheels do.
        let measures = self.supervisor.is_linked();
        self.motor_time = measures.then_some(sample.time);
        let mode = self.supervisor.mode();
        if let Some(inertial) = sample.inertial {
            self.imu_heard = Some(inertial.time);
        }
        if let Some(inertial) = self.watches.observe_board(sample, mode, &self.config) {
            self.imu_time = Some(inertial.time);
            let motor_speed = measures.then_some(sample.motor_speed);
            self.estimator.handle_inertial(inertial, motor_speed);
        }
    }
}
