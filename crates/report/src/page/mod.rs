//! Pages of results, each a self-contained HTML file.

mod csv;
mod html;

use crate::Panel;
use crate::viewer::Thumbnail;

pub use crate::escape::escape;
pub use csv::csv_table;
pub use html::html;

/// A page.
#[derive(Clone, Debug, Default)]
pub struct Page {
    /// Title.
    pub title: String,
    /// Subtitle.
    pub subtitle: String,
    /// Status, beside the title.
    pub status: Cell,
    /// Main results: name and value.
    pub highlights: Vec<(String, String)>,
    /// The sections; empty ones are omitted.
    pub sections: Vec<Section>,
}

/// A section of a page.
#[derive(Clone, Debug, Default)]
pub struct Section {
    /// The heading.
    pub title: String,
    /// The blocks.
    pub blocks: Vec<Block>,
}

/// A block of a section.
#[derive(Clone, Debug)]
pub enum Block {
    /// A smaller heading.
    Heading(String),
    /// A paragraph.
    Text(String),
    /// A highlighted paragraph.
    Warning(String),
    /// Names and values.
    Facts(Vec<(String, String)>),
    /// A table.
    Table(Table),
    /// Charts side by side.
    Charts(Vec<Panel>),
    /// Moving objects side by side.
    Scenes(Vec<Thumbnail>),
    /// A collapsed table, below its title.
    Folded(String, Table),
    /// Collapsed preformatted text, below its title.
    Source(String, String),
}

/// A table.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    /// Names of the columns.
    pub header: Vec<String>,
    /// The rows; a row with a single cell is a heading.
    pub rows: Vec<Vec<Cell>>,
}

/// A cell of a table.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cell {
    /// The text.
    pub text: String,
    /// The tone.
    pub tone: Tone,
}

/// Tone of a value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Tone {
    /// Neutral.
    #[default]
    Plain,
    /// A good value.
    Good,
    /// A bad value.
    Bad,
    /// In progress.
    Busy,
}

impl Cell {
    /// A cell with a tone.
    pub fn new(text: impl Into<String>, tone: Tone) -> Self {
        Self {
            text: text.into(),
            tone,
        }
    }
}

impl<T: Into<String>> From<T> for Cell {
    fn from(text: T) -> Self {
        Self::new(text, Tone::Plain)
    }
}

impl Section {
    /// A section without blocks.
    pub fn new(title: impl Into<String>) -> Self {
        Self {
            title: title.into(),
            blocks: Vec::new(),
        }
    }

    /// Adds a block unless it is empty.
    pub fn add(&mut self, block: Block) {
        let is_empty = match &block {
            Block::Facts(facts) => facts.is_empty(),
            Block::Table(table) | Block::Folded(_, table) => table.rows.is_empty(),
            Block::Charts(charts) => charts.iter().all(Panel::is_empty),
            Block::Scenes(scenes) => scenes.is_empty(),
            Block::Heading(text) | Block::Text(text) => text.is_empty(),
            Block::Warning(text) | Block::Source(_, text) => text.is_empty(),
        };
        if !is_empty {
            self.blocks.push(block);
        }
    }
}
