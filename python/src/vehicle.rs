//! The two simulated cars of the environments: the car alone, and the whole system.

use singletrack_board::Actuators;
use singletrack_control::{
    Actuation, LimitedLaw, Motion, Setpoint, SpeedDemand, SteeringDemand, SteeringMap, Velocity,
};
use singletrack_core::config::ReferenceSection;
use singletrack_pilot::Mode;
use singletrack_scenario::{
    laboratory::{Setup, SetupError},
    virtual_drive::{VirtualDrive, VirtualTick},
};
use singletrack_sim::{Car, SERVO_FRAME_US, SimulationConfig, Truth};

/// A period of the controller, in µs.
pub(crate) const PERIOD_US: u64 = 10_000;
const PERIOD_S: f64 = 0.01;

/// The longest time until the ESC of a car alone is armed, in µs.
const ARMING_US: u64 = 1_000_000;

/// A command for one period.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Command {
    /// Steering angle (rad) and speed (m/s).
    Actuate([f64; 2]),
    /// Velocity of P in the world, in m/s.
    PointVelocity([f64; 2]),
}

/// A simulated car under commands.
pub(crate) trait Vehicle: Send {
    /// What the controller knows of the car: its motion alone.
    fn seen(&self) -> Truth {
        self.truth()
    }

    /// The ground truth.
    fn truth(&self) -> Truth;

    /// Drives for one period. Returns whether the car is still driven.
    fn step(&mut self, command: Command) -> bool;

    /// Why the drive has ended, if it has.
    fn reason(&self) -> &'static str {
        ""
    }
}

/// The simulated car with the board's own servo and ESC control. There is no link, camera,
/// estimator or supervisor, and the state is known.
#[derive(Debug)]
pub(crate) struct Plant {
    car: Car,
    /// State of the car, now.
    truth: Truth,
    steering: SteeringMap,
    actuators: Actuators,
    law: LimitedLaw,
    now_us: u64,
    next_frame_us: u64,
}

impl Plant {
    pub(crate) fn new(setup: &Setup, simulation: &SimulationConfig) -> Result<Self, SetupError> {
        let config = &setup.config;
        let mut parameters = simulation.car.clone();
        // The episode begins with an ESC that is ready.
        parameters.motor.arming_us = parameters.motor.arming_us.min(SERVO_FRAME_US);
        let law = config
            .law
            .front_point_law(&config.vehicle)
            .map_err(SetupError::new)?;
        let car = Car::new(parameters);
        let mut plant = Self {
            truth: car.truth(),
            car,
            steering: config.steering_map().map_err(SetupError::new)?,
            actuators: Actuators::new(config.board_configuration()),
            law: LimitedLaw::new(law, config.limits.limits(config.vehicle.wheelbase_m())),
            now_us: 0,
            next_frame_us: 0,
        };
        while !plant.car.esc_is_armed() && plant.now_us < ARMING_US {
            plant.advance();
        }
        plant.car.place(simulation.car.start);
        plant.truth = plant.car.truth();
        Ok(plant)
    }

    /// The command within the limits of the pilot.
    fn actuation(&mut self, command: Command, truth: &Truth) -> Actuation {
        let actuation = match command {
            Command::Actuate([steering, speed]) => self.law.follow(
                SteeringDemand::Angle(steering),
                SpeedDemand::Speed(speed),
                PERIOD_S,
            ),
            Command::PointVelocity([x, y]) => {
                let motion = Motion {
                    yaw: truth.yaw,
                    yaw_rate: truth.yaw_rate,
                    sideslip: truth.sideslip,
                };
                let wanted = Velocity::new(x, y);
                self.law.step(&motion, truth.speed, &wanted, PERIOD_S)
            }
        };
        actuation.unwrap_or_else(|_| self.law.actuation())
    }

    fn advance(&mut self) {
        if self.now_us >= self.next_frame_us {
            let [servo_us, esc_us] = self.actuators.pulses_us();
            self.car.apply_pulses(servo_us, esc_us);
            self.next_frame_us += SERVO_FRAME_US;
        }
        self.now_us += PERIOD_US;
        self.car.advance_to(self.now_us);
    }
}

impl Vehicle for Plant {
    fn truth(&self) -> Truth {
        self.truth
    }

    fn step(&mut self, command: Command) -> bool {
        let truth = self.truth;
        let Actuation {
            speed, steering, ..
        } = self.actuation(command, &truth);
        // The speed is that of the rear axle, as in the pilot.
        let rear_speed = speed * libm::cos(truth.sideslip);
        let steering = self.steering.commanded(steering);
        self.actuators
            .drive((rear_speed * 1e3) as i16, (steering * 1e4) as i16);
        self.actuators
            .control(PERIOD_US as u32, (truth.wheel_speed.abs() * 1e3) as i16);
        self.advance();
        self.truth = self.car.truth();
        true
    }
}

/// The host and the simulated world, in virtual time.
#[derive(Debug)]
pub(crate) struct System {
    pub(crate) drive: VirtualDrive,
    pub(crate) last: VirtualTick,
}

impl System {
    /// Goes on to the first driving tick.
    pub(crate) fn new(
        setup: &Setup,
        simulation: SimulationConfig,
        seed: u64,
    ) -> Result<Self, SetupError> {
        let mut config = setup.config.clone();
        config.reference = ReferenceSection::External {
            setpoint_timeout_ms: 200,
        };
        let mut drive = VirtualDrive::new(config, seed, simulation).map_err(SetupError::new)?;
        let last = drive.start().map_err(SetupError::new)?;
        Ok(Self { drive, last })
    }
}

impl Vehicle for System {
    fn seen(&self) -> Truth {
        let output = &self.last.tick.output;
        output
            .estimate
            .map_or_else(Truth::default, |estimate| Truth {
                x: estimate.position.x,
                y: estimate.position.y,
                yaw: estimate.yaw,
                yaw_rate: estimate.yaw_rate,
                sideslip: estimate.sideslip,
                speed: estimate.speed,
                steering: output.actuation.steering,
                ..Truth::default()
            })
    }

    fn truth(&self) -> Truth {
        self.drive.world.truth()
    }

    fn step(&mut self, command: Command) -> bool {
        let now = self.last.now;
        self.drive.send_setpoint(&match command {
            Command::PointVelocity([x, y]) => Setpoint::point(now, None, Velocity::new(x, y)),
            Command::Actuate([steering, speed]) => Setpoint::actuation(
                now,
                SteeringDemand::Angle(steering),
                SpeedDemand::Speed(speed),
            ),
        });
        self.last = self.drive.step();
        self.last.tick.output.mode == Mode::Driving
    }

    fn reason(&self) -> &'static str {
        let output = &self.last.tick.output;
        let reason = output.reason.filter(|_| output.mode != Mode::Driving);
        reason.map_or("", |reason| reason.name())
    }
}
