//! Names of the files of samples.

/// Names of the samples of a request: `count` per stem, numbered if there are several.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Names {
    /// The names of the conditions; empty for a single one.
    pub stems: Vec<String>,
    /// Samples per stem.
    pub count: usize,
}

impl Names {
    /// The name of sample `index` (from 0) of a stem.
    pub fn of(&self, stem: &str, index: usize) -> String {
        match self.count {
            1 => stem.to_string(),
            _ => format!("{stem}-{index:03}"),
        }
    }

    /// True if a sample has that name.
    pub fn contains(&self, name: &str) -> bool {
        let number = name
            .rsplit_once('-')
            .and_then(|(_, number)| number.parse().ok());
        let index = number.filter(|&index| index < self.count).unwrap_or(0);
        self.stems.iter().any(|stem| self.of(stem, index) == name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_numbered_where_there_are_several() {
        let stems = || vec![String::new(), "-a".to_string()];
        let one = Names {
            stems: stems(),
            count: 1,
        };
        assert_eq!(one.of("-a", 0), "-a");
        assert!(one.contains("") && one.contains("-a"));
        assert!(!one.contains("-a-000") && !one.contains("-b"));
        let many = Names {
            stems: stems(),
            count: 1200,
        };
        assert_eq!(many.of("-a", 7), "-a-007");
        assert!(many.contains("-a-007") && many.contains("-1199"));
        for other in ["", "-a", "-a-7", "-1200", "-a-1200", "-a-0007", "-b-000"] {
            assert!(!many.contains(other), "{other}");
        }
    }
}
