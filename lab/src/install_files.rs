//! `singletrack-lab install-files`: completions for shells and manual pages of all programs, from
//! the description of the options itself.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use clap::{Args, Command, CommandFactory as _, ValueEnum};
use clap_complete::{Shell, generate, generate_to};

/// Options of `singletrack-lab install-files`.
#[derive(Clone, Debug, Args)]
pub struct InstallFilesArgs {
    /// The folder for them; it gets one each for bash, zsh, fish and man
    #[arg(long, value_name = "DIR", default_value = "target/install-files")]
    out: PathBuf,
}

/// A shell with completions.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum CompletedShell {
    /// Write it to `~/.local/share/bash-completion/completions/singletrack`.
    Bash,
    /// Write it to a folder of `fpath`, as `_singletrack`.
    Zsh,
    /// Write it to `~/.config/fish/completions/singletrack.fish`.
    Fish,
}

impl CompletedShell {
    const fn shell(self) -> Shell {
        match self {
            Self::Bash => Shell::Bash,
            Self::Zsh => Shell::Zsh,
            Self::Fish => Shell::Fish,
        }
    }
}

/// Prints the completions of `singletrack`, with the commands of the laboratory, which `command`
/// describes.
///
/// # Errors
///
/// When standard output can't be written; a closed pipe is no error.
pub fn print(shell: CompletedShell, command: &Command) -> crate::Result {
    let mut text = Vec::new();
    let mut command = singletrack(command);
    generate(shell.shell(), &mut command, "singletrack", &mut text);
    crate::print(&String::from_utf8_lossy(&text))
}

/// `singletrack` with the commands of the laboratory.
fn singletrack(command: &Command) -> Command {
    let commands = command.get_subcommands().cloned();
    shown(&singletrack::program::command().subcommands(commands))
}

/// Writes the files for `singletrack`, with the commands of the laboratory, which `command`
/// describes, for `singletrackd` and for `singletrack-sim`.
///
/// # Errors
///
/// When a file can't be written.
pub fn run(args: &InstallFilesArgs, command: &Command) -> Result<(), String> {
    for command in [
        &singletrack(command),
        &singletrackd::Arguments::command(),
        &singletrack_sim::Arguments::command(),
    ] {
        let name = command.get_name();
        for shell in CompletedShell::value_variants() {
            let shell = shell.shell();
            write_to(&args.out.join(shell.to_string()), |folder| {
                generate_to(shell, &mut command.clone(), name, folder).map(drop)
            })?;
        }
        write_to(&args.out.join("man"), |folder| {
            clap_mangen::generate_to(command.clone(), folder)
        })?;
    }
    // Its commands have their pages as those of `singletrack`, as which they are typed.
    let mut own = Command::new("singletrack-lab")
        .version(env!("CARGO_PKG_VERSION"))
        .after_help("Its commands are typed as `singletrack COMMAND`: see singletrack(1).");
    if let Some(about) = command.get_about() {
        own = own.about(about.clone());
    }
    write_to(&args.out.join("man"), |folder| {
        clap_mangen::generate_to(own, folder)
    })
}

/// The command without the subcommands that its help does not show, which completions do.
fn shown(command: &Command) -> Command {
    let subcommands = command.get_subcommands().filter(|one| !one.is_hide_set());
    let mut shown = Command::new("singletrack")
        .version(env!("CARGO_PKG_VERSION"))
        .args(command.get_arguments().cloned())
        .subcommands(subcommands.cloned());
    if let Some(about) = command.get_about() {
        shown = shown.about(about.clone());
    }
    if let Some(text) = command.get_after_long_help() {
        shown = shown.after_long_help(text.clone());
    }
    shown
}

fn write_to(folder: &Path, write: impl FnOnce(&Path) -> io::Result<()>) -> Result<(), String> {
    fs::create_dir_all(folder)
        .and_then(|()| write(folder))
        .map_err(|error| {
            let folder = folder.display();
            format!("can't write to {folder}: {error}; choose another folder with --out")
        })
}
