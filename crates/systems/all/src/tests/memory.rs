//! Memory of networks.

use crate::BUILT_IN;

#[test]
fn the_coherent_fit_of_long_phrases_counts() {
    let footprint = |frames: usize| {
        let text = format!(
            "[train]\nrecipe = \"e2e\"\n[decoder]\ncoherence = \"projection\"\n[data]\n\
             target_frames = {frames}"
        );
        let config = BUILT_IN.parse(&text, "c.toml", &[]).expect("a config");
        let (system, _) = BUILT_IN.of(&config).expect("built in");
        system.footprint(&config).expect("networks")
    };
    let [long, longer] = [30_000, 60_000].map(footprint);
    assert_eq!(
        (longer.activations, longer.shared),
        (2 * long.activations, 2 * long.shared)
    );
    // The memory of the fit is used once per batch and is small compared with an item.
    let [one, two] = [1, 2].map(|items| long.of_sampling(items, false, true));
    assert!(
        long.shared > 0 && 4 * long.shared < (two - one) / 10,
        "{one}, {two}"
    );
}
