//! Paths in SVG files.

use kurbo::{BezPath, PathEl};
use roxmltree::{Document, Node, ParsingOptions};

use super::polyline::MAX_METRES;

/// Tolerance of the flattening of curves, metres.
const TOLERANCE: f64 = 1e-3;

/// Allowed scales, metres per unit.
const SCALES: std::ops::RangeInclusive<f64> = 1e-6..=1e4;

/// SVG elements whose children are not rendered in place.
const HIDDEN: [&str; 6] = ["defs", "clipPath", "marker", "mask", "pattern", "symbol"];

/// Largest number of nodes of a file; entities can multiply nodes.
const MOST_NODES: u32 = 1 << 20;

/// The first `path`, `polyline`, `polygon` or `line` of an SVG file, with `scale` metres per unit.
/// Returns points `[x, z]`, metres, x to the right, z up, and true if closed. Only the first
/// subpath is read.
pub(super) fn read_svg(text: &str, scale: f64) -> Result<(Vec<[f64; 2]>, bool), String> {
    if !SCALES.contains(&scale) {
        let (least, most) = (SCALES.start(), SCALES.end());
        return Err(format!(
            "a unit is {scale} metres, allowed: {least} to {most}"
        ));
    }
    // Drawing programs write a document type.
    let options = ParsingOptions {
        allow_dtd: true,
        nodes_limit: MOST_NODES,
        ..ParsingOptions::default()
    };
    let document = Document::parse_with_options(text, options);
    let document = document.map_err(|error| format!("it is not SVG: {error}"))?;
    let names = ["path", "polyline", "polygon", "line"];
    let is_path = |node: &Node| {
        let hidden = node.ancestors().any(|node| {
            HIDDEN.contains(&node.tag_name().name())
                || node.attribute("display") == Some("none")
                || style_of(&node).contains("display:none")
        });
        node.is_element() && names.contains(&node.tag_name().name()) && !hidden
    };
    let node = document.descendants().find(is_path);
    let node = node.ok_or("it contains no `path`, `polyline`, `polygon` or `line`")?;
    let turned =
        |node: Node| node.has_attribute("transform") || style_of(&node).contains("transform");
    if node.ancestors().any(turned) {
        return Err(
            "its path has a `transform`, which is not read: apply it in the drawing program".into(),
        );
    }
    let outline = outline(&node)?;
    let elements = outline.elements().iter();
    let mut points = elements.flat_map(|element| match *element {
        PathEl::MoveTo(a) | PathEl::LineTo(a) => vec![a],
        PathEl::QuadTo(a, b) => vec![a, b],
        PathEl::CurveTo(a, b, c) => vec![a, b, c],
        PathEl::ClosePath => Vec::new(),
    });
    let far = |value: f64| !value.is_finite() || scale * value.abs() > MAX_METRES;
    if let Some(point) = points.find(|point| far(point.x) || far(point.y)) {
        return Err(format!(
            "a point of its path is ({}, {}) units, allowed: at most {MAX_METRES} metres",
            point.x, point.y
        ));
    }
    let (mut path, mut closed, mut parts) = (Vec::new(), false, 0);
    kurbo::flatten(outline, TOLERANCE / scale, |element| {
        parts += usize::from(matches!(element, PathEl::MoveTo(_)));
        match element {
            _ if parts > 1 => {}
            // The upward direction of the page is +z.
            PathEl::MoveTo(point) | PathEl::LineTo(point) => {
                path.push([scale * point.x, -scale * point.y]);
            }
            PathEl::ClosePath => closed = true,
            _ => unreachable!("a flattened path has lines only"),
        }
    });
    Ok((path, closed))
}

/// A node's style without spaces.
fn style_of(node: &Node) -> String {
    let style = node.attribute("style").unwrap_or_default();
    style.split_whitespace().collect()
}

/// A node's outline as a path.
fn outline(node: &Node) -> Result<BezPath, String> {
    let name = node.tag_name().name();
    let attribute = |key: &str| {
        let value = node.attribute(key);
        value.ok_or_else(|| format!("its `{name}` has no `{key}`"))
    };
    let data = match name {
        "path" => attribute("d")?.to_owned(),
        "line" => {
            let [x1, y1, x2, y2] = ["x1", "y1", "x2", "y2"].map(attribute);
            format!("M{},{} L{},{}", x1?, y1?, x2?, y2?)
        }
        "polygon" => format!("M{} Z", attribute("points")?),
        _ => format!("M{}", attribute("points")?),
    };
    BezPath::from_svg(&data).map_err(|error| format!("its `{name}` cannot be read: {error}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::path::PathPlan;

    fn svg(inside: &str) -> String {
        format!("<svg xmlns='http://www.w3.org/2000/svg'><g>{inside}</g></svg>")
    }

    #[test]
    fn lines_and_curves_of_a_drawing_are_read_in_metres() {
        let text =
            svg("<text>a</text><path d='M 100 0 C 100 -100 200 -100 200 -200 M 0 0 L 5 5'/>");
        let (points, closed) = read_svg(&text, 0.01).unwrap();
        assert_eq!(points[0], [1.0, 0.0]);
        assert_eq!(points.last(), Some(&[2.0, 2.0]));
        assert!(points.len() > 5 && !closed);
        let polygon = svg("<polygon points='0,0 10,0 10,-20'/>");
        let (points, closed) = read_svg(&polygon, 0.1).unwrap();
        assert_eq!(points, [[0.0, 0.0], [1.0, 0.0], [1.0, 2.0]]);
        assert!(closed);
        let line = svg("<line x1='0' y1='0' x2='0' y2='-30'/>");
        let (points, _) = read_svg(&line, 0.1).unwrap();
        assert_eq!(points, [[0.0, 0.0], [0.0, 3.0]]);
        let plan = PathPlan::read(&svg("<polyline points='0,0 1,-1'/>"), "a.SVG", Some(2.0));
        assert_eq!(plan.unwrap().points[1], [2.0, 2.0]);
    }

    #[test]
    fn programs_write_document_types_and_hide_what_is_not_seen() {
        let hidden = "<path style='fill:red; display : none' d='M 0 0 L 9 9'/>\
                      <g display='none'><path d='M 0 0 L 8 8'/></g>";
        let path = svg(&format!("{hidden}<path d='M 0 0 L 0 -3'/>"));
        let text = format!(
            "<?xml version='1.0'?>\n<!DOCTYPE svg PUBLIC '-//W3C//DTD SVG 1.1//EN' \
             'http://www.w3.org/Graphics/SVG/1.1/DTD/svg11.dtd'>\n{path}"
        );
        let (points, _) = read_svg(&text, 1.0).unwrap();
        assert_eq!(points, [[0.0, 0.0], [0.0, 3.0]]);
    }

    #[test]
    fn hidden_paths_are_refused() {
        for (text, scale, expected) in [
            ("no", 1.0, "it is not SVG"),
            (&svg("<rect/>"), 1.0, "it contains no `path`"),
            (&svg("<path/>"), 1.0, "its `path` has no `d`"),
            (&svg("<path d='M 0 x'/>"), 1.0, "its `path` cannot be read"),
            (
                &svg("<path transform='scale(2)' d='M0 0L1 1'/>"),
                1.0,
                "`transform`",
            ),
            (&svg("<path d='M0 0L1 1'/>"), 0.0, "a unit is 0 metres"),
            (&svg("<path d='M0 0L1 1'/>"), 1e200, "a unit is 1"),
            (
                &svg("<path d='M0 0 C 1e200 0 1 1 2 2'/>"),
                1.0,
                "a point of its path",
            ),
            (
                &svg("<path d='M0 0 C 1e20 0 1 1 2 2'/>"),
                1e-6,
                "a point of its path",
            ),
            (
                &svg("<path style='transform: scale(2)' d='M0 0L1 1'/>"),
                1.0,
                "`transform`",
            ),
            (
                &svg("<defs><path d='M0 0L1 1'/></defs>"),
                1.0,
                "it contains no `path`",
            ),
        ] {
            let found = read_svg(text, scale).unwrap_err();
            assert!(found.contains(expected), "{found}");
        }
    }
}
