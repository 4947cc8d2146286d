//! The streaming id of the body's name.

use singletrack_mocap::{
    Binding,
    codec::{FrameFlags, RigidBody},
    planar::PoseState,
};

use crate::world::{CAR, Frame, MS, S, UNICAST, World, car_at, config};

#[test]
fn a_missing_name_is_a_state_until_the_name_appears() {
    let mut world = World::new(config(UNICAST));
    world.server.models = vec![("other", 3), ("Car", CAR)];
    world.run(20 * MS);
    assert_eq!(world.session.binding(), Binding::Missing);
    assert_eq!(world.session.names().to_string(), r#""other", "Car""#);
    assert_eq!(
        world.next_state(&Frame::at_rest(1)),
        PoseState::Unbound(Binding::Missing)
    );
    assert_eq!(world.session.counters().unbound, 1);
    world.server.models.push(("car", 12));
    world.run(600 * MS);
    assert_eq!(world.session.binding(), Binding::Bound { id: 12 });
}

#[test]
fn a_name_of_two_bodies_is_ambiguous() {
    let mut world = World::new(config(UNICAST));
    world.server.models = vec![("car", 1), ("other", 3), ("car", CAR)];
    world.run(20 * MS);
    let ambiguous = Binding::Ambiguous { count: 2 };
    assert_eq!(world.session.binding(), ambiguous);
    assert!(world.bindings.contains(&ambiguous));
    assert_eq!(
        world.next_state(&Frame::at_rest(1)),
        PoseState::Unbound(ambiguous)
    );
}

/// Another body has the car's former id.
fn after_swap(number: i32) -> Frame {
    let mut other = car_at(0.02, 0.0);
    other.id = CAR;
    let mut car = car_at(0.0, 0.0);
    car.id = 8;
    Frame::new(number, &[other, car])
}

#[test]
fn ids_that_change_with_the_flag_never_yield_another_bodys_pose() {
    let mut world = World::connected(config(UNICAST));
    world.next_state(&Frame::at_rest(1));
    world.server.models = vec![("other", CAR), ("car", 8)];
    let mut changed = after_swap(2);
    changed.flags = FrameFlags::MODELS_CHANGED;
    assert_eq!(
        world.next_state(&changed),
        PoseState::Unbound(Binding::Unresolved)
    );
    // The flag may stay set: the definitions are read once at once, then slowly.
    for number in 3..20 {
        let mut frame = after_swap(number);
        frame.flags = FrameFlags::MODELS_CHANGED;
        let state = world.next_state(&frame);
        let PoseState::Valid(pose) = state else {
            panic!("{state:?}");
        };
        assert!(pose.x_m.abs() < 1e-9, "the other body's pose");
    }
}

#[test]
fn ids_that_change_without_the_flag_are_noticed_by_polling() {
    let mut world = World::connected(config(UNICAST));
    world.server.models = vec![("other", CAR), ("car", 8)];
    for number in 0..600 {
        world.next_state(&after_swap(number));
    }
    assert_eq!(world.session.binding(), Binding::Bound { id: 8 });
}

#[test]
fn lost_definitions_are_soon_requested_again() {
    let mut world = World::connected(config(UNICAST));
    world.server.answers = false;
    let mut changed = Frame::at_rest(1);
    changed.flags = FrameFlags::MODELS_CHANGED;
    world.next_state(&changed);
    world.run(50 * MS);
    world.server.answers = true;
    world.run(110 * MS);
    assert_eq!(world.session.binding(), Binding::Bound { id: CAR });
}

#[test]
fn a_damaged_definition_is_counted_and_leaves_the_binding() {
    let mut world = World::connected(config(UNICAST));
    world.receive(&[5, 0, 4, 0, 1, 0, 0, 0]);
    assert_eq!(world.session.counters().session.malformed, 1);
    assert_eq!(world.session.binding(), Binding::Bound { id: CAR });
    world.run(S);
    let body = RigidBody::tracked(CAR, [0.0; 3], [0.0, 0.0, 0.0, 1.0]);
    assert!(matches!(
        world.next_state(&Frame::new(1, &[body])),
        PoseState::Valid(_)
    ));
}

#[test]
fn of_many_names_the_first_are_listed_and_the_others_counted() {
    let mut world = World::new(config(UNICAST));
    assert!(world.session.names().is_empty());
    world.server.models = vec![("a\u{1b}[2J", 1); 1];
    world
        .server
        .models
        .extend([("twenty-five-bytes-of-name", 2); 20]);
    world.run(20 * MS);
    let names = world.session.names().to_string();
    // What a terminal would obey is escaped.
    assert!(
        names.starts_with(r#""a\u{1b}[2J", "twenty-five"#),
        "{names}"
    );
    assert!(names.ends_with("\" and 13 more"), "{names}");
    let names = world.session.names();
    assert_eq!(names.name(1), Some(r#""a\u{1b}[2J""#));
    assert_eq!(names.name(2), Some(r#""twenty-five-bytes-of-name""#));
    assert_eq!(names.name(3), None);
}
