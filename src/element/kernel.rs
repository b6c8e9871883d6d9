//! Which code computes forces: by law, with fibres and penalty or without, for the machine at hand.

use super::tetrahedra::Extent;
use crate::lanes::{self, Four, Plain};
use crate::law::linear::{Hooke, Linear};
use crate::law::response::{Law, Response};
use crate::law::st_venant_kirchhoff::StVenantKirchhoff;
use crate::law::stable_neo_hookean::StableNeoHookean;
use crate::model::tensor_mass::Lane;

/// Forces of elements, in lanes.
#[allow(private_bounds)]
pub trait Kernel {
    fn law(&self) -> Law;

    /// Fibres, or a volume penalty.
    fn has_extra(&self) -> bool;

    /// Adds dW/du \[N\] and returns W \[J\] and how far tissue is deformed.
    ///
    /// # Safety
    /// As [`Four`]; `u` and `to` have an entry for each node of the elements.
    #[doc(hidden)]
    unsafe fn kernel<V: Four, R: Response, const EXTRA: bool>(
        &self,
        u: &[Lane],
        to: &mut [Lane],
    ) -> (f64, Extent);

    /// Adds dW/du \[N\] at displacements u \[m\], a moving node each, to what there is. Returns W \[J\] and how far
    /// tissue is deformed.
    fn add_forces(&self, u: &[Lane], to: &mut [Lane]) -> (f64, Extent) {
        assert!(u.len() == to.len());
        #[cfg(target_arch = "x86_64")]
        if lanes::has_avx2() {
            // SAFETY: it is there; nodes are below the number of moving nodes, and so of `u`, by construction.
            return unsafe { avx2(self, u, to) };
        }
        self.add_forces_plain(u, to)
    }

    /// The same in plain code, for machines without AVX2 and as the fast form's oracle.
    fn add_forces_plain(&self, u: &[Lane], to: &mut [Lane]) -> (f64, Extent) {
        // SAFETY: plain code needs no machine.
        unsafe { dispatch::<Plain, Self>(self, u, to) }
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
unsafe fn avx2<K: Kernel + ?Sized>(own: &K, u: &[Lane], to: &mut [Lane]) -> (f64, Extent) {
    // SAFETY: the caller's.
    unsafe { dispatch::<lanes::Avx2, K>(own, u, to) }
}

#[inline(always)]
unsafe fn dispatch<V: Four, K: Kernel + ?Sized>(
    own: &K,
    u: &[Lane],
    to: &mut [Lane],
) -> (f64, Extent) {
    // SAFETY: the caller's.
    unsafe {
        match (own.law(), own.has_extra()) {
            (Law::Linear, false) => own.kernel::<V, Linear, false>(u, to),
            (Law::Linear, true) => own.kernel::<V, Linear, true>(u, to),
            (Law::StVenantKirchhoff, false) => own.kernel::<V, StVenantKirchhoff, false>(u, to),
            (Law::StVenantKirchhoff, true) => own.kernel::<V, StVenantKirchhoff, true>(u, to),
            (Law::StableNeoHookean, false) => own.kernel::<V, StableNeoHookean, false>(u, to),
            (Law::StableNeoHookean, true) => own.kernel::<V, StableNeoHookean, true>(u, to),
        }
    }
}

/// Of [`Response::parameters`].
pub(super) fn parameters(law: Law, material: &Hooke) -> [f64; 2] {
    match law {
        Law::Linear => Linear::parameters(material),
        Law::StVenantKirchhoff => StVenantKirchhoff::parameters(material),
        Law::StableNeoHookean => StableNeoHookean::parameters(material),
    }
}
