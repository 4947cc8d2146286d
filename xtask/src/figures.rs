//! Resource usage of the image, with budgets.

use crate::{gates::Size, process::Failure};

/// Flash, in bytes: three quarters of the processor's.
const FLASH_BUDGET: f64 = 24_576.0;
/// Variables and worst stack, in bytes, of 2,048.
const SRAM_BUDGET: f64 = 1_400.0;
/// Processor load, in percent.
const CPU_BUDGET_PERCENT: f64 = 20.0;

/// One line of the table.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Figure {
    name: String,
    value: f64,
    /// Number of decimals.
    decimals: usize,
    unit: String,
    budget: Option<f64>,
}

impl Figure {
    fn bytes(name: &str, value: f64) -> Self {
        Self {
            name: name.to_owned(),
            value,
            decimals: 0,
            unit: "B".to_owned(),
            budget: None,
        }
    }

    /// Parses a line such as `stack 248 B`: name, value, unit. Only the name may
    /// contain blanks.
    fn parse(line: &str) -> Option<Self> {
        let mut words = line.split_whitespace().rev();
        let (unit, digits) = (words.next()?, words.next()?);
        let mut name: Vec<&str> = words.collect();
        name.reverse();
        let value: f64 = digits.parse().ok()?;
        (!name.is_empty() && value.is_finite()).then(|| Self {
            name: name.join(" "),
            value,
            decimals: digits.split_once('.').map_or(0, |(_, behind)| behind.len()),
            unit: unit.to_owned(),
            budget: None,
        })
    }

    fn named(self, name: &str) -> Self {
        Self {
            name: name.to_owned(),
            ..self
        }
    }

    fn within(self, budget: f64) -> Self {
        Self {
            budget: Some(budget),
            ..self
        }
    }

    /// Message about an exceeded budget, if it is exceeded.
    fn excess(&self) -> Option<String> {
        let Self { name, unit, .. } = self;
        let budget = self.budget?;
        (self.value > budget).then(|| {
            format!(
                "{name}: {} {unit} are {} {unit} more than the budget of {} {unit}",
                number(self.value, self.decimals),
                number(self.value - budget, self.decimals),
                number(budget, 0)
            )
        })
    }
}

/// The table of the results of `avr-size` and `uno-figures`, budgets first.
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
            .ok_or_else(|| Failure::new(format!("uno-figures prints no `{name}` in {unit}")))?;
        Ok::<_, Failure>(figures.remove(position))
    };
    let stack = take("stack", "B")?.named("worst stack");
    let cpu = take("cpu", "%")?.within(CPU_BUDGET_PERCENT);
    let flash = Figure::bytes("flash", f64::from(size.flash)).within(FLASH_BUDGET);
    let static_sram = Figure::bytes("static SRAM", f64::from(size.static_sram));
    // uno-figures reads the file independently of avr-size.
    for (name, ours) in [("flash", &flash), ("static", &static_sram)] {
        let theirs = take(name, "B")?;
        if theirs.value != ours.value {
            return Err(Failure::new(format!(
                "{name}: {} B by avr-size, {} B by uno-figures: one of them reads the image wrongly",
                ours.value, theirs.value
            )));
        }
    }
    let sram = Figure::bytes("SRAM in all", static_sram.value + stack.value).within(SRAM_BUDGET);
    let mut table = vec![flash, static_sram, stack, sram, cpu];
    table.append(&mut figures);
    Ok(table)
}

/// Formats the table.
pub(crate) fn render(table: &[Figure]) -> String {
    let rows: Vec<[String; 3]> = table
        .iter()
        .map(|figure| {
            let quantity = |value, decimals| format!("{} {}", number(value, decimals), figure.unit);
            [
                figure.name.clone(),
                quantity(figure.value, figure.decimals),
                figure
                    .budget
                    .map(|budget| quantity(budget, 0))
                    .unwrap_or_default(),
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

/// Fails with all exceeded budgets.
pub(crate) fn check(table: &[Figure]) -> Result<(), Failure> {
    let excess: Vec<String> = table.iter().filter_map(Figure::excess).collect();
    if excess.is_empty() {
        Ok(())
    } else {
        Err(Failure::new(excess.join("; ")))
    }
}

/// Fails unless the image has greeted as this car.
pub(crate) fn check_car(table: &[Figure], car_id: u16) -> Result<(), Failure> {
    let greeted = table.iter().find(|figure| figure.name == "car-id");
    if greeted.is_some_and(|figure| figure.value == f64::from(car_id)) {
        Ok(())
    } else {
        let greeted = greeted.map_or("none".to_owned(), |figure| figure.value.to_string());
        Err(Failure::new(format!(
            "the image is for car {car_id}, and greets as car {greeted}"
        )))
    }
}

/// Formats a number with commas between thousands.
fn number(value: f64, decimals: usize) -> String {
    let digits = format!("{value:.decimals$}");
    let (whole, fraction) = match digits.find('.') {
        Some(point) => digits.split_at(point),
        None => (digits.as_str(), ""),
    };
    let mut text = String::new();
    for (position, digit) in whole.char_indices() {
        if (whole.len() - position).is_multiple_of(3)
            && text.ends_with(|c: char| c.is_ascii_digit())
        {
            text.push(',');
        }
        text.push(digit);
    }
    text + fraction
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
        let within = table(SIZE, "flash 6512 B\nstatic 289 B\nstack 1111 B\ncpu 20 %\n").unwrap();
        check(&within).unwrap();
        let beyond = table(SIZE, "flash 6512 B\nstatic 289 B\nstack 1112 B\ncpu 20 %\n").unwrap();
        assert_eq!(
            check(&beyond).unwrap_err().to_string(),
            "SRAM in all: 1,401 B are 1 B more than the budget of 1,400 B"
        );
    }

    #[test]
    fn every_exceeded_budget_is_reported() {
        let size = Size {
            flash: 24_577,
            ..SIZE
        };
        let beyond = table(
            size,
            "flash 24577 B\nstatic 289 B\nstack 248 B\ncpu 20.2 %\n",
        )
        .unwrap();
        assert_eq!(
            check(&beyond).unwrap_err().to_string(),
            "flash: 24,577 B are 1 B more than the budget of 24,576 B; \
             cpu: 20.2 % are 0.2 % more than the budget of 20 %"
        );
    }

    #[test]
    fn an_image_that_greets_as_another_car_is_refused() {
        let greets = |lines: &str| {
            let measured = format!("flash 6512 B\nstatic 289 B\nstack 2 B\ncpu 2 %\n{lines}");
            check_car(&table(SIZE, &measured).unwrap(), 7)
        };
        greets("car-id 7 greeted\n").unwrap();
        for (lines, as_car) in [("car-id 0 greeted\n", "car 0"), ("", "car none")] {
            let error = greets(lines).unwrap_err().to_string();
            assert!(error.ends_with(as_car), "{error}");
        }
    }

    #[test]
    fn a_missing_figure_with_a_budget_is_refused() {
        for measured in [
            "flash 6512 B\nstatic 289 B\nstack 248 B\n",
            "flash 6512 B\nstatic 289 B\ncpu 7.1 %\n",
            "flash 6512 B\nstatic 289 B\nstack 248 %\ncpu 7.1 %\n",
        ] {
            let error = table(SIZE, measured).unwrap_err().to_string();
            assert!(error.contains("prints no"), "{error}");
        }
    }

    #[test]
    fn a_size_that_differs_from_avr_size_is_refused() {
        for measured in [
            "flash 6513 B\nstatic 289 B\nstack 248 B\ncpu 7 %\n",
            "flash 6512 B\nstatic 288 B\nstack 248 B\ncpu 7 %\n",
        ] {
            let error = table(SIZE, measured).unwrap_err().to_string();
            assert!(error.contains("reads the image wrongly"), "{error}");
        }
    }

    #[test]
    fn a_malformed_line_is_refused() {
        for line in ["stack", "248 B", "stack many B", "stack NaN B"] {
            let error = table(SIZE, line).unwrap_err().to_string();
            assert!(error.contains("not of the form"), "{error}");
        }
    }

    #[test]
    fn all_other_figures_are_in_the_table() {
        let table = table(
            SIZE,
            "flash 6512 B\nstatic 289 B\nstack 248 B\ncpu 7.12 %\ninterrupt INT0, most 56 cycles\n",
        )
        .unwrap();
        assert_eq!(
            render(&table),
            "                          value    budget\n\
             flash                   6,512 B  24,576 B\n\
             static SRAM               289 B\n\
             worst stack               248 B\n\
             SRAM in all               537 B   1,400 B\n\
             cpu                      7.12 %      20 %\n\
             interrupt INT0, most  56 cycles\n"
        );
    }

    #[test]
    fn thousands_have_commas() {
        for (value, decimals, text) in [
            (0.0, 0, "0"),
            (999.0, 0, "999"),
            (1_000.0, 0, "1,000"),
            (-1_000.0, 0, "-1,000"),
            (-100.0, 0, "-100"),
            (1_234_567.25, 2, "1,234,567.25"),
            (7.1, 1, "7.1"),
        ] {
            assert_eq!(number(value, decimals), text);
        }
    }
}
