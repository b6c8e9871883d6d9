//! One communication step: n equal substeps, contact, cutting and tearing at haptic ticks.

use crate::contact::burn;
use crate::contact::hold::{self, Held};
use crate::contact::nearby::Nearby;
use crate::contact::{press, slide};
use crate::couple::Before;
use crate::cut;
use crate::element::listed::Listed;
use crate::element::tetrahedra::Extent;
use crate::energy::Account;
use crate::haptics::slope::{self, Slopes};
use crate::integrate::{self, implicit_euler, leapfrog, runge_kutta_4};
use crate::law::response::Law;
use crate::loose;
use crate::mesh::Vec3;
use crate::model::sweep::Sums;
use crate::model::tensor_mass::Lane;
use crate::model::{Model, guyan};
use crate::pose::{Path, Pose};
use crate::scene::{Scheme, ToolKind};
use crate::sleep;
use crate::state::State;
use crate::statics::StaticsError;
use crate::tear::{Tears, tear};

/// Times the substep is halved before a step is given up.
const RETRIES: u32 = 4;
/// Share of the energy in play that the balance may miss.
const RESIDUAL_LIMIT: f64 = 0.05;
/// The elastic energy may exceed the whole by 1/(1 - (h/h_critical)²), no more; past this factor the
/// scheme is running away. (The account closes even then: its kinetic part turns negative.)
const RUNAWAY: f64 = 1000.0;
/// Share of all energy that has moved which substeps of changing length may have made. Some per cent
/// come and go where they are stable; where they feed a mode it tends to the whole.
const MADE_LIMIT: f64 = 0.5;
/// Round-off of the account, as a share of what it has booked.
const ROUND_OFF: f64 = 1e-12;
/// What turning frames may miss, as a share of the most energy there ever was: it stays when the piece has gone.
const FRAME_SHARE: f64 = 1e-4;
/// What springs may miss of what has been booked: their account has an error of the order h²
/// (0.06 % where a stretched bar tears), which stays when all that moved is at rest again.
const SPRINGS_OFF: f64 = 0.01;
/// Energies below this \[J\] are not compared.
const RESIDUAL_FLOOR: f64 = 1e-9;
/// Way of a tool, in radii, after which it is looked at again what it touches, though no haptic tick is due; and that a
/// substep may take it along.
const GLANCE: f64 = 0.05;
/// Substeps one communication step may need; more is a host's slip (a step of hours).
const MOST_SUBSTEPS: f64 = 1e9;

/// Why a step was not made. The state is that of its start.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum StepError {
    #[error("the communication step size is {0} s; it must be positive and finite")]
    Length(f64),
    #[error("a communication step of {0} s takes over 1e9 substeps of {1} s")]
    TooLong(f64, f64),
    #[error("tool[{0}].orientation is zero; a quaternion w x y z of any length but zero is needed")]
    Orientation(usize),
    #[error(
        "the substep of {0:.3e} s is too long: the critical one is {1:.3e} s, out of reach of {RETRIES} halvings"
    )]
    Unstable(f64, f64),
    #[error("the state became non-finite at {0} s although the substep was halved {RETRIES} times")]
    NonFinite(f64),
    #[error(
        "the energy balance was {1:.3e} J off at {0} s although the substep was halved {RETRIES} times"
    )]
    Energy(f64, f64),
    #[error(
        "a tetrahedron was turned inside out (det F = {1:.3}) at {0} s although the substep was halved {RETRIES} times; stVenantKirchhoff cannot bring it back, stableNeoHookean can"
    )]
    Inverted(f64, f64),
    #[error("implicit Euler's equations have no factor: {0}")]
    Factor(StaticsError),
}

/// Scratch, reused from step to step.
#[derive(Debug)]
pub struct Workspace {
    pub(crate) residual: Vec<Lane>,
    pub(crate) partial: Vec<Lane>,
    /// A point of the elements each.
    pub(crate) points: Vec<f64>,
    touched: Vec<(u32, [u32; 3])>,
    pub(crate) cut: cut::Scratch,
    burn: burn::Scratch,
    paths: Vec<Path>,
    /// Way of each tool in a substep, in its radius.
    haste: Vec<f64>,
    /// Where tools were at the start of the substep.
    pub(crate) from: Vec<Pose>,
    pub(crate) slide: slide::Scratch,
    nearby: Nearby,
    /// Force that each tool would have to bear \[N\].
    pub(crate) borne: Vec<Vec3>,
    pub(crate) impulse: Vec<Vec3>,
    pub(crate) before: Before,
    pub(crate) loose: loose::Scratch,
    /// Power that damping takes, as evaluated last \[W\].
    pub(crate) damped: f64,
    pub(crate) interface: guyan::Scratch,
    pub(crate) stages: runge_kutta_4::Scratch,
    pub(crate) implicit: implicit_euler::Scratch,
    /// Of implicit Euler's last solution.
    pub iterations: u64,
    /// A cautery has touched tissue that it cannot burn.
    pub spared: bool,
    pub(crate) tears: Tears,
    /// Nothing attaches, lets go, is cut or tears: a trial of [`crate::haptics`].
    pub(crate) frozen: bool,
    /// The last step was slept through.
    pub(crate) slept: bool,
    slopes: Slopes,
    pub(crate) listed: Option<Listed>,
    start: State,
}

impl Workspace {
    /// The state is another one.
    pub(crate) fn forget(&mut self) {
        self.tears.forget();
        self.nearby.forget();
        if let Some(listed) = &mut self.listed {
            listed.forget();
        }
    }

    pub fn new(model: &Model, state: &State) -> Workspace {
        let nodes = model.parts.moving;
        let tools = model.scene.tools.len();
        let mut start = state.clone();
        start.reserve(model);
        Workspace {
            residual: vec![Lane::default(); nodes],
            partial: vec![Lane::default(); nodes],
            points: vec![0.0; model.whole.points()],
            touched: Vec::with_capacity(model.topology.faces.len().min(4096)),
            cut: cut::Scratch::new(model),
            burn: burn::Scratch::new(model),
            paths: Vec::with_capacity(tools),
            haste: Vec::with_capacity(tools),
            from: Vec::with_capacity(tools),
            slide: slide::Scratch::new(model),
            nearby: Nearby::with_room(model),
            borne: vec![Vec3::zeros(); tools],
            impulse: vec![Vec3::zeros(); tools],
            before: Before::with_room(model),
            loose: loose::Scratch::new(model),
            damped: 0.0,
            listed: Listed::new(
                state.live.elements.as_ref(),
                state.live.blend.as_ref(),
                nodes,
            ),
            interface: guyan::Scratch::new(model),
            stages: runge_kutta_4::Scratch::new(model),
            implicit: implicit_euler::Scratch::new(model),
            iterations: 0,
            spared: false,
            tears: Tears::new(model),
            frozen: false,
            slept: false,
            slopes: Slopes::new(model),
            start,
        }
    }
}

/// n = max(1, ceil(H / substep - 1e-6)) substeps of h = H/n; h = substep exactly where
/// |n substep - H| < 1e-9 H.
pub fn division(length: f64, substep: f64) -> (u64, f64) {
    let n = (length / substep - 1e-6).ceil().max(1.0);
    let h = if (n * substep - length).abs() < 1e-9 * length {
        substep
    } else {
        length / n
    };
    (n as u64, h)
}

/// Advances by `length` \[s\]. On an error the state is that of the start of the step, inputs included.
/// Returns how often the substep has been halved.
pub fn step(
    model: &Model,
    state: &mut State,
    work: &mut Workspace,
    length: f64,
) -> Result<u32, StepError> {
    if !(length > 0.0 && length.is_finite()) {
        return Err(StepError::Length(length));
    }
    if length / state.nominal_substep > MOST_SUBSTEPS {
        return Err(StepError::TooLong(length, state.nominal_substep));
    }
    let foreseen = foreseen(model, state, length)?;
    work.slept =
        state.sleep.asleep && !work.frozen && sleeps_on(model, state, work, length, foreseen);
    if work.slept {
        return Ok(foreseen);
    }
    work.start.copy_from(model, state);
    let mut outcome = Ok(0);
    for halvings in foreseen..=RETRIES {
        let (n, h) = halved(state, length, halvings);
        outcome = advance(model, state, work, n, h).map(|()| halvings);
        match outcome {
            Ok(_) => return outcome,
            Err(StepError::Orientation(_)) => {}
            Err(_) => work.partial.fill(Lane::default()),
        }
        state.copy_from(model, &work.start);
        work.forget();
        if matches!(outcome, Err(StepError::Orientation(_))) {
            break;
        }
    }
    outcome
}

/// Halvings that a step needs at least: the limit is known, of springs for any stretch, so that none must run into
/// it first.
pub(crate) fn foreseen(model: &Model, state: &State, length: f64) -> Result<u32, StepError> {
    let (stable, hasty) = (stable(model, state, length)?, hasty(model, state, length));
    Ok(stable.max(hasty))
}

/// Those of them that stability needs.
pub(crate) fn stable(model: &Model, state: &State, length: f64) -> Result<u32, StepError> {
    let (_, substep) = division(length, state.nominal_substep);
    let critical = critical_substep(model, state);
    let foreseen = (substep / critical).log2().ceil().max(0.0);
    if foreseen > f64::from(RETRIES) {
        return Err(StepError::Unstable(substep, critical));
    }
    Ok(foreseen as u32)
}

/// Halvings after which no tool goes far in a substep; one is left for what else may come. Whether tissue is near does not count:
/// substeps shall not depend on how a host splits time. Implicit Euler would need another factor.
pub(crate) fn hasty(model: &Model, state: &State, length: f64) -> u32 {
    if model.scheme() == Scheme::ImplicitEuler {
        return 0;
    }
    let (_, substep) = division(length, state.nominal_substep);
    let haste = (0..state.tools.len()).map(|k| {
        let tool = &state.tools[k];
        let path = Path::new(&tool.pose, &tool.input, &tool.lines, 1, length);
        let pushes = model.scene.tools[k].kind != ToolKind::Grasper;
        let way = |path: Path| model.tools[k].way(&tool.pose, &path.at(1));
        let way = path.filter(|_| pushes).map_or(0.0, way);
        way / model.tools[k].least_radius()
    });
    let halvings = (haste.fold(0.0, f64::max) * substep / (GLANCE * length)).log2();
    ((halvings - 1e-9).ceil().max(0.0) as u32).min(RETRIES - 1)
}

/// Number and length \[s\] of the substeps of a step after so many halvings.
pub(crate) fn halved(state: &State, length: f64, halvings: u32) -> (u64, f64) {
    let (count, substep) = division(length, state.nominal_substep);
    let n = count << halvings;
    match halvings {
        0 => (n, substep),
        _ => (n, length / n as f64),
    }
}

/// Largest stable substep of the tissue as it is \[s\].
pub fn critical_substep(model: &Model, state: &State) -> f64 {
    critical_at(model, state, &state.extent)
}

/// The same of tissue so deformed.
fn critical_at(model: &Model, state: &State, extent: &Extent) -> f64 {
    let omega = if state.live.removed.is_empty() {
        model.spectrum.highest
    } else {
        model.limiting_frequency()
    };
    let stiffening = model.stiffening(extent, state.parameters.incompressibility);
    let omega = (omega * omega * stiffening + extent.guard).sqrt();
    model.critical_step_at(omega, state.parameters.damping)
}

/// Tissue that sleeps does so to the end of the step, if nothing is to wake it on the way.
fn sleeps_on(
    model: &Model,
    state: &mut State,
    work: &mut Workspace,
    length: f64,
    halvings: u32,
) -> bool {
    let (n, h) = halved(state, length, halvings);
    let length = n as f64 * h;
    let found = find_paths(state, &mut work.paths, n, h);
    if found.is_err()
        || sleep::is_stirred(state, &work.paths)
        || sleep::is_cut_due(model, state, length + 1e-9 * h)
    {
        return false;
    }
    set_substep(model, state, h);
    let period = haptic_period(model);
    for _ in 0..n {
        sleep::pass(model, state, h, period);
    }
    for (tool, path) in state.tools.iter_mut().zip(&work.paths) {
        tool.mean_force = tool.force;
        (tool.force_rate, tool.torque_rate) = (Vec3::zeros(), Vec3::zeros());
        tool.slips = false;
        tool.lines = path.lines();
        tool.input.rate = [None; 7];
    }
    state.length = length;
    true
}

/// With room for the round-off of counted substeps \[s\].
fn haptic_period(model: &Model) -> f64 {
    (1.0 + 1e-6) / model.scene.integration.haptic_rate
}

/// Of all tools, over n substeps of h \[s\].
fn find_paths(state: &State, paths: &mut Vec<Path>, n: u64, h: f64) -> Result<(), StepError> {
    paths.clear();
    for (k, tool) in state.tools.iter().enumerate() {
        let path = Path::new(&tool.pose, &tool.input, &tool.lines, n, h);
        paths.push(path.ok_or(StepError::Orientation(k + 1))?);
    }
    Ok(())
}

/// `n` substeps of `h` \[s\], stable or not, unless the watchdog stops them on the way.
pub fn advance(
    model: &Model,
    state: &mut State,
    work: &mut Workspace,
    n: u64,
    h: f64,
) -> Result<(), StepError> {
    set_substep(model, state, h);
    if model.scheme() == Scheme::CentralDifference && state.clock.total == 0 {
        leapfrog::half_step_back(model, state, &mut work.loose, h);
    }
    find_paths(state, &mut work.paths, n, h)?;
    if work.frozen || sleep::is_stirred(state, &work.paths) {
        state.sleep.wake();
    }
    work.haste.clear();
    for (k, path) in work.paths.iter().enumerate() {
        let shape = &model.tools[k];
        let way = shape.way(&state.tools[k].pose, &path.at(1));
        work.haste.push(way / shape.least_radius());
    }
    work.impulse.fill(Vec3::zeros());
    state.tools.iter_mut().for_each(|tool| tool.slips = false);
    let period = haptic_period(model);
    let span = slope::span(n, h, period);
    for k in 0..n {
        if k + span == n && !work.frozen {
            if k > 0 {
                read_forces(model, state, work);
            }
            work.slopes.begin(state);
        }
        if state.sleep.asleep && !sleep::is_cut_due(model, state, 1e-9 * h) {
            sleep::pass(model, state, h, period);
            for (impulse, tool) in work.impulse.iter_mut().zip(&state.tools) {
                *impulse += tool.force * h;
            }
            continue;
        }
        let time = state.clock.time();
        update_loads(model, state, &mut work.before, &mut work.impulse, time);
        while let Some(scripted) = model.cuts.get(state.cuts_done) {
            if work.frozen || scripted.time > state.clock.time() + 1e-9 * h {
                break;
            }
            state.cuts_done += 1;
            state.sleep.wake();
            cut::event(
                model,
                state,
                &mut work.cut,
                &mut work.loose,
                &scripted.tetrahedra,
            );
        }
        let switched = k == 0 && state.tools.iter().any(|t| t.active != t.input_active);
        // Due, or late at the next boundary.
        let tick = state.since_haptic + h > period || switched;
        if tick && work.frozen {
            state.since_haptic = 0.0;
        } else if tick {
            drift(model, state);
            let elapsed = std::mem::take(&mut state.since_haptic);
            for tool in 0..state.tools.len() {
                feel(model, state, work, tool, h);
                let way = way(model, work, tool, h);
                slide::find(model, state, tool, way, &mut work.slide, &mut work.nearby);
                let burns = model.scene.tools[tool].kind == ToolKind::Cautery;
                if !(burns && state.tools[tool].active) {
                    burn::cool(state, tool);
                } else {
                    burn::burn(model, state, tool, elapsed, &mut work.burn);
                    cut::event(
                        model,
                        state,
                        &mut work.cut,
                        &mut work.loose,
                        work.burn.burnt(),
                    );
                    work.spared = work.spared || cut::spares(model, state, tool);
                }
            }
            tear(
                model,
                state,
                &mut work.tears,
                &mut work.cut,
                &mut work.loose,
            );
        } else if !work.frozen {
            let glances = |haste: f64, since: f64| (haste * since / (h * GLANCE) + 1e-9).floor();
            let (last, now) = (state.since_haptic - h, state.since_haptic);
            for tool in 0..state.tools.len() {
                let haste = work.haste[tool];
                if sticks(model, tool) && glances(haste, now) > glances(haste, last) {
                    drift(model, state);
                    feel(model, state, work, tool, h);
                }
            }
        }
        work.from.clear();
        for (tool, path) in state.tools.iter_mut().zip(&work.paths) {
            work.from.push(tool.pose);
            tool.pose = path.at(k + 1);
        }
        set_targets(model, state, h);
        let pressing = tick.then(|| sleep::pressing(state));
        integrate::substep(model, state, work, h, tick)?;
        state.clock.lag = model.lag(h);
        state.clock.ticks += 1;
        state.clock.total += 1;
        state.since_haptic += h;
        if let Some(before) = pressing.filter(|_| !work.frozen)
            && sleep::falls_asleep(model, state, h, before)
        {
            read_forces(model, state, work);
        }
    }
    let time = state.clock.time();
    update_loads(model, state, &mut work.before, &mut work.impulse, time);
    if !state
        .displacement
        .iter()
        .all(|u| (u.0[0] + u.0[1] + u.0[2]).is_finite())
    {
        return Err(StepError::NonFinite(state.clock.time()));
    }
    state.extent = state.live.extent(&state.displacement, &mut work.points);
    check_inversion(model, state, &state.extent)?;
    let length = n as f64 * h;
    for (k, tool) in state.tools.iter_mut().enumerate() {
        tool.mean_force = work.impulse[k] / length;
        tool.lines = work.paths[k].lines();
        tool.input.rate = [None; 7];
    }
    read_forces(model, state, work);
    state.length = length;
    if !work.frozen {
        work.slopes.end(state, span as f64 * h);
    }
    Ok(())
}

/// Whether tissue sticks to what tool `k` pushes against.
fn sticks(model: &Model, k: usize) -> bool {
    let grasps = model.scene.tools[k].kind == ToolKind::Grasper;
    !grasps && slide::coefficient(model, k).is_none()
}

/// What moves the pre-computed part has moved since the last haptic tick, at least.
fn drift(model: &Model, state: &mut State) {
    let seconds = state.since_haptic;
    if seconds.is_finite() {
        (state.coupling).drifts(model, &state.velocity, &state.held, seconds);
    }
}

/// How far any point of a tool goes until the next haptic tick \[m\].
fn way(model: &Model, work: &Workspace, tool: usize, h: f64) -> f64 {
    let substeps = (1.0 / (model.scene.integration.haptic_rate * h)).ceil();
    substeps.max(1.0) * work.haste[tool] * model.tools[tool].least_radius()
}

/// What tool `tool` touches and holds, as of now.
fn feel(model: &Model, state: &mut State, work: &mut Workspace, tool: usize, h: f64) {
    let way = way(model, work, tool, h);
    look(model, state, tool, way);
    work.before.remember(model, &state.coupling);
    measure_held(model, state, &mut work.loose);
    while hold::update(
        model,
        state,
        tool,
        &work.loose,
        &mut work.touched,
        &mut work.nearby,
    ) {
        regrip(model, state, work, tool);
        look(model, state, tool, way);
        work.before.remember(model, &state.coupling);
    }
    regrip(model, state, work, tool);
}

/// A new substep length, from the present time on.
fn set_substep(model: &Model, state: &mut State, h: f64) {
    if h != state.clock.substep {
        state.clock.anchor = state.clock.time();
        state.clock.ticks = 0;
        state.clock.substep = h;
    }
    if state.clock.total == 0 {
        state.clock.lag = model.lag(h);
    }
}

/// Before tool `k` is asked what it touches: where the tissue near it is.
fn look(model: &Model, state: &mut State, k: usize, way: f64) {
    if model.parts.touchable == 0 || !hold::feels(model, state, k) {
        return;
    }
    let shape = model.tools[k].at(&state.tools[k].pose);
    // The vertices of a touched triangle are within its longest edge; the rest is for stretch.
    let reach = slide::reach(model, k, way) + slide::STRETCH * model.longest_edge;
    let distance = |at: &Vec3| {
        let each = shape.clone().map(|c| c.axis_distance(at) - c.radius);
        each.fold(f64::INFINITY, f64::min)
    };
    let State {
        coupling,
        displacement,
        held,
        ..
    } = state;
    coupling.update_near(model, displacement, held, reach, distance);
}

/// After a change of what tools hold inside the pre-computed part: it finds its new equilibrium at
/// once, and what that loses is dissipated.
fn regrip(model: &Model, state: &mut State, work: &mut Workspace, tool: usize) {
    if model.precomputed.is_none() || !state.coupling.set_held(model, &state.held) {
        return;
    }
    state.coupling.solve(model, &state.displacement);
    state.account.dissipated -= gained(model, state, &work.before, &mut work.impulse);
    let lag = state.clock.lag;
    for k in 0..work.before.held().len() {
        let dof = work.before.held()[k];
        if state.coupling.holds(dof) {
            continue;
        }
        // The trailing half of what the tool did on it.
        let node = model.parts.moving + dof as usize / 3;
        let velocity = &mut state.velocity[node].0[dof as usize % 3];
        let pressure = work.before.pressure_at(dof);
        state.account.tool_work += 0.5 * lag * *velocity * pressure;
        work.impulse[tool][dof as usize % 3] -= 0.5 * lag * pressure;
        *velocity = 0.0;
        let State {
            coupling,
            displacement,
            held,
            ..
        } = state;
        coupling.springs_back(model, displacement, held, dof as usize / 3);
    }
}

/// What an event inside the pre-computed part has put into the account. The trailing half step of what
/// tools hold through it was made at the pressure before.
pub(crate) fn gained(
    model: &Model,
    state: &mut State,
    before: &Before,
    impulse: &mut [Vec3],
) -> f64 {
    // What slides follows, its forces being as they were.
    press::follow_jump(model, state);
    let half = 0.5 * state.clock.lag;
    for held in &state.held {
        let i = held.node as usize;
        let (Some(inside), Some(tool)) = (i.checked_sub(model.parts.moving), held.tool) else {
            continue;
        };
        for axis in (0..3).filter(|a| held.axes[*a]) {
            let now = state.coupling.pressure_on(inside)[axis];
            let change = now - before.pressure_at((3 * inside + axis) as u32);
            state.account.tool_work -= half * state.velocity[i].0[axis] * change;
            impulse[tool as usize][axis] += half * change;
        }
    }
    before.gained(model, &state.coupling, &state.velocity, 2.0 * half)
}

/// Loads that still grow, as of a time \[s\]. What a ramp changes of the potential -f.u counts as work of
/// the supports.
pub(crate) fn update_loads(
    model: &Model,
    state: &mut State,
    before: &mut Before,
    impulse: &mut [Vec3],
    time: f64,
) {
    let gravity = state.parameters.gravity;
    if state.coupling.amplitudes_change(model, &gravity, time) {
        before.remember(model, &state.coupling);
        state.coupling.set_amplitudes(model, &gravity, time);
        state.coupling.solve(model, &state.displacement);
        state.account.support_work += gained(model, state, before, impulse);
    }
    let mut last = u32::MAX;
    for load in &model.boundary.loads {
        let grows = load.ramp > 0.0 && time <= load.ramp + 2.0 * state.clock.substep;
        let i = load.node as usize;
        // Inside the pre-computed part a load is a drive.
        let moves = i < model.parts.moving && state.live.star_count[i] > 0;
        if !grows || load.node == last || !moves {
            continue;
        }
        last = load.node;
        let before = state.external[i].xyz();
        state.refresh_external_at(model, i, time);
        let middle =
            state.displacement[i].xyz() - state.velocity[i].xyz() * (0.5 * state.clock.lag);
        state.account.support_work -= (state.external[i].xyz() - before).dot(&middle);
    }
}

/// Where held nodes shall be after this substep, tools being there already.
fn set_targets(model: &Model, state: &mut State, h: f64) {
    let time = state.clock.next();
    for held in &mut state.held {
        let i = held.node as usize;
        held.target = match held.tool {
            Some(tool) => state.tools[tool as usize].pose.point(&held.local) - state.live.rest[i],
            None => model.boundary.prescribed[held.support as usize].at(time),
        };
        held.velocity = (held.target - state.displacement[i].xyz()) / h;
    }
}

/// Non-finite or running away at once; an energy residual on two haptic ticks running. `before` is the account before
/// this substep.
pub(crate) fn watch(
    model: &Model,
    state: &mut State,
    before: &Account,
    sums: &Sums,
    kinetic: f64,
    trailing: f64,
    tick: bool,
) -> Result<(), StepError> {
    check_inversion(model, state, &sums.extent)?;
    let critical = || critical_at(model, state, &sums.extent);
    if tick && model.is_nonlinear() && state.clock.substep > critical() {
        return Err(StepError::Unstable(state.clock.substep, critical()));
    }
    let elastic = 0.5 * sums.elastic;
    if !(elastic + kinetic + sums.external + sums.damping).is_finite() {
        return Err(StepError::NonFinite(state.clock.time()));
    }
    if elastic > RUNAWAY * (elastic + kinetic).abs().max(RESIDUAL_FLOOR) {
        return Err(StepError::Energy(state.clock.time(), elastic));
    }
    if tick {
        let balance = elastic + kinetic - sums.external + before.dissipated
            - before.tool_work
            - before.support_work
            - trailing;
        // Explicit Euler's is its own.
        let residual = match model.scheme() {
            Scheme::Euler => 0.0,
            _ => balance - before.start,
        };
        let booked = before.dissipated.abs() + before.support_work.abs() + sums.external.abs();
        let in_play = elastic + kinetic + before.tool_work.abs();
        state.account.most = before.most.max(elastic + kinetic);
        let share = if state.live.is_objective() {
            SPRINGS_OFF
        } else {
            ROUND_OFF
        };
        let limit = RESIDUAL_LIMIT * in_play.max(RESIDUAL_FLOOR)
            + share * booked
            + FRAME_SHARE * before.most;
        let moved = in_play + before.support_work.abs() + (before.dissipated + before.made).abs();
        let grows = model.is_staggered() && before.made > MADE_LIMIT * moved.max(RESIDUAL_FLOOR);
        let strikes = &mut state.account.strikes;
        *strikes = if residual.abs() > limit || grows {
            *strikes + 1
        } else {
            0
        };
        if *strikes >= 2 {
            let off = if grows { before.made } else { residual };
            return Err(StepError::Energy(state.clock.time(), off));
        }
    }
    Ok(())
}

/// What St Venant and Kirchhoff's law turns inside out it leaves so, at rest or nearly.
fn check_inversion(model: &Model, state: &State, extent: &Extent) -> Result<(), StepError> {
    if model.law() == Some(Law::StVenantKirchhoff) && extent.least <= 0.0 {
        return Err(StepError::Inverted(state.clock.time(), extent.least));
    }
    Ok(())
}

/// Before reactions are asked for: those of loose pieces follow from all of the piece.
fn measure_held(model: &Model, state: &State, loose: &mut loose::Scratch) {
    let is_loose = |h: &Held| h.tool.is_some() && state.live.pieces.is_loose(h.node as usize);
    let slides = !state.contacts.is_empty() && !state.live.pieces.loose_nodes().is_empty();
    if slides || state.held.iter().any(is_loose) {
        loose.measure(model, state);
    }
}

/// End-of-step force and torque of each tool.
fn read_forces(model: &Model, state: &mut State, work: &mut Workspace) {
    measure_held(model, state, &mut work.loose);
    let loose = &work.loose;
    for tool in &mut state.tools {
        tool.force = Vec3::zeros();
        tool.torque = Vec3::zeros();
        tool.in_contact = false;
    }
    for at in 0..state.held.len() {
        let held = state.held[at];
        let Some(tool) = held.tool else { continue };
        let force = hold::reaction(model, state, loose, &held);
        let position = state.position(held.node);
        let tool = &mut state.tools[tool as usize];
        tool.force += force;
        tool.torque += (position - tool.pose.position).cross(&force);
        tool.in_contact = true;
    }
    slide::read_forces(model, state, &work.loose, &mut work.slide);
}
