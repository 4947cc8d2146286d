//! Compiles the C shim and links simavr.

use std::path::Path;

const HEADERS: &str = "/usr/include/simavr";
const ARCHIVE: &str = "libsimavr.a";

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    if let Err(error) = link() {
        println!("cargo::error={error}");
    }
}

fn link() -> Result<(), String> {
    let missing =
        |file: &str| format!("{file} is missing: apt-get install libsimavr-dev libelf-dev");
    println!("cargo::rerun-if-changed=src/shim.c");
    let header = format!("{HEADERS}/sim_avr.h");
    println!("cargo::rerun-if-changed={header}");
    if !Path::new(&header).is_file() {
        return Err(missing(&header));
    }
    let mut build = cc::Build::new();
    build
        .file("src/shim.c")
        .include(HEADERS)
        .flag_if_supported("-std=gnu11")
        // simavr's own headers.
        .flag_if_supported("-Wno-unused-parameter");
    let why = |error: cc::Error| error.to_string();
    let compiler = build.try_get_compiler().map_err(why)?;
    build.try_compile("shim").map_err(why)?;
    // The compiler knows the library folder of this machine on Debian.
    let found = compiler
        .to_command()
        .arg(format!("-print-file-name={ARCHIVE}"))
        .output()
        .map_err(|error| error.to_string())?;
    let archive = String::from_utf8_lossy(&found.stdout).trim().to_owned();
    match Path::new(&archive).parent() {
        Some(folder) if Path::new(&archive).is_absolute() => {
            println!("cargo::rustc-link-search=native={}", folder.display());
            println!("cargo::rustc-link-lib=static=simavr");
            Ok(())
        }
        _ => Err(missing(ARCHIVE)),
    }
}
