//! The list of systems.

use std::fs;
use std::path::Path;

use kinegrad_cc_motion::CcMotion;
use kinegrad_train::Systems;

use crate::BUILT_IN;

#[test]
fn every_recipe_is_of_one_system() {
    for recipe in BUILT_IN.recipes() {
        assert!(BUILT_IN.of_recipe(recipe.name).is_some());
    }
    assert!(BUILT_IN.of_recipe("nobody's").is_none());
}

#[test]
#[should_panic(expected = "two recipes are called `decoder`: of the systems `cc_motion` and")]
fn a_list_in_which_one_recipe_hides_another_is_refused() {
    Systems(&[&CcMotion, &CcMotion]).of_recipe("decoder");
}

/// Calls `visit` with each source file and manifest below `folder` and its text.
fn each_file(folder: &Path, visit: &mut dyn FnMut(&Path, &str)) {
    for entry in fs::read_dir(folder).expect("a folder of sources") {
        let path = entry.expect("an entry").path();
        match path.is_dir() {
            true => each_file(&path, visit),
            false => visit(&path, &fs::read_to_string(&path).expect("text")),
        }
    }
}

#[test]
fn no_file_of_a_system_names_another_system() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let (mut files, mut found) = (0, Vec::new());
    for own in BUILT_IN.0 {
        each_file(&folder.join(own.name()), &mut |path, text| {
            files += 1;
            let others = BUILT_IN.0.iter().map(|other| other.name());
            for other in others.filter(|other| *other != own.name()) {
                let package = format!("kinegrad-{}", other.replace('_', "-"));
                if text.contains(&format!("kinegrad_{other}")) || text.contains(&package) {
                    found.push(format!("{} names `{other}`", path.display()));
                }
            }
        });
    }
    assert!(files > 100, "{files} files");
    assert!(found.is_empty(), "{found:#?}");
}
