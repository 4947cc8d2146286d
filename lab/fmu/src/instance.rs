//! An instance of a unit: its values, and what it simulates.

use singletrack_api::Setpoint;
use singletrack_core::config::ReferenceSection;
use singletrack_scenario::laboratory::{Laboratory, Setup, SetupError};
use singletrack_sim::{Car, SERVO_FRAME_US, StartPose};

use crate::variables::{Role, Seen, Unit, Value, Variable};

use Value::{Count, Number, Text};

/// The status of a call, with the numbers of FMI.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub(crate) enum Status {
    Ok,
    /// Nothing has changed; a call with other values can follow.
    Discard = 2,
    /// The instance can be reset or freed.
    Error,
    /// The instance can be freed.
    Fatal,
}

/// Why a call was not obeyed.
#[derive(Debug)]
pub(crate) struct Failure(pub(crate) Status, pub(crate) String);

impl From<SetupError> for Failure {
    fn from(error: SetupError) -> Self {
        Self(Status::Error, error.to_string())
    }
}

/// Returns a failure with a status and a text.
macro_rules! fail {
    ($status:ident, $($text:tt)+) => {
        return Err($crate::instance::Failure($crate::instance::Status::$status, format!($($text)+)))
    };
}
pub(crate) use fail;

enum Simulated {
    Car(Box<Car>),
    /// The whole system, and when its drive began, in µs of its simulation.
    System(Box<Laboratory>, u64),
}

/// The longest step, in s.
const LONGEST_STEP: f64 = 10.0;

/// An instance of a unit.
pub(crate) struct Instance {
    unit: Unit,
    values: Vec<Value>,
    /// None before the first step or output.
    simulated: Option<Simulated>,
    /// Distances of the front axle and of P in the configuration, in m.
    distances: [f64; 2],
    /// The importer's time at the start of the simulation, in s.
    start: f64,
    now_us: u64,
}

impl Instance {
    pub(crate) fn new(unit: Unit) -> Self {
        Self {
            unit,
            values: unit.variables().map(|it| it.2.clone()).collect(),
            simulated: None,
            distances: [0.0; 2],
            start: 0.0,
            now_us: 0,
        }
    }

    pub(crate) fn reset(&mut self) {
        *self = Self::new(self.unit);
    }

    pub(crate) fn start(&mut self, time: f64) {
        self.start = time;
        self.values[0] = Number(time);
    }

    /// Sets the simulation up, unless it is.
    pub(crate) fn set_up(&mut self) -> Result<(), Failure> {
        if self.simulated.is_some() {
            return Ok(());
        }
        let [
            _,
            Text(configuration),
            Text(truth),
            Number(x_m),
            Number(y_m),
            Number(yaw_rad),
            _,
            _,
            seed,
            ..,
        ] = &self.values[..]
        else {
            fail!(Fatal, "the variables are not those of this version");
        };
        let external = ReferenceSection::External {
            setpoint_timeout_ms: 200,
        };
        let [configuration, truth] = [configuration, truth].map(|text| text.to_string_lossy());
        let setup = Setup::new(external, &configuration, &truth)?;
        let law = &setup.config.law;
        self.distances = [law.front_axle_distance_m, law.point_distance_m];
        let seed = if let Count(seed) = *seed { seed } else { 0 };
        let [x_m, y_m, yaw_rad] = [*x_m, *y_m, *yaw_rad];
        let simulation = setup.simulation(seed, StartPose { x_m, y_m, yaw_rad }, &[])?;
        self.simulated = Some(match self.unit {
            Unit::Car => Simulated::Car(Box::new(Car::new(simulation.car))),
            Unit::System => {
                let laboratory = Laboratory::new(setup.config, seed, simulation);
                let mut laboratory = Box::new(laboratory.map_err(SetupError::new)?);
                laboratory.start().map_err(SetupError::new)?;
                let start_us = laboratory.drive.now_us();
                Simulated::System(laboratory, start_us)
            }
        });
        self.read();
        Ok(())
    }

    /// Reads the outputs of the simulation.
    fn read(&mut self) {
        let (truth, tick) = match &self.simulated {
            Some(Simulated::Car(car)) => (car.truth(), None),
            Some(Simulated::System(laboratory, _)) => {
                (laboratory.drive.world.truth(), laboratory.last())
            }
            None => return,
        };
        let [front, point] = self.distances;
        let seen = Seen {
            truth,
            point: truth.point_p(front, point),
            tick: tick.map(|last| &last.tick.output),
        };
        for (value, variable) in self.values.iter_mut().zip(self.unit.variables()) {
            if let Role::Output(read) = &variable.1 {
                *value = read(&seen);
            }
        }
    }

    pub(crate) fn variable(&self, reference: u32) -> Result<&'static Variable, Failure> {
        match self.unit.variables().nth(reference as usize) {
            Some(variable) => Ok(variable),
            None => fail!(Error, "no variable {reference}: see modelDescription.xml"),
        }
    }

    pub(crate) fn get(&mut self, reference: u32) -> Result<&Value, Failure> {
        if let Role::Output(_) = self.variable(reference)?.1 {
            self.set_up()?;
        }
        Ok(&self.values[reference as usize])
    }

    /// Sets an input, or a parameter before the first step.
    pub(crate) fn set(&mut self, reference: u32, value: Value) -> Result<(), Failure> {
        let Variable(name, role, old, unit, ..) = self.variable(reference)?;
        let (kind, given) = (old.kind(), value.kind());
        if kind != given {
            fail!(
                Error,
                "{name} is a {kind}: call fmi3Set{kind}, not fmi3Set{given}"
            );
        }
        match (role, &value) {
            (Role::Input(range), Number(number)) if !range.contains(number) => {
                let (least, most) = range.clone().into_inner();
                fail!(Discard, "{name} is {number}: give {least} to {most} {unit}");
            }
            (Role::Parameter, Number(number)) if !number.is_finite() => {
                fail!(Discard, "{name} is {number}: give a finite number");
            }
            (Role::Parameter, _) if self.now_us > 0 => {
                fail!(
                    Error,
                    "{name} is a parameter: set it before the first step, or after a reset"
                );
            }
            (Role::Parameter, _) => self.simulated = None,
            (Role::Input(_), _) => {}
            (Role::Time | Role::Output(_), _) => {
                fail!(Error, "{name} is an output: it can't be set")
            }
        }
        self.values[reference as usize] = value;
        Ok(())
    }

    /// Simulates a step from a time on, both in s.
    pub(crate) fn step(&mut self, time: f64, step: f64) -> Result<(), Failure> {
        let now = self.start + self.now_us as f64 * 1e-6;
        if !(-1e-6..=1e-6).contains(&(time - now)) {
            fail!(
                Discard,
                "the step begins at {time} s: begin at {now} s, where the simulation is"
            );
        }
        if !(1e-6..=LONGEST_STEP).contains(&step) {
            fail!(
                Discard,
                "the step is {step} s: give 1e-6 to {LONGEST_STEP} s"
            );
        }
        self.set_up()?;
        let until_us = ((time + step - self.start) * 1e6).round() as u64;
        if let [_, _, _, _, _, _, Number(first), Number(second), ..] = self.values[..] {
            self.advance([first, second], until_us)?;
        }
        self.now_us = until_us;
        self.values[0] = Number(time + step);
        self.read();
        Ok(())
    }

    /// Goes on to a time in µs with these inputs.
    fn advance(&mut self, inputs: [f64; 2], until_us: u64) -> Result<(), SetupError> {
        match &mut self.simulated {
            Some(Simulated::Car(car)) => {
                while self.now_us < until_us {
                    if self.now_us.is_multiple_of(SERVO_FRAME_US) {
                        let [servo_us, esc_us] = inputs.map(|pulse_us| pulse_us.round() as u16);
                        car.apply_pulses(servo_us, esc_us);
                    }
                    let frame_us = (self.now_us / SERVO_FRAME_US + 1) * SERVO_FRAME_US;
                    self.now_us = until_us.min(frame_us);
                    car.advance_to(self.now_us);
                }
            }
            Some(Simulated::System(laboratory, start_us)) => {
                while !laboratory.drive.advance_to(*start_us + until_us) {
                    if laboratory.is_external() {
                        let velocity = Setpoint {
                            velocity_m_s: Some(inputs),
                            ..Setpoint::default()
                        };
                        let given = laboratory.setpoint(velocity);
                        given.map_err(|refused| SetupError::new(refused.text))?;
                    }
                    laboratory.step().map_err(SetupError::new)?;
                }
            }
            None => {}
        }
        Ok(())
    }
}
