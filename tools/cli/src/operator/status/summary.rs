//! The status in words.

use singletrack_api::{State, Status};
use singletrack_core::reasons::Why;

use crate::{help::wrap, operator::control};

/// Columns of the names in the view.
const NAMES: usize = 10;
/// Columns of the first value beside a name.
const VALUES: usize = 18;

/// What a person needs of the daemon's status.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Summary {
    /// The last answer to `status`, with the newest state.
    status: Status,
}

impl Summary {
    /// Summary of an answer to `status`.
    pub(super) const fn of(status: Status) -> Self {
        Self { status }
    }

    /// Takes an answer to `status`, except its state: that of the stream is newer.
    pub(super) fn take_status(&mut self, status: Status) {
        self.status = Status {
            state: self.status.state.take().or(status.state),
            ..status
        };
    }

    /// Takes a state of the stream.
    pub(super) fn take_state(&mut self, state: State) {
        self.status.state = Some(state);
    }

    /// The status as one line.
    pub(super) fn line(&self) -> String {
        let why = Why::of(&self.status);
        let mut line = self.status.mode().to_owned();
        if let Some(time_s) = self.value(|state| state.drive_time_s) {
            line += &format!(" {time_s:.1} s");
        }
        if let Some(why) = &why {
            line += &format!(": {}", why.text);
        }
        if let Some(trouble) = self.status.record_trouble() {
            line += &format!("; {trouble}");
        }
        line += &format!(
            "; pose {}, battery {}, link {}, speed {}",
            age(self.value(|state| state.pose_age_s)),
            self.battery(),
            self.link(),
            self.speed(),
        );
        for (name, text) in [
            ("tuned", self.tuned()),
            ("calibration", self.calibration()),
            ("learned", self.learned()),
        ] {
            if let Some(text) = text {
                line += &format!("; {name}: {text}");
            }
        }
        if let Some(advice) = why.and_then(|why| why.advice) {
            line += &format!(". To do: {advice}");
        }
        line
    }

    /// The status as lines no wider than `columns`.
    pub(super) fn lines(&self, columns: usize) -> Vec<String> {
        let why = Why::of(&self.status);
        let status = &self.status;
        let mut lines = Lines {
            columns,
            lines: Vec::new(),
        };
        let time = self.value(|state| state.drive_time_s);
        let time = time.map(|time_s| format!("{time_s:.1} s"));
        lines.field("mode", status.mode(), &time.unwrap_or_default());
        // Above all else: what is below the window is not seen.
        if let Some(why) = why {
            lines.paragraph("why", &why.text);
            lines.paragraph("to do", why.advice.as_deref().unwrap_or("-"));
        }
        if let Some(trouble) = status.record_trouble() {
            lines.paragraph("record", &trouble);
        }
        let pose = age(self.value(|state| state.pose_age_s));
        lines.field("pose", &pose, &self.place());
        let commanded = metres_per_second(self.value(|state| Some(state.commanded_speed_m_s)));
        lines.field("speed", &self.speed(), &format!("commanded {commanded}"));
        let steering = self.value(|state| Some(state.steering_rad.to_degrees()));
        lines.field("steering", &with_unit(steering, 1, "degrees"), "");
        lines.field("P", &self.error(), "");
        let telemetry = format!("telemetry {}", age(self.value(|state| state.board_age_s)));
        lines.field("link", self.link(), &telemetry);
        lines.field("battery", &self.battery(), "");
        for (name, text) in [
            ("tuned", self.tuned()),
            ("advice", self.calibration()),
            ("learned", self.learned()),
        ] {
            if let Some(text) = text {
                lines.paragraph(name, &text);
            }
        }
        lines.lines
    }

    /// Tuned values that differ from the configuration, and those of the configuration.
    fn tuned(&self) -> Option<String> {
        let tunable = self.status.tuning.as_ref().filter(|it| it.differs)?;
        let tuning = self.status.state.as_ref()?.tuning()?;
        let [tuned, was] = [&tuning, &tunable.configured].map(control::in_words);
        Some(format!("{tuned} (configured: {was})"))
    }

    /// What the drives say of the calibration.
    fn calibration(&self) -> Option<String> {
        self.status.calibration.as_ref()?.line()
    }

    /// What live calibration corrects, such as "steering gain -12.5 %"; only what is not nothing.
    fn learned(&self) -> Option<String> {
        let learned = self.status.learned?;
        let [forward, left] = learned.pivot_m;
        let corrections = [
            ("steering gain", 1e2 * learned.steering_gain, "%"),
            ("trim", 1e3 * learned.steering_trim_rad, "mrad"),
            ("stamps", 1e3 * learned.stamp_offset_s, "ms"),
            ("body yaw", 1e3 * learned.body_yaw_rad, "mrad"),
            ("pivot forward", 1e3 * forward, "mm"),
            ("pivot left", 1e3 * left, "mm"),
        ];
        let shown: Vec<String> = corrections
            .into_iter()
            .filter(|(_, value, ..)| *value != 0.0)
            .map(|(name, value, unit)| format!("{name} {value:+.1} {unit}"))
            .collect();
        Some(match shown.as_slice() {
            [] => "nothing yet".to_owned(),
            shown => shown.join(", "),
        })
    }

    /// A value of the newest state.
    fn value<T>(&self, of: impl FnOnce(&State) -> Option<T>) -> Option<T> {
        self.status.state.as_ref().and_then(of)
    }

    fn speed(&self) -> String {
        metres_per_second(self.value(|state| state.speed_m_s))
    }

    fn link(&self) -> &str {
        let state = self.status.state.as_ref();
        state.map_or("unknown", |state| &state.link)
    }

    fn battery(&self) -> String {
        let board = self.status.board.as_ref();
        let battery_mv = board.and_then(|board| board.battery_mv);
        with_unit(battery_mv.map(|mv| f64::from(mv) / 1_000.0), 2, "V")
    }

    fn place(&self) -> String {
        let place = |state: &State| Some((state.x_m?, state.y_m?, state.yaw_rad?));
        let Some((x_m, y_m, yaw_rad)) = self.value(place) else {
            return String::new();
        };
        let yaw = with_unit(Some(yaw_rad.to_degrees()), 0, "degrees");
        format!("at ({x_m:.2}, {y_m:.2}) m, yaw {yaw}")
    }

    /// How far P is from its reference.
    fn error(&self) -> String {
        let both = |state: &State| state.point_m.zip(state.reference_m);
        let Some(([x_m, y_m], [reference_x_m, reference_y_m])) = self.value(both) else {
            return "-".to_owned();
        };
        let error_m = libm::hypot(x_m - reference_x_m, y_m - reference_y_m);
        format!("{:.0} mm from its reference", error_m * 1_000.0)
    }
}

/// Lines that begin with a name.
struct Lines {
    /// How wide a paragraph may be.
    columns: usize,
    lines: Vec<String>,
}

impl Lines {
    fn field(&mut self, name: &str, first: &str, second: &str) {
        let text = format!("{name:<NAMES$}{first:<VALUES$}{second}");
        self.lines.push(text.trim_end().to_owned());
    }

    fn paragraph(&mut self, name: &str, text: &str) {
        for (index, part) in wrap(text, self.columns.saturating_sub(NAMES)).enumerate() {
            let name = if index == 0 { name } else { "" };
            self.lines.push(format!("{name:<NAMES$}{part}"));
        }
    }
}

fn with_unit(value: Option<f64>, digits: usize, unit: &str) -> String {
    value.map_or_else(
        || "unknown".to_owned(),
        |value| {
            let text = format!("{value:.digits$}");
            // Noise around zero is not reverse.
            let is_zero = !text.contains(|digit| matches!(digit, '1'..='9'));
            let text = text.strip_prefix('-').filter(|_| is_zero).unwrap_or(&text);
            format!("{text} {unit}")
        },
    )
}

fn metres_per_second(speed_m_s: Option<f64>) -> String {
    with_unit(speed_m_s, 2, "m/s")
}

/// An age; none of what has never come.
fn age(age_s: Option<f64>) -> String {
    match age_s {
        None => "none".to_owned(),
        Some(age_s) if age_s < 1.0 => format!("{:.0} ms old", age_s * 1_000.0),
        Some(age_s) => format!("{age_s:.1} s old"),
    }
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};

    use super::*;

    fn of(status: &Value) -> Summary {
        Summary::of(serde_json::from_value(status.clone()).unwrap())
    }

    fn standing() -> Value {
        json!({
            "state": {
                "topic": "state", "tick": 1, "t_s": 0.0, "time_ns": 1, "held": true,
                "mode": "idle", "reason": "requested", "preflight": "no-pose", "link": "ready",
                "steering_rad": 0.0, "commanded_speed_m_s": 0.0,
                "filtering": "none", "filtered_ticks": 0,
            },
            "board": {"mode": "neutral", "stop_cause": "disarmed", "battery_mv": 7412},
            "cameras": {"diagnosis": "good", "text": "poses arrive"},
            "configuration": {"number": 1}, "figures": {}, "realtime": {},
        })
    }

    #[test]
    fn a_car_that_stands_says_why_it_is_not_armed_and_what_to_do() {
        assert_eq!(
            of(&standing()).line(),
            "idle: no pose yet (no-pose); pose none, battery 7.41 V, link ready, speed unknown. \
             To do: Start streaming; check motion_capture.server and rigid_body; look at the \
             camera messages in the log."
        );
    }

    #[test]
    fn the_diagnosis_of_the_cameras_replaces_the_advice_for_poses_alone() {
        let mut status = standing();
        status["cameras"] = json!({"diagnosis": "no-server", "text": "is the cable plugged in?"});
        let line = of(&status).line();
        assert!(line.ends_with("To do: is the cable plugged in?"), "{line}");
        status["state"]["preflight"] = json!("battery-low");
        let line = of(&status).line();
        assert!(
            line.contains("(battery-low)") && line.contains("Charge it."),
            "{line}"
        );
    }

    #[test]
    fn another_body_near_a_car_without_a_pose_is_named_beside_the_advice() {
        let mut status = standing();
        status["cameras"]["neighbour"] = json!("\"wand\" is near");
        for (preflight, named) in [("pose-implausible", true), ("battery-low", false)] {
            status["state"]["preflight"] = json!(preflight);
            let line = of(&status).line();
            assert_eq!(line.contains("; \"wand\" is near"), named, "{line}");
            assert!(line.contains("To do: "), "{line}");
        }
    }

    #[test]
    fn what_is_learned_is_shown_without_what_is_not() {
        let mut status = standing();
        status["learned"] = json!({
            "body_yaw_rad": 0.0,
            "pivot_m": [0.0, -0.005],
            "stamp_offset_s": 0.0,
            "steering_gain": -0.125,
            "steering_trim_rad": 0.0,
        });
        let line = of(&status).line();
        let learned = "; learned: steering gain -12.5 %, pivot left -5.0 mm";
        assert!(line.contains(learned), "{line}");
        status["learned"] = json!(null);
        let line = of(&status).line();
        assert!(!line.contains("learned"), "{line}");
    }

    #[test]
    fn a_stop_of_the_board_is_explained_by_its_cause() {
        let mut status = standing();
        status["state"]["mode"] = json!("fault");
        status["state"]["reason"] = json!("board-failsafe");
        status["board"]["stop_cause"] = json!("motor-sensor");
        let line = of(&status).line();
        assert!(
            line.starts_with(
                "fault: the board stopped the car by itself (board-failsafe): no motor pulse"
            ),
            "{line}"
        );
        assert!(line.contains("To do: Check the pulse sensor"), "{line}");
    }

    #[test]
    fn a_board_that_was_reset_is_not_said_to_have_stopped_because_of_none() {
        let mut status = standing();
        status["state"]["mode"] = json!("ready");
        status["state"]["preflight"] = json!(null);
        status["state"]["reason"] = json!("board-failsafe");
        status["board"]["stop_cause"] = json!("none");
        let line = of(&status).line();
        assert!(
            line.starts_with("ready: the last drive ended: the board stopped the car by itself")
                && line.contains("has been reset since")
                && line.contains("To do: Look at the stops in the record"),
            "{line}"
        );
        assert!(!line.contains("none)"), "{line}");
    }

    #[test]
    fn the_view_says_why_below_the_mode() {
        let lines = of(&standing()).lines(80);
        assert!(lines[0].starts_with("mode      idle"), "{lines:?}");
        assert!(
            lines[1].starts_with("why       no pose yet (no-pose)"),
            "{lines:?}"
        );
        assert!(
            lines[2].starts_with("to do     Start streaming;"),
            "{lines:?}"
        );
    }

    #[test]
    fn a_drive_shows_time_age_and_speed_and_nothing_to_do() {
        let mut summary = of(&standing());
        let state = json!({
            "mode": "driving", "reason": null, "drive_time_s": 12.34, "pose_age_s": 0.0124,
            "speed_m_s": 0.4987, "x_m": 1.0, "y_m": -0.5, "yaw_rad": 0.5, "point_m": [1.0, 0.0],
            "reference_m": [1.0, 0.012], "commanded_speed_m_s": 0.5, "steering_rad": -0.1,
            "board_age_s": 0.008, "link": "ready",
            "topic": "state", "tick": 2, "t_s": 0.01, "time_ns": 2, "held": false,
            "filtering": "none", "filtered_ticks": 0,
        });
        summary.take_state(serde_json::from_value(state).unwrap());
        assert_eq!(
            summary.line(),
            "driving 12.3 s; pose 12 ms old, battery 7.41 V, link ready, speed 0.50 m/s"
        );
        let lines = summary.lines(80).join("\n");
        for part in [
            "12 mm from its reference",
            "telemetry 8 ms old",
            "at (1.00, -0.50) m",
        ] {
            assert!(lines.contains(part), "{part} is missing in {lines}");
        }
        // A state has no battery; the answer to a later question has no newer pose.
        summary.take_status(serde_json::from_value(standing()).unwrap());
        assert!(summary.line().contains("pose 12 ms old"));
    }

    #[test]
    fn a_car_that_is_ready_says_how_its_last_drive_ended_and_noise_is_not_reverse() {
        let mut status = standing();
        status["state"]["mode"] = json!("ready");
        status["state"]["preflight"] = json!(null);
        status["state"]["reason"] = json!("time-up");
        status["state"]["speed_m_s"] = json!(-0.004);
        status["state"]["pose_age_s"] = json!(0.008);
        let line = of(&status).line();
        assert_eq!(
            line,
            "ready: the last drive ended: the time that was given with the arm request is over \
             (time-up); pose 8 ms old, battery 7.41 V, link ready, speed 0.00 m/s"
        );
        status["state"]["speed_m_s"] = json!(-0.3);
        assert!(of(&status).line().ends_with("speed -0.30 m/s"));
    }

    #[test]
    fn a_record_that_has_ended_or_soon_will_is_told_before_the_figures() {
        let mut status = standing();
        status["record_warning"] = json!("the disk is nearly full");
        let told = |status: &Value, text: &str| {
            let text = format!("idle: no pose yet (no-pose); {text}; pose none");
            let line = of(status).line();
            assert!(line.starts_with(&text), "{line}");
        };
        told(&status, "the disk is nearly full");
        status["record_error"] = json!("No space left on device: can't write r.mcap.part");
        let text = "nothing is recorded: No space left on device: can't write r.mcap.part";
        told(&status, text);
        let lines = of(&status).lines(200);
        assert!(lines.iter().any(|line| line.contains(text)), "{lines:?}");
    }

    #[test]
    fn an_unknown_word_is_shown_as_it_is() {
        let mut status = standing();
        status["state"]["preflight"] = json!("asleep");
        assert!(of(&status).line().starts_with("idle: asleep; pose none"));
    }

    #[test]
    fn no_line_of_the_view_is_wider_than_the_terminal() {
        for columns in [40, 80, 200] {
            let lines = of(&standing()).lines(columns);
            for line in lines.iter().filter(|line| line.starts_with("to do")) {
                assert!(line.chars().count() <= columns, "{line}");
            }
        }
    }
}
