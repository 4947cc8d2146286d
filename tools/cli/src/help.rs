//! The list of the commands in groups.

use std::fmt::Write as _;

use clap::Command;

use crate::wrap::wrap;

/// What the commands are for, and their names.
pub const GROUPS: [(&str, &str); 4] = [
    (
        "Drive",
        "arm disarm stop fleet drive tune setpoint set-reference",
    ),
    (
        "Set up a car",
        "cameras doctor bring-up calibrate accept jog",
    ),
    ("Look", "status page live dump plot"),
    (
        "Simulate and analyse",
        "demo simulate compare reproduce stability identify merge import judge recover replay",
    ),
];

/// Columns of a line.
const COLUMNS: usize = 100;
/// Columns of the names.
const NAMES: usize = 15;

/// Lists the subcommands of `command` by [`GROUPS`] in its help.
#[must_use]
pub fn grouped(command: Command) -> Command {
    let header = *command.get_styles().get_header();
    let literal = *command.get_styles().get_literal();
    let mut template = "{about-with-newline}\n{usage-heading} {usage}\n".to_owned();
    for (group, names) in GROUPS {
        let mut lines = String::new();
        for one in names
            .split(' ')
            .filter_map(|name| command.find_subcommand(name))
        {
            let about = one.get_about().map(ToString::to_string).unwrap_or_default();
            let mut name = one.get_name();
            for line in wrap(&about, COLUMNS - NAMES - 2) {
                let _ = writeln!(lines, "  {literal}{name:<NAMES$}{literal:#}{line}");
                name = "";
            }
        }
        if !lines.is_empty() {
            let _ = write!(template, "\n{header}{group}:{header:#}\n{lines}");
        }
    }
    let _ = write!(
        template,
        "\n{header}Options:{header:#}\n{{options}}{{after-help}}"
    );
    command.help_template(template)
}
