//! Debian's packages: which are installed, and getting more of them.

use std::{
    fs,
    time::{Duration, SystemTime},
};

use crate::{
    machine::{Machine, Rights, answer},
    process::Failure,
};

/// Older package lists name packages that the servers no longer have, and miss the
/// security updates since.
const LISTS_ARE_FRESH_FOR: Duration = Duration::from_secs(24 * 3600);

/// What is installed of some packages, in words: `gcc-avr 1:5.4.0; not avr-libc`.
/// Nothing where there is no dpkg.
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

/// apt-get, where it may be used.
pub(crate) struct Apt<'a> {
    machine: &'a Machine,
    sudo: bool,
    /// Whether the lists could be refreshed, once that was tried.
    refreshed: Option<Result<(), String>>,
}

impl<'a> Apt<'a> {
    /// Or why packages cannot be installed here.
    pub(crate) fn find(machine: &'a Machine) -> Result<Self, String> {
        if machine.ask("apt-get", ["--version"]).is_none() {
            return Err("There is no apt-get here to install packages with.".to_owned());
        }
        match machine.rights() {
            Rights::None => Err(
                "Installing packages takes root, and sudo asks for a password: install them \
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

    /// Installs packages, or upgrades those that are there, from lists that are not older
    /// than a day.
    pub(crate) fn install(&mut self, packages: &[&str]) -> Result<(), Failure> {
        if self.refreshed.is_none() && lists_are_old(self.machine) {
            self.refresh();
            // Packages would not come either, each after a time-out of its own. If one list
            // came and another did not, the packages may still come.
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

    /// Fetches the package lists, unless that was done before.
    pub(crate) fn refresh(&mut self) {
        /// How often, and after how long, while another program holds the lists.
        const TRIES: u32 = 10;
        const PAUSE: Duration = Duration::from_secs(2);
        eprintln!("Refreshing the package lists");
        let mut result = Ok(());
        for _ in 0..TRIES {
            // A list that cannot be fetched would be a warning, and its old one be used.
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

    /// Why the lists may be old all the same.
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
            // Another program may be installing something just now.
            .args(["-o", "DPkg::Lock::Timeout=20"])
            // A server that does not answer is given up soon.
            .args(["-o", "Acquire::Retries=0", "-o", "Acquire::http::Timeout=8"])
            .args(["-o", "Acquire::https::Timeout=8"])
            .args(arguments);
        let Some(said) = answer(&mut command) else {
            return Err("apt-get does not start".to_owned());
        };
        if said.success {
            return Ok(());
        }
        Err(format!(
            "apt-get {} failed{}",
            arguments.join(" "),
            errors(&said.text)
        ))
    }
}

/// The errors in what apt-get printed, each once, each on a line of its own.
fn errors(text: &str) -> String {
    const MOST: usize = 4;
    let mut lines: Vec<&str> = Vec::new();
    for line in text.lines().filter(|line| line.starts_with("E: ")) {
        if !lines.contains(&line) {
            lines.push(line);
        }
    }
    if lines.is_empty() {
        lines.extend(text.lines().rev().take(1));
    }
    lines.truncate(MOST);
    lines
        .into_iter()
        .map(|line| format!("\n    {line}"))
        .collect()
}

/// Whether the package lists are missing, or were fetched longer than a day ago. The
/// files in the folder have the server's times; the folder's own is that of the last list
/// that came. (Its folder `partial` changes with every attempt.)
fn lists_are_old(machine: &Machine) -> bool {
    let folder = &machine.package_lists;
    let lists = fs::read_dir(folder).is_ok_and(|mut files| {
        files.any(|file| {
            file.is_ok_and(|file| file.file_name().to_string_lossy().contains("_Packages"))
        })
    });
    // A time in the future says nothing.
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
    fn packages_are_installed_from_lists_of_today_as_they_are() {
        let machine = Bare::new("today");
        machine.program("apt-get", &machine.logged("apt-get"));
        add_list(&machine);
        let mut apt = Apt::find(&machine.machine).unwrap();
        apt.install(&["gcc-avr"]).unwrap();
        assert!(!machine.calls().iter().any(|call| call.contains("update")));
    }

    #[test]
    fn an_apt_that_is_offline_says_why_once() {
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
    fn a_list_that_cannot_be_fetched_does_not_keep_packages_from_being_installed() {
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
    fn without_apt_or_rights_nothing_is_tried() {
        let mut machine = Bare::new("rights");
        assert!(Apt::find(&machine.machine).is_err());
        machine.program("apt-get", &machine.logged("apt-get"));
        machine.machine.rights = Some(Rights::None);
        let why = Apt::find(&machine.machine).err().unwrap();
        assert!(why.contains("by hand"), "{why}");
    }

    #[test]
    fn sudo_is_asked_never_to_ask() {
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
    fn installed_packages_are_told_with_their_versions() {
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
