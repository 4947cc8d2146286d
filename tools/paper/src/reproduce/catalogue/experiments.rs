//! Claims on the experiments.

use super::{
    super::{
        claims::{Claim, Criterion, Scope},
        setup::{GAIN, Setup, TURN_RATE},
        text::{metres, with_digits},
    },
    claim::{claim, near},
};

/// Two integrators agree with each other to this, in m and rad.
const EXACT: f64 = 1e-6;

pub(super) fn steps(setup: &Setup) -> Vec<Claim> {
    let wheelbase = setup.vehicle.wheelbase_m();
    let rear = setup.rear_deviation_m();
    // The limit of "very close".
    let close = Criterion::Below(wheelbase);
    vec![
        claim(
            "steps-integrators",
            2,
            Scope::AnyCar,
            "With the right l_f the law makes of P two independent integrators",
            "\"behaves as predicted by the theory, i.e., as two independent integrators\": \
             deviation 0",
        )
        .unit("m")
        .agrees("ideal", "steps.largest.right.ideal", near(0.0, EXACT))
        .because("equations 4 to 7; the deviation left is the integrator's"),
        claim(
            "steps-close",
            2,
            Scope::PaperCar,
            "Without position control P stays very close to its nominal path",
            "\"very close to the nominal one\"; no number: taken as within a wheelbase",
        )
        .unit("m")
        .agrees("ideal, dl = 0", "steps.largest.right.ideal", close)
        .agrees("ideal, dl = l_r", "steps.largest.rear.ideal", close)
        .because(format!(
            "the wheelbase is {}; the largest deviation is 2 dl",
            metres(wheelbase)
        )),
        claim(
            "steps-close-car",
            2,
            Scope::PaperCar,
            "So it does on the car, in spite of non-idealities and marker losses",
            "\"very close to the nominal one\", \"robust to this disturbance as well\"; no \
             number: taken as within a wheelbase",
        )
        .unit("m")
        .agrees("dl = 0", "steps.largest.right.car", close)
        .agrees("dl = l_r", "steps.largest.rear.car", close)
        .because(
            "most of it arises in the first second: the nominal P moves at once, the simulated \
             car has to start; there are no data of the real one to compare with",
        ),
        claim(
            "steps-losses",
            2,
            Scope::PaperCar,
            "Holding the last pose while the markers are lost does little harm",
            "\"robust to this disturbance as well\"; no number: taken as below 0.1 m",
        )
        .unit("m")
        .agrees("car", "steps.due_to_losses.car", Criterion::Below(0.1))
        .because("four losses of 200 ms against the same drive without them"),
        claim(
            "steps-uncertain-integrators",
            2,
            Scope::AnyCar,
            format!("They stay integrators with dl = {}", metres(rear)),
            "\"as two independent integrators, even in the presence of uncertainty\": deviation 0",
        )
        .unit("m")
        .differs(
            "ideal",
            "steps.largest.rear.ideal",
            near(0.0, EXACT),
            near(2.0 * rear, 1e-3 * rear),
        )
        .because(format!(
            "the law linearises the P it believes in; the true one deviates by \
             2 |dl sin(Δψ/2)|: {} over a turn of 180°",
            metres(2.0 * rear)
        )),
        claim(
            "steps-deviation-law",
            2,
            Scope::AnyCar,
            "With a wrong l_f P's velocity is off by dl r, across the car",
            "equation 9, which integrates to a deviation of 2 |dl sin(Δψ/2)|",
        )
        .unit("m")
        .agrees(
            "residual, ideal",
            "steps.residual.rear.ideal",
            near(0.0, EXACT),
        )
        .because("the deviation measured, less the one of theory, at most"),
        claim(
            "steps-caption",
            2,
            Scope::PaperCar,
            "The second test has dl = 0.132 m",
            "0.132 m in the captions, 0.1232 m in the text",
        )
        .unit("m")
        .differs(
            "l_r",
            "vehicle.l_r",
            near(0.132, 0.0005),
            near(0.1232, 1e-9),
        )
        .because(
            "\"as if the center of mass were located at the rear wheel contact point\" is \
             dl = l_r = 0.1232 m; 0.132 m would be behind the rear axle, outside the range",
        ),
        claim(
            "singularity",
            2,
            Scope::AnyCar,
            "The singularity β − δ = 90° is out of reach",
            "\"never satisfied\" for sideslip up to ±40° and steering up to ±50°",
        )
        .differs(
            "cos(β − δ) at 40°, −50°",
            "law.cosine_at_corner",
            Criterion::Above(0.1),
            near(0.0, 1e-15),
        )
        .because(
            "the corner of the stated ranges is 40° + 50° = 90°, where the law refuses to answer; \
             with steering up to 26°, as the car has, it is out of reach",
        ),
    ]
}

pub(super) fn circle(setup: &Setup) -> Vec<Claim> {
    let radius = setup.radius_m();
    let gain = 1.0 / (1.0 + (TURN_RATE / GAIN).powi(2)).sqrt();
    let amplitude = gain * radius;
    let lag = (TURN_RATE / GAIN).atan();
    vec![
        claim(
            "circle-converges",
            3,
            Scope::AnyCar,
            "P converges to the path, wherever it starts",
            "\"guarantees the convergence to the desired trajectory even in this situation\": \
             all starts end alike",
        )
        .unit("m, rad")
        .agrees("apart, ideal", "circle.spread.ideal", near(0.0, 1e-4))
        .agrees("apart, car", "circle.spread.car", near(0.0, 0.01))
        .on_the_car()
        .because(
            "amplitude and lag of the last turn, from four starts; to a path of its own: see below",
        ),
        claim(
            "circle-amplitude",
            3,
            Scope::AnyCar,
            "Reference and actual position have the same amplitude",
            format!("\"sinusoids with the same amplitude\": {}", metres(radius)),
        )
        .unit("m")
        .differs(
            "ideal",
            "circle.amplitude.outside.ideal",
            near(radius, 0.01 * radius),
            near(amplitude, 1e-5 * radius),
        )
        .differs(
            "car",
            "circle.amplitude.outside.car",
            near(radius, 0.01 * radius),
            near(amplitude, 0.02 * radius),
        )
        .on_the_car()
        .because(format!(
            "two integrators under unit gain are a low-pass: 1/√(1 + 0.5²) = {} of the \
             reference's amplitude",
            with_digits(gain, 6)
        )),
        claim(
            "circle-lag",
            3,
            Scope::AnyCar,
            "The delay comes from the start outside the path",
            "\"as the vehicle starts outside the desired path\": a start on the path would have \
             none",
        )
        .unit("rad")
        .differs(
            "on the path, ideal",
            "circle.lag.on-the-path.ideal",
            near(0.0, 0.01),
            near(lag, 1e-5),
        )
        .differs(
            "on the path, car",
            "circle.lag.on-the-path.car",
            near(0.0, 0.01),
            near(lag, 0.02),
        )
        .on_the_car()
        .because(format!(
            "it is the steady state of proportional control, atan(0.5) = {} rad, from every \
             start, also from one on the path",
            with_digits(lag, 6)
        )),
        claim(
            "circle-linear-tools",
            3,
            Scope::AnyCar,
            "Any tool of linear control can be put around the law",
            "\"any linear system tool can be applied\": with the reference's velocity fed forward \
             two integrators follow without error",
        )
        .unit("m")
        .agrees(
            "error, ideal",
            "circle.feed-forward.error.ideal",
            near(0.0, 1e-4 * radius),
        )
        .agrees(
            "error, car",
            "circle.feed-forward.error.car",
            near(0.0, 0.02),
        )
        .on_the_car()
        .because(
            "amplitude and delay are then those of the reference; on the car noise, lags and \
             delays are left",
        ),
    ]
}
