//! A drive from above, played back at its own speed: one SVG without a script, so that it also
//! moves where a page only shows it as a picture.

use std::fmt::Write as _;

use singletrack_control::VehicleParameters;
use toml::Table;

use super::drive::{Drive, TickSample, distance};
use crate::{figure::trimmed, output::fill};

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

/// The car and its geofence, by the configuration.
struct Scene {
    /// Length of the body, in m.
    length: f64,
    width: f64,
    /// From the centre of mass, as the law believes it, in m.
    front_axle: f64,
    rear_axle: f64,
    /// From the front axle, in m.
    point: f64,
    fence: Vec<[f64; 2]>,
}

impl Scene {
    /// None if the configuration does not hold the car.
    fn of(configuration: &Table) -> Option<Self> {
        let vehicle: VehicleParameters = configuration.get("vehicle")?.clone().try_into().ok()?;
        let law = configuration.get("law")?;
        let front_axle = law.get("front_axle_distance_m")?.as_float()?;
        let corners = configuration
            .get("fence")
            .and_then(|fence| fence.get("corners_m"));
        let corners = corners.and_then(|corners| corners.clone().try_into().ok());
        Some(Self {
            length: vehicle.body_length_m(),
            width: vehicle.body_width_m(),
            front_axle,
            rear_axle: vehicle.wheelbase_m() - front_axle,
            point: law.get("point_distance_m")?.as_float()?,
            fence: corners.unwrap_or_default(),
        })
    }

    fn fence_path(&self) -> String {
        if self.fence.is_empty() {
            return String::new();
        }
        format!(r#"<path class="fence" d="{}z"/>"#, through(&self.fence))
    }

    /// The car with its centre of mass at the origin, its front to the right; `steering` opens a group that
    /// turns with the front wheels.
    fn car(&self, steering: &str) -> String {
        let (length, width) = (self.length, self.width);
        let (front_axle, rear_axle) = (self.front_axle, self.rear_axle);
        let (wheel, tyre) = (0.17 * length, 0.07 * length);
        let wheel_at = |x: f64, y: f64| {
            let [tyre, x, y, wheel] = [tyre, x - 0.5 * wheel, y, wheel].map(number);
            format!(r#"<path class="wheel" stroke-width="{tyre}" d="M{x} {y}h{wheel}"/>"#)
        };
        let axles = |side: f64| {
            let (rear, front) = (wheel_at(-rear_axle, side), wheel_at(0.0, 0.0));
            let [x, y] = [front_axle, side].map(number);
            format!(r#"{rear}<g transform="translate({x} {y})">{steering}{front}</g></g>"#)
        };
        let overhang = 0.5 * (length - front_axle - rear_axle);
        let side = 0.5 * (width - tyre);
        fill(
            include_str!("car.svg").trim_end(),
            &[
                ("body_left", number(-rear_axle - overhang)),
                ("body_top", number(-0.5 * width)),
                ("length", number(length)),
                ("width", number(width)),
                ("corner", number(0.12 * length)),
                ("wheels", axles(-side) + &axles(side)),
                ("front", number(front_axle)),
                ("steering", steering.to_owned()),
                ("point", number(self.point)),
                ("point_radius", number(0.075 * length)),
            ],
        )
    }
}

/// The part of the floor that is seen.
struct View {
    left: f64,
    top: f64,
    width: f64,
    height: f64,
    /// Pixels per m.
    scale: f64,
    width_px: f64,
    height_px: f64,
    /// From one line of the grid to the next, in m.
    grid_m: f64,
}

/// The size of the picture of the floor is within this, in pixels.
const WIDTH_PX: f64 = 800.0;
const HEIGHT_PX: f64 = 560.0;
/// The narrowest that holds its legend, in pixels.
const LEAST_WIDTH_PX: f64 = 420.0;
/// A geofence is shown whole up to this multiple of the size of the drive.
const FENCE_RATIO: f64 = 2.0;

impl View {
    /// What shows these places with a car around each, and the geofence if it is near.
    fn around(places: &[[f64; 2]], scene: &Scene) -> Self {
        let border = 0.6 * scene.length;
        let driven = Bounds::NONE.with(places, border);
        let both = driven.with(&scene.fence, 0.3 * border);
        let is_near = both.width() <= FENCE_RATIO * driven.width()
            && both.height() <= FENCE_RATIO * driven.height();
        let seen = if is_near { both } else { driven };
        let scale = (WIDTH_PX / seen.width()).min(HEIGHT_PX / seen.height());
        let width_px = (seen.width() * scale).max(LEAST_WIDTH_PX);
        let missing = width_px / scale - seen.width();
        let grids = [0.1, 0.5, 1.0, 5.0, 10.0, 50.0];
        let grid_m = grids.into_iter().find(|grid| grid * scale >= 60.0);
        Self {
            left: seen.low[0] - 0.5 * missing,
            top: seen.high[1],
            width: width_px / scale,
            height: seen.height(),
            scale,
            width_px,
            height_px: seen.height() * scale,
            grid_m: grid_m.unwrap_or(100.0),
        }
    }

    /// From metres, y up, to pixels, y down, below a header.
    fn transform(&self, header_px: f64) -> String {
        let scale = self.scale;
        let [x, y] = [-self.left * scale, header_px + self.top * scale].map(number);
        format!("translate({x} {y}) scale({scale:.4} {:.4})", -scale)
    }

    fn metres(&self, pixels: f64) -> f64 {
        pixels / self.scale
    }

    fn grid(&self) -> String {
        let mut path = String::new();
        let lines = |from: f64, length: f64| {
            let first = (from / self.grid_m).ceil() as i64;
            let last = ((from + length) / self.grid_m).floor() as i64;
            first..=last
        };
        let bottom = self.top - self.height;
        for index in lines(self.left, self.width) {
            let x = index as f64 * self.grid_m;
            let _ = write!(path, "M{} {bottom:.3}v{:.3}", number(x), self.height);
        }
        for index in lines(bottom, self.height) {
            let y = index as f64 * self.grid_m;
            let _ = write!(path, "M{:.3} {}h{:.3}", self.left, number(y), self.width);
        }
        format!(r#"<path class="grid" d="{path}"/>"#)
    }
}

/// A rectangle on the floor.
#[derive(Clone, Copy)]
struct Bounds {
    low: [f64; 2],
    high: [f64; 2],
}

impl Bounds {
    const NONE: Self = Self {
        low: [f64::INFINITY; 2],
        high: [f64::NEG_INFINITY; 2],
    };

    /// What holds these places with a border, too.
    fn with(mut self, places: &[[f64; 2]], border: f64) -> Self {
        for (axis, value) in places.iter().flat_map(|place| place.iter().enumerate()) {
            self.low[axis] = self.low[axis].min(value - border);
            self.high[axis] = self.high[axis].max(value + border);
        }
        self
    }

    fn width(&self) -> f64 {
        self.high[0] - self.low[0]
    }

    fn height(&self) -> f64 {
        self.high[1] - self.low[1]
    }
}

/// A number to a thousandth, without needless digits.
fn number(value: f64) -> String {
    trimmed(value, 3)
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
