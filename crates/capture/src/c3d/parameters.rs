//! The parameter section: groups of named, typed arrays.

use super::Processor;

/// A parameter, its data still as in the file.
pub(super) struct Parameter<'a> {
    group: i8,
    name: String,
    /// -1 characters, 1 bytes, 2 words, 4 floats.
    kind: i8,
    dimensions: &'a [u8],
    data: &'a [u8],
    /// Place of the data in the file.
    pub offset: usize,
}

pub(super) struct Parameters<'a> {
    processor: Processor,
    groups: Vec<(i8, String)>,
    parameters: Vec<Parameter<'a>>,
}

impl<'a> Parameters<'a> {
    /// Reads the records from `start` on. The error is the place of the record that does not fit
    /// into the file.
    ///
    /// The link of each record leads behind its name. So every step goes forward, and all names
    /// together fit into the file's length.
    pub fn read(bytes: &'a [u8], start: usize, processor: Processor) -> Result<Self, usize> {
        let mut all = Self {
            processor,
            groups: Vec::new(),
            parameters: Vec::new(),
        };
        let mut place = start;
        // A name of length 0 ends the section, and so does the end of the file.
        while let Some(&[length, id]) = bytes.get(place..).and_then(<[u8]>::first_chunk)
            && length != 0
        {
            // A negative length marks a locked parameter.
            let length = usize::from((length as i8).unsigned_abs());
            let (length, id) = (length, id as i8);
            let link = place + 2 + length;
            let name = bytes.get(place + 2..link).ok_or(place)?;
            let name = String::from_utf8_lossy(name).trim().to_ascii_uppercase();
            let next = processor.word(bytes, link).ok_or(place)?;
            if id < 0 {
                all.groups.push((id.saturating_neg(), name));
            } else {
                let parameter = Parameter::read(bytes, link + 2, id, name).ok_or(place)?;
                all.parameters.push(parameter);
            }
            if next == 0 {
                break;
            }
            place = link + usize::from(next);
        }
        Ok(all)
    }

    /// The parameter `GROUP:NAME`.
    pub fn find(&self, group: &str, name: &str) -> Option<&Parameter<'a>> {
        let (id, _) = self.groups.iter().find(|(_, name)| name == group)?;
        let mut parameters = self.parameters.iter();
        parameters.find(|parameter| parameter.group == *id && parameter.name == name)
    }

    /// Entry `index` of a numeric parameter; words are taken without sign.
    pub fn number(&self, group: &str, name: &str, index: usize) -> Option<f64> {
        let parameter = self.find(group, name)?;
        match parameter.kind {
            1 => Some((*parameter.data.get(index)?).into()),
            2 => Some(self.processor.word(parameter.data, 2 * index)?.into()),
            4 => Some(self.processor.float(parameter.data, 4 * index)?.into()),
            _ => None,
        }
    }

    /// The strings of a parameter of characters, trimmed, none if it is missing.
    pub fn strings(&self, group: &str, name: &str) -> impl Iterator<Item = String> + use<'a> {
        let parameter = self.find(group, name).filter(|p| p.kind == -1);
        let (width, data) = parameter.map_or((1, &[][..]), |p| {
            (p.dimensions.first().map_or(1, |w| usize::from(*w)), p.data)
        });
        data.chunks(width.max(1)).map(|text| {
            let text = String::from_utf8_lossy(text);
            text.trim_matches([' ', '\0']).to_string()
        })
    }
}

impl<'a> Parameter<'a> {
    /// Reads type, dimensions and data from `place` on; none if they do not fit into the file.
    fn read(bytes: &'a [u8], place: usize, group: i8, name: String) -> Option<Self> {
        let &[kind, count] = bytes.get(place..)?.first_chunk()?;
        let (kind, count) = (kind as i8, usize::from(count));
        let offset = place + 2 + count;
        let dimensions = bytes.get(place + 2..offset)?;
        let mut length = usize::from(kind.unsigned_abs());
        for dimension in dimensions {
            length = length.checked_mul(usize::from(*dimension))?;
        }
        let data = bytes.get(offset..offset.checked_add(length)?)?;
        Some(Self {
            group,
            name,
            kind,
            dimensions,
            data,
            offset,
        })
    }
}
