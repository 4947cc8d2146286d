//! `cargo web`: the laboratory in a browser, a folder of static files; and its checks, in Node and in
//! Chromium.

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use crate::{
    odroid,
    prerequisites::{self, Compiler, cross},
    process::{Result, at, check, command, failure, require, silent, text},
    programs::Packages,
    step::least_s,
    workspace::{copy, emptied, put, root},
};

pub(crate) const USAGE: &str = "\
usage: cargo web

Build the laboratory for a browser into the folder web/site of the target folder, and print its path.
Any server of static files serves it. Installs missing Debian packages.
";

/// The target of the compiler.
const WASM: &str = "wasm32-unknown-unknown";

/// Files of the page, which the laboratory shares.
const PAGE: [&str; 4] = ["chart.js", "view.js", "page.css", "icon.svg"];

/// Scenarios that the laboratory shows, with their names there.
const SHOWN: [(&str, &str); 3] = [
    ("circle-car.toml", "circle-car.toml"),
    ("steps-car.toml", "steps-car.toml"),
    ("best/circle-1.0-lqi.toml", "circle-lqi.toml"),
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
    cargo.env("AR_wasm32_unknown_unknown", archiver);
    // The stack is 1 MiB by default, which overflows without a message.
    let stack = "-Clink-arg=-zstack-size=16777216";
    cargo.args(["--package", "singletrack-web", "--", stack]);
    check(cargo.stdout(Stdio::null()))?;
    let site = emptied("web/site")?;
    copy(&root().join("web/static"), &site)?;
    let assets = root().join("tools/viewers/src/page/assets");
    for name in PAGE {
        put(&assets.join(name), &site.join(name))?;
    }
    let (scenarios, shown) = (root().join("tools/scenarios"), site.join("scenarios"));
    for (from, to) in SHOWN {
        put(&scenarios.join(from), &shown.join(to))?;
    }
    let module = folder.join("singletrack_web.wasm");
    put(&module, &site.join("singletrack.wasm"))?;
    check_size(&site)?;
    Ok(site)
}

/// Checks that the laboratory has the bits of the tested build, in Node and in Chromium, and the
/// bounds of its size and speed.
pub(crate) fn verify(packages: &Packages) -> Result {
    let site = build(|cargo| odroid::quickly(cargo, "web", &odroid::OTHERS[..2]))?;
    let node = |check: &str, arguments: &[&str]| {
        let mut node = command(&format!("node web/check/{check}.mjs"));
        node.current_dir(root()).arg(&site).args(arguments);
        node
    };
    let scenarios = [&odroid::SCENARIOS[..], &SCENARIOS].concat();
    let builds = "this machine and Node";
    odroid::compare(packages, &scenarios, builds, || {
        node("node", &["trajectory"])
    })?;
    let folder = emptied("web/checked")?;
    let (scenario, record) = ("tools/scenarios/circle-car.toml", folder.join("drive.mcap"));
    let mut drive = packages.program(&format!("singletrack simulate {scenario} --record"))?;
    silent(drive.arg(&record))?;
    let simulate = format!("singletrack simulate {scenario} --format digest");
    let digest = text(&mut packages.program(&simulate)?)?;
    let replayed = text(node("node", &["replay"]).arg(&record))?;
    require!(
        replayed == digest,
        "the record has the digest {digest}, replayed in Node {replayed}"
    );
    check_speed(packages, scenario, &mut node("node", &["time"]))?;
    let mut browser = node("browser", &[]);
    browser.arg(&record).arg(digest.trim());
    check(browser.arg(&folder))
}

fn check_size(site: &Path) -> Result {
    let archive = site.with_extension("tar.gz");
    let mut tar = command("tar --create --sort=name --gzip --file");
    tar.arg(&archive).arg("--directory").arg(site);
    silent(tar.arg("."))?;
    let size = fs::metadata(&archive).map_err(at(&archive))?.len();
    println!("all files after gzip: {size} bytes, at most {LARGEST}");
    require!(size <= LARGEST, "the files are too large");
    Ok(())
}

/// Compares processor times, the best of three runs each.
fn check_speed(packages: &Packages, scenario: &str, node: &mut Command) -> Result {
    let mut simulate = packages.program(&format!("trajectory {scenario}"))?;
    let native_s = least_s(3, &mut simulate)?;
    let measured = text(node.arg(scenario))?;
    let wasm_s = measured.trim().parse::<f64>();
    let wasm_s = wasm_s.map_err(|_| failure!("Node printed {measured:?}"))?;
    let speed = native_s / wasm_s;
    println!("{scenario}: {native_s:.3} s here, {wasm_s:.3} s in Node, {speed:.2} of the speed");
    let is_quick = speed >= LEAST_SPEED;
    require!(is_quick, "slower than {LEAST_SPEED} of the tested build");
    Ok(())
}
