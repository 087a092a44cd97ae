//! Systems: one folder per generative method.
//!
//! A [`System`] defines its name, its recipes, its config tables, and how to validate, train,
//! sample, evaluate and import weights. Code outside a system's folder does not refer to it by
//! name: entry points take a list of [`Systems`] and find the system of a run by its recipe.
//! [`BUILT_IN`] lists the systems of this crate.

pub mod bpe_transformer;
pub mod cc_motion;
pub mod flow;
pub mod gmd;
pub mod text_motion;

pub use crate::recipe::RecipeInfo;
pub use crate::system::{System, Systems};

/// The systems of this crate.
pub const BUILT_IN: Systems<'static> = Systems(&[
    &cc_motion::CcMotion,
    &gmd::Gmd,
    &flow::Flow,
    &bpe_transformer::BpeTransformer,
    &text_motion::TextMotionSystem,
]);

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::Path;

    use super::*;

    /// Calls `visit` with each file below `folder` and its text.
    fn each_file(folder: &Path, visit: &mut dyn FnMut(&Path, &str)) {
        for entry in fs::read_dir(folder).expect("a folder of sources") {
            let path = entry.expect("an entry").path();
            match path.is_dir() {
                true => each_file(&path, visit),
                false => visit(&path, &fs::read_to_string(&path).expect("source text")),
            }
        }
    }

    #[test]
    fn no_file_of_a_system_names_another_system() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/systems");
        let (mut files, mut found) = (0, Vec::new());
        for own in BUILT_IN.0 {
            each_file(&folder.join(own.name()), &mut |path, text| {
                files += 1;
                let others = BUILT_IN.0.iter().map(|other| other.name());
                for other in others.filter(|other| *other != own.name()) {
                    let names = ["systems::", "super::", "kinegrad_"];
                    let names = names.map(|before| format!("{before}{other}"));
                    if names.iter().any(|name| text.contains(name)) {
                        found.push(format!("{} names `{other}`", path.display()));
                    }
                }
                if text.contains("systems::{") {
                    found.push(format!("{}: one import a system", path.display()));
                }
            });
        }
        assert!(files > 50, "{files} files");
        assert!(found.is_empty(), "{found:#?}");
    }
}
