//! Path files: TOML, a table of points, SVG.

use kinegrad_settings::{ABOVE_ZERO, Document, in_range};
use schemars::JsonSchema;
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};

use super::svg::read_svg;
use super::{CatmullRom, Parameterization, PathError, Polyline};

/// Curve through the points of a path.
#[derive(Clone, Copy, Debug, Default, Deserialize, Eq, PartialEq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum CurveKind {
    /// Straight lines.
    Line,
    /// A Catmull-Rom spline.
    #[default]
    Spline,
}

/// A path over the ground.
///
/// ```toml
/// points = [[0.0, 0.0], [0.0, 2.0], [1.5, 3.0]]   # x and z, metres
/// curve = "spline"              # or "line"
/// parameterization = "centripetal"
/// closed = false
/// speed = 1.2                   # metres per second
/// ```
#[derive(Clone, Debug, Default, Deserialize, PartialEq, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PathPlan {
    /// Ground positions `[x, z]`, metres.
    #[serde(deserialize_with = "ground_points")]
    pub points: Vec<[f64; 2]>,
    /// Curve through the points.
    #[serde(default)]
    pub curve: CurveKind,
    /// Parameterization of a spline.
    #[serde(default)]
    pub parameterization: Parameterization,
    /// True if the path returns to its start.
    #[serde(default)]
    pub closed: bool,
    /// Speed along the path, metres per second. By default the motion covers the whole path.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub speed: Option<f64>,
}

impl PathPlan {
    /// A polyline.
    pub fn line(points: Vec<[f64; 2]>) -> Self {
        Self {
            points,
            curve: CurveKind::Line,
            ..Self::default()
        }
    }

    /// The path in `text`, by `file`'s extension: `.csv` with x and z, `.svg` with a scale, or
    /// TOML.
    ///
    /// # Errors
    /// [`PathError::Document`] or [`PathError::File`] with the place in the file.
    pub fn read(text: &str, file: &str, metres_per_unit: Option<f64>) -> Result<Self, PathError> {
        let in_file = |problem: String| PathError::File {
            file: file.to_owned(),
            problem,
        };
        let (_, ending) = file.rsplit_once('.').unwrap_or_default();
        let ending = ending.to_lowercase();
        if metres_per_unit.is_some() && ending != "svg" {
            let problem = "option `metres_per_unit` is for drawings (.svg): this file is in metres";
            return Err(in_file(problem.to_owned()));
        }
        let plan = match ending.as_str() {
            "csv" => Self::line(read_table(text).map_err(in_file)?),
            "svg" => {
                let scale = metres_per_unit.ok_or_else(|| {
                    let problem = "a drawing has no metres: state the length of its unit, as \
                                   option `metres_per_unit 0.01`";
                    in_file(problem.to_owned())
                })?;
                let (points, closed) = read_svg(text, scale).map_err(in_file)?;
                Self {
                    closed,
                    ..Self::line(points)
                }
            }
            _ => {
                let document = Document::parse(text, file)?;
                let plan: Self = document.read("docs/paths.md describes paths")?;
                if let Err(PathError::Setting(setting)) = plan.validate() {
                    return Err(document.refuse(setting).into());
                }
                plan
            }
        };
        let in_place = |error: PathError| in_file(error.to_string());
        plan.validate().map_err(in_place).map(|()| plan)
    }

    /// # Errors
    /// The errors of [`polyline`](Self::polyline), and [`PathError::NoLength`].
    pub fn validate(&self) -> Result<(), PathError> {
        if let Some(speed) = self.speed {
            in_range("speed", speed, ABOVE_ZERO)?;
        }
        match self.polyline()?.length() < super::STILL {
            true => Err(PathError::NoLength),
            false => Ok(()),
        }
    }

    /// The path by arc length ([`CatmullRom::polyline`]).
    ///
    /// # Errors
    /// [`PathError::TooFewPoints`], [`PathError::NotAPoint`].
    pub fn polyline(&self) -> Result<Polyline, PathError> {
        match self.curve {
            CurveKind::Spline => {
                let spline = CatmullRom::new(&self.points, self.parameterization, self.closed);
                Ok(spline?.polyline())
            }
            CurveKind::Line => {
                let mut points = self.points.clone();
                if self.closed && points.len() > 1 {
                    points.push(points[0]);
                }
                Polyline::new(points)
            }
        }
    }
}

/// Points of two coordinates each.
fn ground_points<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<[f64; 2]>, D::Error> {
    let points = Vec::<Vec<f64>>::deserialize(from)?.into_iter();
    let pair = |point: Vec<f64>| {
        let found = point.len();
        let wrong = |_| D::Error::invalid_length(found, &"an array of length 2");
        <[f64; 2]>::try_from(point).map_err(wrong)
    };
    points.map(pair).collect()
}

/// The points of a table, one per row. The first row may name columns x and z.
fn read_table(text: &str) -> Result<Vec<[f64; 2]>, String> {
    let mut reader = csv::ReaderBuilder::new()
        .has_headers(false)
        .flexible(true)
        .trim(csv::Trim::All)
        .comment(Some(b'#'))
        .from_reader(text.as_bytes());
    let (mut columns, mut width) = ([0, 1], 2);
    let mut points = Vec::new();
    for (number, row) in reader.records().enumerate() {
        let row = row.map_err(|error| error.to_string())?;
        let place = row.position();
        let line = place.map_or(number as u64 + 1, csv::Position::line);
        let named = |name: &str| row.iter().position(|cell| cell.eq_ignore_ascii_case(name));
        if number == 0 && row.iter().any(|cell| cell.parse::<f64>().is_err()) {
            let [Some(x), Some(z)] = ["x", "z"].map(named) else {
                let names: Vec<&str> = row.iter().collect();
                return Err(format!(
                    "line {line}: the columns are {}, among them `x` and `z` are needed",
                    names.join(", ")
                ));
            };
            for name in ["x", "z"] {
                let count = row.iter().filter(|cell| cell.eq_ignore_ascii_case(name));
                if count.count() > 1 {
                    return Err(format!("line {line}: several columns are named `{name}`"));
                }
            }
            (columns, width) = ([x, z], row.len());
            continue;
        }
        if number == 0 && row.len() != width {
            return Err(format!(
                "line {line}: {} columns without names: name two of them `x` and `z` in a first line",
                row.len()
            ));
        }
        if row.len() > width {
            return Err(format!(
                "line {line}: {} columns where the first line has {width}",
                row.len()
            ));
        }
        let mut point = [0.0; 2];
        for (value, column) in point.iter_mut().zip(columns) {
            let cell = row.get(column).unwrap_or_default();
            let column = column + 1;
            let wrong = |_| format!("line {line}: `{cell}` in column {column} is not a number");
            *value = cell.parse().map_err(wrong)?;
        }
        points.push(point);
    }
    Ok(points)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_read_from_toml_and_tables() {
        let text = "points = [[0, 0], [0, 2.5]]\ncurve = 'line'\nspeed = 1.2\n";
        let plan = PathPlan::read(text, "p.toml", None).unwrap();
        assert_eq!(plan.speed, Some(1.2));
        assert_eq!(plan.polyline().unwrap().length(), 2.5);
        let table = "# by hand\nframe, z, x\n0, 0.0, 1.0\n1, 2.0, 1.0\n";
        let plan = PathPlan::read(table, "p.csv", None).unwrap();
        assert_eq!(plan.points, [[1.0, 0.0], [1.0, 2.0]]);
        for text in ["1;2\n", "1,2,3\n4,5,6\n"] {
            assert!(PathPlan::read(text, "p.csv", None).is_err(), "{text}");
        }
        let plan = PathPlan::read("1,2\n3,4\n", "p.csv", None).unwrap();
        assert_eq!(plan.points, [[1.0, 2.0], [3.0, 4.0]]);
    }

    #[test]
    fn closed_paths_return() {
        let square = vec![[0.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, 0.0]];
        let plan = PathPlan {
            closed: true,
            ..PathPlan::line(square)
        };
        assert_eq!(plan.polyline().unwrap().length(), 4.0);
        let spline = PathPlan {
            curve: CurveKind::Spline,
            ..plan
        };
        let length = spline.polyline().unwrap().length();
        assert!((4.0..4.6).contains(&length), "{length}");
    }

    #[test]
    fn invalid_files_are_refused_with_their_place() {
        for (file, text, expected) in [
            (
                "p.toml",
                "points = [[0, 0]]",
                "p.toml: a path has 1 points, at least 2 are needed",
            ),
            (
                "p.toml",
                "points = [[1, 1], [1, 1]]",
                "p.toml: all points of the path are the same: it has no length",
            ),
            (
                "p.toml",
                "points = [[0, 0], [nan, 1]]",
                "p.toml:1: `points[1][0]`: NaN is not a finite number",
            ),
            (
                "p.toml",
                "\npoints = [[0, 0], [1]]",
                "p.toml:2: `points`: expected a list of 2 values, found 1",
            ),
            (
                "p.toml",
                "points = [[0, 0, 1], [0, 2, 1]]",
                "p.toml:1: `points`: expected a list of 2 values, found 3",
            ),
            (
                "p.csv",
                "0,0\n1,2,3\n",
                "p.csv: line 2: 3 columns where the first line has 2",
            ),
            (
                "p.csv",
                "x,z,X\n0,0,1\n",
                "p.csv: line 1: several columns are named `x`",
            ),
            (
                "p.toml",
                "points = [[0, 0], [1, 1]]\nspeed = 0",
                "p.toml:2: `speed` is 0, allowed: more than 0",
            ),
            (
                "p.toml",
                "points = [[0, 0], [1, 1]]\nspeeds = 1",
                "p.toml:2: unknown key `speeds`, allowed: points, curve, parameterization, closed, speed",
            ),
            (
                "p.csv",
                "a,b\n1,2\n",
                "p.csv: line 1: the columns are a, b, among them `x` and `z` are needed",
            ),
            (
                "p.csv",
                "x,z\n1,2\n3\n",
                "p.csv: line 3: `` in column 2 is not a number",
            ),
            (
                "p.svg",
                "<svg/>",
                "p.svg: a drawing has no metres: state the length of its unit, as option `metres_per_unit 0.01`",
            ),
        ] {
            let found = PathPlan::read(text, file, None).unwrap_err();
            assert_eq!(found.to_string(), expected, "{text}");
        }
        let found = PathPlan::read("points = [[0,0],[0,1]]", "p.toml", Some(1.0)).unwrap_err();
        assert!(found.to_string().contains("in metres"), "{found}");
    }
}
