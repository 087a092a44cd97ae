//! Pages of motion: files and refusals. `tests/pages` opens them in a browser.

use std::fs;

use kinegrad_capture::Bvh;
use kinegrad_data::write_values;
use kinegrad_motion::humanml::walk::{Course, joints as walk};
use kinegrad_motion::humanml::{Joints, Skeleton};
use kinegrad_motion::metrics::skating_ratio;
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

/// A BVH file of a root and the joints above and below it, `frames` of them.
fn capture(frames: usize) -> String {
    let mut text =
        "HIERARCHY\nROOT Hips\n{\nOFFSET 0 0 0\nCHANNELS 6 Xposition Yposition Zposition \
                    Zrotation Xrotation Yrotation\n"
            .to_string();
    for (name, height) in [("Head", 70), ("LeftFoot", -85)] {
        text += &format!(
            "JOINT {name}\n{{\nOFFSET 0 {height} 0\nCHANNELS 3 Zrotation Xrotation Yrotation\n\
             End Site\n{{\nOFFSET 0 1 0\n}}\n}}\n"
        );
    }
    text += &format!("}}\nMOTION\nFrames: {frames}\nFrame Time: 0.0333333\n");
    for t in 0..frames {
        text += &format!("{t} 90 0 0 0 0 5 0 0 0 {} 0\n", t % 40);
    }
    text
}

#[cfg(unix)]
#[test]
fn ctrl_c_ends_a_film_and_leaves_nothing_behind() {
    use kinegrad_tests::sandbox::wait_for;
    use std::os::unix::fs::PermissionsExt;
    let sandbox = sandbox();
    sandbox.write("long.bvh", capture(9000));
    // A stand-in for ffmpeg that reads all pictures.
    let script = "#!/bin/sh\n[ \"$1\" = -version ] && exit 0\nfor last; do :; done\n\
                  echo half > \"${last#file:}\"\nexec cat > /dev/null\n";
    let program = sandbox.write("programs/ffmpeg", script);
    fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).expect("a program");
    let path = std::env::var("PATH").unwrap_or_default();
    for (option, begun) in [("--mp4 film.mp4", true), ("--gif film.gif", false)] {
        let mut command = sandbox.command(format!("view long.bvh {option}").split(' '));
        command.env(
            "PATH",
            format!("{}:{path}", sandbox.path("programs").display()),
        );
        let mut viewing = command.spawn().expect("the binary starts");
        match begun {
            true => wait_for(&mut viewing, "half a film", || {
                let names = sandbox.list(".").into_iter();
                let mut unfinished = names.filter(|name| name.starts_with(".writing-"));
                unfinished
                    .any(|name| fs::read(sandbox.path(name)).is_ok_and(|film| film == b"half\n"))
            }),
            false => std::thread::sleep(std::time::Duration::from_millis(1500)),
        }
        let id = viewing.id().to_string();
        let sent = std::process::Command::new("kill")
            .args(["-INT", &id])
            .status();
        assert!(sent.expect("kill").success());
        assert_eq!(
            viewing.wait().expect("an end").code(),
            Some(130),
            "{option}"
        );
        let left = sandbox.list(".");
        let is_left = |name: &String| name.contains("film") || name.starts_with(".writing-");
        assert!(!left.iter().any(is_left), "{left:?}");
    }
}

#[test]
fn of_several_files_none_is_written_unless_all_can_be() {
    let sandbox = sandbox();
    write_values(&sandbox.path("points.npy"), &[3, 4, 3], &[0.5; 36]).expect("written");
    sandbox.write("there.glb", "older");
    sandbox.write("file", "no folder");
    for (arguments, texts) in [
        (
            "points.npy --out p.html --glb p.glb",
            &[
                "p.glb: the skeleton of `points` is not known",
                "4 joints",
                "BVH file",
            ][..],
        ),
        (
            "points.npy --out p.html --bvh p.bvh",
            &["points.npy", "hint:"],
        ),
        (
            "walk.npy --out p.html --gif p.gif --glb there.glb",
            &["there.glb exists already"],
        ),
        (
            "walk.npy --out p.html --glb file/p.glb",
            &["cannot create the folder file"],
        ),
    ] {
        let refused = sandbox.run(&format!("view {arguments}"));
        assert!(
            !refused.stderr.contains("numbers are finite"),
            "{}",
            refused.stderr
        );
        refused.failed(2, texts);
    }
    // There is no ffmpeg in an empty PATH.
    let mut command = sandbox.command("view walk.npy --out p.html --mp4 p.mp4".split(' '));
    command.env("PATH", sandbox.path("none"));
    kinegrad_tests::sandbox::finish(command).failed(2, &["`ffmpeg` cannot be started"]);
    let left = sandbox.list(".");
    assert!(
        !left
            .iter()
            .any(|name| name.starts_with("p.") || name.contains("tmp")),
        "{left:?}"
    );
    assert_eq!(
        fs::read_to_string(sandbox.path("there.glb")).unwrap(),
        "older"
    );
}

#[test]
fn raw_output_that_is_not_there_is_missed_aloud() {
    let sandbox = sandbox();
    fs::remove_file(sandbox.path("walk.raw.npy")).expect("removed");
    let said = sandbox.run("view walk.npy --raw").succeeded().stderr;
    let warning = "warning: `--raw`: there is no walk.raw.npy beside walk.npy";
    assert!(said.contains(warning), "{said}");
    fs::copy(sandbox.path("walk.npy"), sandbox.path("walk.raw.npy")).expect("copied");
    let said = sandbox
        .run("view walk.npy --raw --overwrite")
        .succeeded()
        .stderr;
    assert!(!said.contains("warning"), "{said}");
}

#[test]
fn a_bvh_file_of_bones_that_change_says_how_far_it_is_off() {
    let sandbox = sandbox();
    // Bones of the motion from `sandbox` have almost no length.
    let said = sandbox
        .run("view walk.npy --bvh off.bvh")
        .succeeded()
        .stderr;
    let note = said
        .lines()
        .find(|line| line.starts_with("note: off.bvh: joints are up to"));
    let note = note.unwrap_or_else(|| panic!("no note in {said}"));
    assert!(note.contains("--glb"), "{note}");
    let told: f64 = note
        .split("up to ")
        .nth(1)
        .unwrap()
        .split(' ')
        .next()
        .unwrap()
        .parse()
        .unwrap();
    let named = note.split('`').nth(1).unwrap();
    let frame = note.split("in frame ").nth(1).unwrap();
    let frame: usize = frame.split(')').next().unwrap().parse().unwrap();
    // Read back, that joint differs from the motion by the reported distance.
    let bytes = fs::read(sandbox.path("off.bvh")).unwrap();
    let bvh = kinegrad_capture::Bvh::parse(&bytes, "off.bvh").unwrap();
    let skeleton = kinegrad_motion::humanml::Skeleton::humanml3d();
    let names = &skeleton.description().joint_names;
    let joint = names
        .iter()
        .position(|name| name == named)
        .expect("a joint");
    let found = bvh.world(frame)[bvh.joint(named).unwrap()].position;
    let off: f64 = (0..3)
        .map(|axis| {
            let value = ((frame * 66 + 3 * joint + axis) as f32 * 0.1).sin();
            (found[axis] / 100.0 - f64::from(value)).powi(2)
        })
        .sum();
    assert!((off.sqrt() - told).abs() < 1e-3, "{told} is {}", off.sqrt());

    sandbox.write("exact.bvh", capture(5));
    let said = sandbox
        .run("view exact.bvh --bvh again.bvh")
        .succeeded()
        .stderr;
    assert!(!said.contains("joints are up to"), "{said}");
}

#[test]
fn missing_folders_are_made_whatever_is_written() {
    let sandbox = sandbox();
    fs::create_dir_all(sandbox.path("run/checkpoints")).expect("a folder");
    sandbox.write("run/config.toml", "");
    let line = "{\"step\": 1, \"time\": 1.0, \"loss\": 2.0}\n";
    sandbox.write("run/metrics.jsonl", line);
    for (arguments, file) in [
        (
            "view walk.npy --out a/1/page.html --glb a/2/walk.glb",
            "a/2/walk.glb",
        ),
        ("plot walk.npy --out b/1/walk.svg", "b/1/walk.svg"),
        ("init prepare --out c/1/plan.toml", "c/1/plan.toml"),
        ("report run --out d/1/report.html", "d/1/report.html"),
        (
            "data synth --phrases 2 --frames 40 --out e/1/set",
            "e/1/set/motion",
        ),
        ("man --out f/1/pages", "f/1/pages/kinegrad.1"),
    ] {
        sandbox.run(arguments).succeeded();
        assert!(sandbox.path(file).exists(), "{file}");
    }
    sandbox.write("file", "");
    for arguments in [
        "view walk.npy --out file/1/page.html",
        "plot walk.npy --out file/1/walk.svg",
        "init prepare --out file/1/plan.toml",
        "report run --out file/1/report.html",
        "man --out file/1",
    ] {
        let texts = ["cannot create the folder file/1", "hint:"];
        sandbox.run(arguments).failed(2, &texts);
    }
}

#[test]
fn a_folder_of_no_dataset_is_told_what_datasets_are() {
    let sandbox = sandbox();
    sandbox.write("captures/one.bvh", capture(3));
    let texts = [
        "captures is not a dataset",
        "motion/ID/trajectory.npy",
        "new_joint_vecs/ID.npy",
    ];
    let refused = sandbox.run("data inspect captures").failed(2, &texts);
    for text in ["HumanML3D", "KIT-ML", "data prepare", "--walks"] {
        assert!(refused.stderr.contains(text), "{}", refused.stderr);
    }
    sandbox
        .run("data inspect none")
        .failed(2, &["there is no folder none"]);
}

#[test]
fn feet_that_slide_are_held_in_a_bvh_file() {
    let sandbox = sandbox();
    let skeleton = Skeleton::humanml3d();
    let course = Course {
        speed: Box::new(|_| 1.1),
        turning: Box::new(|t| 0.4 * (1.3 * t).sin()),
    };
    // It slides back, so its strides are longer than its path: 2.7 cm a frame.
    let places = walk(&course, &skeleton, 70);
    let frames = places.chunks(skeleton.joints()).enumerate();
    let slid = frames.flat_map(|(t, frame)| {
        let by = 0.024 * t as f64;
        frame
            .iter()
            .map(move |[x, y, z]| [x - 0.5 * by, *y, z - by])
    });
    let slid = Joints::new(slid.collect(), skeleton.joints()).expect("places");
    let shape = [slid.frames(), slid.joints(), 3];
    write_values(&sandbox.path("slid.npy"), &shape, &slid.to_f32()).expect("a file");
    let skating = |options: &str| {
        let said = sandbox
            .run(&format!(
                "view slid.npy --bvh slid.bvh --overwrite {options}"
            ))
            .succeeded();
        let bytes = fs::read(sandbox.path("slid.bvh")).expect("a file");
        let bvh = Bvh::parse(&bytes, "slid.bvh").expect("what was written");
        let joints = bvh.joints_of(&skeleton, 100.0).expect("all joints");
        let ratio = skating_ratio(&joints, 20.0, &[10, 11]).expect("steps");
        (ratio, said.stderr)
    };
    let (before, said) = skating("");
    assert!(!said.contains("feet stand"), "{said}");
    let (after, said) = skating("--lock-feet");
    assert!(said.contains("note: slid.bvh: feet stand in"), "{said}");
    println!("skating {before} before, {after} after: {said}");
    // A foot that has just left the ground is low and fast, sliding or not.
    assert!(before > 0.8 && after < 0.2, "{before} {after}");

    sandbox
        .run("view slid.bvh --bvh again.bvh --lock-feet")
        .failed(2, &["slid.bvh", "`--lock-feet`", "a BVH file"]);
    sandbox
        .run("view slid.npy --lock-feet")
        .failed(2, &["--bvh"]);
}
