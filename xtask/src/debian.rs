//! Debian packages: query and installation.

use std::{
    fs,
    time::{Duration, SystemTime},
};

use crate::{
    machine::{Machine, Rights, answer},
    process::Failure,
};

/// Age above which package lists are refreshed: older lists name packages that the
/// servers have removed, and lack security updates.
const LISTS_ARE_FRESH_FOR: Duration = Duration::from_secs(24 * 3600);

/// Installed versions of packages as text: `gcc-avr 1:5.4.0; not avr-libc`. Empty
/// without dpkg.
pub(crate) fn installed(machine: &Machine, packages: &[&str]) -> Option<String> {
    let arguments = [
        "--show",
        "--showformat=${db:Status-Status} ${Package} ${Version}\n",
    ];
    let answer = machine.ask(
        "dpkg-query",
        arguments.iter().copied().chain(packages.iter().copied()),
    )?;
    let version = |package: &str| {
        answer.stdout.lines().find_map(|line| {
            let mut words = line.split(' ');
            let words = (words.next(), words.next(), words.next());
            match words {
                (Some("installed"), Some(name), Some(version)) if name == package => Some(version),
                _ => None,
            }
        })
    };
    let words: Vec<String> = packages
        .iter()
        .map(|package| match version(package) {
            Some(version) => format!("{package} {version}"),
            None => format!("not {package}"),
        })
        .collect();
    Some(words.join(", "))
}

/// apt-get, if it may be used.
pub(crate) struct Apt<'a> {
    machine: &'a Machine,
    sudo: bool,
    /// Result of refreshing the lists, once tried.
    refreshed: Option<Result<(), String>>,
}

impl<'a> Apt<'a> {
    /// Fails with the reason why packages cannot be installed here.
    pub(crate) fn find(machine: &'a Machine) -> Result<Self, String> {
        if machine.ask("apt-get", ["--version"]).is_none() {
            return Err("There is no apt-get here.".to_owned());
        }
        match machine.rights() {
            Rights::None => Err(
                "Installing packages needs root, and sudo asks for a password: install them \
                 by hand."
                    .to_owned(),
            ),
            rights => Ok(Self {
                machine,
                sudo: rights == Rights::Sudo,
                refreshed: None,
            }),
        }
    }

    /// Installs or upgrades packages, from lists that are at most a day old.
    pub(crate) fn install(&mut self, packages: &[&str]) -> Result<(), Failure> {
        if self.refreshed.is_none() && lists_are_old(self.machine) {
            self.refresh();
            // Downloads would fail too, each after a timeout. If at least one list
            // was fetched, the packages may be available.
            if self.refresh_error().is_some() && lists_are_old(self.machine) {
                return Err(Failure::new(
                    "No package list could be refreshed, so nothing was installed.".to_owned(),
                ));
            }
        }
        let arguments: Vec<&str> = ["install", "--yes", "--no-install-recommends", "--no-remove"]
            .into_iter()
            .chain(packages.iter().copied())
            .collect();
        self.run(&arguments).map_err(Failure::new)
    }

    /// Fetches the package lists, at most once.
    pub(crate) fn refresh(&mut self) {
        /// Number and interval of tries while another program locks the lists.
        const TRIES: u32 = 10;
        const PAUSE: Duration = Duration::from_secs(2);
        eprintln!("Refreshing the package lists");
        let mut result = Ok(());
        for _ in 0..TRIES {
            // By default, a failed list is only a warning, and its old version is used.
            result = self.run(&["update", "--error-on=any"]);
            // apt waits for the lock of dpkg, but not for this one.
            match &result {
                Err(why) if why.contains("Could not get lock") => std::thread::sleep(PAUSE),
                _ => break,
            }
        }
        self.refreshed = Some(result);
    }

    /// Whether [`Self::refresh`] was called.
    pub(crate) fn was_refreshed(&self) -> bool {
        self.refreshed.is_some()
    }

    /// The error of refreshing the lists, if any.
    pub(crate) fn refresh_error(&self) -> Option<&str> {
        self.refreshed.as_ref()?.as_ref().err().map(String::as_str)
    }

    fn run(&self, arguments: &[&str]) -> Result<(), String> {
        let mut command = if self.sudo {
            let mut command = self.machine.command("sudo");
            command.args(["-n", "env", "DEBIAN_FRONTEND=noninteractive", "apt-get"]);
            command
        } else {
            let mut command = self.machine.command("apt-get");
            command.env("DEBIAN_FRONTEND", "noninteractive");
            command
        };
        command
            .args(["-qq", "-o", "Dpkg::Use-Pty=0"])
            // Another program may be installing packages.
            .args(["-o", "DPkg::Lock::Timeout=20"])
            // Short timeout for servers that do not answer.
            .args(["-o", "Acquire::Retries=0", "-o", "Acquire::http::Timeout=8"])
            .args(["-o", "Acquire::https::Timeout=8"])
            .args(arguments);
        let Some(answered) = answer(&mut command) else {
            return Err("apt-get does not start".to_owned());
        };
        if answered.success {
            return Ok(());
        }
        Err(format!(
            "apt-get {} failed{}",
            arguments.join(" "),
            errors(&answered.text)
        ))
    }
}

/// The distinct errors in the output of apt-get, one per line.
fn errors(text: &str) -> String {
    const MAX_ERRORS: usize = 4;
    let mut lines: Vec<&str> = Vec::new();
    for line in text.lines().filter(|line| line.starts_with("E: ")) {
        if !lines.contains(&line) {
            lines.push(line);
        }
    }
    if lines.is_empty() {
        lines.extend(text.lines().rev().take(1));
    }
    lines.truncate(MAX_ERRORS);
    lines
        .into_iter()
        .map(|line| format!("\n    {line}"))
        .collect()
}

/// Whether the package lists are missing or older than a day. The files have the
/// server's times; the folder has the time of the last fetched list. (Its subfolder
/// `partial` changes with every attempt.)
fn lists_are_old(machine: &Machine) -> bool {
    let folder = &machine.package_lists;
    let lists = fs::read_dir(folder).is_ok_and(|mut files| {
        files.any(|file| {
            file.is_ok_and(|file| file.file_name().to_string_lossy().contains("_Packages"))
        })
    });
    // A time in the future is not valid.
    let fresh = fs::metadata(folder)
        .and_then(|folder| folder.modified())
        .ok()
        .and_then(|fetched| SystemTime::now().duration_since(fetched).ok())
        .is_some_and(|age| age < LISTS_ARE_FRESH_FOR);
    !(lists && fresh)
}

#[cfg(test)]
mod tests {
    use std::time::UNIX_EPOCH;

    use super::*;
    use crate::machine::stand_in::Bare;

    fn set_age(machine: &Bare, age: Duration) {
        let time = SystemTime::now() - age;
        let folder = fs::File::open(&machine.machine.package_lists).unwrap();
        folder.set_modified(time).unwrap();
    }

    fn add_list(machine: &Bare) {
        let list = machine.machine.package_lists.join("server_main_Packages");
        fs::write(&list, "").unwrap();
        // The server's time.
        let file = fs::File::options().write(true).open(list).unwrap();
        file.set_modified(UNIX_EPOCH).unwrap();
    }

    #[test]
    fn lists_are_old_a_day_after_they_were_fetched() {
        let machine = Bare::new("lists");
        assert!(lists_are_old(&machine.machine), "without a list");
        add_list(&machine);
        assert!(!lists_are_old(&machine.machine));
        set_age(&machine, Duration::from_secs(23 * 3600));
        assert!(!lists_are_old(&machine.machine));
        set_age(&machine, Duration::from_secs(25 * 3600));
        assert!(lists_are_old(&machine.machine));
    }

    #[test]
    fn packages_are_upgraded_from_fresh_lists() {
        let machine = Bare::new("upgrade");
        machine.program("apt-get", &machine.logged("apt-get"));
        add_list(&machine);
        set_age(&machine, Duration::from_secs(48 * 3600));
        let mut apt = Apt::find(&machine.machine).unwrap();
        apt.install(&["rustc-web", "gcc-avr"]).unwrap();
        apt.install(&["rustc-web"]).unwrap();
        let calls = machine.calls();
        let [version, update, first, second] = &calls[..] else {
            panic!("{calls:?}");
        };
        assert!(version.ends_with("--version"), "{calls:?}");
        assert!(update.contains(" update --error-on=any"), "{calls:?}");
        assert!(
            first.ends_with("install --yes --no-install-recommends --no-remove rustc-web gcc-avr"),
            "{calls:?}"
        );
        assert!(second.ends_with("--no-remove rustc-web"), "{calls:?}");
    }

    #[test]
    fn recent_lists_are_not_refreshed() {
        let machine = Bare::new("today");
        machine.program("apt-get", &machine.logged("apt-get"));
        add_list(&machine);
        let mut apt = Apt::find(&machine.machine).unwrap();
        apt.install(&["gcc-avr"]).unwrap();
        assert!(!machine.calls().iter().any(|call| call.contains("update")));
    }

    #[test]
    fn an_offline_apt_reports_the_reason_once() {
        let machine = Bare::new("offline");
        machine.program(
            "apt-get",
            "case \"$*\" in\n\
             *--version*) exit 0 ;;\n\
             *update*) echo 'W: one is old'; echo 'E: no route'; echo 'E: no route' >&2; exit 100 ;;\n\
             *) echo 'E: Unable to fetch gcc-avr' >&2; exit 100 ;;\n\
             esac",
        );
        let mut apt = Apt::find(&machine.machine).unwrap();
        let why = apt.install(&["gcc-avr"]).unwrap_err().to_string();
        assert_eq!(
            why,
            "No package list could be refreshed, so nothing was installed."
        );
        assert_eq!(
            apt.refresh_error(),
            Some("apt-get update --error-on=any failed\n    E: no route")
        );
    }

    #[test]
    fn a_failed_list_does_not_prevent_the_installation() {
        let machine = Bare::new("one-list");
        add_list(&machine);
        set_age(&machine, Duration::from_secs(48 * 3600));
        machine.program(
            "apt-get",
            &format!(
                "case \"$*\" in *update*) : > '{}/another_Packages'; echo 'E: one of them'; exit 100 ;; \
                 esac",
                machine.machine.package_lists.display()
            ),
        );
        let mut apt = Apt::find(&machine.machine).unwrap();
        apt.install(&["gcc-avr"]).unwrap();
        assert!(
            apt.refresh_error()
                .is_some_and(|why| why.contains("one of them"))
        );
    }

    #[test]
    fn nothing_is_tried_without_apt_or_rights() {
        let mut machine = Bare::new("rights");
        assert!(Apt::find(&machine.machine).is_err());
        machine.program("apt-get", &machine.logged("apt-get"));
        machine.machine.rights = Some(Rights::None);
        let why = Apt::find(&machine.machine).err().unwrap();
        assert!(why.contains("by hand"), "{why}");
    }

    #[test]
    fn sudo_never_prompts() {
        let mut machine = Bare::new("sudo");
        machine.program("apt-get", "");
        machine.program("sudo", &machine.logged("sudo"));
        machine.machine.rights = Some(Rights::Sudo);
        let mut apt = Apt::find(&machine.machine).unwrap();
        apt.install(&["gcc-avr"]).unwrap();
        assert!(
            machine
                .calls()
                .iter()
                .all(|call| call.starts_with("sudo -n ")),
            "{:?}",
            machine.calls()
        );
    }

    #[test]
    fn installed_packages_are_listed_with_versions() {
        let machine = Bare::new("dpkg");
        assert_eq!(installed(&machine.machine, &["gcc-avr"]), None);
        machine.program(
            "dpkg-query",
            "echo 'installed gcc-avr 1:5.4.0'; echo 'config-files avr-libc 1:2.0'; \
             echo 'dpkg-query: no packages found matching simavr' >&2; exit 1",
        );
        assert_eq!(
            installed(&machine.machine, &["gcc-avr", "avr-libc", "simavr"]).as_deref(),
            Some("gcc-avr 1:5.4.0, not avr-libc, not simavr")
        );
    }
}
