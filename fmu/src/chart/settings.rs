//! What can be chosen for a body: kind of model, law, element, threshold, share, scheme, substep.

use tissue::model::{Model, ModelError};
use tissue::scene::{Elasticity, Element, Form, ModelKind, Region, Scene, Scheme, Selector};

use super::site::Site;

/// What a setting is drawn as.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Family {
    SpringMass,
    QuasiStatic,
    TensorMass,
    Hybrid,
    Adaptive,
    StVenantKirchhoff,
    StableNeoHookean,
}

impl Family {
    pub const ALL: [Family; 7] = [
        Family::SpringMass,
        Family::QuasiStatic,
        Family::TensorMass,
        Family::Hybrid,
        Family::Adaptive,
        Family::StVenantKirchhoff,
        Family::StableNeoHookean,
    ];

    /// As written in the CSV and on sheets.
    pub fn name(self) -> &'static str {
        match self {
            Family::SpringMass => "springs",
            Family::QuasiStatic => "pre-computed",
            Family::TensorMass => "linear",
            Family::Hybrid => "hybrid",
            Family::Adaptive => "adaptive",
            Family::StVenantKirchhoff => "St Venant-Kirchhoff",
            Family::StableNeoHookean => "stable neo-Hookean",
        }
    }
}

/// One way to compute a body.
pub struct SettingRow {
    pub name: &'static str,
    pub family: Family,
    pub sentence: &'static str,
    /// Of a scene's sizes, so many from the coarsest; 0: not charted, for `advise` alone.
    pub sizes: usize,
    /// Whether it is there to be compared with, and no advice.
    pub compared: bool,
    /// Whether `--quick` has it.
    pub quick: bool,
    /// Times the substeps that are chosen.
    pub substeps: f64,
    /// Changes a scene that is otherwise linear, dynamic, of constant strain.
    pub apply: fn(&mut Scene, &Site),
}

impl SettingRow {
    /// The model with as many substeps as the setting has.
    pub fn divided(&self, model: Model) -> Result<Model, ModelError> {
        if self.substeps == 1.0 {
            return Ok(model);
        }
        let period = 1.0 / model.scene.integration.haptic_rate;
        let chosen = (period / model.substep(model.damping())).round();
        let mut scene = model.scene.clone();
        scene.integration.scheme = Some(model.scheme());
        scene.integration.substep = Some(period / (self.substeps * chosen).ceil());
        model.with_scene(scene)
    }
}

/// The full law on an element: what a setting of that element is compared with on the same mesh.
pub fn full_law(element: Element) -> &'static str {
    match element {
        Element::ConstantStrain => "neo-Hookean",
        Element::NodalPressure => "neo-Hookean, nodal pressure",
        Element::NodalAveraged => FULL,
    }
}

/// What the reference is computed with, on a finer mesh.
pub const FULL: &str = "neo-Hookean, averaged";

/// What a row does not say.
const PLAIN: SettingRow = SettingRow {
    name: "",
    family: Family::TensorMass,
    sentence: "",
    sizes: 3,
    compared: false,
    quick: false,
    substeps: 1.0,
    apply: |_, _| {},
};

/// What others are compared with comes first.
pub const SETTINGS: &[SettingRow] = &[
    SettingRow {
        name: FULL,
        family: Family::StableNeoHookean,
        sentence: "stable neo-Hookean law on nodal-averaged elements: what `stableNeoHookean` gives",
        quick: true,
        apply: |scene, _| law(scene, Elasticity::StableNeoHookean, Element::NodalAveraged),
        ..PLAIN
    },
    SettingRow {
        name: "neo-Hookean",
        family: Family::StableNeoHookean,
        sentence: "the same law on constant-strain elements",
        quick: true,
        apply: |scene, _| law(scene, Elasticity::StableNeoHookean, Element::ConstantStrain),
        ..PLAIN
    },
    SettingRow {
        name: "neo-Hookean, nodal pressure",
        family: Family::StableNeoHookean,
        sentence: "the same law on nodal-pressure elements",
        sizes: 2,
        quick: true,
        apply: |scene, _| law(scene, Elasticity::StableNeoHookean, Element::NodalPressure),
        ..PLAIN
    },
    SettingRow {
        name: "neo-Hookean, averaged, c = 0.25",
        family: Family::StableNeoHookean,
        sentence: "nodal-averaged elements with less stabilisation (`hourglass`)",
        sizes: 2,
        apply: |scene, _| {
            law(scene, Elasticity::StableNeoHookean, Element::NodalAveraged);
            scene.model.hourglass = 0.25;
        },
        ..PLAIN
    },
    SettingRow {
        name: "neo-Hookean, averaged, half substep",
        family: Family::StableNeoHookean,
        sentence: "twice as many substeps as are chosen",
        compared: true,
        sizes: 2,
        substeps: 2.0,
        apply: |scene, _| {
            law(scene, Elasticity::StableNeoHookean, Element::NodalAveraged);
        },
        ..PLAIN
    },
    SettingRow {
        name: "neo-Hookean, averaged, longer substep",
        family: Family::StableNeoHookean,
        sentence: "about two thirds of the substeps that are chosen: a smaller margin to the critical one",
        sizes: 2,
        substeps: 2.0 / 3.0,
        apply: |scene, _| {
            law(scene, Elasticity::StableNeoHookean, Element::NodalAveraged);
        },
        ..PLAIN
    },
    SettingRow {
        name: "neo-Hookean, averaged, central difference",
        family: Family::StableNeoHookean,
        sentence: "`centralDifference` in place of `symplecticEuler`",
        sizes: 2,
        apply: |scene, _| {
            law(scene, Elasticity::StableNeoHookean, Element::NodalAveraged);
            scene.integration.scheme = Some(Scheme::CentralDifference);
        },
        ..PLAIN
    },
    SettingRow {
        name: "neo-Hookean, averaged, Runge-Kutta 4",
        family: Family::StableNeoHookean,
        sentence: "`rungeKutta4`, four forces a substep",
        sizes: 2,
        apply: |scene, _| {
            law(scene, Elasticity::StableNeoHookean, Element::NodalAveraged);
            scene.integration.scheme = Some(Scheme::RungeKutta4);
        },
        ..PLAIN
    },
    SettingRow {
        name: "St Venant-Kirchhoff, averaged",
        family: Family::StVenantKirchhoff,
        sentence: "St Venant and Kirchhoff's law on nodal-averaged elements: what `stVenantKirchhoff` gives",
        quick: true,
        apply: |scene, _| law(scene, Elasticity::StVenantKirchhoff, Element::NodalAveraged),
        ..PLAIN
    },
    SettingRow {
        name: "St Venant-Kirchhoff",
        family: Family::StVenantKirchhoff,
        sentence: "the same law on constant-strain elements",
        quick: true,
        apply: |scene, _| {
            law(
                scene,
                Elasticity::StVenantKirchhoff,
                Element::ConstantStrain,
            )
        },
        ..PLAIN
    },
    SettingRow {
        name: "St Venant-Kirchhoff, nodal pressure",
        family: Family::StVenantKirchhoff,
        sentence: "the same law on nodal-pressure elements",
        sizes: 2,
        apply: |scene, _| law(scene, Elasticity::StVenantKirchhoff, Element::NodalPressure),
        ..PLAIN
    },
    SettingRow {
        name: "St Venant-Kirchhoff, polynomial",
        family: Family::StVenantKirchhoff,
        sentence: "the papers' stiffness parameters: the forces of constant strain, summed otherwise",
        compared: true,
        sizes: 2,
        apply: |scene, _| {
            law(
                scene,
                Elasticity::StVenantKirchhoff,
                Element::ConstantStrain,
            );
            scene.model.form = Form::Polynomial;
        },
        ..PLAIN
    },
    SettingRow {
        name: "adaptive, 1/20",
        family: Family::Adaptive,
        sentence: "St Venant and Kirchhoff's law where tetrahedra deform by more than a twentieth of their edge (`nonlinearThreshold`), constant strain",
        sizes: 2,
        apply: |scene, site| adaptive(scene, site.edge / 20.0),
        ..PLAIN
    },
    SettingRow {
        name: "adaptive, 1/10",
        family: Family::Adaptive,
        sentence: "from a tenth on",
        quick: true,
        apply: |scene, site| adaptive(scene, site.edge / 10.0),
        ..PLAIN
    },
    SettingRow {
        name: "adaptive, 1/5",
        family: Family::Adaptive,
        sentence: "from a fifth on",
        sizes: 2,
        apply: |scene, site| adaptive(scene, site.edge / 5.0),
        ..PLAIN
    },
    SettingRow {
        name: "adaptive, 2/5",
        family: Family::Adaptive,
        sentence: "from two fifths on",
        sizes: 2,
        apply: |scene, site| adaptive(scene, site.edge / 2.5),
        ..PLAIN
    },
    SettingRow {
        name: "linear",
        family: Family::TensorMass,
        sentence: "linear tensor-mass on constant-strain elements: the default",
        quick: true,
        ..PLAIN
    },
    SettingRow {
        name: "linear, averaged",
        family: Family::TensorMass,
        sentence: "linear elasticity on nodal-averaged elements",
        quick: true,
        apply: |scene, _| law(scene, Elasticity::Linear, Element::NodalAveraged),
        ..PLAIN
    },
    SettingRow {
        name: "linear, nodal pressure",
        family: Family::TensorMass,
        sentence: "linear elasticity on nodal-pressure elements",
        sizes: 2,
        apply: |scene, _| law(scene, Elasticity::Linear, Element::NodalPressure),
        ..PLAIN
    },
    SettingRow {
        name: "linear, half substep",
        family: Family::TensorMass,
        sentence: "linear, twice as many substeps as are chosen",
        compared: true,
        sizes: 2,
        substeps: 2.0,
        ..PLAIN
    },
    SettingRow {
        name: "linear, central difference",
        family: Family::TensorMass,
        sentence: "linear, `centralDifference`",
        sizes: 2,
        apply: |scene, _| scene.integration.scheme = Some(Scheme::CentralDifference),
        ..PLAIN
    },
    SettingRow {
        name: "linear, Runge-Kutta 4",
        family: Family::TensorMass,
        sentence: "linear, `rungeKutta4`",
        sizes: 2,
        apply: |scene, _| scene.integration.scheme = Some(Scheme::RungeKutta4),
        ..PLAIN
    },
    SettingRow {
        name: "linear, implicit Euler",
        family: Family::TensorMass,
        sentence: "linear, `implicitEuler`, one solution a millisecond",
        compared: true,
        sizes: 2,
        apply: |scene, _| scene.integration.scheme = Some(Scheme::ImplicitEuler),
        ..PLAIN
    },
    SettingRow {
        name: "linear, explicit Euler",
        family: Family::TensorMass,
        sentence: "linear, `euler`, which needs very short substeps",
        compared: true,
        sizes: 1,
        apply: |scene, _| scene.integration.scheme = Some(Scheme::Euler),
        ..PLAIN
    },
    SettingRow {
        name: "springs",
        family: Family::SpringMass,
        sentence: "springs along the edges, stiffness by Van Gelder",
        compared: true,
        quick: true,
        apply: |scene, _| scene.model.kind = ModelKind::SpringMass,
        ..PLAIN
    },
    SettingRow {
        name: "pre-computed",
        family: Family::QuasiStatic,
        sentence: "`quasiStatic`: the compliance of the patch, pre-computed; constant strain",
        quick: true,
        apply: |scene, _| scene.model.kind = ModelKind::QuasiStatic,
        ..PLAIN
    },
    SettingRow {
        name: "pre-computed, averaged",
        family: Family::QuasiStatic,
        sentence: "the same on nodal-averaged elements, which cost nothing while it runs",
        quick: true,
        apply: |scene, _| {
            law(scene, Elasticity::Linear, Element::NodalAveraged);
            scene.model.kind = ModelKind::QuasiStatic;
        },
        ..PLAIN
    },
    SettingRow {
        name: "hybrid 25 %",
        family: Family::Hybrid,
        sentence: "a quarter of the tetrahedra, the nearest to the patch, dynamic and linear; the rest pre-computed; constant strain",
        sizes: 2,
        quick: true,
        apply: |scene, site| hybrid(scene, site, 0.25),
        ..PLAIN
    },
    SettingRow {
        name: "hybrid 50 %",
        family: Family::Hybrid,
        sentence: "half of them dynamic",
        sizes: 2,
        apply: |scene, site| hybrid(scene, site, 0.5),
        ..PLAIN
    },
    SettingRow {
        name: "hybrid 75 %",
        family: Family::Hybrid,
        sentence: "three quarters of them dynamic",
        sizes: 2,
        apply: |scene, site| hybrid(scene, site, 0.75),
        ..PLAIN
    },
    SettingRow {
        name: "hybrid 25 %, 30 modes",
        family: Family::Hybrid,
        sentence: "a quarter dynamic, the 30 softest interface modes (`interfaceModes`)",
        sizes: 2,
        apply: |scene, site| {
            hybrid(scene, site, 0.25);
            scene.model.interface_modes = Some(30);
        },
        ..PLAIN
    },
    SettingRow {
        name: "hybrid 25 %, 90 modes",
        family: Family::Hybrid,
        sentence: "a quarter dynamic, the 90 softest interface modes",
        sizes: 2,
        apply: |scene, site| {
            hybrid(scene, site, 0.25);
            scene.model.interface_modes = Some(90);
        },
        ..PLAIN
    },
    SettingRow {
        name: "hybrid 25 %, neo-Hookean",
        family: Family::Hybrid,
        sentence: "a quarter dynamic with the stable neo-Hookean law on nodal-averaged elements, the rest pre-computed and linear",
        sizes: 2,
        quick: true,
        apply: |scene, site| {
            law(scene, Elasticity::StableNeoHookean, Element::NodalAveraged);
            hybrid(scene, site, 0.25);
        },
        ..PLAIN
    },
    SettingRow {
        name: "hybrid 50 %, neo-Hookean",
        family: Family::Hybrid,
        sentence: "the same with half of the tetrahedra",
        sizes: 2,
        apply: |scene, site| {
            law(scene, Elasticity::StableNeoHookean, Element::NodalAveraged);
            hybrid(scene, site, 0.5);
        },
        ..PLAIN
    },
    SettingRow {
        name: "hybrid 75 %, neo-Hookean",
        family: Family::Hybrid,
        sentence: "the same with three quarters",
        sizes: 2,
        apply: |scene, site| {
            law(scene, Elasticity::StableNeoHookean, Element::NodalAveraged);
            hybrid(scene, site, 0.75);
        },
        ..PLAIN
    },
    SettingRow {
        name: "neo-Hookean, averaged, c = 0.25, longer substep",
        family: Family::StableNeoHookean,
        sentence: "less stabilisation and two thirds of the substeps",
        sizes: 0,
        substeps: 2.0 / 3.0,
        apply: |scene, _| {
            law(scene, Elasticity::StableNeoHookean, Element::NodalAveraged);
            scene.model.hourglass = 0.25;
        },
        ..PLAIN
    },
    SettingRow {
        name: "linear, averaged, longer substep",
        family: Family::TensorMass,
        sentence: "linear elasticity on nodal-averaged elements, two thirds of the substeps",
        sizes: 0,
        substeps: 2.0 / 3.0,
        apply: |scene, _| law(scene, Elasticity::Linear, Element::NodalAveraged),
        ..PLAIN
    },
    SettingRow {
        name: "hybrid 5 %, averaged",
        family: Family::Hybrid,
        sentence: "5 % dynamic, linear on nodal-averaged elements",
        sizes: 0,
        apply: |scene, site| {
            law(scene, Elasticity::Linear, Element::NodalAveraged);
            hybrid(scene, site, 0.05);
        },
        ..PLAIN
    },
    SettingRow {
        name: "hybrid 10 %, averaged",
        family: Family::Hybrid,
        sentence: "10 % dynamic, linear on nodal-averaged elements",
        sizes: 0,
        apply: |scene, site| {
            law(scene, Elasticity::Linear, Element::NodalAveraged);
            hybrid(scene, site, 0.1);
        },
        ..PLAIN
    },
    SettingRow {
        name: "hybrid 25 %, averaged",
        family: Family::Hybrid,
        sentence: "25 % dynamic, linear on nodal-averaged elements",
        sizes: 0,
        apply: |scene, site| {
            law(scene, Elasticity::Linear, Element::NodalAveraged);
            hybrid(scene, site, 0.25);
        },
        ..PLAIN
    },
    SettingRow {
        name: "hybrid 50 %, averaged",
        family: Family::Hybrid,
        sentence: "50 % dynamic, linear on nodal-averaged elements",
        sizes: 0,
        apply: |scene, site| {
            law(scene, Elasticity::Linear, Element::NodalAveraged);
            hybrid(scene, site, 0.5);
        },
        ..PLAIN
    },
    SettingRow {
        name: "hybrid 10 %, averaged, 30 modes",
        family: Family::Hybrid,
        sentence: "10 % dynamic, linear on nodal-averaged elements, the 30 softest interface modes",
        sizes: 0,
        apply: |scene, site| {
            law(scene, Elasticity::Linear, Element::NodalAveraged);
            hybrid(scene, site, 0.1);
            scene.model.interface_modes = Some(30);
        },
        ..PLAIN
    },
    SettingRow {
        name: "hybrid 25 %, averaged, 60 modes",
        family: Family::Hybrid,
        sentence: "25 % dynamic, linear on nodal-averaged elements, the 60 softest interface modes",
        sizes: 0,
        apply: |scene, site| {
            law(scene, Elasticity::Linear, Element::NodalAveraged);
            hybrid(scene, site, 0.25);
            scene.model.interface_modes = Some(60);
        },
        ..PLAIN
    },
    SettingRow {
        name: "hybrid 5 %, neo-Hookean",
        family: Family::Hybrid,
        sentence: "5 % dynamic, the stable neo-Hookean law on nodal-averaged elements",
        sizes: 0,
        apply: |scene, site| {
            law(scene, Elasticity::StableNeoHookean, Element::NodalAveraged);
            hybrid(scene, site, 0.05);
        },
        ..PLAIN
    },
    SettingRow {
        name: "hybrid 10 %, neo-Hookean",
        family: Family::Hybrid,
        sentence: "10 % dynamic, the stable neo-Hookean law on nodal-averaged elements",
        sizes: 0,
        apply: |scene, site| {
            law(scene, Elasticity::StableNeoHookean, Element::NodalAveraged);
            hybrid(scene, site, 0.1);
        },
        ..PLAIN
    },
    SettingRow {
        name: "hybrid 10 %, neo-Hookean, 30 modes",
        family: Family::Hybrid,
        sentence: "10 % dynamic, the stable neo-Hookean law on nodal-averaged elements, the 30 softest interface modes",
        sizes: 0,
        apply: |scene, site| {
            law(scene, Elasticity::StableNeoHookean, Element::NodalAveraged);
            hybrid(scene, site, 0.1);
            scene.model.interface_modes = Some(30);
        },
        ..PLAIN
    },
    SettingRow {
        name: "hybrid 25 %, neo-Hookean, 60 modes",
        family: Family::Hybrid,
        sentence: "25 % dynamic, the stable neo-Hookean law on nodal-averaged elements, the 60 softest interface modes",
        sizes: 0,
        apply: |scene, site| {
            law(scene, Elasticity::StableNeoHookean, Element::NodalAveraged);
            hybrid(scene, site, 0.25);
            scene.model.interface_modes = Some(60);
        },
        ..PLAIN
    },
    SettingRow {
        name: "hybrid 50 %, neo-Hookean, 60 modes",
        family: Family::Hybrid,
        sentence: "50 % dynamic, the stable neo-Hookean law on nodal-averaged elements, the 60 softest interface modes",
        sizes: 0,
        apply: |scene, site| {
            law(scene, Elasticity::StableNeoHookean, Element::NodalAveraged);
            hybrid(scene, site, 0.5);
            scene.model.interface_modes = Some(60);
        },
        ..PLAIN
    },
];

fn law(scene: &mut Scene, elasticity: Elasticity, element: Element) {
    scene.model.elasticity = elasticity;
    scene.model.element = Some(element);
}

fn adaptive(scene: &mut Scene, threshold: f64) {
    scene.model.elasticity = Elasticity::StVenantKirchhoff;
    scene.model.nonlinear_threshold = threshold;
}

/// The tetrahedra that come first are dynamic.
fn hybrid(scene: &mut Scene, site: &Site, share: f64) {
    scene.model.kind = ModelKind::Hybrid;
    scene.model.dynamic = Some(Selector {
        optional: false,
        region: Region::Tetrahedra(site.nearest(share)),
    });
}

#[cfg(test)]
mod tests {
    use super::super::body::Body;
    use super::super::scenes::SCENES;
    use super::*;

    /// A setting is what a scene file can say, on every body; no two are called alike.
    #[test]
    fn every_setting_is_a_scene_of_its_own() {
        for row in &SCENES {
            let body = Body::new(row, row.sizes[0]).unwrap();
            let mut seen = Vec::new();
            for setting in SETTINGS {
                let scene = body.with(setting);
                let text = serde_json::to_string(&scene).unwrap();
                let again = tissue::scene::parse(&text, setting.name);
                assert_eq!(again.unwrap(), scene, "{}", setting.name);
                assert!(SETTINGS.iter().filter(|s| s.name == setting.name).count() == 1);
                let what = (scene.model, scene.integration, setting.substeps.to_bits());
                assert!(!seen.contains(&what), "{} says nothing new", setting.name);
                seen.push(what);
                assert!(setting.sizes <= 3 && !setting.sentence.is_empty());
            }
        }
    }

    /// What a setting is compared with is charted wherever it is, and before it.
    #[test]
    fn full_laws_are_charted() {
        let body = Body::new(&SCENES[1], SCENES[1].sizes[0]).unwrap();
        for (k, setting) in SETTINGS.iter().enumerate() {
            let full = full_law(body.with(setting).model.element());
            let at = SETTINGS.iter().position(|s| s.name == full).unwrap();
            let row = &SETTINGS[at];
            assert!(at <= k && row.sizes >= setting.sizes && (row.quick || !setting.quick));
            assert!(row.family == Family::StableNeoHookean && row.substeps == 1.0);
        }
    }
}
