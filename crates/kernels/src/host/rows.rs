//! Frames as rows: the memory order of the kernels.

use std::marker::PhantomData;
use std::mem::MaybeUninit;

/// A view of `[batch, time, channels]` with contiguous channels.
#[derive(Clone, Copy, Debug)]
pub struct Rows<'a> {
    /// The elements.
    pub data: &'a [f32],
    /// Samples.
    pub batch: usize,
    /// Frames of a sample.
    pub time: usize,
    /// Channels of a frame.
    pub channels: usize,
    /// Distance of samples in elements.
    pub sample_stride: usize,
    /// Distance of frames in elements.
    pub row_stride: usize,
}

impl<'a> Rows<'a> {
    /// A view of rows without gaps.
    pub fn dense(data: &'a [f32], [batch, time, channels]: [usize; 3]) -> Self {
        assert_eq!(data.len(), batch * time * channels, "elements");
        Self {
            data,
            batch,
            time,
            channels,
            sample_stride: time * channels,
            row_stride: channels,
        }
    }

    /// `[batch, time, channels]`.
    pub fn shape(&self) -> [usize; 3] {
        [self.batch, self.time, self.channels]
    }

    /// Frame `time` of sample `sample`.
    #[inline(always)]
    pub fn row(&self, sample: usize, time: usize) -> &'a [f32] {
        &self.data[sample * self.sample_stride + time * self.row_stride..][..self.channels]
    }

    /// All elements without gaps.
    pub fn to_dense(self) -> Vec<f32> {
        let mut dense = Vec::with_capacity(self.batch * self.time * self.channels);
        for sample in 0..self.batch {
            for time in 0..self.time {
                dense.extend_from_slice(self.row(sample, time));
            }
        }
        dense
    }

    /// The first `time` frames of every sample.
    #[inline(always)]
    pub fn first(self, time: usize) -> Self {
        debug_assert!(time <= self.time, "frames");
        Self { time, ..self }
    }

    /// Channels `first..first + channels` of every frame.
    pub fn narrow(&self, first: usize, channels: usize) -> Self {
        assert!(first + channels <= self.channels, "channels");
        let start = first.min(self.data.len());
        Self {
            data: &self.data[start..],
            channels,
            ..*self
        }
    }
}

/// Rows that several threads write, each thread its own columns or rows.
pub(crate) struct SharedRows<'a, T = f32> {
    data: *mut T,
    len: usize,
    start: usize,
    sample_stride: usize,
    row_stride: usize,
    lifetime: PhantomData<&'a mut [T]>,
}

impl<T> Clone for SharedRows<'_, T> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<T> Copy for SharedRows<'_, T> {}

// SAFETY: only `segment` follows the pointer, and its callers keep the segments of two threads
// apart; the elements may go to any thread.
#[allow(unsafe_code)]
unsafe impl<T: Send> Send for SharedRows<'_, T> {}
// SAFETY: as above.
#[allow(unsafe_code)]
unsafe impl<T: Send> Sync for SharedRows<'_, T> {}

impl<'a, T> SharedRows<'a, T> {
    /// Rows in `data` from element `start` on.
    pub fn new(data: &'a mut [T], start: usize, sample_stride: usize, row_stride: usize) -> Self {
        Self {
            data: data.as_mut_ptr(),
            len: data.len(),
            start,
            sample_stride,
            row_stride,
            lifetime: PhantomData,
        }
    }

    /// Rows without gaps.
    pub fn dense(data: &'a mut [T], [batch, time, channels]: [usize; 3]) -> Self {
        assert_eq!(data.len(), batch * time * channels, "elements");
        Self::new(data, 0, time * channels, channels)
    }

    /// Channels `first..first + channels` of a row.
    ///
    /// # Safety
    /// No other slice of these elements may exist at the same time: tasks own disjoint rows or
    /// columns, and a task has one slice of an element at a time.
    #[inline(always)]
    #[allow(unsafe_code, clippy::mut_from_ref)]
    pub unsafe fn segment(
        &self,
        sample: usize,
        time: usize,
        first: usize,
        channels: usize,
    ) -> &mut [T] {
        let at = self.start + sample * self.sample_stride + time * self.row_stride + first;
        assert!(at + channels <= self.len, "a row outside the buffer");
        // SAFETY: the range was checked against the slice that `new` borrowed mutably for `'a`;
        // the caller keeps segments apart.
        unsafe { std::slice::from_raw_parts_mut(self.data.add(at), channels) }
    }
}

/// Elements `[batch, time, channels]` written by `write`.
///
/// # Safety
/// `write` must write every element.
#[allow(unsafe_code)]
pub(crate) unsafe fn rows_written_by(
    shape: [usize; 3],
    write: impl FnOnce(SharedRows<'_, MaybeUninit<f32>>),
) -> Vec<f32> {
    // SAFETY: the caller's promise.
    unsafe { padded_rows_written_by(shape, 0, 0, write) }
}

/// [`rows_written_by`] with zero rows before and after each sample, for windows across the sample's
/// ends: `[batch, before + time + after, channels]`.
///
/// # Safety
/// `write` must write every element of its rows.
#[allow(unsafe_code)]
pub(crate) unsafe fn padded_rows_written_by(
    [batch, time, channels]: [usize; 3],
    before: usize,
    after: usize,
    write: impl FnOnce(SharedRows<'_, MaybeUninit<f32>>),
) -> Vec<f32> {
    let stride = (before + time + after) * channels;
    let len = batch * stride;
    let mut data: Vec<f32> = Vec::with_capacity(len);
    let unwritten = &mut data.spare_capacity_mut()[..len];
    if len > 0 {
        for sample in unwritten.chunks_exact_mut(stride) {
            let (head, inner) = sample.split_at_mut(before * channels);
            let (_, tail) = inner.split_at_mut(time * channels);
            head.fill(MaybeUninit::new(0.0));
            tail.fill(MaybeUninit::new(0.0));
        }
    }
    write(SharedRows::new(
        unwritten,
        before * channels,
        stride,
        channels,
    ));
    // SAFETY: the zero rows are written above, the other rows by the caller's promise.
    unsafe {
        data.set_len(len);
    }
    data
}

/// Divides `[batch, channels]` into tasks of one sample or, with few samples, of some channels of
/// one sample. The channels of a task are a multiple of `unit`.
pub(crate) fn column_tasks(batch: usize, channels: usize, unit: usize) -> Vec<ColumnTask> {
    /// A part narrower than this does not fill vector registers.
    const LEAST: usize = 32;
    let wanted = (2 * rayon::current_num_threads()).div_ceil(batch.max(1));
    let parts = wanted.min(channels / LEAST).max(1);
    let width = channels.div_ceil(parts).next_multiple_of(unit);
    (0..batch)
        .flat_map(|sample| {
            (0..channels).step_by(width).map(move |first| ColumnTask {
                sample,
                first,
                channels: width.min(channels - first),
            })
        })
        .collect()
}

/// A task: some channels of all frames of one sample.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ColumnTask {
    pub sample: usize,
    pub first: usize,
    pub channels: usize,
}
