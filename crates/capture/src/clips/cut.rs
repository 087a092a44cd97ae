//! Cutting takes into clips.

use std::ops::Range;

/// The ranges of `frames` that become clips of `least` to `most` frames, in order, and the
/// remaining range. Clips of one take are about equally long and adjacent.
pub(super) fn cut(
    frames: usize,
    least: usize,
    most: usize,
) -> (Vec<Range<usize>>, Option<Range<usize>>) {
    if frames < least {
        return (Vec::new(), (frames > 0).then_some(0..frames));
    }
    let clips = frames.div_ceil(most);
    if frames / clips >= least {
        let bound = |clip: usize| clip * frames / clips;
        let cut = (0..clips).map(|clip| bound(clip)..bound(clip + 1));
        return (cut.collect(), None);
    }
    // One clip fewer, each of the largest length.
    let clips = clips - 1;
    let cut = (0..clips).map(|clip| clip * most..(clip + 1) * most);
    (cut.collect(), Some(clips * most..frames))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn long_takes_give_clips_of_about_one_length() {
        let alone = |clip: Range<usize>| std::iter::once(clip).collect::<Vec<_>>();
        assert_eq!(cut(39, 40, 196), (vec![], Some(0..39)));
        assert_eq!(cut(0, 40, 196), (vec![], None));
        assert_eq!(cut(40, 40, 196), (alone(0..40), None));
        assert_eq!(cut(196, 40, 196), (alone(0..196), None));
        assert_eq!(cut(197, 40, 196), (vec![0..98, 98..197], None));
        assert_eq!(cut(60, 40, 50), (alone(0..50), Some(50..60)));
    }

    proptest! {
        #[test]
        fn clips_follow_each_other_within_the_bounds(
            frames in 0usize..3000,
            least in 4usize..60,
            more in 0usize..200,
        ) {
            let most = least + more;
            let (clips, rest) = cut(frames, least, most);
            let mut end = 0;
            for clip in &clips {
                prop_assert_eq!(clip.start, end);
                prop_assert!((least..=most).contains(&clip.len()));
                end = clip.end;
            }
            if let Some(rest) = &rest {
                prop_assert_eq!(rest.start, end);
                end = rest.end;
            }
            prop_assert_eq!(end, frames);
            prop_assert!(frames < least || !clips.is_empty());
        }
    }
}
