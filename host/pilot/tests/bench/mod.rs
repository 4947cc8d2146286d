//! An ideal car that follows every command exactly, and its pilot.

#![allow(dead_code, reason = "each test file uses its own part")]
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use singletrack_control::{
    EstimatorConfig, FrontPointLaw, InertialSample, Limits, PoseSample, Position, ProportionalLoop,
    Reference, Start, Time, TrackingLoop, VehicleParameters, Velocity, VelocityStep, VelocitySteps,
    direction,
};
use singletrack_pilot::{
    Arming, BoardHealth, BoardRequest, BoardSample, BoardState, Compensation, Event, Fence,
    LinkState, Mode, Output, Pilot, PilotConfig, PilotRequest, PoseMissing, RealTimeState,
    SupervisorConfig, WatchConfig,
};

pub(crate) const TICK_NS: u64 = 10_000_000;

/// The events before the first drive.
pub(crate) const AT_START: [Event; 3] = [
    Event::RealTime(RealTimeState {
        fifo: false,
        memory_locked: false,
    }),
    Event::Link(LinkState::Ready),
    Event::Health(BoardHealth {
        battery_mv: 7_400,
        stop_input_open: false,
        battery_open: false,
        imu_fault: false,
    }),
];

/// A kinematic car with perfect sensors, and its pilot.
pub(crate) struct Bench {
    pub(crate) pilot: Pilot,
    pub(crate) tick: u64,
    pub(crate) position: Position,
    pub(crate) yaw: f64,
    pub(crate) speed: f64,
    /// At the tick before.
    pub(crate) speed_before: f64,
    pub(crate) steering: f64,
    pub(crate) board: BoardState,
    pub(crate) link: bool,
    pub(crate) imu: bool,
    pub(crate) pose: Pose,
    /// Counted pulses per true pulse.
    pub(crate) pulses: f64,
    pub(crate) gyro_bias: f64,
    /// What the gyro measures of a turn: -1 if it is mounted upside down.
    pub(crate) gyro_gain: f64,
    pub(crate) noisy: bool,
    /// The yaw rate at which the IMU hangs.
    pub(crate) stuck: Option<f64>,
    /// Whether the board sends its status message, five times a second.
    pub(crate) sends_health: bool,
    /// Events of the next tick.
    pub(crate) extra: Vec<Event>,
}

#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Pose {
    Seen,
    Missing,
    Jumped,
}

/// A geofence that is a square with sides of `width` (m).
pub(crate) fn square(centre: Position, width: f64, margin: f64) -> Fence {
    let corners = [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)];
    let corners = corners.map(|(x, y)| centre + width * Velocity::new(x, y));
    Fence::new(&corners, margin).unwrap()
}

pub(crate) fn config() -> PilotConfig {
    let vehicle = VehicleParameters::paper();
    PilotConfig {
        law: FrontPointLaw::new(vehicle.front_axle_distance_m, 0.35, vehicle.wheelbase_m())
            .unwrap(),
        tracking: TrackingLoop::Proportional(ProportionalLoop {
            gain: Velocity::new(1.0, 1.0),
            feed_forward: true,
        }),
        reference: Reference::VelocitySteps(
            VelocitySteps::new(&[VelocityStep {
                duration: 5.0,
                velocity: Velocity::new(0.5, 0.1),
            }])
            .unwrap(),
        ),
        start: Start::Beginning,
        governor: None,
        limits: Limits::paper(),
        estimator: EstimatorConfig::for_vehicle(&vehicle),
        // The bench's accelerometer measures no start: it is no car to prove.
        supervisor: SupervisorConfig {
            prove: false,
            ..SupervisorConfig::paper()
        },
        watch: WatchConfig::paper(),
        fence: square(Position::origin(), 20.0, 0.0),
        braking: 1.5,
        stop_deceleration: 1.5,
        compensation: Compensation {
            clock: false,
            actuation: None,
            vehicle,
        },
        safety: None,
        neighbours: None,
        tuning: None,
        learns: false,
        period: 0.01,
    }
}

impl Bench {
    pub(crate) fn new() -> Self {
        Self::with(config())
    }

    pub(crate) fn with(config: PilotConfig) -> Self {
        Self {
            pilot: Pilot::new(config),
            tick: 1000,
            position: Position::origin(),
            yaw: 0.0,
            speed: 0.0,
            speed_before: 0.0,
            steering: 0.0,
            board: BoardState::Neutral,
            link: true,
            imu: true,
            pose: Pose::Seen,
            pulses: 1.0,
            gyro_bias: 0.0,
            gyro_gain: 1.0,
            noisy: true,
            stuck: None,
            sends_health: true,
            extra: Vec::new(),
        }
    }

    pub(crate) fn now(&self) -> Time {
        Time(self.tick * TICK_NS)
    }

    pub(crate) fn step_with(&mut self, request: Option<PilotRequest>) -> Output {
        self.tick += 1;
        let wheelbase = VehicleParameters::paper().wheelbase_m();
        let yaw_rate = self.speed * self.steering.tan() / wheelbase;
        let sideslip = (0.1232 / wheelbase * self.steering.tan()).atan();
        self.yaw += yaw_rate * 0.01;
        self.position += self.speed * 0.01 * direction(self.yaw + sideslip);

        let now = self.now();
        let mut events = Vec::new();
        if self.tick == 1001 {
            events.extend(AT_START);
        }
        // A working sensor has noise.
        let noise = if self.tick.is_multiple_of(2) {
            1e-3
        } else {
            -1e-3
        };
        if self.link && self.sends_health && self.tick.is_multiple_of(20) {
            events.push(AT_START[2]);
        }
        if self.link {
            events.push(Event::Board(BoardSample {
                time: now,
                inertial: self.imu.then_some(InertialSample {
                    time: now,
                    yaw_rate: self
                        .stuck
                        .unwrap_or(self.gyro_gain * yaw_rate + noise + self.gyro_bias),
                    forward_acceleration: match self.stuck {
                        Some(_) => 0.0,
                        None => (self.speed - self.speed_before) / 0.01,
                    },
                    left_acceleration: self.stuck.unwrap_or(self.speed * yaw_rate),
                }),
                motor_speed: self.pulses * self.speed,
                state: self.board,
            }));
        }
        events.push(match self.pose {
            Pose::Seen | Pose::Jumped => Event::Pose(PoseSample {
                capture: now,
                receive: now,
                frame: i32::try_from(self.tick).unwrap(),
                position: if self.pose == Pose::Jumped {
                    self.position + Velocity::new(0.5, 0.0)
                } else {
                    self.position
                },
                // Cameras have noise too. It is too small to change a figure.
                yaw: self.yaw + 1e-6 * noise,
            }),
            Pose::Missing => Event::PoseMissing(PoseMissing::Untracked),
        });
        events.extend(request.map(Event::Request));
        events.append(&mut self.extra);
        let output = self.pilot.step(now, &events);
        self.speed_before = self.speed;
        if let Some(command) = output.command {
            self.speed = command.rear_speed;
            self.steering = command.steering;
            self.board = BoardState::Driving;
        }
        match output.request {
            Some(BoardRequest::Arm) => self.board = BoardState::Armed,
            Some(BoardRequest::Disarm) => {
                self.board = BoardState::Neutral;
                self.speed = 0.0;
            }
            Some(BoardRequest::EmergencyStop) => {
                self.board = BoardState::EmergencyStopped;
                self.speed = 0.0;
            }
            None => {}
        }
        output
    }

    pub(crate) fn step(&mut self) -> Output {
        self.step_with(None)
    }

    pub(crate) fn run(&mut self, ticks: u32) -> Output {
        for _ in 1..ticks {
            self.step();
        }
        self.step()
    }

    pub(crate) fn drive(&mut self) {
        assert_eq!(self.run(100).mode, Mode::Ready);
        self.step_with(Some(PilotRequest::Arm(Arming::Unattended)));
        let output = self.run(3);
        assert_eq!(output.mode, Mode::Driving, "{:?}", output.reason);
        self.run(100);
        assert!(self.speed > 0.3);
    }

    /// Runs until the pilot sends no more commands. Returns the last output, and the time
    /// until the car stood, in s.
    pub(crate) fn run_until_idle(&mut self) -> (Output, f64) {
        let mut stood = None;
        for tick in 0..1_000 {
            let output = self.step();
            if self.speed == 0.0 && stood.is_none() {
                stood = Some(f64::from(tick) * 0.01);
            }
            if !output.mode.commands() {
                return (output, stood.unwrap_or(f64::INFINITY));
            }
        }
        panic!("never stopped");
    }
}
