//! `report.html`: one self-contained file.

use singletrack_control::VehicleParameters;
use singletrack_figures::{figure::escaped, template};

use super::{
    Plate, Reproduction, Section,
    claims::{Claim, Verdict},
    table,
    text::number,
};

/// The report of a reproduction.
pub(super) fn report(reproduction: &Reproduction) -> String {
    let sections = &reproduction.sections;
    let parts = [
        ("style", singletrack_figures::plot::STYLE.to_owned()),
        ("own_style", include_str!("report/style.css").to_owned()),
        ("subtitle", escaped(&subtitle(reproduction))),
        ("counts", escaped(&table::counts(&reproduction.claims))),
        ("contents", sections.iter().map(entry).collect()),
        ("claims", reproduction.claims.iter().map(row).collect()),
        (
            "sections",
            sections
                .iter()
                .map(|section| body(section, &reproduction.claims))
                .collect(),
        ),
        ("vehicle", vehicle(reproduction)),
    ];
    template::fill(include_str!("report/page.html"), &parts)
}

fn subtitle(reproduction: &Reproduction) -> String {
    let setup = &reproduction.setup;
    let mut text = format!(
        "Every experiment and analysis in virtual time, with {}: on the ideal plant (the paper's \
         equations, controlled continuously) and on the car (the whole pilot against the \
         simulated car, board and cameras, with lags, delays and noise). No data of the real car \
         are known here: where the car differs from the paper's figures, it is the simulated car \
         that does.",
        setup.name
    );
    if !setup.is_paper() {
        text += &format!(
            " This is not the paper's car: its experiments are driven {} times as large, and the \
             paper's numbers can't be compared.",
            number(setup.scale())
        );
    }
    if !setup.fits_simulated_car() {
        text += " It is another kind of car than the simulated one, which is not driven.";
    }
    if setup.quick {
        text += " A quick run: coarser maps, shorter drives, fewer seeds.";
    }
    text
}

fn entry(section: &Section) -> String {
    format!(
        "<li value=\"{0}\"><a href=\"#section-{0}\">{1}</a></li>\n",
        section.number,
        escaped(section.title)
    )
}

/// The class of a verdict in the style sheet.
const fn class(claim: &Claim) -> &'static str {
    match (claim.verdict, &claim.surprise) {
        (_, Some(_)) => "surprise",
        (Verdict::Agrees, None) => "agrees",
        (Verdict::Differs, None) => "differs",
        (Verdict::NotComparable | Verdict::NotMeasured, None) => "none",
    }
}

/// A text for the page, with subscripts where it has underscores: `l_f`.
fn typeset(text: &str) -> String {
    let text = escaped(text);
    let mut html = String::with_capacity(text.len());
    let mut letters = text.chars().peekable();
    while let Some(letter) = letters.next() {
        match (letter, letters.peek()) {
            ('_', Some(below)) if below.is_ascii_lowercase() => {
                html += &format!("<sub>{below}</sub>");
                letters.next();
            }
            _ => html.push(letter),
        }
    }
    html
}

fn row(claim: &Claim) -> String {
    let class = class(claim);
    let surprise = claim
        .surprise
        .as_ref()
        .map_or_else(String::new, |surprise| {
            format!("<strong>Unexpected: {}.</strong> ", escaped(surprise))
        });
    let measured: Vec<String> = table::measured(claim)
        .iter()
        .map(|line| typeset(line))
        .collect();
    format!(
        "<tr id=\"{}\" class=\"{class}\"><td><a href=\"#section-{}\">{}</a></td><td>{}</td>\
         <td>{}</td><td>{}</td><td><span class=\"verdict\">{}</span></td><td>{surprise}{}</td></tr>\n",
        claim.id,
        claim.section,
        claim.section,
        typeset(&claim.claim),
        typeset(&claim.paper),
        measured.join("<br>"),
        claim.verdict.name(),
        typeset(&claim.why)
    )
}

fn body(section: &Section, claims: &[Claim]) -> String {
    let mut html = format!(
        "<section id=\"section-{}\">\n<h2>{}. {}</h2>\n",
        section.number,
        section.number,
        escaped(section.title)
    );
    html += &format!("<p>{}</p>\n", section.intro);
    for note in &section.notes {
        html += &format!("<p class=\"note\">{}</p>\n", escaped(note));
    }
    let own: Vec<String> = claims
        .iter()
        .filter(|claim| claim.section == section.number)
        .map(|claim| {
            format!(
                "<li class=\"{}\"><a href=\"#{}\">{}</a>: <span class=\"verdict\">{}</span></li>",
                class(claim),
                claim.id,
                typeset(&claim.claim),
                claim.verdict.name()
            )
        })
        .collect();
    if !own.is_empty() {
        html += &format!("<ul class=\"own\">{}</ul>\n", own.concat());
    }
    for plate in &section.plates {
        html += &framed(plate);
    }
    if !section.tables.is_empty() {
        let names: Vec<String> = section
            .tables
            .iter()
            .map(|(name, _)| format!("<a href=\"data/{name}.csv\">{name}.csv</a>"))
            .collect();
        html += &format!("<p class=\"quiet\">Data: {}.</p>\n", names.join(", "));
    }
    html + "</section>\n"
}

fn framed(plate: &Plate) -> String {
    if plate.pictures.is_empty() {
        return format!(
            "<h3>{}</h3>\n<p><b>The paper.</b> {}</p>\n<p><b>Ours.</b> {}</p>\n",
            plate.title, plate.paper, plate.ours
        );
    }
    let mut html = format!(
        "<figure class=\"plate\">\n<h3>{}</h3>\n<div class=\"pictures{}\">\n",
        plate.title,
        if plate.pictures.len() == 3 {
            " three"
        } else {
            ""
        }
    );
    for picture in &plate.pictures {
        let (width, svg) = (picture.figure.width, picture.figure.to_svg());
        html += &format!("<div class=\"{width} static\">{svg}");
        if !picture.label.is_empty() {
            html += &format!("<p class=\"which\">{}</p>", escaped(&picture.label));
        }
        html += "</div>\n";
    }
    html += &format!(
        "</div>\n<figcaption><p><b>The paper.</b> {}</p>\n<p><b>Ours.</b> {}</p></figcaption>\n</figure>\n",
        plate.paper, plate.ours
    );
    html
}

fn vehicle(reproduction: &Reproduction) -> String {
    let VehicleParameters {
        mass_kg: m,
        yaw_inertia_kg_m2: i_z,
        front_axle_distance_m: l_f,
        rear_axle_distance_m: l_r,
        friction,
        front_cornering_stiffness_n_rad: c_f,
        rear_cornering_stiffness_n_rad: c_r,
    } = reproduction.setup.vehicle;
    let p = reproduction.setup.point_distance_m();
    [
        ("mass m", m, "kg"),
        ("yaw moment of inertia I_z", i_z, "kg m²"),
        ("centre of mass to front axle l_f", l_f, "m"),
        ("centre of mass to rear axle l_r", l_r, "m"),
        ("friction μ", friction, ""),
        ("cornering stiffness, front C_f", c_f, "N/rad"),
        ("cornering stiffness, rear C_r", c_r, "N/rad"),
        ("distance p of P from the front axle", p, "m"),
    ]
    .iter()
    .map(|(name, value, unit)| {
        format!(
            "<tr><th scope=\"row\">{}</th><td>{} {unit}</td></tr>\n",
            typeset(name),
            super::text::with_digits(*value, 6)
        )
    })
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn underscores_become_subscripts_and_markup_stays_text() {
        assert_eq!(typeset("C_f l_r < 1"), "C<sub>f</sub> l<sub>r</sub> &lt; 1");
        assert_eq!(typeset("a_ b_1 _"), "a_ b_1 _");
    }

    #[test]
    fn every_place_of_the_page_has_its_part_and_parts_are_not_filled() {
        let template = include_str!("report/page.html");
        let names = [
            "style",
            "own_style",
            "subtitle",
            "counts",
            "contents",
            "claims",
            "sections",
            "vehicle",
        ];
        let parts = names.map(|name| (name, "{style}".to_owned()));
        let page = template::fill(template, &parts);
        assert_eq!(page.matches("{style}").count(), names.len(), "{page}");
        assert_eq!(page.matches('{').count(), names.len());
    }
}
