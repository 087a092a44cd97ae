//! Clips shorter than the model's length.

use kinegrad_data::read_array;

use super::goals::{GOAL, shape, trained};

#[test]
fn a_clip_is_drawn_at_the_length_of_training_and_cut() {
    let sandbox = trained();
    let drawn = |frames: usize, padding: &str| {
        let out = format!("free{frames}");
        let sample = format!(
            "sample runs/gmd_motion --frames {frames} --out {out} --overwrite \
             --set steering.padding={padding}"
        );
        sandbox.run(&sample).succeeded();
        let features = read_array(&sandbox.path(format!("{out}.features.npy")));
        features.expect("features").values
    };
    let features = |frames| drawn(frames, "sampled");
    // 16 is the length of training; the network is padded to 20.
    let (short, cut, whole) = (features(7), features(13), features(16));
    assert_eq!(short[..], whole[..7 * 263]);
    assert_eq!(cut[..], whole[..13 * 263]);
    assert_ne!(
        features(18)[..7 * 263],
        short[..],
        "18 frames are drawn as 18"
    );
    // With padding as in training, a short clip is not the beginning of a long one.
    let (padded, long) = (drawn(7, "zeros"), drawn(16, "zeros"));
    assert_eq!(long, whole);
    assert_eq!(padded.len(), short.len());
    assert_ne!(padded, short);

    // Several goals of different lengths, padded and as published. As published, frames after the
    // end of a short goal are free, and the first stage's path is followed to the end.
    sandbox.write(
        "short.toml",
        GOAL.replace("frames = 16", "frames = 9").replace("15", "5"),
    );
    let two_stages = "sample runs/gmd_motion --trajectory-run runs/gmd_trajectory \
                      --goal goal.toml --goal short.toml";
    for padding in ["zeros", "sampled"] {
        let set = format!("--set steering.padding={padding}");
        sandbox
            .run(&format!("{two_stages} --out {padding} {set}"))
            .succeeded();
        for (index, frames) in [16, 9].into_iter().enumerate() {
            let name = format!("{padding}-{index:03}");
            assert_eq!(shape(&sandbox.path(format!("{name}.npy"))), [frames, 22, 3]);
            assert_eq!(
                shape(&sandbox.path(format!("{name}.path.npy"))),
                [frames, 2]
            );
        }
    }
    let path = |padding: &str, index: usize| {
        let path = sandbox.path(format!("{padding}-{index:03}.path.npy"));
        read_array(&path).expect("a path").values
    };
    assert_ne!(path("zeros", 1), path("sampled", 1));
}
