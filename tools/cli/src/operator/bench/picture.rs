//! Pictures of measurements.

use singletrack_commissioning::{Plot, PlotKind};
use singletrack_figures::figure::{Axis, Column, Curve, Figure, Look, Panel, Width};

/// The picture as SVG.
pub(super) fn svg(plot: &Plot) -> String {
    let axis = |(quantity, unit)| Axis::new(quantity, None, unit);
    let mut panel = Panel::new(axis(plot.x), axis(plot.y));
    panel.equal = plot.equal;
    panel.curves = plot
        .lines
        .iter()
        .map(|line| {
            let column =
                |index: usize| -> Column { line.points.iter().map(|point| point[index]).collect() };
            let look = match line.kind {
                PlotKind::Measured => Look::Nominal,
                PlotKind::Other => Look::Actual,
                PlotKind::Fitted => Look::Boundary,
            };
            Curve::new(line.name, look, &column(0), column(1))
        })
        .collect();
    Figure {
        title: plot.title.to_owned(),
        caption: plot.title.to_owned(),
        width: Width::Column,
        panels: vec![panel],
    }
    .to_svg()
}

#[cfg(test)]
mod tests {
    use singletrack_commissioning::PlotLine;

    use super::*;

    #[test]
    fn a_plot_becomes_a_picture_with_its_axes_and_lines() {
        let svg = svg(&Plot::over_time(
            "latency",
            "A twist",
            ("yaw rate", "rad/s"),
            vec![PlotLine {
                name: "gyro",
                kind: PlotKind::Measured,
                points: vec![[0.0, 1.0], [1.0, 2.0], [f64::NAN, 0.0], [2.0, 1.0]],
            }],
        ));
        for part in ["<svg", "A twist", "yaw rate", "gyro"] {
            assert!(svg.contains(part), "{part} is missing in {svg}");
        }
    }
}
