//! `singletrack lab`: the exercises of the course, with numbers for each student, and their marks.
//!
//! What is right is computed by the simulator and by the analysis of stability when an answer is
//! marked; no result is stored here.

mod answers;
mod centre_of_mass;
mod delay;
mod error;
mod exercise;
mod law;
mod marks;
mod rig;
mod student;

use std::{
    fs::{self, OpenOptions},
    io::{self, Write},
    path::PathBuf,
};

use clap::{Args, Subcommand, builder::RangedU64ValueParser};

pub use self::{
    answers::{Answers, template},
    error::LabError,
    exercise::{Exercise, Quantity},
    marks::{Grade, Mark, Marks, mark},
    student::Student,
};

/// How many labs there are.
pub const LABS: u8 = 3;

/// Options of `singletrack lab`.
#[derive(Clone, Debug, Args)]
pub struct LabArgs {
    #[command(subcommand)]
    command: LabCommand,
}

#[derive(Clone, Debug, Subcommand)]
enum LabCommand {
    /// Print the exercises of a lab with the numbers of a student, and write a file for the answers.
    Show(ShowArgs),
    /// Mark a file of answers: the simulator computes what is right.
    Mark(MarkArgs),
}

#[derive(Clone, Debug, Args)]
struct ShowArgs {
    /// 1: the law on the ideal car; 2: a wrong centre of mass; 3: stability and delay
    #[arg(value_name = "LAB", value_parser = RangedU64ValueParser::<u8>::new().range(1..=u64::from(LABS)))]
    lab: u8,
    /// The student, whose numbers these are: the same name gives the same numbers
    #[arg(long, value_name = "NAME")]
    student: String,
    /// The file for the answers [default: lab-LAB.toml]; one that exists is left as it is
    #[arg(long, value_name = "FILE.toml")]
    out: Option<PathBuf>,
}

#[derive(Clone, Debug, Args)]
struct MarkArgs {
    /// The file with the answers
    #[arg(value_name = "FILE.toml")]
    answers: PathBuf,
    /// Print one JSON object instead, for programs
    #[arg(long)]
    json: bool,
}

/// The title of a lab.
#[must_use]
pub const fn title(lab: u8) -> &'static str {
    match lab {
        1 => "the law on the ideal car",
        2 => "what a wrong centre of mass does",
        _ => "stability and delay",
    }
}

/// The exercises of a lab for a student.
///
/// # Errors
///
/// There is no such lab.
pub fn exercises(lab: u8, student: &Student) -> Result<Vec<Exercise>, LabError> {
    match lab {
        1 => Ok(law::exercises(student)),
        2 => Ok(centre_of_mass::exercises(student)),
        3 => Ok(delay::exercises(student)),
        _ => Err(LabError::NoSuchLab(i64::from(lab))),
    }
}

/// Runs the command.
///
/// # Errors
///
/// A file can't be read or written, or is no file of answers; an exercise can't be computed.
pub fn run(args: &LabArgs) -> Result<(), LabError> {
    let mut out = io::stdout().lock();
    let printed = match &args.command {
        LabCommand::Show(args) => show(args, &mut out)?,
        LabCommand::Mark(args) => {
            let text = fs::read_to_string(&args.answers).map_err(|source| LabError::Read {
                path: args.answers.clone(),
                source,
            })?;
            let answers = Answers::from_toml(&text).map_err(|error| error.of(&args.answers))?;
            let marks = mark(&answers)?;
            if args.json {
                let text = serde_json::to_string_pretty(&marks)?;
                writeln!(out, "{text}")
            } else {
                write!(out, "{marks}")
            }
        }
    };
    match printed {
        // The reader of a pipe may close it at any time.
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => Err(LabError::Print(error)),
        _ => Ok(()),
    }
}

fn show(args: &ShowArgs, out: &mut impl Write) -> Result<io::Result<()>, LabError> {
    let student = Student::new(&args.student)?;
    let exercises = exercises(args.lab, &student)?;
    let path = args
        .out
        .clone()
        .unwrap_or_else(|| PathBuf::from(format!("lab-{}.toml", args.lab)));
    let text = template(args.lab, &student, &exercises);
    let created = OpenOptions::new().write(true).create_new(true).open(&path);
    let written = match created.and_then(|mut file| file.write_all(text.as_bytes())) {
        Ok(()) => format!("Write your answers to {}.", path.display()),
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
            format!("{} exists and is left as it is.", path.display())
        }
        Err(source) => return Err(LabError::Write { path, source }),
    };
    let mut page = format!(
        "Lab {}: {}, for {}\n",
        args.lab,
        title(args.lab),
        student.name()
    );
    for exercise in &exercises {
        page.push_str(&format!("\n{exercise}\n"));
    }
    page.push_str(&format!(
        "\n{written} Mark them with: singletrack lab mark {}\n",
        path.display()
    ));
    Ok(out.write_all(page.as_bytes()))
}
