//! Packed weights that products reuse.
//!
//! With few rows, packing a weight takes about as long as the product. A sampler that calls a small
//! network repeatedly reuses the packed weights.

use std::any::Any;
use std::cell::RefCell;
use std::collections::HashMap;
use std::sync::Arc;

use super::packing::Weight;
use super::product::panel_width;

/// Above this number of rows, packing is cheap relative to the product.
const FEW_ROWS: usize = 64;

/// Maximum number of stored elements (16 MiB). Packing a weight that exceeds the processor's cache
/// costs no more than reading the weight.
const MAX_ELEMENTS: usize = 4 << 20;

thread_local! {
    static CACHE: RefCell<Option<Cache>> = const { RefCell::new(None) };
}

#[derive(Default)]
struct Cache {
    /// Weights by address, which the owner fixes, and shape.
    weights: HashMap<(usize, [usize; 3]), CachedWeight>,
    elements: usize,
}

struct CachedWeight {
    _owner: Box<dyn Any>,
    panels: Option<Arc<Vec<f32>>>,
}

/// Runs `work` on this thread. Products of few rows in `work` reuse packed weights, up to 16 MiB.
/// The cache does not change results.
pub fn cache_packed_weights<R>(work: impl FnOnce() -> R) -> R {
    struct Outermost;
    impl Drop for Outermost {
        fn drop(&mut self) {
            CACHE.set(None);
        }
    }
    let _outermost = CACHE.with_borrow_mut(|cache| match cache {
        Some(_) => None,
        None => {
            *cache = Some(Cache::default());
            Some(Outermost)
        }
    });
    work()
}

/// Allows a weight of this shape to be cached. The stored owner fixes the weight's address and
/// values.
pub(crate) fn allow<T: Any>(weight: &[f32], shape: [usize; 3], owner: impl FnOnce() -> T) {
    CACHE.with_borrow_mut(|cache| {
        let Some(cache) = cache else { return };
        if cache.elements + weight.len() > MAX_ELEMENTS {
            return;
        }
        let key = (weight.as_ptr().addr(), shape);
        cache.weights.entry(key).or_insert_with(|| {
            cache.elements += weight.len();
            CachedWeight {
                _owner: Box::new(owner()),
                panels: None,
            }
        });
    });
}

/// The cached panels of a weight for a product of `rows` rows; `None` if the weight may not be
/// cached.
pub(super) fn panels(weight: &Weight<'_>, rows: usize) -> Option<Arc<Vec<f32>>> {
    if rows > FEW_ROWS || !weight.gathers() {
        return None;
    }
    CACHE.with_borrow_mut(|cache| {
        let key = (weight.data.as_ptr().addr(), weight.shape);
        let cache = cache.as_mut()?.weights.get_mut(&key)?;
        let pack = || Arc::new(weight.packed(panel_width()));
        Some(Arc::clone(cache.panels.get_or_insert_with(pack)))
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
    fn allowed_weights_are_packed_once_and_released_at_the_end() {
        let data = Arc::new(vec![1.0_f32; 70 * 20]);
        let shape = [70, 20, 1];
        let panels = |rows| super::panels(&weight(&data, shape), rows);
        allow(&data, shape, || Arc::clone(&data));
        assert!(panels(20).is_none(), "not asked to");
        cache_packed_weights(|| {
            assert!(panels(20).is_none(), "not allowed");
            allow(&data, shape, || Arc::clone(&data));
            let first = panels(20).expect("panels");
            assert_eq!(first.len(), 70_usize.next_multiple_of(panel_width()) * 20);
            let nested = cache_packed_weights(|| panels(21).expect("panels"));
            assert!(Arc::ptr_eq(&first, &nested) && panels(20).is_some());
            assert!(panels(FEW_ROWS + 1).is_none(), "many rows");
            let other = super::panels(&weight(&data, [35, 40, 1]), 20);
            assert!(other.is_none(), "another shape");
        });
        assert!(panels(20).is_none(), "ended");
        assert_eq!(Arc::strong_count(&data), 1, "released");
    }

    #[test]
    fn at_most_16_mib_are_cached() {
        let data = Arc::new(vec![0.0_f32; MAX_ELEMENTS / 2 + 1]);
        cache_packed_weights(|| {
            for columns in [1, 2, 3] {
                let shape = [columns, 1, 1];
                allow(&data, shape, || Arc::clone(&data));
            }
            assert_eq!(Arc::strong_count(&data), 2);
        });
    }
}
