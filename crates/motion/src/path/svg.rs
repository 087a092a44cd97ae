//! Paths in SVG files.

use std::cell::Cell;

use kurbo::{BezPath, PathEl};
use roxmltree::{Document, Node, ParsingOptions};

use super::polyline::MAX_METRES;

/// Tolerance of the flattening of curves, metres.
const TOLERANCE: f64 = 1e-3;

/// Allowed scales, metres per unit.
const SCALES: std::ops::RangeInclusive<f64> = 1e-6..=1e4;

/// SVG elements whose children are not rendered in place.
const HIDDEN: [&str; 6] = ["defs", "clipPath", "marker", "mask", "pattern", "symbol"];

/// Most straight pieces of a path.
const MOST_PIECES: usize = 1 << 20;

/// Largest number of nodes of a file; entities can multiply nodes.
const MOST_NODES: u32 = 1 << 20;

/// Largest number of attributes of an element; the parser compares each with those before it.
const MOST_ATTRIBUTES: usize = 4096;

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
    // Values of attributes contain no `<`.
    let has_many = |tag: &str| tag.matches('=').nth(MOST_ATTRIBUTES).is_some();
    if text.split('<').any(has_many) {
        return Err(format!(
            "an element has more than {MOST_ATTRIBUTES} attributes"
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
    let node = first_path(document.root());
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
    let (mut path, mut closed) = (Vec::new(), false);
    let pieces = Cell::new(0);
    let is_next = |element: &PathEl| matches!(element, PathEl::MoveTo(_)) && pieces.get() > 0;
    let first = outline.iter();
    let first = first.take_while(|element| !is_next(element) && pieces.get() <= MOST_PIECES);
    kurbo::flatten(first, TOLERANCE / scale, |element| {
        match element {
            // The upward direction of the page is +z.
            PathEl::MoveTo(point) | PathEl::LineTo(point) => {
                path.push([scale * point.x, -scale * point.y]);
            }
            PathEl::ClosePath => closed = true,
            _ => unreachable!("a flattened path has lines only"),
        }
        pieces.set(path.len());
    });
    if path.len() > MOST_PIECES {
        return Err(format!(
            "its path has more than {MOST_PIECES} straight pieces, of 1 mm accuracy: simplify it, or \
             state the length of a unit with a smaller option `metres_per_unit`"
        ));
    }
    Ok((path, closed))
}

/// The first rendered element that is a path.
fn first_path<'a, 'i>(root: Node<'a, 'i>) -> Option<Node<'a, 'i>> {
    let names = ["path", "polyline", "polygon", "line"];
    let mut next = root.first_element_child();
    while let Some(node) = next {
        let name = node.tag_name().name();
        let is_hidden = HIDDEN.contains(&name)
            || node.attribute("display") == Some("none")
            || style_of(&node).contains("display:none");
        if names.contains(&name) && !is_hidden {
            return Some(node);
        }
        let inside = node.first_element_child().filter(|_| !is_hidden);
        let behind = || {
            node.ancestors()
                .find_map(|above| above.next_sibling_element())
        };
        next = inside.or_else(behind);
    }
    None
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
    fn many_attributes_are_refused() {
        let attributes: String = (0..=MOST_ATTRIBUTES)
            .map(|n| format!(" a{n}='>'"))
            .collect();
        let error = read_svg(&svg(&format!("<g{attributes}/>")), 1.0).unwrap_err();
        assert!(error.contains("more than 4096 attributes"), "{error}");
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
    fn curves_have_a_bound_and_deep_drawings_take_one_step_for_each_node() {
        let curves = |count: usize| {
            let curve = " C 4999 4999 -4999 4999 0 0";
            svg(&format!("<path d='M0 0{}'/>", curve.repeat(count)))
        };
        let found = read_svg(&curves(2), 1.0).unwrap().0.len();
        assert!(found < 20_000, "{found}");
        // Without a bound, these would be millions of points.
        let problem = read_svg(&curves(2000), 1.0).unwrap_err();
        assert!(
            problem.contains("more than 1048576 straight pieces"),
            "{problem}"
        );
        // With a look at all elements above each, this would take minutes.
        let deep = 100_000;
        let open = "<g><text/>".repeat(deep);
        let text = format!(
            "<svg>{open}{}<path d='M0 0L1 1'/></svg>",
            "</g>".repeat(deep)
        );
        match read_svg(&text, 1.0) {
            Ok((points, _)) => assert_eq!(points.len(), 2),
            Err(problem) => assert!(problem.contains("it is not SVG"), "{problem}"),
        }
        let deep = 500;
        let open = "<g><path style='display:none' d='M0 0L2 2'/>".repeat(deep);
        let text = format!(
            "<svg>{open}{}<path d='M0 0L1 1'/></svg>",
            "</g>".repeat(deep)
        );
        assert_eq!(read_svg(&text, 1.0).unwrap().0[1], [1.0, -1.0]);
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
