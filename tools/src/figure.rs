//! Figures, drawn with `kuva`: the only file that knows the plotting crate.

use kuva::{
    backend::svg::SvgBackend,
    plot::{
        LinePlot,
        scatter::{MarkerShape, ScatterPlot},
    },
    render::{layout::Layout, plots::Plot, render::render_multiple},
};

/// A point on the floor, in m.
pub type Point = [f64; 2];

/// A curve with its look.
#[derive(Clone, Debug)]
pub struct Curve<'a> {
    /// What it is, for the legend; none to leave it out there.
    pub name: Option<&'a str>,
    /// The points, in order.
    pub points: Vec<Point>,
    /// A CSS colour.
    pub colour: &'static str,
    /// Width, in px.
    pub width: f64,
    /// Whether it is dashed.
    pub dashed: bool,
}

/// A mark with its look.
#[derive(Clone, Copy, Debug)]
pub struct Mark<'a> {
    /// What it is, for the legend.
    pub name: &'a str,
    /// Where.
    pub point: Point,
    /// A triangle for a start, a circle for an end.
    pub kind: MarkKind,
    /// A CSS colour.
    pub colour: &'static str,
}

/// The paper's marks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MarkKind {
    /// Where a trajectory starts: a triangle.
    Start,
    /// Where it ends: a circle.
    End,
}

/// Draws trajectories on the floor, with equal axes, as SVG.
#[must_use]
pub fn floor_plan(title: &str, curves: &[Curve<'_>], marks: &[Mark<'_>]) -> String {
    let mut plots: Vec<Plot> = curves
        .iter()
        .filter(|curve| curve.points.len() > 1)
        .map(|curve| {
            let mut line = LinePlot::new()
                .with_data(curve.points.iter().map(|[x, y]| (*x, *y)))
                .with_color(curve.colour)
                .with_stroke_width(curve.width);
            if curve.dashed {
                line = line.with_dashed();
            }
            if let Some(name) = curve.name {
                line = line.with_legend(name);
            }
            Plot::Line(line)
        })
        .collect();
    plots.extend(marks.iter().map(|mark| {
        let [x, y] = mark.point;
        Plot::Scatter(
            ScatterPlot::new()
                .with_data([(x, y)])
                .with_color(mark.colour)
                .with_size(6.0)
                .with_marker(match mark.kind {
                    MarkKind::Start => MarkerShape::Triangle,
                    MarkKind::End => MarkerShape::Circle,
                })
                .with_legend(mark.name),
        )
    }));
    let layout = Layout::auto_from_plots(&plots)
        .with_title(title)
        .with_x_label("x (m)")
        .with_y_label("y (m)")
        .with_width(760.0)
        .with_height(560.0)
        .with_equal_aspect();
    SvgBackend.render_scene(&render_multiple(plots, layout))
}
