//! The result for a person.

use std::fmt::Write as _;

use singletrack_analysis::identification::{Criterion, Estimate, Parameter, Score, ServoFrames};

use super::{
    Identified, Report,
    output::{speeds, taken_as_exact},
};

/// How a parameter is shown: its unit there, how many of them make one of its own, and
/// digits behind the point.
const fn shown(parameter: Parameter) -> (&'static str, f64, usize) {
    match parameter {
        Parameter::FrontStiffness | Parameter::RearStiffness => ("N/rad", 1.0, 3),
        Parameter::YawInertia => ("kg m²", 1.0, 6),
        Parameter::FrontAxleDistance => ("mm", 1e3, 2),
        Parameter::Friction | Parameter::SteeringGain | Parameter::GyroScale => ("", 1.0, 4),
        Parameter::ServoLag | Parameter::SteeringDelay | Parameter::InertialDelay => ("ms", 1e3, 3),
        Parameter::SteeringTrim => ("mrad", 1e3, 3),
        Parameter::LateralBias => ("mm/s²", 1e3, 1),
    }
}

pub(super) fn table(report: &Report) -> String {
    let mut text = String::new();
    // Writing to a string does not fail.
    let _ = write(&mut text, report);
    text
}

fn write(text: &mut String, report: &Report) -> std::fmt::Result {
    let Identified {
        logs,
        identification,
    } = &report.identified;
    let speeds = speeds(identification);
    for log in logs {
        writeln!(text, "{}, drive {}", log.path.display(), log.drive)?;
    }
    writeln!(
        text,
        "{:.1} s at {:.2} to {:.2} m/s; tyres {}; servo pulses from {} records; minimised: error of the {}",
        identification.seconds(),
        speeds[0],
        speeds[1],
        report.tyres.name(),
        match identification.frames {
            ServoFrames::Every => "all",
            frames => frames.name(),
        },
        identification.criterion.name(),
    )?;
    writeln!(
        text,
        "\n{:14}{:>12} {:6}{:>26}{:>9}{:>12}",
        "parameter", "estimate", "", "95 % interval", "±", "start"
    )?;
    for estimate in &identification.estimates {
        row(text, estimate)?;
    }
    let exact: Vec<String> = taken_as_exact(report)
        .map(|(name, value)| format!("{name} ({value})"))
        .collect();
    writeln!(text, "\nthe intervals take as exact: {}", exact.join(", "))?;
    writeln!(
        text,
        "with 1 % more mass c_f, c_r and i_z are 1 % more; the others can be estimated jointly \
         (--parameters)"
    )?;
    writeln!(text, "\ncorrelation")?;
    let names = identification.estimates.iter();
    let names = names.map(|estimate| estimate.parameter.name());
    write!(text, "{:14}", "")?;
    for name in names {
        write!(text, "{name:>13}")?;
    }
    writeln!(text)?;
    for (row, estimate) in identification.estimates.iter().enumerate() {
        write!(text, "{:14}", estimate.parameter.name())?;
        for column in 0..=row {
            write!(text, "{:>13.3}", identification.correlation[(row, column)])?;
        }
        writeln!(text)?;
    }
    if identification.criterion == Criterion::Prediction {
        let noise = &identification.noise;
        writeln!(
            text,
            "\nnoise: position {:.2} mm, yaw {:.2} mrad, gyro {:.2} mrad/s, acceleration {:.3} m/s², \
         unexplained force {:.2} mN/√Hz an axle",
            1e3 * noise.position_m,
            1e3 * noise.yaw_rad,
            1e3 * noise.yaw_rate_rad_s,
            noise.left_m_s2,
            1e3 * noise.force_density,
        )?;
    }
    writeln!(
        text,
        "\nthe model left alone with speed and servo pulses, beside what was measured:"
    )?;
    for (what, log) in report.logs() {
        writeln!(text, "{}, drive {}", log.path.display(), log.drive)?;
        score(text, what, &log.score)?;
    }
    writeln!(
        text,
        "NMPE: mean |model - measured| over the standard deviation of the measured, and the mean of that \
         over the outputs."
    )
}

fn row(text: &mut String, estimate: &Estimate) -> std::fmt::Result {
    let (unit, scale, digits) = shown(estimate.parameter);
    let [low, high] = estimate.interval.map(|end| scale * end);
    let relative = 100.0 * estimate.standard_deviation / estimate.value.abs();
    let part = if Parameter::NUISANCE.contains(&estimate.parameter) {
        String::new()
    } else {
        format!("{:.2} %", 1.96 * relative)
    };
    writeln!(
        text,
        "{:14}{:>12.digits$} {unit:6}{:>26}{part:>9}{:>12.digits$}",
        estimate.parameter.name(),
        scale * estimate.value,
        format!("{low:.digits$} to {high:.digits$}"),
        scale * estimate.start,
    )
}

fn score(text: &mut String, what: &str, score: &Score) -> std::fmt::Result {
    writeln!(text, "{what:15} NMPE {:.4}", score.nmpe)?;
    for output in &score.outputs {
        writeln!(
            text,
            "  {:18} NMPE {:.4}  fit {:5.1} %  rms {:.5}",
            output.output.name(),
            output.nmpe,
            output.fit_percent,
            output.rms
        )?;
    }
    Ok(())
}
