//! Reading a figure's SVG: what lies where on the page.

#![allow(clippy::unwrap_used, reason = "a test may fail")]

/// The value of an attribute of the element in a line.
pub(crate) fn attribute<'a>(line: &'a str, name: &str) -> &'a str {
    let (_, rest) = line.split_once(&format!(" {name}=\"")).unwrap();
    rest.split_once('"').unwrap().0
}

pub(crate) fn number(line: &str, name: &str) -> f64 {
    attribute(line, name).parse().unwrap()
}

/// The frame of a panel, by which values are found on the page.
pub(crate) struct Frame {
    pub(crate) left: f64,
    pub(crate) top: f64,
    pub(crate) width: f64,
    pub(crate) height: f64,
    x: [f64; 2],
    y: [f64; 2],
}

impl Frame {
    pub(crate) fn of(svg: &str, number_of_panel: usize, x: [f64; 2], y: [f64; 2]) -> Self {
        let mut frames = svg.lines().filter(|line| line.contains("class=\"frame\""));
        let line = frames.nth(number_of_panel).unwrap();
        Self {
            left: number(line, "x"),
            top: number(line, "y"),
            width: number(line, "width"),
            height: number(line, "height"),
            x,
            y,
        }
    }

    pub(crate) fn at(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [
            self.left + self.width * (x - self.x[0]) / (self.x[1] - self.x[0]),
            self.top + self.height * (self.y[1] - y) / (self.y[1] - self.y[0]),
        ]
    }
}

/// The pieces of the path in a line.
pub(crate) fn pieces(line: &str) -> Vec<Vec<[f64; 2]>> {
    let data = attribute(line, "d");
    let pieces = data.split('M').filter(|piece| !piece.is_empty());
    let point = |text: &str| {
        let (x, y) = text.trim_end_matches('z').split_once(' ').unwrap();
        [x.parse().unwrap(), y.parse().unwrap()]
    };
    pieces
        .map(|piece| piece.split('L').map(point).collect())
        .collect()
}

/// The paths of a class that have a title: what is in the legend has none.
pub(crate) fn titled<'a>(svg: &'a str, class: &str, title: &str) -> &'a str {
    let class = format!("<path class=\"{class}");
    let title = format!("<title>{title}");
    let mut found = svg
        .lines()
        .filter(|line| line.starts_with(&class) && line.contains(&title));
    found.next().unwrap()
}

/// Whether a place is in an odd number of the rings of a shade.
pub(crate) fn covers(line: &str, [x, y]: [f64; 2]) -> bool {
    let mut inside = false;
    for ring in pieces(line) {
        let next = ring.iter().cycle().skip(1);
        for (from, to) in ring.iter().zip(next) {
            let rising = (from[1] > y) != (to[1] > y);
            if rising && x < from[0] + (y - from[1]) / (to[1] - from[1]) * (to[0] - from[0]) {
                inside = !inside;
            }
        }
    }
    inside
}

/// Text and place of the labels with a slot of their own.
pub(crate) fn labels(svg: &str) -> Vec<(String, [f64; 2])> {
    let lines = svg
        .lines()
        .filter(|line| line.starts_with("<text class=\"ink label\""));
    lines
        .map(|line| {
            let moved = attribute(line, "transform");
            let (place, _) = moved
                .trim_start_matches("translate(")
                .split_once(')')
                .unwrap();
            let (x, y) = place.split_once(' ').unwrap();
            let (_, text) = line.split_once('>').unwrap();
            let text = text.trim_end_matches("</text>").to_owned();
            (text, [x.parse().unwrap(), y.parse().unwrap()])
        })
        .collect()
}
