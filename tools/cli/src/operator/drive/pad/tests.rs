//! Buttons, sticks, and the loss of a pad.

use super::*;

const fn at(ms: u64) -> Time {
    Time(ms * 1_000_000)
}

const fn button(code: u16, pressed: bool) -> PadEvent {
    PadEvent::Button { code, pressed }
}

const fn axis(code: u16, value: f64) -> PadEvent {
    PadEvent::Axis { code, value }
}

/// A pad with its buttons released and its sticks centred.
fn ready() -> Pad {
    let mut pad = Pad::new(0.5, Duration::from_secs(5), at(0));
    for event in [
        button(BTN_TR, false),
        button(BTN_TL, false),
        axis(ABS_Y, 0.0),
        axis(ABS_RX, 0.0),
    ] {
        assert_eq!(pad.handle(at(0), event), None);
    }
    pad
}

fn polled(pad: &mut Pad, now: Time) -> Vec<PadRequest> {
    std::iter::from_fn(|| pad.poll(now)).collect()
}

#[test]
fn a_held_button_lets_the_car_drive_and_its_release_ends_the_drive() {
    let mut pad = ready();
    assert_eq!(polled(&mut pad, at(10)), []);
    pad.handle(at(20), button(BTN_TR, true));
    assert_eq!(polled(&mut pad, at(20)), [PadRequest::Begin(Driver::Pilot)]);
    assert_eq!(polled(&mut pad, at(60)), []);
    assert_eq!(polled(&mut pad, at(70)), [PadRequest::Hold]);
    assert_eq!(
        pad.handle(at(80), button(BTN_TR, false)),
        Some(PadRequest::End)
    );
    assert_eq!(polled(&mut pad, at(200)), []);
    // And again.
    pad.handle(at(210), button(BTN_TR, true));
    assert_eq!(
        polled(&mut pad, at(210)),
        [PadRequest::Begin(Driver::Pilot)]
    );
}

#[test]
fn a_button_that_is_pressed_from_the_beginning_must_be_released_once() {
    for code in [BTN_TR, BTN_TL] {
        let mut pad = Pad::new(0.5, Duration::from_secs(5), at(0));
        for event in [axis(ABS_Y, 0.0), axis(ABS_RX, 0.0), button(code, true)] {
            pad.handle(at(0), event);
        }
        assert_eq!(polled(&mut pad, at(10)), [PadRequest::Note(RELEASE_FIRST)]);
        // Said once.
        assert_eq!(polled(&mut pad, at(10_000)), []);
        pad.handle(at(20), button(code, false));
        assert_eq!(polled(&mut pad, at(20)), []);
        pad.handle(at(30), button(code, true));
        assert!(matches!(
            polled(&mut pad, at(30))[..],
            [PadRequest::Begin(_)]
        ));
    }
}

#[test]
fn after_a_drive_that_ended_by_itself_the_button_must_be_released() {
    let mut pad = ready();
    pad.handle(at(10), button(BTN_TR, true));
    polled(&mut pad, at(10));
    pad.ended();
    assert_eq!(polled(&mut pad, at(20)), [PadRequest::Note(RELEASE_FIRST)]);
    pad.handle(at(30), button(BTN_TR, false));
    pad.handle(at(40), button(BTN_TR, true));
    assert_eq!(polled(&mut pad, at(40)), [PadRequest::Begin(Driver::Pilot)]);
}

#[test]
fn a_lost_pad_halts_the_car_and_starts_nothing_any_more() {
    let mut pad = ready();
    pad.handle(at(10), button(BTN_TR, true));
    polled(&mut pad, at(10));
    assert_eq!(pad.handle(at(20), PadEvent::Lost), Some(PadRequest::Halt));
    assert!(pad.is_lost);
    pad.handle(at(30), button(BTN_TR, false));
    pad.handle(at(40), button(BTN_TR, true));
    assert_eq!(polled(&mut pad, at(50)), []);
    // Without a drive there is nothing to halt.
    assert_eq!(ready().handle(at(20), PadEvent::Lost), None);
}

#[test]
fn a_silent_pad_halts_the_car_and_any_event_keeps_it_going() {
    let mut pad = ready();
    pad.handle(at(0), button(BTN_TR, true));
    polled(&mut pad, at(0));
    assert_eq!(polled(&mut pad, at(4_900)), [PadRequest::Hold]);
    pad.handle(at(4_900), PadEvent::Other);
    assert_eq!(polled(&mut pad, at(9_900)), [PadRequest::Hold]);
    assert_eq!(
        polled(&mut pad, at(9_901)),
        [PadRequest::Halt, PadRequest::Note(SILENT)]
    );
    assert_eq!(pad.driver(), None);
    // The button is still pressed, and was not released.
    assert_eq!(polled(&mut pad, at(9_910)), []);
    pad.handle(at(9_920), PadEvent::Other);
    assert_eq!(polled(&mut pad, at(9_920)), []);
}

#[test]
fn lost_events_halt_the_car_and_every_button_must_be_seen_released() {
    let mut pad = ready();
    pad.handle(at(0), button(BTN_TR, true));
    polled(&mut pad, at(0));
    assert_eq!(
        pad.handle(at(10), PadEvent::Dropped),
        Some(PadRequest::Halt)
    );
    pad.handle(at(20), button(BTN_TR, true));
    assert_eq!(polled(&mut pad, at(20)), [PadRequest::Note(RELEASE_FIRST)]);
}

#[test]
fn sticks_steer_from_their_centre_within_their_bounds() {
    let mut pad = ready();
    pad.handle(at(0), axis(ABS_Y, -0.5));
    pad.handle(at(10), button(BTN_TL, true));
    assert_eq!(polled(&mut pad, at(10)), [PadRequest::Note(CENTRE_STICKS)]);
    pad.handle(at(20), axis(ABS_Y, -0.1));
    assert_eq!(
        polled(&mut pad, at(20)),
        [PadRequest::Begin(Driver::Sticks)]
    );
    let mut velocity = |y: f64, x: f64, ms: u64| {
        pad.handle(at(ms), axis(ABS_Y, y));
        pad.handle(at(ms), axis(ABS_RX, x));
        polled(&mut pad, at(ms))
            .into_iter()
            .find_map(|request| match request {
                PadRequest::Velocity { speed, turn } => Some((speed, turn)),
                _ => None,
            })
            .unwrap()
    };
    assert_eq!(velocity(-0.1, 0.1, 50), (0.0, 0.0));
    assert_eq!(velocity(-1.0, 0.0, 80), (0.5, 0.0));
    // Left is negative on the stick and positive for the car.
    assert_eq!(velocity(-1.0, -1.0, 110), (0.5, 0.4));
    assert_eq!(velocity(-7.0, 9.0, 140), (0.5, -0.4));
    // Never backward.
    assert_eq!(velocity(1.0, 0.0, 170).0, 0.0);
    // A stick that gives no number stops.
    assert_eq!(velocity(f64::NAN, 1.0, 200), (0.0, 0.0));
}

/// The events of a recording, with their times.
fn recorded() -> Vec<(Time, PadEvent)> {
    include_str!("../../../../tests/recorded/pad.txt")
        .lines()
        .filter(|line| !line.starts_with('#'))
        .map(|line| {
            let fields: Vec<&str> = line.split(' ').collect();
            let seconds: f64 = fields[0].parse().unwrap();
            let hex = |text| u16::from_str_radix(text, 16).unwrap();
            let (kind, code) = (hex(fields[1]), hex(fields[2]));
            let value: i32 = fields[3].parse().unwrap();
            let event = match kind {
                1 => button(code, value != 0),
                3 => axis(code, f64::from(value) / 32_768.0),
                _ => PadEvent::Other,
            };
            (Time((seconds * 1e9) as u64), event)
        })
        .collect()
}

#[test]
fn a_recorded_session_begins_two_drives_and_ends_with_the_loss_of_the_pad() {
    let mut pad = Pad::new(0.5, Duration::from_secs(5), at(0));
    let mut asked = Vec::new();
    let events = recorded();
    let mut fastest: f64 = 0.0;
    let (mut now, mut holds) = (at(0), 0);
    for (time, event) in events {
        while now < time {
            for request in polled(&mut pad, now) {
                match request {
                    PadRequest::Hold => holds += 1,
                    PadRequest::Velocity { speed, turn } => {
                        assert!((0.0..=0.5).contains(&speed) && turn.abs() <= 0.4);
                        fastest = fastest.max(speed);
                    }
                    other => asked.push(other),
                }
            }
            now = Time(now.0 + 5_000_000);
        }
        asked.extend(pad.handle(time, event));
    }
    asked.extend(pad.handle(now, PadEvent::Lost));
    assert_eq!(
        asked,
        [
            // It was pressed from the beginning.
            PadRequest::Note(RELEASE_FIRST),
            PadRequest::Begin(Driver::Pilot),
            PadRequest::End,
            PadRequest::Begin(Driver::Sticks),
            PadRequest::Halt,
        ]
    );
    assert!((30..60).contains(&holds), "{holds}");
    assert!(fastest > 0.49, "{fastest}");
}

#[test]
fn both_buttons_start_nothing_and_end_a_drive() {
    let mut pad = ready();
    pad.handle(at(0), button(BTN_TL, true));
    pad.handle(at(0), button(BTN_TR, true));
    assert_eq!(polled(&mut pad, at(0)), [PadRequest::Note(ONE_BUTTON)]);
    let mut pad = ready();
    pad.handle(at(0), button(BTN_TL, true));
    polled(&mut pad, at(0));
    assert_eq!(
        pad.handle(at(10), button(BTN_TR, true)),
        Some(PadRequest::End)
    );
    pad.handle(at(20), button(BTN_TL, false));
    // The other one was not released since.
    assert_eq!(polled(&mut pad, at(20)), [PadRequest::Note(RELEASE_FIRST)]);
}

#[test]
fn the_stop_button_stops_with_and_without_a_drive() {
    for begun in [false, true] {
        let mut pad = ready();
        if begun {
            pad.handle(at(0), button(BTN_TR, true));
            polled(&mut pad, at(0));
        }
        assert_eq!(
            pad.handle(at(10), button(BTN_EAST, true)),
            Some(PadRequest::Stop)
        );
        assert_eq!(pad.handle(at(20), button(BTN_EAST, false)), None);
        assert!(!polled(&mut pad, at(30)).contains(&PadRequest::Begin(Driver::Pilot)));
    }
}
