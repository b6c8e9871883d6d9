//! Reads Gmsh meshes: 1 (`$NOD`, `$ELM`), 2 to 2.2, and 4.1, all ASCII
//! (<https://gmsh.info/doc/texinfo/gmsh.html#Gmsh-file-formats>).

use std::collections::HashMap;
use std::str::{FromStr, SplitAsciiWhitespace};

use super::{MeshError, TetMesh, Vec3};

/// What is wrong with a line of a Gmsh file, and what would be right.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum GmshFault {
    #[error("`{0}` starts no Gmsh file; `$MeshFormat` or `$NOD` does")]
    NotGmsh(String),
    #[error("the file is binary; export it as ASCII, version 4.1 or 2.2")]
    Binary,
    #[error("version {0} is not read; export as ASCII, version 4.1 or 2.2")]
    Version(String),
    #[error("the file ends here, but {0} should follow")]
    Ends(String),
    #[error("`{found}` is not {needed}")]
    Token { found: String, needed: &'static str },
    #[error("the line ends before {0}")]
    Short(&'static str),
    #[error("`{found}` stands where {needed} should")]
    Misplaced { found: String, needed: String },
    #[error("{found} {what} where {announced} were announced; the two must agree")]
    Count {
        what: &'static str,
        announced: u64,
        found: u64,
    },
    #[error("node number {number} is already that of line {first}; numbers must differ")]
    DuplicateNode { number: u64, first: usize },
    #[error("element {element} names node {node}, which `{section}` does not have")]
    UnknownNode {
        element: u64,
        node: u64,
        section: &'static str,
    },
    #[error("a second `{0}` section; one is needed")]
    SecondSection(String),
    #[error("element {0} is a tetrahedron of {1} nodes; export elements of order 1, with 4")]
    HighOrder(u64, u32),
    #[error("no tetrahedra (elements of type 4) up to here; mesh the volume, and save it too")]
    NoTetrahedra,
}

/// The nodes in file order, and the 4-node tetrahedra; elements of other kinds are passed over.
///
/// Coordinates are taken as they stand, as metres. Node numbers may be any, with gaps; they become
/// 0, 1, 2, ... in file order. Refuses binary files, other versions, tetrahedra of higher order, and
/// whatever a Gmsh file should not be, with the line; never with more memory than the text calls for.
pub fn parse(text: &str) -> Result<TetMesh, MeshError> {
    let mut reader = Reader::new(text);
    let mut dialect = None;
    let mut nodes = None;
    let mut elements = None;
    while let Some(mut words) = reader.next_line() {
        let name = words.next("a section")?;
        if !name.starts_with('$') && dialect.is_none() {
            return Err(words.fault(GmshFault::NotGmsh(clip(name))));
        }
        if !name.starts_with('$') || name.starts_with("$End") || name.starts_with("$END") {
            return Err(words.fault(misplaced(name, "a section's first line, such as `$Nodes`,")));
        }
        if let ("$NOD" | "$ELM", None) = (name, dialect) {
            dialect = Some(Dialect::V1);
        }
        use Dialect::{V1, V2, V4};
        let second = match (dialect, name) {
            (_, "$MeshFormat") => dialect.replace(format(&mut reader)?).is_some(),
            (None, "$Nodes" | "$Elements") => {
                return Err(words.fault(misplaced(name, "`$MeshFormat`")));
            }
            (Some(V1), "$NOD") | (Some(V2), "$Nodes") => {
                nodes.replace(nodes_in_rows(&mut reader, name)?).is_some()
            }
            (Some(V4), "$Nodes") => nodes.replace(nodes_in_blocks(&mut reader)?).is_some(),
            (Some(dialect @ V1), "$ELM") | (Some(dialect @ V2), "$Elements") => elements
                .replace(elements_in_rows(&mut reader, dialect)?)
                .is_some(),
            (Some(V4), "$Elements") => elements.replace(elements_in_blocks(&mut reader)?).is_some(),
            _ => {
                reader.skip(name)?;
                false
            }
        };
        if second {
            return Err(words.fault(GmshFault::SecondSection(clip(name))));
        }
    }

    let Some(dialect) = dialect else {
        return Err(reader.ends("`$MeshFormat` or `$NOD`"));
    };
    let [node_section, element_section] = dialect.sections();
    let missing = |section| reader.ends(format!("`{section}`"));
    let nodes = nodes.ok_or_else(|| missing(node_section))?;
    let elements = elements.ok_or_else(|| missing(element_section))?;
    if elements.is_empty() {
        return Err(at(reader.line, GmshFault::NoTetrahedra));
    }
    let number = |element: &Element, node: u64| match nodes.numbers.get(&node) {
        Some(&(number, _)) => Ok(number),
        None => Err(at(
            element.line,
            GmshFault::UnknownNode {
                element: element.number,
                node,
                section: node_section,
            },
        )),
    };
    let mut tetrahedra = Vec::with_capacity(elements.len());
    for element in &elements {
        let [a, b, c, d] = element.nodes;
        let a = number(element, a)?;
        tetrahedra.push([
            a,
            number(element, b)?,
            number(element, c)?,
            number(element, d)?,
        ]);
    }
    Ok(TetMesh {
        nodes: nodes.positions,
        tetrahedra,
    })
}

#[derive(Clone, Copy, PartialEq)]
enum Dialect {
    V1,
    V2,
    V4,
}

impl Dialect {
    fn sections(self) -> [&'static str; 2] {
        match self {
            Dialect::V1 => ["$NOD", "$ELM"],
            Dialect::V2 | Dialect::V4 => ["$Nodes", "$Elements"],
        }
    }
}

#[derive(Default)]
struct Nodes {
    positions: Vec<Vec3>,
    /// From the file's number to ours and the line.
    numbers: HashMap<u64, (u32, usize)>,
}

impl Nodes {
    fn number(&mut self, number: u64, line: usize) -> Result<(), MeshError> {
        let ours = self.numbers.len() as u32;
        match self.numbers.insert(number, (ours, line)) {
            None => Ok(()),
            Some((_, first)) => Err(at(line, GmshFault::DuplicateNode { number, first })),
        }
    }

    fn place(&mut self, words: &mut Words) -> Result<(), MeshError> {
        let [x, y, z] = [
            words.coordinate()?,
            words.coordinate()?,
            words.coordinate()?,
        ];
        self.positions.push(Vec3::new(x, y, z));
        Ok(())
    }
}

/// A tetrahedron, by the file's numbers.
struct Element {
    number: u64,
    nodes: [u64; 4],
    line: usize,
}

/// `version file-type data-size`, `$EndMeshFormat`
fn format(reader: &mut Reader) -> Result<Dialect, MeshError> {
    let mut words = reader.row("`version file-type data-size`")?;
    let version = words.next("the version")?;
    let dialect = match version {
        "4.1" => Dialect::V4,
        "2" | "2.0" | "2.1" | "2.2" => Dialect::V2,
        _ if version.parse::<f64>().is_ok() => {
            return Err(words.fault(GmshFault::Version(clip(version))));
        }
        _ => return Err(words.fault(GmshFault::token(version, "a format version such as 4.1"))),
    };
    if words.parse::<u64>("the file type, 0 or 1")? != 0 {
        return Err(words.fault(GmshFault::Binary));
    }
    words.parse::<u64>("the data size, such as 8")?;
    words.end()?;
    reader.expect("$EndMeshFormat")?;
    Ok(dialect)
}

/// `count`, then `number x y z` a row.
fn nodes_in_rows(reader: &mut Reader, section: &str) -> Result<Nodes, MeshError> {
    let mut nodes = Nodes::default();
    reader.counted("nodes", section, |words| {
        nodes.number(words.number("a node number")?, words.line)?;
        nodes.place(words)?;
        words.end()
    })?;
    Ok(nodes)
}

/// `count`, then a row an element: in version 2 `number type n-tags tags.. nodes..`, in version 1
/// `number type physical elementary n-nodes nodes..`.
fn elements_in_rows(reader: &mut Reader, dialect: Dialect) -> Result<Vec<Element>, MeshError> {
    let mut elements = Vec::new();
    reader.counted("elements", dialect.sections()[1], |words| {
        let number = words.number("an element number")?;
        let kind = words.number("an element type")?;
        if dialect == Dialect::V2 {
            for _ in 0..words.number("a number of tags")? {
                words.parse::<i64>("a tag, an integer")?;
            }
        } else {
            words.parse::<i64>("a physical region, an integer")?;
            words.parse::<i64>("an elementary region, an integer")?;
            let count = words.number("a number of nodes")?;
            if kind == TETRAHEDRON && count != 4 {
                return Err(words.fault(GmshFault::Count {
                    what: "nodes to an element of type 4",
                    announced: 4,
                    found: count,
                }));
            }
        }
        elements.extend(words.element(number, kind)?);
        Ok(())
    })?;
    Ok(elements)
}

/// `n-blocks n-nodes min max`, then blocks: `dimension entity parametric n`, n numbers, n positions.
fn nodes_in_blocks(reader: &mut Reader) -> Result<Nodes, MeshError> {
    let mut nodes = Nodes::default();
    reader.blocks("nodes", "$Nodes", |reader| {
        let mut words = reader.row("a block's `dimension entity parametric n-nodes`")?;
        words.number("the block's dimension")?;
        words.parse::<i64>("the block's entity, an integer")?;
        words.number("0 or 1: parametric")?;
        let count = words.number("the block's number of nodes")?;
        words.end()?;
        reader.rows("node numbers", count, |words| {
            nodes.number(words.number("a node number")?, words.line)?;
            words.end()
        })?;
        reader.rows("node positions", count, |words| {
            nodes.place(words)?;
            words.finite_rest()
        })?;
        Ok(count)
    })?;
    Ok(nodes)
}

/// `n-blocks n-elements min max`, then blocks: `dimension entity type n`, n rows `number nodes..`.
fn elements_in_blocks(reader: &mut Reader) -> Result<Vec<Element>, MeshError> {
    let mut elements = Vec::new();
    reader.blocks("elements", "$Elements", |reader| {
        let mut words = reader.row("a block's `dimension entity type n-elements`")?;
        words.number("the block's dimension")?;
        words.parse::<i64>("the block's entity, an integer")?;
        let kind = words.number("an element type")?;
        let count = words.number("the block's number of elements")?;
        words.end()?;
        reader.rows("elements", count, |words| {
            let number = words.number("an element number")?;
            elements.extend(words.element(number, kind)?);
            Ok(())
        })?;
        Ok(count)
    })?;
    Ok(elements)
}

/// Gmsh's element type of the 4-node tetrahedron.
const TETRAHEDRON: u64 = 4;

/// Element types of tetrahedra with more nodes, and how many.
const HIGH_ORDER: [(u64, u32); 4] = [(11, 10), (29, 20), (30, 35), (31, 56)];

/// The lines that are not blank.
struct Reader<'a> {
    lines: std::iter::Enumerate<std::str::Lines<'a>>,
    /// The last line read, 1-based.
    line: usize,
}

impl<'a> Reader<'a> {
    fn new(text: &'a str) -> Self {
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        Reader {
            lines: text.lines().enumerate(),
            line: 1,
        }
    }

    fn next_line(&mut self) -> Option<Words<'a>> {
        for (index, text) in self.lines.by_ref() {
            self.line = index + 1;
            if !text.trim_ascii().is_empty() {
                return Some(Words {
                    line: self.line,
                    words: text.split_ascii_whitespace(),
                });
            }
        }
        None
    }

    fn ends(&self, needed: impl Into<String>) -> MeshError {
        at(self.line, GmshFault::Ends(needed.into()))
    }

    fn row(&mut self, needed: &str) -> Result<Words<'a>, MeshError> {
        let words = self.next_line().ok_or_else(|| self.ends(needed))?;
        match words.section() {
            Some(section) => Err(words.fault(misplaced(section, needed))),
            None => Ok(words),
        }
    }

    /// `count` rows with nothing else between.
    fn rows(
        &mut self,
        what: &'static str,
        count: u64,
        mut read: impl FnMut(&mut Words<'a>) -> Result<(), MeshError>,
    ) -> Result<(), MeshError> {
        for found in 0..count {
            let Some(mut words) = self.next_line() else {
                return Err(self.ends(format!("{} more {what}", count - found)));
            };
            if words.section().is_some() {
                return Err(words.fault(GmshFault::Count {
                    what,
                    announced: count,
                    found,
                }));
            }
            read(&mut words)?;
        }
        Ok(())
    }

    /// A row with the count, that many rows, and the section's end.
    fn counted(
        &mut self,
        what: &'static str,
        section: &str,
        read: impl FnMut(&mut Words<'a>) -> Result<(), MeshError>,
    ) -> Result<(), MeshError> {
        let mut words = self.row("a count")?;
        let count = words.number("a count")?;
        words.end()?;
        self.rows(what, count, read)?;
        self.expect(&end_of(section)).map_err(|error| match error {
            MeshError::Gmsh {
                line,
                fault: GmshFault::Misplaced { ref found, .. },
            } if !found.starts_with('$') => {
                let more = 1 + std::iter::from_fn(|| self.next_line())
                    .take_while(|words| words.section().is_none())
                    .count() as u64;
                at(
                    line,
                    GmshFault::Count {
                        what,
                        announced: count,
                        found: count.saturating_add(more),
                    },
                )
            }
            other => other,
        })
    }

    /// `n-blocks n-items min max`, n-blocks blocks of which `read` tells the items, and the section's end.
    fn blocks(
        &mut self,
        what: &'static str,
        section: &str,
        mut read: impl FnMut(&mut Self) -> Result<u64, MeshError>,
    ) -> Result<(), MeshError> {
        let mut words = self.row("`n-blocks n-items min-number max-number`")?;
        let blocks = words.number("a number of blocks")?;
        let announced = words.number("a count")?;
        words.number("the lowest number")?;
        words.number("the highest number")?;
        words.end()?;
        let mut found = 0u64;
        for _ in 0..blocks {
            found = found.saturating_add(read(self)?);
        }
        self.expect(&end_of(section))?;
        if found == announced {
            Ok(())
        } else {
            Err(words.fault(GmshFault::Count {
                what,
                announced,
                found,
            }))
        }
    }

    fn expect(&mut self, needed: &str) -> Result<(), MeshError> {
        let mut words = self
            .next_line()
            .ok_or_else(|| self.ends(format!("`{needed}`")))?;
        match words.next("a word")? {
            found if found == needed => words.end(),
            found => Err(words.fault(misplaced(found, format!("`{needed}`")))),
        }
    }

    /// Past the end of a section that is not read.
    fn skip(&mut self, section: &str) -> Result<(), MeshError> {
        let end = end_of(section);
        loop {
            let Some(words) = self.next_line() else {
                return Err(self.ends(format!("`{}`", clip(&end))));
            };
            if words.section() == Some(&end) {
                return Ok(());
            }
        }
    }
}

/// The words of one line.
struct Words<'a> {
    line: usize,
    words: SplitAsciiWhitespace<'a>,
}

impl<'a> Words<'a> {
    fn fault(&self, fault: GmshFault) -> MeshError {
        at(self.line, fault)
    }

    /// The first word, where it begins or ends a section.
    fn section(&self) -> Option<&'a str> {
        self.words
            .clone()
            .next()
            .filter(|word| word.starts_with('$'))
    }

    fn next(&mut self, needed: &'static str) -> Result<&'a str, MeshError> {
        self.words
            .next()
            .ok_or_else(|| self.fault(GmshFault::Short(needed)))
    }

    fn parse<T: FromStr>(&mut self, needed: &'static str) -> Result<T, MeshError> {
        let word = self.next(needed)?;
        word.parse()
            .map_err(|_| self.fault(GmshFault::token(word, needed)))
    }

    fn number(&mut self, needed: &'static str) -> Result<u64, MeshError> {
        self.parse(needed)
    }

    fn coordinate(&mut self) -> Result<f64, MeshError> {
        let needed = "a coordinate, a finite number";
        let word = self.next(needed)?;
        match word.parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(value),
            _ => Err(self.fault(GmshFault::token(word, needed))),
        }
    }

    fn end(&mut self) -> Result<(), MeshError> {
        match self.words.next() {
            None => Ok(()),
            Some(word) => Err(self.fault(misplaced(word, "the end of the line"))),
        }
    }

    fn finite_rest(&mut self) -> Result<(), MeshError> {
        while self.words.clone().next().is_some() {
            self.coordinate()?;
        }
        Ok(())
    }

    /// The rest of an element's line; `None` where it is no tetrahedron.
    fn element(&mut self, number: u64, kind: u64) -> Result<Option<Element>, MeshError> {
        if let Some(&(_, nodes)) = HIGH_ORDER.iter().find(|(high, _)| *high == kind) {
            return Err(self.fault(GmshFault::HighOrder(number, nodes)));
        }
        if kind != TETRAHEDRON {
            while self.words.clone().next().is_some() {
                self.number("a node number")?;
            }
            return Ok(None);
        }
        let mut nodes = [0; 4];
        for node in &mut nodes {
            *node = self.number("a node number")?;
        }
        self.end()?;
        Ok(Some(Element {
            number,
            nodes,
            line: self.line,
        }))
    }
}

impl GmshFault {
    fn token(found: &str, needed: &'static str) -> Self {
        GmshFault::Token {
            found: clip(found),
            needed,
        }
    }
}

fn at(line: usize, fault: GmshFault) -> MeshError {
    MeshError::Gmsh { line, fault }
}

fn misplaced(found: &str, needed: impl Into<String>) -> GmshFault {
    GmshFault::Misplaced {
        found: clip(found),
        needed: needed.into(),
    }
}

/// `$NOD` ends with `$ENDNOD`, `$Nodes` with `$EndNodes`.
fn end_of(section: &str) -> String {
    let name = section.trim_start_matches('$');
    match name {
        "NOD" | "ELM" => format!("$END{name}"),
        _ => format!("$End{name}"),
    }
}

/// Enough of a word to find it by.
fn clip(word: &str) -> String {
    const LENGTH: usize = 40;
    if word.chars().nth(LENGTH).is_none() {
        return word.into();
    }
    word.chars().take(LENGTH).chain(['…']).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const V1: &str = "\
$NOD
5
7 0 0 0
3 1 0 0
900 0 1 0
12 0 0 1
1 1 1 1
$ENDNOD
$ELM
4
1 2 1 1 3 7 3 900
2 4 1 1 4 7 3 900 12
3 15 0 5 1 7
4 4 1 1 4 3 900 12 1
$ENDELM
";

    const V2: &str = "\
$MeshFormat
2.2 0 8
$EndMeshFormat
$PhysicalNames
1
3 1 \"liver\"
$EndPhysicalNames
$Nodes
5
7 0 0 0
3 1 0 0
900 0 1 0
12 0 0 1
1 1 1 1
$EndNodes
$Elements
4
1 2 2 1 1 7 3 900
2 4 2 1 1 7 3 900 12
3 15 0 7
4 4 4 1 1 1 -2 3 900 12 1
$EndElements
";

    const V4: &str = "\
$MeshFormat
4.1 0 8
$EndMeshFormat
$Entities
0 0 0 1
1 0 0 0 1 1 1 0 0
$EndEntities
$Nodes
3 5 1 900
2 1 1 2
7
3
0 0 0 0.5 0.5
1 0 0 0.5 0.5
2 9 0 0
3 1 0 3
900
12
1
0 1 0
0 0 1
1 1 1
$EndNodes
$Elements
3 4 1 4
2 1 2 1
1 7 3 900
3 1 4 2
2 7 3 900 12
4 3 900 12 1
0 1 15 1
3 7
$EndElements
";

    #[test]
    fn the_same_mesh_in_three_versions() {
        let expected = TetMesh {
            nodes: [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]]
                .map(|node| Vec3::from(node.map(f64::from)))
                .to_vec(),
            tetrahedra: vec![[0, 1, 2, 3], [1, 2, 3, 4]],
        };
        for text in [V1, V2, V4] {
            assert_eq!(parse(text), Ok(expected.clone()));
            let dos = text.replace('\n', "\r\n\r\n");
            assert_eq!(parse(&format!("\u{feff}{dos}")), Ok(expected.clone()));
        }
    }

    #[test]
    fn sections_may_come_in_any_order_after_the_format() {
        let (nodes, elements) = V1.split_at(V1.find("$ELM").unwrap());
        assert_eq!(parse(&format!("{elements}{nodes}")), parse(V1));
        assert_eq!(
            parse(&format!("$Comments\nmade by hand\n$EndComments\n{V2}")),
            parse(V2)
        );
    }

    #[test]
    fn a_truncated_file_is_an_error_and_never_a_panic() {
        for text in [V1, V2, V4] {
            // Without its last line break, a file is still whole.
            for length in 0..text.len() - 1 {
                assert!(parse(&text[..length]).is_err(), "{}", &text[..length]);
            }
        }
    }

    #[test]
    fn a_damaged_byte_never_panics() {
        for text in [V1, V2, V4] {
            for position in 0..text.len() {
                for byte in *b"$-9 x\n." {
                    let mut damaged = text.as_bytes().to_vec();
                    damaged[position] = byte;
                    let _ = parse(std::str::from_utf8(&damaged).unwrap());
                }
                let _ = parse(&format!("{}{}", &text[..position], &text[position + 1..]));
            }
        }
    }
}
