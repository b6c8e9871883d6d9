//! Strict reading of a JSON tree: each complaint carries the path, what was found and what would be right.

use serde::de::value::StrDeserializer;
use serde::de::{self, Deserialize};
use serde_json::{Map, Value};

use super::SceneError;

pub(super) type Result<T, E = SceneError> = std::result::Result<T, E>;

/// A value of the tree, or the absence of one, and the way there.
#[derive(Clone, Copy)]
pub(super) struct Node<'a> {
    value: Option<&'a Value>,
    step: Option<(&'a Node<'a>, Step)>,
}

#[derive(Clone, Copy)]
enum Step {
    Key(&'static str),
    Item(usize),
}

impl<'a> Node<'a> {
    pub fn root(value: &'a Value) -> Self {
        Self {
            value: Some(value),
            step: None,
        }
    }

    fn path(&self) -> String {
        match self.step {
            None => String::new(),
            Some((parent, Step::Key(key))) => join(&parent.path(), key),
            Some((parent, Step::Item(i))) => format!("{}[{i}]", parent.path()),
        }
    }

    /// `what; right`, at this node.
    pub fn wrong(&self, what: &str, right: &str) -> SceneError {
        SceneError::at("", self.path(), format!("{what}; {right}"))
    }

    /// Missing, or of the wrong kind.
    pub fn expected(&self, right: &str) -> SceneError {
        let what = self.value.map_or("missing".into(), |value| {
            format!("found {}", describe(value))
        });
        self.wrong(&what, &format!("must be {right}"))
    }

    /// The default where the key is absent.
    pub fn or<T>(&self, default: T, read: impl Fn(&Self) -> Result<T>) -> Result<T> {
        if self.value.is_some() {
            read(self)
        } else {
            Ok(default)
        }
    }

    /// `None` where the key is absent or null.
    pub fn maybe<T>(&self, read: impl Fn(&Self) -> Result<T>) -> Result<Option<T>> {
        if matches!(self.value, None | Some(Value::Null)) {
            Ok(None)
        } else {
            read(self).map(Some)
        }
    }

    /// Any number in JSON is finite: what overflows is refused before.
    pub fn number(&self) -> Result<f64> {
        self.number_in("", |_| true)
    }

    pub fn positive(&self) -> Result<f64> {
        self.number_in("above 0", |x| x > 0.0)
    }

    pub fn not_negative(&self) -> Result<f64> {
        self.number_in("0 or more", |x| x >= 0.0)
    }

    pub fn number_in(&self, range: &str, holds: impl Fn(f64) -> bool) -> Result<f64> {
        match (self.value, self.value.and_then(Value::as_f64)) {
            (_, Some(x)) if holds(x) => Ok(x),
            (Some(value), Some(_)) => Err(self.wrong(
                &format!("{value} is out of range"),
                &format!("must be {range}"),
            )),
            _ => Err(self.expected(format!("a number {range}").trim_end())),
        }
    }

    /// A whole number of at least `least`, and what 32 bits hold.
    pub fn whole(&self, least: u32) -> Result<u32> {
        let x = self.value.and_then(Value::as_f64).unwrap_or(f64::NAN);
        if x.fract() == 0.0 && (f64::from(least)..=f64::from(u32::MAX)).contains(&x) {
            return Ok(x as u32);
        }
        Err(self.expected(&match x > f64::from(u32::MAX) {
            true => format!("a whole number, {} or less", u32::MAX),
            false => format!("a whole number, {least} or more"),
        }))
    }

    pub fn index(&self) -> Result<u32> {
        self.whole(0)
    }

    pub fn boolean(&self) -> Result<bool> {
        self.value
            .and_then(Value::as_bool)
            .ok_or_else(|| self.expected("true or false"))
    }

    pub fn text(&self, right: &str, holds: impl Fn(&str) -> bool) -> Result<&'a str> {
        let text = self
            .value
            .and_then(Value::as_str)
            .filter(|text| holds(text));
        text.ok_or_else(|| self.expected(right))
    }

    pub fn is_number(&self) -> bool {
        self.value.is_some_and(Value::is_number)
    }

    pub fn is_text(&self, text: &str) -> bool {
        self.value.and_then(Value::as_str) == Some(text)
    }

    pub fn is_object(&self) -> bool {
        self.value.is_some_and(Value::is_object)
    }

    pub fn has(&self, key: &str) -> bool {
        self.value.is_some_and(|value| value.get(key).is_some())
    }

    /// A word of the enum `T`, as serde names its variants.
    pub fn choice<T: Deserialize<'a>>(&self) -> Result<T> {
        let word = self.value.and_then(Value::as_str);
        T::deserialize(StrDeserializer::new(word.unwrap_or_default())).map_err(|NotAmong(known)| {
            let all = quoted_list(known, "or");
            match word {
                Some(word) => {
                    let what = format!("unknown value {}", quoted(word));
                    self.wrong(
                        &what,
                        &format!("did you mean {:?}? must be {all}", nearest(word, known).0),
                    )
                }
                None => self.expected(&all),
            }
        })
    }

    fn items(&self, right: &str) -> Result<&'a [Value]> {
        match self.value {
            Some(Value::Array(items)) => Ok(items),
            _ => Err(self.expected(right)),
        }
    }

    fn item(&'a self, i: usize, value: &'a Value) -> Self {
        Self {
            value: Some(value),
            step: Some((self, Step::Item(i))),
        }
    }

    pub fn list<T>(&self, of: &str, read: impl Fn(&Node) -> Result<T>) -> Result<Vec<T>> {
        let items = self.items(&format!("a list of {of}"))?;
        items
            .iter()
            .enumerate()
            .map(|(i, value)| read(&self.item(i, value)))
            .collect()
    }

    /// A list with something in it.
    pub fn filled<T>(&self, of: &str, read: impl Fn(&Node) -> Result<T>) -> Result<Vec<T>> {
        let items = self.list(of, read)?;
        if items.is_empty() {
            return Err(self.expected(&format!("a list of {of}, at least one")));
        }
        Ok(items)
    }

    pub fn array<T: Copy + Default, const N: usize>(
        &self,
        of: &str,
        read: impl Fn(&Node) -> Result<T>,
    ) -> Result<[T; N]> {
        let right = || format!("a list of {N} {of}");
        let Some(Value::Array(items)) = self
            .value
            .filter(|v| v.as_array().is_some_and(|a| a.len() == N))
        else {
            return Err(self.expected(&right()));
        };
        let mut out = [T::default(); N];
        for (i, value) in items.iter().enumerate() {
            out[i] = read(&self.item(i, value))?;
        }
        Ok(out)
    }

    pub fn vector<const N: usize>(&self) -> Result<[f64; N]> {
        self.array("numbers", |n| n.number())
    }

    /// A vector that has a direction.
    pub fn direction(&self) -> Result<[f64; 3]> {
        let vector = self.vector()?;
        if vector == [0.0; 3] {
            return Err(self.wrong("has length 0", "must point somewhere, such as [0, 0, 1]"));
        }
        Ok(vector)
    }

    /// This object, with no key but these.
    pub fn known(&self, keys: &[&str]) -> Result<&'a Map<String, Value>> {
        let Some(Value::Object(object)) = self.value else {
            return Err(match keys.len() {
                0..10 => {
                    let keys = quoted_list(keys, "and");
                    self.expected(&format!("an object with keys among {keys}"))
                }
                _ => self.expected("an object"),
            });
        };
        match object.keys().find(|key| !keys.contains(&key.as_str())) {
            None => Ok(object),
            Some(key) => {
                let (near, distance) = nearest(key, keys);
                let far = 2 * distance > key.chars().count().max(near.len());
                let known = if far {
                    format!(" known here: {}", quoted_list(keys, "and"))
                } else {
                    String::new()
                };
                let message = format!("unknown key {}; did you mean {near:?}?{known}", quoted(key));
                Err(SceneError::at("", join(&self.path(), key), message))
            }
        }
    }

    /// The values of the object's known keys, in the order asked.
    pub fn keys<const N: usize>(&'a self, keys: [&'static str; N]) -> Result<[Self; N]> {
        let object = self.known(&keys)?;
        Ok(keys.map(|key| Self {
            value: object.get(key),
            step: Some((self, Step::Key(key))),
        }))
    }

    /// The one of these keys that stands in the object.
    pub fn one_of(&'a self, keys: &[&'static str]) -> Result<(&'static str, Self)> {
        let mut present = keys.iter().copied().filter(|key| self.has(key));
        let right = || format!("must hold exactly one of {}", quoted_list(keys, "and"));
        match (present.next(), present.next()) {
            (Some(key), None) => {
                let value = self.value.and_then(|value| value.get(key));
                Ok((
                    key,
                    Self {
                        value,
                        step: Some((self, Step::Key(key))),
                    },
                ))
            }
            (Some(a), Some(b)) => Err(self.wrong(&format!("holds both {a:?} and {b:?}"), &right())),
            _ => Err(self.wrong("holds none", &right())),
        }
    }
}

pub(super) fn join(path: &str, key: &str) -> String {
    let plain = key.len() <= 40
        && key
            .chars()
            .all(|c| c.is_alphanumeric() || "_$-".contains(c));
    match (plain, path.is_empty()) {
        (true, true) => key.into(),
        (true, false) => format!("{path}.{key}"),
        (false, _) => format!("{path}[{}]", quoted(key)),
    }
}

/// On one line, and not longer than a message bears.
pub(super) fn quoted(text: &str) -> String {
    match text.char_indices().nth(40) {
        Some((end, _)) => format!("{:?}", format!("{}…", &text[..end])),
        None => format!("{text:?}"),
    }
}

fn quoted_list(words: &[&str], last: &str) -> String {
    let words: Vec<_> = words.iter().map(|word| format!("{word:?}")).collect();
    match words.split_last() {
        Some((end, rest)) if !rest.is_empty() => format!("{} {last} {end}", rest.join(", ")),
        _ => words.concat(),
    }
}

fn describe(value: &Value) -> String {
    match value {
        Value::Null => "null".into(),
        Value::Bool(value) => value.to_string(),
        Value::Number(value) => format!("the number {value}"),
        Value::String(value) => format!("the string {}", quoted(value)),
        Value::Array(items) => match items.len() {
            0 => "an empty list".into(),
            n => format!("a list of {n}"),
        },
        Value::Object(_) => "an object".into(),
    }
}

/// The known word nearest to this one, and its distance.
fn nearest<'a>(word: &str, known: &[&'a str]) -> (&'a str, usize) {
    let near = known
        .iter()
        .map(|k| (*k, edit_distance(word, k)))
        .min_by_key(|(_, distance)| *distance);
    near.unwrap_or_default()
}

/// Levenshtein distance, case ignored.
fn edit_distance(a: &str, b: &str) -> usize {
    let [a, b] = [a, b].map(|text| text.to_lowercase().chars().collect::<Vec<_>>());
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, x) in a.iter().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, y) in b.iter().enumerate() {
            let replaced = diagonal + usize::from(x != y);
            diagonal = row[j + 1];
            row[j + 1] = replaced.min(diagonal + 1).min(row[j] + 1);
        }
    }
    row[b.len()]
}

/// The variants an enum knows, when it does not know a word.
#[derive(Debug)]
struct NotAmong(&'static [&'static str]);

impl std::fmt::Display for NotAmong {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(f, "not one of {}", quoted_list(self.0, "and"))
    }
}

impl std::error::Error for NotAmong {}

impl de::Error for NotAmong {
    fn custom<T: std::fmt::Display>(_: T) -> Self {
        Self(&[])
    }

    fn unknown_variant(_: &str, expected: &'static [&'static str]) -> Self {
        Self(expected)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edit_distance_counts_changes_but_not_case() {
        let table = [
            ("", "", 0),
            ("ab", "", 2),
            ("kitten", "sitting", 3),
            ("hapticRate", "hapticrate", 0),
        ];
        for (a, b, distance) in table {
            assert_eq!(
                (edit_distance(a, b), edit_distance(b, a)),
                (distance, distance)
            );
        }
    }

    #[test]
    fn what_is_quoted_stays_on_one_line_and_short() {
        assert_eq!(quoted("a\nb"), r#""a\nb""#);
        assert_eq!(quoted(&"é".repeat(50)), format!("\"{}…\"", "é".repeat(40)));
    }
}
