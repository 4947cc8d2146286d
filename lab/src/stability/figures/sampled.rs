//! The sampled loop, which the paper leaves out: ticks, delay and missing poses.

use singletrack_analysis::stability::MarginLimits;
use singletrack_figures::figure::{Curve, Figure, Grid, GridError, Map, Panel, Shade};

use super::{
    super::{SampledRow, TimingArgs},
    levels::{around_one, margins},
    scene::{DEVIATION, Frame, SPEED, Scene, band, grid_of},
};

/// The maps of the sampled loop with their names: how fast disturbances decay from tick to tick,
/// and the delay and the longest time between poses that it survives.
///
/// # Errors
///
/// Rows that are not a grid: fewer than two speeds or deviations.
pub fn sampled(
    scene: &Scene,
    timing: TimingArgs,
    rows: &[SampledRow],
) -> Result<[(&'static str, Figure); 3], GridError> {
    let TimingArgs {
        period_ms,
        delay_ms,
        marker_interval,
        ..
    } = timing;
    let limits = MarginLimits::default();
    let grid =
        |value: fn(&SampledRow) -> f64| grid_of(rows, |row| [row.speed_m_s, row.dl_m], value);
    let radius = grid(|row| row.spectral_radius)?;
    let radius = Map {
        bands: vec![
            band(0.0, 1.0, Shade::Light, "stable"),
            band(1.0, f64::INFINITY, Shade::Dark, "unstable"),
        ],
        isolines: around_one(&radius),
        isoline_name: "spectral radius".to_owned(),
        grid: radius,
    };
    let seen = match marker_interval {
        1 => "at every tick".to_owned(),
        interval => format!("every {interval} ticks"),
    };
    let radius = figure(
        scene,
        timing,
        "Spectral radius of a tick",
        &format!(
            "Factor by which a disturbance grows or decays from tick to tick in the long run, \
             with a pose {seen} and commands that act {delay_ms} ms late: below one the motion is \
             stable."
        ),
        radius,
    );
    let delay = figure(
        scene,
        timing,
        "Delay margin",
        "Delay from measurement to command from which on the motion is unstable, in ms, with a \
         pose at every tick: the darker, the less, and hatched where it is unstable without delay.",
        margin_map(
            grid(|row| in_ms(row.delay_margin_s))?,
            0.0,
            1000.0 * limits.delay,
            "delay margin (ms)",
        ),
    );
    let interval = figure(
        scene,
        timing,
        "Longest survivable constant marker interval",
        &format!(
            "Time from one pose to the next, again and again, up to which the motion is stable, \
             in ms, with commands that act {delay_ms} ms late: the darker, the less, and hatched where \
             it is unstable with a pose at every tick."
        ),
        margin_map(
            grid(|row| in_ms(row.longest_constant_interval_s))?,
            period_ms,
            period_ms * f64::from(limits.marker_interval),
            "constant marker interval (ms)",
        ),
    );
    Ok([
        ("spectral-radius", radius),
        ("delay-margin", delay),
        ("marker-interval", interval),
    ])
}

/// A margin that was not found lies beyond the searched range.
fn in_ms(margin: Option<f64>) -> f64 {
    margin.map_or(f64::INFINITY, |margin| 1000.0 * margin)
}

fn figure(scene: &Scene, timing: TimingArgs, what: &str, caption: &str, map: Map) -> Figure {
    let frame = Frame::of(&map.grid);
    let curves: Vec<_> = scene.hopf_curves(&frame).collect();
    let hopf = if curves.iter().all(Curve::is_empty) {
        ""
    } else {
        " The thick line is where stability ends without sampling and delay."
    };
    let mut loop_text = format!(" The law is evaluated every {} ms", timing.period_ms);
    if timing.position_gain > 0.0 {
        loop_text += &format!(
            ", within a position loop of gain {} 1/s",
            timing.position_gain
        );
    }
    if timing.steering_lag_ms > 0.0 {
        loop_text += &format!(
            ", the wheels follow through a servo with {} ms of dead time and {} ms of lag",
            timing.steering_dead_time_ms, timing.steering_lag_ms
        );
        if timing.predict {
            loop_text += ", and the law sees the state predicted to the wheels";
        }
    }
    Figure::column(
        format!("{what} under {}", scene.law),
        format!("{caption}{loop_text}.{hopf}"),
        vec![Panel {
            height_mm: 56.0,
            curves,
            levels: scene.range_ends(),
            map: Some(map),
            ..Panel::new(SPEED, DEVIATION)
        }],
    )
}

/// The resolution of delays, in ms.
const LEAST_MARGIN: f64 = 2.0;

/// A map of a margin in ms: zero is none at all. `step` is that from one margin to the next, zero
/// for a continuous scale; `limit` is the end of the searched range.
fn margin_map(margin: Grid, step: f64, limit: f64, name: &str) -> Map {
    let mut isolines = margins(&margin, [LEAST_MARGIN.max(step), limit]);
    for isoline in &mut isolines {
        // Halfway between a step and the one before.
        isoline.value -= 0.5 * step;
    }
    let third = |part: usize| Some(isolines.get(part * isolines.len() / 3)?.value);
    let least = f64::MIN_POSITIVE.max(0.5 * step);
    let mut bands = vec![band(f64::NEG_INFINITY, least, Shade::Hatched, "unstable")];
    match (third(1), third(2)) {
        // The numbers in the lines say where one shade ends.
        (Some(low), Some(high)) if low < high => bands.extend([
            band(least, low, Shade::Dark, ""),
            band(low, high, Shade::Light, ""),
            band(high, f64::INFINITY, Shade::Palest, ""),
        ]),
        _ => bands.push(band(least, f64::INFINITY, Shade::Light, "stable")),
    }
    Map {
        bands,
        isolines,
        isoline_name: name.to_owned(),
        grid: margin,
    }
}
