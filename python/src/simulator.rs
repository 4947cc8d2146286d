//! The whole system in virtual time: the native half of `singletrack.Simulator`.

use std::{
    path::PathBuf,
    sync::{Mutex, MutexGuard},
};

use pyo3::{
    exceptions::{PyOSError, PyValueError},
    prelude::*,
    types::PyDict,
};
use singletrack_control::{
    Demand, MAX_TRAJECTORY_POINTS, Position, ReferencePoint, Setpoint, SetpointError,
    SetpointStamp, SpeedDemand, SteeringDemand, Time, Trajectory, TrajectoryPoint, Velocity,
};
use singletrack_core::config::ReferenceSection;
use singletrack_pilot::{Event, PilotRequest, Tuning};
use singletrack_scenario::{
    virtual_drive::{VirtualDrive, VirtualTick},
    virtual_record::VirtualRecord,
};
use singletrack_sim::{
    ImuFault, LossKind, LossPattern, LossWindow, MotorSensorFault, StartPose, TRUTH_KEYS,
    parse_duration_us,
};

use crate::{
    argument::{choice, fail, refuse},
    setup::{Setup, in_hall, reference},
};

/// Ticks after which a record is written to its file.
const TICKS_PER_WRITE: u32 = 100;

/// Ticks after which a signal of the program is seen.
const TICKS_PER_CHECK: usize = 1_000;

/// A host, a board, cameras and a car in virtual time.
#[pyclass(frozen, module = "singletrack._native")]
pub(crate) struct Simulator(Mutex<Simulation>);

struct Simulation {
    setup: Setup,
    drive: VirtualDrive,
    last: Option<VirtualTick>,
    /// The time of the first tick.
    first_ns: Option<u64>,
    /// The time of the newest telemetry.
    board_ns: Option<u64>,
    record: Option<VirtualRecord>,
    unwritten: u32,
}

#[pymethods]
impl Simulator {
    #[new]
    #[pyo3(signature = (*, seed, start, point, configuration, truth, reference_toml, record))]
    fn new(
        seed: u64,
        start: [f64; 3],
        point: bool,
        configuration: &str,
        truth: &str,
        reference_toml: Option<&str>,
        record: Option<PathBuf>,
    ) -> PyResult<Self> {
        let section = match reference_toml {
            Some(text) => reference(text).map_err(refuse)?,
            None => ReferenceSection::External {
                setpoint_timeout_ms: 200,
            },
        };
        let setup = Setup::new(section, configuration, truth).map_err(refuse)?;
        let [x_m, y_m, yaw_rad] = start;
        let start = if point {
            setup.start([x_m, y_m], yaw_rad)
        } else {
            StartPose { x_m, y_m, yaw_rad }
        };
        let simulation = setup.simulation(seed, start, &[]).map_err(refuse)?;
        let mut drive =
            VirtualDrive::new(setup.config.clone(), seed, simulation).map_err(refuse)?;
        let record = record
            .map(|path| VirtualRecord::start(&path, &mut drive, &setup.config, seed))
            .transpose()
            .map_err(|error| PyOSError::new_err(error.to_string()))?;
        Ok(Self(Mutex::new(Simulation {
            setup,
            drive,
            last: None,
            first_ns: None,
            board_ns: None,
            record,
            unwritten: 0,
        })))
    }

    /// Runs ticks of 10 ms.
    #[pyo3(signature = (count = 1))]
    fn step(&self, py: Python<'_>, count: u32) -> PyResult<()> {
        for begun in (0..count).step_by(TICKS_PER_CHECK) {
            py.detach(|| {
                let mut simulation = self.simulation()?;
                let ticks = (count - begun).min(TICKS_PER_CHECK as u32);
                (0..ticks).try_for_each(|_| simulation.step())
            })?;
            // For Ctrl-C.
            py.check_signals()?;
        }
        Ok(())
    }

    /// What the last tick saw and did; `None` before the first.
    fn state<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyDict>>> {
        let simulation = self.simulation()?;
        let Some(VirtualTick { now, tick, .. }) = &simulation.last else {
            return Ok(None);
        };
        let output = &tick.output;
        let state = PyDict::new(py);
        state.set_item("time_ns", now.0)?;
        let first_ns = simulation.first_ns.unwrap_or(now.0);
        state.set_item("t", (now.0 - first_ns) as f64 * 1e-9)?;
        state.set_item("mode", output.mode.name())?;
        state.set_item("reason", output.reason.map(singletrack_pilot::Reason::name))?;
        state.set_item(
            "preflight",
            output.preflight.map(singletrack_pilot::Reason::name),
        )?;
        state.set_item("drive_time", output.drive_time)?;
        state.set_item("held", output.held)?;
        if let Some(estimate) = &output.estimate {
            state.set_item("x", estimate.position.x)?;
            state.set_item("y", estimate.position.y)?;
            state.set_item("yaw", estimate.yaw)?;
            state.set_item("speed", estimate.speed)?;
            state.set_item("sideslip", estimate.sideslip)?;
            state.set_item("yaw_rate", estimate.yaw_rate)?;
            let age = now.0.saturating_sub(estimate.pose_time.0);
            state.set_item("pose_age", age as f64 * 1e-9)?;
        }
        state.set_item("steering", output.actuation.steering)?;
        state.set_item("commanded_speed", output.actuation.speed)?;
        state.set_item("tick", tick.index)?;
        if let Some(board_ns) = simulation.board_ns {
            let age = now.0.saturating_sub(board_ns);
            state.set_item("board_age", age as f64 * 1e-9)?;
        }
        state.set_item("filtering", output.filtering.name())?;
        if let Some(tuned) = &output.tuned {
            state.set_item("gain", tuned.gain.map(|gain| (gain.x, gain.y)))?;
            state.set_item("point_distance", tuned.point_distance)?;
        }
        if let Some(stamp) = &output.setpoint {
            state.set_item("sequence", stamp.sequence)?;
            let age = now.0.saturating_sub(stamp.time.0);
            state.set_item("setpoint_age", age as f64 * 1e-9)?;
        }
        state.set_item("point", output.point.map(|point| (point.x, point.y)))?;
        state.set_item(
            "point_velocity",
            output
                .point_velocity
                .map(|velocity| (velocity.x, velocity.y)),
        )?;
        if let Some(reference) = &output.reference {
            state.set_item(
                "reference",
                reference.position.map(|position| (position.x, position.y)),
            )?;
            state.set_item(
                "reference_velocity",
                (reference.velocity.x, reference.velocity.y),
            )?;
        }
        Ok(Some(state))
    }

    /// The mode after the last tick.
    #[getter]
    fn mode(&self) -> PyResult<&'static str> {
        Ok(self.simulation()?.drive.mode().name())
    }

    /// The present, in s of virtual time.
    #[getter]
    fn now(&self) -> PyResult<f64> {
        let simulation = self.simulation()?;
        let last = simulation.last.as_ref();
        Ok(last.map_or(0.0, |tick| tick.now.0 as f64 * 1e-9))
    }

    /// Requests something of the pilot, with the next tick.
    fn request(&self, request: &str) -> PyResult<()> {
        let request = match request {
            "arm" => PilotRequest::Arm,
            "disarm" => PilotRequest::Disarm,
            "stop" => PilotRequest::EmergencyStop,
            "halt" => PilotRequest::Halt,
            "carried" => PilotRequest::Carried,
            other => return Err(refuse(format!("unknown request {other:?}"))),
        };
        self.simulation()?.drive.request(request).map_err(fail)
    }

    /// Puts another reference in force.
    fn set_reference(&self, py: Python<'_>, toml: &str) -> PyResult<u32> {
        let section = reference(toml).map_err(refuse)?;
        py.detach(|| {
            let mut simulation = self.simulation()?;
            let mut config = simulation.setup.config.clone();
            config.reference = section;
            let number = simulation
                .drive
                .reconfigure(config.clone())
                .map_err(refuse)?;
            simulation.setup.config = config;
            Ok(number)
        })
    }

    /// Tunes the pilot, with the next tick.
    #[pyo3(signature = (gain_per_s, point_distance_m))]
    fn tune(&self, gain_per_s: Option<[f64; 2]>, point_distance_m: Option<f64>) -> PyResult<()> {
        let tuning = Tuning {
            gain: gain_per_s.map(|[x, y]| Velocity::new(x, y)),
            point_distance: point_distance_m,
        };
        self.simulation()?.drive.tune(tuning).map_err(refuse)
    }

    /// Whether the reference is that of a controller outside.
    #[getter]
    fn is_external(&self) -> PyResult<bool> {
        Ok(matches!(
            self.simulation()?.setup.config.reference,
            ReferenceSection::External { .. }
        ))
    }

    /// Sends a velocity of P, in m/s, with a position in m or without, decided after the last
    /// tick. A set-point that is not obeyed is refused with the reason.
    #[pyo3(signature = (velocity, position, sequence))]
    fn point_velocity(
        &self,
        velocity: [f64; 2],
        position: Option<[f64; 2]>,
        sequence: Option<u32>,
    ) -> PyResult<()> {
        let [v_x, v_y] = velocity;
        let demand = Demand::Point(ReferencePoint {
            position: position.map(|[x, y]| Position::new(x, y)),
            velocity: Velocity::new(v_x, v_y),
        });
        self.simulation()?.send(demand, sequence)
    }

    /// Sends steering, an angle or a rate, and speed, itself or its change, decided after the
    /// last tick.
    #[pyo3(signature = (steering_rad, steering_rate_rad_s, speed_m_s, acceleration_m_s2, sequence))]
    fn actuate(
        &self,
        steering_rad: Option<f64>,
        steering_rate_rad_s: Option<f64>,
        speed_m_s: Option<f64>,
        acceleration_m_s2: Option<f64>,
        sequence: Option<u32>,
    ) -> PyResult<()> {
        let demand = Demand::Actuation {
            steering: match (steering_rad, steering_rate_rad_s) {
                (Some(angle), None) => SteeringDemand::Angle(angle),
                (None, Some(rate)) => SteeringDemand::Rate(rate),
                _ => return Err(refuse("give steering_rad or steering_rate_rad_s")),
            },
            speed: match (speed_m_s, acceleration_m_s2) {
                (Some(speed), None) => SpeedDemand::Speed(speed),
                (None, Some(acceleration)) => SpeedDemand::Acceleration(acceleration),
                _ => return Err(refuse("give speed_m_s or acceleration_m_s2")),
            },
        };
        self.simulation()?.send(demand, sequence)
    }

    /// Sends a trajectory: rows of time (ns of the clock of the states), x, y, `v_x`, `v_y`.
    #[pyo3(signature = (points, sequence))]
    fn trajectory(&self, points: Vec<(u64, [f64; 4])>, sequence: Option<u32>) -> PyResult<()> {
        let simulation = self.simulation()?;
        let trajectory = Trajectory {
            stamp: simulation.stamp(sequence)?,
            points: points
                .iter()
                .take(MAX_TRAJECTORY_POINTS)
                .map(|&(time_ns, [x, y, v_x, v_y])| TrajectoryPoint {
                    time: Time(time_ns),
                    position: Position::new(x, y),
                    velocity: Velocity::new(v_x, v_y),
                })
                .collect(),
        };
        if points.len() > MAX_TRAJECTORY_POINTS {
            return Err(rejected(SetpointError::OutOfRange(
                "a trajectory has more points than are allowed",
            )));
        }
        let now = trajectory.stamp.time;
        trajectory.check(now, f64::INFINITY).map_err(rejected)?;
        simulation.drive.send_trajectory(&trajectory);
        Ok(())
    }

    /// The ground truth.
    fn truth<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let simulation = self.simulation()?;
        let truth = simulation.drive.world().truth();
        let law = &simulation.setup.config.law;
        let dictionary = PyDict::new(py);
        for (name, value) in [
            ("t", truth.time_us as f64 * 1e-6),
            ("x", truth.x),
            ("y", truth.y),
            ("yaw", truth.yaw),
            ("speed", truth.speed),
            ("sideslip", truth.sideslip),
            ("yaw_rate", truth.yaw_rate),
            ("steering", truth.steering),
            ("wheel_speed", truth.wheel_speed),
            ("battery_v", truth.battery_v),
            ("way", truth.way),
        ] {
            dictionary.set_item(name, value)?;
        }
        let [x, y] = truth.point_p(law.front_axle_distance_m, law.point_distance_m);
        dictionary.set_item("point", (x, y))?;
        Ok(dictionary)
    }

    /// Loses the markers periodically, such as `200ms@2s` from now on; never with `None`.
    #[pyo3(signature = (pattern))]
    fn marker_loss(&self, pattern: Option<&str>) -> PyResult<()> {
        let pattern = pattern
            .map(str::parse::<LossPattern>)
            .transpose()
            .map_err(refuse)?;
        let mut simulation = self.simulation()?;
        let world = simulation.drive.world_mut();
        let now_us = world.now_us();
        world.cameras_mut().set_loss_epoch(Some(now_us));
        world.cameras_mut().set_loss(pattern);
        Ok(())
    }

    /// Loses the markers once, from now on, for a duration such as `300ms`.
    fn lose_markers(&self, duration: &str) -> PyResult<()> {
        let duration_us = parse_duration_us(duration).map_err(refuse)?;
        let mut simulation = self.simulation()?;
        let world = simulation.drive.world_mut();
        let now_us = world.now_us();
        world.cameras_mut().set_loss_epoch(Some(0));
        world.cameras_mut().add_loss_window(LossWindow {
            start_us: now_us,
            end_us: now_us + duration_us,
        });
        Ok(())
    }

    /// Sets a fault by its name; `value` is a word or a number.
    fn set_fault(&self, name: &str, value: &Bound<'_, PyAny>) -> PyResult<()> {
        let mut simulation = self.simulation()?;
        let world = simulation.drive.world_mut();
        match name {
            "imu" => world.set_imu_fault(choice(
                name,
                value.extract()?,
                &[
                    ("none", ImuFault::None),
                    ("silent", ImuFault::Silent),
                    ("stuck", ImuFault::Stuck),
                    ("saturated", ImuFault::Saturated),
                    ("erratic", ImuFault::Erratic),
                ],
            )?),
            "motor_sensor" => world.car_mut().set_motor_sensor_fault(choice(
                name,
                value.extract()?,
                &[
                    ("none", MotorSensorFault::None),
                    ("gone", MotorSensorFault::Gone),
                    ("doubled", MotorSensorFault::Doubled),
                    ("halved", MotorSensorFault::Halved),
                    ("erratic", MotorSensorFault::Erratic),
                ],
            )?),
            "cameras" => {
                world.cameras_mut().faults_mut().loss = choice(
                    name,
                    value.extract()?,
                    &[
                        ("none", None),
                        ("occluded", Some(LossKind::Occluded)),
                        ("absent", Some(LossKind::Absent)),
                        ("silent", Some(LossKind::Silent)),
                    ],
                )?;
            }
            "camera_jump_m" => {
                let jump_m: [f64; 3] = value.extract()?;
                if !jump_m.into_iter().all(in_hall) {
                    return Err(refuse(format!(
                        "{name} is {jump_m:?}: give three lengths in m"
                    )));
                }
                world.cameras_mut().faults_mut().jump_m = jump_m;
            }
            "line_drop" => world.wire_mut().faults_mut().drop = probability(name, value)?,
            "line_corrupt" => world.wire_mut().faults_mut().corrupt = probability(name, value)?,
            "line_delay_us" => world.wire_mut().faults_mut().delay_us = value.extract()?,
            "line_stuck" => world.wire_mut().faults_mut().stuck = value.extract()?,
            "cable" => world.set_wire_connected(value.extract()?),
            "board_power" => world.set_board_power(value.extract()?),
            "esc_power" => world.car_mut().set_esc_power(value.extract()?),
            "battery" => world.car_mut().set_battery_plugged(value.extract()?),
            "stop_switch" => world.board_mut().set_stop_input_open(value.extract()?),
            _ => {
                return Err(refuse(format!(
                    "unknown fault {name:?}: use imu, motor_sensor, cameras, camera_jump_m, \
                     line_drop, line_corrupt, line_delay_us, line_stuck, cable, board_power, \
                     esc_power, battery or stop_switch"
                )));
            }
        }
        Ok(())
    }

    /// Presses the board's reset button.
    fn press_reset(&self) -> PyResult<()> {
        self.simulation()?.drive.world_mut().press_reset();
        Ok(())
    }

    /// Puts the car down elsewhere, at rest.
    fn place(&self, x_m: f64, y_m: f64, yaw_rad: f64) -> PyResult<()> {
        if ![x_m, y_m, yaw_rad].into_iter().all(in_hall) {
            return Err(refuse("this is not a place on a floor"));
        }
        let pose = StartPose { x_m, y_m, yaw_rad };
        self.simulation()?.drive.world_mut().car_mut().place(pose);
        Ok(())
    }

    /// The configuration in force, as TOML.
    fn configuration(&self) -> PyResult<String> {
        self.simulation()?.setup.config.to_toml().map_err(fail)
    }

    /// Completes the record, if there is one.
    fn finish(&self, py: Python<'_>) -> PyResult<()> {
        py.detach(|| {
            let mut simulation = self.simulation()?;
            let simulation = &mut *simulation;
            if let Some(record) = simulation.record.take() {
                record.finish(&mut simulation.drive).map_err(fail)?;
            }
            Ok(())
        })
    }
}

/// An error with the daemon's word for it.
fn rejected(error: SetpointError) -> PyErr {
    let word = match error {
        SetpointError::NotFinite => "not-finite",
        SetpointError::Future => "future",
        SetpointError::Old => "old",
        _ => "out-of-range",
    };
    PyValueError::new_err((error.to_string(), word))
}

fn probability(name: &str, value: &Bound<'_, PyAny>) -> PyResult<f64> {
    let probability = value.extract()?;
    if !(0.0..=1.0).contains(&probability) {
        return Err(refuse(format!(
            "{name} is {probability}: it must be between 0 and 1"
        )));
    }
    Ok(probability)
}

impl Simulator {
    fn simulation(&self) -> PyResult<MutexGuard<'_, Simulation>> {
        self.0
            .lock()
            .map_err(|_| fail("the simulation has panicked before"))
    }
}

impl Simulation {
    fn step(&mut self) -> PyResult<()> {
        let tick = self.drive.step();
        self.first_ns.get_or_insert(tick.now.0);
        for event in &tick.tick.events {
            if let Event::Board(sample) = event {
                self.board_ns = Some(sample.time.0);
            }
        }
        self.last = Some(tick);
        self.unwritten += 1;
        if let Some(record) = &mut self.record
            && self.unwritten >= TICKS_PER_WRITE
        {
            record.write(&mut self.drive).map_err(fail)?;
            self.unwritten = 0;
        }
        Ok(())
    }

    /// The stamp of a set-point that is decided after the last tick.
    fn stamp(&self, sequence: Option<u32>) -> PyResult<SetpointStamp> {
        let last = self.last.as_ref();
        let last = last.ok_or_else(|| fail("run a tick before the first set-point"))?;
        Ok(SetpointStamp {
            time: last.now,
            sequence,
        })
    }

    fn send(&self, demand: Demand, sequence: Option<u32>) -> PyResult<()> {
        demand.check().map_err(rejected)?;
        let stamp = self.stamp(sequence)?;
        self.drive.send_setpoint(&Setpoint { stamp, demand });
        Ok(())
    }
}

/// The keys of `[truth]`: name, range and meaning of each.
#[pyfunction]
pub(crate) fn truth_keys() -> Vec<(String, &'static str, &'static str)> {
    TRUTH_KEYS
        .iter()
        .map(|key| {
            let name = format!("{}.{}", key.section, key.name);
            (name, key.range, key.help.trim())
        })
        .collect()
}
