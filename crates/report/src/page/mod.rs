//! Pages of results: one HTML file that needs nothing beside itself.

mod chart;
mod csv;
mod html;

use crate::viewer::Thumbnail;

pub use chart::{Chart, Line};
pub use csv::csv_table;
pub use html::{escape, html};

/// A page.
#[derive(Clone, Debug, Default)]
pub struct Page {
    /// Title.
    pub title: String,
    /// What it is of, in a line below the title.
    pub subtitle: String,
    /// How things stand, beside the title.
    pub status: Cell,
    /// What matters most: name and value.
    pub highlights: Vec<(String, String)>,
    /// The sections in their order; those without blocks are left out.
    pub sections: Vec<Section>,
}

/// A part of a page under a heading.
#[derive(Clone, Debug, Default)]
pub struct Section {
    /// The heading.
    pub title: String,
    /// What it holds.
    pub blocks: Vec<Block>,
}

/// A part of a section.
#[derive(Clone, Debug)]
pub enum Block {
    /// A smaller heading.
    Heading(String),
    /// A paragraph.
    Text(String),
    /// A paragraph that is to be seen.
    Warning(String),
    /// Names and what is said of them.
    Facts(Vec<(String, String)>),
    /// A table.
    Table(Table),
    /// Charts beside one another.
    Charts(Vec<Chart>),
    /// Moving objects beside one another.
    Scenes(Vec<Thumbnail>),
    /// A long table, folded away below its title.
    Folded {
        /// Title.
        title: String,
        /// The table.
        table: Table,
    },
    /// Text as it stands, folded away below its title.
    Source {
        /// Title.
        title: String,
        /// The text.
        text: String,
    },
}

/// A table.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    /// Names of the columns.
    pub header: Vec<String>,
    /// The rows; one with a single cell is a heading over all columns.
    pub rows: Vec<Vec<Cell>>,
}

/// A cell of a table.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cell {
    /// What it says.
    pub text: String,
    /// What that means.
    pub tone: Tone,
}

/// What a value means.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Tone {
    /// A number or a name.
    #[default]
    Plain,
    /// As it should be.
    Good,
    /// Not as it should be.
    Bad,
    /// Going on.
    Busy,
}

impl Cell {
    /// A cell of that tone.
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

    /// Adds a block, unless there is nothing in it.
    pub fn add(&mut self, block: Block) {
        let is_empty = match &block {
            Block::Facts(facts) => facts.is_empty(),
            Block::Table(table) | Block::Folded { table, .. } => table.rows.is_empty(),
            Block::Charts(charts) => charts.iter().all(Chart::is_empty),
            Block::Scenes(scenes) => scenes.is_empty(),
            Block::Heading(text) | Block::Text(text) | Block::Warning(text) => text.is_empty(),
            Block::Source { text, .. } => text.is_empty(),
        };
        if !is_empty {
            self.blocks.push(block);
        }
    }
}
