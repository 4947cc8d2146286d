//! The steering command as an angle.

use crate::bench::{MAP, imported};

const LOG: &str = "\
t,x,y,yaw,v,s
0.00,0,0,0,1,-2
0.01,0,0,0,1,-0.5
0.02,0,0,0,1,0
0.03,0,0,0,1,0.25
0.04,0,0,0,1,1
0.05,0,0,0,1,2
";

fn angles(steering: &str) -> Vec<f64> {
    let map = MAP.replace("radians_per_unit = 0.5\n", steering);
    let steering = imported(LOG, &map).steering();
    steering.iter().map(|(_, angle)| *angle).collect()
}

#[test]
fn a_linear_map_has_a_gain_and_an_offset() {
    assert_eq!(
        angles("radians_per_unit = -0.4\noffset_rad = 0.1\n"),
        [0.9, 0.3, 0.1, 0.0, -0.3, -0.7]
    );
}

#[test]
fn a_table_is_linear_between_its_pairs_and_constant_beyond() {
    assert_eq!(
        angles("table = [[-1.0, -0.4], [0.0, 0.1], [0.5, 0.2], [1.0, 0.2]]\n"),
        [-0.4, -0.15, 0.1, 0.15, 0.2, 0.2]
    );
}

#[test]
fn a_command_is_in_force_from_its_time_until_the_next_one() {
    assert_eq!(
        angles("radians_per_unit = 1.0\ndelay_s = 0.015\n"),
        [-0.5, 0.0, 0.25, 1.0, 2.0, 2.0]
    );
}

#[test]
fn an_empty_command_is_that_of_the_row_before() {
    let log = "t,x,y,yaw,v,s\n0,0,0,0,1,\n0.01,0,0,0,1,1\n0.02,0,0,0,1,\n";
    assert_eq!(
        imported(log, MAP).steering(),
        [(0.0, 0.0), (10.0, 0.5), (20.0, 0.5)]
    );
}
