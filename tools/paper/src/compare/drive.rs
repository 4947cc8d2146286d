//! One drive of the comparison.

use libm::{cos, hypot, sin};
use serde::{Deserialize, Serialize};
use singletrack_control::{Setpoint, SpeedDemand, SteeringDemand, Time};
use singletrack_core::{
    ConfigError,
    config::{CompensationSection, ReferenceSection},
};
use singletrack_pilot::{Mode, PilotRequest, Reason};
use singletrack_scenario::{
    simulated::{Drive, daemon_config, follow},
    virtual_drive::{VirtualDrive, VirtualDriveError, VirtualTick},
};
use singletrack_sim::{LossWindow, SimulationConfig, StartPose, Truth};
use singletrack_statistics::Distribution;

use super::{
    condition::Condition,
    controller::Drives,
    course::{Course, PathName, Table},
    foreign::{Foreign, Law},
};

/// What became of a drive.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DriveResult {
    /// Why the car stopped before the end; the errors are those until then.
    pub stopped: Option<String>,
    /// Error of the controller's own point: P, the rear axle, or the front axle.
    pub own: Option<Errors>,
    /// Distance of the front axle from the path, whenever it is where.
    pub front_axle: Option<Errors>,
    /// The largest acceleration of G over that of sliding tyres.
    pub tyre_use_max: f64,
}

/// Errors over the counted time, in m.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Errors {
    /// Root mean square.
    pub rms: f64,
    /// Exceeded in 1 % of the time.
    pub p99: f64,
    /// Largest.
    pub max: f64,
    /// Root mean square along the path; zero where time does not matter.
    pub along_rms: f64,
    /// Root mean square across it.
    pub across_rms: f64,
}

/// Why a drive can't be simulated.
#[derive(Debug, thiserror::Error)]
pub enum DriveError {
    /// The reference is refused.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The host or the world is refused.
    #[error(transparent)]
    Drive(#[from] VirtualDriveError),
}

/// The row that a drive belongs to, and its seed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Case {
    pub(super) drives: Drives,
    pub(super) path: PathName,
    pub(super) speed_m_s: f64,
    pub(super) condition: Condition,
    pub(super) seed: u64,
}

/// The top speed of the car, in mm/s: a controller that is behind may be faster than the
/// reference.
const TOP_SPEED_MM_S: u16 = 2_200;
/// The calibration of the motor up to that speed: with the pulses of the default the simulated
/// car reaches 1.24 m/s.
const MAX_ESC_US: u16 = 2_000;
const FEED_FORWARD_US_PER_M_S: u16 = 110;
const INTEGRAL_LIMIT_US: u16 = 150;
/// At that speed the host can stop a car that is lost within the longest age of a pose that
/// the board takes, if it stops with this deceleration, in m/s².
const STOP_DECELERATION_M_S2: f64 = 3.0;
const MAX_POSE_AGE_MS: u16 = 1_000;
/// Time for the start, in s.
const START_S: f64 = 15.0;
/// How long a set-point is in force, in ms.
const SETPOINT_TIMEOUT_MS: u32 = 100;
/// Standard gravity, in m/s².
const GRAVITY: f64 = 9.806_65;
const POINT_DISTANCE_M: f64 = 0.35;

impl Case {
    pub(super) fn drive(&self) -> Result<DriveResult, DriveError> {
        let course = Course::new(self.path, self.speed_m_s);
        let [_, until] = course.counted;
        let table = Table::new(&course, until + 5.0)?;
        let mut run = Run::new(self, &course, &table)?;
        run.start();
        run.finish(until);
        Ok(run.errors.result(run.stopped))
    }
}

struct Run<'a> {
    drive: VirtualDrive,
    foreign: Option<Foreign<'a>>,
    errors: Counted<'a>,
    /// When the cameras see nothing, in s of the drive, and for how long, in µs.
    loss: (f64, u64),
    period: f64,
    stopped: Option<String>,
}

impl<'a> Run<'a> {
    fn new(case: &Case, course: &Course, table: &'a Table) -> Result<Self, DriveError> {
        let mut simulation = SimulationConfig {
            seed: case.seed,
            ..SimulationConfig::default()
        };
        let believed = simulation.car.vehicle;
        let mut drive = Drive::following(course.reference.clone());
        drive.vehicle = believed;
        drive.law.point_distance_m = POINT_DISTANCE_M;
        drive.law.front_axle_distance_m =
            believed.front_axle_distance_m + case.condition.axle_error_m();
        let mut foreign = None;
        // The paper's controller has none, and nor have the others.
        let mut compensation = CompensationSection {
            clock: false,
            actuation: false,
        };
        let own = match case.drives {
            Drives::Point {
                outer_loop,
                compensated,
            } => {
                drive.outer_loop = outer_loop;
                compensation = CompensationSection {
                    clock: compensated,
                    actuation: compensated,
                };
                Own::P
            }
            Drives::Actuators { law, catch_up } => {
                drive.reference = ReferenceSection::External {
                    setpoint_timeout_ms: SETPOINT_TIMEOUT_MS,
                };
                let mut vehicle = believed;
                // The wheelbase is known: it can be measured.
                vehicle.front_axle_distance_m += case.condition.axle_error_m();
                vehicle.rear_axle_distance_m -= case.condition.axle_error_m();
                foreign = Some(Foreign {
                    law,
                    catch_up,
                    vehicle,
                    table,
                    index: 0,
                });
                match law {
                    Law::PurePursuit { .. } => Own::RearAxle,
                    Law::Stanley { .. } => Own::FrontAxle,
                }
            }
        };
        let mut config = daemon_config(drive);
        config.compensation = compensation;
        config.limits.max_speed_m_s = f64::from(TOP_SPEED_MM_S) * 1e-3;
        config.board.speed.max_forward_mm_s = TOP_SPEED_MM_S;
        config.board.esc.max_us = MAX_ESC_US;
        config.board.speed.feed_forward_us_per_m_s = FEED_FORWARD_US_PER_M_S;
        config.board.speed.integral_limit_us = INTEGRAL_LIMIT_US;
        config.board.max_pose_age_ms = MAX_POSE_AGE_MS;
        config.control.stop_deceleration_m_s2 = STOP_DECELERATION_M_S2;
        let true_car = &mut simulation.car.vehicle;
        true_car.front_cornering_stiffness_n_rad *= case.condition.stiffness();
        true_car.rear_cornering_stiffness_n_rad *= case.condition.stiffness();
        let front = true_car.front_axle_distance_m;
        let errors = Counted {
            own,
            front,
            rear: true_car.rear_axle_distance_m,
            counted: course.counted,
            table,
            index: 0,
            errors: Vec::new(),
            front_errors: Vec::new(),
            tyre_use: 0.0,
            sliding: true_car.friction * GRAVITY,
        };
        let reach = match own {
            Own::P => front + POINT_DISTANCE_M,
            Own::FrontAxle => front,
            Own::RearAxle => -errors.rear,
        };
        let [x, y] = course.start;
        simulation.car.start = StartPose {
            x_m: x - reach * cos(course.heading),
            y_m: y - reach * sin(course.heading),
            yaw_rad: course.heading,
        };
        follow(&config, &mut simulation);
        let period = config.control.period_ns() as f64 * 1e-9;
        Ok(Self {
            drive: VirtualDrive::new(config, case.seed, simulation)?,
            foreign,
            errors,
            loss: (course.counted[0] + 1.0, case.condition.loss_us()),
            period,
            stopped: None,
        })
    }

    /// Gives the pilot steering and speed for the next tick.
    fn send(&self, [steering, speed]: [f64; 2]) {
        if self.foreign.is_some() {
            let now = Time(self.drive.next_tick_us() * 1_000);
            self.drive.send_setpoint(&Setpoint::actuation(
                now,
                SteeringDemand::Angle(steering),
                SpeedDemand::Speed(speed),
            ));
        }
    }

    fn start(&mut self) {
        let mut armed = false;
        while self.drive.next_tick_us() as f64 * 1e-6 < START_S {
            if !armed && self.drive.mode() == Mode::Ready {
                armed = self.drive.request(PilotRequest::Arm).is_ok();
            }
            self.send([0.0; 2]);
            let tick = self.drive.step();
            if tick.tick.output.mode == Mode::Driving {
                self.lose();
                self.take(&tick);
                return;
            }
        }
        self.stop();
    }

    fn lose(&mut self) {
        let (at, for_us) = self.loss;
        let start_us = self.drive.next_tick_us() + (at * 1e6) as u64;
        if for_us > 0 {
            self.drive
                .world_mut()
                .cameras_mut()
                .add_loss_window(LossWindow {
                    start_us,
                    end_us: start_us + for_us,
                });
        }
    }

    fn stop(&mut self) {
        let reason = self.drive.controller().pilot().reason();
        self.stopped = Some(reason.map_or("unknown", Reason::name).to_owned());
    }

    fn finish(&mut self, until: f64) {
        while self.stopped.is_none() {
            let tick = self.drive.step();
            let output = &tick.tick.output;
            let Some(time) = output.drive_time.filter(|_| output.mode == Mode::Driving) else {
                self.stop();
                return;
            };
            if time > until {
                return;
            }
            self.take(&tick);
        }
    }

    /// Counts a tick, and lets the law outside answer it.
    fn take(&mut self, tick: &VirtualTick) {
        let output = &tick.tick.output;
        let Some(time) = output.drive_time else {
            return;
        };
        self.errors.add(time, &tick.truth);
        let command = match (&mut self.foreign, &output.estimate) {
            (Some(foreign), Some(estimate)) => {
                foreign.command(estimate, time + self.period, self.period)
            }
            _ => return,
        };
        self.send(command);
    }
}

/// The point whose errors are the controller's own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Own {
    P,
    FrontAxle,
    RearAxle,
}

/// The errors of a drive, from the true states.
struct Counted<'a> {
    own: Own,
    /// The true distances of the axles from G, in m.
    front: f64,
    rear: f64,
    /// The time that is counted, in s.
    counted: [f64; 2],
    table: &'a Table,
    /// The place of the path's point that is nearest to the front axle.
    index: usize,
    /// Along and across the path, in m.
    errors: Vec<[f64; 2]>,
    front_errors: Vec<[f64; 2]>,
    tyre_use: f64,
    /// Acceleration at which the tyres slide, in m/s².
    sliding: f64,
}

impl Counted<'_> {
    fn add(&mut self, time: f64, truth: &Truth) {
        let on_axis = |ahead: f64| {
            [
                truth.x + ahead * cos(truth.yaw),
                truth.y + ahead * sin(truth.yaw),
            ]
        };
        let front = on_axis(self.front);
        self.index = self.table.nearest(front, self.index);
        let [from, until] = self.counted;
        if !(from..=until).contains(&time) {
            return;
        }
        let nearest = self.table.get(self.index);
        let [_, across] = error(front, nearest.position, nearest.heading);
        self.front_errors.push([0.0, across]);
        let own = match self.own {
            Own::P => truth.point_p(self.front, POINT_DISTANCE_M),
            Own::FrontAxle => front,
            Own::RearAxle => on_axis(-self.rear),
        };
        let wanted = self.table.at(time);
        self.errors
            .push(error(own, wanted.position, wanted.heading));
        let acceleration = hypot(truth.longitudinal_acceleration, truth.lateral_acceleration);
        self.tyre_use = self.tyre_use.max(acceleration / self.sliding);
    }

    fn result(&self, stopped: Option<String>) -> DriveResult {
        DriveResult {
            stopped,
            own: Errors::of(&self.errors),
            front_axle: Errors::of(&self.front_errors),
            tyre_use_max: self.tyre_use,
        }
    }
}

/// The error along and across a direction, in m.
fn error(point: [f64; 2], wanted: [f64; 2], heading: f64) -> [f64; 2] {
    let [x, y] = [point[0] - wanted[0], point[1] - wanted[1]];
    let (sin, cos) = (sin(heading), cos(heading));
    [x * cos + y * sin, y * cos - x * sin]
}

impl Errors {
    fn of(errors: &[[f64; 2]]) -> Option<Self> {
        let distances =
            Distribution::of(errors.iter().map(|&[along, across]| hypot(along, across)));
        let part = |axis: usize| Distribution::of(errors.iter().map(|error| error[axis]));
        Some(Self {
            rms: distances.root_mean_square()?,
            p99: distances.quantile(0.99)?,
            max: distances.max()?,
            along_rms: part(0).root_mean_square()?,
            across_rms: part(1).root_mean_square()?,
        })
    }
}
