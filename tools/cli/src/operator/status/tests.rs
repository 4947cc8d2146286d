//! The status in words.

use serde_json::{Value, json};

use super::*;

fn of(status: &Value) -> Summary {
    Summary(serde_json::from_value(status.clone()).unwrap())
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
    summary.0.state = serde_json::from_value(state).unwrap();
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
