//! `stlfr.methods` and `stlfr.options`: the methods and options that a user chooses.

use super::convert::to_python;
use crate::interpolation::SyncMethod;
use crate::method::Method;
use crate::options::{Preset, ProxyMethod, RenderOptions, TrailMode};
use pyo3::prelude::*;
use serde::Serialize;
use std::collections::BTreeMap;

/// One stage's methods, cheapest first.
#[derive(Serialize)]
struct MethodList {
    default: &'static str,
    methods: Vec<Named>,
}

#[derive(Serialize)]
struct Named {
    name: &'static str,
    help: &'static str,
}

/// Every stage's methods by the name of its option.
#[pyfunction]
pub fn methods(py: Python<'_>) -> PyResult<Bound<'_, PyAny>> {
    let stages = BTreeMap::from([
        ("sync", stage::<SyncMethod>()),
        ("proxy", stage::<ProxyMethod>()),
        ("trail", stage::<TrailMode>()),
        ("preset", stage::<Preset>()),
    ]);
    to_python(py, &stages)
}

/// Every option with its default, range, unit and help.
#[pyfunction]
pub fn options(py: Python<'_>) -> PyResult<Bound<'_, PyAny>> {
    to_python(py, &RenderOptions::default().declared())
}

fn stage<M: Method>() -> MethodList {
    let methods = M::ALL.iter().map(|m| Named { name: m.name(), help: m.help() }).collect();
    MethodList { default: M::default().name(), methods }
}
