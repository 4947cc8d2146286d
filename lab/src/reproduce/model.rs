//! Model validation: the car identified from one drive, compared with another.

use std::path::Path;

use indicatif::ProgressBar;
use singletrack_analysis::identification::{Identification, Output, Parameter};
use singletrack_control::{SlipAngles, Tyres, VehicleParameters};
use singletrack_scenario::simulate::{self, Scenario};
use singletrack_sim::CarTruth;

use super::{
    Setup, assumptions, largest, least, pictures,
    section::{Above, Near, Picture, Scope, Section, with_digits},
};
use crate::{
    Result, Table,
    identify::{self, IdentifyArgs, Report},
    vehicle_file,
};

/// The drive for the identification, and another one for its validation.
const DRIVES: [&str; 2] = [
    include_str!("../../../tools/scenarios/identify-car.toml"),
    include_str!("../../../tools/scenarios/identify-car-validation.toml"),
];

/// Drives a scenario of the identification with the car, and writes its record. A car of another
/// structure than the model has exact slip angles and other tyres, with the same stiffnesses.
fn drive(setup: &Setup, text: &str, seed: u64, structure: Structure, record: &Path) -> Result {
    let mut scenario = Scenario::from_toml(text, Path::new("identification"))?;
    scenario.vehicle = setup.vehicle;
    scenario.law.front_axle_distance_m = setup.vehicle.front_axle_distance_m;
    scenario.run.seed = seed;
    if structure == Structure::Other {
        let mut truth = CarTruth::default();
        truth.vehicle.tyre_curve = Some(Tyres::MagicFormula);
        truth.vehicle.slip_angles = Some(SlipAngles::Exact);
        scenario.truth = Some(truth);
        // It has proved its configuration all the same.
        let proved = [("prove_first_metre".to_owned(), false.into())];
        scenario.supervisor.get_or_insert_default().extend(proved);
    }
    if setup.quick {
        scenario.run.duration_s = scenario.run.duration_s.min(QUICK_S);
    }
    simulate::simulate_recorded(&scenario, record)?;
    Ok(())
}

/// Whether the car that is driven has the equations of the model that is fitted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Structure {
    Same,
    Other,
}

/// The drives of a quick run are no longer than this.
const QUICK_S: f64 = 30.0;

/// Identifies the car from a drive, and validates it on another.
fn identified(setup: &Setup, structure: Structure, parameters: &[Parameter]) -> Result<Report> {
    let temporary = |error| format!("can't write into a temporary folder: {error}");
    let folder = tempfile::tempdir().map_err(temporary)?;
    let [record, other, start] =
        ["drive.mcap", "validation.mcap", "start.toml"].map(|name| folder.path().join(name));
    for ((seed, text), record) in (1..).zip(DRIVES).zip([&record, &other]) {
        drive(setup, text, seed, structure, record)?;
    }
    // A car that is wrong by 30 to 40 %.
    let mut first = VehicleParameters {
        front_cornering_stiffness_n_rad: 1.4 * setup.vehicle.front_cornering_stiffness_n_rad,
        rear_cornering_stiffness_n_rad: 0.7 * setup.vehicle.rear_cornering_stiffness_n_rad,
        yaw_inertia_kg_m2: 1.4 * setup.vehicle.yaw_inertia_kg_m2,
        ..setup.vehicle
    };
    if parameters.contains(&Parameter::Friction) {
        first.friction *= 1.4;
    }
    let vehicle = vehicle_file::text(first)?;
    std::fs::write(&start, vehicle).map_err(temporary)?;
    identify::identify(&IdentifyArgs {
        vehicle: Some(start),
        parameters: parameters.to_vec(),
        ..IdentifyArgs::of(vec![record], vec![other])
    })
}

fn truth(vehicle: &VehicleParameters, parameter: Parameter) -> f64 {
    singletrack_analysis::identification::Values::of(vehicle).get(parameter)
}

pub(super) fn section(setup: &Setup, progress: &ProgressBar) -> Section {
    let mut section = Section::new(
        1,
        "The model, identified and validated",
        "C<sub>f</sub>, C<sub>r</sub> and I<sub>z</sub> are identified from a record of a minute \
         of weaving with the simulated car, cameras, IMU and servo, all noisy, biased or late, \
         by a fit that starts 30 to 40 % wrong; the model is then left alone on a record of \
         another drive. There is no such thing on the ideal plant, which is the model. The \
         normalised mean prediction error is the mean of |model − measured| over the standard \
         deviation of what was measured, for yaw rate, sideslip and lateral acceleration.",
    );
    let [mut report, mut friction, mut other] = [None, None, None];
    if setup.fits_simulated_car() {
        progress.set_message("identification and validation");
        let fit = |structure, parameters: &[Parameter]| identified(setup, structure, parameters);
        report = section.or_note("identification", fit(Structure::Same, &Parameter::VEHICLE));
        friction = section.or_note(
            "identification with friction",
            fit(Structure::Same, &WITH_FRICTION),
        );
        other = section.or_note(
            "identification of another structure",
            fit(Structure::Other, &Parameter::VEHICLE),
        );
    } else {
        let note = "not driven: it is another kind of car than the simulated one";
        section.notes.push(note.to_owned());
    }
    let reports = [&report, &friction, &other].map(Option::as_ref);
    claims(setup, reports, &mut section);
    section.plate(
        "Single-track vehicle model",
        "The quantities used to derive the motion model.",
        "The same, of this car, to scale.",
        vec![pictures::single_track(setup)],
    );
    let Some(report) = report else {
        return section;
    };
    tables(setup, &report, &mut section);
    plates(setup, &report, &mut section);
    section
}

/// What is identified together with the friction, which the paper's table has, too.
const WITH_FRICTION: [Parameter; 4] = [
    Parameter::FrontStiffness,
    Parameter::RearStiffness,
    Parameter::YawInertia,
    Parameter::Friction,
];

/// The parameters that the paper identifies, as a page sets them.
const NAMES: [&str; 3] = ["C<sub>f</sub>", "C<sub>r</sub>", "I<sub>z</sub>"];

/// The validation on the other drive.
fn validation(report: &Report) -> Option<&Identification> {
    let validated = report.validated.first();
    validated.map(|validated| &validated.identification)
}

/// How much of an output the model reproduces on the other drive, in per cent.
fn fit(report: &Report, output: Output) -> Option<f64> {
    let outputs = &validation(report)?.score.outputs;
    let found = outputs.iter().find(|one| one.output == output);
    found.map(|one| one.fit_percent)
}

/// The normalised mean prediction error over all outputs, by the definitions in use: mean and root
/// mean square of the error, over what the measured output varies by.
fn normalised_errors(report: &Report) -> Option<[f64; 4]> {
    let points = &validation(report)?.simulation;
    let mut sums = [0.0; 4];
    for output in Output::ALL {
        let pairs = points.iter().map(|point| output.of(point));
        let pairs: Vec<_> = pairs
            .filter(|pair| pair.iter().all(|one| one.is_finite()))
            .collect();
        let mean = |value: &dyn Fn(&[f64; 2]) -> f64| {
            pairs.iter().map(value).sum::<f64>() / pairs.len() as f64
        };
        let centre = mean(&|[y, _]| *y);
        let absolute = mean(&|[y, model]| (y - model).abs());
        let squares = mean(&|[y, model]| (y - model).powi(2)).sqrt();
        let spread = mean(&|[y, _]| (y - centre).powi(2)).sqrt();
        let ends = largest(pairs.iter().map(|[y, _]| *y)) - least(pairs.iter().map(|[y, _]| *y));
        let size = mean(&|[y, _]| y.abs());
        let errors = [
            absolute / spread,
            squares / spread,
            absolute / size,
            squares / ends,
        ];
        for (sum, error) in sums.iter_mut().zip(errors) {
            *sum += error / Output::ALL.len() as f64;
        }
    }
    Some(sums)
}

fn claims(setup: &Setup, [report, friction, other]: [Option<&Report>; 3], section: &mut Section) {
    // In per cent of the truth.
    let error_of = |report: Option<&Report>, parameter| {
        let estimate = report?.identified.identification.estimate(parameter)?;
        Some(100.0 * (estimate.value / truth(&setup.vehicle, parameter) - 1.0))
    };
    let [c_f, c_r, i_z] = Parameter::VEHICLE.map(|one| error_of(report, one));
    let friction = error_of(friction, Parameter::Friction);
    section
        .claim(
            ("model-identified", Scope::RealCar, "%"),
            "C_f, C_r and I_z can be identified from drives",
            "\"identified using the normalised mean prediction error\"; no intervals: taken as \
             within 10 %, C_r within 3 %",
            "from a minute of the simulated car, whose plant shares the code of the axles with \
             model and fit: it tests the fit, not the model",
        )
        .number("C_f off by", c_f, Near(0.0, 10.0))
        .number("C_r off by", c_r, Near(0.0, 3.0))
        .number("I_z off by", i_z, Near(0.0, 10.0));
    section
        .claim(
            ("friction-identified", Scope::RealCar, "%"),
            "The friction coefficient of the tyres can be identified, too",
            "0.25 in the table of identified data; no interval: taken as within 10 %",
            "with C_f, C_r and I_z from the same drive, whose tyres saturate",
        )
        .number("off by", friction, Near(0.0, 10.0));
    let [c_f, c_r, i_z] = Parameter::VEHICLE.map(|one| error_of(other, one));
    section
        .claim(
            ("model-identified-other", Scope::RealCar, "%"),
            "The parameters are found on a car with other equations",
            "identified on a real car, which no model equals; no number: taken as within 20 %",
            "the car that is driven has exact slip angles and the tyres of the magic formula, with \
             the same stiffnesses; the fitted model has small angles and tyres of its own",
        )
        .number("C_f off by", c_f, Near(0.0, 20.0))
        .number("C_r off by", c_r, Near(0.0, 20.0))
        .number("I_z off by", i_z, Near(0.0, 20.0));
    let fit = |output| fit(report?, output);
    section
        .claim(
            ("model-valid", Scope::RealCar, "%"),
            "The single-track model reproduces the dynamics of another drive",
            "\"able to correctly reproduce the relevant vehicle dynamics\"; no number: taken as \
             a fit above 80 %",
            "the simulated car's tyres saturate at μ = 0.25, and so do those of the model that \
             is fitted here; the paper's are linear",
        )
        .number("yaw rate", fit(Output::YawRate), Above(80.0))
        .number("sideslip", fit(Output::Sideslip), Above(80.0));
    let errors = report.and_then(normalised_errors);
    let nmpe = section.claim(
        ("model-nmpe", Scope::Nobody, ""),
        "The normalised mean prediction error is low",
        "0.58, without a unit and without its definition",
        "by four definitions in use, of a simulated car; none is known to be the paper's",
    );
    for (index, label) in [
        "mean error over deviation",
        "RMS error over deviation",
        "mean error over mean size",
        "RMS error over range",
    ]
    .into_iter()
    .enumerate()
    {
        nmpe.number(label, errors.map(|errors| errors[index]), Near(0.58, 0.005));
    }
    section
        .claim(
            ("similitude", Scope::AnyCar, ""),
            "A scaled car is similar to a real one",
            "\"identical, after accounting for the dimensional scaling of each parameter\": \
             eigenvalues in the ratio of the time scales",
            "both laws, with a car 10 times as long and 850 times as heavy on a time scale √10 \
             times as long; gravity and friction enter only where the tyres slide",
        )
        .number("differ by", assumptions::similitude(setup), Near(0.0, 1e-9));
    let [model, exact] = [SlipAngles::Small, SlipAngles::Exact]
        .map(|angles| assumptions::steering_on_circle(setup, angles));
    section
        .claim(
            ("small-angles", Scope::PaperCar, "%"),
            "Sideslip and steering are small enough for sin x = x and cos x = 1",
            "\"small enough\"; no number: taken as a steering angle on the circle within 5 % of \
             the one with exact geometry",
            "the model steers 0.3286 rad where a car with exact slip angles and cos δ, and the \
             same linear tyres, steers 0.3226 rad",
        )
        .number("off by", 100.0 * (model / exact - 1.0), Near(0.0, 5.0));
}

/// The data behind the pictures.
fn tables(setup: &Setup, report: &Report, section: &mut Section) {
    let estimates = Parameter::VEHICLE.into_iter().filter_map(|parameter| {
        let estimate = report.identified.identification.estimate(parameter)?;
        let truth = truth(&setup.vehicle, parameter);
        let [low, high] = estimate.interval;
        Some(vec![truth, estimate.start, estimate.value, low, high])
    });
    let rows = estimates.collect();
    let header = "truth,start,estimate,interval_low,interval_high".to_owned();
    section.table("model-estimates", Table { header, rows });
    let points = validation(report).map(|validation| &validation.simulation[..]);
    let rows = points.unwrap_or_default().iter().map(|point| {
        let mut row = vec![point.time_s, point.speed_m_s, point.steering_rad];
        row.extend([point.measured_yaw_rad, point.yaw_rad]);
        row.extend(Output::ALL.iter().flat_map(|output| output.of(point)));
        row.extend(point.measured_m.into_iter().chain(point.position_m));
        row
    });
    let header = "time_s,speed_m_s,steering_rad,measured_yaw_rad,yaw_rad,measured_yaw_rate_rad_s,\
                  yaw_rate_rad_s,measured_sideslip_rad,sideslip_rad,measured_left_m_s2,left_m_s2,\
                  measured_x_m,measured_y_m,x_m,y_m"
        .to_owned();
    let rows = rows.collect();
    section.table("model-validation", Table { header, rows });
}

fn plates(setup: &Setup, report: &Report, section: &mut Section) {
    let mut figures = identify::figures(report);
    let mut take = |name: &str| {
        let at = figures.iter().position(|(own, _)| own == name)?;
        Some(figures.swap_remove(at).1)
    };
    let found = &report.identified.identification;
    let estimates: Vec<String> = Parameter::VEHICLE
        .into_iter()
        .zip(NAMES)
        .filter_map(|(parameter, html)| {
            let estimate = found.estimate(parameter)?;
            let truth = truth(&setup.vehicle, parameter);
            Some(format!(
                "{html} = {} ({} in truth)",
                with_digits(estimate.value, 4),
                with_digits(truth, 5)
            ))
        })
        .collect();
    if let Some(figure) = take("validation-inputs") {
        section.plate(
            "Inputs and trajectory of the validation",
            "Part of the inputs, speed and steering, and the vehicle's trajectory.",
            format!(
                "Ten seconds of the second drive, and the path that the model drives from the \
                 first pose on, given the speed. Identified from the first: {}.",
                estimates.join(", ")
            ),
            vec![Picture::new("model-inputs", "", figure)],
        );
    }
    let Some(figure) = take("validation-states") else {
        return;
    };
    let told = |value: Option<f64>, unit: &str| {
        value.map_or_else(
            || "(not validated)".to_owned(),
            |value| format!("{}{unit}", with_digits(value, 3)),
        )
    };
    section.plate(
        "Simulation against data",
        "Experimental data (black) and the single-track simulation (grey) of four states, in good \
         accordance; an NMPE of 0.58, whose definition is not in the paper.",
        format!(
            "The same of the second drive, with the simulation (black) over the data (grey), of which noise \
             would hide it: the model fits {} of the yaw rate, {} of the sideslip \
             and {} of the lateral acceleration, an NMPE of {} ({} on the drive that it was \
             identified from).",
            told(fit(report, Output::YawRate), " %"),
            told(fit(report, Output::Sideslip), " %"),
            told(fit(report, Output::Left), " %"),
            told(validation(report).map(|found| found.score.nmpe), ""),
            with_digits(found.score.nmpe, 3)
        ),
        vec![Picture::new("model-states", "", figure)],
    );
}
