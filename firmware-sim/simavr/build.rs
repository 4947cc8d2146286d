//! Compiles the shim in C and links simavr, if the feature asks for it.

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    #[cfg(feature = "simavr")]
    simavr::link();
}

#[cfg(feature = "simavr")]
mod simavr {
    use std::path::Path;

    const HEADERS: &str = "/usr/include/simavr";

    pub(super) fn link() {
        println!("cargo::rerun-if-changed=src/shim.c");
        println!("cargo::rerun-if-changed={HEADERS}/sim_avr.h");
        if !Path::new(HEADERS).join("sim_avr.h").is_file() {
            println!(
                "cargo::error=there is no {HEADERS}/sim_avr.h: \
                 apt-get install libsimavr-dev libelf-dev"
            );
            return;
        }
        cc::Build::new()
            .file("src/shim.c")
            .include("/usr/include")
            .include(HEADERS)
            .flag_if_supported("-std=gnu11")
            // simavr's own headers.
            .flag_if_supported("-Wno-unused-parameter")
            .compile("shim");
        println!("cargo::rustc-link-lib=static=simavr");
        for directory in ["x86_64", "aarch64", "i386", "arm"].map(|machine| match machine {
            "arm" => "/usr/lib/arm-linux-gnueabihf".to_owned(),
            _ => format!("/usr/lib/{machine}-linux-gnu"),
        }) {
            if Path::new(&directory).join("libsimavr.a").is_file() {
                println!("cargo::rustc-link-search=native={directory}");
            }
        }
    }
}
