//! The verdict on whether samples follow the beats of their music.

use kinegrad_data::{BeatAgreement, CHANCE};
use kinegrad_motion::metrics::Estimate;
use kinegrad_settings::counted;

/// The verdict on samples of `phrases` phrases with this beat-phase error; `tracked` is the agreement
/// of the real phrases with the beats tracked in their music.
pub(crate) fn beat_verdict(
    error: &Estimate,
    phrases: usize,
    tracked: Option<&BeatAgreement>,
) -> String {
    let Estimate { mean, low, high } = error;
    if phrases < BeatAgreement::FEWEST_PHRASES {
        let phrases = counted(phrases, "phrase");
        return format!(
            "beat-phase error {mean:.3} (by chance {CHANCE}): {phrases}, too few for a verdict"
        );
    }
    let found = format!("beat-phase error {mean:.3} ({low:.3} to {high:.3}; by chance {CHANCE})");
    if *high < CHANCE {
        return format!("the samples follow the beat: {found}");
    }
    let of_data = tracked.filter(|tracked| tracked.is_at_chance());
    let of_data = of_data.map(|tracked| {
        format!("; the phase of the real phrases does not follow the tracked beats: {tracked}")
    });
    let of_data = of_data.unwrap_or_default();
    format!("the samples do not follow the beat: {found}{of_data}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_follow_the_beat_if_their_interval_is_below_chance() {
        let error = |mean, low, high| Estimate { mean, low, high };
        let said = |error: Estimate| beat_verdict(&error, 4, None);
        let follows = said(error(0.11, 0.04, 0.249));
        assert!(follows.starts_with("the samples follow the beat: beat-phase error 0.110"));
        let unrelated = said(error(0.246, 0.24, 0.26));
        assert!(
            unrelated.starts_with("the samples do not follow the beat"),
            "{unrelated}"
        );
        let data = |distance: f64| {
            let songs = ["a", "a", "b", "b"].map(|song| (song.to_owned(), distance));
            BeatAgreement::of(songs)
        };
        let of_data =
            "the phase of the real phrases does not follow the tracked beats: 0.300 beats";
        let both = beat_verdict(&error(0.246, 0.24, 0.26), 4, data(0.3).as_ref());
        assert!(both.contains(of_data), "{both}");
        let good = beat_verdict(&error(0.246, 0.24, 0.26), 4, data(0.1).as_ref());
        assert_eq!(good, unrelated);
        let few = beat_verdict(&error(0.171, 0.171, 0.171), 1, None);
        assert!(few.ends_with("1 phrase, too few for a verdict"), "{few}");
    }
}
