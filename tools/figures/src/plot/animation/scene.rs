//! What stands still in the animation: the car's shape, the geofence, and the part of the floor
//! that is seen.

use std::fmt::Write as _;

use singletrack_control::VehicleParameters;
use toml::Table;

use crate::{figure::trimmed, output::fill};

/// The car and its geofence, by the configuration.
pub(super) struct Scene {
    /// Length of the body, in m.
    pub(super) length: f64,
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
    pub(super) fn of(configuration: &Table) -> Option<Self> {
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

    pub(super) fn fence_path(&self) -> String {
        if self.fence.is_empty() {
            return String::new();
        }
        format!(
            r#"<path class="fence" d="{}z"/>"#,
            super::through(&self.fence)
        )
    }

    /// The car with its centre of mass at the origin, its front to the right; `steering` opens a group that
    /// turns with the front wheels.
    pub(super) fn car(&self, steering: &str) -> String {
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
pub(super) struct View {
    left: f64,
    top: f64,
    width: f64,
    height: f64,
    /// Pixels per m.
    scale: f64,
    pub(super) width_px: f64,
    pub(super) height_px: f64,
    /// From one line of the grid to the next, in m.
    pub(super) grid_m: f64,
}

/// The size of the picture of the floor is within this, in pixels.
const WIDTH_PX: f64 = 800.0;
const HEIGHT_PX: f64 = 560.0;
/// The narrowest that holds its legend, in pixels.
const LEAST_WIDTH_PX: f64 = 420.0;
/// A geofence wider than so many times what was driven is not shown whole.
const FENCE_RATIO: f64 = 2.0;

impl View {
    /// What shows these places with a car around each, and the geofence if it is near.
    pub(super) fn around(places: &[[f64; 2]], scene: &Scene) -> Self {
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
    pub(super) fn transform(&self, header_px: f64) -> String {
        let scale = self.scale;
        let [x, y] = [-self.left * scale, header_px + self.top * scale].map(number);
        format!("translate({x} {y}) scale({scale:.4} {:.4})", -scale)
    }

    pub(super) fn metres(&self, pixels: f64) -> f64 {
        pixels / self.scale
    }

    pub(super) fn grid(&self) -> String {
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
pub(super) fn number(value: f64) -> String {
    trimmed(value, 3)
}
