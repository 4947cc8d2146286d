//! Figures of maps, levels, callouts and estimates: what lies where on the page.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]
#![allow(clippy::disallowed_methods, reason = "figures")]

mod picture;

use singletrack_figures::figure::{
    Axis, Band, Callout, Callouts, Column, Curve, Estimate, Figure, Grid, Isoline, Level, Look,
    Map, Mark, MarkKind, Panel, Scale, Shade, Symbol, Width,
};

use picture::{Frame, attribute, covers, labels, pieces, titled};

fn axis(from: f64, to: f64, count: i32) -> Column {
    let step = (to - from) / f64::from(count - 1);
    (0..count)
        .map(|index| from + step * f64::from(index))
        .collect()
}

/// Speeds of 0 to 8 by deviations of -0.2 to 0.2.
fn grid(value: impl FnMut(f64, f64) -> f64) -> Grid {
    Grid::of(axis(0.0, 8.0, 41), axis(-0.2, 0.2, 41), value).unwrap()
}

/// Light below zero, dark from zero on.
fn map(grid: Grid) -> Map {
    let band = |name: &str, from, to, shade| Band {
        name: name.to_owned(),
        from,
        to,
        shade,
    };
    Map {
        bands: vec![
            band("stable", f64::NEG_INFINITY, 0.0, Shade::Light),
            band("unstable", 0.0, f64::INFINITY, Shade::Dark),
        ],
        ..Map::new(grid)
    }
}

fn panel(map: Map) -> Panel {
    Panel {
        map: Some(map),
        ..Panel::new(
            Axis::new("speed", Some(Symbol::new("v", "")), "m/s"),
            Axis::new("deviation", Some(Symbol::new("dl", "")), "m"),
        )
    }
}

fn svg(panels: Vec<Panel>) -> String {
    let figure = Figure {
        title: "Stability".to_owned(),
        caption: "Of what.".to_owned(),
        width: Width::Page,
        panels,
    };
    let svg = figure.to_svg();
    assert_eq!(svg, figure.to_svg(), "the same figure is the same file");
    assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
    svg
}

fn frame(svg: &str) -> Frame {
    Frame::of(svg, 0, [0.0, 8.0], [-0.2, 0.2])
}

/// Stable below dl = 0.02 v.
fn tilted(v: f64, dl: f64) -> f64 {
    dl - 0.02 * v
}

#[test]
fn every_point_is_shaded_by_its_own_band() {
    let svg = svg(vec![panel(map(grid(tilted)))]);
    let frame = frame(&svg);
    let (light, dark) = (
        titled(&svg, "shade light", "stable"),
        titled(&svg, "shade dark", "unstable"),
    );
    for v in axis(0.05, 7.95, 17).iter() {
        for dl in axis(-0.19, 0.19, 17).iter() {
            let place = frame.at([*v, *dl]);
            let unstable = tilted(*v, *dl) > 0.0;
            assert_eq!(covers(dark, place), unstable, "{v} {dl}");
            assert_eq!(covers(light, place), !unstable, "{v} {dl}");
        }
    }
    assert!(svg.contains(">stable</text>") && svg.contains(">unstable</text>"));
}

#[test]
fn an_area_in_the_middle_is_a_hole_in_the_other() {
    let hill = |v: f64, dl: f64| 0.5 - ((v - 4.0) / 4.0).hypot(dl / 0.2);
    let svg = svg(vec![panel(map(grid(hill)))]);
    let middle = frame(&svg).at([4.0, 0.0]);
    assert!(covers(titled(&svg, "shade dark", "unstable"), middle));
    assert!(!covers(titled(&svg, "shade light", "stable"), middle));
}

#[test]
fn what_is_not_a_number_is_blank() {
    let svg = svg(vec![panel(map(grid(|v, dl| {
        if v < 3.9 { f64::NAN } else { tilted(v, dl) }
    })))]);
    let frame = frame(&svg);
    let shades = [
        titled(&svg, "shade light", "stable"),
        titled(&svg, "shade dark", "unstable"),
    ];
    for dl in [-0.15, 0.0, 0.19] {
        assert!(!shades.iter().any(|line| covers(line, frame.at([2.0, dl]))));
        assert!(shades.iter().any(|line| covers(line, frame.at([6.0, dl]))));
    }
}

#[test]
fn a_constant_map_is_one_shade_without_lines() {
    for value in [-1.0, 0.0, 1.0, f64::INFINITY, f64::NAN] {
        let map = Map {
            isolines: vec![Isoline::new(value.clamp(-1.0, 1.0), 0)],
            isoline_name: "value".to_owned(),
            ..map(grid(|_, _| value))
        };
        let panel = panel(if value.is_nan() {
            Map {
                isolines: Vec::new(),
                ..map
            }
        } else {
            map
        });
        assert_eq!(panel.is_empty(), value.is_nan());
        let svg = svg(vec![panel]);
        let middle = frame(&svg).at([4.03, 0.013]);
        assert_eq!(
            covers(titled(&svg, "shade dark", "unstable"), middle),
            value >= 0.0
        );
        assert_eq!(
            covers(titled(&svg, "shade light", "stable"), middle),
            value < 0.0
        );
        assert!(labels(&svg).is_empty());
    }
}

#[test]
fn a_label_is_in_a_gap_of_its_line_where_its_value_is() {
    let values = [-0.3, -0.2, -0.1, 0.1];
    let svg = svg(vec![panel(Map {
        isolines: values.map(|value| Isoline::new(value, 1)).to_vec(),
        isoline_name: "real part (1/s)".to_owned(),
        ..map(grid(tilted))
    })]);
    let frame = frame(&svg);
    for value in values {
        let text = format!("{value:.1}").replace('-', "\u{2212}");
        let line = titled(&svg, "isoline", &text);
        let own: Vec<_> = labels(&svg)
            .into_iter()
            .filter(|label| label.0 == text)
            .collect();
        assert!(!own.is_empty(), "{text}");
        for (_, [x, y]) in own {
            let [[left, top], [right, bottom]] = [[0.0, 0.2], [8.0, -0.2]].map(|at| frame.at(at));
            let v = 8.0 * (x - left) / (right - left);
            let dl = 0.2 - 0.4 * (y - top) / (bottom - top);
            assert!((tilted(v, dl) - value).abs() < 1e-3, "{text}: {v} {dl}");
            for [from, to] in pieces(line)
                .iter()
                .flat_map(|piece| piece.array_windows().copied())
            {
                // All lines are oblique, so that a step along them is one to the right.
                assert!((from[0].min(to[0]) > x + 1.0) || (from[0].max(to[0]) < x - 1.0));
            }
        }
    }
    assert!(svg.contains(">real part (1/s)</text>"));
}

#[test]
fn labels_keep_clear_of_each_other_and_of_the_curve() {
    let curve = axis(0.0, 8.0, 81);
    let points: Vec<f64> = (0..8).map(|index| 0.5 + f64::from(index)).collect();
    let svg = svg(vec![Panel {
        curves: vec![Curve {
            name: "Hopf points",
            look: Look::Boundary,
            y: curve.iter().map(|v| 0.02 * v).collect(),
            x: curve,
            time: None,
        }],
        callouts: vec![Callouts {
            name: "coefficient $l_1$".to_owned(),
            points: points
                .iter()
                .map(|v| Callout {
                    point: [*v, 0.02 * v],
                    label: format!("{v:.1}e-4"),
                })
                .collect(),
        }],
        levels: vec![Level {
            name: "physically meaningful range".to_owned(),
            value: 0.1232,
            label: "$l_r$".to_owned(),
            look: Look::RangeEnd,
        }],
        ..panel(Map {
            isolines: vec![Isoline::new(-0.05, 2), Isoline::new(0.05, 2)],
            ..map(grid(tilted))
        })
    }]);
    let frame = frame(&svg);
    let labels = labels(&svg);
    let texts: Vec<&str> = labels.iter().map(|(text, _)| text.as_str()).collect();
    for v in &points {
        let text = format!("{v:.1}e-4");
        assert_eq!(texts.iter().filter(|label| **label == text).count(), 1);
    }
    assert!(texts.iter().any(|text| text.contains(">r</tspan>")));
    for (index, (text, [x, y])) in labels.iter().enumerate() {
        for (other, place) in labels.iter().skip(index + 1) {
            let apart = (x - place[0]).abs() > 4.0 || (y - place[1]).abs() > 2.0;
            assert!(apart, "{text} and {other}");
        }
        let v = 8.0 * (x - frame.left) / frame.width;
        let [_, on_curve] = frame.at([v, 0.02 * v]);
        assert!((y - on_curve).abs() > 1.0, "{text} is on the curve");
    }
    for leader in svg
        .lines()
        .filter(|line| line.contains("<path class=\"leader\""))
    {
        assert!(pieces(leader)[0].len() == 2);
    }
    assert_eq!(
        svg.matches("class=\"leader\"").count(),
        points.len() + 1,
        "each has a leader, and the legend one"
    );
}

#[test]
fn hatching_covers_its_band_and_leaves_labels_free() {
    let mut map = map(grid(tilted));
    map.bands[1].shade = Shade::Hatched;
    let svg = svg(vec![Panel {
        levels: vec![Level {
            name: "range".to_owned(),
            value: 0.1,
            label: "$l_r$ or so".to_owned(),
            look: Look::RangeEnd,
        }],
        callouts: vec![Callouts {
            name: "there".to_owned(),
            points: vec![Callout {
                point: [2.0, 0.15],
                label: "0.123".to_owned(),
            }],
        }],
        ..panel(map)
    }]);
    let frame = frame(&svg);
    let hatch = pieces(titled(&svg, "shade hatched", "unstable"));
    assert!(hatch.len() > 20);
    for line in &hatch {
        for [x, y] in line {
            let v = 8.0 * (x - frame.left) / frame.width;
            let dl = 0.2 - 0.4 * (y - frame.top) / frame.height;
            assert!(tilted(v, dl) > -1e-3, "{v} {dl}");
        }
    }
    for (text, [x, y]) in labels(&svg) {
        for line in &hatch {
            // Along the text's middle nothing is drawn.
            let [from, to] = line[..] else {
                panic!("{line:?}");
            };
            if (from[1] - y) * (to[1] - y) < 0.0 {
                let part = (y - from[1]) / (to[1] - from[1]);
                let crossing = from[0] + part * (to[0] - from[0]);
                assert!((crossing - x).abs() > 1.5, "{text}");
            }
        }
    }
}

#[test]
fn a_level_is_at_its_value_and_one_beyond_the_map_widens_the_axis() {
    let level = |value: f64| Level {
        name: "limit".to_owned(),
        value,
        label: String::new(),
        look: Look::Asymptote,
    };
    let svg = svg(vec![Panel {
        levels: vec![level(-0.1), level(0.3)],
        ..panel(map(grid(tilted)))
    }]);
    let frame = Frame::of(&svg, 0, [0.0, 8.0], [-0.2, 0.3]);
    for value in [-0.1, 0.3] {
        let line = titled(&svg, "asymptote", &format!("limit: {value}<"));
        let [_, y] = frame.at([0.0, value]);
        assert!(
            pieces(line)[0]
                .iter()
                .all(|place| (place[1] - y).abs() < 0.02)
        );
    }
}

#[test]
fn estimates_stand_in_their_intervals_above_their_numbers() {
    let estimate = |x, value: f64, half: f64| Estimate {
        name: "estimate".to_owned(),
        kind: MarkKind::Found,
        x,
        value,
        interval: [value - half, value + half],
    };
    let svg = svg(vec![Panel {
        estimates: vec![estimate(1.0, 1.02, 0.05), estimate(2.0, 0.97, 0.08)],
        levels: vec![Level {
            name: "true value".to_owned(),
            value: 1.0,
            label: String::new(),
            look: Look::Nominal,
        }],
        ..Panel::new(
            Axis::new("drive", None, "number"),
            Axis::new("estimated over true", None, "1"),
        )
    }]);
    assert!(svg.contains(">drive"));
    let uprights: Vec<_> = svg
        .lines()
        .filter(|line| line.starts_with("<path class=\"interval\""))
        .map(|line| pieces(line)[0].clone())
        .filter(|ends| ends[0][0] == ends[1][0])
        .collect();
    // Each of the two and the legend's.
    assert_eq!(uprights.len(), 3);
    let frame = Frame::of(&svg, 0, [0.94, 2.06], [0.0, 1.0]);
    for (index, x) in [(1, 1.0), (2, 2.0)] {
        let [place, _] = frame.at([x, 0.0]);
        assert!((uprights[index][0][0] - place).abs() < 0.02);
    }
    let length = |index: usize| (uprights[index][0][1] - uprights[index][1][1]).abs();
    assert!((length(2) / length(1) - 1.6).abs() < 0.01);
    assert!(svg.contains("<title>estimate: 1.02 (0.97"));
}

#[test]
fn names_stand_below_their_places_and_long_ones_are_broken() {
    let names = ["p", "pure-pursuit", "a-very-long-name"];
    let kinds = [MarkKind::Square, MarkKind::Diamond, MarkKind::None];
    let marks = kinds.iter().enumerate().map(|(place, kind)| Mark {
        name: "kind",
        point: [place as f64, 1.0],
        kind: *kind,
    });
    let panel = Panel {
        names: names.map(str::to_owned).to_vec(),
        marks: marks.collect(),
        ..Panel::new(Axis::new("", None, ""), Axis::new("error", None, "mm"))
    };
    let drawn = |width| {
        let figure = Figure {
            title: "Errors".to_owned(),
            caption: "Of what.".to_owned(),
            width,
            panels: vec![panel.clone(); if width == Width::Page { 1 } else { 2 }],
        };
        figure.to_svg()
    };
    let page = drawn(Width::Page);
    let frame = Frame::of(&page, 0, [-0.5, 2.5], [0.9, 1.1]);
    for (place, name) in names.iter().enumerate() {
        let line = page
            .lines()
            .find(|line| line.contains(&format!(">{name}<")));
        let x: f64 = attribute(line.unwrap(), "x").parse().unwrap();
        assert!(
            (x - frame.at([place as f64, 1.0])[0]).abs() < 0.02,
            "{name}"
        );
        let class = format!("mark {}", kinds[place]);
        let mark = titled(&page, &class, "kind");
        assert!(mark.contains(&format!("d=\"M{x} ")), "{mark}");
    }
    // Where there is little room, a name has more lines, and the page is longer.
    let narrow = drawn(Width::Column);
    assert!(narrow.contains(">pursuit<") && !narrow.contains(">pure-pursuit<"));
    let height = |svg: &str| {
        let page = svg.lines().next().unwrap();
        let height = attribute(page, "height").trim_end_matches("mm");
        height.parse::<f64>().unwrap()
    };
    assert!(height(&narrow) > height(&page));
}

#[test]
fn panels_stand_in_the_rows_that_they_begin() {
    let titled = |title: &str, begins_row| Panel {
        title: title.to_owned(),
        begins_row,
        ..panel(map(grid(tilted)))
    };
    let svg = svg(vec![
        titled("$λ_1$", true),
        titled("$λ_2$", false),
        titled("$λ_3$", true),
        titled("$λ_4$", false),
    ]);
    let frames = [0, 1, 2, 3].map(|number| Frame::of(&svg, number, [0.0, 1.0], [0.0, 1.0]));
    assert_eq!(frames[0].top, frames[1].top);
    assert_eq!(frames[0].left, frames[2].left);
    assert!(frames[1].left > frames[0].left + frames[0].width);
    assert!(frames[2].top > frames[0].top + frames[0].height + 10.0);
    let page = svg.lines().next().unwrap();
    let height: f64 = attribute(page, "height")
        .trim_end_matches("mm")
        .parse()
        .unwrap();
    assert!(height > frames[3].top + frames[3].height);
    assert!(svg.contains(">λ</tspan><tspan font-size=\"1.73\" dy=\"0.7\">4</tspan>"));
    assert_eq!(svg.matches(">unstable</text>").count(), 1, "one legend");
}

#[test]
fn a_map_on_a_logarithmic_axis_is_where_its_decades_are() {
    let decades = axis(-1.0, 1.0, 41)
        .iter()
        .map(|power| 10_f64.powf(*power))
        .collect();
    let grid = Grid::of(decades, axis(-0.2, 0.2, 41), |v, _| v.log10()).unwrap();
    let mut panel = panel(map(grid));
    panel.x.scale = Scale::Log;
    let svg = svg(vec![panel]);
    let frame = Frame::of(&svg, 0, [-1.0, 1.0], [-0.2, 0.2]);
    let dark = titled(&svg, "shade dark", "unstable");
    assert!(covers(dark, frame.at([0.01, 0.0])) && !covers(dark, frame.at([-0.01, 0.0])));
}

#[test]
fn a_logarithmic_axis_without_a_value_is_drawn_empty() {
    let logarithmic = |quantity| Axis {
        scale: Scale::Log,
        ..Axis::new(quantity, None, "")
    };
    for values in [vec![], vec![f64::NAN; 3]] {
        let values: Column = values.into();
        let panel = Panel {
            curves: vec![Curve::new("noise", Look::Actual, &values, values.clone())],
            ..Panel::new(logarithmic("frequency"), logarithmic("noise"))
        };
        assert!(svg(vec![panel]).contains("noise"));
    }
}
