//! `inspect`: what a scene or FMU amounts to.

use std::path::Path;

use super::{is_fmu, open_fmu, prepare, say};
use crate::error::Error;

pub fn run(path: &Path, json: bool) -> Result<(), Error> {
    let inspection = if is_fmu(path) {
        tissue::inspect::inspect(&open_fmu(path)?)
    } else {
        let model = prepare(path)?;
        tissue::inspect::inspect(&model)
    };
    if json {
        let text = serde_json::to_string_pretty(&inspection)
            .map_err(|e| Error::Content(path.to_path_buf(), e.to_string()))?;
        return say(&text);
    }
    let i = &inspection;
    let mut lines = vec![
        i.name.clone(),
        format!(
            "  mesh         {} vertices, {} edges, {} tetrahedra, {} surface triangles, {} piece(s)",
            i.vertices, i.edges, i.tetrahedra, i.surface_triangles, i.pieces
        ),
        format!(
            "  quality      smallest dihedral angle {:.1} degrees",
            i.minimum_dihedral
        ),
        format!("  tissue       {:.4e} m3, {:.4e} kg", i.volume, i.mass),
    ];
    for (k, share) in i.materials.iter().enumerate() {
        lines.push(format!(
            "  material[{}]  {} tetrahedra, {:.4e} m3, {:.4e} kg",
            k + 1,
            share.tetrahedra,
            share.volume,
            share.mass
        ));
    }
    if i.dynamic_tetrahedra < i.tetrahedra {
        lines.push(format!(
            "  parts        {} tetrahedra dynamic, the rest pre-computed; {} connection nodes, {} touchable",
            i.dynamic_tetrahedra, i.connection_nodes, i.touchable_nodes
        ));
    }
    if let Some(error) = i.interface_error {
        lines.push(format!(
            "  interface    its modes move the equilibrium by {error:.1e}"
        ));
    }
    lines.push(format!(
        "  boundary     {} nodes fixed, {} prescribed, {} loaded",
        i.fixed_nodes, i.prescribed_nodes, i.loaded_nodes
    ));
    let lowest = i
        .lowest_frequency
        .map_or(String::new(), |f| format!("; lowest frequency {f:.4} Hz"));
    lines.push(format!("  damping      {:.4} 1/s{lowest}", i.damping));
    for (scheme, step) in &i.critical_step {
        let step = step.map_or("none".to_string(), |s| format!("{:.4} ms", 1e3 * s));
        lines.push(format!("  critical     {scheme:<18} {step}"));
    }
    let scheme = serde_json::to_string(&i.scheme).unwrap_or_default();
    lines.push(format!("  scheme       {}", scheme.trim_matches('"')));
    lines.push(format!(
        "  substep      {:.4} ms, about {:.1} us each here, without contact",
        1e3 * i.substep,
        1e6 * i.seconds_per_substep
    ));
    if let Some(shares) = &i.substep_shares {
        lines.push(format!(
            "               sweep {:.0} %, coupling {:.0} %, search for contact {:.0} %, rest {:.0} %",
            100.0 * shares.sweep,
            100.0 * shares.coupling,
            100.0 * shares.contact,
            100.0 * shares.rest
        ));
    }
    lines.push(format!(
        "  memory       {:.1} MB an instance",
        i.memory_bytes as f64 / 1e6
    ));
    lines.extend(i.warnings.iter().map(|w| format!("  warning      {w}")));
    say(&lines.join("\n"))
}
