//! Claims on stability and on the two laws, and on the sampled loop, which the paper
//! leaves out.

use singletrack_control::VehicleParameters;

use super::{
    super::{
        claims::{Claim, Criterion, Scope},
        comparison::{DEVIATION_M, WRONG},
        setup::Setup,
        text::{mm, number, with_digits},
    },
    claim::{claim, near},
};

pub(super) fn claims(setup: &Setup) -> Vec<Claim> {
    let mut claims = model();
    claims.extend(proposed(setup));
    claims.extend(eigenvalues());
    claims.extend(appendix(setup));
    claims.extend(comparison(setup));
    claims.extend(sampled());
    claims
}

fn model() -> Vec<Claim> {
    vec![
        claim(
            "model-identified",
            1,
            Scope::PaperCar,
            "C_f, C_r and I_z can be identified from drives",
            "\"identified using the normalised mean prediction error\"; no intervals: taken as \
             within 10 %, C_r within 3 %",
        )
        .unit("%")
        .agrees("C_f off by", "model.error.c_f", near(0.0, 10.0))
        .agrees("C_r off by", "model.error.c_r", near(0.0, 3.0))
        .agrees("I_z off by", "model.error.i_z", near(0.0, 10.0))
        .because(
            "from a minute of the simulated car, which is known; of the real one there are no data",
        ),
        claim(
            "model-valid",
            1,
            Scope::PaperCar,
            "The single-track model reproduces the dynamics of another drive",
            "\"able to correctly reproduce the relevant vehicle dynamics\"; no number: taken as \
             a fit above 80 %",
        )
        .unit("%")
        .agrees("yaw rate", "model.fit.yaw-rate", Criterion::Above(80.0))
        .agrees("sideslip", "model.fit.sideslip", Criterion::Above(80.0))
        .because(
            "the simulated car's tyres saturate at μ = 0.25, and so do those of the model that is \
             fitted here; the paper's are linear",
        ),
        claim(
            "model-nmpe",
            1,
            Scope::Nobody,
            "The normalised mean prediction error is low",
            "0.58, without a unit and without its definition",
        )
        .agrees("validation", "model.nmpe.validation", near(0.58, 0.005))
        .because(
            "not the same number: ours is the mean of |model − measured| over the standard \
             deviation of what was measured, and of a simulated car",
        ),
    ]
}

fn proposed(setup: &Setup) -> Vec<Claim> {
    let VehicleParameters {
        front_axle_distance_m: l_f,
        ..
    } = setup.vehicle;
    vec![
        claim(
            "hopf-negative",
            4,
            Scope::PaperCar,
            "Hopf bifurcations are at negative dl",
            "\"detected at negative values of dl\": below 0",
        )
        .unit("m")
        .agrees("largest", "hopf.front.largest_dl", Criterion::Below(0.0))
        .because("closed form: Hurwitz' determinant is quadratic in dl"),
        claim(
            "hopf-outside",
            4,
            Scope::PaperCar,
            "They are outside the physically meaningful range at all speeds considered",
            format!(
                "\"outside the range [−l_f, l_r] for all considered velocity values\": below {}",
                number(-l_f)
            ),
        )
        .unit("m")
        .agrees("largest", "hopf.front.largest_dl", Criterion::Below(-l_f))
        .agrees("v → ∞", "hopf.front.limit", Criterion::Below(-l_f))
        .because(
            "and so they are at any speed: the paper does not say which it considers, and not \
             that the limit is so near (5.9 mm)",
        ),
        claim(
            "hopf-subcritical",
            4,
            Scope::PaperCar,
            "They are subcritical",
            "\"subcritical Hopf bifurcations\": l₁ above 0",
        )
        .agrees("least l₁", "hopf.front.least_l1", Criterion::Above(0.0))
        .because("exact derivatives; Kuznetsov's normalisation, on which the sign does not depend"),
        claim(
            "structurally-stable",
            4,
            Scope::PaperCar,
            "The steady motion is stable over the whole meaningful range",
            "\"structurally asymptotically stable\": no unstable point",
        )
        .agrees(
            "unstable points",
            "hopf.front.unstable_in_range",
            near(0.0, 0.0),
        )
        .because("Hurwitz' criterion at 201 values of dl and 9 speeds from 0.01 to 1000 m/s"),
    ]
}

fn eigenvalues() -> Vec<Claim> {
    let below = Criterion::Below(0.0);
    let mut negative = claim(
        "eigenvalues-negative",
        5,
        Scope::PaperCar,
        "All four real parts are negative within the meaningful range",
        "\"R(λ_i) < 0 for all i = 1, …, 4\": below 0",
    )
    .unit("1/s");
    for (label, name) in [
        ("λ₁ at most", "eigenvalues.front.1"),
        ("λ₂ at most", "eigenvalues.front.2"),
        ("λ₃ at most", "eigenvalues.front.3"),
        ("λ₄ at most", "eigenvalues.front.4"),
    ] {
        negative = negative.agrees(label, name, below);
    }
    vec![
        negative.because("over the map of speed and dl, sorted by real part"),
        claim(
            "eigenvalues-appendix-count",
            5,
            Scope::AnyCar,
            "The appendix's law has four eigenvalues",
            "\"the four eigenvalues of the dynamics of ξ̃\": 4",
        )
        .differs(
            "eigenvalues",
            "eigenvalues.velocity.count",
            near(4.0, 0.0),
            near(3.0, 0.0),
        )
        .because(
            "ξ̃ is yaw, yaw rate and sideslip: three states, as the law commands the steering angle \
             itself; and the paper shows three maps",
        ),
        claim(
            "eigenvalues-appendix-critical",
            5,
            Scope::PaperCar,
            "Only λ₃ of the appendix's law becomes positive",
            "the caption of its map has a region with R ≥ 0, those of λ₁ and λ₂ have none: 1",
        )
        .differs(
            "with R ≥ 0 in the range",
            "eigenvalues.velocity.unstable",
            near(1.0, 0.0),
            near(2.0, 0.0),
        )
        .because("at a Hopf bifurcation a complex pair crosses the axis: λ₂ goes with λ₃"),
    ]
}

/// The paper's threshold at 0.1 m/s, in mm.
const THRESHOLD_MM: f64 = 0.136;

fn appendix(setup: &Setup) -> Vec<Claim> {
    let VehicleParameters {
        rear_axle_distance_m: l_r,
        front_cornering_stiffness_n_rad: c_f,
        rear_cornering_stiffness_n_rad: c_r,
        ..
    } = setup.vehicle;
    vec![
        claim(
            "appendix-threshold",
            6,
            Scope::PaperCar,
            "At 0.1 m/s the appendix's law is unstable from dl = 0.136 mm on",
            "\"for v = 0.1, the threshold value for dl is equal to 0.136 mm\"",
        )
        .unit("mm")
        .agrees(
            "l_f + dl and l_r − dl",
            "hopf.velocity.threshold_mm",
            near(THRESHOLD_MM, 0.0005),
        )
        .because("exact: with both distances wrong, on a wheelbase that is known"),
        claim(
            "appendix-threshold-front-only",
            6,
            Scope::PaperCar,
            "That is with l_f alone estimated",
            "of the two only an estimate of l_f is spoken of: 0.136 mm",
        )
        .unit("mm")
        .differs(
            "l_f + dl, l_r as it is",
            "hopf.velocity.threshold_front_only_mm",
            near(THRESHOLD_MM, 0.0005),
            // The law uses the distances only in C_r l_r − C_f l_f.
            near(0.135_977_266 * (c_f + c_r) / c_f, 1e-6),
        )
        .because(format!(
            "the law needs C_r l_r − C_f l_f: with l_f alone wrong dl counts (C_f + C_r)/C_f = {} \
             times less",
            with_digits((c_f + c_r) / c_f, 4)
        )),
        claim(
            "appendix-inside",
            6,
            Scope::PaperCar,
            "Its bifurcations are at positive dl, at small speeds inside the meaningful range",
            "\"at positive values of dl\", \"especially for small velocities\" inside: above 0 and \
             inside up to some speed",
        )
        .agrees(
            "least dl, m",
            "hopf.velocity.least_dl",
            Criterion::Above(0.0),
        )
        .agrees(
            "inside up to, m/s",
            "hopf.velocity.leaves_range",
            Criterion::Above(0.1),
        )
        .because(format!("the curve crosses l_r = {} m there", number(l_r))),
        claim(
            "appendix-subcritical",
            6,
            Scope::PaperCar,
            "They are subcritical",
            "\"subcritical Hopf bifurcations\": l₁ above 0",
        )
        .agrees("least l₁", "hopf.velocity.least_l1", Criterion::Above(0.0))
        .because("exact derivatives; it falls by five decades from 0.1 to 8 m/s"),
    ]
}

fn comparison(setup: &Setup) -> Vec<Claim> {
    let deviation = DEVIATION_M * setup.scale();
    let wheelbase = setup.vehicle.wheelbase_m();
    let percent = number(WRONG * 100.0);
    vec![
        claim(
            "compare-standstill",
            7,
            Scope::AnyCar,
            "The appendix's law is singular at standstill, the proposed one is not",
            "\"singular when the vehicle velocity is equal to zero\"; answers (1) or not (0): 1 \
             and 0",
        )
        .agrees("proposed", "compare.standstill.front-point", near(1.0, 0.0))
        .agrees(
            "appendix's",
            "compare.standstill.velocity-point",
            near(0.0, 0.0),
        )
        .because("v = 0 divides the yaw rate in equation 11; equation 8 has no v below a line"),
        claim(
            "compare-right",
            7,
            Scope::AnyCar,
            "With everything right both laws linearise their point exactly",
            "equations 7 and 11: deviation 0",
        )
        .unit("m")
        .agrees(
            "proposed",
            "compare.largest.right.front-point",
            near(0.0, 1e-6),
        )
        .agrees(
            "appendix's",
            "compare.largest.right.velocity-point",
            near(0.0, 1e-6),
        )
        .because("the open-loop steps on the ideal plant"),
        claim(
            "compare-wrong-proposed",
            7,
            Scope::AnyCar,
            format!("The proposed law takes dl = {}", mm(deviation)),
            "robust: at most 2 dl",
        )
        .unit("m")
        .agrees(
            "proposed",
            "compare.largest.deviation.front-point",
            Criterion::Below(2.0 * deviation * (1.0 + 1e-6)),
        )
        .because("2 |dl sin(Δψ/2)|"),
        claim(
            "compare-wrong-appendix",
            7,
            Scope::PaperCar,
            format!("The appendix's law does not take dl = {}", mm(deviation)),
            "\"unsuitable in real cases\"; taken as off by more than a wheelbase on the same steps",
        )
        .unit("m")
        .agrees(
            "appendix's",
            "compare.largest.deviation.velocity-point",
            Criterion::Above(wheelbase),
        )
        .because(
            "at these speeds the motion is unstable with 10 mm: the steering diverges at the first \
             turn, until the speed is zero and the law has no answer",
        ),
        claim(
            "compare-parameters",
            7,
            Scope::AnyCar,
            "The proposed law depends on no parameter but the position of the centre of mass",
            format!(
                "\"does not depend on any model parameter\": deviation 0 on cars with m, C_f or \
                 C_r {percent} % different"
            ),
        )
        .unit("m")
        .agrees(
            "proposed",
            "compare.largest.parameters.front-point",
            near(0.0, 1e-6),
        )
        .because("it uses none of them"),
        claim(
            "compare-parameters-appendix",
            7,
            Scope::PaperCar,
            "The appendix's law does depend on them",
            format!(
                "\"requires an estimate of vehicle parameters\": off with m, C_f or C_r \
                 {percent} % wrong; taken as by more than 10 mm"
            ),
        )
        .unit("m")
        .agrees(
            "appendix's",
            "compare.largest.parameters.velocity-point",
            Criterion::Above(0.01),
        )
        .because("the worst of the six; the motion stays stable, but P is not where it should be"),
        claim(
            "compare-stiffnesses",
            7,
            Scope::PaperCar,
            "Its stability is robust to wrong cornering stiffnesses",
            format!(
                "\"robust with respect to uncertainties on C_f and C_r\": no unstable case with \
                 ±{percent} %"
            ),
        )
        .agrees(
            "unstable of 81",
            "compare.stiffnesses.unstable",
            near(0.0, 0.0),
        )
        .because("nine speeds from 0.1 to 8 m/s, nine combinations, Hurwitz' criterion"),
    ]
}

fn sampled() -> Vec<Claim> {
    vec![
        claim(
            "sampled-stable",
            8,
            Scope::PaperCar,
            "The motion is as stable in ticks of 10 ms, a tick late",
            "the controller has \"a rate of 100 Hz\", the analysis is in continuous time: spectral \
             radius below 1 over the meaningful range",
        )
        .agrees(
            "largest radius",
            "sampled.front.largest_radius",
            Criterion::Below(1.0),
        )
        .because(
            "up to 5 m/s, with a pose at every tick and wheels that follow at once; the paper \
             leaves this out",
        ),
        claim(
            "sampled-servo",
            8,
            Scope::Nobody,
            "The motion is stable with a steering servo",
            "the analysis has none; δ is an input of the model",
        )
        .unit("m/s")
        .agrees("up to", "sampled.servo.first_unstable", near(3.45, 0.01))
        .because(
            "with the servo of the simulated car, 40 ms of lag and 18 ms from tick to wheels, over \
             the whole meaningful range; with the state predicted to the wheels up to 20 m/s at \
             least",
        ),
    ]
}
