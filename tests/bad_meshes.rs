//! What is no mesh is refused with one line that says where, what, and what would be right.

use tissue::mesh::{TetMesh, Vec3, gmsh, repair};

/// A unit corner, the far corner of its cube, and one below.
const NODES: [[f64; 3]; 6] = [
    [0.0, 0.0, 0.0],
    [1.0, 0.0, 0.0],
    [0.0, 1.0, 0.0],
    [0.0, 0.0, 1.0],
    [1.0, 1.0, 1.0],
    [0.0, 0.0, -1.0],
];

fn refusal(nodes: &[[f64; 3]], tetrahedra: &[[u32; 4]]) -> String {
    let nodes = nodes.iter().map(|&node| Vec3::from(node)).collect();
    let tetrahedra = tetrahedra.to_vec();
    match repair(&mut TetMesh { nodes, tetrahedra }) {
        Ok(report) => panic!("accepted: {report:?}"),
        Err(error) => error.to_string(),
    }
}

#[test]
fn bad_tetrahedra() {
    let table: [(&[[u32; 4]], &str); 10] = [
        (&[], "the mesh has no tetrahedra; at least one is needed"),
        (
            &[[0, 1, 2, 6]],
            "tetrahedron 0 names node 6, but the mesh has nodes 0 to 5",
        ),
        (
            &[[0, 1, 2, 3], [1, 2, 4294967295, 3]],
            "tetrahedron 1 names node 4294967295, but the mesh has nodes 0 to 5",
        ),
        (
            &[[0, 1, 2, 3], [3, 4, 1, 1]],
            "tetrahedron 1 (nodes 3 4 1 1) names a node twice; four different nodes are needed",
        ),
        (
            &[[2, 2, 2, 2]],
            "tetrahedron 0 (nodes 2 2 2 2) names a node twice; four different nodes are needed",
        ),
        (
            &[[0, 1, 3, 5]],
            "tetrahedron 0 (nodes 0 1 3 5) is flat: its volume is 0.000e0 m³ at a longest edge of 2.000e0 m; its nodes must not lie in one plane",
        ),
        (
            &[[0, 1, 2, 3], [1, 2, 3, 4], [0, 1, 2, 3]],
            "tetrahedra 0 and 2 are the same (nodes 0 1 2 3); one must go",
        ),
        (
            &[[0, 1, 2, 3], [3, 1, 0, 2]],
            "tetrahedra 0 and 1 are the same (nodes 0 1 2 3); one must go",
        ),
        (
            &[[0, 1, 2, 3], [0, 1, 2, 4], [0, 1, 2, 5]],
            "tetrahedra 0 1 2 share the face 0 2 1; at most two may",
        ),
        (
            &[[0, 1, 2, 3], [0, 1, 2, 4]],
            "tetrahedra 0 and 1 lie on the same side of their face 0 2 1, so they overlap; neighbours lie on either side",
        ),
    ];
    for (tetrahedra, expected) in table {
        assert_eq!(refusal(&NODES, tetrahedra), expected);
    }
}

#[test]
fn bad_nodes() {
    let table: [(&[[f64; 3]], &str); 6] = [
        (&[], "tetrahedron 0 names node 0, but the mesh has no nodes"),
        (
            &[[0.0; 3]],
            "tetrahedron 0 names node 1, but the mesh has node 0 alone",
        ),
        (
            &[
                [0.0; 3],
                [1.0, f64::NAN, 0.0],
                [0.0, 1.0, 0.0],
                [0.0, 0.0, 1.0],
            ],
            "node 1 is at (1, NaN, 0); its coordinates must be finite",
        ),
        (
            &[
                [0.0; 3],
                [1.0, 0.0, 0.0],
                [0.0, f64::NEG_INFINITY, 0.0],
                [0.0, 0.0, 1.0],
            ],
            "node 2 is at (0, -inf, 0); its coordinates must be finite",
        ),
        (
            &[
                [0.0; 3],
                [1.0, 0.0, 0.0],
                [0.0, 1.0, 0.0],
                [0.5, 0.5, 1e-12],
            ],
            "tetrahedron 0 (nodes 0 1 2 3) is flat: its volume is 1.667e-13 m³ at a longest edge of 1.414e0 m; its nodes must not lie in one plane",
        ),
        (
            &[[0.0; 3]; 4],
            "tetrahedron 0 (nodes 0 1 2 3) is flat: its volume is 0.000e0 m³ at a longest edge of 0.000e0 m; its nodes must not lie in one plane",
        ),
    ];
    for (nodes, expected) in table {
        assert_eq!(refusal(nodes, &[[0, 1, 2, 3]]), expected);
    }
}

const V1: &str =
    "$NOD\n4\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n$ENDNOD\n$ELM\n1\n1 4 1 1 4 1 2 3 4\n$ENDELM\n";
const V2: &str = "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n4\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n$EndNodes\n$Elements\n1\n1 4 2 1 1 1 2 3 4\n$EndElements\n";
const V4: &str = "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n1 4 1 4\n3 1 0 4\n1\n2\n3\n4\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n$EndNodes\n$Elements\n1 1 1 1\n3 1 4 1\n1 1 2 3 4\n$EndElements\n";

#[test]
fn bad_gmsh_files() {
    /// A good file, what is replaced in it by what, and the refusal.
    const TABLE: &[(&str, &str, &str, &str)] = &[
        (
            "",
            "",
            "",
            "line 1: the file ends here, but `$MeshFormat` or `$NOD` should follow",
        ),
        (
            "solid liver\n",
            "",
            "",
            "line 1: `solid` starts no Gmsh file; `$MeshFormat` or `$NOD` does",
        ),
        (
            V2,
            "2.2 0 8",
            "2.2 1 8",
            "line 2: the file is binary; export it as ASCII, version 4.1 or 2.2",
        ),
        (
            V2,
            "2.2 0 8",
            "4 0 8",
            "line 2: version 4 is not read; export as ASCII, version 4.1 or 2.2",
        ),
        (
            V2,
            "2.2 0 8",
            "new 0 8",
            "line 2: `new` is not a format version such as 4.1",
        ),
        (
            V2,
            "2.2 0 8",
            "2.2",
            "line 2: the line ends before the file type, 0 or 1",
        ),
        (
            V2,
            "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n",
            "",
            "line 1: `$Nodes` stands where `$MeshFormat` should",
        ),
        (
            V2,
            "$EndMeshFormat\n",
            "",
            "line 3: `$Nodes` stands where `$EndMeshFormat` should",
        ),
        (
            V2,
            "$Nodes\n4",
            "$Nodes\n99999999999",
            "line 10: 4 nodes where 99999999999 were announced; the two must agree",
        ),
        (V2, "$Nodes\n4", "$Nodes\n-4", "line 5: `-4` is not a count"),
        (
            V2,
            "$Nodes\n4",
            "$Nodes\n3",
            "line 9: 4 nodes where 3 were announced; the two must agree",
        ),
        (
            V2,
            "2 1 0 0",
            "2 1 O 0",
            "line 7: `O` is not a coordinate, a finite number",
        ),
        (
            V2,
            "2 1 0 0",
            "2 1 nan 0",
            "line 7: `nan` is not a coordinate, a finite number",
        ),
        (
            V2,
            "2 1 0 0",
            "2 1 0",
            "line 7: the line ends before a coordinate, a finite number",
        ),
        (
            V2,
            "2 1 0 0",
            "2 1 0 0 0",
            "line 7: `0` stands where the end of the line should",
        ),
        (
            V2,
            "2 1 0 0",
            "1 1 0 0",
            "line 7: node number 1 is already that of line 6; numbers must differ",
        ),
        (
            V2,
            "1 2 3 4\n",
            "1 2 3 5\n",
            "line 13: element 1 names node 5, which `$Nodes` does not have",
        ),
        (
            V2,
            "1 2 3 4\n",
            "1 2 3\n",
            "line 13: the line ends before a node number",
        ),
        (
            V2,
            "1 4 2 1 1",
            "1 4 99999999999 1 1",
            "line 13: the line ends before a tag, an integer",
        ),
        (
            V2,
            "1 4 2 1 1 1 2 3 4",
            "1 11 2 1 1 1 2 3 4 5 6 7 8 9 10",
            "line 13: element 1 is a tetrahedron of 10 nodes; export elements of order 1, with 4",
        ),
        (
            V2,
            "1 4 2 1 1 1 2 3 4",
            "1 2 2 1 1 1 2 3",
            "line 14: no tetrahedra (elements of type 4) up to here; mesh the volume, and save it too",
        ),
        (
            V2,
            "$EndElements\n",
            "",
            "line 13: the file ends here, but `$EndElements` should follow",
        ),
        (
            V2,
            "$EndElements\n",
            "$EndElements\n$Elements\n0\n$EndElements\n",
            "line 15: a second `$Elements` section; one is needed",
        ),
        (
            V2,
            "$EndElements\n",
            "$EndElements\n$NodeData\n1\n",
            "line 16: the file ends here, but `$EndNodeData` should follow",
        ),
        (
            V2,
            "$Elements\n1\n1 4 2 1 1 1 2 3 4\n$EndElements\n",
            "",
            "line 10: the file ends here, but `$Elements` should follow",
        ),
        (
            V2,
            "$EndNodes\n",
            "$EndNodes\n7\n",
            "line 11: `7` stands where a section's first line, such as `$Nodes`, should",
        ),
        (
            V1,
            "1 4 1 1 4 1 2 3 4",
            "1 4 1 1 5 1 2 3 4",
            "line 10: 5 nodes to an element of type 4 where 4 were announced; the two must agree",
        ),
        (
            V1,
            "1 4 1 1 4 1 2 3 4",
            "1 4 1 1 4 1 2 3 -4",
            "line 10: `-4` is not a node number",
        ),
        (
            V1,
            "$ENDELM",
            "$EndElm",
            "line 11: `$EndElm` stands where `$ENDELM` should",
        ),
        (
            V4,
            "1 4 1 4\n",
            "1 5 1 4\n",
            "line 5: 4 nodes where 5 were announced; the two must agree",
        ),
        (
            V4,
            "1 4 1 4\n",
            "2 4 1 4\n",
            "line 15: `$EndNodes` stands where a block's `dimension entity parametric n-nodes` should",
        ),
        (
            V4,
            "3 1 0 4\n",
            "3 1 0 99999999999\n",
            "line 11: `0` stands where the end of the line should",
        ),
        (
            V4,
            "3 1 4 1\n",
            "3 1 4 2\n",
            "line 20: 1 elements where 2 were announced; the two must agree",
        ),
        (
            V4,
            "3 1 4 1\n",
            "3 1 11 1\n",
            "line 19: element 1 is a tetrahedron of 10 nodes; export elements of order 1, with 4",
        ),
        (
            V4,
            "1 1 2 3 4\n",
            "1 1 2 3 44\n",
            "line 19: element 1 names node 44, which `$Nodes` does not have",
        ),
    ];
    for good in [V1, V2, V4] {
        assert!(repair(&mut gmsh::parse(good).unwrap()).is_ok());
    }
    for (good, from, to, expected) in TABLE {
        assert!(good.contains(from), "{from}");
        let text = good.replacen(from, to, 1);
        match gmsh::parse(&text) {
            Ok(mesh) => panic!("accepted: {mesh:?} of {text}"),
            Err(error) => assert_eq!(error.to_string(), *expected, "{text}"),
        }
    }
}

#[test]
fn long_words_are_clipped() {
    let error = gmsh::parse(&"x".repeat(100_000)).unwrap_err().to_string();
    assert!(error.len() < 200, "{error}");
}
