//! The figures over speed, dl and p: where the motion is stable, each eigenvalue, limit cycles, the
//! basin of the straight motion, and the sampled loop: ticks, delay and missing poses; with their
//! isolines and the format of their numbers.

use singletrack_analysis::stability::{HopfPoint, LimitCycle, MarginLimits};
use singletrack_figures::figure::{
    Axis, Callout, Callouts, Column, Curve, Figure, Grid, GridError, Isoline, Level, Look, Map,
    Panel, Shade, Symbol, decimals, superscript,
};

use super::{
    super::{EigenvalueRow, RegionRow, SampledRow, TimingArgs, maps::BasinRow},
    scene::{DEVIATION, Frame, SPEED, Scene, at, band, grid_of},
};

/// The number of values of the first Lyapunov coefficient along a Hopf curve that
/// crosses the whole figure.
const LYAPUNOV_LABELS: f64 = 7.0;

/// Where the steady motion is stable: the paper's figure of Hopf bifurcations.
///
/// # Errors
///
/// Rows that are not a grid: fewer than two speeds or deviations.
pub fn region(scene: &Scene, rows: &[RegionRow]) -> Result<Figure, GridError> {
    let largest = grid_of(
        rows,
        |row| [row.speed_m_s, row.dl_m],
        |row| row.largest_re_per_s,
    )?;
    let frame = Frame::of(&largest);
    let limits = scene.limits.iter().copied();
    let limits = limits.filter(|limit| frame.holds_deviation(*limit));
    let mut levels = scene.range_ends();
    levels.extend(limits.map(|value| Level::new("$v$ → ∞", value, Look::Asymptote)));
    let panel = Panel {
        height_mm: 62.0,
        map: Some(Map {
            bands: vec![
                band(f64::NEG_INFINITY, 0.0, Shade::Light, "stable"),
                band(0.0, f64::INFINITY, Shade::Dark, "unstable"),
            ],
            ..Map::new(largest)
        }),
        levels,
        curves: scene.hopf_curves(&frame).collect(),
        callouts: scene
            .branches
            .iter()
            .map(|branch| Callouts {
                name: "$l_1$".to_owned(),
                points: lyapunov_labels(branch, &frame),
            })
            .collect(),
        ..Panel::new(SPEED, DEVIATION)
    };
    Ok(Figure::column(
        format!("Stability of the steady motion under {}", scene.law),
        "Where the steady motion is asymptotically stable and where it is not, by speed \
         and by how far behind its place the centre of mass is believed to be. At the \
         Hopf points a pair of eigenvalues crosses the imaginary axis; where the first \
         Lyapunov coefficient (MatCont's) is positive the bifurcation is subcritical.",
        vec![panel],
    ))
}

/// First Lyapunov coefficients at points that are evenly spread along the curve.
fn lyapunov_labels(branch: &[HopfPoint], frame: &Frame) -> Vec<Callout> {
    let points: Vec<&HopfPoint> = branch
        .iter()
        .filter(|point| frame.holds(at(point)))
        .collect();
    let mut way = 0.0;
    let mut ways = vec![0.0];
    for (from, to) in points.iter().zip(points.iter().skip(1)) {
        way += frame.distance(at(from), at(to));
        ways.push(way);
    }
    // A branch that is all but a point has one.
    let count = (LYAPUNOV_LABELS * way).round().max(1.0) as usize;
    let mut labels: Vec<Callout> = (0..count)
        .filter_map(|index| {
            // Half a step from both ends.
            let wanted = way * (index as f64 + 0.5) / count as f64;
            let point = points.get(ways.partition_point(|way| *way < wanted))?;
            Some(Callout {
                point: at(point),
                label: significant(point.lyapunov.matcont),
            })
        })
        .collect();
    labels.dedup();
    labels
}

/// All eigenvalues in one figure: four in two rows, three in one.
///
/// # Errors
///
/// Rows that are not a grid: fewer than two speeds or deviations.
pub fn eigenvalues(scene: &Scene, rows: &[EigenvalueRow]) -> Result<Figure, GridError> {
    let count = rows.first().map_or(0, |row| row.eigenvalues.len());
    let in_a_row = if count == 3 { 3 } else { 2 };
    let panels: Result<Vec<Panel>, GridError> = (1..=count)
        .map(|number| {
            Ok(Panel {
                title: format!("Re $λ_{number}$ (1/s)"),
                begins_row: number % in_a_row == 1,
                ..panel(scene, real_part(number, rows)?)
            })
        })
        .collect();
    Ok(Figure::page(
        format!("Real parts of the eigenvalues under {}", scene.law),
        "Real parts of the eigenvalues of the linearised dynamics, numbered by ascending \
         real part, with lines of equal value: light where they are negative, dark where \
         they are not.",
        panels?,
    ))
}

fn real_part(number: usize, rows: &[EigenvalueRow]) -> Result<Grid, GridError> {
    grid_of(
        rows,
        |row| [row.speed, row.deviation],
        |row| {
            let value = row.eigenvalues.get(number - 1);
            value.map_or(f64::NAN, |value| value.re)
        },
    )
}

/// A map of the real part, with the Hopf curve where its sign changes.
fn panel(scene: &Scene, real_part: Grid) -> Panel {
    let frame = Frame::of(&real_part);
    let curves = match real_part.range() {
        Some([low, high]) if low < 0.0 && high >= 0.0 => scene.hopf_curves(&frame).collect(),
        _ => Vec::new(),
    };
    Panel {
        height_mm: 50.0,
        curves,
        levels: scene.range_ends(),
        map: Some(Map {
            bands: vec![
                band(f64::NEG_INFINITY, 0.0, Shade::Light, "negative"),
                band(0.0, f64::INFINITY, Shade::Dark, "not negative"),
            ],
            isolines: one_two_five(&real_part),
            isoline_name: "real part (1/s)".to_owned(),
            grid: real_part,
        }),
        ..Panel::new(SPEED, DEVIATION)
    }
}

/// The straight motion, of which all cycles are born: no amplitude, stable up to its Hopf points.
fn straight(cycles: &[LimitCycle], hopf: &[HopfPoint]) -> Vec<Curve> {
    let born = || {
        hopf.iter()
            .filter(|point| point.largest_other_real_part < 0.0)
    };
    let mut ends: Vec<f64> = cycles.iter().map(|cycle| cycle.deviation).collect();
    ends.extend(born().map(|point| point.deviation));
    ends.sort_by(f64::total_cmp);
    let (Some(first), Some(last)) = (ends.first(), ends.last()) else {
        return Vec::new();
    };
    let mut places: Vec<f64> = born().map(|point| point.deviation).collect();
    places.extend([*first, *last]);
    places.sort_by(f64::total_cmp);
    places.dedup();
    let curve = |part: &[f64]| {
        let middle = 0.5 * (part[0] + part[1]);
        let beside = |point: &&HopfPoint| (point.deviation - middle).abs();
        let nearest = born().min_by(|one, other| beside(one).total_cmp(&beside(other)));
        let is_stable =
            nearest.is_some_and(|point| (middle - point.deviation) * point.crossing < 0.0);
        let (name, look) = match is_stable {
            true => ("stable", Look::Boundary),
            false => ("unstable", Look::Other),
        };
        Curve::new(name, look, &Column::from(part), Column::from([0.0; 2]))
    };
    places.windows(2).map(curve).collect()
}

/// The amplitudes of cycles over dl, in the order of their branch, and the straight motion, whose Hopf
/// points are known.
pub fn cycles(cycles: &[LimitCycle], hopf: &[HopfPoint], speed: f64) -> Figure {
    let curves = cycles.chunk_by(|one, other| one.is_stable() == other.is_stable());
    let curves = curves.map(|part| {
        let (name, look) = match part.first() {
            Some(cycle) if cycle.is_stable() => ("stable", Look::Boundary),
            _ => ("unstable", Look::Other),
        };
        let column = |value: fn(&LimitCycle) -> f64| part.iter().map(value).collect::<Column>();
        let amplitude = column(|cycle| cycle.amplitude.to_degrees());
        Curve::new(name, look, &column(|cycle| cycle.deviation), amplitude)
    });
    Figure::column(
        "Limit cycles",
        format!(
            "Half the peak-to-peak steering angle of the limit cycles around the straight motion \
             (at 0°) at {speed} m/s."
        ),
        vec![Panel {
            curves: straight(cycles, hopf).into_iter().chain(curves).collect(),
            ..Panel::new(
                DEVIATION,
                Axis::new("amplitude", Some(Symbol::new("δ", "")), "°"),
            )
        }],
    )
}

/// The basin over speed and p; `regains` says whether a yaw error, in degrees, decays there.
///
/// # Errors
///
/// Fewer than two speeds or distances.
pub(in super::super) fn basin(
    rows: &[BasinRow],
    regains: impl Fn([f64; 2], f64) -> bool + 'static,
) -> Result<Figure, GridError> {
    let grid = grid_of(
        rows,
        |row| [row.speed_m_s, row.point_distance_m],
        |row| row.yaw_rad.to_degrees(),
    )?
    .bisected(regains);
    Ok(Figure::column(
        "Basin of the straight motion",
        "Yaw error from which on the car does not regain the straight motion, in \
         degrees: the darker, the less.",
        vec![Panel {
            height_mm: 56.0,
            map: Some(Map {
                bands: vec![
                    band(f64::NEG_INFINITY, 0.1, Shade::Hatched, "unstable"),
                    band(0.1, 10.0, Shade::Dark, ""),
                    band(10.0, 50.0, Shade::Light, ""),
                    band(50.0, f64::INFINITY, Shade::Palest, ""),
                ],
                isolines: margins(&grid, [5.0, 180.0]),
                isoline_name: "yaw error (°)".to_owned(),
                grid,
            }),
            ..Panel::new(
                SPEED,
                Axis::new("distance of P", Some(Symbol::new("p", "")), "m"),
            )
        }],
    ))
}

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
    let radius = sampled_figure(
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
    let delay = sampled_figure(
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
    let interval = sampled_figure(
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

fn sampled_figure(
    scene: &Scene,
    timing: TimingArgs,
    what: &str,
    caption: &str,
    map: Map,
) -> Figure {
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

/// The largest number of isolines.
const MOST_ISOLINES: usize = 9;

/// Two significant digits, as a power of ten where zeros are many.
fn significant(value: f64) -> String {
    let text = format!("{value:.1e}");
    let parts = text.split_once('e');
    let small = value != 0.0 && value.abs() < 1e-3;
    match parts {
        Some((factor, power)) if small => {
            let raised = superscript(power);
            format!("{}·10{raised}", factor.replace('-', "−"))
        }
        _ => Isoline::new(value, decimals(value) + 1).label,
    }
}

/// Lines at 1, 2, 5, 10 and so on between two values.
fn margins(grid: &Grid, [least, limit]: [f64; 2]) -> Vec<Isoline> {
    let mut candidates = sizes();
    candidates.retain(|size| *size >= least && *size < limit);
    chosen(grid, &candidates, 0.0, decimals)
}

/// 1, 2, 5, 10 and so on.
fn sizes() -> Vec<f64> {
    (-3..=4)
        .flat_map(|power| [1.0, 2.0, 5.0].map(|factor| factor * 10_f64.powi(power)))
        .collect()
}

/// Lines at 1, 2, 5, 10 and so on, above and below zero.
fn one_two_five(grid: &Grid) -> Vec<Isoline> {
    let sizes = sizes();
    let below = sizes.iter().rev().map(|size| -size);
    let candidates: Vec<f64> = below.chain(sizes.iter().copied()).collect();
    chosen(grid, &candidates, 0.0, decimals)
}

/// Lines near and far from one, by their distance from it.
fn around_one(grid: &Grid) -> Vec<Isoline> {
    let distances = [0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001];
    let below = distances.iter().map(|distance| 1.0 - distance);
    let above = distances.iter().rev().map(|distance| 1.0 + distance);
    let candidates: Vec<f64> = below.chain(above).collect();
    let mut isolines = chosen(grid, &candidates, 1.0, |value| decimals(value - 1.0));
    isolines.push(Isoline::new(1.0, 0));
    isolines
}

/// The ascending candidates that divide the grid best: without almost empty
/// bands between two of them or at the boundary, and not too many; with this many decimals.
fn chosen(
    grid: &Grid,
    candidates: &[f64],
    boundary: f64,
    decimals_of: fn(f64) -> usize,
) -> Vec<Isoline> {
    let mut sorted: Vec<f64> = grid
        .values()
        .iter()
        .copied()
        .filter(|value| !value.is_nan())
        .collect();
    sorted.sort_by(f64::total_cmp);
    let below = |value: f64| {
        sorted.partition_point(|other| *other < value) as f64 / sorted.len().max(1) as f64
    };
    let mut chosen: Vec<f64> = Vec::new();
    let gap = 1.0 / (MOST_ISOLINES as f64 + 2.0);
    // The boundary is drawn anyway.
    let edge = below(boundary);
    let mut last = 0.0;
    for candidate in candidates.iter().copied() {
        let part = below(candidate);
        let apart = (part - edge).abs() >= 0.3 * gap || edge == 0.0 || edge == 1.0;
        if part - last >= 0.5 * gap && part <= 1.0 - 0.25 * gap && apart {
            chosen.push(candidate);
            last = part;
        }
    }
    // Where there are too many levels, every other one is dropped.
    while chosen.len() > MOST_ISOLINES {
        let mut index = 0;
        chosen.retain(|_| {
            index += 1;
            index % 2 == 1
        });
    }
    let isolines = chosen.into_iter();
    isolines
        .map(|value| Isoline::new(value, decimals_of(value)))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(value: impl Fn(f64) -> f64) -> Grid {
        let x = (0..101).map(|index| f64::from(index) * 0.01).collect();
        Grid::of(x, [0.0, 1.0].into(), |x, _| value(x)).unwrap()
    }

    fn labels(isolines: Vec<Isoline>) -> Vec<String> {
        isolines.into_iter().map(|isoline| isoline.label).collect()
    }

    #[test]
    fn small_numbers_are_powers_of_ten_and_others_have_two_digits() {
        for (value, text) in [
            (0.590_43, "0.59"),
            (0.036_2, "0.036"),
            (1.2256, "1.2"),
            (0.000_999_9, "1.0·10⁻³"),
            (2.469_75e-4, "2.5·10⁻⁴"),
            (-2.5e-12, "−2.5·10⁻¹²"),
            (0.0, "0.0"),
        ] {
            assert_eq!(significant(value), text);
        }
    }

    #[test]
    fn lines_are_at_round_values_that_part_the_map() {
        assert_eq!(
            labels(one_two_five(&grid(|x| -100.0 * x))),
            ["−50", "−20", "−10", "−5"]
        );
        assert_eq!(
            labels(around_one(&grid(|x| 0.94 + 0.08 * x))),
            ["0.95", "0.98", "0.99", "0.995", "1.002", "1.01", "1"]
        );
    }

    #[test]
    fn a_map_that_spans_decades_has_few_lines_and_a_constant_one_none() {
        let lines = one_two_five(&grid(|x| 10_f64.powf(6.0 * x - 3.0)));
        assert!((4..=MOST_ISOLINES).contains(&lines.len()), "{lines:?}");
        assert!(lines.is_sorted_by(|one, other| one.value < other.value));
        assert_eq!(one_two_five(&grid(|_| 5.0)), []);
        assert_eq!(one_two_five(&grid(|_| f64::NAN)), []);
    }
}
