//! Motion files: a CSV with a column `time` and columns named as the FMU's inputs.
//!
//! Numbers between rows are interpolated linearly, Booleans keep the row before; after the last row all
//! stay.

use std::path::Path;

use tissue::scene::Scene;
use tissue::simulation::Simulation;

use crate::drive::{Host, Kind, Variable};
use crate::error::{Error, file};

/// Inputs of a tool, in the order of their references: a pose, and whether it is active.
const COMPONENTS: [&str; 8] = [
    "position.x",
    "position.y",
    "position.z",
    "orientation.w",
    "orientation.x",
    "orientation.y",
    "orientation.z",
    "active",
];
/// Of [`COMPONENTS`], the switch.
const ACTIVE: u32 = 7;

#[derive(Clone)]
pub struct Motion {
    /// \[s\], ascending.
    time: Vec<f64>,
    /// A column each, with what it sets.
    columns: Vec<(Variable, Vec<f64>)>,
}

impl Motion {
    pub fn read(path: &Path, host: &Host) -> Result<Motion, Error> {
        let text = std::fs::read_to_string(path).map_err(file(path))?;
        Motion::from_text(&text, host).map_err(|e| Error::Content(path.to_path_buf(), e))
    }

    pub fn from_text(text: &str, host: &Host) -> Result<Motion, String> {
        Motion::parse(text, |name| {
            let variable = host.variable(name).filter(|v| v.is_input);
            variable.cloned().ok_or_else(|| {
                let names: Vec<_> = host
                    .variables()
                    .iter()
                    .filter(|v| v.is_input)
                    .map(|v| v.name.as_str())
                    .collect();
                format!(
                    "\"{name}\" is no input of this FMU; inputs are {}",
                    names.join(", ")
                )
            })
        })
    }

    /// Of a scene's tools, without an FMU.
    pub fn of_scene(path: &Path, scene: &Scene) -> Result<Motion, Error> {
        let text = std::fs::read_to_string(path).map_err(file(path))?;
        let names: Vec<Variable> = (0..scene.tools.len())
            .flat_map(|k| (0..COMPONENTS.len() as u32).map(move |c| input(k, c)))
            .collect();
        let find = |name: &str| {
            let known = names.iter().find(|v| v.name == name);
            known.cloned().ok_or_else(|| {
                let count = scene.tools.len();
                format!(
                    "\"{name}\" is no input of this scene; inputs are {} of tools 1 to {count}",
                    COMPONENTS.join(", ")
                )
            })
        };
        Motion::parse(&text, find).map_err(|e| Error::Content(path.to_path_buf(), e))
    }

    /// Rows of all eight inputs of tools, a list a row.
    pub fn of_tools(time: Vec<f64>, tools: &[usize], rows: &[Vec<[f64; 8]>]) -> Motion {
        let mut columns = Vec::new();
        for (place, tool) in tools.iter().enumerate() {
            for c in 0..COMPONENTS.len() {
                let column = rows.iter().map(|row| row[place][c]).collect();
                columns.push((input(*tool, c as u32), column));
            }
        }
        Motion { time, columns }
    }

    /// Times of the rows \[s\].
    pub fn times(&self) -> &[f64] {
        &self.time
    }

    /// Tools of a motion of a scene, ascending.
    pub fn tools(&self) -> Vec<usize> {
        let of = |(v, _): &(Variable, Vec<f64>)| v.reference as usize / COMPONENTS.len();
        let mut tools: Vec<usize> = self.columns.iter().map(of).collect();
        tools.sort_unstable();
        tools.dedup();
        tools
    }

    /// A tool's inputs at a time \[s\]; what has no column is the scene's.
    pub fn at(&self, scene: &Scene, tool: usize, time: f64) -> [f64; 8] {
        let start = &scene.tools[tool];
        let ([x, y, z], [w, a, b, c]) = (start.position, start.orientation);
        let mut inputs = [x, y, z, w, a, b, c, 0.0];
        for (variable, column) in &self.columns {
            let reference = variable.reference as usize;
            if reference / COMPONENTS.len() == tool {
                inputs[reference % COMPONENTS.len()] = match variable.kind {
                    Kind::Real => self.between(column, time),
                    _ => self.before(column, time),
                };
            }
        }
        inputs
    }

    /// As [`Motion::apply`], of a scene's motion.
    pub fn steer(&self, simulation: &mut Simulation, now: f64, at: f64) {
        for (variable, column) in &self.columns {
            let tool = variable.reference as usize / COMPONENTS.len();
            let component = variable.reference as usize % COMPONENTS.len();
            match variable.kind {
                Kind::Real => {
                    simulation.set_pose_input(tool, component, self.between(column, at));
                }
                _ => simulation.set_active(tool, self.before(column, now) != 0.0),
            }
        }
    }

    /// The file.
    pub fn text(&self) -> String {
        let names = self.columns.iter().map(|(v, _)| v.name.as_str());
        let header: Vec<&str> = std::iter::once("time").chain(names).collect();
        let mut text = header.join(",") + "\n";
        for (k, time) in self.time.iter().enumerate() {
            let cells = self.columns.iter().map(|(v, column)| match v.kind {
                Kind::Real => shortest(column[k]),
                _ => (column[k] != 0.0).to_string(),
            });
            let row: Vec<String> = std::iter::once(shortest(*time)).chain(cells).collect();
            text += &(row.join(",") + "\n");
        }
        text
    }

    fn parse(
        text: &str,
        find: impl Fn(&str) -> Result<Variable, String>,
    ) -> Result<Motion, String> {
        // Excel's "CSV UTF-8" begins with a byte order mark.
        let text = text.strip_prefix('\u{FEFF}').unwrap_or(text);
        let mut lines = text
            .lines()
            .enumerate()
            .filter(|(_, l)| !l.trim().is_empty());
        let (_, header) = lines
            .next()
            .ok_or("is empty; a header line with `time` is needed")?;
        let mut names = header.split(',').map(|n| n.trim().trim_matches('"'));
        if names.next() != Some("time") {
            return Err("line 1: the first column must be `time`".into());
        }
        let mut columns: Vec<(Variable, Vec<f64>)> = Vec::new();
        for name in names {
            if columns.iter().any(|(known, _)| known.name == name) {
                return Err(format!("line 1: \"{name}\" stands twice"));
            }
            columns.push((find(name).map_err(|e| format!("line 1: {e}"))?, Vec::new()));
        }
        let mut time = Vec::new();
        for (number, line) in lines {
            let number = number + 1;
            let mut cells = Vec::new();
            for cell in line.split(',').map(str::trim) {
                let value = match cell {
                    "true" => Ok(1.0),
                    "false" => Ok(0.0),
                    other => other.parse::<f64>(),
                };
                let value = value.ok().filter(|v| v.is_finite());
                cells.push(value.ok_or(format!("line {number}: \"{cell}\" is no number"))?);
            }
            if cells.len() != columns.len() + 1 {
                let (found, wanted) = (cells.len(), columns.len() + 1);
                return Err(format!(
                    "line {number}: {found} values; the header has {wanted}"
                ));
            }
            if time.last().is_some_and(|t| cells[0] <= *t) {
                return Err(format!("line {number}: time {} does not grow", cells[0]));
            }
            time.push(cells[0]);
            for ((variable, column), cell) in columns.iter_mut().zip(&cells[1..]) {
                if variable.kind == Kind::Boolean && *cell != 0.0 && *cell != 1.0 {
                    let name = &variable.name;
                    return Err(format!(
                        "line {number}: {name} is {cell}; must be true, false, 1 or 0"
                    ));
                }
                column.push(*cell);
            }
        }
        if time.is_empty() {
            return Err("has a header but no rows".into());
        }
        Ok(Motion { time, columns })
    }

    /// Time of the last row \[s\].
    pub fn end(&self) -> f64 {
        self.time[self.time.len() - 1]
    }

    /// Sets the inputs that lead to time `at` \[s\]: poses as of then, switches as of `now`.
    pub fn apply(&self, host: &Host, now: f64, at: f64) -> Result<(), Error> {
        for (variable, column) in &self.columns {
            let value = match variable.kind {
                Kind::Real => self.between(column, at),
                _ => self.before(column, now),
            };
            host.set(variable, value)?;
        }
        Ok(())
    }

    fn between(&self, column: &[f64], at: f64) -> f64 {
        let next = self.time.partition_point(|t| *t <= at);
        if next == 0 || next == self.time.len() {
            return column[next.saturating_sub(1)];
        }
        let share = (at - self.time[next - 1]) / (self.time[next] - self.time[next - 1]);
        column[next - 1] + (column[next] - column[next - 1]) * share
    }

    fn before(&self, column: &[f64], at: f64) -> f64 {
        let next = self.time.partition_point(|t| *t <= at + 1e-12);
        column[next.saturating_sub(1)]
    }
}

/// An input of a scene's tool, from 0.
fn input(tool: usize, component: u32) -> Variable {
    Variable {
        name: format!("tool[{}].{}", tool + 1, COMPONENTS[component as usize]),
        reference: tool as u32 * COMPONENTS.len() as u32 + component,
        kind: match component {
            ACTIVE => Kind::Boolean,
            _ => Kind::Real,
        },
        is_input: true,
        is_output: false,
    }
}

/// To a nanometre, a nanosecond.
fn shortest(value: f64) -> String {
    let rounded = (value * 1e9).round() / 1e9;
    format!("{}", rounded + 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn motion(text: &str) -> Result<Motion, String> {
        Motion::parse(text, |name| {
            let kind = match name {
                "x" => Kind::Real,
                "on" => Kind::Boolean,
                other => return Err(format!("no {other}")),
            };
            Ok(Variable {
                name: name.into(),
                reference: 0,
                kind,
                is_input: true,
                is_output: false,
            })
        })
    }

    #[test]
    fn numbers_are_interpolated_and_switches_kept() {
        let m = motion("time,x,on\n0,1,false\n1,3,true\n").unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(m.between(&m.columns[0].1, 0.25), 1.5);
        assert_eq!(m.between(&m.columns[0].1, 9.0), 3.0);
        assert_eq!(m.before(&m.columns[1].1, 0.999), 0.0);
        assert_eq!(m.before(&m.columns[1].1, 1.0), 1.0);
    }

    /// What is written of a scene's motion is read again, and leads its tools the same way.
    #[test]
    fn motions_of_scenes_are_files() {
        let text = r#"{"name": "b", "mesh": {"box": {"size": [1, 1, 1], "cells": [1, 1, 1]}},
            "materials": [{"where": {"all": true}, "youngModulus": 6000, "poissonRatio": 0.45, "density": 1060}],
            "tools": [{"name": "p", "kind": "probe", "shape": {"sphere": {"radius": 0.01}}, "position": [0, 0, 3]},
                      {"name": "g", "kind": "grasper", "shape": {"sphere": {"radius": 0.01}}, "position": [0, 1, 3]}]}"#;
        let scene = tissue::scene::parse(text, "b").unwrap();
        let rows = [
            [0.0, 0.25, 3.0, 1.0, 0.0, 0.0, 0.0, 0.0],
            [1.0, 0.5, -0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        ];
        let motion = Motion::of_tools(vec![0.0, 0.002], &[1], &rows.map(|r| vec![r]));
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), motion.text()).unwrap();
        let again = Motion::of_scene(file.path(), &scene).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!((again.tools(), again.times()), (vec![1], motion.times()));
        for t in [0.0, 0.001, 0.002, 1.0] {
            assert_eq!(again.at(&scene, 1, t), motion.at(&scene, 1, t));
            assert_eq!(again.at(&scene, 0, t)[..3], [0.0, 0.0, 3.0]);
        }
    }

    #[test]
    fn bad_files_say_where() {
        for (text, line) in [
            ("", "is empty; a header line with `time` is needed"),
            ("x\n", "line 1: the first column must be `time`"),
            ("time,y\n", "line 1: no y"),
            ("time,x\n0,1,2\n", "line 2: 3 values; the header has 2"),
            ("time,x\n0,one\n", "line 2: \"one\" is no number"),
            ("time,x\n0,inf\n", "line 2: \"inf\" is no number"),
            ("time,x\n1,0\n1,0\n", "line 3: time 1 does not grow"),
            ("time,x\n", "has a header but no rows"),
            ("time,x,x\n", "line 1: \"x\" stands twice"),
            (
                "\u{FEFF}time,on\n0,2\n",
                "line 2: on is 2; must be true, false, 1 or 0",
            ),
        ] {
            assert_eq!(motion(text).err().as_deref(), Some(line));
        }
    }
}
