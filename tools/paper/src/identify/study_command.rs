//! `singletrack identify --study`: how accurate the identification is.

use std::fmt::Write as _;

use clap::{Args, ValueEnum};
use singletrack_campaign::{Campaign, CampaignArgs};
use singletrack_control::SlipAngles;

use super::{
    IdentifyError, TyreKind,
    study::{Study, StudyPlan},
};

/// Options of the study.
#[derive(Clone, Debug, Default, Args)]
pub struct StudyArgs {
    /// Identify simulated drives whose truth is known, one per seed, and print how far the
    /// estimates are off.
    #[arg(
        long,
        conflicts_with_all = [
            "record", "validate", "vehicle", "parameters", "drive", "least_speed", "out", "format",
        ]
    )]
    pub study: bool,

    /// First seed.
    #[arg(long, value_name = "N", default_value_t = 1, requires = "study")]
    pub first_seed: u64,

    /// Number of consecutive seeds.
    #[arg(long, value_name = "M", default_value_t = 10, requires = "study")]
    pub count: u64,

    /// Tyres of the car that is driven; `--tyres` are those of the fit.
    #[arg(long, value_enum, default_value_t, requires = "study")]
    pub tyre_curve: TyreKind,

    /// Slip angles of the car that is driven; those of the fit are small.
    #[arg(long, value_enum, default_value_t, requires = "study")]
    pub slip_angles: SlipKind,

    /// How it is run.
    #[command(flatten)]
    pub campaign: CampaignArgs,
}

/// Slip angles of a simulated car.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum SlipKind {
    /// Of equation 1: sin x = x and cos x = 1.
    #[default]
    Small,
    /// Between the wheels and the velocities of their axles, with cos δ of the front force.
    Exact,
}

impl SlipKind {
    const fn slip_angles(self) -> SlipAngles {
        match self {
            Self::Small => SlipAngles::Small,
            Self::Exact => SlipAngles::Exact,
        }
    }
}

impl StudyArgs {
    /// Whether the study is wanted: the options of a campaign are only its own.
    pub(super) fn is_meant(&self) -> bool {
        let CampaignArgs {
            shard,
            json,
            from,
            threads,
        } = &self.campaign;
        let campaign = shard.is_some() || json.is_some() || threads.is_some();
        self.study || campaign || !from.is_empty()
    }
}

/// Runs the study, and returns its table.
pub(super) fn report(arguments: &StudyArgs, tyres: TyreKind) -> Result<String, IdentifyError> {
    let plan = StudyPlan {
        first_seed: arguments.first_seed,
        count: arguments.count,
        tyre_curve: arguments.tyre_curve.tyres(),
        slip_angles: arguments.slip_angles.slip_angles(),
        fitted_tyres: tyres.tyres(),
    };
    let campaign = Campaign::obtain(plan, &arguments.campaign)?;
    let results = campaign.results.into_iter();
    let study = Study::of(results.map(|(_, result)| result).collect())?;
    let mut text = String::new();
    // Writing to a string does not fail.
    let _ = table(&mut text, &study);
    Ok(text)
}

fn table(text: &mut String, study: &Study) -> std::fmt::Result {
    writeln!(
        text,
        "{:4} {:>10} {:>11} {:>10} {:>8} {:>10} {:>10} {:>8}",
        "", "truth", "mean", "deviation", "worst", "stated", "bound", "covered"
    )?;
    for summary in study.summaries() {
        writeln!(
            text,
            "{:4} {:>10} {:>11.6} {:>10.2e} {:>6.2} % {:>10.2e} {:>10.2e} {:>4} of {}",
            summary.parameter.name(),
            summary.truth,
            summary.mean,
            summary.deviation,
            100.0 * summary.worst_relative_error,
            summary.stated_deviation,
            summary.bound,
            summary.covered,
            study.seeds.len(),
        )?;
    }
    let [identification, validation] = study.nmpe();
    writeln!(
        text,
        "NMPE {identification:.4} identification, {validation:.4} validation"
    )?;
    for result in &study.seeds {
        for warning in &result.warnings {
            writeln!(text, "seed {}: warning: {warning}", result.seed)?;
        }
    }
    Ok(())
}
