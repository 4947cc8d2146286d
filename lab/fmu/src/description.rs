//! The description of a unit for importers: `modelDescription.xml`.

use core::fmt::Write as _;

use crate::variables::{Role, Unit, Value, Variable};

/// The file `modelDescription.xml` of a unit.
#[must_use]
pub fn description(unit: Unit) -> String {
    let (name, token, version) = (unit.name(), unit.token(), env!("CARGO_PKG_VERSION"));
    let variables: Vec<&Variable> = unit.variables().collect();
    let mut units: Vec<&str> = variables.iter().map(|it| it.3).collect();
    units.sort_unstable();
    units.dedup();
    let units = units.iter().filter(|unit| !unit.is_empty());
    let units: String = units
        .map(|unit| format!("    <Unit name=\"{unit}\"/>\n"))
        .collect();
    let described: String = variables.iter().enumerate().map(element).collect();
    let mut structure = String::new();
    for kind in ["Output", "InitialUnknown"] {
        for (reference, variable) in variables.iter().enumerate() {
            if matches!(variable.1, Role::Output(_)) {
                // Formatting into a text can't fail.
                let _ = writeln!(structure, "    <{kind} valueReference=\"{reference}\"/>");
            }
        }
    }
    format!(
        r#"<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="{name}" instantiationToken="{token}"
    version="{version}" license="MIT OR Apache-2.0" generationTool="Singletrack {version}">
  <CoSimulation modelIdentifier="{name}" canHandleVariableCommunicationStepSize="true"/>
  <UnitDefinitions>
{units}  </UnitDefinitions>
  <LogCategories>
    <Category name="error" description="Calls that were not obeyed, and why"/>
  </LogCategories>
  <DefaultExperiment startTime="0" stopTime="10" stepSize="0.01"/>
  <ModelVariables>
{described}  </ModelVariables>
  <ModelStructure>
{structure}  </ModelStructure>
</fmiModelDescription>
"#
    )
}

/// The element of a variable.
fn element((reference, variable): (usize, &&Variable)) -> String {
    let Variable(name, role, start, unit, meaning, ..) = variable;
    let kind = start.kind();
    let mut attributes =
        format!("name=\"{name}\" valueReference=\"{reference}\" description=\"{meaning}\"");
    attributes += match role {
        Role::Time => " causality=\"independent\"",
        Role::Parameter => " causality=\"parameter\" variability=\"fixed\"",
        Role::Input(_) => " causality=\"input\"",
        Role::Output(_) => " causality=\"output\"",
    };
    if !unit.is_empty() {
        attributes += &format!(" unit=\"{unit}\"");
    }
    if let Role::Input(range) = role {
        attributes += &format!(" min=\"{}\" max=\"{}\"", range.start(), range.end());
    }
    let is_set = matches!(role, Role::Parameter | Role::Input(_));
    match start {
        Value::Number(start) if is_set => attributes += &format!(" start=\"{start}\""),
        Value::Count(start) => attributes += &format!(" start=\"{start}\""),
        Value::Text(_) if is_set => {
            return format!(
                "    <{kind} {attributes}>\n      <Start value=\"\"/>\n    </{kind}>\n"
            );
        }
        _ => {}
    }
    format!("    <{kind} {attributes}/>\n")
}
