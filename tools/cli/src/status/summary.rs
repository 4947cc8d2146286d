//! The status in words.

use singletrack_api::{State, Status, Word};

use super::reasons::Entry;
use crate::tune;

/// Columns of the names in the view.
const NAMES: usize = 10;
/// Columns of the first value beside a name.
const VALUES: usize = 18;

/// What a person needs of the daemon's status.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Summary {
    mode: Word,
    /// Why the car does not drive, or stopped.
    reason: Option<Word>,
    /// Why an arm request would be refused now.
    preflight: Option<Word>,
    /// Why the board last went to neutral.
    stop_cause: Option<Word>,
    /// What is wrong with the cameras, and what to do.
    cameras: Option<String>,
    /// Which other rigid body is near the car.
    neighbour: Option<String>,
    record_error: Option<String>,
    /// Tuned values that differ from the configuration, and those of the configuration.
    tuned: Option<[String; 2]>,
    drive_time_s: Option<f64>,
    pose_age_s: Option<f64>,
    position_m: Option<[f64; 2]>,
    yaw_rad: Option<f64>,
    point_m: Option<[f64; 2]>,
    reference_m: Option<[f64; 2]>,
    speed_m_s: Option<f64>,
    commanded_speed_m_s: Option<f64>,
    steering_rad: Option<f64>,
    battery_v: Option<f64>,
    link: Option<Word>,
    telemetry_age_s: Option<f64>,
}

/// Why the car does not drive, in words.
struct Why {
    /// The meaning and the word.
    text: String,
    advice: Option<String>,
}

impl Summary {
    /// Of an answer to `status`.
    pub(super) fn of(status: &Status) -> Self {
        let mut summary = Self::default();
        summary.take_status(status);
        if let Some(estimate) = &status.estimate {
            summary.pose_age_s = Some(estimate.pose_age_ms / 1_000.0);
            summary.speed_m_s = Some(estimate.speed_m_s);
            summary.yaw_rad = Some(estimate.yaw_rad);
            summary.position_m = Some([estimate.x_m, estimate.y_m]);
        }
        summary.point_m = status.point_m;
        summary.reference_m = status.reference_m;
        summary.drive_time_s = status.drive_time_s;
        summary.commanded_speed_m_s = status.command.map(|command| command.speed_m_s);
        summary.steering_rad = status.command.map(|command| command.steering_rad);
        summary
    }

    /// Takes from an answer to `status` all that the states do not have.
    pub(super) fn take_status(&mut self, status: &Status) {
        self.mode = status.mode.clone();
        self.reason.clone_from(&status.reason);
        self.preflight.clone_from(&status.preflight);
        self.link.clone_from(&status.link);
        let board = status.board.as_ref();
        self.stop_cause = board.map(|board| board.stop_cause.clone());
        self.battery_v = board
            .and_then(|board| board.battery_mv)
            .map(|battery_mv| f64::from(battery_mv) / 1_000.0);
        let cameras = &status.cameras;
        let is_trouble = !matches!(&*cameras.diagnosis, "good" | "starting");
        self.cameras = is_trouble.then(|| cameras.text.clone());
        self.neighbour.clone_from(&cameras.neighbour);
        self.record_error.clone_from(&status.record_error);
        self.tuned = status.tuning.as_ref().and_then(|tuning| {
            let configured = tuning.configured.as_deref()?;
            tuning
                .differs?
                .then(|| [tuning, configured].map(tune::in_words))
        });
    }

    /// Takes a state of the stream.
    pub(super) fn take_state(&mut self, state: State) {
        self.mode = state.mode;
        self.reason = state.reason;
        self.drive_time_s = state.drive_time;
        self.pose_age_s = state.pose_age;
        self.speed_m_s = state.speed;
        self.yaw_rad = state.yaw;
        self.position_m = state.x.zip(state.y).map(Into::into);
        self.point_m = state.point;
        self.reference_m = state.reference;
        self.commanded_speed_m_s = Some(state.commanded_speed);
        self.steering_rad = Some(state.steering);
        self.telemetry_age_s = state.board_age;
    }

    /// The status as one line.
    pub(super) fn line(&self) -> String {
        let why = self.why();
        let mut line = self.mode.to_string();
        if let Some(time_s) = self.drive_time_s {
            line += &format!(" {time_s:.1} s");
        }
        if let Some(why) = &why {
            line += &format!(": {}", why.text);
        }
        line += &format!(
            "; pose {}, battery {}, link {}, speed {}",
            age(self.pose_age_s),
            self.battery(),
            self.link.as_deref().unwrap_or("unknown"),
            metres_per_second(self.speed_m_s),
        );
        if let Some([tuned, configured]) = &self.tuned {
            line += &format!("; tuned: {tuned} (configured: {configured})");
        }
        if let Some(advice) = why.and_then(|why| why.advice) {
            line += &format!(". To do: {advice}");
        }
        if let Some(error) = &self.record_error {
            line += &format!(" The record has ended: {error}");
        }
        line
    }

    /// The status as lines no wider than `columns`.
    pub(super) fn lines(&self, columns: usize) -> Vec<String> {
        let why = self.why();
        let mut lines = Vec::new();
        let mut field = |name: &str, first: &str, second: &str| {
            let text = format!("{name:<NAMES$}{first:<VALUES$}{second}");
            lines.push(text.trim_end().to_owned());
        };
        let time = self.drive_time_s.map(|time_s| format!("{time_s:.1} s"));
        field("mode", &self.mode, &time.unwrap_or_default());
        field("pose", &age(self.pose_age_s), &self.place());
        field(
            "speed",
            &metres_per_second(self.speed_m_s),
            &format!("commanded {}", metres_per_second(self.commanded_speed_m_s)),
        );
        let steering = self.steering_rad.map(f64::to_degrees);
        field("steering", &with_unit(steering, 1, "degrees"), "");
        field("P", &self.error(), "");
        field(
            "link",
            self.link.as_deref().unwrap_or("unknown"),
            &format!("telemetry {}", age(self.telemetry_age_s)),
        );
        field("battery", &self.battery(), "");
        let mut paragraph = |name: &str, text: &str| {
            for (index, part) in wrap(text, columns.saturating_sub(NAMES)).enumerate() {
                let name = if index == 0 { name } else { "" };
                lines.push(format!("{name:<NAMES$}{part}"));
            }
        };
        if let Some([tuned, configured]) = &self.tuned {
            paragraph("tuned", &format!("{tuned} (configured: {configured})"));
        }
        if let Some(why) = why {
            paragraph("why", &why.text);
            paragraph("to do", why.advice.as_deref().unwrap_or("-"));
        }
        if let Some(error) = &self.record_error {
            paragraph("record", &format!("has ended: {error}"));
        }
        lines
    }

    /// Why the car does not drive: of a car that stands, why it can't be armed now, and not why
    /// the last drive ended.
    fn why(&self) -> Option<Why> {
        let stands = matches!(&*self.mode, "idle" | "ready");
        let preflight = self.preflight.as_ref().filter(|_| stands);
        let word = preflight.or(self.reason.as_ref())?;
        let Some(entry) = Entry::find("host", word) else {
            return Some(Why {
                text: word.to_string(),
                advice: None,
            });
        };
        let mut text = format!("{} ({word})", entry.brief());
        if self.mode == "ready" {
            text.insert_str(0, "the last drive ended, ");
        }
        let mut advice = entry.advice;
        if let Some((cause, stop)) = self
            .stop_cause
            .as_ref()
            .filter(|_| word == "board-failsafe")
            .and_then(|cause| Some((cause, Entry::find("board stop", cause)?)))
        {
            text += &format!(": {} ({cause})", stop.brief());
            advice = stop.advice;
        }
        // The daemon knows better what is wrong with its cameras than the table does.
        let is_about_poses = matches!(&**word, "no-pose" | "pose-too-old" | "pose-implausible");
        if let Some(cameras) = self.cameras.as_ref().filter(|_| is_about_poses) {
            advice = Some(format!("{cameras}."));
        }
        if let Some(neighbour) = self.neighbour.as_ref().filter(|_| is_about_poses) {
            text += &format!("; {neighbour}");
        }
        Some(Why { text, advice })
    }

    fn battery(&self) -> String {
        with_unit(self.battery_v, 2, "V")
    }

    fn place(&self) -> String {
        let Some([x_m, y_m]) = self.position_m else {
            return String::new();
        };
        let yaw = self.yaw_rad.map(f64::to_degrees);
        format!(
            "at ({x_m:.2}, {y_m:.2}) m, yaw {}",
            with_unit(yaw, 0, "degrees")
        )
    }

    /// How far P is from its reference.
    fn error(&self) -> String {
        let (Some([x_m, y_m]), Some([reference_x_m, reference_y_m])) =
            (self.point_m, self.reference_m)
        else {
            return "-".to_owned();
        };
        let error_m = (x_m - reference_x_m).hypot(y_m - reference_y_m);
        format!("{:.0} mm from its reference", error_m * 1_000.0)
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

/// Breaks a text between its words.
fn wrap(text: &str, columns: usize) -> impl Iterator<Item = String> {
    let mut lines = vec![String::new()];
    for word in text.split_whitespace() {
        if let Some(line) = lines.last_mut() {
            let is_first = line.is_empty();
            if is_first || line.chars().count() + 1 + word.chars().count() <= columns {
                if !is_first {
                    line.push(' ');
                }
                line.push_str(word);
                continue;
            }
        }
        lines.push(word.to_owned());
    }
    lines.into_iter()
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};

    use super::*;

    fn of(status: &Value) -> Summary {
        Summary::of(&serde_json::from_value(status.clone()).unwrap())
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
        summary.take_status(&serde_json::from_value(standing()).unwrap());
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
            "ready: the last drive ended, the time that was given with the arm request is over \
             (time-up); pose 8 ms old, battery 7.41 V, link ready, speed 0.00 m/s"
        );
        status["estimate"]["speed_m_s"] = json!(-0.3);
        assert!(of(&status).line().ends_with("speed -0.30 m/s"));
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
