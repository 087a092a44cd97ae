//! Plans of `data prepare`: refusals, reports, and rewritten datasets.

use std::fs;

use kinegrad_tests::captures::{self, PLAN, bvh, wav};
use kinegrad_tests::sandbox::{Sandbox, contents, finish};

fn with_captures() -> Sandbox {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    captures::write(&sandbox);
    sandbox
}

#[test]
fn an_interrupted_preparation_goes_on_and_a_changed_take_is_made_again() {
    let sandbox = with_captures();
    sandbox
        .run("data prepare plan.toml --out whole")
        .succeeded();
    sandbox.run("data prepare plan.toml --out set").succeeded();
    // As after a kill: one take is not recorded, the manifest is not written.
    fs::remove_file(sandbox.path("set/prepare/takes/two.json")).expect("a note");
    fs::remove_file(sandbox.path("set/manifest.parquet")).expect("a manifest");
    fs::remove_dir_all(sandbox.path("set/motion/two_00015")).expect("a phrase");
    sandbox.run("data inspect set").failed(
        2,
        &["manifest.parquet", "preparation has not ended", "hint:"],
    );
    let again = sandbox.run("data prepare plan.toml --out set").succeeded();
    assert!(
        again.stdout.contains("2 of 3 takes unchanged"),
        "{}",
        again.stdout
    );
    let same = |folder: &str| {
        let mut all = contents(&sandbox.path(folder));
        all.retain(|(name, _)| name != "prepare/report.json");
        all
    };
    assert_eq!(same("set"), same("whole"));
    // A lost phrase is written again.
    fs::remove_dir_all(sandbox.path("set/audio_features/one_00015")).expect("a phrase");
    let again = sandbox.run("data prepare plan.toml --out set").succeeded();
    assert!(
        again.stdout.contains("2 of 3 takes unchanged"),
        "{}",
        again.stdout
    );
    assert_eq!(same("set"), same("whole"));
    sandbox.write("captures/two.bvh", bvh(200));
    let again = sandbox.run("data prepare plan.toml --out set").succeeded();
    assert!(
        again.stdout.contains("2 of 3 takes unchanged"),
        "{}",
        again.stdout
    );
}

#[test]
fn wrong_plans_say_what_is_wrong_and_write_nothing() {
    let sandbox = with_captures();
    for (plan, texts) in [
        ("output = 3", &["plan.toml:1: `output`"][..]),
        (
            "output = \"o\"\n[[take]]\nmotoin = \"x\"\naudio = \"none\"",
            &[
                "plan.toml:3: unknown key `take[0].motoin`",
                "did you mean `take[0].motion`?",
            ],
        ),
        ("output = \"o\"", &["nothing to prepare"]),
        (
            "output = \"o\"\nphrases.hop = 9223372036854775808",
            &["plan.toml:2: ", "too large"],
        ),
        (
            "output = \"o\"\nphrases = [60, 60]",
            &[
                "plan.toml:2: `phrases`",
                "a list of 2 values",
                "allowed: a table",
            ],
        ),
        (
            "output = \"o\"\njoining.max_step_seconds = inf",
            &["`joining.max_step_seconds`", "inf is not a finite number"],
        ),
        (
            "output = \"o\"\n[[take]]\nmotion = \"captures/no.bvh\"\naudio = \"none\"",
            &["there is no file", "no.bvh"],
        ),
        (
            "output = \"o\"\n[[take]]\nmotion = \"captures/one.bvh\"\naudio = \"songs/no.mp3\"",
            &["there is no file", "no.mp3"],
        ),
        (
            "output = \"o\"\n[[take]]\nname = \"../x\"\nmotion = \"captures/one.bvh\"\naudio = \"none\"",
            &["no slash"],
        ),
        (
            "output = \"o\"\n[[take]]\nname = \"x\"\nmotion = \"captures/*.bvh\"\naudio = \"none\"",
            &["two takes have the name `x`"],
        ),
        (
            "output = \"ftp://host/o\"\n[[take]]\nmotion = \"captures/one.bvh\"\naudio = \"none\"",
            &["`ftp`"],
        ),
        (
            "output = \"o\"\n[[take]]\nmotion = \"captures/one.bvh\"\naudio = \"none\"\nunits = \"feet\"",
            &["plan.toml:5: `take[0].units`", "feet", "\"inch\""],
        ),
        (
            "output = \"o\"\n[[take]]\nmotion = \"captures/one.bvh\"\naudio = \"none\"\nfps = 60",
            &["captures/one.bvh", "`fps` is for .npy"],
        ),
        (
            "output = \"o\"\n[[take]]\nmotion = \"captures/one.bvh\"\naudio = \"none\"\nbeats_per_bar = 3\n\
             beats = { start_seconds = 0, seconds_per_beat = 0.5, beats_per_bar = 4 }",
            &["`take[0].beats_per_bar` is given, allowed: where beats are tracked"],
        ),
        (
            "output = \"o\"\n[[take]]\nname = \"x\"\naudio = \"none\"\naudio_start_seconds = 3\n\
             beats = { start_seconds = 0, seconds_per_beat = 0.5, beats_per_bar = 4 }\n\
             [[take.segment]]\nmotion = \"a.c3d\"\nframes = [0, 9]\nbeats = 8",
            &["`take[0].audio_start_seconds` is given, allowed: in whole takes"],
        ),
        (
            "output = \"o\"\n[[take]]\nmotion = \"captures/one.bvh\"\naudio = \"none\"\n\
             beats = { start_seconds = 0, seconds_per_beat = 0.5, beats_per_bar = 4, beats = nan }",
            &["`take[0].beats.beats`", "NaN is not a finite number"],
        ),
        (
            "output = \"o\"\n[phrases]\nframes = 900\n[[take]]\nmotion = \"captures/*.bvh\"\naudio = \"none\"",
            &[
                "no take gave a phrase",
                "one: too short for a phrase of 900",
                "two: too short",
            ],
        ),
    ] {
        sandbox.write("plan.toml", plan);
        sandbox.run("data prepare plan.toml").failed(2, texts);
        assert!(!sandbox.path("o").exists(), "{plan}");
    }
    sandbox
        .run("data synth --out foreign --phrases 2 --frames 10")
        .succeeded();
    sandbox.write("plan.toml", PLAN);
    sandbox
        .run("data prepare plan.toml --out foreign")
        .failed(2, &["already contains a dataset"]);
    let missing = PLAN.replace("captures/one.bvh", "captures/*.c3d");
    sandbox.write("plan.toml", missing);
    sandbox
        .run("data prepare plan.toml --out o")
        .failed(2, &["there is no file"]);
    sandbox.write(
        "plan.toml",
        "output = \"o\"\n[[take]]\nname = \"x\"\naudio = \"none\"\nbeats = { start_seconds = 0, \
         seconds_per_beat = 0.5, beats_per_bar = 4 }\n[[take.segment]]\nmotion = \"no.c3d\"\n\
         frames = [0, 9]\nbeats = 8\n",
    );
    sandbox
        .run("data prepare plan.toml")
        .failed(2, &["no take gave a phrase", "no capture: no.c3d"]);
    assert!(!sandbox.path("o/manifest.parquet").exists());
    sandbox.write("plan.toml", PLAN);
    sandbox.write("captures/two.bvh", "HIERARCHY nonsense");
    let half = sandbox.run("data prepare plan.toml").failed(1, &[]);
    assert!(
        half.stdout.contains("two: failed") && half.stdout.contains("line 1"),
        "{}",
        half.stdout
    );
    sandbox.run("data inspect set").succeeded();
}

#[test]
fn what_a_preparation_should_tell_it_tells() {
    let sandbox = with_captures();
    let plan = PLAN
        .replace("\"two_*\"", "\"two_*\", \"three_*\"")
        .replace("motion_end_seconds = 3.0", "motion_end_seconds = 60.0");
    sandbox.write("plan.toml", &plan);
    let song = wav(4);
    sandbox.write("songs/cut.wav", &song[..song.len() / 2]);
    sandbox.write(
        "cut.toml",
        "output = \"cut\"\n[phrases]\nframes = 20\n[[take]]\nname = \"cut\"\n\
         motion = \"captures/one.bvh\"\nunits = \"m\"\naudio = \"songs/cut.wav\"\n",
    );
    let said = sandbox.run("data prepare plan.toml").succeeded().stdout;
    for text in [
        "no phrase matches `three_*`",
        "motion_end_seconds is 60, but captures/one.bvh ends at",
    ] {
        assert!(said.contains(text), "no `{text}` in {said}");
    }
    let said = sandbox.run("data prepare cut.toml").succeeded().stdout;
    for text in ["shorter than its headers state", "are its units"] {
        assert!(said.contains(text), "no `{text}` in {said}");
    }
    let flagged = "flags like *damaged_audio*";
    let select = sandbox.command(["data", "inspect", "cut", "--json", "--where", flagged]);
    let selected = finish(select).succeeded();
    assert!(selected.stdout.contains("cut_00000"), "{}", selected.stdout);
}

#[test]
fn a_damaged_phrase_is_listed_and_made_again() {
    let sandbox = with_captures();
    sandbox.run("data prepare plan.toml").succeeded();
    let damaged = sandbox.path("set/motion/one_00015/trajectory.npy");
    let whole = fs::read(&damaged).expect("a phrase");
    let mut bytes = whole.clone();
    bytes[200] ^= 1;
    fs::write(&damaged, bytes).expect("written");
    let inspected = sandbox.run("data inspect set").failed(1, &[]);
    let expected = "one_00015 (unusable)";
    assert!(inspected.stdout.contains(expected), "{}", inspected.stdout);
    // From another folder, by another spelling of the plan's path.
    let plan = sandbox.path("plan.toml").display().to_string();
    let again = sandbox.run(&format!("data prepare {plan}")).succeeded();
    let expected = "2 of 3 takes unchanged";
    assert!(again.stdout.contains(expected), "{}", again.stdout);
    assert!(fs::read(&damaged).expect("a phrase") == whole);
    let all = sandbox.run("data prepare plan.toml --again").succeeded();
    let expected = "0 of 3 takes unchanged";
    assert!(all.stdout.contains(expected), "{}", all.stdout);
}

#[test]
fn two_preparations_do_not_write_one_dataset() {
    let sandbox = with_captures();
    sandbox.run("data prepare plan.toml").succeeded();
    let before = contents(&sandbox.path("set"));
    let other = fs::File::open(sandbox.path("set/prepare/lock")).expect("a lock");
    other.lock().expect("nobody holds it");
    sandbox
        .run("data prepare plan.toml --again")
        .failed(2, &["another preparation is writing", "hint:"]);
    assert!(contents(&sandbox.path("set")) == before);
    other.unlock().expect("held");
    sandbox.run("data prepare plan.toml").succeeded();
}

#[test]
fn phrases_of_takes_that_are_gone_are_told_and_pruned() {
    let sandbox = with_captures();
    sandbox.run("data prepare plan.toml").succeeded();
    let one = PLAN.replace("captures/*.bvh", "captures/one.bvh");
    sandbox.write("plan.toml", one);
    let said = sandbox.run("data prepare plan.toml").succeeded().stdout;
    assert!(
        said.contains("phrases of other takes; the dataset does not"),
        "{said}"
    );
    let ids = || sandbox.list("set/motion");
    assert!(ids().iter().any(|id| id.starts_with("two_")));
    let said = sandbox.run("data prepare plan.toml --prune").succeeded();
    assert!(!said.stdout.contains("of other takes"), "{}", said.stdout);
    assert!(ids().iter().all(|id| !id.starts_with("two_")));
    sandbox.run("data inspect set").succeeded();
}
