//! Motion aligned to the beats of its song, and beats as features: `data prepare`, `audio
//! features`, training and `sample --audio`.

use std::f64::consts::TAU;
use std::fs;

use kinegrad_data::manifest::Selection;
use kinegrad_data::{AudioLayout, Store, StoreConfig, load_audio, read_motion, write_values};
use kinegrad_motion::phrase::PHASE;
use kinegrad_tests::captures::clicks;
use kinegrad_tests::sandbox::{SMALLEST, Sandbox};

/// Number of danced beats.
const DANCED: usize = 48;

/// Frames of capture per beat.
const CAPTURED: usize = 20;

/// Times of the 54 beats of a song that slows down from 138 to 109 beats a minute.
fn slowing() -> Vec<f64> {
    let length = |k: usize| 0.434 + 0.116 * k as f64 / 54.0;
    (0..54)
        .scan(0.6, |now, k| {
            let beat = *now;
            *now += length(k);
            Some(beat)
        })
        .collect()
}

/// A capture that walks a centimetre a frame along z, and its song; a plan that states `count` even
/// beats between the third beat and the one that ends the dance.
fn sandbox(count: usize, extra: &str) -> Sandbox {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    let beats = slowing();
    sandbox.write("song.wav", clicks(&beats, 29.0));
    let frames = DANCED * CAPTURED + 1;
    let rows = (0..frames).flat_map(|t| [0.0, 1.0, 0.01 * t as f32, 1.0, 0.0, 0.0, 0.0]);
    let values: Vec<f32> = rows.collect();
    write_values(&sandbox.path("walk.npy"), &[frames, 7], &values).expect("a capture");
    let (start, end) = (beats[2], beats[2 + DANCED]);
    let spb = (end - start) / count as f64;
    let segments = (0..DANCED / 4).map(|k| {
        let (from, to) = (4 * k * CAPTURED, 4 * (k + 1) * CAPTURED);
        format!("[[take.segment]]\nmotion = \"walk.npy\"\nframes = [{from}, {to}]\nbeats = 4\n")
    });
    let segments: String = segments.take(count / 4).collect();
    sandbox.write(
        "plan.toml",
        format!(
            "output = \"set\"\n[phrases]\nframes = 60\nhop = 60\n\
             audio_features = [\"ccmotion\", \"beats\"]\n[[take]]\nname = \"walk\"\n\
             audio = \"song.wav\"\nbeats = {{ start_seconds = {start}, seconds_per_beat = {spb}, \
             beats_per_bar = 4 }}\n{extra}\n{segments}"
        ),
    );
    sandbox
}

/// Length of the mean of `exp(i TAU d)`.
fn concentration(differences: &[f64]) -> f64 {
    let mean = |f: fn(f64) -> f64| {
        differences.iter().map(|d| f(TAU * d)).sum::<f64>() / differences.len() as f64
    };
    f64::hypot(mean(f64::sin), mean(f64::cos))
}

/// Beats from the first of `beats` to a time.
fn position(beats: &[f64], seconds: f64) -> f64 {
    kinegrad_audio::pulse::position(beats, seconds)
}

/// Over all phrases: concentration of the written beat phase relative to the true one and to that
/// of the features, and the largest distance of a frame's motion from that of its beat, in beats.
fn measured(sandbox: &Sandbox) -> (f64, f64, f64) {
    let (mut of_truth, mut of_features, mut motion_off) = (Vec::new(), Vec::new(), 0.0f64);
    let beats = slowing();
    for id in sandbox.list("set/motion") {
        let (_, first) = id.rsplit_once('_').expect("a first frame");
        let first: usize = first.parse().expect("a number");
        let motion = read_motion(&sandbox.path(format!("set/motion/{id}/trajectory.npy")));
        let motion = motion.expect("a motion");
        let heard = sandbox.path(format!("set/audio_features/{id}/features.npz"));
        let heard = load_audio(&heard, AudioLayout::WITH_BEATS).expect("features");
        let phase = |t: usize| f64::from(motion.frame(t)[PHASE]);
        let mut bars = 0.0;
        for t in 0..motion.frames() {
            let truth = position(&beats, (first + t) as f64 / 30.0) - 2.0;
            of_truth.push(4.0 * phase(t) - truth);
            let (sine, cosine) = (heard.channel(163)[t], heard.channel(164)[t]);
            let beat = f64::from(sine).atan2(f64::from(cosine)) / TAU;
            of_features.push(4.0 * phase(t) - beat);
            if t > 0 && phase(t) < phase(t - 1) {
                bars += 1.0;
            }
            let danced = 4.0 * (bars + phase(t) - phase(0));
            let walked = f64::from(motion.frame(t)[2]) / (0.01 * CAPTURED as f64);
            motion_off = motion_off.max((walked - danced).abs());
        }
    }
    (
        concentration(&of_truth),
        concentration(&of_features),
        motion_off,
    )
}

fn report(sandbox: &Sandbox) -> serde_json::Value {
    let text = fs::read_to_string(sandbox.path("set/prepare/report.json")).expect("a report");
    serde_json::from_str(&text).expect("JSON")
}

#[test]
fn segments_dance_on_the_beats_of_a_song_that_slows_down() {
    let sandbox = sandbox(DANCED, "");
    let said = sandbox.run("data prepare plan.toml").succeeded().stdout;
    assert!(said.contains("tracked beats"), "{said}");
    assert!(said.contains("one song alone"), "{said}");
    let (truth, features, motion) = measured(&sandbox);
    assert!(truth > 0.99 && features > 0.9999, "{truth} {features}");
    assert!(motion < 0.02, "the motion is {motion} beats from its phase");
    let grid = &report(&sandbox)["takes"][0]["grid"];
    assert_eq!(grid["grid"], "tracked");
    assert_eq!(grid["tracked_beats"], DANCED);
    assert!(
        grid["drift_beats"].as_f64().expect("a number") > 0.8,
        "{grid}"
    );
    assert!(
        grid["uniform_concentration"].as_f64().expect("a number") < 0.9,
        "{grid}"
    );
    assert!(
        grid["concentration"].as_f64().expect("a number") > 0.9999,
        "{grid}"
    );
    let place = sandbox.path("set").display().to_string();
    let store = Store::open(&place, &StoreConfig::default()).expect("a store");
    let rows = Selection::read(&store).expect("a manifest").expect("rows");
    let groups = rows.texts("audio_features").expect("a column");
    assert!(
        groups.iter().all(|groups| groups == "ccmotion,beats"),
        "{groups:?}"
    );
    let sides = rows.texts("split").expect("a column");
    assert!(sides.iter().all(|side| side == "train"), "{sides:?}");
}

#[test]
fn even_beats_are_used_where_the_counts_disagree_or_the_plan_says_so() {
    // 44 stated, 48 tracked.
    let few = sandbox(44, "");
    let said = few.run("data prepare plan.toml").succeeded().stdout;
    assert!(
        said.contains("48 beats are tracked where 44.0 are stated"),
        "{said}"
    );
    assert_eq!(report(&few)["takes"][0]["grid"]["grid"], "uniform");
    let (truth, _, motion) = measured(&few);
    assert!(truth < 0.5 && motion < 0.02, "{truth} {motion}");

    let wanted = sandbox(44, "grid = \"tracked\"");
    let failed = wanted
        .run("data prepare plan.toml")
        .failed(2, &["grid = \"tracked\""]);
    assert!(
        failed.stderr.contains("44.0 are stated"),
        "{}",
        failed.stderr
    );

    let uniform = sandbox(DANCED, "grid = \"uniform\"");
    uniform.run("data prepare plan.toml").succeeded();
    let (truth, features, motion) = measured(&uniform);
    assert!(
        truth < 0.9 && features < 0.9 && motion < 0.02,
        "{truth} {features} {motion}"
    );
}

#[test]
fn models_hear_beats_and_refuse_what_has_none() {
    let sandbox = sandbox(DANCED, "");
    sandbox.write("c.toml", SMALLEST);
    sandbox.run("data prepare plan.toml").succeeded();
    let plan = fs::read_to_string(sandbox.path("plan.toml")).expect("a plan");
    let plain = plan
        .replace("audio_features = [\"ccmotion\", \"beats\"]", "")
        .replace("\"set\"", "\"plain\"");
    sandbox.write("plain.toml", plain);
    sandbox.run("data prepare plain.toml").succeeded();
    let train = "train c.toml --set data.kind=phrases --set train.max_steps=4 \
                 --set data.validation.patterns=[\"*_00240\"] --set sampling.count_at_end=1";
    let beats = "--set data.audio_features=[\"ccmotion\",\"beats\"]";
    sandbox
        .run(&format!(
            "{train} --name none --set data.source=plain {beats}"
        ))
        .failed(
            2,
            &[
                "data.audio_features",
                "was prepared without beat features",
                "hint:",
            ],
        );
    sandbox
        .run(&format!(
            "{train} --name odd --set data.source=set --set data.audio_features=[\"beats\"]"
        ))
        .failed(2, &["data.audio_features", "[\"ccmotion\", \"beats\"]"]);
    // The 163 features are the same with or without the beats.
    sandbox
        .run(&format!("{train} --name deaf --set data.source=set"))
        .succeeded();
    sandbox
        .run(&format!(
            "{train} --name hears --set data.source=set {beats}"
        ))
        .succeeded();
    sandbox
        .run(&format!(
            "{train} --name tuned --set data.source=set --set train.recipe=decoder \
             --set init.diffusion=runs/hears"
        ))
        .failed(
            2,
            &["data.audio_features", "which the run it starts from has"],
        );

    let draw = "--steps 2 --frames 30";
    for (name, options) in [
        ("free", ""),
        ("later", "--start 3"),
        ("waltz", "--downbeat 1.6 --beats-per-bar 3 --tempo 120"),
    ] {
        sandbox
            .run(&format!(
                "sample runs/hears --audio song.wav --out {name} {draw} {options}"
            ))
            .succeeded();
    }
    let bytes = |name: &str| fs::read(sandbox.path(format!("{name}.npy"))).expect("a motion");
    assert_ne!(bytes("free"), bytes("waltz"), "the downbeat is heard");
    let record = fs::read_to_string(sandbox.path("waltz.json")).expect("a record");
    assert!(record.contains("\"downbeat\": 1.6"), "{record}");
    sandbox
        .run(&format!(
            "sample runs/deaf --audio song.wav --downbeat 1 --out x {draw}"
        ))
        .failed(2, &["`--downbeat` with a run without beat features"]);
    sandbox
        .run(&format!("sample runs/hears --downbeat 1 --out x {draw}"))
        .failed(2, &["`--downbeat` without `--audio`"]);

    sandbox
        .run("audio features song.wav --out features --beats --downbeat 1.6 --start 2")
        .succeeded();
    let file = sandbox.path("features/song/features.npz");
    let heard = load_audio(&file, AudioLayout::WITH_BEATS).expect("features");
    let beats: Vec<f64> = slowing();
    let off: Vec<f64> = (0..600)
        .map(|t| {
            let angle = f64::from(heard.channel(163)[t]).atan2(f64::from(heard.channel(164)[t]));
            angle / TAU - position(&beats, t as f64 / 30.0 + 2.0)
        })
        .collect();
    assert!(concentration(&off) > 0.99);
    assert!(heard.channel(167).iter().all(|known| *known == 1.0));
    sandbox
        .run(&format!(
            "sample runs/hears --audio-features features/song/features.npz --out cond {draw}"
        ))
        .succeeded();
    sandbox
        .run("audio features song.wav --out plain_features")
        .succeeded();
    sandbox
        .run(&format!(
            "sample runs/hears --audio-features plain_features/song/features.npz --out x {draw}"
        ))
        .failed(
            2,
            &["array `beats` is missing", "beat features are requested"],
        );
    // Without beats, the features are the usual ones.
    load_audio(
        &sandbox.path("plain_features/song/features.npz"),
        AudioLayout::CCMOTION,
    )
    .expect("the 163");
}

#[test]
fn whole_songs_are_held_out_where_the_plan_names_none() {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    let beats = slowing();
    let frames = 400;
    let rows = (0..frames).flat_map(|t| [0.0, 1.0, 0.01 * t as f32, 1.0, 0.0, 0.0, 0.0]);
    let values: Vec<f32> = rows.collect();
    let mut plan = String::from("output = \"set\"\n[phrases]\nframes = 60\nhop = 60\n");
    for song in ["a", "b", "c"] {
        sandbox.write(format!("{song}.wav").as_str(), clicks(&beats, 14.0));
        for take in ["x", "y"] {
            let file = format!("{song}{take}.npy");
            write_values(&sandbox.path(&file), &[frames, 7], &values).expect("a capture");
            plan += &format!("[[take]]\nmotion = \"{file}\"\naudio = \"{song}.wav\"\n");
        }
    }
    sandbox.write("plan.toml", plan);
    let said = sandbox.run("data prepare plan.toml").succeeded().stdout;
    assert!(said.contains("held out: "), "{said}");
    let held_out = report(&sandbox)["held_out_songs"].clone();
    assert_eq!(held_out.as_array().expect("a list").len(), 1, "{held_out}");
    let song = held_out[0]
        .as_str()
        .expect("a song")
        .trim_end_matches(".wav")
        .to_owned();
    let listed = |condition: &str| {
        let mut command =
            sandbox.command(["data", "inspect", "set", "--json", "--where", condition]);
        command.stdin(std::process::Stdio::null());
        let found = kinegrad_tests::sandbox::finish(command).succeeded().stdout;
        serde_json::from_str::<Vec<String>>(&found).expect("a list of ids")
    };
    let held = listed("split = validation");
    assert!(
        held.len() > 8 && held.iter().all(|id| id.starts_with(&song)),
        "{held:?}"
    );
    assert_eq!(held, listed(&format!("audio_source = {song}.wav")));
    assert_eq!(listed("split = train").len(), 2 * held.len());
}
