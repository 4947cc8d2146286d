//! The status in words.

use singletrack_api::{Command, Estimate, State, Status};
use singletrack_core::reasons::Why;

use crate::help::wrap;
use crate::operator::tune;

/// Columns of the names in the view.
const NAMES: usize = 10;
/// Columns of the first value beside a name.
const VALUES: usize = 18;

/// What a person needs of the daemon's status.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Summary {
    /// The last answer to `status`, with the values of the last state.
    status: Status,
    telemetry_age_ms: Option<f64>,
}

impl Summary {
    /// Of an answer to `status`.
    pub(super) const fn of(status: Status) -> Self {
        Self {
            status,
            telemetry_age_ms: None,
        }
    }

    /// Takes from an answer to `status` all that the states do not have.
    pub(super) fn take_status(&mut self, status: Status) {
        self.status = Status {
            command: self.status.command,
            drive_time_s: self.status.drive_time_s,
            estimate: self.status.estimate,
            point_m: self.status.point_m,
            reference_m: self.status.reference_m,
            ..status
        };
    }

    /// Takes a state of the stream.
    pub(super) fn take_state(&mut self, state: State) {
        self.telemetry_age_ms = state.board_age.map(|age_s| age_s * 1_000.0);
        let status = &mut self.status;
        status.estimate = estimate(&state);
        status.mode = state.mode;
        status.reason = state.reason;
        status.drive_time_s = state.drive_time;
        status.point_m = state.point;
        status.reference_m = state.reference;
        status.command = Some(Command {
            speed_m_s: state.commanded_speed,
            steering_rad: state.steering,
        });
    }

    /// The status as one line.
    pub(super) fn line(&self) -> String {
        let why = Why::of(&self.status);
        let mut line = self.status.mode.to_string();
        if let Some(time_s) = self.status.drive_time_s {
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
            age(self.pose_age_ms()),
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
        let time = status.drive_time_s.map(|time_s| format!("{time_s:.1} s"));
        lines.field("mode", &status.mode, &time.unwrap_or_default());
        // Above all else: what is below the window is not seen.
        if let Some(why) = why {
            lines.paragraph("why", &why.text);
            lines.paragraph("to do", why.advice.as_deref().unwrap_or("-"));
        }
        if let Some(trouble) = status.record_trouble() {
            lines.paragraph("record", &trouble);
        }
        lines.field("pose", &age(self.pose_age_ms()), &self.place());
        let commanded = metres_per_second(status.command.map(|command| command.speed_m_s));
        lines.field("speed", &self.speed(), &format!("commanded {commanded}"));
        let steering = status
            .command
            .map(|command| command.steering_rad.to_degrees());
        lines.field("steering", &with_unit(steering, 1, "degrees"), "");
        lines.field("P", &self.error(), "");
        let telemetry = format!("telemetry {}", age(self.telemetry_age_ms));
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
        let tuning = self.status.tuning.as_ref()?;
        let configured = tuning.configured.as_deref()?;
        let [tuned, was] = [tuning, configured].map(tune::in_words);
        tuning
            .differs?
            .then(|| format!("{tuned} (configured: {was})"))
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
            ("stamps", learned.stamp_offset_ms, "ms"),
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

    fn pose_age_ms(&self) -> Option<f64> {
        self.status.estimate.map(|estimate| estimate.pose_age_ms)
    }

    fn speed(&self) -> String {
        metres_per_second(self.status.estimate.map(|estimate| estimate.speed_m_s))
    }

    fn link(&self) -> &str {
        self.status.link.as_deref().unwrap_or("unknown")
    }

    fn battery(&self) -> String {
        let board = self.status.board.as_ref();
        let battery_mv = board.and_then(|board| board.battery_mv);
        with_unit(battery_mv.map(|mv| f64::from(mv) / 1_000.0), 2, "V")
    }

    fn place(&self) -> String {
        let Some(Estimate {
            x_m, y_m, yaw_rad, ..
        }) = self.status.estimate
        else {
            return String::new();
        };
        let yaw = with_unit(Some(yaw_rad.to_degrees()), 0, "degrees");
        format!("at ({x_m:.2}, {y_m:.2}) m, yaw {yaw}")
    }

    /// How far P is from its reference.
    fn error(&self) -> String {
        let (Some([x_m, y_m]), Some([reference_x_m, reference_y_m])) =
            (self.status.point_m, self.status.reference_m)
        else {
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

/// The estimate of a state.
fn estimate(state: &State) -> Option<Estimate> {
    Some(Estimate {
        pose_age_ms: state.pose_age? * 1_000.0,
        sideslip_rad: state.sideslip.unwrap_or_default(),
        speed_m_s: state.speed?,
        x_m: state.x?,
        y_m: state.y?,
        yaw_rad: state.yaw?,
        yaw_rate_rad_s: state.yaw_rate.unwrap_or_default(),
    })
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
fn age(age_ms: Option<f64>) -> String {
    match age_ms {
        None => "none".to_owned(),
        Some(age_ms) if age_ms < 1_000.0 => format!("{age_ms:.0} ms old"),
        Some(age_ms) => format!("{:.1} s old", age_ms / 1_000.0),
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
            "mode": "idle", "reason": "requested", "preflight": "no-pose", "link": "ready",
            "estimate": null, "drive_time_s": null,
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
        assert!(line.ends_with("To do: is the cable plugged in?."), "{line}");
        status["preflight"] = json!("battery-low");
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
            status["preflight"] = json!(preflight);
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
            "stamp_offset_ms": 0.0,
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
        status["mode"] = json!("fault");
        status["reason"] = json!("board-failsafe");
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
        status["mode"] = json!("ready");
        status["preflight"] = json!(null);
        status["reason"] = json!("board-failsafe");
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
        let mut status = standing();
        status["mode"] = json!("driving");
        status["reason"] = json!(null);
        let mut summary = of(&status);
        let state = json!({
            "mode": "driving", "reason": null, "drive_time": 12.34, "pose_age": 0.0124,
            "speed": 0.4987, "x": 1.0, "y": -0.5, "yaw": 0.5, "point": [1.0, 0.0],
            "reference": [1.0, 0.012], "commanded_speed": 0.5, "steering": -0.1,
            "board_age": 0.008,
            "topic": "state", "tick": 1, "t": 0.0, "time_ns": 1, "held": false,
            "filtering": "none",
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
        status["mode"] = json!("ready");
        status["preflight"] = json!(null);
        status["reason"] = json!("time-up");
        status["estimate"] = json!({
            "speed_m_s": -0.004, "pose_age_ms": 8.0, "x_m": 0.0, "y_m": 0.0, "yaw_rad": 0.0,
            "yaw_rate_rad_s": 0.0, "sideslip_rad": 0.0,
        });
        let line = of(&status).line();
        assert_eq!(
            line,
            "ready: the last drive ended: the time that was given with the arm request is over \
             (time-up); pose 8 ms old, battery 7.41 V, link ready, speed 0.00 m/s"
        );
        status["estimate"]["speed_m_s"] = json!(-0.3);
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
        status["preflight"] = json!("asleep");
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
