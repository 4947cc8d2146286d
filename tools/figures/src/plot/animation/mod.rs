//! A drive from above, played back at its own speed: one SVG without a script, so that it also
//! moves where a page only shows it as a picture.

mod scene;

use std::fmt::Write as _;

use toml::Table;

use super::drive::{Drive, TickSample, distance};
use crate::output::fill;
use scene::{Scene, View, number};

/// The name of the animation's file.
pub const ANIMATION: &str = "animation.svg";

/// From one frame of the picture to the next, in s, in drives that are not too long for it.
const STEP: f64 = 0.1;
/// Frames of the longest drive: the file stays below a few hundred kB.
const MAX_FRAMES: f64 = 1_200.0;
/// For how long the end of the drive is shown before it begins again, in s.
const PAUSE: f64 = 1.5;

/// Draws the animation of a drive that was driven with this configuration.
///
/// # Errors
///
/// What the drive or the configuration lacks for it.
pub(super) fn animation(drive: &Drive, configuration: &Table) -> Result<String, &'static str> {
    let scene = Scene::of(configuration);
    let scene = scene.ok_or("the record does not hold the dimensions of the car")?;
    let frames = Frames::of(drive).ok_or("no tick knows where the car was")?;
    let view = View::around(&frames.all_places(), &scene);
    let seconds = number(frames.duration);
    // Opens a group. What does not move it shows it where the drive ended.
    let animate = |kind: &str, values: Vec<String>| {
        format!(
            r#"<g transform="{kind}({})"><animateTransform attributeName="transform" type="{kind}" dur="{seconds}s" repeatCount="indefinite" values="{}"/>"#,
            values.last().map_or("0", String::as_str),
            values.join(";")
        )
    };
    let translation = |places: &[[f64; 2]]| {
        let values = places.iter().map(|[x, y]| format!("{x:.3} {y:.3}"));
        animate("translate", values.collect())
    };
    let rotation = |angles: &[f64]| {
        let values = angles.iter().map(|angle| number(angle.to_degrees()));
        animate("rotate", values.collect())
    };
    let (label, reference_path, reference, legend) = match &frames.reference {
        Some(places) => {
            let (path, radius) = (through(places), number(0.11 * scene.length));
            (
                "A car from above: P, in front of it, follows its reference",
                format!(r#"<path class="reference-path" d="{path}"/>"#),
                translation(places) + &format!(r#"<circle class="reference" r="{radius}"/></g>"#),
                r#"<circle class="ring" cx="76" cy="17" r="6"/><text x="90" y="22">reference</text>"#,
            )
        }
        None => (
            "A car from above: P, in front of it, moves with the velocity that it is given",
            String::new(),
            String::new(),
            "",
        ),
    };
    let car = scene.car(&rotation(&frames.steering));
    let car = translation(&frames.car) + &rotation(&frames.yaw) + &car + "</g></g>";
    Ok(fill(
        include_str!("template.svg"),
        &[
            ("label", label.to_owned()),
            ("width", number(view.width_px)),
            ("height", number(view.height_px + HEADER_PX + FOOTER_PX)),
            ("floor_top", number(HEADER_PX)),
            ("floor_height", number(view.height_px)),
            ("bar_top", number(HEADER_PX + view.height_px + 10.0)),
            ("text_bottom", number(HEADER_PX + view.height_px + 16.0)),
            ("bar_width", number(view.width_px - 2.0 * BAR_PX)),
            ("bar_left", number(BAR_PX)),
            ("seconds", seconds.clone()),
            ("progress", frames.progress(view.width_px - 2.0 * BAR_PX)),
            ("driven", format!("{:.0} s", frames.driven)),
            ("grid_text", format!("grid {} m", view.grid_m)),
            ("grid_right", number(view.width_px - 16.0)),
            ("transform", view.transform(HEADER_PX)),
            ("grid", view.grid()),
            ("fence", scene.fence_path()),
            ("reference_path", reference_path),
            ("trail", frames.trail(&seconds)),
            // In m, as all on the floor: not every renderer knows strokes that do not scale.
            ("px_1", number(view.metres(1.0))),
            ("px_1_5", number(view.metres(1.5))),
            ("px_2", number(view.metres(2.0))),
            ("px_2_5", number(view.metres(2.5))),
            ("px_3_5", number(view.metres(3.5))),
            ("px_4", number(view.metres(4.0))),
            ("px_7", number(view.metres(7.0))),
            ("lost", frames.lost(&seconds, view.width_px)),
            ("reference", reference),
            ("car", car),
            ("legend_reference", legend.to_owned()),
        ],
    ))
}

/// Above the floor: the legend. Below it: the time.
const HEADER_PX: f64 = 34.0;
const FOOTER_PX: f64 = 24.0;
/// Left and right of the bar of the time.
const BAR_PX: f64 = 60.0;

/// What the picture shows, at equal intervals of time.
struct Frames {
    /// Duration of all of it, in s, with the pause at the end.
    duration: f64,
    /// Duration of the drive, in s.
    driven: f64,
    step: f64,
    car: Vec<[f64; 2]>,
    /// Without jumps at half a turn, in rad.
    yaw: Vec<f64>,
    steering: Vec<f64>,
    point: Vec<[f64; 2]>,
    /// Where P should be; none for a drive without such places.
    reference: Option<Vec<[f64; 2]>>,
    /// The spans without markers, in s.
    spans: Vec<[f64; 2]>,
}

impl Frames {
    /// None if it is not known where the car was.
    fn of(drive: &Drive) -> Option<Self> {
        let driven = drive.duration();
        let step = STEP.max(driven / MAX_FRAMES);
        let moving = (driven / step).ceil() as usize;
        let frames = moving + (PAUSE / step).ceil() as usize;
        let ticks: Vec<&TickSample> = (0..=frames)
            .filter_map(|frame| {
                // Times of ticks jitter by far less than a frame.
                let time = frame as f64 * step + 1e-3;
                let after = drive.ticks.partition_point(|tick| tick.time <= time);
                drive.ticks.get(after.saturating_sub(1))
            })
            .collect();
        let pick = |value: fn(&TickSample) -> [f64; 2]| held(ticks.iter().map(|tick| value(tick)));
        let first = |places: Vec<[f64; 2]>| places.iter().map(|[angle, _]| *angle).collect();
        let mut yaw: Vec<f64> = first(pick(|tick| [tick.yaw, 0.0])?);
        unwrap(&mut yaw);
        Some(Self {
            duration: frames as f64 * step,
            driven,
            step,
            car: pick(|tick| tick.place)?,
            yaw,
            steering: first(pick(|tick| [tick.steering, 0.0])?),
            point: pick(|tick| tick.point)?,
            reference: pick(|tick| tick.nominal),
            spans: drive.lost_markers(),
        })
    }

    fn all_places(&self) -> Vec<[f64; 2]> {
        let all = [&self.car, &self.point].into_iter().chain(&self.reference);
        all.flatten().copied().collect()
    }

    /// The path of P, drawn as far as P has gone.
    fn trail(&self, seconds: &str) -> String {
        let steps = || self.point.array_windows();
        let length: f64 = steps().map(|[one, other]| distance(*one, *other)).sum();
        let mut rest = length;
        let mut offsets = format!("{length:.3}");
        for [one, other] in steps() {
            rest = (rest - distance(*one, *other)).max(0.0);
            let _ = write!(offsets, ";{rest:.3}");
        }
        format!(
            r#"<path class="trail" d="{}" stroke-dasharray="{length:.3}"><animate attributeName="stroke-dashoffset" dur="{seconds}s" repeatCount="indefinite" values="{offsets}"/></path>"#,
            through(&self.point)
        )
    }

    /// The time, as the widths of its bar.
    fn progress(&self, width: f64) -> String {
        let widths = (0..self.car.len()).map(|frame| {
            let part = frame as f64 * self.step / self.driven.max(self.step);
            number(width * part.min(1.0))
        });
        widths.collect::<Vec<_>>().join(";")
    }

    /// A word that is seen while the cameras do not see the car.
    fn lost(&self, seconds: &str, width: f64) -> String {
        if self.spans.is_empty() {
            return String::new();
        }
        let values = (0..self.car.len()).map(|frame| {
            let (from, to) = (frame as f64 * self.step, (frame + 1) as f64 * self.step);
            let is_lost = self.spans.iter().any(|span| span[0] < to && span[1] > from);
            if is_lost { "visible" } else { "hidden" }
        });
        format!(
            r#"<text class="lost" x="{}" y="22" text-anchor="middle" visibility="hidden">markers lost<animate attributeName="visibility" calcMode="discrete" dur="{seconds}s" repeatCount="indefinite" values="{}"/></text>"#,
            number(0.5 * width),
            values.collect::<Vec<_>>().join(";")
        )
    }
}

/// What is not known is as it was; before the first that is known, as it is then.
fn held(values: impl Iterator<Item = [f64; 2]>) -> Option<Vec<[f64; 2]>> {
    let mut values: Vec<[f64; 2]> = values.collect();
    let known = |value: &[f64; 2]| value.iter().all(|part| part.is_finite());
    let mut last = *values.iter().find(|value| known(value))?;
    for value in &mut values {
        if known(value) {
            last = *value;
        }
        *value = last;
    }
    Some(values)
}

/// Takes the whole turns out of the steps of an angle, in rad.
fn unwrap(angles: &mut [f64]) {
    let mut before = angles.first().copied().unwrap_or_default();
    for angle in angles {
        let turns = ((*angle - before) / core::f64::consts::TAU).round();
        *angle -= turns * core::f64::consts::TAU;
        before = *angle;
    }
}

fn through(places: &[[f64; 2]]) -> String {
    let places = places.iter().map(|[x, y]| format!("{x:.3} {y:.3}"));
    format!("M{}", places.collect::<Vec<_>>().join("L"))
}

#[cfg(test)]
mod tests {
    use core::f64::consts::PI;

    use super::*;

    #[test]
    fn a_turn_has_no_jump() {
        let mut yaw = [3.0, 3.1, -3.1, -3.0, 3.1];
        unwrap(&mut yaw);
        let expected = [3.0, 3.1, 2.0 * PI - 3.1, 2.0 * PI - 3.0, 3.1];
        for (yaw, expected) in yaw.iter().zip(expected) {
            assert!((yaw - expected).abs() < 1e-12, "{yaw} is not {expected}");
        }
    }

    #[test]
    fn what_is_not_known_is_as_it_was() {
        let unknown = [f64::NAN; 2];
        let values = [unknown, [1.0, 2.0], unknown, [3.0, 4.0]];
        let expected = [[1.0, 2.0], [1.0, 2.0], [1.0, 2.0], [3.0, 4.0]];
        assert_eq!(held(values.into_iter()).unwrap(), expected);
        assert_eq!(held([unknown, unknown].into_iter()), None);
    }
}
