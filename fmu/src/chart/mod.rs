//! Speed against accuracy: every setting of [`settings`] on every body of [`scenes`], measured and compared.
//!
//! A setting, a scene or a gesture is a row of a table. [`mod@body`] makes a scene's mesh and grip at a size, [`site`] says what of it comes first, [`measure`]
//! runs it, [`compare`] puts shapes of different meshes side by side, [`desk`] compares a run with the reference,
//! [`work`] counts what a substep computes. [`study`] decides what is run and what is known already, [`record`] is a row
//! of the CSV, [`front`](mod@front) finds what nothing beats, and [`sheet`] draws it. [`maps`] and [`map_points`] run the points of the
//! stability maps, [`map_sheet`] draws them. [`mod@random`] draws scenes from the region that shall hold, [`random_run`] runs them. [`rate`] finds how much tissue runs at 1 kHz.

pub mod body;
pub mod compare;
pub mod desk;
pub mod front;
pub mod map_points;
pub mod map_sheet;
pub mod maps;
pub mod measure;
pub mod random;
pub mod random_run;
pub mod rate;
pub mod record;
pub mod scenes;
pub mod settings;
pub mod sheet;
pub mod site;
pub mod study;
pub mod work;
