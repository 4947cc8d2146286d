//! Large motions: limit cycles over dl, and the basin of the straight motion over speed and p.

use singletrack_analysis::stability::LimitCycle;
use singletrack_figures::figure::{
    Axis, Column, Curve, Figure, GridError, Look, Map, Panel, Shade, Symbol, Width,
};

use super::{
    super::basin::BasinRow,
    levels::margins,
    scene::{DEVIATION, SPEED, band, grid_of},
};

/// The amplitudes of cycles over dl, in the order of their branch.
#[must_use]
pub fn cycles(cycles: &[LimitCycle], speed: f64) -> Figure {
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
    Figure {
        title: "Limit cycles".to_owned(),
        caption: format!(
            "Half the peak-to-peak steering angle of the limit cycles around the straight motion \
             at {speed} m/s."
        ),
        width: Width::Column,
        panels: vec![Panel {
            curves: curves.collect(),
            ..Panel::new(
                DEVIATION,
                Axis::new("amplitude", Some(Symbol::new("δ", "")), "°"),
            )
        }],
    }
}

/// The basin over speed and p.
///
/// # Errors
///
/// Fewer than two speeds or distances.
pub(in super::super) fn basin(rows: &[BasinRow]) -> Result<Figure, GridError> {
    let grid = grid_of(
        rows,
        |row| [row.speed_m_s, row.point_distance_m],
        |row| row.yaw_rad.to_degrees(),
    )?;
    Ok(Figure {
        title: "Basin of the straight motion".to_owned(),
        caption: "Yaw error from which on the car does not regain the straight motion, in \
                  degrees: the darker, the less."
            .to_owned(),
        width: Width::Column,
        panels: vec![Panel {
            height_mm: 56.0,
            map: Some(Map {
                bands: vec![
                    band(f64::NEG_INFINITY, 0.1, Shade::Hatched, "unstable"),
                    band(0.1, 10.0, Shade::Dark, "below 10°"),
                    band(10.0, 50.0, Shade::Light, "10 to 50°"),
                    band(50.0, f64::INFINITY, Shade::Palest, "from 50° on"),
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
    })
}
