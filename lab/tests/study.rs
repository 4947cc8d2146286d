//! The accuracy of the identification: the same drive under many seeds of the simulator's
//! noise, compared with the truth and with the Cramér-Rao bound.

use std::{fmt::Display, path::Path};

use singletrack_analysis::identification::{
    self, DriveData, Estimate, NoiseLevels, Parameter, Settings, Values, Warning,
};
use singletrack_campaign::{run_units, thread_count};
use singletrack_control::{SlipAngles, Tyres, VehicleParameters};
use singletrack_lab::{Result, identify::Collector};
use singletrack_scenario::{
    simulate::{Scenario, virtual_drive_config},
    virtual_drive::VirtualDrive,
};
use singletrack_sim::{CameraParameters, CarTruth, ImuParameters, ServoParameters};

/// The drive for the identification.
pub(crate) const SCENARIO: &str = include_str!("../../tools/scenarios/identify-car.toml");
/// Another one, for validation.
pub(crate) const VALIDATION: &str =
    include_str!("../../tools/scenarios/identify-car-validation.toml");

/// The study: the same drive under consecutive seeds.
///
/// Each seed simulates the drive for identification, identifies the car from it and
/// validates that on the other drive under another seed. Every fit starts from a car that is
/// wrong by 30 to 40 %. The car that is driven may have another structure than the model that
/// is fitted, whose slip angles are small.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct StudyPlan {
    /// The first seed.
    pub(crate) first_seed: u64,
    /// The number of seeds.
    pub(crate) count: u64,
    /// The tyres of the car that is driven.
    pub(crate) tyre_curve: Tyres,
    /// The slip angles of the car that is driven.
    pub(crate) slip_angles: SlipAngles,
    /// The tyres of the model that is fitted.
    pub(crate) fitted_tyres: Tyres,
    /// The slip angles of the model that is fitted.
    pub(crate) fitted_slip_angles: SlipAngles,
}

/// The results of the study.
#[derive(Clone, Debug)]
pub(crate) struct Study {
    /// The car that was driven.
    pub(crate) truth: VehicleParameters,
    /// Each seed, in the given order.
    pub(crate) seeds: Vec<SeedResult>,
}

/// The result of one seed.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct SeedResult {
    /// The identified parameters.
    pub(crate) estimates: Vec<Estimate>,
    /// The smallest standard deviations of the parameters, those of the vehicle first (Cramér and
    /// Rao), with the simulator's noise.
    pub(crate) bounds: Vec<f64>,
    /// Normalised mean prediction error on the drive for identification, and on that for validation.
    pub(crate) nmpe: [f64; 2],
    /// The warnings of the fit.
    pub(crate) warnings: Vec<Warning>,
}

/// The statistics of a parameter over all seeds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Summary {
    /// Which.
    pub(crate) parameter: Parameter,
    /// The truth.
    pub(crate) truth: f64,
    /// Standard deviation of the estimates from the truth.
    pub(crate) deviation: f64,
    /// Largest error over the truth.
    pub(crate) worst_relative_error: f64,
    /// Mean of the standard deviations that the fits state.
    pub(crate) stated_deviation: f64,
    /// Mean of the Cramér-Rao bounds.
    pub(crate) bound: f64,
}

/// Says with which seed it failed.
fn under<E: Display>(seed: u64) -> impl Fn(E) -> String {
    move |error| format!("seed {seed}: {error}")
}

/// Runs the study on all cores.
pub(crate) fn run_study(plan: &StudyPlan) -> Result<Study> {
    let seeds = (0..plan.count).map(|index| plan.first_seed.wrapping_add(index));
    let seeds: Vec<u64> = seeds.collect();
    let results = run_units(&seeds, thread_count(), |seed| one(plan, seed), || {})?;
    Ok(Study {
        truth: scenario(SCENARIO, 0)?.vehicle,
        seeds: results.into_iter().map(|(_, result)| result).collect(),
    })
}

fn one(plan: &StudyPlan, seed: u64) -> Result<SeedResult> {
    let truth = scenario(SCENARIO, 0)?.vehicle;
    let start = start(truth);
    let settings = Settings {
        tyres: plan.fitted_tyres,
        slip_angles: plan.fitted_slip_angles,
        ..Settings::default()
    };
    let data = simulated(plan, SCENARIO, seed)?;
    let identification = identification::identify(&data, &start, &settings).map_err(under(seed))?;
    let bounds = identification::cramer_rao(
        &data,
        &true_values(&truth, &identification.values),
        &simulated_noise(usual_speed(&data)),
        identification.frames,
        &settings,
    )
    .map_err(under(seed))?;
    // A seed that no other drive of the study has.
    let other = simulated(plan, VALIDATION, seed ^ 1 << 40)?;
    let validation =
        identification::validate(&other, &identification, &settings).map_err(under(seed))?;
    Ok(SeedResult {
        estimates: identification.estimates,
        bounds,
        nmpe: [identification.score.nmpe, validation.score.nmpe],
        warnings: identification.warnings,
    })
}

/// Where a fit starts: a car that is wrong by 30 to 40 %.
fn start(truth: VehicleParameters) -> VehicleParameters {
    VehicleParameters {
        front_cornering_stiffness_n_rad: 1.4 * truth.front_cornering_stiffness_n_rad,
        rear_cornering_stiffness_n_rad: 0.7 * truth.rear_cornering_stiffness_n_rad,
        yaw_inertia_kg_m2: 1.4 * truth.yaw_inertia_kg_m2,
        ..truth
    }
}

fn scenario(text: &str, seed: u64) -> Result<Scenario> {
    let mut scenario = Scenario::from_toml(text, Path::new("identify-car"))?;
    scenario.run.seed = seed;
    Ok(scenario)
}

/// Lets a scenario drive a car with these equations, which has proved its configuration all the same.
fn differ(scenario: &mut Scenario, tyres: Tyres, slip_angles: SlipAngles) {
    let mut truth = CarTruth::default();
    truth.vehicle.tyre_curve = Some(tyres);
    truth.vehicle.slip_angles = Some(slip_angles);
    scenario.truth = Some(truth);
    let proved = [("prove_first_metre".to_owned(), false.into())];
    scenario.supervisor.get_or_insert_default().extend(proved);
}

/// The data that a record of the drive would have, without a file.
fn simulated(plan: &StudyPlan, text: &str, seed: u64) -> Result<DriveData> {
    let mut scenario = scenario(text, seed)?;
    differ(&mut scenario, plan.tyre_curve, plan.slip_angles);
    let (config, simulation) = virtual_drive_config(&scenario).map_err(under(seed))?;
    let mut collector = Collector::new(&config, 0).map_err(under(seed))?;
    let drive = VirtualDrive::new(config, scenario.run.seed, simulation);
    let mut drive = drive.map_err(under(seed))?;
    drive.keep_entries();
    let first = drive.start().map_err(under(seed))?.now;
    let mut now = first;
    while now.seconds_since(first) < scenario.run.duration_s {
        now = drive.step().now;
        for entry in drive.entries() {
            collector.take(&entry);
        }
    }
    Ok(collector.until(u64::MAX >> 1))
}

/// The true car, with the estimated delays and biases.
fn true_values(truth: &VehicleParameters, estimated: &Values) -> Values {
    let servo = ServoParameters::default();
    let mut values = Values::of(truth).with(Parameter::ServoLag, servo.lag_s);
    for parameter in [
        Parameter::SteeringDelay,
        Parameter::InertialDelay,
        Parameter::LateralBias,
    ] {
        values = values.with(parameter, estimated.get(parameter));
    }
    values
}

/// The median speed of a drive, in m/s.
fn usual_speed(data: &DriveData) -> f64 {
    let mut speeds: Vec<f64> = data
        .poses
        .windows(2)
        .map(|pair| {
            let way = libm::hypot(pair[1].x_m - pair[0].x_m, pair[1].y_m - pair[0].y_m);
            way / (pair[1].time_s - pair[0].time_s)
        })
        .collect();
    speeds.sort_by(f64::total_cmp);
    speeds.get(speeds.len() / 2).copied().unwrap_or(0.0)
}

/// The simulator's noise at this speed, as the identification counts it.
fn simulated_noise(speed: f64) -> NoiseLevels {
    let cameras = CameraParameters::default();
    let imu = ImuParameters::default();
    let period_s = imu.period_us as f64 * 1e-6;
    let vibration_rad_s = imu.vibration_rad_s + imu.vibration_rad_s_per_m_s * speed;
    let vibration_m_s2 = imu.vibration_m_s2 + imu.vibration_m_s2_per_m_s * speed;
    let acceleration_m_s2 = libm::hypot(imu.acceleration_noise_m_s2, vibration_m_s2);
    NoiseLevels {
        position_m: cameras.position_noise_m,
        yaw_rad: cameras.orientation_noise_rad,
        yaw_rate_rad_s: libm::hypot(imu.gyro_noise_rad_s, vibration_rad_s),
        left_m_s2: acceleration_m_s2,
        forward_density: acceleration_m_s2 * period_s.sqrt(),
        gyro_walk: imu.gyro_walk_rad_s,
        ..NoiseLevels::exact()
    }
}

impl SeedResult {
    /// The estimate of a parameter, if it was identified.
    pub(crate) fn estimate(&self, parameter: Parameter) -> Option<&Estimate> {
        let mut estimates = self.estimates.iter();
        estimates.find(|estimate| estimate.parameter == parameter)
    }
}

impl Study {
    /// Statistics of `C_f`, `C_r` and `I_z` over all seeds.
    pub(crate) fn summaries(&self) -> [Summary; 3] {
        let values = Values::of(&self.truth);
        let count = self.seeds.len().max(1) as f64;
        let mut index = 0;
        Parameter::VEHICLE.map(|parameter| {
            let truth = values.get(parameter);
            let mut summary = Summary {
                parameter,
                truth,
                deviation: 0.0,
                worst_relative_error: 0.0,
                stated_deviation: 0.0,
                bound: 0.0,
            };
            for result in &self.seeds {
                let Some(estimate) = result.estimate(parameter) else {
                    continue;
                };
                let error = estimate.value - truth;
                summary.deviation += error * error / count;
                summary.worst_relative_error =
                    summary.worst_relative_error.max(error.abs() / truth);
                summary.stated_deviation += estimate.standard_deviation / count;
                summary.bound += result.bounds.get(index).copied().unwrap_or(f64::NAN) / count;
            }
            summary.deviation = summary.deviation.sqrt();
            index += 1;
            summary
        })
    }

    /// Mean of the normalised mean prediction errors on the drives for identification
    /// and for validation.
    pub(crate) fn nmpe(&self) -> [f64; 2] {
        let count = self.seeds.len().max(1) as f64;
        [0, 1].map(|drive| {
            let of_seeds = self.seeds.iter().map(|result| result.nmpe[drive]);
            of_seeds.sum::<f64>() / count
        })
    }
}
