//! Pages of runs and lists of runs.

use std::fs;

use kinegrad_tests::sandbox::{SMALLEST, SMALLEST_WALKS, Sandbox, wait_for};
use serde_json::Value;

pub fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new(env!("CARGO_BIN_EXE_kinegrad"));
    sandbox.write("c.toml", SMALLEST);
    sandbox.write("w.toml", SMALLEST_WALKS);
    sandbox
}

/// The page that `report` writes to `out`.
fn page(sandbox: &Sandbox, arguments: &str, out: &str) -> String {
    let written = sandbox.run(&format!("report {arguments}")).succeeded();
    assert_eq!(written.stdout.trim(), out);
    let page = fs::read_to_string(sandbox.path(out)).expect("a page");
    assert!(page.starts_with("<!doctype html>") && page.trim_end().ends_with("</html>"));
    // A format's namespace is not a requested address.
    let named = page.replace("http://www.w3.org/2000/svg", "");
    for outside in ["http://", "https://", "src=\"", "@import"] {
        assert!(!named.contains(outside), "{outside}");
    }
    page
}

#[track_caller]
pub fn holds(page: &str, texts: &[&str]) {
    for text in texts {
        assert!(page.contains(text), "no `{text}`");
    }
}

#[test]
fn a_page_gathers_what_a_run_holds() {
    let sandbox = sandbox();
    let train = "train c.toml --set optim.lr_schedule=constant --set sampling.count_at_end=2 \
                 --set sampling.sampler.num_inference_steps=2 --set train.max_steps";
    sandbox.run(&format!("{train}=8")).succeeded();
    sandbox.run(&format!("{train}=12 --resume")).succeeded();
    sandbox
        .run("eval runs/smallest --steps 2 --set evaluation.phrases=2")
        .succeeded();
    let page = page(&sandbox, "runs/smallest", "runs/smallest/report.html");
    let version = env!("CARGO_PKG_VERSION");
    holds(
        &page,
        &[
            "<h1>smallest</h1>",
            ">finished</span>",
            "12 of 12",
            "best validation loss",
            "gradient norm",
            "<polyline",
            "<h2>Samples</h2>",
            "synthetic_",
            "<h2>Evaluation</h2>",
            "within the limits of `strict`",
            "<h2>Hardware and versions</h2>",
            &format!("<dt>kinegrad</dt><dd>{version}</dd>"),
            "<dt>Burn</dt><dd>0.22.1</dd>",
            "cores",
            "Starts",
            "<dt>parameters</dt>",
            "SHA-256",
            "log_every_steps = 1",
        ],
    );
    let starts = fs::read_to_string(sandbox.path("runs/smallest/environment.jsonl"));
    let starts: Vec<Value> = starts
        .expect("lines")
        .lines()
        .map(|line| serde_json::from_str(line).expect("JSON"))
        .collect();
    let steps: Vec<_> = starts.iter().map(|start| start["step"].as_u64()).collect();
    assert_eq!(steps, [Some(0), Some(8)]);
    assert_eq!(starts[0]["device"], "cpu");
    assert!(starts[0]["cores"].as_u64() > Some(0));

    // A motion with non-finite positions fails; the others play.
    let samples = sandbox.list("runs/smallest/samples");
    let is_motion = |name: &&String| name.ends_with(".npy") && !name.ends_with(".raw.npy");
    let name = samples.iter().find(is_motion).expect("a sample").clone();
    let path = sandbox.path("runs/smallest/samples").join(&name);
    let kept = fs::read(&path).expect("a sample");
    let mut bytes = kept.clone();
    let last = bytes.len() - 25 * 4;
    bytes[last..last + 4].copy_from_slice(&f32::NAN.to_le_bytes());
    fs::write(&path, bytes).expect("written");
    let spoiled = self::page(&sandbox, "runs/smallest --out made.html", "made.html");
    let rows: Vec<&str> = spoiled
        .lines()
        .filter(|line| line.contains("finite 1 "))
        .collect();
    assert_eq!(rows.len(), 1, "{name}");
    assert!(rows[0].contains(">fail</td>") && rows[0].contains(name.trim_end_matches(".npy")));
    assert!(!spoiled.contains("is not written"));
    let scenes = |page: &str| page.matches("kg kg-small").count();
    assert_eq!(scenes(&spoiled) + 1, scenes(&page));
    fs::write(&path, kept).expect("written");

    // An invalid sample is named, and the rest is shown.
    sandbox.write("runs/smallest/samples/bad<b>.npy", "none");
    fs::write(sandbox.path("runs/smallest/reports/broken.csv"), "a,b\n1\n").expect("written");
    let again = self::page(&sandbox, "runs/smallest --out made.html", "made.html");
    holds(
        &again,
        &[
            "bad&lt;b&gt;.npy",
            "broken.csv is not a table",
            "synthetic_",
        ],
    );
    assert!(!again.contains("bad<b>"));
}

#[test]
fn a_page_shows_an_audio_ablation() {
    let sandbox = sandbox();
    sandbox
        .run("train c.toml --set train.max_steps=4")
        .succeeded();
    sandbox
        .run("eval runs/smallest --audio-ablation --steps 2 --set evaluation.seeds=1")
        .succeeded();
    let page = page(&sandbox, "runs/smallest", "runs/smallest/report.html");
    let table = page.split("<h2>Evaluation</h2>").nth(1).expect("reports");
    let table = table
        .split("every measure")
        .next()
        .expect("the main measures");
    for name in ["loss", "beat_phase_error", "own_minus.loss"] {
        let rows = table
            .lines()
            .filter(|line| line.contains(&format!(">{name}</td>")));
        let rows: Vec<&str> = rows.collect();
        assert!(!rows.is_empty(), "{name}");
        let has_interval = |row: &&str| row.contains(" to ");
        assert!(rows.iter().any(has_interval), "{rows:?}");
    }
    holds(&page, &["too few for a verdict"]);
}

#[test]
fn a_page_is_made_of_any_run() {
    let sandbox = sandbox();
    // Without samples and validation.
    sandbox
        .run("train c.toml --set validation.every_steps=0 --set train.max_steps=4")
        .succeeded();
    let bare = page(&sandbox, "runs/smallest", "runs/smallest/report.html");
    holds(&bare, &["last training loss", ">finished</span>"]);
    assert!(!bare.contains("<h2>Samples</h2>") && !bare.contains("<h2>Evaluation</h2>"));

    // On clips.
    let walks = "train w.toml --name walks --set sampling.count_at_end=1 --set train.max_steps=4";
    sandbox.run(walks).succeeded();
    let walks = page(&sandbox, "runs/walks", "runs/walks/report.html");
    holds(
        &walks,
        &[
            "Recipe gmd_motion of gmd",
            "<h2>Samples</h2>",
            "synthetic_walks",
        ],
    );

    // With its earlier stages and merged weights.
    let stages = "train c.toml --name whole --set train.recipe=e2e --set train.max_steps=4 \
        --set init.pretrain.diffusion_steps=4 --set init.pretrain.decoder_steps=4 \
        --set decoder.hidden_dim=32 --set rollout.steps=2 --set lora.rank=2";
    sandbox.run(stages).succeeded();
    let whole = page(&sandbox, "runs/whole", "runs/whole/report.html");
    holds(
        &whole,
        &[
            "<h2>Stage base</h2>",
            "<h2>Stage decoder</h2>",
            "learning rates",
        ],
    );
    sandbox
        .run("merge runs/whole --out runs/merged")
        .succeeded();
    let merged = page(&sandbox, "runs/merged", "runs/merged/report.html");
    holds(
        &merged,
        &[
            "<h1>merged</h1>",
            "weights only",
            "There are no metrics",
            "not recorded",
        ],
    );

    // Stopped in a stage, before its own folder has files.
    fs::remove_dir_all(sandbox.path("runs/whole/checkpoints")).expect("removed");
    for file in ["config.toml", "lock", "metrics.jsonl"] {
        fs::remove_file(sandbox.path("runs/whole").join(file)).expect("removed");
    }
    let stopped = page(&sandbox, "runs/whole", "runs/whole/report.html");
    holds(
        &stopped,
        &["<h1>whole</h1>", "not started", "<h2>Stage base</h2>"],
    );
}

#[test]
fn previews_move_where_there_are_no_samples() {
    let sandbox = sandbox();
    for (config, item) in [("c", "synthetic_"), ("w", "walk_")] {
        let train = format!(
            "train {config}.toml --name {config} --set sampling.count_at_end=0 \
             --set sampling.sampler.num_inference_steps=2 --set sampling.preview_every_steps=2 \
             --set train.max_steps=5"
        );
        sandbox.run(&train).succeeded();
        let (run, out) = (
            format!("runs/{config}"),
            format!("runs/{config}/report.html"),
        );
        let whole = page(&sandbox, &run, &out);
        holds(
            &whole,
            &[
                "<h2>Previews</h2>",
                "Sampled after step 4.",
                "each of 2 steps",
                item,
            ],
        );
        let moving = whole.matches("class=\"kg kg-small\"").count();
        assert!((1..=4).contains(&moving), "{moving}");
        assert!(!whole.contains("<h2>Samples</h2>"));
        // An invalid one is named, and the previous one is shown.
        sandbox.write(&format!("{run}/previews/step-00000004.html"), "<p>mine");
        let older = page(&sandbox, &run, &out);
        holds(
            &older,
            &[
                "step-00000004.html shows no motion",
                "Sampled after step 2.",
            ],
        );
        assert!(!older.contains("<p>mine"));
    }
}

#[test]
fn a_page_of_a_run_that_is_trained_says_so() {
    let sandbox = sandbox();
    let mut child = sandbox.start("train c.toml --set train.max_steps=100000");
    let first = sandbox.path("runs/smallest/checkpoints/step-00000004");
    wait_for(&mut child, "a checkpoint", || first.exists());
    let busy = page(&sandbox, "runs/smallest --out busy.html", "busy.html");
    let listed = sandbox.run("runs").succeeded().stdout;
    child.kill().expect("a kill");
    child.wait().expect("an end");
    holds(&busy, &[">training</span>", "time left"]);
    assert!(listed.contains("training"), "{listed}");
    let listed = sandbox.run("runs").succeeded().stdout;
    assert!(
        listed.contains("stopped") && !listed.contains("training"),
        "{listed}"
    );
}

#[test]
fn a_page_needs_a_run_and_a_place() {
    let sandbox = sandbox();
    fs::create_dir(sandbox.path("empty")).expect("a folder");
    for run in ["empty", "nowhere", "c.toml"] {
        let said = format!("{run} is not a run");
        sandbox
            .run(&format!("report {run}"))
            .failed(2, &[&said, "hint:"]);
    }
    assert!(sandbox.list("empty").is_empty());
    sandbox
        .run("train c.toml --set train.max_steps=2")
        .succeeded();
    sandbox.write("file", "");
    for (out, text) in [
        ("empty", "`--out empty/report.html`"),
        ("file/page.html", "cannot create the folder file"),
    ] {
        sandbox
            .run(&format!("report runs/smallest --out {out}"))
            .failed(2, &[text]);
    }
    assert!(sandbox.list("empty").is_empty());
    // A missing folder is created.
    sandbox
        .run("report runs/smallest --out no/such/page.html")
        .succeeded();
    assert!(sandbox.path("no/such/page.html").exists());
}

#[test]
fn runs_are_listed_with_their_states() {
    let sandbox = sandbox();
    assert_eq!(sandbox.run("runs").succeeded().stdout, "no runs in runs\n");
    let none = sandbox.run("runs --json").succeeded().stdout;
    assert_eq!(none, "{\"runs\":[]}\n");
    sandbox
        .run("runs other")
        .failed(2, &["there is no folder other"]);
    fs::create_dir(sandbox.path("runs")).expect("a folder");
    let none = sandbox.run("runs").succeeded();
    assert_eq!(none.stdout.trim(), "no runs in runs");

    let train = "train c.toml --set validation.every_steps=2 --set train.max_steps=4";
    sandbox.run(&format!("{train} --name done")).succeeded();
    sandbox
        .run(&format!("{train} --name nested --runs-dir runs/more"))
        .succeeded();
    for name in ["damaged", "half"] {
        sandbox.run(&format!("{train} --name {name}")).succeeded();
    }
    // One has an older checkpoint, the other none.
    for state in [
        "damaged/checkpoints/step-00000002",
        "damaged/checkpoints/step-00000004",
    ] {
        let state = sandbox.path(format!("runs/{state}/state.json"));
        fs::write(state, "{}").expect("written");
    }
    let state = "runs/done/checkpoints/step-00000004/state.json";
    let kept = fs::read(sandbox.path(state)).expect("a state");
    fs::write(sandbox.path(state), "{}").expect("written");
    let older = sandbox.run("runs").succeeded();
    assert!(older.stdout.contains("2 of 4"), "{}", older.stdout);
    assert!(older.stderr.contains("warning: done: "), "{}", older.stderr);
    fs::write(sandbox.path(state), kept).expect("written");
    let config = sandbox.path("runs/half/config.toml");
    let text = fs::read_to_string(&config).expect("a config");
    fs::write(&config, text.replace("max_steps = 4", "max_steps = 9")).expect("written");
    sandbox.write("runs/new/lock", "");
    // Only an unreadable config.
    sandbox.write("runs/lost/config.toml", "[train\n");
    sandbox.write("runs/notes.txt", "mine");

    let listed = sandbox.run("runs").succeeded();
    for texts in [
        ["done", "cc_motion/diffusion", "finished", "4 of 4"],
        ["more/nested", "cc_motion/diffusion", "finished", "4 of 4"],
        ["half", "cc_motion/diffusion", "stopped", "4 of 9"],
        ["damaged", "cc_motion/diffusion", "damaged", "- of 4"],
        ["new", "-", "not started", "0"],
        ["lost", "-", "damaged", "0"],
    ] {
        let line = |line: &&str| texts.iter().all(|text| line.contains(text));
        assert!(
            listed.stdout.lines().any(|found| line(&found)),
            "{texts:?}: {}",
            listed.stdout
        );
    }
    let line = |name: &str| {
        let start = format!("warning: {name}: ");
        let mut lines = listed.stderr.lines();
        let line = lines.find(|line| line.starts_with(&start));
        line.unwrap_or_else(|| panic!("{name}: {}", listed.stderr))
    };
    let damaged = line("damaged");
    holds(damaged, &["step-00000002", "step-00000004"]);
    holds(line("lost"), &["lost/config.toml:1"]);
    let lost = page(&sandbox, "runs/lost", "runs/lost/report.html");
    holds(&lost, &[">damaged</span>", "lost/config.toml:1"]);
    let bad = page(&sandbox, "runs/damaged", "runs/damaged/report.html");
    holds(&bad, &["<dd>- of 4</dd>", ">damaged</td>"]);

    let json = sandbox.run("runs --json").succeeded().stdout;
    let json: Value = serde_json::from_str(&json).expect("JSON");
    let runs = json["runs"].as_array().expect("a list");
    let names: Vec<_> = runs.iter().filter_map(|run| run["name"].as_str()).collect();
    assert_eq!(
        names,
        ["damaged", "done", "half", "lost", "more/nested", "new"]
    );
    assert!(runs[0]["step"].is_null());
    assert!(runs[0]["problem"].is_string() && runs[1]["problem"].is_null());
    assert_eq!(runs[1]["step"], 4);
    assert!(runs[1]["best_val_loss"].is_number());
    assert!(runs[1]["bytes"].as_u64() > Some(100_000));

    let own = sandbox.run("runs runs/done").succeeded().stdout;
    assert!(own.contains("done") && own.lines().count() == 3, "{own}");
}

#[test]
fn runs_are_plotted_and_reported_together() {
    let sandbox = sandbox();
    for (name, seed) in [("one", 1), ("two", 2)] {
        let train =
            format!("train c.toml --name {name} --set train.max_steps=3 --set run.seed={seed}");
        sandbox.run(&train).succeeded();
    }
    sandbox.run("plot runs/one --out one.svg").succeeded();
    let one = fs::read_to_string(sandbox.path("one.svg")).expect("a picture");
    holds(&one, &["val_loss", "gradient norm", "learning rate"]);
    sandbox
        .run("plot runs/one runs/two --out both.svg")
        .succeeded();
    let both = fs::read_to_string(sandbox.path("both.svg")).expect("a picture");
    let named = |name: &str| both.matches(&format!("\n{name}\n")).count();
    // Each chart names both runs.
    assert!(named("one") >= 3 && named("one") == named("two"));
    holds(&both, &["validation loss", "gradient norm"]);
    // Two runs of one name are labelled by their folders.
    fs::create_dir(sandbox.path("kept")).expect("a folder");
    fs::rename(sandbox.path("runs/two"), sandbox.path("kept/one")).expect("renamed");
    sandbox
        .run("plot runs/one kept/one --out equal.svg")
        .succeeded();
    let equal = fs::read_to_string(sandbox.path("equal.svg")).expect("a picture");
    holds(&equal, &["\nruns/one\n", "\nkept/one\n"]);
    fs::rename(sandbox.path("kept/one"), sandbox.path("runs/two")).expect("renamed");
    // The loss has a single term, which equals it.
    assert!(!both.contains("loss_"));
    let page = page(&sandbox, "runs/one runs/two", "runs/comparison.html");
    holds(
        &page,
        &["one, two", "run.seed", "gradient norm", "size on disk"],
    );
    assert!(!page.contains("train.max_steps"), "the same in both");
    for (command, problem) in [
        ("plot runs/one c.toml --out q.svg", "c.toml is not a run"),
        ("plot runs/one nowhere --out q.svg", "a run at nowhere"),
        ("report runs/one nowhere", "nowhere is not a run"),
    ] {
        sandbox.run(command).failed(2, &[problem]);
    }
}

#[test]
fn evaluations_of_several_runs_are_compared() {
    let sandbox = sandbox();
    for (name, seed) in [("one", 1), ("two", 2)] {
        let train =
            format!("train c.toml --name {name} --set train.max_steps=3 --set run.seed={seed}");
        sandbox.run(&train).succeeded();
    }
    let eval = |run: &str, settings: &str| {
        let steps = "--steps 2 --set evaluation.phrases=1";
        sandbox
            .run(&format!("eval runs/{run} {steps} {settings}"))
            .succeeded();
    };
    eval("one", "");
    eval("two", "");
    eval("two", "--seed 3");
    eval("one", "--audio-ablation --set evaluation.seeds=1");
    let page = page(&sandbox, "runs/one runs/two", "runs/comparison.html");
    let section = page.split("<h2>Evaluation</h2>").nth(1).expect("a section");
    let section = section.split("</section>").next().expect("its end");
    let tables: Vec<&str> = section.split("<h3>").skip(1).collect();
    let header = |table: &str| {
        let header = table.split("<thead><tr>").nth(1).expect("a header");
        let header = header.split("</tr>").next().expect("its end");
        let cells = header.split("<th class=\"").skip(1);
        let cells = cells.map(|cell| cell.split(['>', '<']).nth(1).expect("a text").to_owned());
        cells.collect::<Vec<_>>()
    };
    // The evaluation of both runs, the ablation of one, and the evaluation with another seed.
    let headers: Vec<_> = tables.iter().map(|table| header(table)).collect();
    assert_eq!(headers[0], ["measure", "one", "two", "real", "better"]);
    assert_eq!(headers[1], ["measure", "one", "real", "better"]);
    assert_eq!(headers[2], ["measure", "two", "real", "better"]);
    assert_eq!(tables.len(), 3);
    holds(tables[1], &["Not evaluated with these settings: two."]);
    holds(tables[2], &["Settings: seed = &quot;3&quot;."]);
    holds(tables[2], &["Not evaluated with these settings: one."]);
    let both = tables[0];
    holds(both, &["one: ", "two: ", "every measure"]);
    // Direction and best value of a measure whose values differ.
    let rows: Vec<&str> = both
        .lines()
        .filter(|row| row.contains("path_speed.median"))
        .collect();
    let row = rows.first().expect("a main measure");
    assert!(row.contains(">near real</td>"), "{row}");
    assert_eq!(row.matches("good").count(), 1, "{row}");
    assert_eq!(row.matches(">* ").count(), 1, "{row}");
    // The best one is that of `eval`.
    let said = sandbox.run("eval runs/one runs/two --steps 2 --set evaluation.phrases=1");
    let said = said.succeeded().stdout;
    let line = said
        .lines()
        .find(|line| line.contains("mean speed along the path"));
    let cells: Vec<&str> = line.expect(&said).split('|').collect();
    let best = cells[1..3].iter().position(|cell| cell.contains('*'));
    let shown = row
        .split("</td>")
        .skip(1)
        .position(|cell| cell.contains(">* "));
    assert_eq!(shown, best, "{row} {cells:?}");
}
