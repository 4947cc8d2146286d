use std::{
    env, fs,
    path::{Path, PathBuf},
};

use super::*;

/// A machine with stand-ins, which are shell scripts, and with the programs that the functions
/// of the probes call.
struct Machine(PathBuf);

impl Machine {
    fn new(test: &str) -> Self {
        let name = format!("singletrack-xtask-{test}-{}", std::process::id());
        let machine = Self(env::temp_dir().join(name));
        let _ = fs::remove_dir_all(&machine.0);
        machine.sh(
            "mkdir -p \"$1/bin\"
             for tool in bash cat cut dirname env grep head mktemp rm sed sh sort tail; do
                 ln -s \"$(command -v $tool)\" \"$1/bin\"
             done",
            "",
        );
        machine.program("bin/id", "echo 0");
        machine.program("bin/sleep", "");
        machine
    }

    /// Runs a script with the machine's folder and a text.
    fn sh(&self, script: &str, text: &str) {
        let mut sh = Command::new("/bin/sh");
        let status = sh
            .args(["-ec", script, "sh"])
            .arg(&self.0)
            .arg(text)
            .status();
        assert!(status.unwrap().success());
    }

    /// Written by another process: a file that is open for writing in this one could be
    /// inherited by a program of another test, and could then not be executed.
    fn program(&self, place: &str, script: &str) -> String {
        let write = format!(
            "mkdir -p $(dirname \"$1/{place}\"); printf '#!/bin/sh\\n%s\\n' \"$2\" >\"$1/{place}\"
             chmod 755 \"$1/{place}\""
        );
        self.sh(&write, script);
        self.0.join(place).to_str().unwrap().to_owned()
    }

    /// An apt-get that logs its calls, with a script for the rest.
    fn apt(&self, script: &str) {
        let calls = self.0.join("calls");
        let log = format!("echo \"$*\" >>'{}'\n{script}", calls.display());
        self.program("bin/apt-get", &log);
    }

    /// What apt-get was to update and to install.
    fn calls(&self) -> Vec<String> {
        let calls = fs::read_to_string(self.0.join("calls")).unwrap_or_default();
        let after = |line: &str| line.split_once("https::Timeout=8 ").unwrap().1.to_owned();
        calls.lines().map(after).collect()
    }

    /// A rustc of a release that compiles for this target, with the sources of a library.
    fn rustc(&self, folder: &str, release: &str, target: &str, library: &str) -> String {
        let sysroot = self.0.join(folder);
        let sources = sysroot.join("lib/rustlib/src/rust/library").join(library);
        fs::create_dir_all(sources.join("src")).unwrap();
        fs::write(sources.join("src/lib.rs"), "").unwrap();
        self.program(
            &format!("{folder}/bin/rustc"),
            &format!(
                "case \"$*\" in
                 *--target*{target}*) exit 0 ;;
                 *--target*) echo 'error: no back end' >&2; exit 1 ;;
                 '-vV') echo 'release: {release}' ;;
                 '--print sysroot') echo '{}' ;;
                 esac",
                sysroot.display()
            ),
        )
    }

    fn run(&self, script: &mut Command) -> Result<String, String> {
        let script = script
            .stderr(Stdio::piped())
            .env("PATH", self.0.join("bin"))
            .env("DEBIAN_RUSTC", self.0.join("debian/bin/rustc"))
            .env_remove("CARGO")
            .env_remove("RUSTC")
            .env_remove("CC");
        answer(script).map_err(|why| why.to_string())
    }

    /// What a probe finds, or why it fails.
    fn find(&self, probe: &str) -> Result<String, String> {
        let mut find = script("find");
        find.args(probe.split(' ')).env_remove("SINGLETRACK_RUSTC");
        self.run(&mut find)
    }

    /// Searches a compiler, and perhaps a named one; returns its path, and its cargo.
    fn compiler(&self, probe: &str, named: Option<&str>) -> Result<Vec<String>, String> {
        let mut find = script("find");
        find.args(probe.split(' '));
        find.env("SINGLETRACK_RUSTC", named.unwrap_or_default());
        let found = self.run(&mut find)?;
        Ok(found.lines().skip(1).map(str::to_owned).collect())
    }

    fn ensure(&self, parts: &[&str]) -> Result<String, String> {
        let mut ensure = script("ensure");
        ensure.args(parts).env_remove("SINGLETRACK_RUSTC");
        self.run(&mut ensure)
    }
}

impl Drop for Machine {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

const ARMV7: &str = "compiler armv7-unknown-linux-gnueabihf std";

/// The packages of the two parts that the tests install.
const PACKAGES: &str = "chromium debhelper lintian";

#[test]
fn missing_packages_are_installed_at_once_from_refreshed_lists() {
    let machine = Machine::new("install");
    let bin = machine.0.join("bin");
    machine.apt(&format!(
        "case \"$*\" in *install*)
             for name in chromium dpkg-architecture dpkg-deb man lintian; do ln -s /bin/true '{0}'/$name; done
             printf '#!/bin/sh\\necho installsysusers\\n' >'{0}/dh'; chmod +x '{0}/dh' ;;
         esac",
        bin.display()
    ));
    machine.sh(
        "for tool in chmod ln; do ln -s \"$(command -v $tool)\" \"$1/bin\"; done",
        "",
    );
    machine.ensure(&["browser", "debian"]).unwrap();
    assert_eq!(
        machine.calls(),
        ["update --error-on=any", &format!("install {PACKAGES}")]
    );
    machine.ensure(&["browser", "debian"]).unwrap();
    assert_eq!(
        machine.calls().len(),
        2,
        "what works is not installed again"
    );
}

#[test]
fn unmet_prerequisites_are_reported_with_a_fix() {
    let machine = Machine::new("short");
    // Another program holds the lists for a moment.
    machine.apt(&format!(
        "case \"$*\" in
         *update*) [ -e '{0}' ] || {{ : >'{0}'; echo 'E: Could not get lock x'; exit 100; }} ;;
         *chromium*) echo 'E: Unable to locate package chromium' >&2; exit 100 ;;
         esac",
        machine.0.join("locked").display()
    ));
    let why = machine.ensure(&["uno", "browser", "debian"]).unwrap_err();
    for part in [
        "7 prerequisites are not met",
        "  Chromium\n    found    ",
        "get it   apt-get update && apt-get install debhelper lintian   (Debian 12)\n",
        "get it   rustup toolchain install nightly --component rust-src,clippy\n             or name",
        "\napt-get install: E: Unable to locate package chromium\n",
        "packaging/Containerfile",
        "cargo verify --without uno,browser,web,debian",
    ] {
        assert!(why.contains(part), "{part}\n{why}");
    }
    assert!(!why.contains("lock"), "{why}");
    // One package that does not exist does not prevent the others.
    let calls = machine.calls();
    assert!(
        calls[2].ends_with("libelf-dev chromium debhelper lintian"),
        "{calls:?}"
    );
    assert_eq!(
        calls[calls.len() - 2..],
        ["install debhelper", "install lintian"]
    );
}

#[test]
fn a_named_compiler_is_not_replaced_by_a_package() {
    let machine = Machine::new("named");
    machine.apt("");
    let mut ensure = script("ensure");
    ensure
        .arg("armhf")
        .env("SINGLETRACK_RUSTC", "/no/such/rustc");
    let why = machine.run(&mut ensure).unwrap_err();
    assert!(
        why.contains("SINGLETRACK_RUSTC names /no/such/rustc"),
        "{why}"
    );
    assert!(!machine.calls().concat().contains("rustc-web"), "{why}");
}

#[test]
fn without_network_apt_or_rights_the_reason_is_reported() {
    let machine = Machine::new("offline");
    let why = machine.ensure(&["browser"]).unwrap_err();
    assert!(why.contains("There is no apt-get here"), "{why}");
    machine.apt("echo 'W: old'; echo \"E: Failed to fetch for $*\"; exit 100");
    let why = machine.ensure(&["browser"]).unwrap_err();
    assert!(why.contains("apt-get update: E: Failed to fetch"), "{why}");
    assert!(!why.contains("W: "), "{why}");
    assert_eq!(
        machine.calls().len(),
        2,
        "no more downloads, which would fail too"
    );
    machine.program("bin/id", "echo 1000");
    let why = machine.ensure(&["browser"]).unwrap_err();
    assert!(why.contains("by hand"), "{why}");
    machine.program(
        "bin/sudo",
        "[ \"$1\" = -n ] && shift && { [ \"$1\" = true ] || exec \"$@\"; }",
    );
    let why = machine.ensure(&["browser"]).unwrap_err();
    assert!(why.contains("apt-get update: E: Failed to fetch"), "{why}");
}

#[test]
fn the_first_compiler_that_works_is_used() {
    let machine = Machine::new("compilers");
    let debians = machine.rustc("debian", "1.96.0", "avr-none", "core");
    let found = |call: &str| machine.compiler(call, None);
    let clippy = format!("{AVR} clippy");
    assert_eq!(found(AVR).unwrap(), [debians.as_str()]);
    // A nightly comes before, once it has the sources.
    let nightly = machine.rustc("nightly", "1.99.0-nightly", "avr-none", "alloc");
    machine.program(
        "bin/rustup",
        &format!(
            "case \"$*\" in
             'toolchain list') echo 'stable (active, default)'; echo 'nightly-x (override)' ;;
             'which --toolchain nightly-x rustc') echo '{nightly}' ;;
             *) exit 1 ;;
             esac"
        ),
    );
    assert_eq!(found(AVR).unwrap(), [debians.as_str()]);
    machine.rustc("nightly", "1.99.0-nightly", "avr-none", "core");
    assert_eq!(found(AVR).unwrap(), [nightly.as_str()]);
    // Its cargo if that is of the same release.
    machine.program("nightly/bin/cargo", "echo 'release: 0.66.0'");
    assert_eq!(found(AVR).unwrap(), [nightly.as_str()]);
    let cargo = machine.program("nightly/bin/cargo", "echo 'release: 1.99.0'");
    assert_eq!(found(AVR).unwrap(), [nightly.clone(), cargo]);
    // With its clippy.
    let why = found(&clippy).unwrap_err();
    assert!(
        why.contains("nightly/bin/clippy-driver is of rustc (it does not run)"),
        "{why}"
    );
    machine.program("debian/bin/clippy-driver", "echo 'release: 1.85.0'");
    let why = found(&clippy).unwrap_err();
    assert!(
        why.contains("is of rustc 1.85.0, the compiler is 1.96.0"),
        "{why}"
    );
    machine.program("debian/bin/clippy-driver", "echo 'release: 1.96.0'");
    assert_eq!(found(&clippy).unwrap(), [debians.as_str()]);
    // A named compiler is not replaced.
    let named = |rustc: &str| machine.compiler(AVR, Some(rustc));
    let mine = machine.rustc("mine", "1.97.0", "avr-none", "core");
    assert_eq!(named(&mine).unwrap(), [mine.as_str()]);
    machine.rustc("mine", "1.97.0", "none-of-ours", "core");
    let why = named(&mine).unwrap_err();
    assert!(
        why.ends_with("can't compile for avr-none: error: no back end"),
        "{why}"
    );
    let why = named("/no/such/rustc").unwrap_err();
    assert_eq!(
        why,
        "SINGLETRACK_RUSTC names /no/such/rustc, which does not run"
    );
}

#[test]
fn unsuitable_compilers_are_reported_with_what_they_lack() {
    let machine = Machine::new("unsuitable");
    let lack = |call| machine.compiler(call, None).unwrap_err();
    assert!(lack(AVR).ends_with("debian/bin/rustc does not run"));
    machine.rustc("debian", "1.85.0", "avr-none", "core");
    assert!(
        lack(AVR).ends_with("rustc 1.85.0, is older than 1.95"),
        "{}",
        lack(AVR)
    );
    machine.rustc("debian", "1.100.0", "avr-none", "core");
    machine.compiler(AVR, None).unwrap();
    assert!(lack(ARMV7).contains("can't compile for armv7-unknown-linux-gnueabihf"));
    machine.rustc("debian", "1.96.0", "armv7", "core");
    assert!(lack(ARMV7).contains("lacks the sources of std"));
    machine.rustc("debian", "1.96.0", "armv7", "std");
    machine.compiler(ARMV7, None).unwrap();
}

#[test]
fn programs_are_tried_and_not_only_looked_for() {
    let machine = Machine::new("programs");
    let lacks = |probe: &str, why: &str| {
        let found = machine.find(probe).unwrap_err();
        assert!(found.contains(why), "{probe}: {found}");
    };
    let attempt = |probe: &str| machine.find(probe);
    lacks("systemd", "systemd-analyze: command not found");
    machine.program("bin/systemd-analyze", "echo 'systemd 247 (247.3-7)'");
    lacks("systemd", "systemd 247, not 250 or later");
    machine.program("bin/systemd-analyze", "echo 'systemd 252 (252.38-1)'");
    assert_eq!(attempt("systemd").is_ok(), Path::new("/bin/kill").exists());

    for tool in ["bin/dpkg-architecture", "bin/dpkg-deb", "bin/man"] {
        lacks("debhelper", "not found");
        machine.program(tool, "");
    }
    machine.program("bin/dh", "echo systemd");
    lacks("debhelper", "dh lacks installsysusers");
    machine.program("bin/dh", "echo installsysusers; echo systemd");
    attempt("debhelper").unwrap();

    lacks(
        "emulates arm-linux-gnueabihf qemu-arm-static",
        "arm-linux-gnueabihf-gcc: command not found",
    );
    machine.program("bin/arm-linux-gnueabihf-gcc", "");
    attempt("c_for_odroid").unwrap();
    machine.program("bin/qemu-arm-static", "exit 1");
    lacks(
        "emulates arm-linux-gnueabihf qemu-arm-static",
        "qemu-arm-static does not run a program: status 1",
    );
    machine.program("bin/qemu-arm-static", "[ \"$1\" = --version ] || exit 42");
    attempt("emulates arm-linux-gnueabihf qemu-arm-static").unwrap();

    machine.program(
        "bin/avr-gcc",
        "echo 'avr/io.h: error: No such file' >&2; exit 1",
    );
    lacks("c_for_uno", "avr/io.h: error");
    machine.program("bin/avr-gcc", "");
    lacks("c_for_uno", "avr-nm: command not found");
}

#[test]
fn only_the_selected_parts_have_prerequisites() {
    let machine = Machine::new("parts");
    let unmet = |parts: &[&str]| machine.ensure(parts).unwrap_err();
    let base = unmet(&["base"]);
    assert!(base.starts_with("3 prerequisites are not met"), "{base}");
    assert!(unmet(&["uno"]).contains("simavr"));
    assert!(!unmet(&["odroid", "units"]).contains("simavr"));
    assert!(!unmet(&["image"]).contains("clippy for"));
}

#[test]
fn the_list_has_the_packages_of_every_part() {
    let list = |parts: &[&str]| {
        let list = Command::new(root().join("packaging/prerequisites"))
            .arg("--list")
            .args(parts)
            .output();
        let list = list.unwrap();
        assert!(list.status.success(), "{parts:?}");
        String::from_utf8(list.stdout).unwrap()
    };
    for part in PARTS {
        let is_empty = list(&[part]).trim().is_empty();
        assert_eq!(is_empty, part == "zenoh", "{part}");
    }
    let named = fs::read_to_string(root().join("xtask/src/prerequisites.sh")).unwrap();
    for part in PARTS {
        assert!(named.contains(&format!("{part} ")), "{part}");
    }
    for part in ["base", "rust", "flash", "arm64", "git", "podman"] {
        assert!(named.contains(&format!("\" {part} \"")), "{part}");
        assert_ne!(list(&[part]).trim(), "", "{part}");
    }
    let read = |path: &str| fs::read_to_string(root().join(path)).unwrap();
    assert!(read("packaging/Containerfile").contains("RUN prerequisites && "));
    assert!(read(".ci/run").contains("\npackaging/prerequisites "));
    let all = list(&[]);
    assert!(all.contains("gcc-avr") && !all.contains("podman"), "{all}");
}

#[test]
fn variables_that_change_a_build_are_recognised() {
    for name in [
        "RUSTFLAGS",
        "CARGO_ENCODED_RUSTFLAGS",
        "CARGO_BUILD_TARGET",
        "CARGO_PROFILE_RELEASE_OPT_LEVEL",
        "CARGO_TARGET_DIR",
        "CARGO_UNSTABLE_BUILD_STD",
    ] {
        assert!(changes_a_build(name), "{name}");
    }
    for name in [
        "PATH",
        "CARGO",
        "CARGO_HOME",
        "CARGO_NET_OFFLINE",
        "CARGO_REGISTRIES_X_INDEX",
    ] {
        assert!(!changes_a_build(name), "{name}");
    }
}
