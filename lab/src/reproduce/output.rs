//! What a reproduction writes: the claims on standard output, and a folder with the report, its
//! figures, its data and the claims as files. The folder holds no other files.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize};
use singletrack_control::VehicleParameters;
use singletrack_figures::{
    figure::escaped,
    output::{self, WriteError, make_folder},
};
use singletrack_scenario::csv_text::csv_text;

use super::{
    Reproduction,
    section::{Claim, Plate, Quantity, Section, Verdict, number, with_digits},
    surprises,
};
use crate::Result;

/// The names of the files.
const REPORT: &str = "report.html";
const CLAIMS_JSON: &str = "claims.json";
const CLAIMS_CSV: &str = "claims.csv";
const CLAIMS_MARKDOWN: &str = "claims.md";
/// Folders.
const FIGURES: &str = "figures";
const DATA: &str = "data";

/// Makes the folder, and checks that it can be written to and holds no other files. An
/// earlier reproduction stays until the new one is computed, minutes later.
pub(super) fn prepare(folder: &Path) -> Result {
    make_folder(folder)?;
    earlier(folder)?;
    tempfile::tempfile_in(folder).map_err(WriteError::of(folder))?;
    Ok(())
}

/// The list of files in `claims.json`.
#[derive(Deserialize)]
struct Contents {
    files: Vec<PathBuf>,
}

/// The files of an earlier reproduction; none in an empty folder.
fn earlier(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut entries = fs::read_dir(folder).map_err(WriteError::of(folder))?;
    let Some(first) = entries.next() else {
        return Ok(Vec::new());
    };
    let first = first.map_err(WriteError::of(folder))?.file_name();
    let foreign = || {
        format!(
            "{} holds files that are not of an earlier reproduction ({}); choose another folder with \
             --out",
            folder.display(),
            first.to_string_lossy()
        )
    };
    let text = fs::read_to_string(folder.join(CLAIMS_JSON)).map_err(|_| foreign())?;
    let contents: Contents = serde_json::from_str(&text).map_err(|_| foreign())?;
    // A file may say anything; only what could be ours is removed.
    let ours = |file: &PathBuf| match (file.parent(), file.file_name()) {
        (Some(folder), Some(name)) if folder == Path::new("") => {
            [REPORT, CLAIMS_JSON, CLAIMS_CSV, CLAIMS_MARKDOWN]
                .iter()
                .any(|own| name == *own)
        }
        (Some(folder), Some(_)) => folder == Path::new(FIGURES) || folder == Path::new(DATA),
        _ => false,
    };
    Ok(contents.files.into_iter().filter(ours).collect())
}

/// `claims.json`.
#[derive(Serialize)]
struct Json<'a> {
    vehicle: VehicleParameters,
    quick: bool,
    claims: Vec<&'a Claim>,
    /// What this reproduction wrote, relative to the folder.
    files: Vec<&'a str>,
}

/// Writes everything in place of an earlier reproduction; returns the path of the
/// report. `claims.json`, which lists the files, is written first, so that an
/// interrupted reproduction can be overwritten.
pub(super) fn write(folder: &Path, reproduction: &Reproduction) -> Result<PathBuf> {
    for file in earlier(folder)? {
        // The list of what is left stays until there is a new one.
        if file == Path::new(CLAIMS_JSON) {
            continue;
        }
        let path = folder.join(file);
        match fs::remove_file(&path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                return Err(WriteError::of(&path)(error).into());
            }
            _ => {}
        }
    }
    let texts = texts(reproduction);
    let names = texts.iter().map(|(name, _)| name.as_str());
    let json = Json {
        vehicle: reproduction.setup.vehicle,
        quick: reproduction.setup.quick,
        claims: reproduction.claims().collect(),
        files: names.chain([CLAIMS_JSON]).collect(),
    };
    let json = serde_json::to_string_pretty(&json)
        .map_err(|error| WriteError::of(&folder.join(CLAIMS_JSON))(io::Error::other(error)))?;
    output::write(&folder.join(CLAIMS_JSON), &(json + "\n"))?;
    for (name, text) in &texts {
        let path = folder.join(name);
        make_folder(path.parent().unwrap_or(folder))?;
        output::write(&path, text)?;
    }
    Ok(folder.join(REPORT))
}

/// The files but `claims.json`, each with its text.
fn texts(reproduction: &Reproduction) -> Vec<(String, String)> {
    let mut texts = Vec::new();
    for section in &reproduction.sections {
        for picture in section.plates.iter().flat_map(|plate| &plate.pictures) {
            let name = format!("{FIGURES}/{}.svg", picture.name);
            texts.push((name, picture.figure.to_svg()));
        }
        for (name, table) in &section.tables {
            texts.push((format!("{DATA}/{name}.csv"), table.to_csv()));
        }
    }
    texts.push((CLAIMS_CSV.to_owned(), csv(reproduction.claims())));
    texts.push((CLAIMS_MARKDOWN.to_owned(), markdown(reproduction.claims())));
    texts.push((REPORT.to_owned(), report(reproduction)));
    texts
}

/// The columns of `claims.csv`.
const COLUMNS: &str =
    "id,section,claim,paper,quantity,measured,unit,agrees_if,should_be,verdict,expected,why";

/// A row for each number of each claim.
fn csv<'a>(claims: impl Iterator<Item = &'a Claim>) -> String {
    let mut rows = Vec::new();
    for claim in claims {
        for quantity in &claim.quantities {
            let value = quantity.value.map(|value| value.to_string());
            let should_be = quantity.should_be.map(|criterion| criterion.to_string());
            let expected = if claim.surprise.is_some() {
                "no"
            } else {
                "yes"
            };
            rows.push([
                claim.id.to_owned(),
                claim.section.to_string(),
                claim.claim.clone(),
                claim.paper.clone(),
                quantity.label.to_owned(),
                value.unwrap_or_default(),
                claim.unit.to_owned(),
                quantity.agrees_if.to_string(),
                should_be.unwrap_or_default(),
                claim.verdict.name().to_owned(),
                expected.to_owned(),
                claim.why.clone(),
            ]);
        }
    }
    format!("{COLUMNS}\n{}", csv_text(rows))
}

/// Prints each claim with its verdict and its numbers, the notes, and the path of the report. A
/// closed pipe is not an error.
pub(super) fn print(reproduction: &Reproduction, report: &Path) {
    let mut text = String::new();
    for claim in reproduction.claims() {
        let mark = if claim.surprise.is_some() { "!" } else { " " };
        text += &format!(
            "{mark} {:12}  {}. {}\n",
            claim.verdict.name(),
            claim.section,
            claim.claim
        );
        text += &format!("{:18}{}\n", "", measured(claim).join("; "));
        if let Some(surprise) = &claim.surprise {
            text += &format!("{:18}UNEXPECTED: {surprise}\n", "");
        }
    }
    for section in &reproduction.sections {
        for note in &section.notes {
            text += &format!("note on section {}: {note}\n", section.number);
        }
    }
    text += &format!("{}\n{}\n", counts(reproduction), report.display());
    let _ = output::print(&text);
}

/// The number of claims by verdict, in a sentence.
fn counts(reproduction: &Reproduction) -> String {
    let claims = reproduction.claims();
    let count = |verdict| claims.clone().filter(|one| one.verdict == verdict).count();
    let mut text = format!(
        "{} claims: {} agree, {} in simulation, {} differ",
        claims.clone().count(),
        count(Verdict::Agrees),
        count(Verdict::AgreesInSimulation),
        count(Verdict::Differs)
    );
    for (verdict, name) in [
        (Verdict::NotComparable, "can't be compared"),
        (Verdict::NotMeasured, "were not measured"),
    ] {
        if count(verdict) > 0 {
            text += &format!(", {} {name}", count(verdict));
        }
    }
    text + &match surprises(claims.clone()) {
        0 => "; all as expected.".to_owned(),
        count => format!("; {count} of them otherwise than expected."),
    }
}

/// Each number with its label.
fn measured(claim: &Claim) -> Vec<String> {
    let quantities = claim.quantities.iter();
    quantities
        .map(|Quantity { label, value, .. }| match value {
            None => format!("{label}: none"),
            // No line break between number and unit.
            Some(value) => format!("{label}: {}\u{a0}{}", with_digits(*value, 4), claim.unit)
                .trim_end()
                .to_owned(),
        })
        .collect()
}

/// The table in Markdown.
fn markdown<'a>(claims: impl Iterator<Item = &'a Claim>) -> String {
    let mut table =
        "| § | claim | the paper | measured | verdict | why |\n|---|---|---|---|---|---|\n"
            .to_owned();
    for claim in claims {
        let mut verdict = claim.verdict.name().to_owned();
        let mut why = claim.why.clone();
        if let Some(surprise) = &claim.surprise {
            verdict = format!("! {verdict}");
            why = format!("UNEXPECTED: {surprise}. {why}");
        }
        let cells = [
            claim.section.to_string(),
            claim.claim.clone(),
            claim.paper.clone(),
            measured(claim).join("; "),
            verdict,
            why,
        ];
        let cells = cells.map(|cell| cell.replace('|', "\\|"));
        table += &format!("| {} |\n", cells.join(" | "));
    }
    table
}

/// The report of a reproduction: one self-contained file.
fn report(reproduction: &Reproduction) -> String {
    let sections = &reproduction.sections;
    format!(
        include_str!("report/page.html"),
        style = singletrack_figures::plot::STYLE,
        own_style = include_str!("report/style.css"),
        subtitle = escaped(&subtitle(reproduction)),
        counts = escaped(&counts(reproduction)),
        contents = sections.iter().map(entry).collect::<String>(),
        claims = reproduction.claims().map(row).collect::<String>(),
        sections = sections.iter().map(body).collect::<String>(),
        vehicle = vehicle(reproduction)
    )
}

fn subtitle(reproduction: &Reproduction) -> String {
    let setup = &reproduction.setup;
    let mut text = format!(
        "Every experiment and analysis in virtual time, with {}: on the ideal plant (the paper's \
         equations, controlled continuously) and on the car (the whole pilot against the \
         simulated car, board and cameras, with lags, delays and noise). No data of the real car \
         are known here: where the car differs from the paper's figures, it is the simulated car \
         that does.",
        setup.name
    );
    if !setup.is_paper() {
        text += &format!(
            " This is not the paper's car: its experiments are driven {} times as large, and the \
             paper's numbers can't be compared.",
            number(setup.scale())
        );
    }
    if !setup.fits_simulated_car() {
        text += " It is another kind of car than the simulated one, which is not driven.";
    }
    if setup.quick {
        text += " A quick run: coarser maps, shorter drives, fewer seeds.";
    }
    text
}

fn entry(section: &Section) -> String {
    format!(
        "<li value=\"{0}\"><a href=\"#section-{0}\">{1}</a></li>\n",
        section.number,
        escaped(section.title)
    )
}

/// The class of a verdict in the style sheet.
const fn class(claim: &Claim) -> &'static str {
    match (claim.verdict, &claim.surprise) {
        (_, Some(_)) => "surprise",
        (Verdict::Agrees | Verdict::AgreesInSimulation, None) => "agrees",
        (Verdict::Differs, None) => "differs",
        (Verdict::NotComparable | Verdict::NotMeasured, None) => "none",
    }
}

/// A text for the page, with subscripts where it has underscores: `l_f`.
fn typeset(text: &str) -> String {
    let text = escaped(text);
    let mut html = String::with_capacity(text.len());
    let mut letters = text.chars().peekable();
    while let Some(letter) = letters.next() {
        match (letter, letters.peek()) {
            ('_', Some(below)) if below.is_ascii_lowercase() => {
                html += &format!("<sub>{below}</sub>");
                letters.next();
            }
            _ => html.push(letter),
        }
    }
    html
}

fn row(claim: &Claim) -> String {
    let class = class(claim);
    let surprise = claim.surprise.iter();
    let surprise: String = surprise
        .map(|text| format!("<strong>Unexpected: {}.</strong> ", escaped(text)))
        .collect();
    let measured: Vec<String> = measured(claim).iter().map(|line| typeset(line)).collect();
    format!(
        "<tr id=\"{}\" class=\"{class}\"><td><a href=\"#section-{}\">{}</a></td><td>{}</td>\
         <td>{}</td><td>{}</td><td><span class=\"verdict\">{}</span></td><td>{surprise}{}</td></tr>\n",
        claim.id,
        claim.section,
        claim.section,
        typeset(&claim.claim),
        typeset(&claim.paper),
        measured.join("<br>"),
        claim.verdict.name(),
        typeset(&claim.why)
    )
}

fn body(section: &Section) -> String {
    let number = section.number;
    let title = escaped(section.title);
    let mut html = format!("<section id=\"section-{number}\">\n<h2>{number}. {title}</h2>\n");
    html += &format!("<p>{}</p>\n", section.intro);
    for note in &section.notes {
        html += &format!("<p class=\"note\">{}</p>\n", escaped(note));
    }
    let own = section.claims.iter().map(|claim| {
        format!(
            "<li class=\"{}\"><a href=\"#{}\">{}</a>: <span class=\"verdict\">{}</span></li>",
            class(claim),
            claim.id,
            typeset(&claim.claim),
            claim.verdict.name()
        )
    });
    let own: String = own.collect();
    if !own.is_empty() {
        html += &format!("<ul class=\"own\">{own}</ul>\n");
    }
    html.extend(section.plates.iter().map(framed));
    let data = section.tables.iter();
    let data = data.map(|(name, _)| format!("<a href=\"data/{name}.csv\">{name}.csv</a>"));
    let data: Vec<String> = data.collect();
    if !data.is_empty() {
        html += &format!("<p class=\"quiet\">Data: {}.</p>\n", data.join(", "));
    }
    html + "</section>\n"
}

fn framed(plate: &Plate) -> String {
    let Plate {
        title,
        paper,
        ours,
        pictures,
    } = plate;
    let said = format!("<p><b>The paper.</b> {paper}</p>\n<p><b>Ours.</b> {ours}</p>");
    if pictures.is_empty() {
        return format!("<h3>{title}</h3>\n{said}\n");
    }
    let three = if pictures.len() == 3 { " three" } else { "" };
    let drawn = pictures.iter().map(|picture| {
        let (width, svg) = (picture.figure.width, picture.figure.to_svg());
        let label = match &picture.label[..] {
            "" => String::new(),
            label => format!("<p class=\"which\">{}</p>", escaped(label)),
        };
        format!("<div class=\"{width} static\">{svg}{label}</div>\n")
    });
    let drawn: String = drawn.collect();
    format!(
        "<figure class=\"plate\">\n<h3>{title}</h3>\n<div class=\"pictures{three}\">\n{drawn}</div>\n\
         <figcaption>{said}</figcaption>\n</figure>\n"
    )
}

fn vehicle(reproduction: &Reproduction) -> String {
    let car = &reproduction.setup.vehicle;
    let [c_f, c_r] = [
        car.front_cornering_stiffness_n_rad,
        car.rear_cornering_stiffness_n_rad,
    ];
    let [l_f, l_r] = [car.front_axle_distance_m, car.rear_axle_distance_m];
    let p = reproduction.setup.point_distance_m();
    [
        ("mass m", car.mass_kg, "kg"),
        ("yaw moment of inertia I_z", car.yaw_inertia_kg_m2, "kg m²"),
        ("centre of mass to front axle l_f", l_f, "m"),
        ("centre of mass to rear axle l_r", l_r, "m"),
        ("friction μ", car.friction, ""),
        ("cornering stiffness, front C_f", c_f, "N/rad"),
        ("cornering stiffness, rear C_r", c_r, "N/rad"),
        ("distance p of P from the front axle", p, "m"),
    ]
    .iter()
    .map(|(name, value, unit)| {
        format!(
            "<tr><th scope=\"row\">{}</th><td>{} {unit}</td></tr>\n",
            typeset(name),
            with_digits(*value, 6)
        )
    })
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Table,
        reproduce::{
            Setup,
            section::{Near, Scope},
        },
    };

    #[test]
    fn a_file_that_names_others_does_not_get_them_removed() {
        let folder = tempfile::tempdir().unwrap();
        let inside = folder.path().join("out");
        fs::create_dir(&inside).unwrap();
        let precious = folder.path().join("precious");
        fs::write(&precious, "mine").unwrap();
        fs::write(inside.join("notes.txt"), "mine").unwrap();
        let named = format!(
            r#"{{"files": ["../precious", "{}", "notes.txt", "data/../../precious"]}}"#,
            precious.display()
        );
        fs::write(inside.join(CLAIMS_JSON), named).unwrap();
        prepare(&inside).unwrap();
        assert!(precious.exists() && inside.join("notes.txt").exists());
    }

    #[test]
    fn a_folder_with_foreign_files_is_not_changed() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("thesis.tex"), "mine").unwrap();
        let error = prepare(folder.path()).unwrap_err().to_string();
        assert!(
            error.contains("thesis.tex") && error.contains("--out"),
            "{error}"
        );
    }

    fn reproduction() -> Reproduction {
        let table = |name: &str| {
            let table = Table::of("t", &[serde_json::json!({ "t": 1.0 })]);
            (name.to_owned(), table)
        };
        let mut section = Section::new(2, "", "");
        section.tables = vec![table("one"), table("two")];
        Reproduction {
            setup: Setup::paper(),
            sections: vec![section],
        }
    }

    #[test]
    fn an_earlier_result_stays_until_there_is_a_new_one_and_then_goes_whole() {
        let folder = tempfile::tempdir().unwrap();
        let mut reproduction = reproduction();
        write(folder.path(), &reproduction).unwrap();
        let (one, two) = (
            folder.path().join("data/one.csv"),
            folder.path().join("data/two.csv"),
        );
        // Interrupted while it computes.
        prepare(folder.path()).unwrap();
        assert!(one.exists() && two.exists());
        reproduction.sections[0].tables.pop();
        write(folder.path(), &reproduction).unwrap();
        assert!(one.exists() && !two.exists());
        // Interrupted while it wrote: the list of what is ours is there first.
        fs::remove_file(folder.path().join(REPORT)).unwrap();
        prepare(folder.path()).unwrap();
        write(folder.path(), &reproduction).unwrap();
        assert!(folder.path().join(REPORT).exists());
    }

    #[test]
    fn a_bar_in_a_cell_is_no_border_in_markdown() {
        let mut section = Section::new(2, "", "");
        let claim = section.claim(
            ("deviation", Scope::AnyCar, "m"),
            "2 |dl|",
            "none",
            "it is so",
        );
        claim.judge(true);
        let table = markdown([&*claim].into_iter());
        assert!(
            table.ends_with("| 2 | 2 \\|dl\\| | none |  | agrees | it is so |\n"),
            "{table}"
        );
    }

    #[test]
    fn an_unexpected_verdict_is_counted_and_marked() {
        let mut section = Section::new(2, "", "");
        let claim = section.claim(
            ("deviation", Scope::AnyCar, "m"),
            "The deviation",
            "1 m",
            "it is so",
        );
        claim.number("ideal", 2.0, Near(1.0, 0.1)).judge(true);
        let mut reproduction = reproduction();
        reproduction.sections.push(section);
        assert_eq!(surprises(reproduction.claims()), 1);
        assert!(counts(&reproduction).ends_with("1 of them otherwise than expected."));
        let report = report(&reproduction);
        assert!(report.contains("Unexpected: ideal 2 m should be 1 ± 0.1 m"));
        assert!(markdown(reproduction.claims()).contains("| ! differs | UNEXPECTED: ideal 2 m"));
    }

    #[test]
    fn underscores_become_subscripts_and_markup_stays_text() {
        assert_eq!(typeset("C_f l_r < 1"), "C<sub>f</sub> l<sub>r</sub> &lt; 1");
        assert_eq!(typeset("a_ b_1 _"), "a_ b_1 _");
    }
}
