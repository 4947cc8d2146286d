//! Records as columns: the native half of `singletrack.read`.

use std::{collections::BTreeMap, path::PathBuf};

use numpy::PyArray1;
use pyo3::{
    exceptions::PyOSError,
    prelude::*,
    types::{PyDict, PyList},
};
use singletrack_record::{Ending, Reader, RecordError, Topic, Value};

use crate::refuse;

/// All values as those of a kind; none if one is of another kind.
fn all<T>(values: &[Value], kind: impl Fn(&Value) -> Option<T>) -> Option<Vec<T>> {
    values.iter().map(kind).collect()
}

/// The values of a field in the order of the record, as an array: of truth values, of integers, of
/// floats with NaN for an absent value, or a list of texts with `None`.
fn array<'py>(py: Python<'py>, values: &[Value]) -> PyResult<Bound<'py, PyAny>> {
    let text = |value: &Value| match value {
        Value::Text(text) => Some(text.to_string()),
        _ => None,
    };
    let truth = |value: &Value| match value {
        Value::Bool(bit) => Some(*bit),
        _ => None,
    };
    let unsigned = |value: &Value| match value {
        Value::Unsigned(number) => Some(*number),
        _ => None,
    };
    let signed = |value: &Value| match value {
        Value::Signed(number) => Some(*number),
        Value::Unsigned(number) => Some(i64::try_from(*number).unwrap_or(i64::MAX)),
        _ => None,
    };
    let float = |value: &Value| match value {
        Value::Float(number) => *number,
        Value::Unsigned(number) => *number as f64,
        Value::Signed(number) => *number as f64,
        Value::Bool(bit) => f64::from(u8::from(*bit)),
        Value::Absent | Value::Text(_) => f64::NAN,
    };
    Ok(if values.iter().any(|value| text(value).is_some()) {
        PyList::new(py, values.iter().map(text))?.into_any()
    } else if let Some(bits) = all(values, truth) {
        PyArray1::from_vec(py, bits).into_any()
    } else if let Some(numbers) = all(values, unsigned) {
        PyArray1::from_vec(py, numbers).into_any()
    } else if let Some(numbers) = all(values, signed) {
        PyArray1::from_vec(py, numbers).into_any()
    } else {
        PyArray1::from_iter(py, values.iter().map(float)).into_any()
    })
}

fn error(error: RecordError) -> PyErr {
    match error {
        RecordError::Io { .. } => PyOSError::new_err(error.to_string()),
        other => refuse(other),
    }
}

/// Reads a record: `(topics, meta)`, with a dictionary of columns for each topic.
#[pyfunction]
#[pyo3(signature = (path, topics = None))]
pub(crate) fn read_record<'py>(
    py: Python<'py>,
    path: PathBuf,
    topics: Option<Vec<String>>,
) -> PyResult<(Bound<'py, PyDict>, Bound<'py, PyDict>)> {
    let topics: Vec<Topic> = match topics {
        None => Topic::ALL.to_vec(),
        Some(names) => names
            .iter()
            .map(|name| name.parse::<Topic>().map_err(refuse))
            .collect::<PyResult<_>>()?,
    };
    let mut reader = Reader::open(&path).map_err(error)?.only(&topics);
    let mut columns: BTreeMap<&'static str, Vec<Vec<Value>>> = BTreeMap::new();
    let damage = py.detach(|| {
        let mut values = Vec::new();
        let mut entries = 0_u64;
        loop {
            let step = reader.advance().and_then(|found| {
                found
                    .map(|at| reader.read_values(&mut values).map(|()| at.topic))
                    .transpose()
            });
            match step {
                Ok(Some(topic)) => {
                    entries += 1;
                    let of_topic = columns.entry(topic.name()).or_default();
                    of_topic.resize_with(values.len().max(of_topic.len()), Vec::new);
                    for (column, value) in of_topic.iter_mut().zip(values.drain(..)) {
                        column.push(value);
                    }
                }
                Ok(None) => return Ok(None),
                // What comes before the damage can be used.
                Err(damage @ RecordError::Damaged { .. }) if entries > 0 => {
                    return Ok(Some(damage.to_string()));
                }
                Err(other) => return Err(other),
            }
        }
    });
    let damage = damage.map_err(error)?;
    let tables = PyDict::new(py);
    for topic in topics {
        let table = PyDict::new(py);
        let found = columns.remove(topic.name()).unwrap_or_default();
        for (name, column) in topic.fields().into_iter().zip(found) {
            table.set_item(name, array(py, &column)?)?;
        }
        tables.set_item(topic.name(), table)?;
    }
    let meta = PyDict::new(py);
    let found = &reader.meta;
    meta.set_item("configuration", &found.configuration)?;
    meta.set_item("software", found.software.clone())?;
    meta.set_item("seed", found.seed)?;
    meta.set_item("start_monotonic_ns", found.start.monotonic_ns)?;
    meta.set_item("start_wall_ns", found.start.wall_ns)?;
    meta.set_item("damage", damage)?;
    meta.set_item("finished", reader.ending == Some(Ending::Finished))?;
    Ok((tables, meta))
}
