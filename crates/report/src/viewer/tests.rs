use super::*;
use crate::scene::{Curves, PartOrigins, SongFormat};

fn object(name: &str, frames: usize, joints: usize) -> SceneObject {
    let place = |i: usize| (i as f32 * 0.37).sin();
    SceneObject {
        name: name.to_string(),
        fps: 30.0,
        positions: (0..frames * joints * 3).map(place).collect(),
        joint_names: (0..joints).map(|joint| format!("joint {joint}")).collect(),
        parents: (0..joints).map(|joint| joint.checked_sub(1)).collect(),
        contacts: vec![Contact {
            joint: 0,
            frames: (0..frames).map(|frame| frame % 4 != 0).collect(),
        }],
        curves: vec![Curves {
            title: "height (m)".to_string(),
            series: vec![("root".to_string(), vec![1.0; frames])],
        }],
        ..SceneObject::default()
    }
}

#[test]
fn a_page_refers_to_nothing_outside_of_itself() {
    let page = page(&Scene {
        title: "one".to_string(),
        objects: vec![object("a", 9, 3)],
        ..Scene::default()
    });
    // The namespace of SVG icons, which is never loaded.
    let page = page.replace("http://www.w3.org/2000/svg", "");
    assert!(!page.contains("http://") && !page.contains("https://"));
    assert!(!page.contains(" src=\""));
    assert!(page.contains(CONTENT_SECURITY_POLICY));
}

#[test]
fn names_are_text_wherever_they_stand() {
    let name = "</script><script>alert(1)</script><!--\"'&\u{2028}";
    let scene = Scene {
        title: name.to_string(),
        objects: vec![object(name, 2, 1)],
        ..Scene::default()
    };
    let page = page(&scene);
    assert!(!page.contains("<script>alert"));
    assert!(!page.contains("<!--"));
    // One script of data and one script of the viewer.
    assert_eq!(page.matches("</script>").count(), 2);
    let data = scene_json(&scene, false);
    let read: Value = serde_json::from_str(&inert(&data)).unwrap();
    assert_eq!(read["figures"][0]["name"], name);
}

#[test]
fn contacts_are_ranges_and_thumbnails_leave_curves_and_song_out() {
    let scene = Scene {
        objects: vec![object("a", 7, 2)],
        song: Some(Song {
            format: SongFormat::Wav,
            bytes: vec![1, 2, 3],
            start: 0.5,
            beats: vec![1.0],
        }),
        ..Scene::default()
    };
    let large = scene_json(&scene, false);
    assert_eq!(
        large["figures"][0]["contacts"][0]["ranges"],
        json!([[1, 4], [5, 7]])
    );
    assert_eq!(large["song"]["src"], "data:audio/wav;base64,AQID");
    let small = scene_json(&scene, true);
    assert_eq!(small["figures"][0]["charts"], json!([]));
    assert!(small["song"].is_null());
    assert!(
        Thumbnail::from(scene.clone())
            .html()
            .contains("class=\"kg kg-small\"")
    );
}

#[test]
fn origins_are_runs_of_named_examples() {
    let part = PartOrigins {
        name: "body".to_string(),
        runs: vec![[3, 1, 20, 6]],
    };
    let origins = Origins {
        examples: vec![("walk".to_string(), 40), ("run".to_string(), 30)],
        parts: vec![part],
    };
    let scene = Scene {
        objects: vec![SceneObject {
            origins: Some(origins),
            ..object("a", 9, 2)
        }],
        ..Scene::default()
    };
    let large = &scene_json(&scene, false)["figures"][0]["origins"];
    assert_eq!(large["examples"][1], json!({ "name": "run", "frames": 30 }));
    assert_eq!(large["parts"][0]["runs"], json!([[3, 1, 20, 6]]));
    assert!(scene_json(&scene, true)["figures"][0]["origins"].is_null());
    let plain = Scene {
        objects: vec![object("a", 9, 2)],
        ..Scene::default()
    };
    assert!(scene_json(&plain, false)["figures"][0]["origins"].is_null());
}

#[test]
fn four_clips_of_ten_seconds_with_seventy_joints_fit_into_a_megabyte_and_a_half() {
    // Smooth swings with capture noise.
    let mut state = 1u32;
    let mut noise = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 24) as f32 * 0.0005
    };
    let mut clip = object("clip", 0, 70);
    clip.fps = 60.0;
    for t in 0..600 {
        for c in 0..210 {
            let place = (t as f32 * (0.02 + c as f32 * 0.0003)).sin() + noise();
            clip.positions.push(place);
        }
    }
    let scene = Scene {
        objects: vec![clip; 4],
        ..Scene::default()
    };
    let bytes = page(&scene).len();
    assert!(bytes < 1_500_000, "{bytes} bytes");
}

#[test]
fn no_script_passes_a_list_of_points_as_arguments() {
    for call in ["Math.min(...", "Math.max(...", "push(..."] {
        assert!(!script().contains(call), "{call}");
    }
}
