//! `CHANGELOG.md`: a section for what is not released, and one for each version.

use std::fs;

use crate::{
    process::{Failure, failure},
    workspace::root,
};

const VERSION: &str = env!("CARGO_PKG_VERSION");

/// The newest section.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Section {
    /// The day of the release, as in 2026-11-27; none before it.
    pub(crate) date: Option<String>,
    pub(crate) text: String,
}

impl Section {
    /// Checks that it is the section of the version with this tag.
    pub(crate) fn check_tag(&self, tag: &str) -> Result<(), Failure> {
        if tag != format!("v{VERSION}") {
            return Err(failure!(
                "the tag {tag} is not v{VERSION}, the version in Cargo.toml: change one of them"
            ));
        }
        if self.date.is_none() {
            return Err(failure!(
                "CHANGELOG.md begins with \"## Unreleased\": name that section \"## {VERSION} (YYYY-MM-DD)\""
            ));
        }
        Ok(())
    }
}

/// The newest section, in a changelog that agrees with the version of the workspace.
pub(crate) fn newest() -> Result<Section, Failure> {
    let path = root().join("CHANGELOG.md");
    let text =
        fs::read_to_string(&path).map_err(|error| failure!("{}: {error}", path.display()))?;
    parse(&text, VERSION)
}

fn parse(text: &str, version: &str) -> Result<Section, Failure> {
    let mut sections = text.split("\n## ").skip(1);
    let mut next = || sections.next()?.split_once('\n');
    let (heading, text) = next().ok_or_else(|| failure!("CHANGELOG.md has no section"))?;
    let is_unreleased = heading == "Unreleased";
    let released = match is_unreleased {
        true => next().map(|(heading, _)| heading),
        false => Some(heading),
    };
    let date = |heading: &str| {
        let date = heading.strip_prefix(version)?.strip_prefix(" (")?;
        let date = date.strip_suffix(')')?;
        let is_day = date.split('-').map(str::len).eq([4, 2, 2]);
        is_day.then(|| date.to_owned())
    };
    let dated = |heading| {
        date(heading).ok_or_else(|| {
            failure!(
                "CHANGELOG.md: the newest version is \"## {heading}\", but Cargo.toml has {version}: \
                 give that section the heading \"## Unreleased\" or \"## {version} (YYYY-MM-DD)\", or \
                 change the version in Cargo.toml"
            )
        })
    };
    let date = released.map(dated).transpose()?;
    Ok(Section {
        date: date.filter(|_| !is_unreleased),
        text: format!("{}\n", text.trim()),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const RELEASED: &str = "# Changelog\n\n## 0.2.0 (2026-12-01)\n\n### Board\n\n- New.\n\n\
                            ## 0.1.0 (2026-11-27)\n\n- First.\n";

    #[test]
    fn the_changelog_agrees_with_the_version() {
        newest().unwrap();
    }

    #[test]
    fn the_notes_are_the_newest_section() {
        let newest = parse(RELEASED, "0.2.0").unwrap();
        assert_eq!(newest.date.as_deref(), Some("2026-12-01"));
        assert_eq!(newest.text, "### Board\n\n- New.\n");
    }

    #[test]
    fn what_is_not_released_has_no_date() {
        for (text, version) in [
            (
                "# Changelog\n\n## Unreleased\n\n- New.\n".to_owned(),
                "0.1.0",
            ),
            (
                RELEASED.replacen("\n## ", "\n## Unreleased\n\n- New.\n\n## ", 1),
                "0.2.0",
            ),
        ] {
            let newest = parse(&text, version).unwrap();
            assert_eq!((newest.date, newest.text.as_str()), (None, "- New.\n"));
        }
    }

    #[test]
    fn a_version_that_is_not_that_of_the_workspace_is_refused() {
        for text in [
            RELEASED.to_owned(),
            RELEASED.replacen("\n## ", "\n## Unreleased\n\n- New.\n\n## ", 1),
            RELEASED.replace("0.2.0 (2026-12-01)", "0.3.0"),
            RELEASED.replace("0.2.0 (2026-12-01)", "0.3.0 (soon)"),
        ] {
            let why = parse(&text, "0.3.0").unwrap_err().to_string();
            assert!(why.contains("Cargo.toml has 0.3.0"), "{why}");
        }
    }

    #[test]
    fn a_tag_is_that_of_a_released_version() {
        let mut section = Section {
            date: None,
            text: String::new(),
        };
        let tag = format!("v{VERSION}");
        let why = section.check_tag(&tag).unwrap_err().to_string();
        assert!(why.contains("Unreleased"), "{why}");
        section.date = Some("2026-11-27".to_owned());
        section.check_tag(&tag).unwrap();
        let why = section.check_tag("v99.0.0").unwrap_err().to_string();
        assert!(why.contains("v99.0.0"), "{why}");
    }
}
