//! Tetrahedra that a substep has to look at, of those that only count where they are deformed far.

use super::Elements;
use super::blend::{self, Blend};
use super::guard;
use crate::model::tensor_mass::Lane;

/// Whatever it holds, results are the same.
#[derive(Debug)]
pub enum Listed {
    Blend(blend::Listed),
    Guard(guard::Listed),
}

impl Listed {
    /// Of tissue with so many moving nodes; none where each tetrahedron counts.
    pub fn new(elements: Option<&Elements>, blend: Option<&Blend>, nodes: usize) -> Option<Listed> {
        if let Some(blend) = blend {
            return Some(Listed::Blend(blend::Listed::new(blend, nodes)));
        }
        let guarded = elements?.guarded()?;
        Some(Listed::Guard(guard::Listed::new(guarded, nodes)))
    }

    /// Nothing is known any more.
    pub fn forget(&mut self) {
        match self {
            Listed::Blend(listed) => listed.forget(),
            Listed::Guard(listed) => listed.forget(),
        }
    }

    pub fn blend(&self) -> Option<&blend::Listed> {
        match self {
            Listed::Blend(listed) => Some(listed),
            Listed::Guard(_) => None,
        }
    }

    pub fn guard(&self) -> Option<&guard::Listed> {
        match self {
            Listed::Blend(_) => None,
            Listed::Guard(listed) => Some(listed),
        }
    }

    /// Lists anew if nodes may have moved too far since, at displacements u \[m\] of a mesh of that revision.
    pub fn refresh(
        &mut self,
        elements: Option<&Elements>,
        blend: Option<&Blend>,
        revision: u64,
        u: &[Lane],
    ) {
        match self {
            Listed::Blend(listed) => {
                if let Some(blend) = blend {
                    listed.refresh(blend, revision, u);
                }
            }
            Listed::Guard(listed) => {
                if let Some(guarded) = elements.and_then(Elements::guarded) {
                    listed.refresh(guarded, revision, u);
                }
            }
        }
    }
}
