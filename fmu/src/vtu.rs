//! Meshes and time series as VTK XML files, for ParaView and PyVista.
//!
//! Arrays are inline base64 of little-endian doubles, so values read back bit by bit.
//! Format: <https://docs.vtk.org/en/latest/design_documents/VTKFileFormats.html>.

use crate::picture::base64;
use std::io::{self, Write};

/// What joins the points; 0-based indices.
#[derive(Clone, Copy, Debug)]
#[allow(dead_code)] // the kinds of meshes there are, whichever the commands write
pub enum Cells<'a> {
    Tetrahedra(&'a [[u32; 4]]),
    Triangles(&'a [[u32; 3]]),
    /// Every point for itself.
    Vertices,
}

/// VTK's cell type numbers.
const VTK_VERTEX: u8 = 1;
const VTK_TRIANGLE: u8 = 5;
const VTK_TETRA: u8 = 10;

/// Writes an unstructured grid (`.vtu`) with named point data.
///
/// # Errors
/// `InvalidInput` when a cell's index or a field's length does not fit the points, and whatever
/// the writer reports.
pub fn write_vtu(
    out: &mut impl Write,
    points: &[[f64; 3]],
    cells: Cells,
    point_data: &[(&str, &[[f64; 3]])],
) -> io::Result<()> {
    let own: Vec<[u32; 1]>;
    let (connectivity, corners, kind) = match cells {
        Cells::Tetrahedra(cells) => (cells.as_flattened(), 4, VTK_TETRA),
        Cells::Triangles(cells) => (cells.as_flattened(), 3, VTK_TRIANGLE),
        Cells::Vertices => {
            own = (0..points.len() as u32).map(|i| [i]).collect();
            (own.as_flattened(), 1, VTK_VERTEX)
        }
    };
    if let Some(index) = connectivity
        .iter()
        .find(|&&index| index as usize >= points.len())
    {
        return Err(invalid(format!(
            "cell index {index} with {} points",
            points.len()
        )));
    }
    let count = connectivity.len() / corners;
    writeln!(
        out,
        "<?xml version=\"1.0\"?>\n\
         <VTKFile type=\"UnstructuredGrid\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt64\">\n\
         <UnstructuredGrid>\n<Piece NumberOfPoints=\"{}\" NumberOfCells=\"{count}\">\n<Points>",
        points.len()
    )?;
    write_array(out, "Points", "Float64", 3, doubles(points.as_flattened()))?;
    writeln!(out, "</Points>\n<Cells>")?;
    let indices = connectivity
        .iter()
        .flat_map(|&index| i64::from(index).to_le_bytes());
    write_array(out, "connectivity", "Int64", 1, indices.collect())?;
    let offsets = (1..=count).flat_map(|i| ((i * corners) as i64).to_le_bytes());
    write_array(out, "offsets", "Int64", 1, offsets.collect())?;
    write_array(out, "types", "UInt8", 1, vec![kind; count])?;
    writeln!(out, "</Cells>\n<PointData>")?;
    for (name, data) in point_data {
        if data.len() != points.len() {
            let text = format!(
                "point data '{name}': {} vectors for {} points",
                data.len(),
                points.len()
            );
            return Err(invalid(text));
        }
        write_array(out, name, "Float64", 3, doubles(data.as_flattened()))?;
    }
    writeln!(
        out,
        "</PointData>\n</Piece>\n</UnstructuredGrid>\n</VTKFile>"
    )
}

/// Writes a collection (`.pvd`): times in s and the files that show them, relative to it.
///
/// # Errors
/// Whatever the writer reports.
pub fn write_pvd(out: &mut impl Write, entries: &[(f64, String)]) -> io::Result<()> {
    writeln!(
        out,
        "<?xml version=\"1.0\"?>\n\
         <VTKFile type=\"Collection\" version=\"1.0\" byte_order=\"LittleEndian\">\n<Collection>"
    )?;
    for (time, file) in entries {
        writeln!(
            out,
            "<DataSet timestep=\"{time}\" part=\"0\" file=\"{}\"/>",
            attribute(file)
        )?;
    }
    writeln!(out, "</Collection>\n</VTKFile>")
}

/// The byte count as header, then the bytes, in one base64 run.
fn write_array(
    out: &mut impl Write,
    name: &str,
    kind: &str,
    components: usize,
    bytes: Vec<u8>,
) -> io::Result<()> {
    let mut block = (bytes.len() as u64).to_le_bytes().to_vec();
    block.extend(bytes);
    let shape = match components {
        1 => String::new(),
        n => format!(" NumberOfComponents=\"{n}\""),
    };
    writeln!(
        out,
        "<DataArray type=\"{kind}\" Name=\"{}\"{shape} format=\"binary\">\n{}\n</DataArray>",
        attribute(name),
        base64::encode(&block)
    )
}

fn doubles(values: &[f64]) -> Vec<u8> {
    values
        .iter()
        .flat_map(|value| value.to_le_bytes())
        .collect()
}

fn attribute(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('"', "&quot;")
}

fn invalid(text: String) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidInput, text)
}

#[cfg(test)]
mod tests {
    use super::*;

    const POINTS: [[f64; 3]; 4] = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.1]];

    fn vtu(cells: Cells, data: &[(&str, &[[f64; 3]])]) -> io::Result<String> {
        let mut out = Vec::new();
        write_vtu(&mut out, &POINTS, cells, data)?;
        Ok(String::from_utf8_lossy(&out).into_owned())
    }

    #[test]
    fn counts_types_and_names_are_written() {
        let tetrahedra = [[0, 1, 2, 3]];
        let triangles = [[0, 1, 2], [0, 1, 3]];
        let data = [("a<b", &POINTS[..]), ("u", &POINTS[..])];
        for (cells, count, types) in [
            (Cells::Tetrahedra(&tetrahedra), 1, vec![10]),
            (Cells::Triangles(&triangles), 2, vec![5, 5]),
            (Cells::Vertices, 4, vec![1; 4]),
        ] {
            let text = vtu(cells, &data).unwrap();
            let head = format!("NumberOfPoints=\"4\" NumberOfCells=\"{count}\"");
            let mut block = (types.len() as u64).to_le_bytes().to_vec();
            block.extend(types);
            assert!(text.contains(&head) && text.contains(&base64::encode(&block)));
            assert!(text.contains("Name=\"a&lt;b\" NumberOfComponents"));
            assert!(text.contains("Name=\"u\" NumberOfComponents=\"3\""));
            assert_eq!(
                text.matches("<DataArray").count(),
                text.matches("</DataArray>").count()
            );
        }
    }

    #[test]
    fn misfits_are_refused() {
        let kind = |result: io::Result<String>| result.map_err(|error| error.kind());
        let refused = Err(io::ErrorKind::InvalidInput);
        assert_eq!(kind(vtu(Cells::Triangles(&[[0, 1, 4]]), &[])), refused);
        let short = [("u", &POINTS[..1])];
        assert_eq!(kind(vtu(Cells::Vertices, &short)), refused);
    }

    #[test]
    fn collections_list_times_and_files() {
        let mut out = Vec::new();
        let entries = [(0.0, "a.vtu".to_owned()), (0.1 + 0.2, "b&c.vtu".to_owned())];
        write_pvd(&mut out, &entries).unwrap();
        let text = String::from_utf8_lossy(&out);
        assert!(text.contains("timestep=\"0\" part=\"0\" file=\"a.vtu\""));
        assert!(text.contains("timestep=\"0.30000000000000004\" part=\"0\" file=\"b&amp;c.vtu\""));
    }
}
