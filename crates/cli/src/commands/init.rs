//! `kinegrad init`

use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use kinegrad_train::Error;

use super::nearest;
use crate::args::{DEFAULT_CONFIG, InitArguments, STDOUT};
use crate::folder;

/// The default template.
const FIRST: &str = "quickstart";

/// A file of the repository's folder `configs`.
struct Template {
    name: &'static str,
    text: &'static str,
}

macro_rules! templates {
    ($($name:literal),* $(,)?) => {
        &[$(Template {
            name: $name,
            text: include_str!(concat!("../../../../configs/", $name, ".toml")),
        }),*]
    };
}

/// All templates, in the order of `--list`.
const TEMPLATES: &[Template] = templates![
    "quickstart",
    "phrases",
    "decoder",
    "e2e",
    "e2e_quickstart",
    "gmd_motion",
    "gmd_trajectory",
    "mdm",
    "gmd_motion_tiny",
    "gmd_trajectory_tiny",
    "bodies_motion",
    "bodies_trajectory",
    "flow_tiny",
    "flow",
    "bpe_tiny",
    "bodies_bpe",
    "bpe",
    "text_motion",
    "prepare",
    "bodies",
    "goal",
    "compose",
];

impl Template {
    /// The first sentence of its comment.
    fn purpose(&self) -> String {
        let lines = self.text.lines().map_while(|line| line.strip_prefix("# "));
        let paragraph = lines.collect::<Vec<_>>().join(" ");
        let stops = paragraph.match_indices(". ").map(|(stop, _)| stop);
        // "et al. 2023" does not end a sentence.
        let mut ends = stops.filter(|stop| paragraph[stop + 2..].starts_with(char::is_uppercase));
        let sentence = ends.next().map_or(&*paragraph, |end| &paragraph[..end]);
        let sentence = sentence.trim_end_matches(['.', ':']);
        self.outside(sentence, Path::new("prepare.toml"))
    }

    /// The command that uses the file.
    fn command(&self, file: &Path) -> String {
        let path = file.display();
        match self.name {
            "prepare" | "bodies" => format!("kinegrad data prepare {path}"),
            "goal" => format!("kinegrad sample RUN --goal {path} --out walk"),
            "compose" => format!("kinegrad sample RUN --prompts {path} --out walk"),
            _ if file == Path::new(DEFAULT_CONFIG) => "kinegrad train".to_owned(),
            _ => format!("kinegrad train {path}"),
        }
    }

    /// `text` for an installed program: without the folder `configs`, and with files of a plan
    /// beside it.
    fn outside(&self, text: &str, file: &Path) -> String {
        let itself = format!("kinegrad train configs/{}.toml", self.name);
        text.replace("cargo run --release -- ", "kinegrad ")
            .replace(&itself, &self.command(file))
            .replace(
                "Takes about a minute on two cores after the build",
                "Takes about a minute",
            )
            .replace("configs/", "")
            .replace("\"../", "\"")
    }

    /// The text of `file`.
    fn contents(&self, file: &Path) -> String {
        format!(
            "# Written by `kinegrad init {}`. Next: `{}`\n\
             # `kinegrad config explain KEY` explains a key.\n\n{}",
            self.name,
            self.command(file),
            self.outside(self.text, file)
        )
    }
}

/// Writes a template.
pub fn run(arguments: InitArguments) -> Result<ExitCode, Error> {
    if arguments.list {
        for template in TEMPLATES {
            say!("{:<20} {}", template.name, template.purpose());
        }
        return Ok(ExitCode::SUCCESS);
    }
    let name = arguments.name.as_deref();
    let template = find(name.unwrap_or(FIRST))?;
    let usual = match name {
        Some(name) => PathBuf::from(format!("{name}.toml")),
        None => PathBuf::from(DEFAULT_CONFIG),
    };
    if arguments.out.as_deref() == Some(Path::new(STDOUT)) {
        show!("{}", template.contents(&usual).trim_end());
        return Ok(ExitCode::SUCCESS);
    }
    let file = arguments.out.unwrap_or(usual);
    write_new(&file, &template.contents(&file))?;
    say!("{}", file.display());
    tell!("next: `{}`", template.command(&file));
    Ok(ExitCode::SUCCESS)
}

fn find(name: &str) -> Result<&'static Template, Error> {
    let found = TEMPLATES.iter().find(|template| template.name == name);
    found.ok_or_else(|| {
        let names: Vec<&str> = TEMPLATES.iter().map(|template| template.name).collect();
        let hint = match nearest(name, names.iter().copied()) {
            Some(near) => format!("did you mean `kinegrad init {near}`?"),
            None => "`kinegrad init --list` describes them".into(),
        };
        let message = format!("there is no config `{name}`, allowed: {}", names.join(", "));
        Error::usage(message, hint)
    })
}

/// Writes a new file; fails if the file exists.
fn write_new(file: &Path, text: &str) -> Result<(), Error> {
    folder::make_for(file)?;
    kinegrad_output::write_new(file, text.as_bytes()).map_err(|error| match error.kind() {
        ErrorKind::AlreadyExists => Error::usage(
            format!("{} exists already", file.display()),
            "remove it, or write another one with `--out FILE.toml`",
        ),
        _ => Error::io("write", file)(error),
    })
}

#[cfg(test)]
mod tests {
    use kinegrad_systems::BUILT_IN;

    use super::*;

    #[test]
    fn a_written_config_is_that_of_the_repository_with_valid_paths() {
        for template in TEMPLATES {
            let file = PathBuf::from(format!("{}.toml", template.name));
            let written = template.contents(&file);
            for absent in ["configs/", "cargo run", "../"] {
                assert!(!written.contains(absent), "{}: {absent}", template.name);
            }
            assert!(written.lines().all(|line| line.len() <= 110), "{written}");
            assert!(template.purpose().len() > 20, "{}", template.purpose());
            if !matches!(template.name, "prepare" | "bodies" | "goal" | "compose") {
                let read = BUILT_IN
                    .parse(&written, template.name, &[])
                    .expect("a config");
                let own = BUILT_IN
                    .parse(template.text, template.name, &[])
                    .expect("a config");
                assert_eq!(read, own);
            }
        }
    }

    #[test]
    fn every_config_of_the_repository_can_be_written() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs");
        let files = std::fs::read_dir(folder)
            .expect("the folder of configs")
            .flatten();
        let files = files.map(|entry| entry.path());
        for file in files.filter(|path| path.is_file()) {
            let name = file.file_stem().expect("a name").to_string_lossy();
            assert!(find(&name).is_ok(), "{name}");
        }
    }
}
