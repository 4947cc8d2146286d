//! One drive of the comparison on the simulated car: what is different from a calibrated car with good
//! cameras, and how it ends.

use clap::{ValueEnum, builder::PossibleValue};
use singletrack_control::{
    Setpoint, SpeedDemand, SteeringDemand, Time, VehicleParameters, Velocity, words,
};
use singletrack_core::{
    config::{CompensationSection, ReferenceSection},
    setpoint::SetpointCommand,
};
use singletrack_pilot::{Arming, Mode, PilotRequest, Reason};
use singletrack_scenario::{
    simulated::{Drive, daemon_config, follow, start_of},
    virtual_drive::{VirtualDrive, VirtualDriveError, VirtualTick},
};
use singletrack_sim::{LossWindow, SimulationConfig};

use super::{
    controller::Drives,
    counted::{AddedDelay, Counted, DriveError, DriveResult, POINT_DISTANCE_M},
    course::{Course, LATERAL_M_S2, PathName, Table},
    foreign::{Ahead, Foreign, Known},
    ideal,
    predictive::Predictive,
};

words! {
    /// A condition of the comparison.
    pub enum Condition: serde {
        /// The car is as it is believed to be.
        Nominal = "nominal",
        /// The true tyres have half the cornering stiffness.
        SoftTyres = "tyres-50%",
        /// The true tyres have 1.5 times the cornering stiffness.
        StiffTyres = "tyres+50%",
        /// The front axle is believed to be at the centre of mass: dl = `-l_f`.
        AxleLeast = "axle-lf",
        /// The distance of the front axle from the centre of mass is believed to be 50 mm less.
        AxleLess = "axle-50mm",
        /// The distance of the front axle from the centre of mass is believed to be 50 mm more.
        AxleMore = "axle+50mm",
        /// The rear axle is believed to be at the centre of mass: dl = `l_r`.
        AxleMost = "axle+lr",
        /// The wheels turn 20 % less than commanded.
        WeakSteering = "gain-20%",
        /// The true trim of the steering is 3 degrees off.
        WrongTrim = "trim-3deg",
        /// The poses are 20 ms older than their stamps.
        LateStamps = "stamps-20ms",
        /// The cameras see nothing for 50 ms, a second after the counting begins.
        Loss50 = "loss-50ms",
        /// The cameras see nothing for 100 ms.
        Loss100 = "loss-100ms",
        /// The cameras see nothing for 200 ms.
        Loss200 = "loss-200ms",
        /// The cameras see nothing for 500 ms.
        Loss500 = "loss-500ms",
        /// The cameras see nothing for a second.
        Loss1000 = "loss-1000ms",
        /// The paper's equations in place of the simulated car: no lag, noise, limits or estimator.
        IdealPlant = "ideal-plant",
        /// The search for the least added delay that diverges, in a table of its own.
        AddedDelay = "added-delay",
    }
}

impl ValueEnum for Condition {
    fn value_variants<'a>() -> &'a [Self] {
        &Self::ALL
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        let help = self.documentation().trim().trim_end_matches('.');
        Some(PossibleValue::new(self.name()).help(help))
    }
}

impl Condition {
    /// Factor of the true cornering stiffnesses.
    const fn stiffness(self) -> f64 {
        match self {
            Self::SoftTyres => 0.5,
            Self::StiffTyres => 1.5,
            _ => 1.0,
        }
    }

    /// Error of the believed distance of the front axle, in m: dl.
    fn axle_error_m(self, vehicle: &VehicleParameters) -> f64 {
        match self {
            Self::AxleLeast => -vehicle.front_axle_distance_m,
            Self::AxleLess => -0.05,
            Self::AxleMore => 0.05,
            Self::AxleMost => vehicle.rear_axle_distance_m,
            _ => 0.0,
        }
    }

    /// Makes steering and cameras differ from what is believed of them.
    fn falsify(self, simulation: &mut SimulationConfig) {
        let servo = &mut simulation.car.servo;
        match self {
            Self::WeakSteering => servo.gain_us_per_rad /= 0.8,
            Self::WrongTrim => servo.centre_us += 3_f64.to_radians() * servo.gain_us_per_rad.abs(),
            Self::LateStamps => simulation.cameras.stamp_bias_ms = 20.0,
            _ => {}
        }
    }

    /// How long the cameras see nothing, in µs.
    const fn loss_us(self) -> u64 {
        match self {
            Self::Loss50 => 50_000,
            Self::Loss100 => 100_000,
            Self::Loss200 => 200_000,
            Self::Loss500 => 500_000,
            Self::Loss1000 => 1_000_000,
            _ => 0,
        }
    }
}

use Condition::{
    AxleLeast, AxleLess, AxleMore, AxleMost, LateStamps, Nominal, SoftTyres, StiffTyres,
    WeakSteering, WrongTrim,
};

/// Conditions of which the worst has a row of its own, with its name in the table: within 50 % of
/// the cornering stiffness, over the believed place of the front axle, dl from `-l_f` to `l_r`,
/// and over the wrong beliefs about steering and cameras.
pub(super) const WORST: [(&str, &[Condition]); 3] = [
    ("worst-tyres", &[Nominal, SoftTyres, StiffTyres]),
    (
        "worst-axle",
        &[Nominal, AxleLeast, AxleLess, AxleMore, AxleMost],
    ),
    (
        "worst-belief",
        &[Nominal, WeakSteering, WrongTrim, LateStamps],
    ),
];

/// The row that a drive belongs to, and its seed.
#[derive(Clone, Debug)]
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
/// The longest added delay that is tried, and how exactly the least that diverges is found, in ms.
pub(super) const LONGEST_DELAY_MS: u32 = 640;
const DELAY_STEP_MS: u32 = 5;
/// The delay grows from this time of the drive on, in s, by this in every tick, in µs: a motor that
/// starts late is taken for a failed sensor by the board, and a gap between two pulses for a lost
/// signal by the ESC.
const DELAY_FROM_S: f64 = 0.5;
const DELAY_STEP_US: u64 = 6_400;
/// A drive diverges with a delay if its largest error grows by more than this, in m.
const DIVERGED_M: f64 = 0.25;
/// How a drive ends that diverges, and one that has not begun to follow when the counting begins,
/// among the names of the supervisor's reasons.
pub(super) const DIVERGED: &str = "diverged";
const TURNING_ROUND: &str = "turning-round";
/// How a drive ends whose controller gives no set-point any more.
const NO_SETPOINT: &str = "no-setpoint";

/// Decides the set-point that acts in the tick after this one; none ends the drive.
pub type Decide<'a> = dyn FnMut(&VirtualTick) -> Option<SetpointCommand> + 'a;

impl Case {
    pub(super) fn drive(&self) -> Result<DriveResult, DriveError> {
        let (course, table) = self.course()?;
        match self.condition {
            Condition::IdealPlant => ideal::drive(&self.drives, &course, &table),
            Condition::AddedDelay => self.search_delay(&course, &table),
            _ => self.car(&course, &table, 0, f64::INFINITY),
        }
    }

    fn course(&self) -> Result<(Course, Table), DriveError> {
        let course = Course::new(self.path, self.speed_m_s);
        let table = Table::new(&course, course.counted[1] + 5.0)?;
        Ok((course, table))
    }

    /// On the simulated car, with the set-points of a program.
    pub(super) fn drive_by(&self, decide: &mut Decide<'_>) -> Result<DriveResult, DriveError> {
        let (course, table) = self.course()?;
        let mut run = Run::new(self, &course, &table, 0)?;
        run.driver = Driver::Yours(decide);
        run.start();
        run.finish(&course, f64::INFINITY);
        Ok(run.errors.result(run.stopped))
    }

    /// On the simulated car, with pulses that act `delay_ms` later. It ends as [`DIVERGED`] when
    /// the error exceeds `most_m`.
    fn car(
        &self,
        course: &Course,
        table: &Table,
        delay_ms: u32,
        most_m: f64,
    ) -> Result<DriveResult, DriveError> {
        let mut run = match Run::new(self, course, table, delay_ms) {
            // A loop that does not settle with these weights on this course: nothing is driven.
            Err(DriveError::Drive(VirtualDriveError::Config(error))) if self.drives.has_model() => {
                let vehicle = VehicleParameters::paper();
                let nothing =
                    Counted::new(self.drives.own_point(), &vehicle, course.counted, table);
                return Ok(nothing.result(Some(format!("refused: {error}"))));
            }
            run => run?,
        };
        run.start();
        run.finish(course, most_m);
        Ok(run.errors.result(run.stopped))
    }

    /// The least delay that diverges, by bisection: what is beyond it is taken to diverge, too.
    fn search_delay(&self, course: &Course, table: &Table) -> Result<DriveResult, DriveError> {
        let without = self.car(course, table, 0, f64::INFINITY)?;
        let most = without.own.map_or(0.0, |errors| errors.max) + DIVERGED_M;
        let end_with = |delay_ms| {
            self.car(course, table, delay_ms, most)
                .map(|end| end.stopped)
        };
        let mut found = AddedDelay {
            diverges_ms: None,
            ended_by: None,
        };
        if without.stopped.is_some() {
            found.diverges_ms = Some(0);
            found.ended_by.clone_from(&without.stopped);
        } else if let Some(ended_by) = end_with(LONGEST_DELAY_MS)? {
            let (mut stands, mut fails) = (0, LONGEST_DELAY_MS);
            found.ended_by = Some(ended_by);
            while fails - stands > DELAY_STEP_MS {
                let middle = stands.midpoint(fails);
                if let Some(ended_by) = end_with(middle)? {
                    fails = middle;
                    found.ended_by = Some(ended_by);
                } else {
                    stands = middle;
                }
            }
            found.diverges_ms = Some(fails);
        }
        Ok(DriveResult {
            added_delay: Some(found),
            ..without
        })
    }
}

/// What decides the commands.
enum Driver<'a> {
    /// The pilot, from its reference.
    Pilot,
    Foreign(Box<Foreign<'a>>),
    Predictive(Box<Predictive<'a>>),
    Yours(&'a mut Decide<'a>),
}

struct Run<'a> {
    drive: VirtualDrive,
    driver: Driver<'a>,
    errors: Counted<'a>,
    /// When the cameras see nothing, in s of the drive, and for how long, in µs.
    loss: (f64, u64),
    /// The delay of the pulses that is still to be added, in µs.
    delay_us: u64,
    period: f64,
    stopped: Option<String>,
}

impl<'a> Run<'a> {
    fn new(
        case: &Case,
        course: &Course,
        table: &'a Table,
        delay_ms: u32,
    ) -> Result<Self, DriveError> {
        let mut simulation = SimulationConfig {
            seed: case.seed,
            ..SimulationConfig::default()
        };
        let believed = simulation.car.vehicle;
        let axle_error_m = case.condition.axle_error_m(&believed);
        let mut drive = Drive::following(course.reference.clone());
        drive.vehicle = believed;
        drive.law.point_distance_m = POINT_DISTANCE_M;
        drive.law.front_axle_distance_m = believed.front_axle_distance_m + axle_error_m;
        let external = ReferenceSection::External {
            setpoint_timeout_ms: SETPOINT_TIMEOUT_MS,
        };
        let mut vehicle = believed;
        // The wheelbase is known: it can be measured.
        vehicle.front_axle_distance_m += axle_error_m;
        vehicle.rear_axle_distance_m -= axle_error_m;
        match &case.drives {
            Drives::Point { outer_loop, .. } => drive.outer_loop = outer_loop.clone(),
            _ => drive.reference = external,
        }
        let is_compensated = case.drives.is_compensated();
        let mut config = daemon_config(drive);
        config.compensation = CompensationSection {
            clock: is_compensated,
            actuation: is_compensated,
        };
        config.limits.max_speed_m_s = f64::from(TOP_SPEED_MM_S) * 1e-3;
        config.limits.max_lateral_acceleration_m_s2 = LATERAL_M_S2;
        config.board.speed.max_forward_mm_s = TOP_SPEED_MM_S;
        config.board.esc.max_us = MAX_ESC_US;
        config.board.speed.feed_forward_us_per_m_s = FEED_FORWARD_US_PER_M_S;
        config.board.speed.integral_limit_us = INTEGRAL_LIMIT_US;
        config.board.max_pose_age_ms = MAX_POSE_AGE_MS;
        config.control.stop_deceleration_m_s2 = STOP_DECELERATION_M_S2;
        let true_car = &mut simulation.car.vehicle;
        true_car.front_cornering_stiffness_n_rad *= case.condition.stiffness();
        true_car.rear_cornering_stiffness_n_rad *= case.condition.stiffness();
        let own = case.drives.own_point();
        let reach = own.reach(true_car);
        let errors = Counted::new(own, true_car, course.counted, table);
        simulation.car.start = start_of(course.start, reach, course.heading);
        follow(&config, &mut simulation);
        case.condition.falsify(&mut simulation);
        let period = config.control.period_ns() as f64 * 1e-9;
        let model = config.actuators.model();
        let driver = match &case.drives {
            Drives::Point { .. } | Drives::Yours(_) => Driver::Pilot,
            &Drives::Actuators { law, catch_up, .. } => Driver::Foreign(Box::new(Foreign {
                law,
                catch_up,
                vehicle,
                table,
                index: 0,
                compensation: is_compensated.then(|| Ahead::new(model, &vehicle, period)),
            })),
            &Drives::Predictive(weights) => {
                let limits = config.limits.limits(vehicle.wheelbase_m());
                let limits = limits.with_tyres(&vehicle);
                let law = Predictive::new(weights, vehicle, model, limits, period, table);
                Driver::Predictive(Box::new(law))
            }
        };
        Ok(Self {
            drive: VirtualDrive::new(config, case.seed, simulation)?,
            driver,
            errors,
            loss: (course.counted[0] + 1.0, case.condition.loss_us()),
            delay_us: 1_000 * u64::from(delay_ms),
            period,
            stopped: None,
        })
    }

    /// Gives the pilot standstill for the next tick: without a set-point it does not arm.
    fn stand(&self) {
        let now = Time(self.drive.now_us() * 1_000);
        match self.driver {
            Driver::Pilot => {}
            Driver::Foreign(_) | Driver::Predictive(_) => {
                self.drive.send_setpoint(&actuation(now, [0.0; 2]));
            }
            Driver::Yours(_) => {
                let setpoint = Setpoint::point(now, None, Velocity::zeros());
                self.drive.send_setpoint(&setpoint);
            }
        }
    }

    fn start(&mut self) {
        let mut armed = false;
        while self.drive.next_tick_us() as f64 * 1e-6 < START_S {
            if !armed && self.drive.mode() == Mode::Ready {
                let arm = PilotRequest::Arm(Arming::Unattended);
                armed = self.drive.request(arm).is_ok();
            }
            self.stand();
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
            let end_us = start_us + for_us;
            let cameras = &mut self.drive.world.cameras.parameters;
            cameras.loss_windows.push(LossWindow { start_us, end_us });
        }
    }

    /// Adds a part of the delay.
    fn delay(&mut self) {
        let part_us = self.delay_us.min(DELAY_STEP_US);
        if part_us > 0 {
            self.delay_us -= part_us;
            self.drive.world.car.delay_pulses(part_us);
        }
    }

    fn stop(&mut self) {
        let reason = self.drive.controller().pilot.reason();
        let board = self.drive.world.board.telemetry();
        let reason = match (reason, board) {
            // The board stopped by itself, and knows why.
            (Some(Reason::BoardFailsafe), Some(board)) => board.stop_cause.name(),
            (reason, _) => reason.map_or("unknown", Reason::name),
        };
        self.stopped = Some(reason.to_owned());
    }

    fn finish(&mut self, course: &Course, most_m: f64) {
        let [from, until] = course.counted;
        let ends = course.ends.then(|| self.errors.path_duration()).flatten();
        let mut counting = false;
        let mut last = 0.0;
        while self.stopped.is_none() {
            let tick = self.drive.step();
            let output = &tick.tick.output;
            let Some(time) = output.drive_time.filter(|_| output.mode == Mode::Driving) else {
                let reason = self.drive.controller().pilot.reason();
                if ends.is_some()
                    && matches!(reason, Some(Reason::ReferenceFinished | Reason::Requested))
                {
                    self.stand_still(last + self.period, until, &tick);
                } else {
                    self.stop();
                }
                return;
            };
            last = time;
            // As the pilot ends a drive whose reference ends.
            if !matches!(self.driver, Driver::Pilot) && ends.is_some_and(|end| time >= end) {
                // Refused if it is asked for already.
                let _ = self.drive.request(PilotRequest::Disarm);
            }
            if time > until {
                return;
            }
            if !counting && time >= from {
                counting = true;
                // It drives a circle, and the reference does not come again.
                if course.ends && output.turning_round {
                    self.stopped = Some(TURNING_ROUND.to_owned());
                    return;
                }
            }
            if time >= DELAY_FROM_S {
                self.delay();
            }
            self.take(&tick);
            if self.errors.largest_m() > most_m {
                self.stopped = Some(DIVERGED.to_owned());
            }
        }
    }

    /// Counts how the car comes to rest behind the end of its path.
    fn stand_still(&mut self, from: f64, until: f64, tick: &VirtualTick) {
        self.errors.add(from, &tick.truth);
        let mut time = from + self.period;
        while time <= until {
            let tick = self.drive.step();
            self.errors.add(time, &tick.truth);
            time += self.period;
        }
    }

    /// Counts a tick, and lets the law outside answer it.
    fn take(&mut self, tick: &VirtualTick) {
        let output = &tick.tick.output;
        let Some(time) = output.drive_time else {
            return;
        };
        self.errors.add(time, &tick.truth);
        let known = output.estimate.as_ref().map(|estimate| Known {
            estimate,
            steering: output.actuation.steering,
            speed: output.actuation.speed,
            time,
        });
        let command = match (&mut self.driver, known) {
            (Driver::Foreign(law), Some(known)) => law.answer(&known, self.period),
            (Driver::Predictive(law), Some(known)) => law.answer(&known),
            (Driver::Yours(decide), _) => {
                match decide(tick) {
                    Some(command) => self.drive.host().parts.setpoints.pass(&command),
                    None => self.stopped = Some(NO_SETPOINT.to_owned()),
                }
                return;
            }
            _ => return,
        };
        let now = Time(self.drive.now_us() * 1_000);
        self.drive.send_setpoint(&actuation(now, command));
    }
}

/// Steering (rad) and speed (m/s) as a set-point.
const fn actuation(now: Time, [steering, speed]: [f64; 2]) -> Setpoint {
    Setpoint::actuation(
        now,
        SteeringDemand::Angle(steering),
        SpeedDemand::Speed(speed),
    )
}
