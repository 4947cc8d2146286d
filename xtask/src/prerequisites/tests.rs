//! Tests with stand-ins for the programs of a machine.

use std::fs;

use super::{catalogue::*, *};
use crate::{
    compiler::stand_in::{add_debians, add_nightly},
    machine::stand_in::Bare,
};

/// Tests only the compiler of the image.
fn ensure_compiler(machine: &Bare) -> (Result<(), Failure>, Vec<String>) {
    let mut found = Vec::new();
    let required = [IMAGE_COMPILER, IMAGE_CLIPPY];
    let result = ensure(&machine.machine, &required, &mut |line| {
        found.push(line.to_owned());
    });
    (result, found)
}

/// An apt-get that installs Debian's compiler of a release, or finds nothing until
/// its lists are refreshed.
fn add_apt(machine: &Bare, release: &str, needs_update: bool) {
    let debian = machine.folder.join("debian");
    let stamp = machine.folder.join("updated");
    machine.program(
        "apt-get",
        &format!(
            "{}\n\
             case \"$*\" in\n\
             *update*) : > '{stamp}' ;;\n\
             *install*)\n\
             if {} || [ -e '{stamp}' ]; then /bin/cp '{debian}/new/'* '{debian}/bin/'; \
             fi ;;\n\
             esac",
            machine.logged("apt-get"),
            !needs_update,
            stamp = stamp.display(),
            debian = debian.display(),
        ),
    );
    add_debians(machine, release, "avr-none");
    fs::rename(debian.join("bin"), debian.join("new")).unwrap();
    fs::create_dir(debian.join("bin")).unwrap();
}

/// Package lists that were just fetched.
fn add_lists(machine: &Bare) {
    fs::write(machine.machine.package_lists.join("main_Packages"), "").unwrap();
}

fn apt_calls(machine: &Bare) -> Vec<String> {
    let calls = machine.calls();
    calls
        .iter()
        .filter_map(|call| {
            ["update", "install"]
                .into_iter()
                .find_map(|verb| call.find(verb).map(|place| call[place..].to_owned()))
        })
        .collect()
}

const INSTALL: &str = "install --yes --no-install-recommends --no-remove";

#[test]
fn met_prerequisites_are_not_installed() {
    let machine = Bare::new("order");
    machine.program("apt-get", &machine.logged("apt-get"));
    add_debians(&machine, "1.96.0", "avr-none");
    let (result, found) = ensure_compiler(&machine);
    result.unwrap();
    assert_eq!(apt_calls(&machine), [""; 0]);
    assert!(
        found[0].starts_with("Rust for the Arduino: rustc 1.96.0 (Debian's rustc-web, "),
        "{found:?}"
    );
}

#[test]
fn an_old_compiler_is_upgraded_from_refreshed_lists() {
    let machine = Bare::new("too-old");
    add_apt(&machine, "1.96.0", false);
    add_debians(&machine, "1.85.0", "avr-none");
    let (result, found) = ensure_compiler(&machine);
    result.unwrap();
    assert_eq!(found.len(), 2);
    assert_eq!(
        apt_calls(&machine),
        [
            "update --error-on=any".to_owned(),
            format!("{INSTALL} rustc-web rust-web-src rust-web-clippy"),
        ]
    );
}

#[test]
fn recent_lists_with_an_old_compiler_are_refreshed() {
    let machine = Bare::new("stale-today");
    add_apt(&machine, "1.96.0", true);
    add_lists(&machine);
    let (result, _) = ensure_compiler(&machine);
    result.unwrap();
    let install = format!("{INSTALL} rustc-web rust-web-src rust-web-clippy");
    assert_eq!(
        apt_calls(&machine),
        [install.as_str(), "update --error-on=any", &install]
    );
}

#[test]
fn unmet_prerequisites_are_reported_with_a_fix() {
    let machine = Bare::new("still-short");
    add_apt(&machine, "1.85.0", false);
    machine.program(
        "dpkg-query",
        "echo 'installed rustc-web 1.85.0+dfsg3'; exit 1",
    );
    let (result, _) = ensure_compiler(&machine);
    let why = result.unwrap_err().to_string();
    for part in [
        "2 of 2 prerequisites are not met",
        "rustc 1.85.0 (Debian's rustc-web), is older than 1.95",
        "needed   a rustc 1.95 or later that compiles for avr-none",
        "packages rustc-web 1.85.0+dfsg3, not rust-web-src",
        "get it   apt-get update && apt-get install rustc-web rust-web-src   (Debian 12)",
        "get it   rustup toolchain install nightly --component rust-src,clippy",
        "packaging/Containerfile",
        "cargo verify --without uno\n",
    ] {
        assert!(why.contains(part), "{part}\n{why}");
    }
}

#[test]
fn the_message_reports_a_failed_download() {
    let machine = Bare::new("offline-all");
    machine.program(
        "apt-get",
        "case \"$*\" in *--version*) ;; *) echo 'E: no route to host'; exit 100 ;; esac",
    );
    let (result, _) = ensure_compiler(&machine);
    let why = result.unwrap_err().to_string();
    assert!(why.contains("is not installed"), "{why}");
    assert!(
        why.contains("apt-get update --error-on=any failed"),
        "{why}"
    );
    assert!(why.contains("E: no route to host"), "{why}");
}

#[test]
fn a_failed_refresh_is_reported_even_if_packages_are_installed() {
    let machine = Bare::new("half-offline");
    machine.program(
        "apt-get",
        &format!(
            "case \"$*\" in *update*) : > '{}/one_Packages'; echo 'E: no route to host'; exit 100 ;; \
             esac",
            machine.machine.package_lists.display()
        ),
    );
    add_debians(&machine, "1.85.0", "avr-none");
    let (result, _) = ensure_compiler(&machine);
    let why = result.unwrap_err().to_string();
    assert!(
        why.contains("apt-get update --error-on=any failed"),
        "{why}"
    );
    assert!(why.contains("is older than"), "{why}");
}

#[test]
fn a_missing_package_does_not_prevent_the_others() {
    let machine = Bare::new("ubuntu");
    machine.program(
        "apt-get",
        &format!(
            "{}\n\
             case \"$*\" in *rustc-web*) echo 'E: Unable to locate package rustc-web'; exit 100 ;; \
             esac",
            machine.logged("apt-get")
        ),
    );
    add_lists(&machine);
    let required = [IMAGE_COMPILER, IMAGE_LINKER];
    let result = ensure(&machine.machine, &required, &mut |_| {});
    assert!(result.unwrap_err().to_string().contains("Unable to locate"));
    let last = apt_calls(&machine).pop().unwrap();
    assert_eq!(last, format!("{INSTALL} gcc-avr avr-libc binutils-avr"));
}

#[test]
fn without_apt_the_message_lists_prerequisites_and_the_container() {
    let machine = Bare::new("no-apt");
    add_nightly(&machine, "1.99.0-nightly", &[]);
    let (result, _) = ensure_compiler(&machine);
    let why = result.unwrap_err().to_string();
    assert!(why.contains("rustup component add rust-src"), "{why}");
    assert!(why.contains("There is no apt-get here"), "{why}");
    assert!(why.contains("packaging/Containerfile"), "{why}");
    assert!(!why.contains("packages rustc-web"), "{why}");
}

#[test]
fn a_named_compiler_is_not_replaced_by_a_package() {
    let mut machine = Bare::new("named-package");
    add_apt(&machine, "1.96.0", false);
    machine.machine.named_compiler = Some("/no/such/rustc".into());
    let (result, _) = ensure_compiler(&machine);
    let why = result.unwrap_err().to_string();
    assert!(why.contains("/no/such/rustc"), "{why}");
    assert_eq!(apt_calls(&machine), [""; 0]);
}

#[test]
fn a_nightly_without_clippy_does_not_get_debians() {
    let machine = Bare::new("nightly-clippy");
    add_apt(&machine, "1.96.0", false);
    add_nightly(&machine, "1.99.0-nightly", &["core"]);
    let (result, _) = ensure_compiler(&machine);
    let why = result.unwrap_err().to_string();
    assert!(
        why.contains("rustup component add clippy --toolchain nightly-x86_64"),
        "{why}"
    );
    assert!(!why.contains("apt-get install"), "{why}");
    assert_eq!(apt_calls(&machine), [""; 0]);
}

#[test]
fn missing_or_old_programs_do_not_meet_prerequisites() {
    let machine = Bare::new("programs");
    let attempt = |one: Prerequisite| (one.attempt)(&machine.machine);
    assert_eq!(attempt(SYSTEMD), Err("no systemd-analyze".to_owned()));
    machine.program("systemd-analyze", "echo 'systemd 247 (247.3-7)'");
    assert!(attempt(SYSTEMD).unwrap_err().ends_with("not 250 or later"));
    machine.program("systemd-analyze", "echo 'systemd 252 (252.38-1)'");
    assert_eq!(attempt(SYSTEMD), Ok("systemd 252 (252.38-1)".to_owned()));

    for tool in ["dpkg-architecture", "dpkg-deb", "man"] {
        machine.program(tool, "");
    }
    assert_eq!(attempt(DEBHELPER), Err("no dh".to_owned()));
    machine.program("dh", "echo systemd");
    assert!(attempt(DEBHELPER).unwrap_err().ends_with("too old"));
    machine.program("dh", "echo installsysusers; echo systemd");
    attempt(DEBHELPER).unwrap();

    for one in [ODROID_LINKER, EMULATOR] {
        let why = attempt(one).unwrap_err();
        assert!(why.contains("no arm-linux-gnueabihf-gcc"), "{why}");
    }
    machine.program("arm-linux-gnueabihf-gcc", "");
    attempt(ODROID_LINKER).unwrap();
    assert!(
        attempt(EMULATOR)
            .unwrap_err()
            .contains("no qemu-arm-static")
    );
    machine.program("qemu-arm-static", "exit 1");
    assert!(
        attempt(EMULATOR)
            .unwrap_err()
            .contains("does not run a program")
    );
    machine.program("qemu-arm-static", "[ \"$1\" = --version ] || exit 42");
    attempt(EMULATOR).unwrap();

    machine.program("avr-gcc", "echo 'avr/io.h: error: No such file'; exit 1");
    assert!(
        attempt(IMAGE_LINKER)
            .unwrap_err()
            .contains("avr/io.h: error")
    );
    machine.program("avr-gcc", "");
    assert_eq!(attempt(IMAGE_LINKER), Err("no avr-nm".to_owned()));
}

#[test]
fn only_the_selected_parts_have_prerequisites() {
    let names =
        |parts: &[Part]| -> Vec<&str> { of_parts(parts).into_iter().map(|one| one.name).collect() };
    assert_eq!(names(&[]), ["rustfmt", "clippy", "C compiler"]);
    assert!(names(&[Part::Uno]).contains(&"simavr"));
    assert!(!names(&[Part::Odroid, Part::Units]).contains(&"simavr"));
}

#[test]
fn the_container_has_all_packages() {
    let recipe = crate::workspace::root().join("packaging/Containerfile");
    let recipe = fs::read_to_string(recipe).unwrap();
    let words: Vec<&str> = recipe.split_whitespace().collect();
    for one in of_parts(&Part::ALL)
        .iter()
        .chain([&PROGRAMMER])
        .chain(&PACKAGE_ARM64)
    {
        for package in one.packages {
            assert!(words.contains(package), "{package}");
        }
    }
}
