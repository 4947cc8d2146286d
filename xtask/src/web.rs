//! `cargo web`: the laboratory in a browser, a folder of static files; and its checks, in Node and in
//! Chromium.

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use crate::{
    odroid, prerequisites,
    process::{At as _, Result, check, command, failure, output, require, silent, text},
    programs::Packages,
    step::least_s,
    target,
    toolchain::{Compiler, cross},
    workspace::root,
};

pub(crate) const USAGE: &str = "\
usage: cargo web

Build the laboratory for a browser into the folder web/site of the target folder, and print its path.
Any server of static files serves it. Installs missing Debian packages.
";

/// The target of the compiler.
const WASM: &str = "wasm32-unknown-unknown";

/// Files of the page, which the laboratory shares, with their places.
const SHARED: [(&str, &str); 7] = [
    ("tools/viewers/src/page/assets/chart.js", "chart.js"),
    ("tools/viewers/src/page/assets/view.js", "view.js"),
    ("tools/viewers/src/page/assets/page.css", "page.css"),
    ("tools/viewers/src/page/assets/icon.svg", "icon.svg"),
    (
        "tools/scenarios/circle-car.toml",
        "scenarios/circle-car.toml",
    ),
    ("tools/scenarios/steps-car.toml", "scenarios/steps-car.toml"),
    (
        "tools/scenarios/best/circle-1.0-lqi.toml",
        "scenarios/circle-lqi.toml",
    ),
];

/// Scenarios whose trajectories are compared, besides those for the Odroid: with marker losses, and
/// each outer loop.
const SCENARIOS: [&str; 4] = [
    "tools/scenarios/steps-car.toml",
    "tools/scenarios/best/circle-1.0-lqi.toml",
    "web/static/scenarios/circle-mpc.toml",
    "web/static/scenarios/eight-losses.toml",
];

/// The largest size of all files after gzip, in bytes.
const LARGEST: u64 = 1_600_000;

/// The least speed of the simulation, as a fraction of that of the tested build.
const LEAST_SPEED: f64 = 0.5;

pub(crate) fn main(arguments: &[String]) -> Result {
    let has_none = arguments.is_empty();
    require!(has_none, "unexpected arguments {arguments:?}\n\n{USAGE}");
    prerequisites::ensure(&["wasm"])?;
    println!("{}", build_published()?.display());
    Ok(())
}

/// Makes the folder of static files as they are published, and returns it.
pub(crate) fn build_published() -> Result<PathBuf> {
    build(|_| {})
}

/// Makes the folder of static files with further options of cargo, and returns it. Their size is bounded.
fn build(options: fn(&mut Command)) -> Result<PathBuf> {
    let tools = prerequisites::find("wasm_tools")?;
    let [linker, clang, archiver] = tools.lines().collect::<Vec<_>>()[..] else {
        return Err(failure!("wasm_tools found {tools:?}"));
    };
    let compiler = Compiler::find(&format!("compiler {WASM} std"))?;
    let mut cargo = compiler.cargo(root());
    options(cargo.arg("rustc"));
    let folder = cross(&mut cargo, WASM, "web", "panic_abort", [linker, clang])?;
    cargo
        .env("AR_wasm32_unknown_unknown", archiver)
        .args(["--package", "singletrack-web"])
        // Of 1 MiB by default, which overflows without a message.
        .args(["--", "-Clink-arg=-zstack-size=16777216"]);
    check(cargo.stdout(Stdio::null()))?;
    let site = target::emptied("web/site")?;
    target::copy(&root().join("web/static"), &site)?;
    for (from, to) in SHARED {
        target::put(&root().join(from), &site.join(to))?;
    }
    let module = folder.join("singletrack_web.wasm");
    target::put(&module, &site.join("singletrack.wasm"))?;
    check_size(&site)?;
    Ok(site)
}

/// Checks that the laboratory has the bits of the tested build, in Node and in Chromium, and the
/// bounds of its size and speed.
pub(crate) fn verify(packages: &Packages) -> Result {
    let site = build(|cargo| odroid::quickly(cargo, "web", &odroid::OTHERS[..2]))?;
    let node = |check: &str| {
        let mut node = command(&format!("node web/check/{check}.mjs"));
        node.current_dir(root()).arg(&site);
        node
    };
    let scenarios = [&odroid::SCENARIOS[..], &SCENARIOS].concat();
    let builds = "this machine and Node";
    odroid::compare(packages, &scenarios, builds, |scenario| {
        output(node("node").args(["trajectory", scenario]))
    })?;
    let folder = target::emptied("web/checked")?;
    let (scenario, record) = ("tools/scenarios/circle-car.toml", folder.join("drive.mcap"));
    let mut drive = packages.program("singletrack")?;
    silent(drive.args(["simulate", scenario, "--record"]).arg(&record))?;
    let mut again = packages.program("singletrack")?;
    let digest = text(again.args(["simulate", scenario, "--format", "digest"]))?;
    let replayed = text(node("node").arg("replay").arg(&record))?;
    require!(
        replayed == digest,
        "the record has the digest {digest}, replayed in Node {replayed}"
    );
    check_speed(packages, scenario, &mut node("node"))?;
    check(node("browser").arg(&record).arg(digest.trim()).arg(&folder))
}

fn check_size(site: &Path) -> Result {
    let archive = site.with_extension("tar.gz");
    target::pack(site, &archive)?;
    let size = fs::metadata(&archive).at(&archive)?.len();
    println!("all files after gzip: {size} bytes, at most {LARGEST}");
    require!(size <= LARGEST, "the files are too large");
    Ok(())
}

/// Compares processor times, the best of three runs each.
fn check_speed(packages: &Packages, scenario: &str, node: &mut Command) -> Result {
    let mut simulate = packages.program("trajectory")?;
    let native_s = least_s(3, simulate.arg(scenario))?;
    let measured = text(node.arg("time").arg(scenario))?;
    let wasm_s = measured.trim().parse::<f64>();
    let wasm_s = wasm_s.map_err(|_| failure!("Node printed {measured:?}"))?;
    let speed = native_s / wasm_s;
    println!("{scenario}: {native_s:.3} s here, {wasm_s:.3} s in Node, {speed:.2} of the speed");
    let is_slow = speed < LEAST_SPEED;
    require!(!is_slow, "slower than {LEAST_SPEED} of the tested build");
    Ok(())
}
