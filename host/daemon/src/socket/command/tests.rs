use singletrack_control::{
    Demand, Position, Setpoint, SetpointStamp, SpeedDemand, SteeringDemand, Time, Trajectory,
    TrajectoryPoint, Velocity,
};

use singletrack_api::Code;
use singletrack_core::config::Start;

use super::*;

const NOW: u64 = 1_000;

/// Every line is followed by its answer: `ok`, or the error, with the word of a rejected set-point.
#[test]
fn every_line_is_answered_as_the_golden_file_says() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/golden/requests.txt");
    let golden = std::fs::read_to_string(path).unwrap();
    let mut answered = String::new();
    for line in golden.lines().filter(|line| !line.starts_with("  ")) {
        let answer = match Command::parse(line.as_bytes(), NOW) {
            Ok(_) => "ok".to_owned(),
            Err(ParseError::Rejected(rejected)) => format!("{}: {rejected}", rejected.code),
            Err(ParseError::Text(text)) => text,
        };
        answered += &format!("{line}\n  {answer}\n");
    }
    if std::env::var_os("SINGLETRACK_RENEW").is_some() {
        std::fs::write(path, &answered).unwrap();
    }
    assert!(answered == golden, "{answered}");
}

#[test]
fn valid_lines_are_parsed() {
    let arm = |attendance| Arm {
        attendance,
        hold: None,
        start_ns: None,
        uncalibrated: false,
    };
    let setpoint = |position, time| {
        let velocity = Velocity::new(0.5, -1.0);
        Command::Setpoint(SetpointCommand::Setpoint(Setpoint::point(
            Time(time),
            position,
            velocity,
        )))
    };
    let actuation = |steering, speed, sequence| {
        let stamp = SetpointStamp {
            time: Time(NOW),
            sequence,
        };
        let demand = Demand::Actuation { steering, speed };
        Command::Setpoint(SetpointCommand::Setpoint(Setpoint { stamp, demand }))
    };
    for (line, command) in [
        (r#"{"version":3,"command":"status"}"#, Command::Status),
        (
            r#"{"version":3,"command":"disarm","at_once":true}"#,
            Command::End(PilotRequest::Halt),
        ),
        (
            r#"{"version":3,"command":"disarm","carried":true}"#,
            Command::End(PilotRequest::Carried),
        ),
        (
            r#"{"version":3,"command":"disarm","at_once":false}"#,
            Command::End(PilotRequest::Disarm),
        ),
        (
            r#"{"version":3,"command":"arm","attendance":"hold"}"#,
            Command::Arm(arm(Attendance::Hold)),
        ),
        (
            r#"{"version":3,"command":"arm","attendance":"timed","for_s":1.5}"#,
            Command::Arm(arm(Attendance::Timed(Duration::from_millis(1_500)))),
        ),
        (
            r#"{"version":3,"command":"arm","attendance":"unattended"}"#,
            Command::Arm(arm(Attendance::Unattended)),
        ),
        (
            r#"{"version":3,"command":"arm","attendance":"hold","uncalibrated":true}"#,
            Command::Arm(Arm {
                uncalibrated: true,
                ..arm(Attendance::Hold)
            }),
        ),
        (
            r#"{"version":3,"command":"arm","attendance":"hold","hold_ms":150}"#,
            Command::Arm(Arm {
                hold: Some(Duration::from_millis(150)),
                ..arm(Attendance::Hold)
            }),
        ),
        (
            r#"{"version":3,"command":"arm","attendance":"hold","start_ns":60000001000}"#,
            Command::Arm(Arm {
                start_ns: Some(60_000_001_000),
                ..arm(Attendance::Hold)
            }),
        ),
        (
            r#"{"version":3,"command":"commissioned","procedure":"bring-up","result":"passed"}"#,
            Command::Commissioned {
                uncalibrated: false,
                procedure: Procedure::BringUp,
                result: ProcedureResult::Passed,
            },
        ),
        (
            r#"{"version":3,"command":"arm","attendance":"hold","jog":true}"#,
            Command::ArmJog,
        ),
        (
            r#"{"version":3,"command":"arm","attendance":"hold","jog":false}"#,
            Command::Arm(arm(Attendance::Hold)),
        ),
        (
            r#"{"version":3,"command":"jog","servo_us":1400,"esc_us":65535}"#,
            Command::Jog(Jog {
                servo_us: 1_400,
                esc_us: u16::MAX,
            }),
        ),
        (r#"{"version":3,"command":"reload"}"#, Command::Reload),
        (r#"{"version":3,"command":"hold"}"#, Command::Hold),
        (
            "{\"command\":\"stop\",\"version\":3}\r\n",
            Command::End(PilotRequest::EmergencyStop),
        ),
        (
            r#"{"version":3,"command":"watch","topics":["tick","log"]}"#,
            Command::Watch {
                topics: vec![Topic::Tick, Topic::Log],
            },
        ),
        (
            r#"{"version":3,"command":"set-reference","reference":
                {"kind":"circle","radius_m":1,"angular_velocity_rad_s":0.5}}"#,
            Command::SetReference(ReferenceSection::Circle {
                radius_m: 1.0,
                angular_velocity_rad_s: 0.5,
                centre_m: [0.0, 0.0],
                start: Start::Nearest,
            }),
        ),
        (
            r#"{"version":3,"command":"setpoint","velocity_m_s":[0.5,-1]}"#,
            setpoint(None, NOW),
        ),
        (
            r#"{"version":3,"command":"setpoint","velocity_m_s":[0.5,-1],
                "position_m":[2,3],"time_ns":400}"#,
            setpoint(Some(Position::new(2.0, 3.0)), 400),
        ),
        (
            r#"{"version":3,"command":"setpoint","steering_rad":0.1,"speed_m_s":-0.5,
                "sequence":7}"#,
            actuation(
                SteeringDemand::Angle(0.1),
                SpeedDemand::Speed(-0.5),
                Some(7),
            ),
        ),
        (
            r#"{"version":3,"command":"setpoint","steering_rad":0.1,"steering_rate_rad_s":2,
                "rear_speed_m_s":0.5}"#,
            actuation(
                SteeringDemand::AngleWithin {
                    angle: 0.1,
                    rate: 2.0,
                },
                SpeedDemand::RearSpeed(0.5),
                None,
            ),
        ),
        (
            r#"{"version":3,"command":"setpoint","steering_rate_rad_s":-0.2,
                "acceleration_m_s2":0.3}"#,
            actuation(
                SteeringDemand::Rate(-0.2),
                SpeedDemand::Acceleration(0.3),
                None,
            ),
        ),
        (
            r#"{"version":3,"command":"setpoint","trajectory":[
                {"time_ns":900,"position_m":[1,2],"velocity_m_s":[0,0]},
                {"time_ns":1001,"position_m":[1,2.000001],"velocity_m_s":[3,4]}]}"#,
            Command::Setpoint(SetpointCommand::Trajectory(Box::new(Trajectory {
                stamp: SetpointStamp {
                    time: Time(NOW),
                    sequence: None,
                },
                points: [(900, 2.0, [0.0, 0.0]), (1_001, 2.000_001, [3.0, 4.0])]
                    .into_iter()
                    .map(|(time, y, [v_x, v_y])| TrajectoryPoint {
                        time: Time(time),
                        position: Position::new(1.0, y),
                        velocity: Velocity::new(v_x, v_y),
                    })
                    .collect(),
            }))),
        ),
        (
            r#"{"version":3,"command":"watch","topics":["state"]}"#,
            Command::WatchState,
        ),
    ] {
        assert_eq!(Command::parse(line.as_bytes(), NOW), Ok(command), "{line}");
    }
}

#[test]
fn a_set_point_with_a_mistake_is_rejected_with_a_word() {
    use Code::{Future, Invalid, NotFinite, Old, OutOfRange};
    let points = |times: &[u64]| {
        let point =
            |time| format!(r#"{{"time_ns":{time},"position_m":[0,0],"velocity_m_s":[0,0]}}"#);
        let points: Vec<_> = times.iter().map(point).collect();
        format!(r#""trajectory":[{}]"#, points.join(","))
    };
    let many: Vec<u64> = (1_000..1_101).collect();
    for (keys, why) in [
        ("", Invalid),
        (r#""position_m":[0,0]"#, Invalid),
        (r#""velocity_m_s":[0]"#, Invalid),
        (r#""velocity_m_s":[0,0],"speed_m_s":1"#, Invalid),
        (r#""velocity_m_s":[0,0],"to":1"#, Invalid),
        (r#""steering_rad":0.1"#, Invalid),
        (r#""speed_m_s":0.1"#, Invalid),
        (
            r#""steering_rad":0.1,"rear_speed_m_s":1,"speed_m_s":1"#,
            Invalid,
        ),
        (
            r#""steering_rad":0.1,"acceleration_m_s2":0.1,"speed_m_s":1"#,
            Invalid,
        ),
        (r#""velocity_m_s":[0,0],"sequence":-1"#, Invalid),
        (r#""velocity_m_s":[0,0],"sequence":4294967296"#, Invalid),
        (r#""velocity_m_s":[NaN,0]"#, NotFinite),
        (r#""velocity_m_s":[0,-Infinity]"#, NotFinite),
        (r#""velocity_m_s":[0,null]"#, NotFinite),
        (r#""velocity_m_s":[0,1e999]"#, NotFinite),
        (r#""velocity_m_s":[0,100.1]"#, OutOfRange),
        (r#""velocity_m_s":[0,0],"position_m":[1e5,0]"#, OutOfRange),
        (r#""steering_rad":1.6,"speed_m_s":1"#, OutOfRange),
        (r#""steering_rad":0,"speed_m_s":-101"#, OutOfRange),
        (
            r#""steering_rate_rad_s":101,"rear_speed_m_s":1"#,
            OutOfRange,
        ),
        (r#""steering_rad":0,"acceleration_m_s2":101"#, OutOfRange),
        (
            r#""steering_rad":0,"acceleration_m_s2":1,"time_ns":1001"#,
            Future,
        ),
        (&points(&[1_000]), OutOfRange),
        (&points(&[1_000, 1_000]), OutOfRange),
        (&points(&many), OutOfRange),
        (&points(&[2_000_000_000, 3_000_000_000]), Future),
        (&points(&[998, 999]), Old),
    ] {
        let comma = if keys.is_empty() { "" } else { "," };
        let line = format!(r#"{{"version":3,"command":"setpoint"{comma}{keys}}}"#);
        let error = Command::parse(line.as_bytes(), NOW).unwrap_err();
        let is_why = matches!(&error, ParseError::Rejected(rejected) if rejected.code == why);
        assert!(is_why, "{line}: {error}");
    }
    let error = Command::parse(b"{\"version\":3,\"command\":NaN}", NOW).unwrap_err();
    assert!(matches!(error, ParseError::Text(_)));
}
