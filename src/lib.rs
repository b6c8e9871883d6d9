//! Soft tissue you can press, pull and cut at haptic rate.
//!
//! 1. A scene file becomes a [`scene::Scene`]; [`mesh`] makes or reads its tetrahedra.
//! 2. [`model::Model`] is what never changes: shape gradients, tensors, boundary, spectrum.
//! 3. [`simulation::Simulation`] steps a [`state::State`]: contact, forces, integration, n substeps a
//!    communication step.
//! 4. [`mod@reference`] solves the same scene's statics directly, for comparison.
//!
//! Units are SI throughout. The library knows nothing of FMI.

pub mod calibration;
pub mod contact;
pub mod couple;
pub mod cut;
pub mod element;
pub mod energy;
pub mod haptics;
pub mod inspect;
mod integrate;
mod lanes;
pub mod law;
pub mod live;
pub mod loose;
pub mod mesh;
pub mod model;
pub mod newton;
pub mod pieces;
pub mod pose;
pub mod prepared;
pub mod reference;
pub mod scene;
pub mod simulation;
pub mod sleep;
pub mod snapshot;
pub mod star;
pub mod state;
pub mod statics;
pub mod step;
pub mod tear;
