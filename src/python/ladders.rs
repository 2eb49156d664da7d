//! `stlfr.ladders`: the rungs there are, for who lets others choose.

use super::convert::to_python;
use crate::interpolation::Sync;
use crate::render::{Preset, ProxyRung, TrailMode};
use clap::ValueEnum;
use pyo3::prelude::*;
use serde::Serialize;
use std::collections::BTreeMap;

/// One ladder, cheapest rung first.
#[derive(Serialize)]
struct Ladder {
    default: String,
    rungs: Vec<Rung>,
}

#[derive(Serialize)]
struct Rung {
    name: String,
    help: String,
}

/// Every ladder by its option's name.
#[pyfunction]
pub fn ladders(py: Python<'_>) -> PyResult<Bound<'_, PyAny>> {
    let ladders = BTreeMap::from([
        ("sync", ladder::<Sync>()),
        ("proxy", ladder::<ProxyRung>()),
        ("trail", ladder::<TrailMode>()),
        ("preset", ladder::<Preset>()),
    ]);
    to_python(py, &ladders)
}

fn ladder<T: ValueEnum + Default>() -> Ladder {
    let values = T::value_variants().iter().filter_map(T::to_possible_value);
    let rung = |v: clap::builder::PossibleValue| Rung {
        name: v.get_name().to_owned(),
        help: v.get_help().map(ToString::to_string).unwrap_or_default(),
    };
    Ladder {
        default: T::default().to_possible_value().map(|v| rung(v).name).unwrap_or_default(),
        rungs: values.map(rung).collect(),
    }
}
