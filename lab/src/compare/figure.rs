//! The picture of a comparison: the RMS of every controller.

use singletrack_figures::figure::{Axis, Estimate, Figure, Mark, MarkKind, Panel, Scale, Width};

use super::{condition::Condition, table::Line};

/// The marks of the speeds, distinguishable without colour.
const KINDS: [MarkKind; 5] = [
    MarkKind::Found,
    MarkKind::End,
    MarkKind::Square,
    MarkKind::Diamond,
    MarkKind::Start,
];
/// The part of a controller's place over which the marks of its speeds are spread.
const SPREAD: f64 = 0.72;
const HEIGHT_MM: f64 = 38.0;

/// The nominal condition: a panel per path, in it the controllers, and of each a mark per speed.
/// `None` if that condition was not driven.
#[must_use]
pub fn figure(lines: &[Line]) -> Option<Figure> {
    let shown = lines.iter().filter(|line| {
        line.row.condition == Condition::Nominal && line.worst_of.is_none() && !line.front_axle
    });
    let shown: Vec<&Line> = shown.collect();
    let mut controllers: Vec<&str> = Vec::new();
    let mut speeds: Vec<f64> = Vec::new();
    for line in &shown {
        if !controllers.contains(&line.name.as_str()) {
            controllers.push(&line.name);
        }
        if !speeds.contains(&line.row.speed_m_s) {
            speeds.push(line.row.speed_m_s);
        }
    }
    let panels = shown.chunk_by(|a, b| a.row.path == b.row.path);
    let panels: Vec<Panel> = panels
        .map(|lines| panel(lines, &controllers, &speeds))
        .collect();
    (!panels.is_empty()).then(|| Figure {
        title: "RMS error of the controllers".to_owned(),
        caption: "Root mean square of the distance of each controller's own point from its \
                  reference, mean over the seeds with its 95 % interval, condition nominal."
            .to_owned(),
        width: Width::Page,
        panels,
    })
}

fn panel(lines: &[&Line], controllers: &[&str], speeds: &[f64]) -> Panel {
    let mut panel = Panel::new(
        Axis::new("", None, ""),
        Axis {
            scale: Scale::Log,
            ..Axis::new("RMS error", None, "mm")
        },
    );
    panel.begins_row = true;
    panel.height_mm = HEIGHT_MM;
    let path = lines.first().map(|line| line.row.path);
    panel.title = path.map_or_else(String::new, |path| path.to_string());
    panel.names = controllers.iter().map(ToString::to_string).collect();
    let place = |line: &Line| {
        let controller = controllers.iter().position(|name| *name == line.name);
        let speed = speeds.iter().position(|speed| *speed == line.row.speed_m_s);
        let (controller, speed) = (controller.unwrap_or_default(), speed.unwrap_or_default());
        let aside = (speed as f64 + 0.5) / speeds.len() as f64 - 0.5;
        (controller as f64 + SPREAD * aside, speed)
    };
    for line in lines {
        let (x, speed) = place(line);
        let [Some(rms), Some(low), Some(high), ..] = line.values else {
            continue;
        };
        panel.estimates.push(Estimate {
            name: format!("{} m/s", line.row.speed_m_s),
            kind: KINDS[speed % KINDS.len()],
            x,
            value: 1e3 * rms,
            interval: [1e3 * low, 1e3 * high],
        });
    }
    // Those without a value stand at the upper end of the axis.
    let values = panel.estimates.iter().map(|estimate| estimate.interval[1]);
    let top = values.fold(1.0, f64::max).log10().ceil();
    for line in lines.iter().filter(|line| line.values[0].is_none()) {
        panel.marks.push(Mark {
            name: "the car stops with every seed",
            point: [place(line).0, 10_f64.powf(top)],
            kind: MarkKind::None,
        });
    }
    panel
}
