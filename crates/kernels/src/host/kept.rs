//! Weights that stay packed from product to product.
//!
//! Few rows are multiplied in hardly more time than it takes to pack what they are multiplied with. Who
//! asks a small network again and again with the same weights, as a sampler does, need not pack them
//! again and again.

use std::any::Any;
use std::cell::RefCell;
use std::collections::HashMap;
use std::sync::Arc;

use super::packing::Weight;
use super::product::panel_width;

/// Rows from which on packing is little beside multiplying.
const FEW_ROWS: usize = 64;

/// Elements that are kept at most, 16 MiB: what no cache holds is packed as fast as it is read.
const MOST_ELEMENTS: usize = 4 << 20;

thread_local! {
    static KEPT: RefCell<Option<Kept>> = const { RefCell::new(None) };
}

#[derive(Default)]
struct Kept {
    /// By the place of a weight in memory, which its owner does not leave, and its shape.
    weights: HashMap<(usize, [usize; 3]), KeptWeight>,
    elements: usize,
}

struct KeptWeight {
    _owner: Box<dyn Any>,
    panels: Option<Arc<Vec<f32>>>,
}

/// Runs `work` on this thread. Products of few rows within it keep the weights that they pack, up to
/// 16 MiB of them, until it ends. Results are the very same.
pub fn keeping_packed_weights<R>(work: impl FnOnce() -> R) -> R {
    struct Outermost;
    impl Drop for Outermost {
        fn drop(&mut self) {
            KEPT.set(None);
        }
    }
    let _outermost = KEPT.with_borrow_mut(|kept| match kept {
        Some(_) => None,
        None => {
            *kept = Some(Kept::default());
            Some(Outermost)
        }
    });
    work()
}

/// Allows a weight of this shape to be kept. As long as it exists, its owner leaves the weight where
/// it is, and as it is.
pub(crate) fn allow<T: Any>(weight: &[f32], shape: [usize; 3], owner: impl FnOnce() -> T) {
    KEPT.with_borrow_mut(|kept| {
        let Some(kept) = kept else { return };
        if kept.elements + weight.len() > MOST_ELEMENTS {
            return;
        }
        let key = (weight.as_ptr().addr(), shape);
        kept.weights.entry(key).or_insert_with(|| {
            kept.elements += weight.len();
            KeptWeight {
                _owner: Box::new(owner()),
                panels: None,
            }
        });
    });
}

/// The panels of a weight, if it may be kept, for so many rows.
pub(super) fn panels(weight: &Weight<'_>, rows: usize) -> Option<Arc<Vec<f32>>> {
    if rows > FEW_ROWS || !weight.gathers() {
        return None;
    }
    KEPT.with_borrow_mut(|kept| {
        let key = (weight.data.as_ptr().addr(), weight.shape);
        let kept = kept.as_mut()?.weights.get_mut(&key)?;
        let pack = || Arc::new(weight.packed(panel_width()));
        Some(Arc::clone(kept.panels.get_or_insert_with(pack)))
    })
}

#[cfg(test)]
mod tests {
    use super::super::packing::Direction;
    use super::*;

    fn weight(data: &[f32], shape: [usize; 3]) -> Weight<'_> {
        Weight {
            data,
            shape,
            direction: Direction::Gather,
        }
    }

    #[test]
    fn what_may_be_kept_is_packed_once_and_let_go_at_the_end() {
        let data = Arc::new(vec![1.0_f32; 70 * 20]);
        let shape = [70, 20, 1];
        let panels = |rows| super::panels(&weight(&data, shape), rows);
        allow(&data, shape, || Arc::clone(&data));
        assert!(panels(20).is_none(), "not asked to");
        keeping_packed_weights(|| {
            assert!(panels(20).is_none(), "not allowed");
            allow(&data, shape, || Arc::clone(&data));
            let first = panels(20).expect("panels");
            assert_eq!(first.len(), 70_usize.next_multiple_of(panel_width()) * 20);
            let nested = keeping_packed_weights(|| panels(21).expect("panels"));
            assert!(Arc::ptr_eq(&first, &nested) && panels(20).is_some());
            assert!(panels(FEW_ROWS + 1).is_none(), "many rows");
            let other = super::panels(&weight(&data, [35, 40, 1]), 20);
            assert!(other.is_none(), "another shape");
        });
        assert!(panels(20).is_none(), "ended");
        assert_eq!(Arc::strong_count(&data), 1, "let go");
    }

    #[test]
    fn no_more_is_kept_than_16_mib() {
        let data = Arc::new(vec![0.0_f32; MOST_ELEMENTS / 2 + 1]);
        keeping_packed_weights(|| {
            for columns in [1, 2, 3] {
                let shape = [columns, 1, 1];
                allow(&data, shape, || Arc::clone(&data));
            }
            assert_eq!(Arc::strong_count(&data), 2);
        });
    }
}
