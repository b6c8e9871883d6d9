//! Value references to getters and setters, with every check a host's call needs.

use std::ffi::c_int;
use std::mem::MaybeUninit;

use model_description::{
    Causality, Row, TABLE, Value, Variability, count, exists, felt, posed, reference, resolve,
};
use tissue::model::Model;
use tissue::simulation::Simulation;

use crate::types::{Outcome, discard, error};

type Get<T> = fn(&mut Simulation, usize, usize) -> T;
type Set<T> = fn(&mut Simulation, usize, usize, T) -> Result<(), String>;

/// One variable.
#[derive(Clone, Copy)]
pub struct Variable {
    row: &'static Row,
    item: usize,
    component: usize,
}

impl Variable {
    fn name(&self) -> String {
        self.row.name.replace('#', &(self.item + 1).to_string())
            + self.row.components[self.component]
    }

    fn type_name(&self) -> &'static str {
        match self.row.value {
            Value::Real { .. } | Value::Evaluated { .. } => "Real",
            Value::Integer { .. } => "Integer",
            Value::Boolean { .. } => "Boolean",
        }
    }

    fn wrong_type(&self, verb: &str) -> String {
        let (name, kind) = (self.name(), self.type_name());
        format!("{name} is of type {kind}; use fmi2{verb}{kind}")
    }
}

/// Finds variables by reference; those of one row, in any order, with a single search.
struct Finder<'a> {
    model: &'a Model,
    last: Option<Range>,
}

struct Range {
    row: &'static Row,
    first: u32,
    stride: u32,
    components: u32,
    items: u32,
}

impl Finder<'_> {
    fn new(model: &Model) -> Finder<'_> {
        Finder { model, last: None }
    }

    #[inline]
    fn find(&mut self, wanted: u32) -> Outcome<Variable> {
        if let Some(range) = &self.last
            && let Some(within) = wanted.checked_sub(range.first)
        {
            let (item, component) = (within / range.stride, within % range.stride);
            if item < range.items && component < range.components {
                return Ok(Variable {
                    row: range.row,
                    item: item as usize,
                    component: component as usize,
                });
            }
        }
        self.search(wanted)
    }

    fn search(&mut self, wanted: u32) -> Outcome<Variable> {
        let (row, item, component) = resolve(wanted, self.model)
            .ok_or_else(|| error(format!("there is no variable with value reference {wanted}; modelDescription.xml lists them")))?;
        let first = reference(row, 0, 0);
        self.last = Some(Range {
            row,
            first,
            stride: reference(row, 1, 0) - first,
            components: row.components.len() as u32,
            items: count(row.group, self.model) as u32,
        });
        Ok(Variable {
            row,
            item,
            component,
        })
    }
}

/// `T` as the table has it, `C` as the host does.
fn get<T, C: From<T>>(
    simulation: &mut Simulation,
    references: &[u32],
    values: &mut [MaybeUninit<C>],
    getter: impl Fn(&Value) -> Option<Get<T>>,
) -> Outcome {
    let model = simulation.model().clone();
    let mut finder = Finder::new(&model);
    for (reference, value) in references.iter().zip(values) {
        let at = finder.find(*reference)?;
        let get = getter(&at.row.value).ok_or_else(|| error(at.wrong_type("Get")))?;
        value.write(get(simulation, at.item, at.component).into());
    }
    Ok(())
}

pub fn get_real(
    simulation: &mut Simulation,
    references: &[u32],
    values: &mut [MaybeUninit<f64>],
) -> Outcome {
    let model = simulation.model().clone();
    let mut finder = Finder::new(&model);
    for (reference, value) in references.iter().zip(values) {
        let at = finder.find(*reference)?;
        value.write(match at.row.value {
            Value::Real { get, .. } => get(simulation, at.item, at.component),
            Value::Evaluated { get, .. } => get(simulation, at.item, at.component)
                .map_err(|reason| discard(format!("{}: {reason}", at.name())))?,
            _ => return Err(error(at.wrong_type("Get"))),
        });
    }
    Ok(())
}

pub fn get_integer(
    simulation: &mut Simulation,
    references: &[u32],
    values: &mut [MaybeUninit<c_int>],
) -> Outcome {
    get(simulation, references, values, |value| match value {
        Value::Integer { get } => Some(*get),
        _ => None,
    })
}

pub fn get_boolean(
    simulation: &mut Simulation,
    references: &[u32],
    values: &mut [MaybeUninit<c_int>],
) -> Outcome {
    get(simulation, references, values, |value| match value {
        Value::Boolean { get, .. } => Some(*get),
        _ => None,
    })
}

/// Whether the host may set it now. `before_start`: up to the end of initialization mode.
fn settable(at: &Variable, before_start: bool) -> Outcome {
    let fixed = at.row.variability == Variability::Fixed;
    match at.row.causality {
        Causality::Input => Ok(()),
        Causality::Parameter if !fixed || before_start => Ok(()),
        Causality::Parameter => Err(error(format!(
            "{} is a fixed parameter; it can be set before fmi2ExitInitializationMode only",
            at.name()
        ))),
        Causality::Output | Causality::Local | Causality::AsScene => Err(error(format!(
            "{} is calculated; it can only be read",
            at.name()
        ))),
    }
}

/// Finite and within the table's bounds.
fn acceptable(at: &Variable, value: f64) -> Outcome {
    let Value::Real { unit, min, max, .. } = at.row.value else {
        return Err(error(at.wrong_type("Set")));
    };
    if !value.is_finite() {
        return Err(discard(format!(
            "{} = {value} is not a finite number; the old value is kept",
            at.name()
        )));
    }
    if min.is_some_and(|min| value < min) || max.is_some_and(|max| value > max) {
        let least = min.map(|min| format!(" at least {min} {unit}"));
        let most = max.map(|max| format!(" at most {max} {unit}"));
        let range: Vec<String> = least.into_iter().chain(most).collect();
        return Err(error(format!(
            "{} = {value} {unit} is out of range; it must be{}",
            at.name(),
            range.join(" and")
        )));
    }
    Ok(())
}

/// All checks, then all values; an error outweighs a discard.
fn checked(
    model: &Model,
    references: &[u32],
    mut check: impl FnMut(usize, &Variable) -> Outcome,
) -> Outcome<Vec<Variable>> {
    let mut finder = Finder::new(model);
    let mut variables = Vec::with_capacity(references.len());
    let mut discarded = None;
    for (k, reference) in references.iter().enumerate() {
        let at = finder.find(*reference)?;
        match check(k, &at) {
            Err(refusal) if refusal.status == crate::types::Status::Discard => {
                discarded.get_or_insert(refusal);
            }
            other => other?,
        }
        variables.push(at);
    }
    discarded.map_or(Ok(variables), Err)
}

pub fn set_real(
    simulation: &mut Simulation,
    before_start: bool,
    references: &[u32],
    values: &[f64],
) -> Outcome {
    let model = simulation.model().clone();
    let variables = checked(&model, references, |k, at| {
        let (Value::Real { .. } | Value::Evaluated { .. }) = at.row.value else {
            return Err(error(at.wrong_type("Set")));
        };
        settable(at, before_start)?;
        acceptable(at, values[k])
    })?;
    // Fixed parameters first: they may still be refused by their setter, and can be undone exactly.
    let mut undo: Vec<(Variable, f64)> = Vec::new();
    for first in [true, false] {
        for (at, value) in variables.iter().zip(values) {
            let Value::Real {
                get,
                set: Some(set),
                ..
            } = at.row.value
            else {
                continue;
            };
            let fixed = at.row.variability == Variability::Fixed;
            if fixed != first {
                continue;
            }
            if fixed {
                undo.push((*at, get(simulation, at.item, at.component)));
            }
            if let Err(reason) = set(simulation, at.item, at.component, *value) {
                for (at, value) in undo.iter().rev().skip(usize::from(fixed)) {
                    put(simulation, at, *value);
                }
                return Err(error(format!("{} = {value}: {reason}", at.name())));
            }
        }
    }
    Ok(())
}

/// Sets a value that was the variable's own before.
fn put(simulation: &mut Simulation, at: &Variable, value: f64) {
    if let Value::Real { set: Some(set), .. } = at.row.value {
        let _ = set(simulation, at.item, at.component, value);
    }
}

pub fn set_integer(simulation: &mut Simulation, before_start: bool, references: &[u32]) -> Outcome {
    let model = simulation.model().clone();
    checked(&model, references, |_, at| match at.row.value {
        Value::Integer { .. } => settable(at, before_start),
        _ => Err(error(at.wrong_type("Set"))),
    })
    .map(|_| ())
}

pub fn set_boolean(
    simulation: &mut Simulation,
    before_start: bool,
    references: &[u32],
    values: &[c_int],
) -> Outcome {
    let model = simulation.model().clone();
    let variables = checked(&model, references, |_, at| match at.row.value {
        Value::Boolean { .. } => settable(at, before_start),
        _ => Err(error(at.wrong_type("Set"))),
    })?;
    for (at, value) in variables.iter().zip(values) {
        if let Value::Boolean { set: Some(set), .. } = at.row.value {
            let set: Set<bool> = set;
            set(simulation, at.item, at.component, *value != 0)
                .map_err(|reason| error(format!("{} = {value}: {reason}", at.name())))?;
        }
    }
    Ok(())
}

/// First derivatives \[1/s of the unit\] of real inputs, that is of tool poses.
pub fn set_input_derivatives(
    simulation: &mut Simulation,
    references: &[u32],
    orders: &[c_int],
    values: &[f64],
) -> Outcome {
    let model = simulation.model().clone();
    let variables = checked(&model, references, |k, at| {
        let (Causality::Input, Value::Real { .. }) = (at.row.causality, at.row.value) else {
            return Err(error(format!(
                "{} has no input derivatives; position and orientation of tools have",
                at.name()
            )));
        };
        if orders[k] != 1 {
            return Err(error(format!(
                "order {} of {} is not supported; only order 1 is",
                orders[k],
                at.name()
            )));
        }
        if !values[k].is_finite() {
            return Err(discard(format!(
                "derivative {} of {} is not a finite number; the old one is kept",
                values[k],
                at.name()
            )));
        }
        Ok(())
    })?;
    for (at, value) in variables.iter().zip(values) {
        // A tool's pose comes first in its item: position at 0, orientation at 3.
        simulation.set_pose_rate(at.item, at.row.offset as usize + at.component, *value);
    }
    Ok(())
}

/// Derivatives by the poses of tools along a direction: sum_k d unknown / d known_k dv_k.
pub fn directional_derivative(
    simulation: &mut Simulation,
    unknowns: &[u32],
    knowns: &[u32],
    direction: &[f64],
    values: &mut [MaybeUninit<f64>],
) -> Outcome {
    let model = simulation.model().clone();
    let mut finder = Finder::new(&model);
    let mut along = Vec::with_capacity(knowns.len());
    for (reference, change) in knowns.iter().zip(direction) {
        let at = finder.find(*reference)?;
        let component = posed(at.row, at.component).ok_or_else(|| {
            error(format!(
                "{} is no known of directional derivatives; position and orientation of tools are",
                at.name()
            ))
        })?;
        if !change.is_finite() {
            return Err(discard(format!(
                "the direction has {change} along {}; it must be finite",
                at.name()
            )));
        }
        along.push((at.item, component, *change));
    }
    for reference in unknowns {
        let at = finder.find(*reference)?;
        if felt(at.row, at.component).is_none() {
            return Err(error(format!(
                "{} has no directional derivatives; force and torque of tools have",
                at.name()
            )));
        }
    }
    for (reference, value) in unknowns.iter().zip(values) {
        let at = finder.find(*reference)?;
        let own = felt(at.row, at.component).unwrap_or_default();
        let mut sum = 0.0;
        for (by, component, change) in along.iter().filter(|(.., change)| *change != 0.0) {
            let column = simulation.tangent(at.item, *by, *component);
            sum += change * column.map_err(discard)?[own];
        }
        if !sum.is_finite() {
            return Err(discard(format!(
                "the derivative of {} is too large",
                at.name()
            )));
        }
        value.write(sum);
    }
    Ok(())
}

/// First derivatives \[1/s of the unit\] of outputs that have them.
pub fn get_output_derivatives(
    simulation: &mut Simulation,
    references: &[u32],
    orders: &[c_int],
    values: &mut [MaybeUninit<f64>],
) -> Outcome {
    let model = simulation.model().clone();
    let rates = checked(&model, references, |k, at| {
        if !matches!(at.row.value, Value::Real { rate: Some(_), .. }) {
            return Err(error(format!(
                "{} has no output derivatives; force and torque of tools and positions of vertices have",
                at.name()
            )));
        }
        if orders[k] != 1 {
            return Err(error(format!(
                "order {} of {} is not provided; only order 1 is",
                orders[k],
                at.name()
            )));
        }
        Ok(())
    })?;
    for (at, value) in rates.iter().zip(values) {
        if let Value::Real {
            rate: Some(rate), ..
        } = at.row.value
        {
            value.write(rate(simulation, at.item, at.component));
        }
    }
    Ok(())
}

/// All fixed parameters, in the order of the table.
fn fixed(model: &Model) -> impl Iterator<Item = Variable> {
    let rows = TABLE.iter().filter(|row| {
        row.causality == Causality::Parameter
            && row.variability == Variability::Fixed
            && exists(row, model)
    });
    rows.flat_map(|row| {
        (0..count(row.group, model)).flat_map(move |item| {
            (0..row.components.len()).map(move |component| Variable {
                row,
                item,
                component,
            })
        })
    })
}

/// Values of the fixed parameters as last set.
pub fn fixed_values(simulation: &mut Simulation) -> Vec<f64> {
    let model = simulation.model().clone();
    fixed(&model)
        .filter_map(|at| match at.row.value {
            Value::Real { get, .. } => Some(get(simulation, at.item, at.component)),
            _ => None,
        })
        .collect()
}

/// Sets all fixed parameters; those that keep their value are left alone.
pub fn set_fixed(simulation: &mut Simulation, values: &[f64]) -> Outcome {
    let model = simulation.model().clone();
    let old = fixed_values(simulation);
    if old.len() != values.len() {
        return Err(error("the number of fixed parameters differs"));
    }
    for ((at, value), old) in fixed(&model).zip(values).zip(old) {
        acceptable(&at, *value)?;
        if let (true, Value::Real { set: Some(set), .. }) = (*value != old, at.row.value) {
            set(simulation, at.item, at.component, *value).map_err(error)?;
        }
    }
    Ok(())
}
