//! Result files: shards join to the file of one process, and nothing else joins.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::{
    fs,
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize};
use singletrack_campaign::{
    Campaign, CampaignArgs, Experiment, Result, ResultFile, Shard, merge_files,
};
use tempfile::TempDir;

/// Numbers that a decimal text must not change.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Thirds {
    units: u64,
    divisor: f64,
}

const THIRDS: Thirds = Thirds {
    units: 10,
    divisor: 3.0,
};

impl Experiment for Thirds {
    const NAME: &'static str = "thirds";
    type Result = f64;

    fn units(&self) -> u64 {
        self.units
    }

    fn run(&self, unit: u64) -> Result<f64> {
        Ok(1e-7 * unit as f64 / self.divisor)
    }
}

fn run(experiment: Thirds, shard: &str, path: &Path) -> Campaign<Thirds> {
    let arguments = CampaignArgs {
        shard: Some(shard.parse().unwrap()),
        json: Some(path.to_owned()),
        threads: Some(2),
        ..CampaignArgs::default()
    };
    Campaign::obtain(experiment, &arguments).unwrap()
}

/// The files of the shards of `of`.
fn shards(folder: &TempDir, of: u64) -> Vec<PathBuf> {
    let shard = |index| {
        let path = folder.path().join(format!("{index}-of-{of}.jsonl"));
        run(THIRDS, &format!("{index}/{of}"), &path);
        path
    };
    (1..=of).map(shard).collect()
}

fn refusal(files: &[PathBuf]) -> String {
    merge_files(files).unwrap_err().to_string()
}

#[test]
fn any_number_of_shards_joins_to_the_file_of_one_process() {
    let folder = tempfile::tempdir().unwrap();
    let whole = folder.path().join("whole.jsonl");
    let one = run(THIRDS, "1/1", &whole);
    let text = fs::read_to_string(&whole).unwrap();
    assert_eq!(text.lines().count(), 11);
    for of in [1, 2, 3, 10, 13] {
        let mut files = shards(&folder, of);
        files.reverse();
        assert_eq!(merge_files(&files).unwrap().text().unwrap(), text);
        let read = Campaign::<Thirds>::obtain(
            Thirds {
                units: 0,
                divisor: 0.0,
            },
            &CampaignArgs {
                from: files,
                ..CampaignArgs::default()
            },
        );
        let read = read.unwrap();
        assert_eq!(read.experiment.units, 10);
        let bits = |campaign: &Campaign<Thirds>| -> Vec<(u64, u64)> {
            let results = campaign.results.iter();
            results
                .map(|(unit, value)| (*unit, value.to_bits()))
                .collect()
        };
        assert_eq!(bits(&read), bits(&one));
    }
    // What is merged can be merged again.
    let again = merge_files(std::slice::from_ref(&whole)).unwrap();
    assert_eq!(again.text().unwrap(), text);
}

#[test]
fn a_missing_shard_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let mut files = shards(&folder, 4);
    files.remove(2);
    let text = refusal(&files);
    assert!(text.contains("2 of 10 units are missing"), "{text}");
    assert!(text.contains("give also shard 3/4"), "{text}");
    assert!(!refusal(&[]).is_empty());
}

#[test]
fn a_shard_that_is_given_twice_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let mut files = shards(&folder, 3);
    let copy = folder.path().join("copy.jsonl");
    fs::copy(&files[1], &copy).unwrap();
    files.push(copy);
    let text = refusal(&files);
    assert!(
        text.contains("2-of-3.jsonl and in") && text.contains("copy.jsonl"),
        "{text}"
    );
    // Shards of another number overlap.
    let files = [shards(&folder, 2), shards(&folder, 3)].concat();
    assert!(refusal(&files).contains("give each shard once"));
}

#[test]
fn files_of_different_campaigns_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let mut files = shards(&folder, 2);
    let other = folder.path().join("other.jsonl");
    run(
        Thirds {
            divisor: 7.0,
            ..THIRDS
        },
        "2/2",
        &other,
    );
    files[1].clone_from(&other);
    let text = refusal(&files);
    assert!(
        text.contains("the options is") && text.contains("other.jsonl"),
        "{text}"
    );

    let files = shards(&folder, 2);
    let text = fs::read_to_string(&files[1]).unwrap();
    for (from, to, what) in [
        ("\"thirds\"", "\"halves\"", "the campaign"),
        ("\"version\":\"", "\"version\":\"9.", "the version"),
        ("\"program\":\"", "\"program\":\"f", "the build"),
    ] {
        assert!(text.contains(from), "{text}");
        fs::write(&other, text.replacen(from, to, 1)).unwrap();
        let refused = refusal(&[files[0].clone(), other.clone()]);
        assert!(refused.contains(what), "{refused}");
    }
}

#[test]
fn shards_with_another_file_that_decides_the_results_are_refused() {
    #[derive(Debug, Serialize, Deserialize)]
    struct Image {
        #[serde(skip)]
        path: PathBuf,
    }
    impl Experiment for Image {
        const NAME: &'static str = "image";
        type Result = u64;

        fn units(&self) -> u64 {
            2
        }

        fn files(&self) -> Vec<PathBuf> {
            vec![self.path.clone()]
        }

        fn run(&self, unit: u64) -> Result<u64> {
            Ok(unit)
        }
    }
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let shard = |index: u64, image: &str| {
        fs::write(path("image"), image).unwrap();
        let json = path(&format!("{index}-{image}.jsonl"));
        let arguments = CampaignArgs {
            shard: Some(Shard::new(index, 2).unwrap()),
            json: Some(json.clone()),
            ..CampaignArgs::default()
        };
        let image = Image {
            path: path("image"),
        };
        Campaign::obtain(image, &arguments).unwrap();
        json
    };
    let first = shard(1, "old");
    assert!(merge_files(&[first.clone(), shard(2, "old")]).is_ok());
    let refused = refusal(&[first, shard(2, "new")]);
    assert!(refused.contains("the build"), "{refused}");
}

#[test]
fn a_file_that_was_cut_or_changed_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let [file] = shards(&folder, 1).try_into().unwrap();
    let text = fs::read_to_string(&file).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    let last = lines.last().unwrap();
    let cut = |count: usize| lines[..count].join("\n");
    for (broken, reason) in [
        (String::new(), "the file is empty"),
        ("{}".to_owned(), "no header"),
        (text.replacen("\"format\":1", "\"format\":9", 1), "format 9"),
        (text.replacen("\"1/1\"", "\"2/1\"", 1), "no header"),
        (cut(1), "unit 0 of shard 1/1 is missing"),
        (cut(10), "unit 9 of shard 1/1 is missing"),
        (text[..text.len() - 4].to_owned(), "no result of a unit"),
        (format!("{text}{last}\n"), "unit 9 is not the next"),
        (
            cut(5) + "\n" + &lines[6..].join("\n"),
            "unit 5 is not the next",
        ),
        (
            text.replacen("\"unit\":3,", "\"unit\":3,\"unit\":4,", 1),
            "no result of a unit",
        ),
    ] {
        fs::write(&file, broken).unwrap();
        let refused = refusal(std::slice::from_ref(&file));
        assert!(refused.contains(reason), "{refused}");
    }
}

#[test]
fn the_report_about_another_experiment_is_refused() {
    #[derive(Debug, Serialize, Deserialize)]
    struct Other {}
    impl Experiment for Other {
        const NAME: &'static str = "other";
        type Result = f64;

        fn units(&self) -> u64 {
            0
        }

        fn run(&self, _: u64) -> Result<f64> {
            Ok(0.0)
        }
    }
    let folder = tempfile::tempdir().unwrap();
    let arguments = CampaignArgs {
        from: shards(&folder, 2),
        ..CampaignArgs::default()
    };
    let refused = Campaign::obtain(Other {}, &arguments)
        .unwrap_err()
        .to_string();
    assert!(
        refused.contains("\"thirds\"") && refused.contains("\"other\""),
        "{refused}"
    );
}

#[test]
fn a_place_that_cannot_be_written_is_refused_before_the_work() {
    #[derive(Debug, Serialize, Deserialize)]
    struct Never {}
    impl Experiment for Never {
        const NAME: &'static str = "never";
        type Result = ();

        fn units(&self) -> u64 {
            1
        }

        fn run(&self, _: u64) -> Result {
            Err("it was run".into())
        }
    }
    let folder = tempfile::tempdir().unwrap();
    let arguments = CampaignArgs {
        json: Some(folder.path().join("missing").join("file.jsonl")),
        ..CampaignArgs::default()
    };
    let refused = Campaign::obtain(Never {}, &arguments)
        .unwrap_err()
        .to_string();
    assert!(
        refused.contains("can't write") && refused.contains("missing"),
        "{refused}"
    );
}

#[test]
fn a_file_replaces_that_of_the_same_shard_and_nothing_else_is_left() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.jsonl");
    run(THIRDS, "1/2", &path);
    run(THIRDS, "2/2", &path);
    let file = ResultFile::read(&path).unwrap();
    assert_eq!(file.header.shard, Shard::new(2, 2).unwrap());
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}
