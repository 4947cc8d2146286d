//! Claims on assumptions, and remarks on which the paper spends a sentence.

use super::{
    super::{
        claims::{Claim, Criterion, Scope},
        setup::{GAIN, Setup, TURN_RATE},
    },
    claim::{claim, near},
};

/// Two ways of computing the same agree to this.
const SAME: f64 = 1e-9;

pub(super) fn claims(setup: &Setup) -> Vec<Claim> {
    let mut claims = model();
    claims.extend(law());
    claims.extend(circle(setup));
    claims
}

fn model() -> Vec<Claim> {
    vec![
        claim(
            "similitude",
            1,
            Scope::AnyCar,
            "A scaled car is similar to a real one",
            "\"identical, after accounting for the dimensional scaling of each parameter\": \
             eigenvalues in the ratio of the time scales",
        )
        .agrees("differ by", "assumptions.similitude", near(0.0, SAME))
        .because(
            "both laws, with a car 10 times as long and 850 times as heavy on a time scale √10 \
             times as long; gravity and friction enter only where the tyres slide",
        ),
        claim(
            "small-angles",
            1,
            Scope::PaperCar,
            "Sideslip and steering are small enough for sin x = x and cos x = 1",
            "\"small enough\"; no number: taken as a steering angle on the circle within 5 % of \
             the one with exact geometry",
        )
        .unit("%")
        .agrees("off by", "assumptions.steering.off", near(0.0, 5.0))
        .because(
            "the model steers 0.3286 rad where a car with exact slip angles and cos δ, and the \
             same linear tyres, steers 0.3226 rad",
        ),
    ]
}

fn law() -> Vec<Claim> {
    vec![
        claim(
            "point-anywhere",
            2,
            Scope::AnyCar,
            "P may be at any distance p but zero",
            "\"can be arbitrarily selected, excluding the case p = 0\": velocity of P as wanted",
        )
        .unit("m/s")
        .agrees("off by", "assumptions.any-p", near(0.0, SAME))
        .because(
            "equation 7 makes P an integrator for every p from 0.01 to 5 m; whether the motion \
             is stable is another question",
        ),
        claim(
            "parameter-is-a-distance",
            7,
            Scope::AnyCar,
            "The law's only parameter is the position of the centre of mass",
            "\"apart from the position of the center of mass\": another point gives other commands",
        )
        .unit("m/s, rad/s")
        .agrees(
            "commands differ by",
            "assumptions.measured-point",
            near(0.0, SAME),
        )
        .because(
            "it depends on less: on the distance of the front axle from the point to which pose \
             and sideslip refer. Any point of the axis gives the same commands; the centre of mass \
             need not be known",
        ),
        claim(
            "necessary-and-sufficient",
            4,
            Scope::PaperCar,
            "The stability of ξ decides that of the whole system",
            "\"necessary, but also sufficient\": with the position loop around the law no unstable \
             point where ξ is stable, and no stable one where it is not",
        )
        .agrees(
            "unstable of 147",
            "assumptions.unstable-with-position-loop",
            near(0.0, 0.0),
        )
        .agrees(
            "stable of 47",
            "assumptions.stable-only-with-position-loop",
            near(0.0, 0.0),
        )
        .because(
            "without a position loop the positions do not act on ξ; with one and a wrong l_f they \
             do, and the paper's gain of 1 takes no stability over the meaningful range and gives \
             none at the unstable ones of 147 motions beyond it, down to dl = −5 l_f",
        ),
        claim(
            "direction",
            4,
            Scope::AnyCar,
            "The direction of the motion may be 45° without loss of generality",
            "\"without loss of generality\": the same motion in every direction",
        )
        .agrees("differ by", "assumptions.direction", near(0.0, SAME))
        .because("law and model turn with the world; four directions and four states"),
        claim(
            "point-stability",
            4,
            Scope::Nobody,
            "Stable with P at another distance",
            "analysed with p = 0.35 m only",
        )
        .unit("m")
        .agrees("p for every speed", "point.smallest", near(0.35, 0.01))
        .because(
            "our extension, in closed form: stable over the whole meaningful range at every speed \
             from this p on. With the servo of the simulated car the least p grows with the speed",
        ),
    ]
}

fn circle(setup: &Setup) -> Vec<Claim> {
    let radius = setup.radius_m();
    let distance = radius / (1.0 + (GAIN / TURN_RATE).powi(2)).sqrt();
    vec![
        claim(
            "circle-carpet",
            3,
            Scope::PaperCar,
            "A circle of 1 m is driven on a carpet of 4 m²",
            "\"a four square meter carpet\", \"a radius of 1 m\": taken as a square, P within 2 m",
        )
        .unit("m")
        .agrees(
            "reference",
            "assumptions.reference-diameter",
            near(2.0, SAME),
        )
        .agrees("P", "assumptions.path-diameter", Criterion::Below(2.0))
        .because(
            "P goes round on 0.894 m and leaves 0.1 m; a car that followed the reference itself \
             would touch the edges, and a start outside of the circle is in a corner or off the \
             carpet",
        ),
        claim(
            "circle-satisfactory",
            3,
            Scope::Nobody,
            "The tracking of the circle is satisfactory",
            "\"satisfactory tracking performance even with a proportional position control law\"; \
             no number",
        )
        .unit("m")
        .agrees("ideal", "circle.error.outside.ideal", near(distance, 1e-3))
        .agrees("car", "circle.error.outside.car", near(distance, 0.02))
        .on_the_car()
        .because(
            "P stays 0.447 m from its reference, nearly half of the radius: r/√(1 + (K/ω)²). With \
             the reference's velocity fed forward it is zero",
        ),
    ]
}
