//! Findings as a page for people.

use std::fmt::Write as _;

use crate::{Finding, Interval, Parameter, Verdict};

/// The subject of a page.
#[derive(Clone, Copy, Debug)]
pub struct About<'a> {
    /// The procedure, such as `doctor`.
    pub procedure: &'a str,
    /// When it ended.
    pub date: &'a str,
    /// The number of the car.
    pub car_id: u16,
    /// The hash of the configuration at the end.
    pub configuration: u64,
    /// Files with figures, beside the page, each with a title.
    pub figures: &'a [(String, String)],
    /// What changed in the configuration, as a unified diff.
    pub diff: &'a str,
}

/// A page in Markdown: findings, measured values, and things to do.
pub fn page(about: &About<'_>, findings: &[Finding]) -> String {
    let mut page = String::new();
    let _ = writeln!(
        page,
        "# {} of car {}\n\n{}, configuration {:016x}\n",
        about.procedure, about.car_id, about.date, about.configuration
    );
    let _ = writeln!(page, "{}\n", summary(findings));
    page.push_str("| step | verdict | found | should be |\n|---|---|---|---|\n");
    for finding in findings {
        let (found, expected) = (cell(&finding.found), cell(&finding.expected));
        let (step, verdict) = (&finding.step, finding.verdict.name());
        let _ = writeln!(page, "| {step} | {verdict} | {found} | {expected} |");
    }
    let to_do: Vec<_> = findings.iter().filter(|one| !one.fix.is_empty()).collect();
    if !to_do.is_empty() {
        page.push_str("\n## To do\n\n");
        for finding in to_do {
            let _ = writeln!(page, "- {}: {}", finding.step, finding.fix);
        }
    }
    if findings.iter().any(|one| !one.parameters.is_empty()) {
        page.push_str("\n## Measured\n\n");
        page.push_str(
            "| parameter | value | 95 % interval | unit | written, and why |\n|---|---|---|---|---|\n",
        );
        for parameter in findings.iter().flat_map(|one| &one.parameters) {
            let [value, interval] = digits(&parameter.estimate);
            let written = parameter.key.as_ref().map(|(key, value)| {
                let value = value.to_string();
                let because = if parameter.why.is_empty() { "" } else { ": " };
                format!("`{key} = {}`{because}{}", value.trim(), parameter.why)
            });
            let written = written.unwrap_or_default();
            let Parameter { name, unit, .. } = parameter;
            let _ = writeln!(
                page,
                "| {name} | {value} | {interval} | {unit} | {written} |"
            );
        }
    }
    if !about.figures.is_empty() {
        page.push_str("\n## Figures\n\n");
        for (file, title) in about.figures {
            let _ = writeln!(page, "![{title}]({file})\n");
        }
    }
    if !about.diff.is_empty() {
        let _ = write!(page, "\n## Changes\n\n```diff\n{}```\n", about.diff);
    }
    page
}

/// The number of steps by verdict, in one line.
pub fn summary(findings: &[Finding]) -> String {
    use Verdict::{Failed, Good, Skipped, Warning};
    let counts = [Good, Warning, Failed, Skipped].map(|verdict| {
        let count = findings.iter().filter(|one| one.verdict == verdict).count();
        (count > 0).then(|| format!("{count} {}", verdict.name()))
    });
    let counts: Vec<String> = counts.into_iter().flatten().collect();
    format!("{} steps: {}", findings.len(), counts.join(", "))
}

/// A parameter on one line, with its interval.
pub fn line(parameter: &Parameter) -> String {
    let [value, interval] = digits(&parameter.estimate);
    let Parameter { name, unit, .. } = parameter;
    format!("{name} {value} {unit} (95 %: {interval})")
}

/// The value and the ends of an interval, whose half width then has two digits.
fn digits(estimate: &Interval) -> [String; 2] {
    let half_width = estimate.half_width();
    let digits = match half_width.is_finite() && half_width > 0.0 {
        true => (1.0 - half_width.log10().floor()).clamp(0.0, 9.0) as usize,
        false => 3,
    };
    let Interval { value, low, high } = estimate;
    [
        format!("{value:.digits$}"),
        format!("{low:.digits$} to {high:.digits$}"),
    ]
}

/// A text as a cell of a table.
fn cell(text: &str) -> String {
    text.replace('|', "\\|").replace('\n', " ")
}

#[cfg(test)]
mod tests {
    use serde::Deserialize as _;
    use serde_json::{Value, json};

    use super::*;

    fn finding() -> Finding {
        Finding {
            step: "geometry".into(),
            verdict: Verdict::Warning,
            found: "4 passes | 2.0 m".to_owned(),
            expected: "straight".to_owned(),
            fix: "roll it again".to_owned(),
            parameters: vec![
                Parameter {
                    name: "pulse-distance".into(),
                    unit: "um".into(),
                    estimate: Interval::around(3_012.4, 21.0),
                    key: Some(("board.speed.pulse_distance_um".into(), 3012.into())),
                    why: "by the board's clock".into(),
                },
                Parameter {
                    name: "body-left".into(),
                    unit: "m".into(),
                    estimate: Interval::around(-0.0021, 0.0004),
                    key: None,
                    why: "".into(),
                },
            ],
        }
    }

    fn from_json(json: Value) -> Option<Finding> {
        Finding::deserialize(json).ok()
    }

    #[test]
    fn a_finding_survives_json() {
        let json: Value = serde_json::from_str(&json!(finding()).to_string()).unwrap();
        let back = from_json(json).unwrap();
        assert_eq!(json!(back), json!(finding()));
        assert_eq!(back.verdict, Verdict::Warning);
    }

    #[test]
    fn json_that_is_no_finding_is_refused() {
        let whole = json!(finding());
        for key in ["step", "verdict", "found", "expected", "fix", "parameters"] {
            let mut broken = whole.clone();
            broken.as_object_mut().unwrap().remove(key);
            assert!(from_json(broken).is_none(), "{key}");
        }
        let mut broken = whole.clone();
        broken["verdict"] = "perfect".into();
        assert!(from_json(broken).is_none());
        let mut broken = whole;
        broken["parameters"][0]
            .as_object_mut()
            .unwrap()
            .remove("toml");
        assert!(from_json(broken).is_none());
    }

    #[test]
    fn the_page_says_what_was_found_measured_and_changed() {
        let page = page(
            &About {
                procedure: "doctor",
                date: "2026-01-02 10:00 UTC",
                car_id: 7,
                configuration: 0xabc,
                figures: &[("latency.svg".to_owned(), "Latency".to_owned())],
                diff: "-a\n+b\n",
            },
            &[finding()],
        );
        for part in [
            "# doctor of car 7\n",
            "configuration 0000000000000abc",
            "1 steps: 1 warning",
            "| geometry | warning | 4 passes \\| 2.0 m | straight |",
            "- geometry: roll it again",
            "| pulse-distance | 3012 | 2991 to 3033 | um | `board.speed.pulse_distance_um = 3012`: by the board's clock |",
            "| body-left | -0.00210 | -0.00250 to -0.00170 | m |  |",
            "![Latency](latency.svg)",
            "```diff\n-a\n+b\n```",
        ] {
            assert!(page.contains(part), "{part} is missing in:\n{page}");
        }
    }
}
