//! What a scene may say and this version cannot do yet.

use serde::Serialize;

use super::error::SceneError;
use super::parse::extension;
use super::types::*;

/// `PATH: WHAT is not available in this version; INSTEAD` for the first such thing.
pub(super) fn refuse(scene: &Scene) -> Result<(), SceneError> {
    let model = &scene.model;
    let adaptive = model.nonlinear_threshold > 0.0;
    let penalised = model.incompressibility != Incompressibility::Pressure(0.0);
    let polynomial = model.form == Form::Polynomial;
    let splits = scene.cutting.rule == CutRule::Duplicate;
    let format = match &scene.mesh {
        MeshSource::File { file, .. } => extension(file),
        _ => "msh",
    };
    let text = |path: &str| path.to_string();
    // The equilibrium of springs is no linear system.
    let springs = model.kind == ModelKind::SpringMass;
    let settled = springs && scene.start == Start::Equilibrium;
    #[rustfmt::skip]
    let table = vec![
        (settled, text("start"), format!("{} with {}", word(&scene.start), word(&model.kind)), "use rest"),
        (adaptive && polynomial, text("model.form"), format!("{} with a non-linear threshold", word(&model.form)), "use perTetrahedron"),
        ((adaptive || polynomial) && penalised, text("model.incompressibility"), format!("a volume penalty with {}", if polynomial {"polynomial"} else {"a non-linear threshold"}), "use 0"),
        (polynomial && splits, text("cutting.rule"), format!("duplicate with {}", word(&model.form)), "use remove"),
        (!format.eq_ignore_ascii_case("msh"), text("mesh.file"), format!("the mesh format .{format}"), "use .msh"),
    ];
    unsuited(scene)?;
    match table.into_iter().find(|(refused, ..)| *refused) {
        None => Ok(()),
        Some((_, path, what, instead)) => {
            let message = format!("{what} is not available in this version; {instead}");
            Err(SceneError::at("", path, message))
        }
    }
}

/// What a scheme cannot do at all.
fn unsuited(scene: &Scene) -> Result<(), SceneError> {
    let scheme = scene.integration.scheme;
    let staggered = matches!(
        scheme,
        None | Some(Scheme::SymplecticEuler | Scheme::CentralDifference)
    );
    if scene.model.interface_mass == InterfaceMass::Guyan && !staggered {
        return Err(SceneError::at(
            "",
            "model.interfaceMass",
            "guyan needs integration.scheme symplecticEuler or centralDifference",
        ));
    }
    let splits = scene.cutting.rule == CutRule::Duplicate;
    if splits && scene.integration.mass == Mass::Uniform {
        // One mass for all nodes cannot be shared between the halves of one.
        return Err(SceneError::at(
            "",
            "cutting.rule",
            "duplicate needs integration.mass lumped",
        ));
    }
    if splits && scene.model.interface_mass == InterfaceMass::Guyan {
        return Err(SceneError::at(
            "",
            "cutting.rule",
            "duplicate needs model.interfaceMass lumped",
        ));
    }
    if !splits && scene.cutting.spare_vertices.is_some() {
        return Err(SceneError::at(
            "",
            "cutting.spareVertices",
            "only duplicate makes vertices; cutting.rule must be duplicate",
        ));
    }
    let springs = scene.model.kind == ModelKind::SpringMass;
    let nonlinear = scene.model.elasticity != Elasticity::Linear;
    if (springs || nonlinear) && scheme == Some(Scheme::ImplicitEuler) {
        // Its factor is that of a matrix that does not change.
        let law = if springs {
            word(&scene.model.kind)
        } else {
            word(&scene.model.elasticity)
        };
        return Err(SceneError::at(
            "",
            "integration.scheme",
            format!("implicitEuler needs a linear model; {law} must have another scheme"),
        ));
    }
    let element = scene.model.element();
    if scheme == Some(Scheme::ImplicitEuler) && element != Element::ConstantStrain {
        // Its factor is renewed tetrahedron by tetrahedron.
        return Err(SceneError::at(
            "",
            "integration.scheme",
            format!(
                "implicitEuler needs constantStrain; {} must have another scheme",
                word(&element)
            ),
        ));
    }
    let penalised = scene.model.incompressibility != Incompressibility::Pressure(0.0);
    if penalised && !nonlinear {
        return Err(SceneError::at(
            "",
            "model.incompressibility",
            "measures volumes of large deformation; needs model.elasticity stVenantKirchhoff or stableNeoHookean",
        ));
    }
    adapted(&scene.model, scene.start)?;
    for (k, tool) in scene.tools.iter().enumerate() {
        rubs(tool, scheme)
            .map_err(|what| SceneError::at("", format!("tools[{k}].friction"), what))?;
        slips(tool, scheme)
            .map_err(|what| SceneError::at("", format!("tools[{k}].slipForce"), what))?;
    }
    if springs && nonlinear {
        return Err(SceneError::at(
            "",
            "model.elasticity",
            "springMass has a law of its own; must be linear",
        ));
    }
    if springs && element != Element::ConstantStrain {
        return Err(SceneError::at(
            "",
            "model.element",
            "springMass has edges alone; must be constantStrain",
        ));
    }
    if scene.model.kind == ModelKind::QuasiStatic && nonlinear {
        return Err(SceneError::at(
            "",
            "model.elasticity",
            "what is pre-computed is linear; quasiStatic must have linear",
        ));
    }
    let polynomial = scene.model.form == Form::Polynomial;
    if polynomial && scene.model.elasticity != Elasticity::StVenantKirchhoff {
        let law = word(&scene.model.elasticity);
        return Err(SceneError::at(
            "",
            "model.form",
            format!("polynomial needs stVenantKirchhoff; must be perTetrahedron with {law}"),
        ));
    }
    if polynomial && scene.model.element() != Element::ConstantStrain {
        let element = word(&scene.model.element());
        return Err(SceneError::at(
            "",
            "model.element",
            format!("{element} has no polynomial form; must be constantStrain"),
        ));
    }
    if scheme == Some(Scheme::Euler) && scene.integration.damping == Some(0.0) {
        return Err(SceneError::at("", "integration.damping", EULER_UNDAMPED));
    }
    Ok(())
}

/// Where there is no friction coefficient.
fn rubs(tool: &Tool, scheme: Option<Scheme>) -> Result<(), String> {
    let staggered = [Scheme::SymplecticEuler, Scheme::CentralDifference];
    match (tool.friction, tool.kind, scheme) {
        (Friction::Stick, ..) => Ok(()),
        (_, ToolKind::Grasper, _) => {
            Err("belongs to what pushes; a grasper holds, and must have \"stick\"".to_string())
        }
        (.., Some(scheme)) if !staggered.contains(&scheme) => Err(format!(
            "a coefficient needs integration.scheme symplecticEuler or centralDifference; must be \"stick\" with {}",
            word(&scheme)
        )),
        _ => Ok(()),
    }
}

/// Where nothing slips.
fn slips(tool: &Tool, scheme: Option<Scheme>) -> Result<(), String> {
    let staggered = [Scheme::SymplecticEuler, Scheme::CentralDifference];
    match (tool.slip_force, tool.kind, scheme) {
        (None, ..) => Ok(()),
        (_, ToolKind::Grasper, Some(scheme)) if !staggered.contains(&scheme) => Err(format!(
            "needs integration.scheme symplecticEuler or centralDifference; must be null with {}",
            word(&scheme)
        )),
        (_, ToolKind::Grasper, _) => Ok(()),
        _ => Err(
            "belongs to a grasper; what pushes slides by its friction coefficient; must be null"
                .to_string(),
        ),
    }
}

/// What a non-linear threshold does not go with.
fn adapted(model: &ModelSettings, start: Start) -> Result<(), SceneError> {
    let adaptive = model.nonlinear_threshold > 0.0;
    let per_vertex = model.adaptive == Adaptive::PerVertex;
    let element = model.element();
    let table = [
        (
            adaptive && model.elasticity == Elasticity::Linear,
            "model.nonlinearThreshold",
            "has no law beyond it; needs model.elasticity stVenantKirchhoff or stableNeoHookean"
                .to_string(),
        ),
        (
            adaptive && element != Element::ConstantStrain,
            "model.element",
            format!(
                "{} knows no threshold; must be constantStrain with model.nonlinearThreshold",
                word(&element)
            ),
        ),
        (
            per_vertex && !adaptive,
            "model.adaptive",
            "perVertex needs model.nonlinearThreshold above 0".to_string(),
        ),
        (
            per_vertex && start == Start::Equilibrium,
            "start",
            "perVertex has forces without an energy, and no equilibrium to find; must be rest"
                .to_string(),
        ),
    ];
    match table.into_iter().find(|(refused, ..)| *refused) {
        None => Ok(()),
        Some((_, path, message)) => Err(SceneError::at("", path, message)),
    }
}

/// Explicit Euler has no stable substep then.
pub const EULER_UNDAMPED: &str =
    "is 0, at which euler is unstable at any substep; must be more, or another scheme";

/// As the scene file spells it.
fn word(value: &impl Serialize) -> String {
    match serde_json::to_value(value) {
        Ok(serde_json::Value::String(word)) => word,
        _ => "this".into(),
    }
}
