//! Checks of the image: forbidden symbols, and use of flash, SRAM and processor.

use std::{path::Path, process::Command};

use crate::process::{Failure, failure, text};

/// The processor has 32,768 B of flash, and 2,048 B of SRAM for variables and stack.
const BUDGETS: [(&str, f64, &str); 3] = [
    ("flash", 24_576.0, "B"),
    ("SRAM in all", 1_400.0, "B"),
    ("cpu", 20.0, "%"),
];

/// Refuses symbols that are known to fail on an AVR.
pub(crate) fn refuse_forbidden(elf: &Path) -> Result<(), Failure> {
    forbidden(&text(Command::new("avr-nm").arg(elf))?)
        .map_err(|why| failure!("{}: {why}", elf.display()))
}

fn forbidden(symbols: &str) -> Result<(), String> {
    let names: Vec<&str> = symbols
        .lines()
        .filter_map(|line| line.split_whitespace().last())
        .collect();
    if !names.iter().any(|name| name.starts_with("__vector_")) {
        return Err("no interrupt among its symbols, so it can't be checked".into());
    }
    for name in names {
        if ["__mulosi4", "__mulodi4", "__muloti4"].contains(&name) {
            return Err(format!(
                "it contains {name}, which is miscompiled on AVR: the caller has 2 bytes on its stack \
                 for the overflow, the function writes 4. The image must not use checked_mul, \
                 overflowing_mul or saturating_mul of i32 and wider, nor overflow checks: bound the \
                 factors, or multiply in a wider type"
            ));
        }
        // The mangled path of core::fmt, and of its traits in implementations.
        if name.contains("4core3fmt") || name.contains("core..fmt..") {
            return Err(format!(
                "it contains {name}: formatting takes 3 to 7 KB of flash, and the text is never shown. \
                 Look for a derived Debug, unwrap, expect or an index that can panic"
            ));
        }
    }
    Ok(())
}

/// Flash and static SRAM of the image by avr-size, in bytes.
pub(crate) fn size(elf: &Path) -> Result<[f64; 2], Failure> {
    size_of(&text(Command::new("avr-size").arg(elf))?)
        .ok_or_else(|| failure!("{}: avr-size finds no program", elf.display()))
}

fn size_of(text: &str) -> Option<[f64; 2]> {
    let numbers = text.lines().nth(1)?.split_whitespace();
    let numbers: Vec<f64> = numbers.map_while(|word| word.parse().ok()).collect();
    let [code, data, zeroed, ..] = numbers[..] else {
        return None;
    };
    // Initial values and constants are in flash and in SRAM.
    (code > 0.0).then_some([code + data, data + zeroed])
}

/// Compares what `uno-figures` has measured, in lines such as `stack 248 B`, with the budgets, with
/// the size by avr-size and with the car that the image is for. Returns a table, and what is wrong.
pub(crate) fn judge(
    [flash, static_sram]: [f64; 2],
    car_id: u16,
    measured: &str,
) -> Result<(String, Vec<String>), Failure> {
    let lines = measured.lines().filter(|line| !line.trim().is_empty());
    let parsed = |line| {
        parse(line)
            .ok_or_else(|| failure!("uno-figures: {line:?} is not of the form `name value unit`"))
    };
    let mut figures = lines.map(parsed).collect::<Result<Vec<_>, _>>()?;
    let find = |figures: &[(&str, f64, &str)], name, unit| {
        let figure = figures.iter().find(|one| (one.0, one.2) == (name, unit));
        figure
            .map(|figure| figure.1)
            .ok_or_else(|| failure!("uno-figures prints no `{name}` in {unit}"))
    };
    let sram = find(&figures, "static", "B")? + find(&figures, "stack", "B")?;
    figures.insert(0, ("SRAM in all", sram, "B"));
    let mut wrong = Vec::new();
    // uno-figures reads the file independently of avr-size.
    for (name, ours) in [("flash", flash), ("static", static_sram)] {
        let theirs = find(&figures, name, "B")?;
        let numbers = format!("{name}: {ours} B by avr-size, {theirs} B by uno-figures");
        let why = format!("{numbers}: one of them reads the image wrongly");
        wrong.extend((theirs != ours).then_some(why));
    }
    for (name, budget, unit) in BUDGETS {
        let value = find(&figures, name, unit)?;
        let why = format!("{name}: {value} {unit} are more than the budget of {budget} {unit}");
        wrong.extend((value > budget).then_some(why));
    }
    let greeted = find(&figures, "car-id", "greeted")?;
    let why = format!("the image is for car {car_id}, and greets as car {greeted}");
    wrong.extend((greeted != f64::from(car_id)).then_some(why));
    let table = figures.into_iter().map(|(name, value, unit)| {
        let budget = BUDGETS.iter().find(|budget| budget.0 == name);
        let budget = budget.map_or(String::new(), |(_, most, _)| format!("  of {most}"));
        format!("{name:30} {value:>9} {unit}{budget}\n")
    });
    Ok((table.collect(), wrong))
}

/// Name, value and unit. Only the name may contain blanks.
fn parse(line: &str) -> Option<(&str, f64, &str)> {
    let (rest, unit) = line.trim().rsplit_once(' ')?;
    let (name, value) = rest.trim_end().rsplit_once(' ')?;
    let value = value.parse().ok().filter(|value: &f64| value.is_finite())?;
    Some((name.trim_end(), value, unit))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn initial_values_count_in_flash_and_in_sram() {
        let text = "   text\t   data\t    bss\t    dec\t    hex\tfilename\n   \
                    6450\t     62\t    227\t   6739\t   1a53\tuno.elf\n";
        assert_eq!(size_of(text), Some([6_512.0, 289.0]));
        assert_eq!(size_of("text data bss\n0 0 0 0 0 empty.elf\n"), None);
        assert_eq!(size_of(""), None);
    }

    #[test]
    fn forbidden_symbols_are_reported() {
        let image = |name: &str| forbidden(&format!("00000080 T __vector_1\n00000a12 T {name}\n"));
        assert_eq!(image("_ZN15singletrack_uno4main17h0E"), Ok(()));
        for name in [
            "__mulosi4",
            "__mulodi4",
            "__muloti4",
            // Formatting, with either mangling.
            "_ZN4core3fmt9Formatter3pad17h0123456789abcdefE",
            "_RNvNtCs1234_4core3fmt5write",
            "_ZN42_$LT$u8$u20$as$u20$core..fmt..Debug$GT$3fmt17h01E",
        ] {
            assert!(image(name).unwrap_err().contains(name), "{name}");
        }
        assert!(forbidden("").is_err(), "a stripped image");
    }

    fn wrong(lines: &str) -> String {
        let judged = judge(
            [6_512.0, 289.0],
            7,
            &format!("{lines}interrupt INT0, most 56 cycles\n"),
        );
        match judged {
            Ok((_, wrong)) => wrong.join("; "),
            Err(failure) => failure.to_string(),
        }
    }

    #[test]
    fn every_exceeded_budget_is_reported() {
        let measured = |stack: u32, cpu: f64| {
            format!("flash 6512 B\nstatic 289 B\nstack {stack} B\ncpu {cpu} %\ncar-id 7 greeted\n")
        };
        assert_eq!(wrong(&measured(1_111, 20.0)), "");
        assert_eq!(
            wrong(&measured(1_112, 20.25)),
            "SRAM in all: 1401 B are more than the budget of 1400 B; \
             cpu: 20.25 % are more than the budget of 20 %"
        );
        let (table, _) = judge([6_512.0, 289.0], 7, &measured(248, 7.12)).unwrap();
        assert!(
            table.contains("SRAM in all                          537 B  of 1400\n"),
            "{table}"
        );
    }

    #[test]
    fn contradictions_and_missing_figures_are_refused() {
        for (lines, why) in [
            (
                "flash 6513 B\nstatic 289 B\nstack 2 B\ncpu 7 %\ncar-id 7 greeted\n",
                "reads the image wrongly",
            ),
            (
                "flash 6512 B\nstatic 288 B\nstack 2 B\ncpu 7 %\ncar-id 7 greeted\n",
                "reads the image wrongly",
            ),
            (
                "flash 6512 B\nstatic 289 B\nstack 2 B\ncpu 7 %\ncar-id 0 greeted\n",
                "greets as car 0",
            ),
            (
                "flash 6512 B\nstatic 289 B\nstack 2 B\ncpu 7 %\n",
                "no `car-id`",
            ),
            ("flash 6512 B\nstatic 289 B\nstack 2 B\n", "no `cpu` in %"),
            (
                "flash 6512 B\nstatic 289 B\nstack 2 %\ncpu 7 %\n",
                "no `stack` in B",
            ),
            ("stack\n", "not of the form"),
            ("248 B\n", "not of the form"),
            ("stack many B\n", "not of the form"),
            ("stack NaN B\n", "not of the form"),
        ] {
            assert!(wrong(lines).contains(why), "{lines}{}", wrong(lines));
        }
    }
}
