//! Writes the generated corpus.

use std::{error::Error, fs, path::Path};

use singletrack_fuzz::{TARGETS, seeds::seeds};

fn main() -> Result<(), Box<dyn Error>> {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus");
    for target in TARGETS {
        let folder = corpus.join(target.name);
        fs::create_dir_all(&folder)?;
        let seeds = seeds(target.name);
        for seed in &seeds {
            fs::write(folder.join(&seed.name), &seed.bytes)?;
        }
        println!("{}: {} files", folder.display(), seeds.len());
    }
    Ok(())
}
