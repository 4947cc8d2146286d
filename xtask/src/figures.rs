//! What the image costs while it runs, and the table of it all.

use crate::{gates::Size, step::Failure};

/// Half of the processor's flash.
const FLASH_BUDGET: f64 = 16_384.0;
/// Variables and worst stack, of 2,048 B.
const SRAM_BUDGET: f64 = 1_400.0;
/// Of the processor's time.
const CPU_BUDGET_PERCENT: f64 = 15.0;

/// One line of the table.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Figure {
    name: String,
    value: f64,
    unit: String,
    budget: Option<f64>,
}

impl Figure {
    fn new(name: &str, value: f64, unit: &str, budget: Option<f64>) -> Self {
        Self {
            name: name.to_owned(),
            value,
            unit: unit.to_owned(),
            budget,
        }
    }

    /// From a line such as `stack 248 B`: name, value, unit. A name may have
    /// blanks, the other two not.
    fn parse(line: &str) -> Option<Self> {
        let mut words = line.split_whitespace().rev();
        let (unit, value) = (words.next()?, words.next()?);
        let mut name: Vec<&str> = words.collect();
        name.reverse();
        let value: f64 = value.parse().ok()?;
        (!name.is_empty() && value.is_finite())
            .then(|| Self::new(&name.join(" "), value, unit, None))
    }

    /// By how much it is too large.
    fn excess(&self) -> Option<String> {
        let Self {
            name,
            value,
            unit,
            budget,
        } = self;
        let budget = (*budget)?;
        (*value > budget).then(|| {
            format!(
                "{name}: {} {unit} are {} {unit} more than the budget of {} {unit}",
                number(*value),
                number(value - budget),
                number(budget)
            )
        })
    }
}

/// The table of what size and `uno-figures` tell, budgets first.
pub(crate) fn table(size: Size, measured: &str) -> Result<Vec<Figure>, Failure> {
    let mut figures = Vec::new();
    for line in measured.lines().filter(|line| !line.trim().is_empty()) {
        figures.push(Figure::parse(line).ok_or_else(|| {
            Failure::new(format!(
                "uno-figures: {line:?} is not of the form `name value unit`"
            ))
        })?);
    }
    let mut take = |name: &str, unit: &str| {
        let position = figures
            .iter()
            .position(|figure| figure.name == name && figure.unit == unit)
            .ok_or_else(|| Failure::new(format!("uno-figures tells no `{name}` in {unit}")))?;
        Ok::<_, Failure>(figures.remove(position).value)
    };
    let stack = take("stack", "B")?;
    let cpu = take("cpu", "%")?;
    let static_sram = f64::from(size.static_sram);
    let mut table = vec![
        Figure::new("flash", f64::from(size.flash), "B", Some(FLASH_BUDGET)),
        Figure::new("static SRAM", static_sram, "B", None),
        Figure::new("worst stack", stack, "B", None),
        Figure::new("SRAM in all", static_sram + stack, "B", Some(SRAM_BUDGET)),
        Figure::new("cpu", cpu, "%", Some(CPU_BUDGET_PERCENT)),
    ];
    table.append(&mut figures);
    Ok(table)
}

/// The table as people read it.
pub(crate) fn render(table: &[Figure]) -> String {
    let rows: Vec<[String; 3]> = table
        .iter()
        .map(|figure| {
            let quantity = |value| format!("{} {}", number(value), figure.unit);
            [
                figure.name.clone(),
                quantity(figure.value),
                figure.budget.map(quantity).unwrap_or_default(),
            ]
        })
        .collect();
    let width = |column: usize, heading: &str| {
        rows.iter()
            .map(|row| row[column].chars().count())
            .chain([heading.len()])
            .max()
            .unwrap_or_default()
    };
    let (name, value, budget) = (width(0, ""), width(1, "value"), width(2, "budget"));
    let mut text = format!("{:name$}  {:>value$}  {:>budget$}\n", "", "value", "budget");
    for row in &rows {
        let line = format!("{:name$}  {:>value$}  {:>budget$}", row[0], row[1], row[2]);
        text.push_str(line.trim_end());
        text.push('\n');
    }
    text
}

/// Fails over every budget exceeded, by name and by how much.
pub(crate) fn check(table: &[Figure]) -> Result<(), Failure> {
    let excess: Vec<String> = table.iter().filter_map(Figure::excess).collect();
    if excess.is_empty() {
        Ok(())
    } else {
        Err(Failure::new(excess.join("; ")))
    }
}

/// With commas between thousands, and one decimal where there are any.
fn number(value: f64) -> String {
    let digits = if value.fract() == 0.0 {
        format!("{value:.0}")
    } else {
        format!("{value:.1}")
    };
    let (whole, fraction) = digits.split_once('.').unwrap_or((&digits, ""));
    let mut text = String::new();
    for (position, digit) in whole.chars().enumerate() {
        if position > 0
            && digit.is_ascii_digit()
            && (whole.len() - position).is_multiple_of(3)
            && text != "-"
        {
            text.push(',');
        }
        text.push(digit);
    }
    if !fraction.is_empty() {
        text.push('.');
        text.push_str(fraction);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: Size = Size {
        flash: 6_512,
        static_sram: 289,
    };

    #[test]
    fn variables_and_stack_share_a_budget() {
        let within = table(SIZE, "stack 1111 B\ncpu 15 %\n").unwrap();
        check(&within).unwrap();
        let beyond = table(SIZE, "stack 1112 B\ncpu 15 %\n").unwrap();
        assert_eq!(
            check(&beyond).unwrap_err().to_string(),
            "SRAM in all: 1,401 B are 1 B more than the budget of 1,400 B"
        );
    }

    #[test]
    fn every_budget_exceeded_is_named() {
        let size = Size {
            flash: 16_385,
            ..SIZE
        };
        let beyond = table(size, "stack 248 B\ncpu 15.2 %\n").unwrap();
        assert_eq!(
            check(&beyond).unwrap_err().to_string(),
            "flash: 16,385 B are 1 B more than the budget of 16,384 B; \
             cpu: 15.2 % are 0.2 % more than the budget of 15 %"
        );
    }

    #[test]
    fn a_figure_with_a_budget_must_be_told() {
        for measured in ["", "stack 248 B\n", "cpu 7.1 %\n", "stack 248 %\ncpu 7 %\n"] {
            assert!(table(SIZE, measured).is_err(), "{measured:?}");
        }
    }

    #[test]
    fn a_line_of_another_form_is_refused() {
        for line in ["stack", "248 B", "stack many B", "stack NaN B"] {
            assert!(table(SIZE, line).is_err(), "{line:?}");
        }
    }

    #[test]
    fn all_other_figures_are_passed_on() {
        let table = table(
            SIZE,
            "stack 248 B\ncpu 7.1 %\ninterrupt INT0, most 56 cycles\n",
        )
        .unwrap();
        assert_eq!(
            render(&table),
            "                          value    budget\n\
             flash                   6,512 B  16,384 B\n\
             static SRAM               289 B\n\
             worst stack               248 B\n\
             SRAM in all               537 B   1,400 B\n\
             cpu                       7.1 %      15 %\n\
             interrupt INT0, most  56 cycles\n"
        );
    }

    #[test]
    fn thousands_have_commas() {
        for (value, text) in [
            (0.0, "0"),
            (999.0, "999"),
            (1_000.0, "1,000"),
            (1_234_567.25, "1,234,567.2"),
            (7.1, "7.1"),
        ] {
            assert_eq!(number(value), text);
        }
    }
}
