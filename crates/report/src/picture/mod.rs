//! Charts in a grid as SVG or PNG, by file extension.

mod axes;
mod body;
mod chart;
mod heat;
mod html;
mod legend;
mod panel;

use std::error::Error;
use std::path::{Path, PathBuf};

use kinegrad_output::block;
use miette::Diagnostic;
use plotters::coord::Shift;
use plotters::prelude::*;

pub use body::body_panels;
pub use panel::{Panel, Series};

use crate::font;
use crate::raster::Image;
use chart::draw_panel;

/// Errors of pictures.
#[derive(Debug, thiserror::Error, Diagnostic)]
pub enum PictureError {
    /// An unknown file extension.
    #[error("`{}`: ending `{ending}` found", path.display())]
    #[diagnostic(help("pictures are .svg or .png"))]
    Ending {
        /// The file.
        path: PathBuf,
        /// Its extension.
        ending: String,
    },
    /// Drawing or writing failed.
    #[error("cannot draw {}: {reason}", path.display())]
    #[diagnostic(help("check that its folder exists and can be written"))]
    Drawing {
        /// The file.
        path: PathBuf,
        /// The cause.
        reason: String,
    },
}

/// Checks the file extension.
///
/// # Errors
/// [`PictureError::Ending`].
pub fn check_ending(out: &Path) -> Result<(), PictureError> {
    let ending = out.extension().unwrap_or_default().to_ascii_lowercase();
    match ending == "svg" || ending == "png" {
        true => Ok(()),
        false => Err(PictureError::Ending {
            path: out.to_path_buf(),
            ending: ending.to_string_lossy().into_owned(),
        }),
    }
}

/// Draws the panels to `out`, `columns` side by side, each `size` pixels.
///
/// # Errors
/// [`PictureError`].
pub fn draw(
    panels: &[Panel],
    columns: usize,
    size: (u32, u32),
    out: &Path,
) -> Result<(), PictureError> {
    check_ending(out)?;
    let ending = out.extension().unwrap_or_default();
    let is_svg = ending.eq_ignore_ascii_case("svg");
    let sheet = Sheet::new(panels, columns, size);
    let bytes = if is_svg { sheet.svg() } else { sheet.png() };
    let written = bytes.and_then(|bytes| Ok(kinegrad_output::write(out, &bytes)?));
    written.map_err(|error| PictureError::Drawing {
        path: out.to_path_buf(),
        reason: error.to_string(),
    })
}

/// The panels as a PNG file, and its size in pixels; `None` if the panels cannot be drawn.
pub fn draw_png(
    panels: &[Panel],
    columns: usize,
    size: (u32, u32),
) -> Option<(Vec<u8>, (u32, u32))> {
    let sheet = Sheet::new(panels, columns, size);
    Some((sheet.png().ok()?, sheet.size))
}

/// A panel with its upper left corner and size in pixels.
type Placed<'a> = (&'a Panel, (i32, i32), (u32, u32));

/// Panels placed in a picture.
struct Sheet<'a> {
    panels: Vec<Placed<'a>>,
    size: (u32, u32),
}

impl<'a> Sheet<'a> {
    /// Places the panels row by row; a wide panel fills a row.
    fn new(panels: &'a [Panel], columns: usize, (width, height): (u32, u32)) -> Self {
        let columns = columns.min(panels.len()).max(1) as u32;
        let mut placed = Vec::with_capacity(panels.len());
        let (mut column, mut row) = (0, 0);
        for panel in panels {
            let span = if panel.is_wide { columns } else { 1 };
            if column + span > columns {
                (column, row) = (0, row + 1);
            }
            let corner = ((column * width) as i32, (row * height) as i32);
            placed.push((panel, corner, (span * width, height)));
            column += span;
        }
        Self {
            panels: placed,
            size: (columns * width, (row + 1) * height),
        }
    }

    fn svg(&self) -> Result<Vec<u8>, Box<dyn Error>> {
        let mut text = String::new();
        let root = SVGBackend::with_string(&mut text, self.size).into_drawing_area();
        self.draw(&root)?;
        drop(root);
        // XML has no control characters, and titles are names of files.
        Ok(block(&text).into_owned().into_bytes())
    }

    fn png(&self) -> Result<Vec<u8>, Box<dyn Error>> {
        let (width, height) = self.size;
        let mut rgb = vec![0; 3 * width as usize * height as usize];
        let bitmap = BitMapBackend::with_buffer(&mut rgb, self.size);
        let root = font::Bitmap(bitmap).into_drawing_area();
        self.draw(&root)?;
        drop(root);
        Ok(Image { width, height, rgb }.png())
    }

    fn draw<B: DrawingBackend<ErrorType: 'static>>(
        &self,
        root: &DrawingArea<B, Shift>,
    ) -> Result<(), Box<dyn Error>> {
        font::register();
        root.fill(&WHITE)?;
        for &(panel, corner, size) in &self.panels {
            draw_panel(panel, &root.clone().shrink(corner, size))?;
        }
        root.present()?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn svg(panels: &[Panel]) -> String {
        let sheet = Sheet::new(panels, 1, (520, 250));
        String::from_utf8(sheet.svg().expect("drawn")).expect("text")
    }

    /// The points of the first curve, which follows its stroke in the legend.
    fn first_curve(svg: &str) -> Vec<(f64, f64)> {
        let of_first = |line: &&str| line.contains("<polyline") && line.contains("#2F6FED");
        let line = svg.lines().rfind(of_first);
        let points = line.expect("a line").split("points=\"").nth(1);
        let points = points.expect("points").split('"').next().expect("a list");
        let pair = |pair: &str| {
            let (x, y) = pair.split_once(',').expect("x and y");
            (x.parse().expect("x"), y.parse().expect("y"))
        };
        points.split_whitespace().map(pair).collect()
    }

    #[test]
    fn a_metre_on_a_map_is_as_long_to_the_right_as_downwards() {
        let square = [(0.0, 0.0), (3.0, 0.0), (3.0, 3.0), (0.0, 3.0)];
        let map = Panel::map("map", vec![("path".into(), square.to_vec())]);
        let corners = first_curve(&svg(&[map]));
        let (across, down) = (corners[1].0 - corners[0].0, corners[2].1 - corners[1].1);
        assert!(down > 100.0, "z goes downwards: {corners:?}");
        assert!((across - down).abs() <= 2.0, "{corners:?}");
    }

    #[test]
    fn names_leave_no_control_characters() {
        let curve = |name: &str| (name.to_string(), vec![(0.0, 0.0), (4.0, 1.0)]);
        let svg = svg(&[Panel::lines(
            "red\u{1b}[31m\u{7}",
            "s",
            vec![curve("a\u{8}b")],
        )]);
        let is_control = |c: char| c.is_control() && !matches!(c, '\n' | '\t');
        assert!(!svg.contains(is_control), "{svg:?}");
        assert!(svg.contains("red\\u{1b}[31m\\u{7}"), "{svg}");
    }

    #[test]
    fn legends_and_ticks_stand_above_the_plot() {
        let curve = |name: &str| (name.to_string(), vec![(0.0, 0.0), (4.0, 1.0)]);
        let panel = Panel::lines("curves", "s", vec![curve("one"), curve("two")]);
        let svg = svg(&[panel.with_marks(&[1.0, 2.0])]);
        let top = first_curve(&svg)
            .iter()
            .fold(f64::INFINITY, |top, p| top.min(p.1));
        let mut ticks = 0;
        for line in svg.lines().filter(|line| line.contains("#FF0000")) {
            let ends = line.split("points=\"").nth(1).expect("points");
            let y: f64 = ends
                .split([',', ' '])
                .nth(3)
                .and_then(|y| y.parse().ok())
                .expect("y");
            assert!(y < top, "{line}");
            ticks += 1;
        }
        assert_eq!(ticks, 2);
        for name in ["one", "two"] {
            let before = svg.split(&format!("\n{name}\n")).next().expect("text");
            let tag = before.rsplit("<text").next().expect("a tag");
            let y = tag.split(" y=\"").nth(1).expect("y").split('"').next();
            assert!(
                y.expect("y").parse::<f64>().expect("a number") < top,
                "{tag}"
            );
        }
    }

    #[test]
    fn a_lone_point_is_a_dot() {
        let blue = |points: Vec<(f64, f64)>| {
            let panel = Panel::lines("", "step", vec![("loss".into(), points)]);
            let sheet = [panel];
            let png = Sheet::new(&sheet, 1, (300, 200)).png().expect("drawn");
            let mut reader = png::Decoder::new(std::io::Cursor::new(png))
                .read_info()
                .expect("a header");
            let mut rgb = vec![0; reader.output_buffer_size().expect("a size")];
            reader.next_frame(&mut rgb).expect("pixels");
            rgb.chunks_exact(3)
                .filter(|pixel| **pixel == [0x2f, 0x6f, 0xed])
                .count()
        };
        let legend = blue(vec![]);
        assert!(blue(vec![(3.0, 1.0)]) > legend + 20);
        let broken = vec![(1.0, 1.0), (2.0, f64::NAN), (3.0, 2.0), (4.0, f64::NAN)];
        assert!(blue(broken) > legend + 40);
    }

    #[test]
    fn a_slow_line_has_no_gaps() {
        let slow = |i: i32| (f64::from(i) / 4000.0, 0.3 * f64::from(i) / 4000.0);
        let panel = [Panel::lines(
            "",
            "s",
            vec![("path".into(), (0..4000).map(slow).collect())],
        )];
        let png = Sheet::new(&panel, 1, (300, 200)).png().expect("drawn");
        let mut reader = png::Decoder::new(std::io::Cursor::new(png))
            .read_info()
            .expect("a header");
        let mut rgb = vec![0; reader.output_buffer_size().expect("a size")];
        reader.next_frame(&mut rgb).expect("pixels");
        let is_blue = |pixel: &[u8]| pixel[2] > 150 && pixel[0] < 140;
        let column = |x: usize| (30..170).any(|y| is_blue(&rgb[3 * (300 * y + x)..][..3]));
        assert!((100..250).all(column));
    }

    #[test]
    fn the_label_of_an_axis_is_below_its_ticks() {
        let panel = Panel::lines(
            "",
            "step",
            vec![("loss".into(), vec![(20.0, 0.4), (60.0, 0.8)])],
        );
        let svg = svg(&[panel]);
        let height = |text: &str| -> f64 {
            let before = svg.split(&format!("\n{text}\n")).next().expect("text");
            let tag = before.rsplit("<text").next().expect("a tag");
            let y = tag.split(" y=\"").nth(1).expect("y").split('"').next();
            y.expect("y").parse().expect("a number")
        };
        assert!(
            height("step") >= height("40") + 11.0,
            "{} {}",
            height("step"),
            height("40")
        );
    }

    #[test]
    fn a_wide_panel_has_a_row_for_itself() {
        let panel = || Panel::lines("", "s", Vec::new());
        let wide = Panel {
            is_wide: true,
            ..panel()
        };
        let panels = [panel(), wide, panel(), panel(), panel()];
        let sheet = Sheet::new(&panels, 2, (10, 5));
        let places = sheet.panels.iter();
        let places: Vec<_> = places.map(|(_, corner, size)| (*corner, size.0)).collect();
        let expected = [
            ((0, 0), 10),
            ((0, 5), 20),
            ((0, 10), 10),
            ((10, 10), 10),
            ((0, 15), 10),
        ];
        assert_eq!(places, expected);
        assert_eq!(sheet.size, (20, 20));
    }

    #[test]
    fn a_picture_in_memory_is_the_one_in_a_file() {
        let folder = std::env::temp_dir().join(format!("kinegrad-picture-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a folder");
        let panel = || [Panel::strip("feet", 2.0, [("left", &[true, false][..])])];
        let out = folder.join("strip.png");
        draw(&panel(), 1, (200, 100), &out).expect("written");
        let (png, size) = draw_png(&panel(), 1, (200, 100)).expect("drawn");
        assert_eq!(size, (200, 100));
        assert!(png == std::fs::read(&out).expect("bytes"));
        std::fs::remove_dir_all(folder).expect("removed");
    }
}
