//! The host: link session and supervisor, and what lies between them in the daemon.

use singletrack_control::Time;
use singletrack_core::pilot_event;
use singletrack_link::{DriveCommand, Event as LinkEvent, JogCommand, Session, SessionConfig};
use singletrack_pilot::{
    BoardRequest, Conditions, Event, ImuVerdict, Jog, LinkState, Mode, PilotRequest, RealTimeState,
    Reason, Supervisor, SupervisorConfig,
};
use singletrack_protocol::{Configuration, ConfigurationError};

/// Speed of a drive, m/s.
const SPEED: f64 = 0.3;

/// Pulses of servo and ESC that an operator gives, in µs.
const JOG: JogCommand = JogCommand {
    servo_us: 1_500,
    esc_us: 1_600,
};

/// Poses beyond which the supervisor does not tell their numbers apart.
const SETTLED_POSES: u32 = 6;

/// Link session and supervisor, with what the pilot would tell the supervisor.
#[derive(Clone, Debug)]
pub(crate) struct Host {
    pub(crate) session: Session,
    pub(crate) supervisor: Supervisor,
    /// Mid-exposure of the last pose.
    pose_time: Option<Time>,
    poses: u32,
    blind_distance: f64,
    imu_time: Option<Time>,
    motor_speed: f64,
    commanded_speed: f64,
    /// The operator holds the drive, or gives pulses, in every tick.
    pub(crate) hand: bool,
    arm_refused: bool,
}

/// What the host perceives of the car in a tick.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Seen {
    /// Whether the cameras see it.
    pub(crate) pose: bool,
    /// Its speed, in m/s.
    pub(crate) speed: f64,
}

impl Host {
    pub(crate) fn new(
        session: SessionConfig,
        supervisor: SupervisorConfig,
        now: Time,
    ) -> Result<Self, ConfigurationError> {
        let mut session = Session::new(session)?;
        session.handle_opened(now.0);
        let mut supervisor = Supervisor::new(supervisor);
        supervisor.handle(&Event::RealTime(RealTimeState {
            fifo: true,
            memory_locked: true,
        }));
        Ok(Self {
            session,
            supervisor,
            pose_time: None,
            poses: 0,
            blind_distance: 0.0,
            imu_time: None,
            motor_speed: 0.0,
            commanded_speed: 0.0,
            hand: false,
            arm_refused: false,
        })
    }

    /// Bytes from the board.
    pub(crate) fn received(&mut self, now: Time, bytes: &[u8]) {
        let mut events = Vec::new();
        self.session
            .handle_bytes(now.0, bytes, &mut |event| events.push(event));
        for event in &events {
            self.handle(event);
        }
    }

    /// The port hangs up, and is opened again.
    pub(crate) fn reopen(&mut self, now: Time) {
        let mut events = Vec::new();
        self.session
            .handle_closed(now.0, &mut |event| events.push(event));
        for event in &events {
            self.handle(event);
        }
        self.supervisor.handle(&Event::Link(LinkState::Down));
        self.session.handle_opened(now.0);
    }

    /// Replaces the board's configuration, unless a drive is underway or asked for.
    pub(crate) fn reconfigure(&mut self, now: Time, configuration: Configuration) {
        if self.supervisor.mode().is_underway() {
            return;
        }
        if self.session.configure(now.0, configuration).is_ok() {
            self.supervisor.handle(&Event::Link(LinkState::Down));
            self.poses = 0;
        }
    }

    /// A control tick: what is to be written goes to `write`.
    pub(crate) fn tick(&mut self, now: Time, seen: Seen, write: &mut impl FnMut(&[u8])) {
        let mut events = Vec::new();
        self.session
            .handle_timeout(now.0, &mut |event| events.push(event));
        for event in &events {
            self.handle(event);
        }
        if core::mem::take(&mut self.arm_refused) {
            self.supervisor.handle(&Event::ArmRefused);
        }
        if self.hand {
            self.supervisor.handle(&Event::Request(PilotRequest::Hold));
            let JogCommand { servo_us, esc_us } = JOG;
            self.supervisor
                .handle(&Event::Jog(Jog { servo_us, esc_us }));
        }
        if seen.pose {
            self.pose_time = Some(now);
            self.poses = (self.poses + 1).min(SETTLED_POSES);
            self.blind_distance = 0.0;
            self.supervisor.handle_pose();
        } else {
            self.blind_distance += 0.01 * seen.speed.max(self.commanded_speed);
        }
        let was = self.supervisor.mode();
        let request = self.supervisor.step(&self.conditions(now, seen));
        let mode = self.supervisor.mode();
        self.command(now, was, mode, write);
        match request {
            Some(BoardRequest::Arm) => self.arm_refused = self.session.arm(now.0).is_err(),
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
    }

    fn command(&mut self, now: Time, was: Mode, mode: Mode, write: &mut impl FnMut(&[u8])) {
        let speed = match mode {
            Mode::Driving => Some(SPEED),
            Mode::Slowing | Mode::Stopping => Some(0.0),
            _ => None,
        };
        self.commanded_speed = speed.unwrap_or(0.0);
        let frame = if let Some(speed_m_s) = speed {
            let command = DriveCommand {
                speed_m_s,
                steering_rad: 0.0,
                brake: false,
                pose_time_ns: self.pose_time.map(|time| time.0),
            };
            self.session.drive(now.0, command).ok()
        } else if mode == Mode::Jogging && was == Mode::Jogging && self.hand {
            self.session.jog(now.0, JOG).ok()
        } else {
            None
        };
        if let Some(frame) = frame {
            write(frame.as_bytes());
        }
    }

    fn conditions(&self, now: Time, seen: Seen) -> Conditions {
        let stands = seen.speed == 0.0;
        Conditions {
            now,
            pose_time: self.pose_time,
            blind_distance: self.blind_distance,
            poses: self.poses,
            implausible: 0,
            imu_time: self.imu_time,
            imu: ImuVerdict::Good,
            imu_still: stands,
            speed: seen.speed,
            motor_speed: self.motor_speed,
            camera_speed: seen.pose.then_some(seen.speed),
            stands: stands && self.motor_speed == 0.0,
            preflight: None,
            doubt: None,
            implausible_motion: None,
            contradiction: None,
            speed_mismatch: false,
            overspeed: false,
            commanded_speed: self.commanded_speed,
            filter: None,
            inside_fence: true,
            neighbours: None,
            late: false,
            setpoint_stale: false,
            reference_finished: false,
        }
    }

    /// Passes an event of the link to the supervisor, as the pilot does.
    fn handle(&mut self, event: &LinkEvent) {
        match pilot_event(event) {
            Some(Event::Board(sample)) => {
                if let Some(inertial) = sample.inertial {
                    self.imu_time = Some(inertial.time);
                }
                self.motor_speed = sample.motor_speed;
                self.supervisor.handle_board(sample.state);
            }
            Some(Event::ArmRefused) => self.arm_refused = true,
            Some(event) => self.supervisor.handle(&event),
            None => {}
        }
    }

    /// Why the car does not drive.
    pub(crate) const fn reason(&self) -> Option<Reason> {
        self.supervisor.reason()
    }
}
