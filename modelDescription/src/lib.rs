//! What a host sees of a model: the one table of variables, and `modelDescription.xml` written from it.

mod table;
mod xml;

pub use table::{
    Causality, Group, Initial, Row, TABLE, Value, Variability, count, exists, felt, posed,
    reference, resolve,
};
pub use xml::{LOG_CATEGORIES, MODEL_DESCRIPTION, guid, write};
