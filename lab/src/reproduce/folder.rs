//! The folder of a reproduction; it holds no other files.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize};
use singletrack_control::VehicleParameters;
use singletrack_figures::output::{self, WriteError, make_folder};
use singletrack_scenario::csv_text::csv_text;

use super::{claims::Claim, report, section::Reproduction, setup::ReproduceError, table};

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
pub(super) fn prepare(folder: &Path) -> Result<(), ReproduceError> {
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
fn earlier(folder: &Path) -> Result<Vec<PathBuf>, ReproduceError> {
    let mut entries = fs::read_dir(folder).map_err(WriteError::of(folder))?;
    let Some(first) = entries.next() else {
        return Ok(Vec::new());
    };
    let first = first.map_err(WriteError::of(folder))?.file_name();
    let foreign = || ReproduceError::Foreign {
        path: folder.to_owned(),
        found: first.to_string_lossy().into_owned(),
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

/// Writes everything in place of an earlier reproduction; returns the path of the
/// report. `claims.json`, which lists the files, is written first, so that an
/// interrupted reproduction can be overwritten.
pub(super) fn write(folder: &Path, reproduction: &Reproduction) -> Result<PathBuf, ReproduceError> {
    let mut texts = texts(reproduction);
    let mut files: Vec<String> = texts.iter().map(|(name, _)| name.clone()).collect();
    files.push(CLAIMS_JSON.to_owned());
    let earlier = earlier(folder)?;
    let outdated = || {
        let kept = |file: &&PathBuf| files.iter().any(|name| Path::new(name) == *file);
        earlier.iter().filter(move |file| !kept(file))
    };
    let listed = |files: &[String]| {
        let json = Json {
            vehicle: reproduction.setup.vehicle,
            quick: reproduction.setup.quick,
            claims: &reproduction.claims,
            files,
        };
        serde_json::to_string_pretty(&json)
            .map(|text| text + "\n")
            .map_err(|error| WriteError::of(&folder.join(CLAIMS_JSON))(io::Error::other(error)))
    };
    let mut all = files.clone();
    all.extend(outdated().map(|file| file.to_string_lossy().into_owned()));
    put(folder, CLAIMS_JSON, &listed(&all)?)?;
    for file in outdated() {
        match fs::remove_file(folder.join(file)) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                return Err(WriteError::of(&folder.join(file))(error).into());
            }
            _ => {}
        }
    }
    texts.push((CLAIMS_JSON.to_owned(), listed(&files)?));
    for (name, text) in &texts {
        put(folder, name, text)?;
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
    let claims = &reproduction.claims;
    texts.push((CLAIMS_CSV.to_owned(), csv(claims)));
    texts.push((CLAIMS_MARKDOWN.to_owned(), table::markdown(claims)));
    texts.push((REPORT.to_owned(), report::report(reproduction)));
    texts
}

/// Writes a file, and the folder that it is in.
fn put(folder: &Path, name: &str, text: &str) -> Result<(), WriteError> {
    let path = folder.join(name);
    make_folder(path.parent().unwrap_or(folder))?;
    output::write(&path, text)
}

/// `claims.json`.
#[derive(Serialize)]
struct Json<'a> {
    vehicle: VehicleParameters,
    quick: bool,
    claims: &'a [Claim],
    /// What this reproduction wrote, relative to the folder.
    files: &'a [String],
}

/// The columns of `claims.csv`.
const COLUMNS: &str =
    "id,section,claim,paper,quantity,measured,unit,agrees_if,should_be,verdict,expected,why";

/// A row for each number of each claim.
fn csv(claims: &[Claim]) -> String {
    let mut rows = Vec::new();
    for claim in claims {
        for number in &claim.quantities {
            let value = number.value.map(|value| value.to_string());
            let instead = number.instead.map(String::from);
            rows.push([
                claim.id.clone(),
                claim.section.to_string(),
                claim.claim.clone(),
                claim.paper.clone(),
                number.name.clone(),
                value.unwrap_or_default(),
                claim.unit.clone(),
                number.agrees.to_string(),
                instead.unwrap_or_default(),
                claim.verdict.name().to_owned(),
                if claim.surprise.is_some() {
                    "no"
                } else {
                    "yes"
                }
                .to_owned(),
                claim.why.clone(),
            ]);
        }
    }
    format!("{COLUMNS}\n{}", csv_text(rows))
}

#[cfg(test)]
mod tests {
    use super::*;

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
        let setup = super::super::Setup {
            vehicle: VehicleParameters::paper(),
            name: String::new(),
            quick: true,
        };
        let table = |name: &str| {
            let table = crate::table::Table::of(&[1.0], &[("t", |t| *t)]);
            (name.to_owned(), table)
        };
        let section = super::super::Section {
            tables: vec![table("one"), table("two")],
            ..super::super::Section::default()
        };
        Reproduction {
            setup,
            sections: vec![section],
            claims: Vec::new(),
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
}
