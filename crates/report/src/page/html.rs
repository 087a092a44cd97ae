//! Pages as HTML.

use std::fmt::Write;

use super::{Block, Cell, Page, Section, Table, Tone};
use crate::escape::escape;
use crate::viewer::{self, CONTENT_SECURITY_POLICY};

/// Style sheet.
const STYLE: &str = include_str!("style.css");

/// Length of a cell above which the column is text.
const WORDS: usize = 24;

/// The page as HTML.
pub fn html(page: &Page) -> String {
    let title = escape(&page.title);
    let mut out = format!(
        "<!doctype html>\n<html lang=en>\n<head>\n<meta charset=utf-8>\n\
         <meta name=viewport content=\"width=device-width, initial-scale=1\">\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"{CONTENT_SECURITY_POLICY}\">\n\
         <link rel=icon href=\"data:,\">\n<title>{title}</title>\n<style>\n{STYLE}</style>\n"
    );
    let mut sections: Vec<&Section> = page.sections.iter().collect();
    sections.retain(|section| !section.blocks.is_empty());
    let mut blocks = sections.iter().flat_map(|section| &section.blocks);
    let moves = blocks.any(|block| matches!(block, Block::Scenes(_)));
    if moves {
        let _ = writeln!(out, "<style>\n{}</style>", viewer::style());
    }
    let (status, subtitle) = (status(&page.status), escape(&page.subtitle));
    out += "</head>\n<body>\n<main>\n<header class=page>";
    let _ = writeln!(out, "<h1>{title}</h1>{status}<p>{subtitle}</p></header>");
    highlights(&mut out, &page.highlights);
    out += "<nav>";
    for (index, section) in sections.iter().enumerate() {
        let _ = write!(out, "<a href=\"#s{index}\">{}</a>", escape(&section.title));
    }
    out += "</nav>\n";
    for (index, section) in sections.iter().enumerate() {
        let title = escape(&section.title);
        let _ = writeln!(out, "<section id=s{index}><h2>{title}</h2>");
        for item in &section.blocks {
            block(&mut out, item);
        }
        out += "</section>\n";
    }
    out += "</main>\n";
    if moves {
        let _ = writeln!(out, "<script>\n{}</script>", viewer::script());
    }
    out + "</body>\n</html>\n"
}

fn tone(tone: Tone) -> &'static str {
    match tone {
        Tone::Plain => "",
        Tone::Good => "good",
        Tone::Bad => "bad",
        Tone::Busy => "busy",
    }
}

fn status(cell: &Cell) -> String {
    if cell.text.is_empty() {
        return String::new();
    }
    let (tone, text) = (tone(cell.tone), escape(&cell.text));
    format!("<span class=\"pill {tone}\">{text}</span>")
}

fn highlights(out: &mut String, highlights: &[(String, String)]) {
    if highlights.is_empty() {
        return;
    }
    *out += "<dl class=highlights>";
    for (name, value) in highlights {
        let (name, value) = (escape(name), escape(value));
        let _ = write!(out, "<div><dt>{name}</dt><dd>{value}</dd></div>");
    }
    *out += "</dl>\n";
}

fn block(out: &mut String, block: &Block) {
    let written = match block {
        Block::Heading(text) => writeln!(out, "<h3>{}</h3>", escape(text)),
        Block::Text(text) => writeln!(out, "<p class=note>{}</p>", escape(text)),
        Block::Warning(text) => writeln!(out, "<p class=warning>{}</p>", escape(text)),
        Block::Facts(facts) => {
            *out += "<dl class=facts>";
            for (name, value) in facts {
                let (name, value) = (escape(name), escape(value));
                let _ = write!(out, "<dt>{name}</dt><dd>{value}</dd>");
            }
            writeln!(out, "</dl>")
        }
        Block::Table(rows) => {
            table(out, rows);
            Ok(())
        }
        Block::Charts(charts) => {
            *out += "<div class=charts>\n";
            let charts = charts.iter().filter(|chart| !chart.is_empty());
            charts.for_each(|chart| *out += &chart.html());
            writeln!(out, "</div>")
        }
        Block::Scenes(scenes) => {
            *out += "<div class=scenes>\n";
            scenes.iter().for_each(|scene| *out += &scene.html());
            writeln!(out, "</div>")
        }
        Block::Folded(title, table) => {
            let _ = write!(out, "<details><summary>{}</summary>", escape(title));
            self::table(out, table);
            writeln!(out, "</details>")
        }
        Block::Source(title, text) => {
            let (title, text) = (escape(title), escape(text));
            let source = format!("<summary>{title}</summary><pre>{text}</pre>");
            writeln!(out, "<details>{source}</details>")
        }
    };
    written.expect("written to memory");
}

fn table(out: &mut String, Table { header, rows }: &Table) {
    *out += "<div class=tables><table><thead><tr>";
    let words = |column: usize| {
        let cells = rows.iter().filter(|row| row.len() > 1);
        let mut cells = cells.filter_map(|row| row.get(column));
        column > 0 && cells.any(|cell| cell.text.len() > WORDS)
    };
    for (column, name) in header.iter().enumerate() {
        let class = if words(column) { "words" } else { "" };
        let _ = write!(out, "<th class=\"{class}\">{}</th>", escape(name));
    }
    *out += "</tr></thead><tbody>\n";
    for row in rows {
        *out += "<tr>";
        let (span, group) = match row.len() {
            1 => (format!(" colspan={}", header.len().max(1)), Some("group")),
            _ => (String::new(), None),
        };
        for (index, cell) in row.iter().enumerate() {
            let words = if words(index) { "words" } else { "" };
            let kind = group.unwrap_or(words);
            let (tone, text) = (tone(cell.tone), escape(&cell.text));
            let _ = write!(out, "<td class=\"{kind} {tone}\"{span}>{text}</td>");
        }
        *out += "</tr>\n";
    }
    *out += "</tbody></table></div>\n";
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Panel;

    #[test]
    fn text_is_never_markup() {
        let bad = || "<script>alert('1\"&')</script>".to_string();
        let label = "<script>alert(2)</script>";
        let chart = Panel::lines(bad(), label, vec![(bad(), vec![(0.0, 1.0)])]);
        let table = Table {
            header: vec![bad(), bad()],
            rows: vec![vec![bad().into()], vec![bad().into(), bad().into()]],
        };
        let blocks = vec![
            Block::Heading(bad()),
            Block::Text(bad()),
            Block::Warning(bad()),
            Block::Facts(vec![(bad(), bad())]),
            Block::Table(table.clone()),
            Block::Folded(bad(), table),
            Block::Charts(vec![chart]),
            Block::Source(bad(), bad()),
        ];
        let page = Page {
            title: bad(),
            subtitle: bad(),
            status: bad().into(),
            highlights: vec![(bad(), bad())],
            sections: vec![Section {
                title: bad(),
                blocks,
            }],
        };
        let html = html(&page);
        assert!(!html.contains("<script"), "{html}");
        assert!(html.matches("&lt;script&gt;").count() >= 20);
    }

    #[test]
    fn a_section_of_nothing_is_left_out() {
        let mut empty = Section::new("nothing here");
        empty.add(Block::Facts(Vec::new()));
        empty.add(Block::Charts(vec![Panel::lines("", "", vec![])]));
        let mut full = Section::new("something");
        full.add(Block::Text("words".into()));
        let page = Page {
            sections: vec![empty, full],
            ..Page::default()
        };
        let html = html(&page);
        assert!(!html.contains("nothing here") && html.contains("something"));
        for outside in ["http://", "https://", "src=", "@import"] {
            assert!(!html.contains(outside), "{outside}");
        }
    }
}
