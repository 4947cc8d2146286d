//! `singletrack-fmu`: writes the functional mock-up units.

use std::{
    env, fs,
    io::{self, Write as _},
    path::{Path, PathBuf},
    process::ExitCode,
};

use clap::Parser;
use singletrack_fmu::{Unit, description};
use zip::{ZipWriter, write::SimpleFileOptions};

/// Write the simulated car and the whole simulated system as functional mock-up units (FMI 3.0).
#[derive(Parser)]
#[command(name = "singletrack-fmu", version, max_term_width = 100)]
struct Cli {
    /// The folder for `singletrack_car.fmu` and `singletrack_system.fmu`, which are replaced.
    #[arg(default_value = ".")]
    folder: PathBuf,
}

fn main() -> ExitCode {
    match write_all(&Cli::parse().folder) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("singletrack-fmu: {error}");
            ExitCode::FAILURE
        }
    }
}

/// The library, which cargo builds with this program.
fn library() -> io::Result<Vec<u8>> {
    let (prefix, suffix) = (env::consts::DLL_PREFIX, env::consts::DLL_SUFFIX);
    let name = format!("deps/{prefix}singletrack_fmu{suffix}");
    let library = env::current_exe()?.with_file_name(name);
    fs::read(&library).map_err(|error| named(&library, &error))
}

fn named(path: &Path, error: &dyn std::error::Error) -> io::Error {
    io::Error::other(format!("{}: {error}", path.display()))
}

fn write_all(folder: &Path) -> io::Result<()> {
    let library = library()?;
    fs::create_dir_all(folder).map_err(|error| named(folder, &error))?;
    for unit in Unit::ALL {
        let path = folder.join(unit.name()).with_extension("fmu");
        write(unit, &library, &path).map_err(|error| named(&path, &error))?;
        println!("{}", path.display());
    }
    Ok(())
}

/// Writes a unit; without times, so that the same library gives the same bytes.
fn write(unit: Unit, library: &[u8], path: &Path) -> io::Result<()> {
    let mut archive = ZipWriter::new(fs::File::create(path)?);
    let options = SimpleFileOptions::default();
    let system = match env::consts::OS {
        "macos" => "darwin",
        system => system,
    };
    let (name, suffix) = (unit.name(), env::consts::DLL_SUFFIX);
    let binary = format!("binaries/{}-{system}/{name}{suffix}", env::consts::ARCH);
    let description = description(unit);
    for (name, bytes) in [
        ("modelDescription.xml", description.as_bytes()),
        (&binary, library),
    ] {
        archive.start_file(name, options)?;
        archive.write_all(bytes)?;
    }
    archive.finish()?;
    Ok(())
}
