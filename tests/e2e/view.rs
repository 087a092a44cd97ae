//! Pages of motion: what is written, and what is refused. `tests/pages` opens them in a browser.

use std::fs;

use kinegrad_data::write_values;
use kinegrad_tests::sandbox::Sandbox;

fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    let place = |i: usize| (i as f32 * 0.1).sin();
    let values: Vec<f32> = (0..8 * 66).map(place).collect();
    for name in ["walk.npy", "walk.raw.npy"] {
        write_values(&sandbox.path(name), &[8, 22, 3], &values).expect("written");
    }
    sandbox
}

#[test]
fn a_page_is_written_beside_the_motion_and_not_over_another() {
    let sandbox = sandbox();
    let said = sandbox.run("view walk.npy").succeeded().stdout;
    assert_eq!(said.trim(), "walk.html");
    let page = fs::read_to_string(sandbox.path("walk.html")).expect("a page");
    assert!(page.starts_with("<!doctype html>") && page.ends_with("</html>\n"));

    let again = sandbox.run("view walk.npy --raw");
    again.failed(2, &["walk.html exists already", "`--overwrite`", "`--out`"]);
    assert_eq!(fs::read_to_string(sandbox.path("walk.html")).unwrap(), page);
    sandbox.run("view walk.npy --raw --overwrite").succeeded();
    assert!(
        fs::read_to_string(sandbox.path("walk.html"))
            .unwrap()
            .contains("walk.raw")
    );
}

#[test]
fn what_cannot_be_shown_is_refused_and_leaves_no_page() {
    let sandbox = sandbox();
    let mut values = vec![0.0; 8 * 66];
    values[70] = f32::NAN;
    write_values(&sandbox.path("nan.npy"), &[8, 22, 3], &values).expect("written");
    write_values(&sandbox.path("odd.npy"), &[8, 7], &[0.0; 56]).expect("written");
    write_values(&sandbox.path("points.npy"), &[2, 4, 3], &[0.0; 24]).expect("written");
    sandbox.write("broken.bvh", "HIERARCHY\nROOT Hips\n{\n");
    sandbox.write("song.mp3", "no song");
    sandbox.write("goal.toml", "frames = 8\n");
    for (arguments, texts) in [
        ("none.npy", &["there is no motion file at none.npy"][..]),
        ("nan.npy", &["nan.npy", "not finite", "kinegrad check"]),
        ("odd.npy", &["odd.npy", "[8, 7]", "known representations"]),
        ("points.npy --fps 0", &["`--fps` is 0"]),
        ("broken.bvh", &["broken.bvh", "line"]),
        ("walk.npy --audio song.mp3", &["song.mp3"]),
        ("walk.npy --goal goal.toml", &["goal"]),
        ("walk.npy --out page.txt", &["page.txt", ".html"]),
        ("walk.npy --units yards", &["cm, mm, inch, cmu"]),
        ("walk.npy --up x", &["--up"]),
        ("walk.npy --start 3", &["--audio"]),
    ] {
        sandbox.run(&format!("view {arguments}")).failed(2, texts);
    }
    let left = sandbox.list(".");
    assert!(
        !left
            .iter()
            .any(|name| name.contains("html") || name.contains("tmp")),
        "{left:?}"
    );
}
