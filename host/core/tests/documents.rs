//! The documents that the declarations of the keys give: the example file, the list of the keys, their schema
//! for editors, and the sections on the pages. With `SINGLETRACK_RENEW=1` these tests write them instead.

use std::{env, fs, path::Path};

use serde_json::{Map, Value as Json, json};
use singletrack_core::config::{Config, Key, SECTIONS, Section};
use singletrack_protocol::ConfigurationError;

/// The keys that a lab sets for its car and its room; the page folds the others.
const BASIC: [&str; 25] = [
    "serial.port",
    "motion_capture.kind",
    "motion_capture.server",
    "motion_capture.rigid_body",
    "motion_capture.up_axis",
    "law.point_distance_m",
    "law.front_axle_distance_m",
    "outer_loop.gain_per_s",
    "outer_loop.feed_forward",
    "reference.kind",
    "reference.radius_m",
    "reference.angular_velocity_rad_s",
    "vehicle.front_axle_distance_m",
    "vehicle.rear_axle_distance_m",
    "limits.max_speed_m_s",
    "fence.corners_m",
    "fence.braking_m_s2",
    "board.servo.centre_us",
    "board.servo.gain_us_per_rad",
    "board.servo.min_us",
    "board.servo.max_us",
    "board.esc.kind",
    "board.esc.neutral_us",
    "board.esc.deadband_us",
    "board.speed.pulse_distance_um",
];

/// The longest line of a comment in the example file.
const WIDTH: usize = 80;

const EXAMPLE_HEADER: &str = "\
# singletrackd: the configuration, with every key.
#
# A line \"#key = value\" shows a default: remove the # to change it. The other keys
# have no default, because they depend on your set-up. Unknown keys are refused.
# docs/configuration.md lists the ranges.
#
#   singletrackd --check --config FILE     reports what is wrong with a file
";

/// The section `[reference]`, of which every kind has keys of its own.
const EXAMPLE_REFERENCE: &str = "\
# Without feed-forward P settles on a circle of 0.76 m here; 0.69 m is the smallest that
# the paper's car can steer. It fits inside the fence below if the car starts with P near
# it, looking along it: --check prints such a place. The paper's circle has a radius of 1.0.
# A drive on a circle, a figure of eight or a closed path begins at the place that is nearest
# to P; with start = \"beginning\" at the first point.
[reference]
kind = \"circle\"
radius_m = 0.85
angular_velocity_rad_s = 0.5
#centre_m = [0.0, 0.0]
#start = \"nearest\"
# Or:
#   kind = \"figure-of-eight\"
#   half_length_m = 1.0
#   half_width_m = 0.5
#   angular_velocity_rad_s = 0.4
#   centre_m = [0.0, 0.0]
# Or, with outer_loop.kind = \"open-loop\":
#   kind = \"velocity-steps\"
#   steps = [ { duration_s = 3.0, v_x_m_s = 0.6, v_y_m_s = 0.0 } ]
# Or through timed points, from a CSV file with the columns t_s,x_m,y_m beside
# this one:
#   kind = \"waypoints\"
#   file = \"waypoints.csv\"
# Or smoothly through points, from a CSV file with the columns x_m,y_m:
#   kind = \"path\"
#   file = \"path.csv\"
#   closed = false
#   speed_m_s = 0.5
# Or set-points that are sent to the control socket, for as long as they are
# renewed:
#   kind = \"external\"
#   setpoint_timeout_ms = 200
";

const PAGE_HEADER: &str = "\
# Configuration

The daemon reads one TOML file. `host/daemon/singletrackd.example.toml` is a file to start from.
Unknown keys are refused, and so is a value outside its range: `singletrackd --check --config FILE`
reports what is wrong with a file.

Each line has a key, in brackets its default and range, and its meaning. A key without a default is
mandatory, in sections with a `kind` for its kind only. A key's name ends with its unit: `_m_s2` is
m/s², `_us` µs, `_um` µm, `_n_rad` N/rad, `_per_s` 1/s.

Shown are the keys that a lab sets; the others are folded. An editor with TOML schemas, such as VS Code
with Even Better TOML, completes and explains all if the first line of the file is
`#:schema PATH/host/daemon/singletrackd.schema.json`.

SIGHUP reloads the file while the car does not drive. A key marked ↻ takes a restart of the daemon.

Generated from the declarations in `host/core/src/config`; see `host/core/tests/documents.rs`.
";

#[test]
fn the_example_file_is_that_of_the_declarations() {
    compare("host/daemon/singletrackd.example.toml", &example());
}

#[test]
fn the_list_of_the_keys_is_that_of_the_declarations() {
    compare("docs/configuration.md", &page());
    compare("host/daemon/singletrackd.schema.json", &schema());
}

/// The ranges of `[board]` are text in the declarations: the board checks the numbers.
#[test]
fn the_boards_ranges_are_those_that_it_checks() {
    let board = |section: &&Section| section.name.split('.').next() == Some("board");
    let mut count = 0;
    for section in SECTIONS.iter().filter(board) {
        for key in section.keys.iter().filter(|key| !key.range.is_empty()) {
            let error = board_refusal(section, key);
            // Of the gain it is the magnitude that has a range.
            let range = key.range.split(" or ").next().unwrap();
            let (lowest, highest) = range.split_once(" to ").unwrap();
            assert_eq!(
                (bound(section, lowest), bound(section, highest)),
                (error.lowest, error.highest),
                "{}.{}",
                section.name,
                key.name
            );
            count += 1;
        }
    }
    assert_eq!(count, 19);
}

/// Why the board refuses the lowest or the highest value that the key can be given.
fn board_refusal(section: &Section, key: &Key) -> ConfigurationError {
    let path = format!("{}.{}", section.name, key.name);
    for value in [0, u16::MAX.into()] {
        let mut file: toml::Value = toml::from_str(&example()).unwrap();
        let section = section
            .name
            .split('.')
            .fold(&mut file, |at, name| &mut at[name]);
        section
            .as_table_mut()
            .unwrap()
            .insert(key.name.to_owned(), toml::Value::Integer(value));
        let Ok(config) = file.try_into::<Config>() else {
            continue;
        };
        if let Err(error) = config.board.configuration().validate() {
            assert!(
                error
                    .field
                    .to_string()
                    .ends_with(path.strip_prefix("board.").unwrap()),
                "{path}: {error}"
            );
            return error;
        }
    }
    panic!("the board takes every value of {path}");
}

/// A bound such as `neutral_us - deadband_us - 1`, with the values of the example file.
fn bound(section: &Section, text: &str) -> i32 {
    let value = |word: &str| match section.keys.iter().find(|key| key.name == word) {
        Some(key) => (key.example)().unwrap().as_integer().unwrap() as i32,
        None => word.parse().unwrap(),
    };
    let words: Vec<_> = text.split(' ').collect();
    words[1..]
        .chunks(2)
        .fold(value(words[0]), |sum, term| match term[0] {
            "+" => sum + value(term[1]),
            _ => sum - value(term[1]),
        })
}

/// Compares a page with the one that is generated, or writes it.
pub(crate) fn compare(path: &str, expected: &str) {
    let file = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../..")
        .join(path);
    if env::var_os("SINGLETRACK_RENEW").is_some_and(|value| value == "1") {
        fs::write(&file, expected).unwrap();
    }
    let found = fs::read_to_string(&file).unwrap_or_default();
    let differs = expected.lines().zip(found.lines()).find(|(a, b)| a != b);
    assert!(
        found == expected,
        "{path} differs from the declarations, first at {differs:?}; renew it with \
         SINGLETRACK_RENEW=1 cargo test -p singletrack-core --test tests"
    );
}

/// The help of a section or a key, on one line.
fn help(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

fn example() -> String {
    let mut text = EXAMPLE_HEADER.to_owned();
    for section in SECTIONS {
        text += "\n";
        text += &comment(section.help);
        match section.name {
            "reference" => text += EXAMPLE_REFERENCE,
            // The paper's car if the section is left out.
            "vehicle" => {
                text += "#[vehicle]\n";
                for key in section.keys {
                    let line = assignment(section, key);
                    text += &format!("#{}", line.trim_start_matches('#'));
                }
            }
            name => {
                text += &format!("[{name}]\n");
                for key in section.keys.iter().filter(|key| !is_section(section, key)) {
                    text += &comment(key.help);
                    text += &assignment(section, key);
                }
            }
        }
    }
    text
}

/// Whether the key is a section of its own.
fn is_section(section: &Section, key: &Key) -> bool {
    let path = format!("{}.{}", section.name, key.name);
    SECTIONS.iter().any(|section| section.name == path)
}

/// Whether the section's kind says which keys it has.
fn has_kinds(section: &Section) -> bool {
    let says = |key: &Key| key.name == "kind" && (key.default)().is_none();
    section.keys.iter().any(says)
}

/// The help as a comment, broken at [`WIDTH`].
fn comment(text: &str) -> String {
    let mut lines = vec!["#".to_owned()];
    for word in text.replace('`', "").split_whitespace() {
        let line = lines.last_mut().unwrap();
        if line.chars().count() + 1 + word.chars().count() > WIDTH {
            lines.push(format!("# {word}"));
        } else {
            *line += &format!(" {word}");
        }
    }
    lines.join("\n") + "\n"
}

/// A key with its default, commented out, or with its example.
fn assignment(section: &Section, key: &Key) -> String {
    let name = key.name;
    // The example's loop is not one of another crate.
    let is_own = key.help.trim_start().starts_with("Own:");
    match ((key.default)(), (key.example)()) {
        (Some(default), _) => format!("#{name} = {default}\n"),
        (None, Some(example)) if key.mandatory || (has_kinds(section) && !is_own) => {
            format!("{name} = {example}\n")
        }
        (None, Some(example)) => format!("# {name} = {example}\n"),
        (None, None) => panic!("{}.{name} has neither default nor example", section.name),
    }
}

fn page() -> String {
    let mut text = PAGE_HEADER.to_owned();
    for section in SECTIONS {
        let restart = if section.restart { " ↻" } else { "" };
        text += &format!(
            "\n## `[{}]`{restart}\n\n{}\n\n",
            section.name,
            help(section.help)
        );
        let keys = section.keys.iter().filter(|key| !is_section(section, key));
        let (basic, more): (Vec<_>, Vec<_>) = keys.partition(|key| is_basic(section, key));
        for key in basic {
            text += &line_of(section, key);
        }
        if !more.is_empty() {
            text += &format!("\n<details><summary>{} more</summary>\n\n", more.len());
            for key in more {
                text += &line_of(section, key);
            }
            text += "\n</details>\n";
        }
    }
    text.replace("\n\n\n", "\n\n")
}

fn is_basic(section: &Section, key: &Key) -> bool {
    BASIC.contains(&&*format!("{}.{}", section.name, key.name))
}

/// A key's line in the page.
fn line_of(section: &Section, key: &Key) -> String {
    let default = match (key.default)() {
        Some(value) => format!("`{value}`"),
        None if key.mandatory || has_kinds(section) => String::new(),
        None => "none".to_owned(),
    };
    // The default shows a type.
    let is_type = key.range.is_empty() && (key.words)().is_empty();
    let range = if is_type && default.starts_with('`') {
        String::new()
    } else {
        range(key)
    };
    let range = match range.starts_with("above") {
        true => range,
        false => range.replace(" to ", "…"),
    };
    let parts: Vec<_> = [default, range]
        .into_iter()
        .filter(|part| !part.is_empty())
        .collect();
    let restart = if key.restart { " ↻" } else { "" };
    format!(
        "- `{}`{restart} ({}): {}\n",
        key.name,
        parts.join("; "),
        help(key.help)
    )
}

/// The schema of the file for editors.
fn schema() -> String {
    let mut whole = json!({
        "$schema": "http://json-schema.org/draft-07/schema#",
        "title": "singletrackd",
        "type": "object",
        "additionalProperties": false,
        "properties": {},
    });
    for section in SECTIONS {
        let mut at = &mut whole;
        for part in section.name.split('.') {
            let properties = at["properties"].as_object_mut().unwrap();
            at = properties.entry(part).or_insert_with(|| json!({}));
        }
        let keys = section.keys.iter().filter(|key| !is_section(section, key));
        let properties: Map<_, _> = keys
            .map(|key| (key.name.to_owned(), property(key)))
            .collect();
        let mandatory = section
            .keys
            .iter()
            .filter(|key| key.mandatory && !is_section(section, key));
        *at = json!({
            "description": help(section.help),
            "type": "object",
            "additionalProperties": false,
            "properties": properties,
            "required": mandatory.map(|key| key.name).collect::<Vec<_>>(),
        });
    }
    serde_json::to_string_pretty(&whole).unwrap() + "\n"
}

/// What an editor knows of a key.
fn property(key: &Key) -> Json {
    let inner = key
        .kind
        .strip_prefix("Option<")
        .and_then(|kind| kind.strip_suffix('>'));
    let mut property = match inner.unwrap_or(key.kind) {
        _ if !(key.words)().is_empty() => json!({ "enum": (key.words)() }),
        "bool" => json!({ "type": "boolean" }),
        "f64" => json!({ "type": "number" }),
        "u8" | "u16" | "i16" | "u32" => json!({ "type": "integer" }),
        "[f64; 2]" => {
            json!({ "type": "array", "items": { "type": "number" }, "minItems": 2, "maxItems": 2 })
        }
        kind if kind.starts_with("Vec<") => json!({ "type": "array" }),
        "Table" => json!({ "type": "object" }),
        _ => json!({ "type": "string" }),
    };
    let bound = |text: &str| number(text).parse::<f64>().ok();
    let (low, high) = match key.range.strip_prefix("up_to(") {
        Some(high) => {
            property["exclusiveMinimum"] = json!(0);
            (None, bound(high.trim_end_matches(')')))
        }
        None => match key.range.split_once("..=") {
            Some((low, high)) => (bound(low), bound(high)),
            None => (None, None),
        },
    };
    let is_number = matches!(property["type"].as_str(), Some("number" | "integer"));
    if !is_number {
        property.as_object_mut().unwrap().remove("exclusiveMinimum");
    }
    for (name, bound) in [("minimum", low), ("maximum", high)] {
        if let (true, Some(bound)) = (is_number, bound) {
            property[name] = json!(bound);
        }
    }
    if let Some(default) = (key.default)() {
        property["default"] = json!(default);
    }
    property["description"] = json!(help(key.help));
    property
}

#[test]
fn an_editor_knows_every_key_and_refuses_others() {
    let schema: Json = serde_json::from_str(&schema()).unwrap();
    for section in SECTIONS {
        let at = section
            .name
            .split('.')
            .fold(&schema, |at, part| &at["properties"][part]);
        assert_eq!(at["additionalProperties"], false, "{}", section.name);
        for key in section.keys {
            assert!(
                at["properties"][key.name]["description"].is_string(),
                "{}",
                key.name
            );
        }
    }
    let speed = &schema["properties"]["limits"]["properties"]["max_speed_m_s"];
    assert_eq!(
        (&speed["exclusiveMinimum"], &speed["maximum"]),
        (&json!(0), &json!(20.0))
    );
    let known = |name: &str| {
        let (section, key) = name.rsplit_once('.').unwrap();
        let section = SECTIONS.iter().find(|known| known.name == section);
        section.is_some_and(|section| section.keys.iter().any(|known| known.name == key))
    };
    assert!(BASIC.into_iter().all(known));
}

/// The values that a key may have, in words.
fn range(key: &Key) -> String {
    if key.range.is_empty() {
        let words = (key.words)();
        return match words.is_empty() {
            false => format!("`\"{}\"`", words.join("\"`, `\"")),
            true => type_in_words(key.kind).to_owned(),
        };
    }
    let highest = key.range.strip_prefix("up_to(");
    let text = match highest.and_then(|range| range.strip_suffix(')')) {
        Some(highest) => format!("above 0, to {}", number(highest)),
        None => match key.range.split_once("..=") {
            Some((lowest, highest)) => format!("{} to {}", number(lowest), number(highest)),
            None => key.range.to_owned(),
        },
    };
    let name = |word: &str| {
        SECTIONS
            .iter()
            .any(|s| s.keys.iter().any(|k| k.name == word))
    };
    let words = text.split(' ').map(|word| match name(word) {
        true => format!("`{word}`"),
        false => word.replace("PI", "π"),
    });
    words.collect::<Vec<_>>().join(" ")
}

/// A type of Rust in words.
fn type_in_words(kind: &str) -> &str {
    let inner = kind.strip_prefix("Option<");
    match inner.map_or(kind, |inner| inner.strip_suffix('>').unwrap()) {
        "bool" => "true or false",
        "String" | "PathBuf" | "Bitstream" => "text",
        "Ipv4Addr" | "IpAddr" => "IP address",
        "u8" | "u16" | "i16" | "u32" => "whole number",
        "f64" => "number",
        "[f64; 2]" => "two numbers",
        "Table" => "table",
        "Vec<[f64; 2]>" => "list of two numbers each",
        list if list.starts_with("Vec<") => "list",
        other => panic!("{other} has no words"),
    }
}

/// A number as a declaration has it, without its Rust: `1_000.0` is 1000.
fn number(text: &str) -> String {
    if text.starts_with(|c: char| c.is_ascii_alphabetic()) {
        return text.to_owned();
    }
    let digits = text.replace('_', "");
    digits.strip_suffix(".0").unwrap_or(&digits).to_owned()
}

const EXAMPLE: &str = include_str!("../../daemon/singletrackd.example.toml");

/// The blocks of TOML of a page.
fn blocks(page: &str) -> impl Iterator<Item = toml::Table> {
    let after = page.split("```toml\n").skip(1);
    after.map(|rest| rest.split("```").next().unwrap().parse().unwrap())
}

/// Puts the keys of a block into the example; a reference or loop of another kind replaces its own.
fn onto_example(block: toml::Table) -> toml::Table {
    let mut whole: toml::Table = EXAMPLE.parse().unwrap();
    for (section, keys) in block {
        match (whole.get_mut(&section), keys) {
            (Some(toml::Value::Table(known)), toml::Value::Table(keys))
                if section != "reference"
                    && !(section == "outer_loop" && keys.contains_key("kind")) =>
            {
                known.extend(keys);
            }
            (_, keys) => {
                whole.insert(section, keys);
            }
        }
    }
    whole
}

#[test]
fn every_section_in_a_page_is_taken_with_the_example() {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs");
    let mut shown = 0;
    for page in fs::read_dir(docs).unwrap().flatten() {
        let path = page.path();
        if path.extension().is_none_or(|ending| ending != "md") {
            continue;
        }
        for block in blocks(&fs::read_to_string(&path).unwrap()) {
            // Maps of imports and the truth of simulations are other files.
            if block.contains_key("truth") || block.contains_key("pose") {
                continue;
            }
            shown += 1;
            for section in block.keys() {
                let is_known = SECTIONS.iter().any(|known| known.name == section);
                assert!(is_known, "{}: there is no [{section}]", path.display());
            }
            let text = toml::to_string(&onto_example(block)).unwrap();
            if let Err(error) = Config::from_toml(&text) {
                let error = error.to_string();
                // Keys are judged before the files of points and the loop, which are the reader's own.
                let own = [".csv: No such", "outer_loop.name is my-loop"];
                assert!(
                    own.iter().any(|part| error.contains(part)),
                    "{}: {error}",
                    path.display()
                );
            }
        }
    }
    assert!(shown > 5, "{shown}");
}
