//! Model validation: the car identified from one drive, compared with another.

use std::path::Path;

use indicatif::ProgressBar;
use singletrack_analysis::identification::{Identification, Output, Parameter};
use singletrack_control::{SlipAngles, Tyres, VehicleParameters};
use singletrack_scenario::simulate::{self, Scenario};
use singletrack_sim::CarTruth;

use super::{
    Setup, assumptions,
    claims::{above, near},
    largest, least,
    section::{Picture, Section},
    text::with_digits,
};
use crate::{
    Format, Result,
    identify::{self, IdentifyArgs, Report, SlipAngleKind, TyreKind},
    table::Table,
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
        record: vec![record],
        validate: vec![other],
        config: None,
        vehicle: Some(start),
        parameters: parameters.to_vec(),
        tyres: TyreKind::Saturating,
        slip_angles: SlipAngleKind::Small,
        drive: None,
        least_speed: 0.5,
        out: None,
        format: Format::Table,
        validate_nominal: false,
    })
}

fn truth(vehicle: &VehicleParameters, parameter: Parameter) -> f64 {
    singletrack_analysis::identification::Values::of(vehicle).get(parameter)
}

pub(super) fn section(setup: &Setup, section: &mut Section, progress: &ProgressBar) {
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
    claims(setup, reports, section);
    let Some(report) = report else { return };
    tables(setup, &report, section);
    plates(setup, &report, section);
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
        .claim("model-identified")
        .number("C_f off by", c_f, near(0.0, 10.0))
        .number("C_r off by", c_r, near(0.0, 3.0))
        .number("I_z off by", i_z, near(0.0, 10.0));
    section
        .claim("friction-identified")
        .number("off by", friction, near(0.0, 10.0));
    let [c_f, c_r, i_z] = Parameter::VEHICLE.map(|one| error_of(other, one));
    section
        .claim("model-identified-other")
        .number("C_f off by", c_f, near(0.0, 20.0))
        .number("C_r off by", c_r, near(0.0, 20.0))
        .number("I_z off by", i_z, near(0.0, 20.0));
    let fit = |output| fit(report?, output);
    section
        .claim("model-valid")
        .number("yaw rate", fit(Output::YawRate), above(80.0))
        .number("sideslip", fit(Output::Sideslip), above(80.0));
    let [first, second, third, fourth] = match report.and_then(normalised_errors) {
        Some(errors) => errors.map(Some),
        None => [None; 4],
    };
    let papers = near(0.58, 0.005);
    section
        .claim("model-nmpe")
        .number("mean error over deviation", first, papers)
        .number("RMS error over deviation", second, papers)
        .number("mean error over mean size", third, papers)
        .number("RMS error over range", fourth, papers);
    section.claim("similitude").number(
        "differ by",
        assumptions::similitude(setup),
        near(0.0, 1e-9),
    );
    let [model, exact] = [SlipAngles::Small, SlipAngles::Exact]
        .map(|angles| assumptions::steering_on_circle(setup, angles));
    section
        .claim("small-angles")
        .number("off by", 100.0 * (model / exact - 1.0), near(0.0, 5.0));
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
    let told = |value: Option<f64>, unit: &str| {
        value.map_or_else(
            || "(not validated)".to_owned(),
            |value| format!("{}{unit}", with_digits(value, 3)),
        )
    };
    let validated = validation(report).map(|found| found.score.nmpe);
    section.facts([
        ("estimates", estimates.join(", ")),
        ("yaw rate", told(fit(report, Output::YawRate), " %")),
        ("sideslip", told(fit(report, Output::Sideslip), " %")),
        (
            "lateral acceleration",
            told(fit(report, Output::Left), " %"),
        ),
        ("validated nmpe", told(validated, "")),
        ("identified nmpe", told(Some(found.score.nmpe), "")),
    ]);
    for what in ["inputs", "states"] {
        if let Some(figure) = take(&format!("validation-{what}")) {
            let picture = Picture::new(format!("model-{what}"), "", figure);
            section.plate(what, vec![picture]);
        }
    }
}
