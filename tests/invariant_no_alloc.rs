//! Nothing allocates in a step: not in substeps, nor in contact, nor while cutting.

mod common;

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

struct Counting;

static CALLS: AtomicUsize = AtomicUsize::new(0);

// SAFETY: hands everything to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        CALLS.fetch_add(1, Relaxed);
        // SAFETY: as called.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: as called.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// One test, one thread: the count is everybody's.
#[test]
fn a_step_allocates_nothing() {
    let springs = r#""model": {"kind": "springMass"}, "tools""#;
    for text in [common::BAR, &common::BAR.replace("\"tools\"", springs)] {
        script_allocates_nothing(text);
    }
}

fn script_allocates_nothing(text: &str) {
    let mut s = common::simulation(text);
    let (mut contacts, mut worst) = (0, 0);
    for k in 0..1200 {
        common::script(&mut s, f64::from(k) * 1e-3);
        let before = CALLS.load(Relaxed);
        s.step(1e-3).unwrap();
        worst = worst.max(CALLS.load(Relaxed) - before);
        contacts += u32::from(s.tool(0).in_contact || s.tool(1).in_contact);
    }
    assert_eq!(worst, 0);
    assert!(contacts > 100 && s.state().live.removed.len() > 10);
}
