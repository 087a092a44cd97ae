//! Previews of a run without samples.

use kinegrad_data::file::read_text;
use kinegrad_report::page::{Block, Section};
use kinegrad_report::viewer::Thumbnail;
use kinegrad_train::run::PREVIEWS;

use super::own_files;
use crate::io::file_stem;
use crate::runs::Run;

/// The newest previews as moving thumbnails.
pub fn section(run: &Run) -> Section {
    let mut section = Section::new("Previews");
    let pages = own_files(&run.folder, PREVIEWS, &["html"], &mut section);
    for page in pages.iter().rev() {
        let thumbnails = match read_text(page) {
            Ok(text) => Thumbnail::of_page(&text),
            Err(error) => {
                section.add(Block::Warning(format!("{}: {error}", page.display())));
                continue;
            }
        };
        if thumbnails.is_empty() {
            let text = format!("{} shows no motion", page.display());
            section.add(Block::Warning(text));
            continue;
        }
        let name = file_stem(page);
        let step = name.trim_start_matches("step-").trim_start_matches('0');
        let step = if step.is_empty() { "0" } else { step };
        let all = match pages.len() {
            1 => String::new(),
            pages => format!(" The folder {PREVIEWS} has a page for each of {pages} steps."),
        };
        section.add(Block::Text(format!("Sampled after step {step}.{all}")));
        section.add(Block::Scenes(thumbnails));
        break;
    }
    section
}
